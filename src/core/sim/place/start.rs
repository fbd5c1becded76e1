//! Start postures near a goal: the camera is displaced by some centimetres and degrees, and the target is still well inside the image.
//!
//! The numbers here were chosen by hand. Smaller displacements follow until the target stays in view. Each start is checked
//! and tried in a simulated run before it is proposed; how often another choice would find more is not measured.

use super::Search;
use super::stand::Stand;
use crate::geometry::Pose;
use crate::scene::Visibility;
use nalgebra::{SVector, UnitQuaternion, Vector2, Vector3};

/// Shares of the widest displacement, the widest first.
const SHARES: [f64; 5] = [1.0, 0.7, 0.45, 0.28, 0.15];
/// The largest displacement to the side and away from the target, as shares of the distance to it.
const ASIDE: f64 = 0.15;
const AWAY: f64 = 0.3;
/// The largest tilt and roll, rad.
const TILT_RAD: f64 = 0.14;
const ROLL_RAD: f64 = 0.25;
/// The largest displacement of a joint of an arm with few joints, rad, and as a share of the distance to the target for a prismatic one.
const JOINT_RAD: f64 = 0.3;
const SLIDE: f64 = 0.25;
/// Margin around the marks, as a share of the image's shorter side.
const FREE_SHARE: f64 = 0.05;
/// Smallest feature error at the start, px: below it a run would show no motion.
const MIN_ERROR_PX: f64 = 10.0;
/// Most starts for each posture at the goal.
const TRIED: usize = 3;

impl<const N: usize> Search<'_, N> {
    /// Starts from which the target of `stand` is seen, the farthest first.
    pub(super) fn starts(&self, stand: &Stand<N>) -> Vec<SVector<f64, N>> {
        let distance_m = stand.X_DO.translation.z;
        let mut found = Vec::new();
        for share in SHARES {
            for signs in 0..8u32 {
                let sign = |bit: u32| if signs >> bit & 1 == 0 { share } else { -share };
                let q = if N >= 6 {
                    self.displaced(stand, distance_m, [sign(0), sign(1), sign(2)], share)
                } else {
                    self.moved(stand, distance_m, &sign)
                };
                if self.sees(stand, &q) {
                    found.push(q);
                    if found.len() >= TRIED {
                        return found;
                    }
                    // another share says more than another side
                    break;
                }
            }
        }
        found
    }

    /// The camera beside, farther away, tilted and rolled, still aimed at the target.
    fn displaced(
        &self,
        stand: &Stand<N>,
        distance_m: f64,
        [x, y, roll]: [f64; 3],
        share: f64,
    ) -> SVector<f64, N> {
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(-y, x, 0.0) * TILT_RAD);
        let turn = tilt * UnitQuaternion::from_scaled_axis(Vector3::z() * (roll * ROLL_RAD));
        let beside = Vector3::new(x * ASIDE, y * ASIDE, -share * AWAY) * distance_m;
        let X_DS = Pose::from_parts(beside.into(), turn);
        let X_WD = stand.X_WO * stand.X_DO.inverse();
        self.posture().towards(&stand.q, &(X_WD * X_DS))
    }

    /// Each joint a little farther.
    fn moved(&self, stand: &Stand<N>, distance_m: f64, sign: &impl Fn(u32) -> f64) -> SVector<f64, N> {
        let kinds = &self.config.robot.joints;
        SVector::from_fn(|i, _| {
            let slides = kinds.get(i).is_some_and(|joint| joint.kind == crate::robot::JointKind::Prismatic);
            let widest = if slides { SLIDE * distance_m } else { JOINT_RAD / N as f64 };
            stand.q[i] + widest * sign((i % 3) as u32)
        })
    }

    /// Whether `q` is a posture with room, from which the whole target is seen, and not where it is to be seen in the end.
    fn sees(&self, stand: &Stand<N>, q: &SVector<f64, N>) -> bool {
        if self.arm.outside_limits(q).is_some() || !(self.room(q) > 0.0) {
            return false;
        }
        let X_CO = self.posture().X_WC(q).inv_mul(&stand.X_WO);
        let camera = &self.config.camera.model;
        let i = camera.intrinsics();
        let visibility = Visibility::of(&self.config.target, camera, &X_CO);
        let free_px = FREE_SHARE * f64::from(i.width_px.min(i.height_px));
        let set_point = crate::servo::SetPoint::from_pose(&stand.X_DO, self.config.set_point.points());
        let error_px = set_point.map_or(0.0, |s| s.error_rms_px_at(&X_CO, &Vector2::new(i.fx_px, i.fy_px)));
        visibility.is_whole() && visibility.room_px >= free_px && error_px >= MIN_ERROR_PX
    }
}
