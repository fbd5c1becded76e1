//! The camera from a board whose pose is known: (10.62), (10.63), view by view, and whether the views agree with that pose.

use super::joint::{JointFit, RobotSd};
use super::scatter::{ClosedFormCamera, LoopScatter, board, deviation};
use super::{LoopSample, camera_in_base};
use crate::geometry::{Pose, closest_rotation};
use crate::linalg::Ldlt;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Squared distance, in standard deviations, beyond which the views contradict the board's pose. Derived: with six degrees of freedom chance passes
/// it once in 10 000 calibrations.
const CONTRADICTED: f64 = 27.86;

/// The camera in the frame that bears it, as each view by itself has it with the board at `X_WO`: `X_MC = X_WM^-1 X_WO X_CO^-1`.
///
/// Beside the arm M is the base, and the board in it is `X_BO = X_BE X_EO`, (10.62); in the hand M is the flange, and the board in it is
/// `X_EO = X_BE^-1 X_BO`, (10.63): the same line.
pub fn cameras_by_known_board<'a>(
    samples: &'a [LoopSample],
    X_WO: &'a Pose,
) -> impl Iterator<Item = Pose> + 'a {
    samples.iter().map(move |sample| camera_in_base(&sample.X_WM.inv_mul(X_WO), &sample.X_CO))
}

/// Their mean: positions, and the rotation nearest to the mean of the matrices. `None` without views.
pub(super) fn by_known_board(samples: &[LoopSample], X_WO: &Pose) -> Option<ClosedFormCamera> {
    let (mut turn, mut place) = (Matrix3::zeros(), Vector3::zeros());
    for X_MC in cameras_by_known_board(samples, X_WO) {
        turn += X_MC.rotation.to_rotation_matrix().matrix();
        place += X_MC.translation.vector;
    }
    let R = UnitQuaternion::from_rotation_matrix(&closest_rotation(&turn)?);
    let X_MC = Pose::from_parts(Translation3::from(place / samples.len().max(1) as f64), R);
    let scatter = scatter_about(samples, &X_MC, X_WO);
    (!samples.is_empty()).then_some(ClosedFormCamera {
        method: "known board, mean of the views",
        X_MC,
        scatter,
    })
}

/// How far the board's places by the single views lie from `X_WO`.
pub(super) fn scatter_about(samples: &[LoopSample], X_MC: &Pose, X_WO: &Pose) -> LoopScatter {
    let places: Vec<Pose> = samples.iter().map(|sample| board(sample, X_MC)).collect();
    let (rotation_rad, position_m) = deviation(&places, X_WO);
    LoopScatter { X_WO: *X_WO, rotation_rad, position_m }
}

/// Where the views by themselves have a board whose pose was said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardAsSeen {
    /// The board in W, by the views alone.
    pub X_WO: Pose,
    /// How far that lies from where it was said to be, m.
    pub position_m: f64,
    /// How it is turned against that, rad.
    pub rotation_rad: f64,
    /// The same squared, in standard deviations of what the views alone have: chi-square of six degrees of freedom if both are the same.
    pub chi_square: f64,
    /// Deviations of the robot's poses that the views ask for where the board's pose is free.
    pub robot_seen: RobotSd,
}

impl BoardAsSeen {
    /// `stated`: where the board was said to be; `by_views`: the fit without that. `None` where the fit has no covariance.
    pub(super) fn of(stated: &Pose, by_views: &JointFit, robot_seen: RobotSd) -> Option<Self> {
        let X_WO = by_views.X_WO;
        let v = X_WO.translation.vector - stated.translation.vector;
        let w = (X_WO.rotation * stated.rotation.inverse()).scaled_axis();
        let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
        let solved = Vector6::from(Ldlt::of(&by_views.covariance_X_WO)?.solve(&d.into()));
        Some(Self {
            X_WO,
            position_m: v.norm(),
            rotation_rad: w.norm(),
            chi_square: d.dot(&solved),
            robot_seen,
        })
    }

    /// Whether the views have the board elsewhere than it was said to be, beyond what chance explains.
    #[must_use]
    pub fn is_contradicted(&self) -> bool {
        self.chi_square > CONTRADICTED
    }

