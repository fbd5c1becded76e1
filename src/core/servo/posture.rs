//! Inverse kinematics of the camera: postures (joint positions) from which the camera has a desired pose or desired features, within the joint limits.
//!
//! For planning and checks; nothing of it runs in a tick. The first line is [`PostureSearch::towards`], the second [`PostureSearch::features_from`]:
//!
//! ```text
//! V = log(X_WC^-1 X_WD), cut short ─► damped least squares, limits held (robot::damped_velocity) ─► q, again
//! s_d - s ─► normal equations (10.89) ─► joints ─► damped as long as the error does not fall
//! ```

use super::SetPoint;
use crate::features::NormalEquations;
use crate::geometry::{Pose, Twist};
use crate::linalg::{Ldlt, Random};
use crate::robot::{InverseOptions, JointKind, Mount, Robot, RobotDescription};
use nalgebra::{SMatrix, SVector, Vector2};

/// Steps of a search, and the longest one: m, rad of the camera; rad or m of a joint.
/// Chosen by hand: half and twice of each change no unit test.
const STEPS: usize = 150;
const LONGEST_M: f64 = 0.3;
const LONGEST_RAD: f64 = 0.6;
const LONGEST_JOINT: f64 = 0.4;
/// Remaining twist of the camera, and joint step, at which a search ends: some thousand times the rounding of an arm's forward
/// kinematics. Half and twice of each change no unit test.
const THERE: f64 = 1e-11;
const STOPPED: f64 = 1e-10;
/// A joint this near the end of its range is at it: searches clamp to the end itself, so that anything above rounding would do.
const AT_LIMIT: f64 = 1e-6;

/// An arm with its camera, for which postures are sought.
#[derive(Debug, Clone, Copy)]
pub struct PostureSearch<'a, const N: usize> {
    /// The arm.
    pub robot: &'a Robot<N>,
    /// Where the camera is mounted.
    pub mount: &'a Mount,
}

impl<const N: usize> PostureSearch<'_, N> {
    /// Pose of the camera at `q` in the frame W in which the object rests.
    #[must_use]
    pub fn X_WC(&self, q: &SVector<f64, N>) -> Pose {
        self.mount.X_WC(self.robot, q)
    }

    /// From `q` towards a posture with the camera at `X_WD`, in at most `steps` steps. Returns that posture, or the one at which the search ended; the
    /// caller compares [`Self::X_WC`] with `X_WD`.
    #[must_use]
    pub fn towards_within(&self, q: &SVector<f64, N>, X_WD: &Pose, steps: usize) -> SVector<f64, N> {
        let mut q = *q;
        for _ in 0..steps {
            let (X_WC, J) = self.mount.camera(self.robot, &q);
            let off = X_WC.inv_mul(X_WD);
            let (v, w) = (off.translation.vector, off.rotation.scaled_axis());
            let share = (LONGEST_M / v.norm().max(LONGEST_M)).min(LONGEST_RAD / w.norm().max(LONGEST_RAD));
            let V = Twist::new(v.x, v.y, v.z, w.x, w.y, w.z) * share;
            if !(V.amax() > THERE) {
                break;
            }
            // One step is a second: a limit is met where it is.
            let options = InverseOptions {
                // Damping fades with the error, so that the end is quick. Its share and bounds are chosen by hand: half lets steps near a
                // singular posture swing, the double takes more of the steps that a search has.
                damping_max: (0.3 * V.norm()).clamp(1e-4, 0.1),
                limit_horizon_s: 1.0,
                ..InverseOptions::default()
            };
            let step = self.robot.damped_velocity(&q, J.matrix(), &V, &SVector::zeros(), &options).qd;
            if !(step.amax() > STOPPED) {
                break;
            }
            q = self.clamped(&(q + step * (LONGEST_JOINT / step.amax().max(LONGEST_JOINT))));
        }
        q
    }

    /// [`Self::towards_within`] with the usual bound on the steps, 150.
    #[must_use]
    pub fn towards(&self, q: &SVector<f64, N>, X_WD: &Pose) -> SVector<f64, N> {
        self.towards_within(q, X_WD, STEPS)
    }

    /// From `q` to the near posture with the least feature error to `set_point` for an object at `X_WO`: for arms that cannot reach the desired pose
    /// of the camera exactly. Levenberg-Marquardt on the normal equations of (10.89).
    #[must_use]
    pub fn features_from(&self, q: &SVector<f64, N>, X_WO: &Pose, set_point: &SetPoint) -> SVector<f64, N> {
        let unit = Vector2::repeat(1.0);
        let error = |q: &SVector<f64, N>| set_point.error_rms_px_at(&self.X_WC(q).inv_mul(X_WO), &unit);
        let (mut q, mut damping) = (*q, 1e-6);
        let mut least = error(&q);
        for _ in 0..60 {
            let (X_WC, J) = self.mount.camera(self.robot, &q);
            let X_CO = X_WC.inv_mul(X_WO);
            let mut equations = NormalEquations::<6>::new();
            for (p_O, s_d) in set_point.points().iter().zip(set_point.features()) {
                let p_C = X_CO * p_O;
                if p_C.z > 0.0 {
                    let s = p_C.coords.xy() / p_C.z;
                    equations.add_point(&s, p_C.z, &(s_d - s), 1.0);
                }
            }
            let J = J.matrix();
            let A: SMatrix<f64, N, N> = J.transpose() * equations.matrix() * J;
            let b: SVector<f64, N> = J.transpose() * equations.vector();
            // so that the damping of an A of zeros is not zero
            let Some(factors) = Ldlt::new(&A.data.0, &[damping * A.trace().max(1e-12); N]) else { break };
            let next = self.clamped(&(q + SVector::from(factors.solve(&b.into()))));
            let found = error(&next);
            if found < least {
                // Chosen: what is gained is a billionth of the error.
                let done = least - found < 1e-9 * least;
                // The damping of Levenberg and Marquardt; a bound above zero, so that it can grow again.
                (q, least, damping) = (next, found, (damping * 0.2).max(1e-12));
                if done {
                    break;
                }
            } else {
                damping *= 10.0;
                // A step is then a thousandth of the one along the gradient: nothing better is to be found near. Chosen by hand, as the factors are:
                // half or double end such a search a step sooner or later at most.
                if damping > 1e3 {
                    break;
                }
            }
        }
        q
    }

    /// What a search from `q` for the features of `set_point` at `X_WO` finds, `X_WD` being where the camera sees them: the posture that has the
    /// camera there, or comes nearest; then, for arms that cannot have it there, the one near by whose features are right all the same.
    pub fn postures_from(
        &self,
        q: &SVector<f64, N>,
        (X_WO, X_WD): (&Pose, &Pose),
        set_point: &SetPoint,
    ) -> impl Iterator<Item = SVector<f64, N>> {
        let there = self.towards(q, X_WD);
        std::iter::once(there)
            .chain(std::iter::once_with(move || self.features_from(&there, X_WO, set_point)))
    }

    /// A posture anywhere in the ranges.
    #[must_use]
    pub fn anywhere(&self, random: &mut Random) -> SVector<f64, N> {
        use std::f64::consts::PI;
        let limits = self.robot.limits();
        SVector::from_fn(|i, _| {
            // joints without limits, whose range is infinite, must have one to draw from: 1000 rad are turned back below
            let (low, high) = (limits[i].lower.max(-1e3), limits[i].upper.min(1e3));
            // more than a turn either way is another posture only for the cable
            if high - low > 2.0 * PI && low <= -PI && high >= PI {
                random.between(-PI, PI)
            } else {
                random.between(low, high)
            }
        })
    }

    /// Indices of the joints that are at a limit in `q`, and whether it is the upper limit.
    pub fn at_limits(&self, q: &SVector<f64, N>) -> impl Iterator<Item = (usize, bool)> {
        let ends = self.robot.limits().map(|limit| (limit.lower, limit.upper));
        let q = *q;
        (0..N).filter_map(move |i| {
            let (low, high) = ends[i];
            if q[i] >= high - AT_LIMIT {
                Some((i, true))
            } else {
                (q[i] <= low + AT_LIMIT).then_some((i, false))
            }
        })
    }

    /// Distance from a singular posture: the least singular value of the camera's Jacobian, with m and rad mixed.
    #[must_use]
    pub fn dexterity(&self, q: &SVector<f64, N>) -> f64 {
        let (_, J) = self.mount.camera(self.robot, q);
        let still = self.robot.damped_velocity(
            q,
            J.matrix(),
            &Twist::zeros(),
            &SVector::zeros(),
            &InverseOptions::default(),
        );
        still.min_singular_value
    }

    fn clamped(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        let limits = self.robot.limits();
        SVector::from_fn(|i, _| q[i].max(limits[i].lower).min(limits[i].upper))
    }
}

