//! Postures from which an arm looks at the board to find out where its camera sits: the board in view, wide turns about all axes.
//!
//! ```text
//! where the board is now ─► views of it, tilted to all sides and rolled ─► postures: in range, board well inside the image ─► spread
//! ```
//! The camera's pose is only believed here. So that the board stays in view where it is wrong by some degrees, it must be well inside the
//! image as it is expected. Obstacles are not known: neighbouring views are at the same distance from the board.

use super::{CameraMount, LoopSample, rotation_spread};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, Twist};
use crate::linalg::Ldlt;
use crate::motion::MotionLimits;
use crate::robot::{Mount, Robot};
use nalgebra::{Matrix6, Point3, SVector, UnitQuaternion, Vector3};
use thiserror::Error;

/// Number of planned views. Chosen by hand: the errors fall with the square root of the number, and each view takes some seconds.
const VIEWS: usize = 14;
/// Fewest views of a tour. Chosen by hand: three determine the mount, and the rest tell its uncertainty.
const LEAST: usize = 6;
/// Rotation about the second axis that a tour must have, rad, so that both axes of rotation are observable.
const MIN_ACROSS_RAD: f64 = 0.2;
/// Tilt and roll of the widest views, rad. Chosen by hand: boards are found at a tilt of 26 degrees, and larger rotations improve the result.
const TILT_RAD: f64 = 0.45;
const ROLL_RAD: f64 = 0.9;
/// Shares of them that are tried, until one is within reach. Chosen by hand: below a third of the tilt a view adds little.
const SHARES: [f64; 4] = [1.0, 0.75, 0.5, 0.3];
/// Margin between the board and the border of the image, as a share of the image's width. Chosen by hand: the true mount may differ from the nominal one.
const BORDER: f64 = 0.1;
/// Share of a joint's range that is kept free at each end. Chosen by hand: so near to the end the reference slows a joint down, and a view at
/// the very end says no more than one beside it.
const RANGE_SHARE: f64 = 0.03;
/// Accuracy of the inverse kinematics, m and rad, and its steps, largest change of a joint and damping. Chosen by hand: a view may differ from its plan, because
/// the measured postures alone are used.
const REACHED: f64 = 0.02;
const STEPS: usize = 200;
const LONGEST_STEP: f64 = 0.1;
const DAMPING: f64 = 1e-4;

/// Why there is no tour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum TourError {
    /// Too few views are within reach.
    #[error(
        "hand-eye: too few views of the board are within reach: start with the board in the middle of the image and small in it, \
         and with the joints away from the ends of their ranges"
    )]
    TooFewViews,
    /// The arm turns the camera about one axis alone.
    #[error(
        "hand-eye: this arm, from here, turns the camera about one axis only, so that the camera's position along it cannot show"
    )]
    OneAxis,
}

/// What is believed of the cell.
#[derive(Debug, Clone, Copy)]
pub struct TourCell<'a, const N: usize> {
    /// The arm.
    pub robot: &'a Robot<N>,
    /// Where its camera is thought to sit.
    pub mount: &'a Mount,
    /// The lens.
    pub camera: &'a CameraModel,
    /// The board's points in O, m.
    pub points: &'a [Point3<f64>],
    /// Ranges of the joints.
    pub limits: &'a MotionLimits<N>,
}

/// A tour in the making, view by view: each takes up to a millisecond.
#[derive(Debug)]
pub struct TourPlanner<const N: usize> {
    /// Where the tour begins, rad or m, and where the board is seen from there.
    start: SVector<f64, N>,
    X_CO: Pose,
    /// The next view.
    view: usize,
    postures: Vec<SVector<f64, N>>,
    samples: Vec<LoopSample>,
}

impl<const N: usize> TourPlanner<N> {
    /// A tour that begins in `q`, from where the board is seen at `X_CO`.
    #[must_use]
    pub fn new(q: &SVector<f64, N>, X_CO: &Pose) -> Self {
        Self { start: *q, X_CO: *X_CO, view: 0, postures: Vec::new(), samples: Vec::new() }
    }

