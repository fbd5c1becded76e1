use super::*;
use crate::imaging::{ImageView, Window};
use proptest::prelude::*;
use std::f64::consts::PI;

/// From the definition, pixel by pixel.
fn slow(pixels: &[(i128, i128, i128)]) -> MomentSums {
    let sum = |i: u32, j: u32| pixels.iter().map(|&(x, y, w)| w * x.pow(i) * y.pow(j)).sum();
    MomentSums {
        m00: sum(0, 0),
        m10: sum(1, 0),
        m01: sum(0, 1),
        m20: sum(2, 0),
        m11: sum(1, 1),
        m02: sum(0, 2),
        m30: sum(3, 0),
        m21: sum(2, 1),
        m12: sum(1, 2),
        m03: sum(0, 3),
    }
}

fn slow_central(pixels: &[(i128, i128, i128)]) -> [f64; 10] {
    let mass: f64 = pixels.iter().map(|p| p.2 as f64).sum();
    let x = pixels.iter().map(|p| p.0 as f64 * p.2 as f64).sum::<f64>() / mass;
    let y = pixels.iter().map(|p| p.1 as f64 * p.2 as f64).sum::<f64>() / mass;
    let mu = |i, j| {
        pixels.iter().map(|p| p.2 as f64 * (p.0 as f64 - x).powi(i) * (p.1 as f64 - y).powi(j)).sum::<f64>()
    };
    [mass, x, y, mu(2, 0), mu(1, 1), mu(0, 2), mu(3, 0), mu(2, 1), mu(1, 2), mu(0, 3)]
}

fn list(m: &Moments) -> [f64; 10] {
    [m.m00, m.x, m.y, m.mu20, m.mu11, m.mu02, m.mu30, m.mu21, m.mu12, m.mu03]
}

fn close(a: [f64; 10], b: [f64; 10], tolerance: f64) -> bool {
    let radius = (b[3] + b[5]).max(0.0).sqrt() / b[0].sqrt() + 1.0;
    let scale = |k: usize| {
        [b[0], 1.0, 1.0, b[0] * radius.powi(2), b[0] * radius.powi(3)][[0, 1, 1, 3, 3, 3, 4, 4, 4, 4][k]]
    };
    (0..10).all(|k| (a[k] - b[k]).abs() <= tolerance * scale(k))
}

