//! A blob: the ellipse with the area and the second moments of a dark region, which may be a dot.

use crate::imaging::Component;

/// Least area that is measured, px^2. Chosen by hand: a dot of 3 px radius, tilted by 60 degrees, has 14; below, noise makes many.
const MIN_AREA_PX2: f64 = 9.0;
/// Least area of a region whose holes are filled, px^2. Chosen by hand: the smallest ring about a hole of one pixel has 8, and a dot below
/// 25 has no room for glare within it; noise makes many such rings.
const MIN_HOLED_AREA_PX2: f64 = 25.0;
/// Flattest ellipse that is taken for a dot. Chosen by hand: 78 degrees of tilt, where a dot of 10 px radius is four rows.
const MIN_AXIS_RATIO: f64 = 0.2;

/// Least part of its box that an ellipse fills. Derived: half of that of the flattest one at 45 degrees, 0.30, for rims of few pixels.
const MIN_SHARE_OF_BOX: f64 = 0.15;

/// Ellipse of a dark region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Blob {
    pub(super) x: f64,
    pub(super) y: f64,
    /// Covariance `[xx, xy, yy]` of a point that is uniform in the region, px^2.
    pub(super) covariance: [f64; 3],
    pub(super) area: f64,
}

impl Blob {
    /// The ellipse of a region; `None` where the region is too small, cut by the image's border, too flat, or where its area does not fit
    /// its second moments.
    pub(super) fn of(component: &Component) -> Option<Self> {
        let area = component.m00 as f64;
        if component.touches_border || area < MIN_AREA_PX2 {
            return None;
        }
        // Cheap first: of its box an ellipse fills pi/4, a tilted flat one less, nothing of it more.
        let box_area = f64::from(component.x1 - component.x0) * f64::from(component.y1 - component.y0);
        // chosen by hand, since the smallest ellipses lack little but their boxes' corners, four pixels
        if area > 0.95 * box_area + 4.0 || area < MIN_SHARE_OF_BOX * box_area {
            return None;
        }
        let [xx, xy, yy] = component.covariance();
        // moments of the pixels' squares, not only of their centres
        let covariance = [xx + 1.0 / 12.0, xy, yy + 1.0 / 12.0];
        let (x, y) = component.centroid();
        let blob = Self { x, y, covariance, area };
        let (major, minor) = blob.axes();
        let ratio = area / (std::f64::consts::PI * major * minor);
        // a ragged rim matters more on a small region
        let tolerance = 0.04 + 0.25 / minor;
        let good = (ratio - 1.0).abs() < tolerance && minor > MIN_AXIS_RATIO * major && blob.fills(component);
        good.then_some(blob)
    }

    /// Whether filling a region's holes may turn it into an ellipse: it is large enough, not cut by the border, and its area would grow at most
    /// `max_grown` times.
    pub(super) fn may_have_holes(component: &Component, max_grown: u64) -> bool {
        let box_area = f64::from(component.x1 - component.x0) * f64::from(component.y1 - component.y0);
        let area = component.m00 as f64;
        let grown = area * max_grown as f64;
        !component.touches_border
            && (MIN_HOLED_AREA_PX2..box_area).contains(&area)
            && grown >= MIN_SHARE_OF_BOX * box_area
    }

    /// Whether the ellipse touches the region's box on all four sides: a partly occluded dot does not.
    fn fills(&self, c: &Component) -> bool {
        let side = |centre: f64, variance: f64, low: u32, high: u32| {
            let half = 2.0 * variance.max(0.0).sqrt();
            let tolerance = 0.06 * half + 0.8;
            (centre - half - (f64::from(low) - 0.5)).abs() < tolerance
                && (centre + half - (f64::from(high) - 0.5)).abs() < tolerance
        };
        side(self.x, self.covariance[0], c.x0, c.x1) && side(self.y, self.covariance[2], c.y0, c.y1)
    }

    /// The ellipse `d^T S^-1 d = 1` in the same directions, with other half axes.
    pub(super) fn with_axes(&self, other: impl Fn(f64) -> f64) -> [f64; 3] {
        let [xx, xy, yy] = self.covariance;
        let (major, minor) = self.axes();
        let (big, small) = (other(major).powi(2), other(minor).powi(2));
        // S = p I + q C has the eigenvectors of C and the required axes
        let (c_big, c_small) = (0.25 * major * major, 0.25 * minor * minor);
        // a circle's directions are rounding alone
        let q = if c_big - c_small > 1e-9 * c_big { (big - small) / (c_big - c_small) } else { 0.0 };
        let p = big - q * c_big;
        [p + q * xx, q * xy, p + q * yy]
    }

    /// Half axes of the ellipse, px.
    pub(super) fn axes(&self) -> (f64, f64) {
        let [xx, xy, yy] = self.covariance;
        let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        (2.0 * (mean + half).max(0.0).sqrt(), 2.0 * (mean - half).max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::{Components, Connectivity, ImageView, Runs, Window};

    fn largest(inside: impl Fn(f64, f64) -> bool) -> Component {
        let pixels: Vec<u8> = (0..100 * 80)
            .map(|i| if inside(f64::from(i % 100), f64::from(i / 100)) { 0 } else { 255 })
            .collect();
        let image = ImageView::new(&pixels, 100, 80).unwrap();
        let window = Window::whole(&image);
        let (mut runs, mut components) = (Runs::with_limit(1000), Components::with_limit(1000));
        runs.find(&image, &window, 128);
        components.find(&runs, &window, Connectivity::Eight);
        *components.as_slice().iter().max_by_key(|c| c.m00).unwrap()
    }

    #[test]
    fn ellipses_pass_and_other_shapes_do_not() {
        for (a, b) in [(3.0f64, 3.0f64), (20.0, 12.0), (20.0, 6.0), (35.0, 35.0), (4.0, 2.2)] {
            let c = largest(|x, y| ((x - 50.2) / a).powi(2) + ((y - 40.4) / b).powi(2) < 1.0);
            let blob = Blob::of(&c).unwrap_or_else(|| panic!("{a} {b}"));
            let (major, minor) = blob.axes();
            assert!((major - a).abs() < 0.25 && (minor - b).abs() < 0.25, "{a} {b}: {major} {minor}");
        }
        let refused: [&dyn Fn(f64, f64) -> bool; 5] = [
            &|x, y| (x - 50.0).abs() < 20.0 && (y - 40.0).abs() < 20.0,
            &|x, y| (10.0..20.0).contains(&(x - 50.0).hypot(y - 40.0)),
            &|x, y| (x - 50.0).hypot(y - 40.0) < 20.0 && x < 58.0,
            &|x, y| (x - 95.0).hypot(y - 40.0) < 15.0,
            &|x, y| (x - 50.0).abs() < 40.0 && (y - 40.0).abs() < 2.0,
        ];
        for (i, inside) in refused.iter().enumerate() {
            assert!(Blob::of(&largest(inside)).is_none(), "shape {i}");
        }
    }
}
