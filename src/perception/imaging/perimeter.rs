//! Length of a region's border, and how round the region is.
//!
//! The way from pixel to pixel, 1 px along rows and columns and sqrt(2) px over corners, is up to 8 % longer than the line that
//! was drawn. Weights fitted to straight lines in all directions take that out (Vossepoel and Smeulders 1982):
//!
//! ```text
//! L = 0.980 n_straight + 1.406 n_corner - 0.091 n_turn
//! ```

use super::Point;

/// Mean distance of a region's edge from the centres of its border pixels, px. Derived, by Pick's theorem: `cos(t) / 2` for an edge at the angle `t` from
/// the nearest axis, half a pixel along rows and columns and 0.35 px along diagonals. Its mean over all directions is `sqrt(8) / (2 pi)` = 0.45;
/// the value beside it is 0.01 larger and was chosen by hand.
const EDGE_PX: f64 = 0.46;

/// Length of a closed contour from pixel to pixel, px: 1 along rows and columns, sqrt(2) over corners.
#[must_use]
pub fn chain_length_px(points: &[Point]) -> f64 {
    let (straight, corner, _) = steps(points);
    straight + corner * std::f64::consts::SQRT_2
}

/// Length of the edge of the region within an outer contour, px: right within 1.5 px and 1 % for discs, 3 % for straight sides in the
/// worst direction. `None` for fewer than two pixels.
#[must_use]
pub fn perimeter_px(points: &[Point]) -> Option<f64> {
    let (straight, corner, turns) = steps(points);
    // the edge of a convex region at a distance d from a line of length L has the length L + 2 pi d
    let length = 0.980 * straight + 1.406 * corner - 0.091 * turns + std::f64::consts::TAU * EDGE_PX;
    (points.len() > 1).then_some(length)
}

/// `4 pi A / L^2`: 1 for a disc, pi/4 for a square, and the less the longer or the more ragged a region is. 0 without perimeter.
#[must_use]
pub fn circularity(area_px2: f64, perimeter_px: f64) -> f64 {
    let circle = perimeter_px * perimeter_px / (4.0 * std::f64::consts::PI);
    if circle > 0.0 { area_px2 / circle } else { 0.0 }
}

/// Numbers of steps along rows and columns, over corners, and of changes of direction.
fn steps(points: &[Point]) -> (f64, f64, f64) {
    let step = |a: Point, b: Point| (i64::from(b.x) - i64::from(a.x), i64::from(b.y) - i64::from(a.y));
    let [.., before, last] = points else { return (0.0, 0.0, 0.0) };
    let (mut straight, mut corner, mut turns) = (0u64, 0u64, 0u64);
    let (mut at, mut direction) = (*last, step(*before, *last));
    for &next in points {
        let d = step(at, next);
        if d.0 != 0 && d.1 != 0 {
            corner += 1;
        } else {
            straight += 1;
        }
        turns += u64::from(d != direction);
        (at, direction) = (next, d);
    }
    (straight as f64, corner as f64, turns as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::{Connectivity, Contours, ImageView, Runs, Window};
    use std::f64::consts::PI;

    fn of(inside: impl Fn(f64, f64) -> bool) -> (f64, f64, f64) {
        let pixels: Vec<u8> = (0..300 * 300)
            .map(|i| if inside(f64::from(i % 300) - 150.0, f64::from(i / 300) - 150.0) { 0 } else { 255 })
            .collect();
        let image = ImageView::new(&pixels, 300, 300).unwrap();
        let (mut runs, mut contours) = (Runs::with_limit(1000), Contours::with_limits(1000, 5000));
        runs.find(&image, &Window::whole(&image), 100);
        contours.find(&runs, Connectivity::Eight);
        assert_eq!(contours.as_slice().len(), 1);
        let contour = contours.as_slice()[0];
        let points = contours.points(&contour);
        (contour.area_px2 as f64, perimeter_px(points).unwrap(), chain_length_px(points))
    }

    #[test]
    fn discs_are_round() {
        for k in 0..60 {
            let r = 6.0 + 2.0 * f64::from(k) + 0.37 * f64::from(k % 7);
            let (dx, dy) = (0.3 * f64::from(k % 3), 0.17 * f64::from(k % 5));
            let (area, length, _) = of(|x, y| (x - dx).hypot(y - dy) < r);
            assert!((length - 2.0 * PI * r).abs() < f64::max(1.5, 0.01 * length), "{r}: {length}");
            assert!((circularity(area, length) - 1.0).abs() < 0.02 + 0.3 / r, "{r}: {area} {length}");
        }
    }

    #[test]
    fn squares_have_straight_sides_in_any_direction() {
        for k in 0..20 {
            let (c, s) = ((0.08 * f64::from(k)).cos(), (0.08 * f64::from(k)).sin());
            let (area, length, _) = of(|x, y| (c * x + s * y).abs() < 60.0 && (c * y - s * x).abs() < 60.0);
            assert!((length / 480.0 - 1.0).abs() < 0.035, "{k}: {length}");
            assert!((circularity(area, length) - PI / 4.0).abs() < 0.05);
        }
    }

    #[test]
    fn chains_count_their_steps() {
        let square = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(x, y)| Point { x, y });
        assert_eq!(chain_length_px(&square), 4.0);
        assert_eq!(perimeter_px(&square[..1]), None);
        assert_eq!(chain_length_px(&[]), 0.0);
        assert_eq!(circularity(3.0, 0.0), 0.0);
    }
}