    /// Looks for the posture of the next view. After the last one: all that were found, rad or m, or why there is no tour.
    pub fn next_view(&mut self, cell: &TourCell<'_, N>) -> Option<Result<Vec<SVector<f64, N>>, TourError>> {
        let X_CO = &self.X_CO;
        let X_WO = cell.X_WC(&self.start) * X_CO;
        let sum = cell.points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords);
        let middle_O = Pose::from(sum / cell.points.len().max(1) as f64);
        let distance_m = (X_CO * middle_O).translation.z;
        let ahead = Pose::translation(0.0, 0.0, distance_m);
        let from = self.postures.last().unwrap_or(&self.start);
        let found = SHARES.iter().find_map(|share| {
            let view =
                ahead * Pose::from_parts(Vector3::zeros().into(), turn(self.view, *share) * X_CO.rotation);
            let wanted_CO = view * middle_O.inverse();
            let q = cell.posture(from, &X_WO, &wanted_CO)?;
            cell.sees_all(&q, &X_WO).then_some(q)
        });
        if let Some(q) = found {
            let X_CO = cell.X_WC(&q).inv_mul(&X_WO);
            self.samples.push(LoopSample { X_WM: cell.place().X_WM(&cell.robot.forward(&q)), X_CO });
            self.postures.push(q);
        }
        self.view += 1;
        (self.view == VIEWS).then(|| self.judged())
    }

    fn judged(&mut self) -> Result<Vec<SVector<f64, N>>, TourError> {
        if self.postures.len() < LEAST {
            return Err(TourError::TooFewViews);
        }
        match rotation_spread(&self.samples) {
            Some(spread) if spread.across_rad > MIN_ACROSS_RAD => Ok(std::mem::take(&mut self.postures)),
            _ => Err(TourError::OneAxis),
        }
    }
}

/// How the board is turned in view `k`: tilted to one side after the other, rolled to and fro.
fn turn(k: usize, share: f64) -> UnitQuaternion<f64> {
    // golden angle: the sides are spread evenly, however many views there are
    let side = 2.4 * k as f64;
    let tilt = TILT_RAD * share * if k.is_multiple_of(3) { 0.6 } else { 1.0 };
    let roll = ROLL_RAD * share * [0.0, 0.5, -0.5, 1.0, -1.0].get(k % 5).copied().unwrap_or_default();
    let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(side.cos(), side.sin(), 0.0) * tilt);
    tilted * UnitQuaternion::from_scaled_axis(Vector3::z() * roll)
}

