//! What a hand-eye calibration found, in numbers.

use super::known_board::BoardAsSeen;
use super::leave_one_out::{HeldOut, rms_px};
use super::observability::RotationSpread;
use super::rows::{ArmAt, ViewRows};
use super::scatter::{ClosedFormCamera, LoopScatter};
use super::{CameraMount, HandEyeView, JointFit, JointSettings, LoopSample, RobotSd};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, Twist};
use crate::pose::chained_covariance;
use nalgebra::{Matrix6, Rotation3, Vector3};
use std::fmt::Write;

/// One view, seen after the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewResidual {
    /// Its name.
    pub name: String,
    /// Whether it took part.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// How fast its image moved, px/s, where velocities are stated.
    pub speed_px_s: Option<f64>,
    /// Distance of its corners from where the calibration has them with the pose that the robot stated, root mean square, px.
    pub rms_px: Option<f64>,
    /// The same with the corrected pose.
    pub rms_corrected_px: Option<f64>,
    /// The correction's length, m.
    pub correction_m: Option<f64>,
    /// Its angle, rad.
    pub correction_rad: Option<f64>,
}

impl ViewResidual {
    pub(super) fn new(view: &HandEyeView, speed_px_s: Option<f64>, moving: Option<f64>) -> Self {
        Self {
            name: view.name.clone(),
            used: moving.is_none(),
            reason: moving.map(|speed| format!("taken in motion: the image moves at {speed:.0} px/s")),
            speed_px_s,
            rms_px: None,
            rms_corrected_px: None,
            correction_m: None,
            correction_rad: None,
        }
    }
}

/// What the camera's uncertainty is where it works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtDistance {
    /// Mean distance of the board's centre along the optical axis, m.
    pub distance_m: f64,
    /// Standard deviation of where an object at that distance is thought to be, by the camera's pose alone: root of the sum over the
    /// axes, m.
    pub position_m: f64,
    /// Of how it is thought to be turned, rad, likewise.
    pub rotation_rad: f64,
    /// Of the camera's position in its bearer, m, likewise.
    pub camera_m: f64,
}

/// A calibration, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEyeReport {
    /// Where the camera is.
    pub place: CameraMount,
    /// The joint refinement.
    pub fit: JointFit,
    /// The camera by closed forms: from a known board, by rotation first and position then, by dual quaternions; those that the views allow.
    pub closed_forms: Vec<ClosedFormCamera>,
    /// How far the board's places by the single views lie apart, or of a known board how far they lie from it.
    pub scatter: LoopScatter,
    /// Where the board's pose is known and the views determine it too: what they make of it.
    pub board_as_seen: Option<BoardAsSeen>,
    /// Whether the board's pose was known.
    pub known_board: bool,
    /// Each view predicted by the others; `None` with three views (of a known board: one).
    pub held_out: Option<HeldOut>,
    /// Deviations of the robot's poses as stated.
    pub robot_stated: RobotSd,
    /// What they are at least, by the views; as stated where nothing contradicts that.
    pub robot_seen: RobotSd,
    /// How far corners lie from where lens and board have them beyond their own deviations, one standard deviation, px; 0 where those
    /// explain everything.
    pub model_sd_px: f64,
    /// How far the arm turned; `None` with one view.
    pub spread: Option<RotationSpread>,
    /// All views.
    pub views: Vec<ViewResidual>,
    /// Distance of all corners from where the calibration has them with the poses that the robot stated, root mean square, px.
    pub rms_px: f64,
    /// Uncertainty where the camera works.
    pub distance: AtDistance,
    /// All of it in words.
    pub verdict: String,
}

impl HandEyeReport {
    /// The camera in the frame that bears it: `X_EC` in the hand, `X_BC` beside the arm.
    #[must_use]
    pub fn X_MC(&self) -> Pose {
        self.fit.X_MC
    }

