//! Image features, their interaction matrices and the least-squares solution of the servo law.
//!
//! Sign convention, that of (10.19): `s_dot = L_s V_BC_C` for an object at rest. Image coordinates are normalized,
//! depths in m, twists ordered `[v; w]`.

mod ellipse;
mod flow;
mod jacobian;
mod moments;
mod normal_equations;
mod point;
mod segment;
mod stack;
#[cfg(test)]
mod tests;

pub use ellipse::EllipseFeature;
pub use jacobian::{
    analytical_image_jacobian, analytical_image_jacobian_4, euler_zyx_rate, image_jacobian, planar_columns,
};
pub use moments::{AreaFeature, ImageMoments, MomentFeature};
pub use normal_equations::{NormalEquations, TwistSolution};
pub(crate) use point::PointRows;
pub use point::{PointFeature, point_image_jacobian, point_rows};
pub use segment::{SegmentFeature, segment_features, segment_rows, wrap_rad};
pub use stack::{FeatureStack, StackError, StackRow, solve_twist};

use nalgebra::{SMatrix, SVector};

/// A feature of K numbers that moves with the camera.
pub trait Feature<const K: usize> {
    /// The feature vector s.
    fn value(&self) -> SVector<f64, K>;

    /// The interaction matrix L_s, or `None` where it does not exist (no depth, no length, no area).
    fn interaction(&self) -> Option<SMatrix<f64, K, 6>>;

    /// The error `e_s = s_d - s`, (10.79); kinds that hold angles wrap them.
    fn error(&self, desired: &SVector<f64, K>) -> SVector<f64, K> {
        desired - self.value()
    }
}
