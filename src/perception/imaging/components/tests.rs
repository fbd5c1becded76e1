use super::*;
use crate::imaging::{ImageView, MomentSums, Plane, Run};
use proptest::prelude::*;

fn find(pixels: &[u8], width: usize, connectivity: Connectivity) -> Vec<Component> {
    let image = ImageView::new(pixels, width, pixels.len() / width).unwrap();
    let window = Window::whole(&image);
    let mut runs = Runs::with_limit(10_000);
    runs.find(&image, &window, 100);
    let mut components = Components::with_limit(10_000);
    components.find(&runs, &window, connectivity);
    components.as_slice().to_vec()
}

/// Flood fill, pixel by pixel.
fn slow(pixels: &[u8], width: usize, connectivity: Connectivity) -> Vec<Component> {
    let height = pixels.len() / width;
    let mut seen = vec![false; pixels.len()];
    let mut out = Vec::new();
    for start in 0..pixels.len() {
        if seen[start] || pixels[start] > 100 {
            continue;
        }
        let mut c = Component { x0: u32::MAX, y0: u32::MAX, ..Component::default() };
        let mut stack = vec![start];
        seen[start] = true;
        while let Some(at) = stack.pop() {
            let (x, y) = ((at % width) as u64, (at / width) as u64);
            c.m00 += 1;
            c.m10 += x;
            c.m01 += y;
            c.m20 += x * x;
            c.m11 += x * y;
            c.m02 += y * y;
            c.x0 = c.x0.min(x as u32);
            c.x1 = c.x1.max(x as u32 + 1);
            c.y0 = c.y0.min(y as u32);
            c.y1 = c.y1.max(y as u32 + 1);
            c.touches_border |= x == 0 || y == 0 || x as usize + 1 == width || y as usize + 1 == height;
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
                if connectivity == Connectivity::Four && dx != 0 && dy != 0 {
                    continue;
                }
                let (nx, ny) = (x as i64 + dx, y as i64 + dy);
                if nx < 0 || ny < 0 || nx >= width as i64 || ny >= height as i64 {
                    continue;
                }
                let next = ny as usize * width + nx as usize;
                if !seen[next] && pixels[next] <= 100 {
                    seen[next] = true;
                    stack.push(next);
                }
            }
        }
        out.push(c);
    }
    out
}

proptest! {
    #[test]
    fn components_are_those_of_flood_fill(
        width in 1usize..80, height in 1usize..40, seed in any::<u64>(), density in 1u64..255,
    ) {
        let mut state = seed;
        let pixels: Vec<u8> = (0..width * height).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            if state >> 56 < density { 0 } else { 255 }
        }).collect();
        for connectivity in [Connectivity::Four, Connectivity::Eight] {
            let (mut got, mut wanted) = (find(&pixels, width, connectivity), slow(&pixels, width, connectivity));
            got.sort_by_key(|c| (c.y0, c.x0, c.m10, c.m01, c.m00));
            wanted.sort_by_key(|c| (c.y0, c.x0, c.m10, c.m01, c.m00));
            prop_assert_eq!(got, wanted);
        }
    }
}

#[test]
fn second_moments_of_an_ellipse() {
    let (a, b, angle) = (40.0f64, 25.0, 0.5f64);
    let mut pixels = vec![255; 200 * 150];
    for y in 0..150 {
        for x in 0..200 {
            let (dx, dy) = (f64::from(x) - 100.3, f64::from(y) - 70.8);
            let (u, v) = (dx * angle.cos() + dy * angle.sin(), dy * angle.cos() - dx * angle.sin());
            if (u / a).powi(2) + (v / b).powi(2) < 1.0 {
                pixels[(y * 200 + x) as usize] = 0;
            }
        }
    }
    let found = find(&pixels, 200, Connectivity::Eight);
    assert_eq!(found.len(), 1);
    // R diag(a^2, b^2) R^T / 4
    let (sin, cos) = angle.sin_cos();
    let wanted = [
        0.25 * (a * a * cos * cos + b * b * sin * sin),
        0.25 * (a * a - b * b) * sin * cos,
        0.25 * (a * a * sin * sin + b * b * cos * cos),
    ];
    for (own, wanted) in found[0].covariance().iter().zip(wanted) {
        assert!((own - wanted).abs() < 0.005 * a * a, "{own} {wanted}");
    }
    let (x, y) = found[0].centroid();
    assert!((x - 100.3).abs() < 0.05 && (y - 70.8).abs() < 0.05);
}

proptest! {
    /// Labels of pixels gather the regions again, and grey sums are those of the pixels with each label.
    #[test]
    fn labels_are_those_of_the_regions(
        width in 1usize..80, height in 1usize..40, seed in any::<u64>(), density in 1u8..255,
    ) {
        let mut state = seed;
        let pixels: Vec<u8> = (0..width * height).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8
        }).collect();
        let image = ImageView::new(&pixels, width, height).unwrap();
        let window = Window::whole(&image);
        let (mut runs, mut components) = (Runs::with_limit(4000), Components::with_limit(10));
        runs.find(&image, &window, density);
        components.find(&runs, &window, Connectivity::Four);
        let mut labels = Plane::with_size(1, 1);
        components.label_image(&runs, width, height, &mut labels);
        let mut sums = Vec::new();
        components.grey_sums(&image, &runs, &mut sums);
        prop_assert_eq!(sums.len(), components.as_slice().len());
        for (i, (c, sum)) in (1u32..).zip(components.as_slice().to_vec().iter().zip(&sums)) {
            let mut own = [0u64; 4];
            let (mut weighted, mut thirds) = ([0i128; 3], [0i128; 4]);
            for (at, &p) in pixels.iter().enumerate().filter(|(at, _)| labels.as_slice()[*at] == i) {
                let (x, y) = ((at % width) as u64, (at / width) as u64);
                prop_assert!(p <= density);
                own = [own[0] + 1, own[1] + x, own[2] + y, own[3] + x * y];
                let [x3, y3] = [x, y].map(i128::from);
                thirds = [thirds[0] + x3.pow(3), thirds[1] + x3 * x3 * y3, thirds[2] + x3 * y3 * y3, thirds[3] + y3.pow(3)];
                weighted[0] += i128::from(p);
                weighted[1] += i128::from(p) * i128::from(x * x * y);
                weighted[2] += i128::from(p) * i128::from(y * y * y);
            }
            prop_assert_eq!(own, [c.m00, c.m10, c.m01, c.m11]);
            let plain = components.sums(&runs, i as usize - 1);
            prop_assert_eq!(thirds, [plain.m30, plain.m21, plain.m12, plain.m03]);
            prop_assert_eq!(weighted, [sum.m00, sum.m21, sum.m03]);
        }
        let background = labels.as_slice().iter().filter(|l| **l == 0).count();
        prop_assert_eq!(background, pixels.iter().filter(|p| **p > density).count());
    }
}

#[test]
fn third_moments_of_a_huge_image_are_exact() {
    // a row far down and far to the right: the sum of 65 530^3 alone is near the end of 64 bits
    let run = Run { y: 65_530, x0: 1, x1: 65_531 };
    let (c, n) = (MomentSums::of_run(&run), 65_530i128);
    assert_eq!(c.m30, (n * (n + 1) / 2).pow(2));
    assert_eq!(c.m03, n * n.pow(3));
    assert_eq!(c.m21, n * (n + 1) * (2 * n + 1) / 6 * n);
}