    /// The distance in standard deviations of one of the six numbers.
    #[must_use]
    pub fn times_sd(&self) -> f64 {
        (self.chi_square / 6.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{SimulatedCell, camera, gap};
    use super::super::{CameraMount, HandEyeError, HandEyeSettings, RobotSd, calibrate_hand_eye};
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Matrix6;

    const PLACES: [CameraMount; 2] = [CameraMount::EyeInHand, CameraMount::EyeToHand];

    #[test]
    fn one_view_is_enough_and_exact() {
        for (seed, place) in (1..=20).flat_map(|seed| PLACES.map(|place| (seed, place))) {
            let mut random = Random::new(seed);
            let cell = SimulatedCell::new(place, &mut random);
            for count in [1, 2, 5] {
                let views = cell.views(count, &mut random);
                let settings = HandEyeSettings { X_WO: Some(cell.X_WO), ..HandEyeSettings::of(place) };
                let report = calibrate_hand_eye(&views, &camera(), &settings).unwrap();
                let off = gap(&report.X_MC(), &cell.X_MC);
                assert!(off < 1e-9, "{place:?} {count}: {off:e}");
                assert!(gap(&report.closed_forms[0].X_MC, &cell.X_MC) < 1e-9);
                assert!(gap(&report.fit.X_WO, &cell.X_WO) < 1e-14 && !report.is_contradicted());
                assert_eq!(report.fit.covariance_X_WO, Matrix6::zeros());
                assert_eq!(report.held_out.is_some(), count > 1);
                assert_eq!(report.verdict.contains("One view"), count == 1, "{}", report.verdict);
            }
        }
    }

    #[test]
    fn without_views_there_is_none() {
        let settings =
            HandEyeSettings { X_WO: Some(Pose::identity()), ..HandEyeSettings::of(CameraMount::EyeInHand) };
        let refused = calibrate_hand_eye(&[], &camera(), &settings);
        assert_eq!(refused, Err(HandEyeError::TooFewViews { given: 0, needed: 1 }));
        assert!(by_known_board(&[], &Pose::identity()).is_none());
    }

    /// The covariance of the camera's pose is that of its errors, of one view and of several: chi-square has its mean.
    #[test]
    fn the_covariance_of_a_known_board_is_honest() {
        for (count, place) in [1, 4].into_iter().flat_map(|count| PLACES.map(|place| (count, place))) {
            let mut random = Random::new(77);
            let draws = 200;
            let mut sum = 0.0;
            for _ in 0..draws {
                let mut cell = SimulatedCell::new(place, &mut random);
                cell.corner_sd_px = 0.1;
                cell.robot = RobotSd { rotation_rad: 5e-4, translation_m: 2e-4 };
                let views = cell.views(count, &mut random);
                let settings = HandEyeSettings {
                    X_WO: Some(cell.X_WO),
                    robot: cell.robot,
                    ..HandEyeSettings::of(place)
                };
                let fit = calibrate_hand_eye(&views, &camera(), &settings).unwrap().fit;
                let v = fit.X_MC.translation.vector - cell.X_MC.translation.vector;
                let w = (fit.X_MC.rotation * cell.X_MC.rotation.inverse()).scaled_axis();
                let d = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
                sum += d.dot(&Vector6::from(Ldlt::of(&fit.covariance_X_MC).unwrap().solve(&d.into())));
            }
            let mean = sum / f64::from(draws) / 6.0;
            // one standard deviation of the mean is 4 %
            assert!((0.8..1.25).contains(&mean), "{place:?} {count}: {mean}");
        }
    }

    /// A board that is 5 mm from where it is said to be is told from views that turn, and is not from one.
    #[test]
    fn a_board_that_lies_elsewhere_is_told() {
        let mut random = Random::new(5);
        let mut cell = SimulatedCell::new(CameraMount::EyeInHand, &mut random);
        cell.corner_sd_px = 0.1;
        let views = cell.views(8, &mut random);
        let run = |X_WO: Pose, count: usize| {
            let settings = HandEyeSettings { X_WO: Some(X_WO), ..HandEyeSettings::of(cell.place) };
            calibrate_hand_eye(&views[..count], &camera(), &settings).unwrap()
        };
        let off = Pose::translation(3e-3, -4e-3, 0.0) * cell.X_WO;
        let told = run(off, 8);
        let board = told.board_as_seen.unwrap();
        assert!(told.is_contradicted() && (board.position_m - 5e-3).abs() < 1e-3, "{board:?}");
        assert!(told.verdict.contains("The views contradict the board's pose"), "{}", told.verdict);
        assert!(!told.verdict.contains("Images and robot contradict"), "{}", told.verdict);
        let right = run(cell.X_WO, 8);
        assert!(!right.is_contradicted() && right.verdict.contains("within what they leave open"));
        let one = run(off, 1);
        assert!(!one.is_contradicted() && (gap(&one.X_MC(), &cell.X_MC) - 5e-3).abs() < 5e-4);
    }
}
