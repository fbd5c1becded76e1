//! Looking around: the place where the target was last seen is brought to other places of the image, as a point is by scheme D.
//!
//! ```text
//! s_dot = L_s J qd        qd = W (L_s J)^T ((L_s J) W (L_s J)^T + lambda)^-1 (rate + k (s_d - s)) + (what changes no s) k (q_seen - q)
//! ```
//! Of all joint motions that bring the place to `s_d` the weights W choose one that turns the camera rather than moves it, and the second part keeps the arm near the posture from
//! which the target was seen.

use super::VisualServo;
use crate::features::point_rows;
use crate::robot::Robot;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Gain k, 1/s. Chosen by hand: that of the way back.
const GAIN_1_S: f64 = super::RETURN_RATE_1_S;
/// Way of the camera for a turn of a joint, m/rad, below which joints count alike. Chosen by hand: wrists move cameras by less, shoulders by more.
const SAME_WAY: f64 = 0.1;
/// Damping as a share of the trace. Chosen by hand: a direction of a thirtieth of the other is answered by half.
const DAMPING: f64 = 1e-3;
/// Depth from which on the place is before the camera, m. Chosen by hand: no lens is nearer.
const MIN_DEPTH_M: f64 = 0.01;

impl<const N: usize> VisualServo<N> {
    /// The joint velocity, rad/s or m/s, by which an arm at `q` brings the place where the goal's target was last seen to `s_d`, normalized, which moves by `rate`, 1/s; and how
    /// far it is from there. `None` where nobody knows that place.
    #[must_use]
    pub fn look_around(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        (s_d, rate): (&Vector2<f64>, &Vector2<f64>),
    ) -> Option<(SVector<f64, N>, f64)> {
        let (place, q_seen) = self.seen_place()?;
        let (X_WC, J) = self.settings.mount.camera(robot, q);
        let J = J.matrix();
        let p_C = X_WC.inverse_transform_point(&place);
        if !(p_C.z > MIN_DEPTH_M) {
            return None;
        }
        let s = p_C.coords.xy() / p_C.z;
        let rows = point_rows(&s, p_C.z) * J;
        let weights = SVector::<f64, N>::from_fn(|i, _| {
            (J.fixed_view::<3, 1>(0, i).norm_squared() + SAME_WAY * SAME_WAY).recip()
        });
        let back = SMatrix::<f64, N, 2>::from_fn(|i, k| weights[i] * rows[(k, i)]);
        let normal = rows * back;
        let inverse = (normal + Matrix2::identity() * (DAMPING * normal.trace())).try_inverse()?;
        let home = (q_seen - q) * GAIN_1_S;
        let off = s_d - s;
        let qd = home + back * (inverse * (rate + off * GAIN_1_S - rows * home));
        qd.iter().all(|x| x.is_finite()).then_some((qd, off.norm()))
    }
}