    /// Whether images and robot contradict each other: no robot as good as was stated has been at the poses that its file says, by the
    /// camera and the board that were named; or whether they contradict the pose that the board was said to have.
    #[must_use]
    pub fn is_contradicted(&self) -> bool {
        self.is_robot_contradicted() || self.board_as_seen.is_some_and(|board| board.is_contradicted())
    }

    /// Whether images and robot contradict each other, wherever the board is.
    pub(super) fn is_robot_contradicted(&self) -> bool {
        let stated = &self.robot_stated;
        let seen = self.board_as_seen.map_or(self.robot_seen, |board| board.robot_seen);
        seen.translation_m > stated.translation_m || seen.rotation_rad > stated.rotation_rad
    }

    /// The lines of a run file that mount the camera so.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let X = self.X_MC();
        let (roll, pitch, yaw) = Rotation3::from(X.rotation).euler_angles();
        let p = X.translation.vector;
        let kind = match self.place {
            CameraMount::EyeInHand => "eye_in_hand",
            CameraMount::EyeToHand => "eye_to_hand",
        };
        let mut text = String::new();
        for line in self.verdict.lines() {
            let _ = writeln!(text, "# {line}");
        }
        let _ = writeln!(
            text,
            "[camera.mount]\nkind = \"{kind}\"    # {} of vservo calibrate hand-eye\nposition_m = [{:.9}, {:.9}, {:.9}]\n\
             rotation_rpy_rad = [{roll:.9}, {pitch:.9}, {yaw:.9}]",
            self.place.camera_name(),
            p.x,
            p.y,
            p.z
        );
        text
    }

    /// Fills in what the views that took part leave.
    pub(super) fn tell_residuals(
        &mut self,
        used: &[&HandEyeView],
        camera: &CameraModel,
        settings: &JointSettings,
    ) {
        let fit = &self.fit;
        let (mut squares, mut corners) = (0.0, 0.0);
        let taken = self.views.iter_mut().filter(|view| view.used);
        for (((told, view), X_BE), d) in taken.zip(used).zip(&fit.arm).zip(&fit.corrections) {
            let V_BE_E = view.V_BE_E.filter(|_| settings.time_offset).unwrap_or_else(Twist::zeros);
            let rms = |X_BE: &Pose| {
                let arm = ArmAt { place: settings.place, X_BE: *X_BE, V_BE_E };
                rms_px(view, camera, &ViewRows::new(&fit.X_MC, &fit.X_WO, arm, fit.offset_s))
            };
            let stated_px = rms(&view.X_BE);
            told.rms_px = Some(stated_px);
            told.rms_corrected_px = Some(rms(X_BE));
            told.correction_m = Some(d.fixed_rows::<3>(0).norm());
            told.correction_rad = Some(d.fixed_rows::<3>(3).norm());
            squares += stated_px * stated_px * view.corners.len() as f64;
            corners += view.corners.len() as f64;
        }
        self.rms_px = (squares / f64::max(corners, 1.0)).sqrt();
    }
}

/// The camera's uncertainty at the mean distance of the boards.
pub(super) fn at_distance(fit: &JointFit, views: &[&HandEyeView], samples: &[LoopSample]) -> AtDistance {
    let mut sum = 0.0;
    for (view, sample) in views.iter().zip(samples) {
        let middle = view.corners.iter().fold(Vector3::zeros(), |sum, corner| sum + corner.p_O.coords)
            / view.corners.len().max(1) as f64;
        sum += (sample.X_CO.rotation * middle + sample.X_CO.translation.vector).z;
    }
    let distance_m = sum / samples.len().max(1) as f64;
    let ahead = Pose::translation(0.0, 0.0, distance_m);
    let there = chained_covariance(&fit.X_MC, &fit.covariance_X_MC, &ahead, &Matrix6::zeros());
    let root = |C: &Matrix6<f64>, from: usize| C.fixed_view::<3, 3>(from, from).trace().max(0.0).sqrt();
    AtDistance {
        distance_m,
        position_m: root(&there, 0),
        rotation_rad: root(&there, 3),
        camera_m: root(&fit.covariance_X_MC, 0),
    }
}
