use super::*;
use crate::imaging::{Components, ImageView, MomentSums, Window};
use proptest::prelude::*;

/// Border, its parent, and whether it is a hole's.
type Border = (Vec<Point>, Option<usize>, bool);

/// Border following pixel by pixel, with marks, as published (Suzuki and Abe 1985, Appendix I).
fn slow(dark: &[bool], width: usize) -> Vec<Border> {
    let (w, h) = (width + 2, dark.len() / width + 2);
    let mut f = vec![0i64; w * h];
    for (i, &d) in dark.iter().enumerate() {
        f[(i / width + 1) * w + i % width + 1] = i64::from(d);
    }
    // clockwise on the screen: east, south-east, ...
    let around: [i64; 8] =
        [1, w as i64 + 1, w as i64, w as i64 - 1, -1, -(w as i64) - 1, -(w as i64), 1 - w as i64];
    let step = |at: usize, d: usize| (at as i64 + around[d % 8]) as usize;
    let towards = |at: usize, to: usize| (0..8).find(|&d| step(at, d) == to).unwrap();
    let point = |at: usize| Point { x: (at % w - 1) as u32, y: (at / w - 1) as u32 };
    let mut borders: Vec<Border> = Vec::new();
    for y in 1..h - 1 {
        // 1 is the frame, a hole's border
        let mut lnbd = 1i64;
        for x in 1..w - 1 {
            let at = y * w + x;
            let start = match f[at] {
                1 if f[at - 1] == 0 => Some((at - 1, false)),
                v if v >= 1 && f[at + 1] == 0 => {
                    if v > 1 {
                        lnbd = v;
                    }
                    Some((at + 1, true))
                }
                _ => None,
            };
            if let Some((from, hole)) = start {
                let nbd = borders.len() as i64 + 2;
                let before = (lnbd >= 2).then(|| (lnbd - 2) as usize);
                let parent = match before {
                    None => None,
                    Some(b) if borders[b].2 == hole => borders[b].1,
                    Some(b) => Some(b),
                };
                assert!(parent.is_some() || !hole);
                let mut points = Vec::new();
                let d0 = towards(at, from);
                let first = (0..8).map(|k| step(at, d0 + k)).find(|&n| f[n] != 0);
                if let Some(first) = first {
                    let (mut i2, mut i3) = (first, at);
                    loop {
                        points.push(point(i3));
                        // counter-clockwise from the one behind i2
                        let d2 = towards(i3, i2);
                        let mut east_was_zero = false;
                        let mut i4 = i3;
                        for k in 1..=8 {
                            let n = step(i3, d2 + 8 - k);
                            if f[n] != 0 {
                                i4 = n;
                                break;
                            }
                            east_was_zero |= n == i3 + 1;
                        }
                        if east_was_zero {
                            f[i3] = -nbd;
                        } else if f[i3] == 1 {
                            f[i3] = nbd;
                        }
                        if i4 == at && i3 == first {
                            break;
                        }
                        (i2, i3) = (i3, i4);
                    }
                } else {
                    points.push(point(at));
                    f[at] = -nbd;
                }
                borders.push((points, parent, hole));
            }
            if f[at] != 0 && f[at] != 1 {
                lnbd = f[at].abs();
            }
        }
    }
    borders
}

fn random(width: usize, height: usize, seed: u64, density: u64) -> Vec<bool> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        state >> 56 < density
    };
    (0..width * height).map(|_| next()).collect()
}

fn runs(dark: &[bool], width: usize) -> Runs {
    let pixels: Vec<u8> = dark.iter().map(|&d| if d { 0 } else { 255 }).collect();
    let image = ImageView::new(&pixels, width, dark.len() / width).unwrap();
    let mut runs = Runs::with_limit(dark.len());
    runs.find(&image, &Window::whole(&image), 100);
    runs
}