/// The joint that is nearest to a limit in `q`, relative to its range: its index, and its distance from the limit, rad or m. `None` for an arm
/// without joint limits.
#[must_use]
pub fn nearest_limit(robot: &RobotDescription, q: &[f64]) -> Option<(usize, f64)> {
    let bounded =
        robot.joints.iter().zip(q).enumerate().filter(|(_, (j, _))| j.kind != JointKind::Continuous);
    let room = bounded.map(|(i, (joint, q))| {
        let (low, high) = (joint.limits.lower, joint.limits.upper);
        let room = (q - low).min(high - q);
        (i, room, room / (high - low))
    });
    room.min_by(|(.., a), (.., b)| a.total_cmp(b)).map(|(i, room, _)| (i, room))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<const N: usize>(arm: &str, X_EC: Pose) -> (usize, usize) {
        let robot = crate::robot::load(arm).unwrap().build::<N>().unwrap();
        let mount = Mount::EyeInHand { X_EC };
        let search = PostureSearch { robot: &robot, mount: &mount };
        let (mut random, mut reached, count) = (Random::new(7), 0, 60);
        for _ in 0..count {
            let wanted = search.X_WC(&search.anywhere(&mut random));
            let there = (0..40).any(|_| {
                let q = search.towards(&search.anywhere(&mut random), &wanted);
                assert!(robot.outside_limits(&q).is_none(), "{arm}: {q}");
                let off = search.X_WC(&q).inv_mul(&wanted);
                off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6
            });
            reached += usize::from(there);
        }
        (reached, count)
    }

    /// What some posture reaches is found from a few starts elsewhere.
    #[test]
    fn postures_are_found_again() {
        let X_EC = Pose::translation(0.0, 0.0, 0.05);
        for (arm, (reached, count)) in [
            ("scara", check::<4>("scara", X_EC)),
            ("pan_tilt", check::<2>("pan_tilt", X_EC)),
            ("ur5", check::<6>("ur5", X_EC)),
            ("panda", check::<7>("panda", X_EC)),
            ("xarm7", check::<7>("xarm7", X_EC)),
        ] {
            assert_eq!(reached, count, "{arm}");
        }
    }
}