proptest! {
    #[test]
    fn grey_sums_are_those_of_the_definition(
        pixels in prop::collection::vec(any::<u8>(), 1..400), width in 1usize..150, x0 in 0usize..150, y0 in 0usize..5,
    ) {
        let height = pixels.len().div_ceil(width);
        let mut pixels = pixels;
        pixels.resize(width * height, 7);
        let image = ImageView::new(&pixels, width, height).unwrap();
        let window = Window { x0, y0, x1: width + 3, y1: height };
        let inside: Vec<_> = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)))
            .filter(|&(x, y)| x >= x0 && y >= y0)
            .map(|(x, y)| (x as i128, y as i128, i128::from(pixels[y * width + x])))
            .collect();
        let sums = MomentSums::of_grey(&image, &window);
        prop_assert_eq!(sums, slow(&inside));
        match sums.central() {
            Some(m) => prop_assert!(close(list(&m), slow_central(&inside), 1e-9), "{m:?}"),
            None => prop_assert_eq!(sums.m00, 0),
        }
        let inverse: Vec<_> = inside.iter().map(|p| (p.0, p.1, 255 - p.2)).collect();
        let ones: Vec<_> = inside.iter().map(|p| (p.0, p.1, 1)).collect();
        let mut rest = slow(&ones).times(255);
        rest -= sums;
        prop_assert_eq!(rest, slow(&inverse));
    }

    #[test]
    fn runs_and_shifts(y in 0u32..3000, x0 in 0u32..3000, n in 0u32..60, dx in -4000i64..4000, dy in -4000i64..4000) {
        let run = Run { y, x0, x1: x0 + n };
        let at = |dx: i64, dy: i64| -> Vec<_> {
            (x0..x0 + n).map(|x| (i128::from(x) + i128::from(dx), i128::from(y) + i128::from(dy), 1)).collect()
        };
        prop_assert_eq!(MomentSums::of_run(&run), slow(&at(0, 0)));
        prop_assert_eq!(MomentSums::of_run(&run).shifted(dx, dy), slow(&at(dx, dy)));
    }

    /// The outline of pixels as a polygon: the same as their sums, each pixel a square.
    #[test]
    fn polygons_of_pixels(rows in prop::collection::vec((0u32..20, 1u32..20), 1..12), x in 0u32..2000, y in 0u32..2000) {
        // rows that overlap their neighbours: a column of pixels belongs to all
        let (mut sums, mut left, mut right) = (MomentSums::default(), Vec::new(), Vec::new());
        for (k, &(before, behind)) in (0u32..).zip(&rows) {
            let run = Run { y: y + k, x0: x + 20 - before, x1: x + 20 + behind };
            sums += MomentSums::of_run(&run);
            for v in [f64::from(run.y) - 0.5, f64::from(run.y) + 0.5] {
                left.push([f64::from(run.x0) - 0.5, v]);
                right.push([f64::from(run.x1) - 0.5, v]);
            }
        }
        left.reverse();
        right.extend(left);
        let wanted = list(&sums.central().unwrap().of_squares());
        prop_assert!(close(list(&Moments::of_polygon(&right).unwrap()), wanted, 1e-9));
        right.reverse();
        prop_assert!(close(list(&Moments::of_polygon(&right).unwrap()), wanted, 1e-9));
    }

    /// A shape with one blunt end, turned: all angles follow.
    #[test]
    fn angles_follow_a_rotation(angle in -PI..PI, x in -500.0..500.0, y in -500.0..500.0, size in 0.5..50.0) {
        // a kite, its blunt end towards +x, a little skew
        let corners = [[2.0, 0.0], [1.0, 1.05], [-4.0, 0.0], [1.0, -1.0]].map(|[u, v]: [f64; 2]| {
            let (c, s) = (angle.cos(), angle.sin());
            [x + size * (c * u - s * v), y + size * (s * u + c * v)]
        });
        let straight = Moments::of_polygon(&[[2.0, 0.0], [1.0, 1.05], [-4.0, 0.0], [1.0, -1.0]]).unwrap();
        let m = Moments::of_polygon(&corners).unwrap();
        let apart = |a: f64, b: f64| (a - b).sin().abs().max(1.0 - (a - b).cos());
        let offset = straight.direction_rad().unwrap();
        prop_assert!(offset.abs() < 0.05);
        prop_assert!(apart(m.direction_rad().unwrap(), angle + offset) < 1e-6);
        prop_assert!(apart(m.skew_direction_rad().unwrap(), angle + straight.skew_direction_rad().unwrap()) < 1e-6);
        let axis = m.axis_rad().unwrap();
        prop_assert!(axis > -PI / 2.0 && axis <= PI / 2.0);
        prop_assert!((axis - angle - offset).sin().abs() < 1e-6);
        // (10.2), cross-multiplied
        prop_assert!(((2.0 * axis).sin() * (m.mu20 - m.mu02) - (2.0 * axis).cos() * 2.0 * m.mu11).abs() < 1e-6 * m.mu20.max(m.mu02));
        let p = m.principal();
        prop_assert!((p.greater + p.smaller - m.mu20 - m.mu02).abs() < 1e-9 * p.greater);
        prop_assert!((p.greater * p.smaller - m.mu20 * m.mu02 + m.mu11 * m.mu11).abs() < 1e-6 * p.greater * p.greater);
        prop_assert!((m.asymmetry() - straight.asymmetry()).abs() < 1e-6);
    }

    #[test]
    fn polygons_without_area_have_no_moments(x in -1e3..1e3, y in -1e3..1e3, u in -1e3..1e3, v in -1e3..1e3) {
        prop_assert!(Moments::of_polygon(&[[x, y], [u, v]]).is_none());
        prop_assert!(Moments::of_polygon(&[[x, y]; 5]).is_none());
        let between = |t: f64| [x + t * (u - x), y + t * (v - y)];
        prop_assert!(Moments::of_polygon(&[0.1, 0.7, 0.9, 0.3, 0.2].map(between)).is_none());
        prop_assert!(Moments::of_polygon(&[[f64::NAN, y], [u, v], [1.0, 2.0]]).is_none());
    }
}

#[test]
fn symmetric_shapes_have_no_direction() {
    let square = Moments::of_polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]).unwrap();
    assert_eq!((square.axis_rad(), square.direction_rad(), square.skew_direction_rad()), (None, None, None));
    let long = Moments::of_polygon(&[[0.0, 0.0], [0.0, 4.0], [1.0, 4.0], [1.0, 0.0]]).unwrap();
    assert!((long.axis_rad().unwrap() - PI / 2.0).abs() < 1e-12);
    assert_eq!(long.direction_rad(), None);
    assert!(MomentSums::default().central().is_none());
    assert!(Moments::of_polygon(&[]).is_none());
    let point = MomentSums::of_run(&Run { y: 3, x0: 5, x1: 6 }).central().unwrap();
    assert_eq!((point.x, point.y, point.asymmetry(), point.axis_rad()), (5.0, 3.0, 0.0, None));
}