proptest! {
    #[test]
    fn contours_are_those_of_border_following(
        width in 1usize..40, height in 1usize..30, seed in any::<u64>(), density in 1u64..255,
    ) {
        let dark = random(width, height, seed, density);
        let mut contours = Contours::with_limits(10, 5000);
        for _ in 0..2 {
            contours.find(&runs(&dark, width), Connectivity::Eight);
            prop_assert!(!contours.overflowed());
            let got: Vec<Border> =
                contours.as_slice().iter().map(|c| (contours.points(c).to_vec(), c.parent(), c.hole)).collect();
            prop_assert_eq!(got, slow(&dark, width));
        }
        // children, brothers and depth say the same as parents
        let list = contours.as_slice();
        for (i, c) in list.iter().enumerate() {
            prop_assert_eq!(c.depth, c.parent().map_or(0, |p| list[p].depth + 1));
            let mut child = c.first_child();
            let mut children = Vec::new();
            while let Some(at) = child {
                children.push(at);
                child = list[at].next_sibling();
            }
            let wanted: Vec<_> = (0..list.len()).filter(|&k| list[k].parent() == Some(i)).collect();
            prop_assert_eq!(children, wanted);
        }
    }

    /// Moments from borders are those of the pixels, to the last bit.
    #[test]
    fn borders_enclose_the_regions_moments(
        width in 1usize..60, height in 1usize..40, seed in any::<u64>(), density in 1u64..255,
    ) {
        let dark = random(width, height, seed, density);
        let runs = runs(&dark, width);
        let (mut contours, mut components) = (Contours::with_limits(10, 5000), Components::default());
        contours.find(&runs, Connectivity::Eight);
        let window = Window { x0: 0, y0: 0, x1: width, y1: height };
        components.find(&runs, &window, Connectivity::Eight);
        let mut sums = vec![MomentSums::default(); components.as_slice().len()];
        for c in contours.as_slice() {
            let own = MomentSums::of_border(contours.points(c));
            prop_assert_eq!(own.m00, if c.hole { -i128::from(c.area_px2) } else { c.area_px2.into() });
            sums[c.region as usize] += own;
        }
        let wanted: Vec<_> = (0..components.as_slice().len()).map(|i| components.sums(&runs, i)).collect();
        prop_assert_eq!(sums, wanted);
    }

    /// With sides alone, contours go along the same regions as the labelling does.
    #[test]
    fn four_neighbours_are_kept_apart(
        width in 1usize..40, height in 1usize..30, seed in any::<u64>(), density in 1u64..255,
    ) {
        let dark = random(width, height, seed, density);
        let runs = runs(&dark, width);
        let (mut contours, mut components) = (Contours::with_limits(10, 5000), Components::default());
        contours.find(&runs, Connectivity::Four);
        components.find(&runs, &Window { x0: 0, y0: 0, x1: width, y1: height }, Connectivity::Four);
        let mut area = vec![0i64; components.as_slice().len()];
        for c in contours.as_slice() {
            area[c.region as usize] += if c.hole { -(c.area_px2 as i64) } else { c.area_px2 as i64 };
            let points = contours.points(c);
            for (a, b) in points.iter().zip(points.iter().cycle().skip(1)) {
                prop_assert!(a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1);
                prop_assert!(dark[a.y as usize * width + a.x as usize]);
            }
        }
        prop_assert_eq!(components.as_slice().iter().map(|c| c.m00 as i64).collect::<Vec<_>>(), area);
    }
}

#[test]
fn overflow_is_told() {
    let dark = random(50, 50, 3, 128);
    let (runs, mut contours) = (runs(&dark, 50), Contours::with_limits(10, 100));
    contours.find(&runs, Connectivity::Eight);
    assert!(contours.overflowed());
    assert!(contours.as_slice().iter().map(|c| contours.points(c).len()).sum::<usize>() <= 100);
    assert!(contours.as_slice().iter().all(|c| !c.is_empty()));
    contours.find(&Runs::with_limit(0), Connectivity::Eight);
    assert!(!contours.overflowed() && contours.as_slice().is_empty());
}
