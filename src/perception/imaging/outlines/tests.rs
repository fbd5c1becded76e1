use super::*;
use crate::imaging::{Components, ImageView, Nested, Nesting, Window};
use proptest::prelude::*;

/// Labels of all pixels, of the background too, by flood fill over a frame of background one pixel wide: regions in reading order.
fn flood(dark: &[bool], width: usize, connectivity: Connectivity) -> (Vec<usize>, Vec<(bool, Vec<usize>)>) {
    let (w, h) = (width + 2, dark.len() / width + 2);
    let set = |at: usize| {
        let (x, y) = (at % w, at / w);
        x > 0 && y > 0 && x + 1 < w && y + 1 < h && dark[(y - 1) * width + x - 1]
    };
    let mut labels = vec![usize::MAX; w * h];
    let mut regions: Vec<(bool, Vec<usize>)> = Vec::new();
    for start in 0..w * h {
        if labels[start] != usize::MAX {
            continue;
        }
        let value = set(start);
        let corners = value == (connectivity == Connectivity::Eight);
        let (mut stack, mut pixels) = (vec![start], Vec::new());
        labels[start] = regions.len();
        while let Some(at) = stack.pop() {
            pixels.push(at);
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
                let (x, y) = ((at % w) as i64 + dx, (at / w) as i64 + dy);
                if (!corners && dx != 0 && dy != 0) || x < 0 || y < 0 || x >= w as i64 || y >= h as i64 {
                    continue;
                }
                let next = y as usize * w + x as usize;
                if labels[next] == usize::MAX && set(next) == value {
                    labels[next] = regions.len();
                    stack.push(next);
                }
            }
        }
        regions.push((value, pixels));
    }
    (labels, regions)
}

/// Nesting from the definition: a region's surroundings is what the pixel left of its first one belongs to.
fn slow(dark: &[bool], width: usize, connectivity: Connectivity) -> Vec<Nested> {
    let (labels, regions) = flood(dark, width, connectivity);
    let around = |label: usize| labels[regions[label].1.iter().min().unwrap() - 1];
    let mut number = vec![0; regions.len()];
    for (count, (label, _)) in (0u32..).zip(regions.iter().enumerate().filter(|(_, r)| r.0)) {
        number[label] = count;
    }
    // everything that lies in something: up through the parents
    let within = |label: usize, outer: usize| {
        let mut at = label;
        while at != 0 && at != outer {
            at = around(at);
        }
        at == outer
    };
    let all = |outer: usize| -> u64 {
        (0..regions.len()).filter(|&l| within(l, outer)).map(|l| regions[l].1.len() as u64).sum()
    };
    let mut out = Vec::new();
    for (label, _) in regions.iter().enumerate().filter(|(_, r)| r.0) {
        let hole = around(label);
        let parent = (hole != 0).then(|| number[around(hole)]);
        let holes: Vec<_> = (1..regions.len()).filter(|&l| !regions[l].0 && around(l) == label).collect();
        let holes_px2 = holes.iter().map(|&l| all(l)).sum();
        out.push(Nested { parent, holes: holes.len() as u32, holes_px2, filled_px2: all(label) });
    }
    out
}

proptest! {
    #[test]
    fn nesting_is_that_of_flood_fill(
        width in 1usize..40, height in 1usize..30, seed in any::<u64>(), density in 1u64..255,
    ) {
        let mut state = seed;
        let dark: Vec<bool> = (0..width * height).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 56 < density
        }).collect();
        let pixels: Vec<u8> = dark.iter().map(|&d| if d { 0 } else { 255 }).collect();
        let image = ImageView::new(&pixels, width, height).unwrap();
        let mut runs = Runs::with_limit(2000);
        runs.find(&image, &Window::whole(&image), 100);
        let (mut nesting, mut components) = (Nesting::with_limit(10), Components::with_limit(10));
        for connectivity in [Connectivity::Four, Connectivity::Eight] {
            nesting.find(&runs, connectivity);
            prop_assert_eq!(nesting.as_slice(), &slow(&dark, width, connectivity)[..]);
            components.find(&runs, &Window::whole(&image), connectivity);
            prop_assert_eq!(components.as_slice().len(), nesting.as_slice().len());
            let of: Vec<_> = nesting.as_slice().iter().map(|n| n.filled_px2 - n.holes_px2).collect();
            prop_assert_eq!(components.as_slice().iter().map(|c| c.m00).collect::<Vec<_>>(), of);
        }
    }
}

#[test]
fn nothing_has_no_outline() {
    let mut outlines = Outlines::default();
    outlines.find(&Runs::with_limit(0), Connectivity::Eight);
    assert!(outlines.as_slice().is_empty());
}
