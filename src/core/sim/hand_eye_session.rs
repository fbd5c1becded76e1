//! An arm that visits views of a board, and what is seen in each when it has come to rest: the views of a hand-taker calibration.
//!
//! ```text
//! Moment::Tick: q, qd measured ─► at rest? ─┐
//! Moment::Frame: pixels ─► corners ─────────┴─► twice the same image at rest ─► a view, once for each rest
//! ```
//! The arm is where its encoders and the robot's model say; where the camera really sits does not enter.

use super::system::{Moment, SimError, SystemRun, simulate_system};
use crate::calibration::hand_eye::{
    BoardCorner, HandEyeView, corner_speed_px_s, flange_speed_px_s, is_settled,
};
use crate::config::Config;
use crate::detect::Detection;
use crate::geometry::{Pose, Twist};
use crate::messages::JointState;
use crate::robot::{ExpressedIn, Robot};
use crate::time::{MonoNs, SpanNs};
use crate::vision::{Vision, VisionSettings};
use nalgebra::SVector;
use std::ops::ControlFlow;

/// The arm must have been at rest for this time before an image counts.
const REST: SpanNs = SpanNs(250_000_000);
/// Standard deviation that is allowed for errors of lens and board before a corner is left out, px.
const MODEL_SD_PX: f64 = 2.0;
/// Smallest standard deviation of a corner, px. Chosen by hand: a smaller
/// one would let a few corners dominate the weighted fit.
const MIN_SD_PX: f64 = 0.01;

/// Runs the tour of `config`, whose task must be `calibrate_hand_eye`, in simulated time; the run, and a view for each rest in which
/// the board was seen.
///
/// # Errors
/// As for [`simulate_system`].
pub fn look_around(config: &Config) -> Result<(SystemRun, Vec<HandEyeView>), SimError> {
    let mut taker = ViewTaker {
        config,
        vision: Vision::new(
            config.camera.model,
            config.target.clone(),
            VisionSettings { model_sd_px: MODEL_SD_PX, track: false, ..config.vision },
        ),
        arm: None,
        at_rest_since: None,
        before: None,
        taken: false,
        views: Vec::new(),
    };
    let run = crate::dispatch_robot!(config.robot, |robot| {
        simulate_system(config, &mut |moment| {
            match moment {
                Moment::Tick(trace, _) => taker.note(&robot, &trace.joint_state),
                Moment::Frame(_, image) => taker.look(image),
                Moment::Seen(_) => {}
            }
            ControlFlow::Continue(())
        })
    })??;
    Ok((run, taker.views))
}

/// What looks.
struct ViewTaker<'a> {
    config: &'a Config,
    vision: Vision,
    /// The flange, and when it was there.
    arm: Option<(Pose, Twist, MonoNs)>,
    at_rest_since: Option<MonoNs>,
    /// What was found in the image before, and when.
    before: Option<(Vec<Detection>, MonoNs)>,
    /// This rest has its view.
    taken: bool,
    views: Vec<HandEyeView>,
}

impl ViewTaker<'_> {
    /// Notes where the arm is, and whether it rests by the velocities that it measures.
    fn note<const N: usize>(&mut self, robot: &Robot<N>, state: &JointState) {
        let of =
            |numbers: &[f64]| SVector::<f64, N>::from_fn(|i, _| numbers.get(i).copied().unwrap_or_default());
        let (q, qd) = (of(&state.q), of(&state.qd));
        let (X_BE, J) = robot.forward_and_jacobian_of_frame(&q, &Pose::identity(), ExpressedIn::Moving);
        let V_BE_E: Twist = J * qd;
        self.arm = Some((X_BE, V_BE_E, state.stamp));
        if is_settled(flange_speed_px_s(&self.config.camera.model, &V_BE_E, self.nearest_m())) {
            self.at_rest_since.get_or_insert(state.stamp);
        } else {
            (self.at_rest_since, self.before, self.taken) = (None, None, false);
        }
    }

    /// A board this near moves the fastest in the image.
    fn nearest_m(&self) -> f64 {
        let plate = self.config.target.plate();
        let size_m = (plate.high_m - plate.low_m).norm();
        let i = self.config.camera.model.intrinsics();
        // it fills the image at the least
        size_m * i.fx_px.max(i.fy_px) / f64::from(i.width_px).hypot(f64::from(i.height_px))
    }

    /// Takes a view where the arm rests, and the image with it.
    fn look(&mut self, image: &crate::imaging::ImageView<'_>) {
        let (Some((X_BE, V_BE_E, now)), Some(since)) = (self.arm, self.at_rest_since) else { return };
        if self.taken || now - since < REST {
            return;
        }
        let Ok(still) = self.vision.process_image(image) else { return };
        let found = still.found.to_vec();
        let steady = self.before.as_ref().is_some_and(|(before, then)| {
            corner_speed_px_s(before, &found, (now - *then).as_s()).is_some_and(is_settled)
        });
        if steady {
            let points = self.config.target.points();
            let corners: Vec<_> = still
                .found
                .iter()
                .zip(still.px)
                .filter_map(|(found, px)| {
                    let p_O = points.iter().find(|point| point.id == found.id)?.p_O;
                    Some(BoardCorner { p_O, px: *px, sd_px: found.sd_px.max(MIN_SD_PX) })
                })
                .collect();
            if corners.len() >= 4 {
                let name = format!("view {}", self.views.len() + 1);
                self.views.push(HandEyeView { name, X_BE, V_BE_E: Some(V_BE_E), corners });
                self.taken = true;
            }
        }
        self.before = Some((found, now));
    }
}
