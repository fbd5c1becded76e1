//! Whether the image moves as the arm's motion should make it, judged once, over the first motion.
//!
//! A camera that is mounted turned about its optical axis, by more than a quarter, turns each law away from its goal, and the faster the farther it gets. From the last view
//! before the arm moves, the arm's motion `X` of the believed camera leads to one view, and that of a camera that is turned by `phi` to another:
//!
//! ```text
//! X(phi) = R_z(-phi) X R_z(phi)
//! ```
//! Where one of the latter is seen and the former is not, whatever the depth is, the mount is turned. Errors of lens and stamps, or an object that moves, look like none of them.

use super::{SetPoint, View};
use crate::geometry::Pose;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Displacement of the features at which they are judged, root mean square, normalized coordinates: 8 px of a lens of 800 px, a hundred times the noise of a dot. Chosen by hand.
const JUDGED: f64 = 0.01;
/// Share of it up to which the arm has not moved yet. Chosen by hand.
const STANDS: f64 = 0.25;
/// Displacement from which on it is judged no more, in units of [`JUDGED`]. Chosen by hand: by then a contradiction was seen in several frames.
const GIVEN_UP: f64 = 8.0;
/// Turns that are tried, in a whole one. Chosen by hand: 5 degrees beside the true turn leave 0.8 % of the displacement's square.
const TURNS: u16 = 36;
/// Share of the square of the displacement that may be left where a camera is believed: another is left by turns of 15 degrees. Chosen by hand: that is what a description may be off by, and still be believed.
const EXPLAINED: f64 = 0.06;
/// Depths that are tried with the believed camera, as powers of this of the believed one, and how many on either side: from a seventh to seven times. Chosen by hand: a target that is believed a fifth
/// or five times as large as it is moves the image by its turns otherwise than by its translations, which a turned camera explains better than the believed one with the believed depth.
const DEPTH_STEP: f64 = 1.19;
const DEPTHS: i32 = 11;
/// Share of what the believed camera leaves that a turned one may leave. Chosen by hand.
const BETTER: f64 = 0.1;
/// Least turn that turns a law away, rad. Measured: with 50 degrees UR5, Panda, xArm7 and two of four SCARAs converge, with 90 none does.
const TURNED: f64 = 1.2;

/// Compares the first motion of the image with that of the arm.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionAgreement {
    /// The last view before the arm moved, and where the camera was then.
    base: Option<(View, Pose)>,
    is_judged: bool,
    turn: Option<f64>,
}

impl MotionAgreement {
    /// Takes in a measured view, with the pose of the camera at its exposure in the frame in which the object rests.
    pub(super) fn note(&mut self, view: &View, X_WC: &Pose, set_point: &SetPoint) {
        if self.is_judged {
            return;
        }
        let (base, X_WB) = *self.base.get_or_insert((*view, *X_WC));
        let X_CB = X_WC.inv_mul(&X_WB);
        let Some(FeatureMotion { moved, seen, left }) = feature_motion(&base, &X_CB, view, set_point) else {
            return;
        };
        if moved < STANDS * JUDGED {
            self.base = Some((*view, *X_WC));
            return;
        }
        if moved < JUDGED || seen < JUDGED {
            self.is_judged = moved > GIVEN_UP * JUDGED;
            return;
        }
        // Translations count by their share of the depth.
        let of_depth = |k: i32| {
            let mut X_CB = X_CB;
            X_CB.translation.vector *= DEPTH_STEP.powi(k);
            feature_motion(&base, &X_CB, view, set_point).map_or(left, |motion| motion.left)
        };
        let is_explained = |left: f64| left < EXPLAINED * seen * seen;
        // Mostly the first is.
        let left =
            if is_explained(left) { left } else { (-DEPTHS..=DEPTHS).map(of_depth).fold(left, f64::min) };
        self.is_judged = is_explained(left) || moved > GIVEN_UP * JUDGED;
        if is_explained(left) {
            return;
        }
        let least = (1..TURNS).filter_map(|k| {
            let turn = TAU * f64::from(k) / f64::from(TURNS);
            let Z = Pose::new(Vector3::zeros(), Vector3::z() * turn);
            let motion = feature_motion(&base, &(Z.inv_mul(&X_CB) * Z), view, set_point)?;
            Some((motion.left, turn))
        });
        let best = least.min_by(|(a, _), (b, _)| a.total_cmp(b));
        self.turn = best.and_then(|(turned, turn)| {
            let is_sure = turned < BETTER * left && is_explained(turned);
            (is_sure && (TURNED..=TAU - TURNED).contains(&turn)).then_some(turn)
        });
        self.is_judged |= self.turn.is_some();
    }

    /// By how many quarters the camera is turned about its optical axis against its mount, 1 to 3: then each law leads away from its goal. `None` where it is not.
    pub(super) fn quarters(&self) -> Option<u8> {
        self.turn.map(|turn| ((turn / FRAC_PI_2).round() as u8).clamp(1, 3))
    }
}

/// How the features have moved since another view: mean squares over them, normalized coordinates.
struct FeatureMotion {
    /// How far the camera's motion should have moved them, and how far they have; root mean squares.
    moved: f64,
    seen: f64,
    /// Mean square of the difference.
    left: f64,
}

