//! What is given: a board's corners in images.

use super::{MIN_POINTS, Unused};
use crate::calibration::bundle::BundlePoint;
use nalgebra::{Matrix2, Point3, Vector2};

/// A corner of the board, and where it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardPoint {
    /// Its id.
    pub id: u32,
    /// Its place on the board, in z_O = 0, m.
    pub p_O: Point3<f64>,
    /// Where it is seen, px.
    pub px: Vector2<f64>,
    /// Covariance of `px`, px^2. All may be wrong by a common factor, which is estimated from the errors.
    pub covariance_px2: Matrix2<f64>,
}

/// The corners seen in one image.
pub type BoardView = Vec<BoardPoint>;

/// The board's middle and half its sides, of all corners seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BoardExtent {
    pub(crate) middle: Vector2<f64>,
    pub(crate) half: Vector2<f64>,
}

impl BoardExtent {
    pub(crate) fn of<'a>(points: impl Iterator<Item = &'a BoardPoint>) -> Self {
        let start = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let (low, high) = points
            .filter(|p| p.p_O.iter().all(|x| x.is_finite()))
            .fold(start, |(low, high), p| (low.inf(&p.p_O.coords.xy()), high.sup(&p.p_O.coords.xy())));
        Self { middle: (low + high) * 0.5, half: (high - low) * 0.5 }
    }

    /// A corner as the least squares take it: from the middle, with what the warp lifts it by. The shape is a parabola along
    /// each side, zero at the ends.
    pub(crate) fn centred(&self, p: &Point3<f64>) -> (nalgebra::Vector3<f64>, Vector2<f64>) {
        let r = p.coords - self.middle.push(0.0);
        let at = |x: f64, half: f64| if half > 0.0 { 1.0 - (x / half) * (x / half) } else { 0.0 };
        (r, Vector2::new(at(r.x, self.half.x), at(r.y, self.half.y)))
    }

    /// A point with the floor `model_sd_px` added to its noise.
    pub(crate) fn point(&self, p: &BoardPoint, model_sd_px: f64) -> BundlePoint {
        let (r, lift) = self.centred(&p.p_O);
        let C = p.covariance_px2 + Matrix2::identity() * (model_sd_px * model_sd_px);
        // lower factor L of C, C = L L^T; W = L^-1
        let l11 = C.m11.sqrt();
        let l21 = C.m21 / l11;
        let l22 = (C.m22 - l21 * l21).sqrt();
        let whitening = Matrix2::new(1.0 / l11, 0.0, -l21 / (l11 * l22), 1.0 / l22);
        BundlePoint { r, lift, px: p.px, whitening }
    }
}

/// Whether a view can take part.
pub(crate) fn usable(view: &BoardView) -> Result<(), Unused> {
    if view.len() < MIN_POINTS {
        return Err(Unused::TooFewPoints { given: view.len() });
    }
    let good = |p: &BoardPoint| {
        let C = &p.covariance_px2;
        let finite = p.p_O.iter().chain(p.px.iter()).chain(C.iter()).all(|x| x.is_finite());
        // semidefinite but for the rounding of a singular one
        let definite = C.m11 >= 0.0 && C.m22 >= 0.0 && C.determinant() >= -1e-12 * C.norm_squared();
        // Symmetric to the rounding of who wrote it; a pixel or a variance of a million must be a slip.
        finite && definite && (C.m12 - C.m21).abs() <= 1e-9 * C.norm() && p.px.amax() < 1e6 && C.amax() < 1e6
    };
    match view.iter().position(|p| !good(p)) {
        Some(index) => Err(Unused::NotFinite { index }),
        None => Ok(()),
    }
}