impl<const N: usize> TourCell<'_, N> {
    fn place(&self) -> CameraMount {
        if self.mount.is_on_arm() { CameraMount::EyeInHand } else { CameraMount::EyeToHand }
    }

    fn X_WC(&self, q: &SVector<f64, N>) -> Pose {
        self.mount.X_WC(self.robot, q)
    }

    /// The posture nearest to `q` that has the board at `wanted_CO`; `None` where none within the ranges does.
    fn posture(&self, q: &SVector<f64, N>, X_WO: &Pose, wanted_CO: &Pose) -> Option<SVector<f64, N>> {
        let wanted_WC = X_WO * wanted_CO.inverse();
        let mut q = *q;
        for _ in 0..STEPS {
            let (X_WC, J) = self.mount.camera(self.robot, &q);
            let off = X_WC.inv_mul(&wanted_WC);
            let (v, w) = (off.translation.vector, off.rotation.scaled_axis());
            let V = Twist::new(v.x, v.y, v.z, w.x, w.y, w.z);
            // A micrometre and a microrad, since the tolerance above is far larger.
            if !(V.amax() > 1e-6) {
                break;
            }
            let J = J.matrix();
            let normal = J * J.transpose() + Matrix6::identity() * DAMPING;
            let solved = Twist::from(Ldlt::of(&normal)?.solve(&V.into()));
            let step = J.transpose() * solved;
            let next = q + step * (LONGEST_STEP / step.amax().max(LONGEST_STEP));
            q = SVector::from_fn(|i, _| {
                let (low, high) = self.range(i);
                next[i].max(low).min(high)
            });
        }
        let off = self.X_WC(&q).inv_mul(&wanted_WC);
        // an arm of few joints cannot turn the camera as it likes
        let turned = N < 6 || off.rotation.angle() < REACHED;
        (off.translation.vector.norm() < REACHED && turned).then_some(q)
    }

    fn range(&self, joint: usize) -> (f64, f64) {
        let (low, high) = (self.limits.lower[joint], self.limits.upper[joint]);
        let free = RANGE_SHARE * (high - low);
        if free.is_finite() { (low + free, high - free) } else { (low, high) }
    }

    /// Whether all points are seen, well inside the image.
    fn sees_all(&self, q: &SVector<f64, N>, X_WO: &Pose) -> bool {
        let X_CO = self.X_WC(q).inv_mul(X_WO);
        let border_px = BORDER * f64::from(self.camera.intrinsics().width_px);
        let inside = |p_O: &Point3<f64>| {
            self.camera.project(&(X_CO * p_O)).is_some_and(|px| self.camera.contains(&px, border_px))
        };
        self.points.iter().all(inside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};

    fn camera() -> CameraModel {
        let intrinsics = Intrinsics {
            fx_px: 800.0,
            fy_px: 800.0,
            cx_px: 320.0,
            cy_px: 240.0,
            width_px: 640,
            height_px: 480,
        };
        CameraModel::new(intrinsics, Distortion::default()).unwrap()
    }

    fn points() -> Vec<Point3<f64>> {
        (0..54).map(|i| Point3::new(f64::from(i % 9) * 0.01, f64::from(i / 9) * 0.01, 0.0)).collect()
    }

    fn planned<const N: usize>(
        cell: &TourCell<'_, N>,
        q: &SVector<f64, N>,
        X_CO: &Pose,
    ) -> Result<Vec<SVector<f64, N>>, TourError> {
        let mut planner = TourPlanner::new(q, X_CO);
        std::iter::repeat_with(|| planner.next_view(cell)).flatten().next().unwrap()
    }

    fn limits<const N: usize>(robot: &Robot<N>) -> MotionLimits<N> {
        MotionLimits::of(robot, SVector::repeat(10.0), SVector::repeat(100.0))
    }

    #[test]
    fn views_are_within_reach_and_turned_to_all_sides() {
        let robot = crate::robot::load("ur5").unwrap().build::<6>().unwrap();
        let limits = limits(&robot);
        let q = SVector::<f64, 6>::from([0.4617, -1.7204, 1.4481, -1.2809, -1.8176, 0.9664]);
        let X_CO = Pose::translation(-0.04, -0.025, 0.35);
        let X_EC = Pose::translation(0.0, 0.0, 0.05);
        // the same views from a camera in the hand and from one beside the arm
        let X_BC = robot.forward(&q) * Pose::translation(0.0, 0.0, 0.4) * Pose::rotation(Vector3::x() * 3.1);
        for (mount, X_CO) in [(Mount::EyeInHand { X_EC }, X_CO), (Mount::EyeToHand { X_BC }, X_CO)] {
            let cell = TourCell {
                robot: &robot,
                mount: &mount,
                camera: &camera(),
                points: &points(),
                limits: &limits,
            };
            let tour = planned(&cell, &q, &X_CO).unwrap();
            assert!(tour.len() >= 8, "{mount:?}: {}", tour.len());
            let X_WO = cell.X_WC(&q) * X_CO;
            let samples: Vec<_> = tour
                .iter()
                .map(|q| {
                    assert!((0..6).all(|i| q[i] >= limits.lower[i] && q[i] <= limits.upper[i]), "{q}");
                    let X_CO = cell.X_WC(q).inv_mul(&X_WO);
                    let seen =
                        |p_O| camera().project(&(X_CO * p_O)).is_some_and(|px| camera().contains(&px, 40.0));
                    assert!(points().into_iter().all(seen), "{X_CO}");
                    LoopSample { X_WM: cell.place().X_WM(&robot.forward(q)), X_CO }
                })
                .collect();
            assert!(rotation_spread(&samples).unwrap().across_rad > 0.3, "{mount:?}");
        }
    }

    #[test]
    fn arms_and_places_that_cannot_are_named() {
        let mount = Mount::EyeInHand { X_EC: Pose::identity() };
        let (camera, points) = (camera(), points());
        let scara = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        let limits_4 = limits(&scara);
        let cell =
            TourCell { robot: &scara, mount: &mount, camera: &camera, points: &points, limits: &limits_4 };
        let q = SVector::<f64, 4>::from([0.0, 1.57, 0.5, -0.7]);
        assert_eq!(planned(&cell, &q, &Pose::translation(-0.04, -0.025, 0.5)), Err(TourError::OneAxis));
        // a board that fills the image has no room
        assert_eq!(planned(&cell, &q, &Pose::translation(-0.04, -0.025, 0.1)), Err(TourError::TooFewViews));
    }
}