/// The motion from `base` to `view` beside the one that a camera makes that goes by `X_CB`; `None` without common features.
fn feature_motion(base: &View, X_CB: &Pose, view: &View, set_point: &SetPoint) -> Option<FeatureMotion> {
    let predicted = base.predicted_at(X_CB, set_point)?;
    let (mut moved, mut seen, mut left, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (i, s) in view.seen() {
        if let (Some(before), Some(there)) = (base.feature(i), predicted.feature(i)) {
            moved += (there - before).norm_squared();
            seen += (s - before).norm_squared();
            left += (s - there).norm_squared();
            count += 1.0;
        }
    }
    (count > 0.0).then(|| FeatureMotion {
        moved: (moved / count).sqrt(),
        seen: (seen / count).sqrt(),
        left: left / count,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::perfect_measurement;
    use crate::time::MonoNs;
    use nalgebra::Point3;

    const POINTS: [(f64, f64); 4] = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)];

    /// What is said of a camera that goes by `step` (m) and turns by `turn` (rad) in each of 40 images, and is believed to be turned otherwise about itself
    /// by `wrong`, while the object goes by `away` (m): whether it is judged, and the quarters by which the camera is turned.
    fn judged(step: [f64; 3], turn: [f64; 3], wrong: [f64; 3], away: [f64; 3]) -> (bool, Option<u8>) {
        let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
        let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
        let set_point = SetPoint::from_pose(&goal, &points).unwrap();
        let mount = Pose::new(Vector3::zeros(), wrong.into());
        let mut agreement = MotionAgreement::default();
        for k in 0..40 {
            let by = |a: [f64; 3]| Vector3::from(a) * f64::from(k);
            let camera = Pose::new(by(step), by(turn));
            let object = Pose::new(by(away), Vector3::zeros()) * goal;
            let seen = perfect_measurement(&points, &camera.inv_mul(&object), MonoNs::ZERO).unwrap();
            // The true camera is turned by the opposite against the one that is believed.
            agreement.note(&View::of(&seen, &set_point).unwrap(), &(camera * mount), &set_point);
        }
        (agreement.is_judged, agreement.quarters())
    }

    #[test]
    fn cameras_that_are_mounted_turned_are_told() {
        for (step, turn) in [
            ([0.003, 0.001, 0.0], [0.0; 3]),
            ([-0.001, 0.004, 0.003], [0.0, 0.01, 0.01]),
            ([0.001, 0.001, -0.004], [0.004, -0.01, 0.0]),
        ] {
            for (degrees, quarters) in
                [(-180.0, 2), (-120.0, 1), (-90.0, 1), (90.0, 3), (150.0, 2), (180.0f64, 2)]
            {
                let wrong = [0.0, 0.0, degrees.to_radians()];
                assert_eq!(judged(step, turn, wrong, [0.0; 3]), (true, Some(quarters)), "{degrees} {step:?}");
            }
            for degrees in [-50.0, -20.0, 0.0, 5.0, 40.0, 60.0f64] {
                let wrong = [0.0, 0.0, degrees.to_radians()];
                assert_eq!(judged(step, turn, wrong, [0.0; 3]).1, None, "{degrees} {step:?}");
            }
        }
        assert_eq!(judged([0.0, 0.003, 0.0], [0.0; 3], [0.3, -0.3, 0.2], [0.0; 3]).1, None);
    }

    /// A target that is larger or smaller than it is believed: the way of the camera is another part of its distance.
    #[test]
    fn wrong_depths_are_no_turns() {
        let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
        let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
        let set_point = SetPoint::from_pose(&goal, &points).unwrap();
        for scale in [0.2, 0.5, 2.0, 5.0] {
            for (step, turn) in [
                ([0.003, 0.001, 0.0], [0.0, 0.003, 0.0]),
                ([0.003, 0.001, 0.0], [0.0, -0.006, 0.0]),
                ([-0.001, 0.004, 0.003], [0.01, 0.01, 0.02]),
                ([0.002, 0.002, -0.004], [-0.004, 0.004, 0.0]),
            ] {
                let mut agreement = MotionAgreement::default();
                for k in 0..40 {
                    let by = |a: [f64; 3]| Vector3::from(a) * f64::from(k);
                    let camera = Pose::new(by(step), by(turn));
                    let seen = perfect_measurement(&points, &camera.inv_mul(&goal), MonoNs::ZERO).unwrap();
                    let believed = Pose::new(by(step) * scale, by(turn));
                    agreement.note(&View::of(&seen, &set_point).unwrap(), &believed, &set_point);
                }
                assert_eq!(agreement.quarters(), None, "{scale} {step:?} {turn:?}");
            }
        }
    }

    #[test]
    fn motion_along_the_optical_axis_tells_nothing_of_turns() {
        assert_eq!(judged([0.0, 0.0, 0.004], [0.0, 0.0, 0.01], [0.0, 0.0, 3.0], [0.0; 3]), (true, None));
    }

    #[test]
    fn an_arm_at_rest_and_an_object_that_moves_contradict_nothing() {
        assert_eq!(judged([0.0; 3], [0.0; 3], [0.0; 3], [0.02, 0.0, 0.0]), (false, None));
        assert_eq!(judged([0.001, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.02, 0.0, 0.0]).1, None);
        assert_eq!(judged([0.001, 0.0, 0.0], [0.0, 0.002, 0.0], [0.0; 3], [0.003, 0.02, 0.01]).1, None);
        // Stamps that are late: the image has hardly moved yet.
        assert_eq!(judged([0.01, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0099, 0.0, 0.0]), (true, None));
    }
}
