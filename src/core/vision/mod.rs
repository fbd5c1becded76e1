//! The vision core: a frame in, a [`Measurement`] out.
//!
//! ```text
//! Frame --> Finder (windows, else whole frame) --> centroids --> pose --> centre offsets --> features, pose, covariance
//!             ^ expected points: carried by the arm's known motion, else constant velocity of the last two measurements
//! ```
//! It reads no clock, allocates nothing and returns no errors: the [`TargetStatus`] of a measurement says why there is no target. Detections are accepted
//! only where one pose explains them, see [`VisionSettings::model_sd_px`]. A partly hidden target is tracked as long as its visible points
//! determine the pose: three dots of four, or enough dots of a grid to identify them.
//!
//! # Terms
//!
//! | term | meaning |
//! | --- | --- |
//! | frame | One image of a stream, with its header and the stamp of the middle of its exposure ([`Frame`]). |
//! | prior | What is known before the frame is examined: the predicted pose of the object, or of the camera ([`Prior`]). |
//! | tracking, search | Detection in small windows about the predicted points; detection in the whole frame. |
//! | measurement | The record that vision sends for each frame: points with their covariance, pose, status ([`Measurement`]). |
//! | estimate | Points and pose of one frame before they are accepted as a measurement. |
//! | misfit | The reprojection error of the pose, compared with the chi-square distribution that noise alone would give. |
//! | ambiguity | Two poses explain the same points almost equally well, as they do for a distant plane. |
//! | occlusion | A part of the target is hidden in the frame. |
//! | target number | Which target of the run file is looked for: 0 is `[target]`, `[targets.NAME]` follow in the order of their names ([`TargetSet`]). |
//! | pair | Two frames of a left and a right camera with the same exposure stamp, within a tolerance ([`Pairing`]). |
//!
//! # Example
//!
//! ```
//! # use vservo_core as vservo;
//! use vservo::camera_model::{CameraModel, Distortion, Intrinsics};
//! use vservo::imaging::ImageView;
//! use vservo::messages::{FrameHeader, TargetStatus};
//! use vservo::target::FourDots;
//! use vservo::vision::{Frame, Prior, Vision, VisionSettings};
//!
//! let lens = Intrinsics { fx_px: 600.0, fy_px: 600.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
//! let camera = CameraModel::new(lens, Distortion::default())?;
//! let mut vision = Vision::new(camera, FourDots::default(), VisionSettings::default());
//!
//! let pixels = vec![200; 640 * 480]; // an empty scene
//! let header = FrameHeader { width_px: 640, height_px: 480, ..FrameHeader::default() };
//! let frame = Frame { header, image: ImageView::new(&pixels, 640, 480)? };
//! let measurement = vision.process(&frame, &Prior::default());
//! assert_ne!(measurement.target_status(), TargetStatus::Found);
//! assert!(measurement.pose().is_none() && measurement.features().is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//! `examples/pose.rs` measures a rendered target and compares the pose with its truth.

mod carrier;
mod expectation;
mod frame_estimate;
mod image_result;
mod mirrored;
mod misfit;
mod noise_level;
mod pose_approach;
mod readout_motion;
mod steady_misfit;
mod stereo;
mod target_choice;
mod target_set;

use crate::camera_model::{CameraModel, Response};
use crate::detect::{Detection, Finder, PredictedPoint};
use crate::faults::MeasurementFaults;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::messages::{FrameHeader, Measurement, TargetStatus, frame_flag};
use crate::target::Target;
use crate::time::MonoNs;
pub use carrier::{ArmCarrier, Carrier};
use frame_estimate::{FrameEstimate, PoseEstimator};
pub use image_result::ImageResult;
use mirrored::MirroredSearch;
pub use misfit::Growth;
use noise_level::{NoiseLevel, may_be_noise};
pub use pose_approach::PoseApproach;
use steady_misfit::{Errors, SteadyMisfit};
pub use stereo::{
    Match, ObjectPose, Pairing, PairingCounts, Side, SpacePoint, StereoMeasurement, StereoRig, StereoVision,
    TaughtPoint, TaughtView, TaughtViewError,
};
pub use target_choice::TargetChoice;
pub use target_set::TargetSet;

/// While a part of the target is hidden, the whole frame is searched in one of so many frames. Chosen by hand: at 25 Hz a point that
/// reappears is found within 0.2 s, and the mean cost rises by a fifth of a search.
const SEARCH_AGAIN: u32 = 5;

/// A frame as the camera published it: header and 8-bit grey image.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Stamps, number and size.
    pub header: FrameHeader,
    /// The image.
    pub image: ImageView<'a>,
}

/// What is known of the scene before the frame is processed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Prior {
    /// Predicted pose of the object in the camera at the frame's exposure. `None`: it is predicted by `X_WC`.
    pub predicted_X_CO: Option<Pose>,
    /// Pose of the camera at the frame's exposure, in a frame W in which the object hardly moves ([`Carrier`]). `None`: the last two
    /// measurements are extrapolated in the image.
    pub X_WC: Option<Pose>,
}

/// Settings of vision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisionSettings {
    /// Whether to look in predicted windows first; otherwise every frame is searched as a whole.
    pub track: bool,
    /// Error of a prediction for which a window allows, px, in addition to a share of the motion since the last frame.
    pub slack_px: f64,
    /// Two poses count as ambiguous when the worse one's error, in standard deviations of the features,
    /// exceeds the better one's by less than this.
    pub ambiguity_sds: f64,
    /// Model error: standard deviation of each coordinate, px, by which lens and target differ from their description. It is added to the variance of
    /// the points when the misfit is checked, and is not part of any stated deviation.
    pub model_sd_px: f64,
    /// Which way the pose is found. Whether one pose explains the dots at all is judged by the one of least reprojection error, whichever is told.
    pub pose: PoseApproach,
    /// Whether the lens is known, at least coarsely: then what is far from a view of a square is none of four dots.
    pub lens_is_known: bool,
    /// The camera's response, for which images were made linear as far as it is known.
    pub response: Response,
}

impl Default for VisionSettings {
    fn default() -> Self {
        Self {
            track: true,
            slack_px: 3.0,
            ambiguity_sds: 3.0,
            model_sd_px: 0.0,
            pose: PoseApproach::Both,
            lens_is_known: true,
            response: Response::Linear,
        }
    }
}

/// An accepted estimate with the time of its exposure.
#[derive(Debug, Clone)]
struct TrustedEstimate {
    exposure: MonoNs,
    /// Pose of the camera at that exposure.
    X_WC: Option<Pose>,
    estimate: FrameEstimate,
}

impl TrustedEstimate {
    /// Pose of an object at rest, as estimated here, in a camera at `X_WC`.
    fn carried(&self, X_WC: Option<&Pose>) -> Option<Pose> {
        Some(X_WC?.inv_mul(&self.X_WC?) * self.estimate.pose.as_ref()?.X_CO)
    }
}

/// Measures the target in frame after frame.
#[derive(Debug, Clone)]
pub struct Vision {
    estimator: PoseEstimator,
    finder: Finder,
    /// Estimates from the present frame: in windows, and in the whole frame.
    tracked: FrameEstimate,
    searched: FrameEstimate,
    /// The last accepted estimate, and the one before it; none after the target was lost.
    last: Option<TrustedEstimate>,
    before: Option<TrustedEstimate>,
    /// Unused buffers of estimates.
    spare: Vec<FrameEstimate>,
    expected: Vec<PredictedPoint>,
    /// Detections whose rims are examined, and the ids of those that are partly occluded.
    examined: Vec<Detection>,
    harmed: Vec<u32>,
    /// Misfit that stays from frame to frame, and room for the reprojection errors of the present one.
    misfit: SteadyMisfit,
    errors: Errors,
    /// Scatter of the points from frame to frame that the finder does not state.
    noise: NoiseLevel,
    /// Number of frames for which a part of the target has been hidden.
    hidden_for: u32,
    mirrored: MirroredSearch,
    lost: u64,
    /// What is put wrong about its measurements on purpose.
    faults: Option<MeasurementFaults>,
}

impl Vision {
    /// Why the last frame that was searched has no measurement, in words: of tags of other ids, which.
    #[must_use]
    pub fn missed_in_words(&self, status: TargetStatus) -> String {
        self.finder.missed_in_words(status).unwrap_or_else(|| status.as_str().into())
    }

    /// Vision for one camera and target. Allocates all buffers; [`Self::process`] allocates nothing.
    #[must_use]
    pub fn new(camera: CameraModel, target: impl Into<Target>, settings: VisionSettings) -> Self {
        let target = target.into();
        let count = target.points().len();
        let estimate = || FrameEstimate::with_room_for(count);
        let finder = Finder::new(camera, &target).for_response(&settings.response);
        Self {
            finder: if settings.lens_is_known { finder } else { finder.for_unknown_lens() },
            tracked: estimate(),
            searched: estimate(),
            last: None,
            before: None,
            spare: vec![estimate(), estimate()],
            expected: Vec::with_capacity(count),
            examined: Vec::with_capacity(count),
            harmed: Vec::with_capacity(count),
            misfit: SteadyMisfit::with_room_for(count),
            errors: Vec::with_capacity(count),
            noise: NoiseLevel::with_room_for(count),
            hidden_for: 0,
            mirrored: MirroredSearch::with_room_for(&camera),
            lost: 0,
            faults: None,
            estimator: PoseEstimator::new(camera, target, settings),
        }
    }

    /// Standard deviation of each coordinate, px, by which points scatter from frame to frame beside what their finder states; 0 where that explains what is seen.
    #[must_use]
    pub fn unstated_noise_px(&self) -> f64 {
        self.noise.unstated_px2().sqrt()
    }

    /// What was seen so far says nothing about the next frame: another target was looked for meanwhile.
    fn begin_anew(&mut self) {
        self.forget_frames();
        self.hidden_for = 0;
    }

    /// The next frame is compared with none before it.
    fn forget_frames(&mut self) {
        self.misfit.interrupt();
        self.noise.interrupt();
        self.spare.extend(self.last.take().map(|seen| seen.estimate));
        self.spare.extend(self.before.take().map(|seen| seen.estimate));
    }

    /// The same with faults of its measurements.
    #[must_use]
    pub fn with_faults(self, faults: MeasurementFaults) -> Self {
        Self { faults: Some(faults), ..self }
    }

    /// The model of the camera.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.estimator.camera
    }

    /// The target that is looked for.
    #[must_use]
    pub fn target(&self) -> &Target {
        &self.estimator.target
    }

    /// Measures the target in one frame; the status of the measurement says why it was not found. All fields are filled except `vision_start`, `vision_end`,
    /// `frames_received` and `frames_dropped`, which belong to the process around.
    pub fn process(&mut self, frame: &Frame<'_>, prior: &Prior) -> Measurement {
        let header = &frame.header;
        let carried = || self.last.as_ref()?.carried(prior.X_WC.as_ref());
        let prior = &Prior { predicted_X_CO: prior.predicted_X_CO.or_else(carried), ..*prior };
        let mut m = Measurement {
            frame_id: header.frame_id,
            exposure: header.exposure,
            frame_sent: header.sent,
            camera: header.camera,
            flags: header.flags & frame_flag::LAST,
            ..Measurement::default()
        };
        match self.find(frame, prior) {
            Ok(whole) => {
                let rms_px = if whole { self.searched.rms_px } else { self.tracked.rms_px };
                if let Some(whole) = self.accepted(whole, frame, prior) {
                    self.mirrored.found();
                    let estimate = if whole { &self.searched } else { &self.tracked };
                    self.estimator.fill(estimate, !whole, &mut m);
                    self.keep(header.exposure, prior.X_WC, whole);
                } else {
                    // The target is visible, but no pose explains it: the last accepted estimate is kept for the prediction.
                    m.status = TargetStatus::Inconsistent as u32;
                    m.reprojection_rms_px = rms_px;
                }
            }
            Err(status) => {
                m.status = self.why_missed(status, frame) as u32;
                self.lost += u64::from(self.last.is_some());
                self.forget_frames();
            }
        }
        m.target_lost = self.lost;
        if let Some(faults) = &mut self.faults {
            faults.apply(&mut m);
        }
        m
    }

    /// Tracks the target in the predicted windows, and searches the whole frame where fewer points than before were tracked.
    /// Returns whether the estimate of the search is the one to use.
    fn find(&mut self, frame: &Frame<'_>, prior: &Prior) -> Result<bool, TargetStatus> {
        let i = self.estimator.camera.intrinsics();
        if (frame.image.width(), frame.image.height()) != (i.width_px as usize, i.height_px as usize) {
            return Err(TargetStatus::WrongSize);
        }
        let (mut in_windows, mut believed) = (false, false);
        if self.estimator.settings.track && self.expect(frame.header.exposure, prior) {
            let last = self.last.as_ref().map(|seen| &seen.estimate);
            in_windows = self.finder.track(&frame.image, &self.expected, &mut self.tracked.dots);
            if let Some(faults) = &self.faults {
                faults.disturb(0, frame.header.frame_id, &mut self.tracked.dots);
            }
            if in_windows {
                self.estimator.describe(&mut self.tracked, &self.finder, prior, last, &self.expected);
                believed = self.estimator.believes(&self.tracked);
                let (seen, all) = (self.tracked.dots.len(), self.estimator.target.points().len());
                self.hidden_for = if seen < all { self.hidden_for.saturating_add(1) } else { 0 };
                let as_before = seen >= last.map_or(0, |last| last.dots.len());
                let search_again = seen < all && (seen <= 3 || self.hidden_for.is_multiple_of(SEARCH_AGAIN));
                if believed && as_before && !search_again {
                    return Ok(false);
                }
            }
        }
        match self.search(frame) {
            Ok(()) => {
                let last = self.last.as_ref().map(|seen| &seen.estimate);
                self.estimator.describe(&mut self.searched, &self.finder, prior, last, &[]);
                let better = self.searched.dots.len() > self.tracked.dots.len();
                Ok(!believed || better && self.estimator.believes(&self.searched))
            }
            // perhaps something else was in the windows, or a part of the target is hidden
            Err(_) if in_windows => Ok(false),
            Err(status) => Err(status),
        }
    }

    /// Searches the whole frame.
    fn search(&mut self, frame: &Frame<'_>) -> Result<(), TargetStatus> {
        self.finder.search(&frame.image, &mut self.searched.dots)?;
        if let Some(faults) = &self.faults {
            faults.disturb(0, frame.header.frame_id, &mut self.searched.dots);
        }
        Ok(())
    }

    /// Why there is no target, where the search says `status`: whether frames are mirrored is looked at as long as the target was never found.
    fn why_missed(&mut self, status: TargetStatus, frame: &Frame<'_>) -> TargetStatus {
        let Self { mirrored, finder, searched, estimator, .. } = self;
        mirrored.look(status, &frame.image, |image| {
            finder.search(image, &mut searched.dots).is_ok() && {
                estimator.describe(searched, finder, &Prior::default(), None, &[]);
                estimator.believes(searched)
            }
        })
    }

    /// Which estimate of the frame is accepted: the one of the search (true), that in the windows (false), or none. `whole`: the one that is proposed.
    fn accepted(&mut self, whole: bool, frame: &Frame<'_>, prior: &Prior) -> Option<bool> {
        let proposed = if whole { &self.searched } else { &self.tracked };
        let fits = self.estimator.believes(proposed);
        let whole = whole || !fits;
        if !fits {
            // All points count: a model error makes all of them uncertain, and leaving out some hides it.
            self.search(frame).ok()?;
            self.describe_all(prior);
        }
        let estimate = if whole { &self.searched } else { &self.tracked };
        if estimate.dots.len() < 4 {
            self.misfit.interrupt();
            return fits.then_some(whole);
        }
        let has_whole_rims = self.learn_noise(whole, frame, prior);
        let estimate = if whole { &mut self.searched } else { &mut self.tracked };
        if self.estimator.believes(estimate) && !self.misfit.is_known() {
            self.misfit.interrupt();
            // Noise may hide what lies over the target's points.
            return has_whole_rims.then_some(whole);
        }
        let variance_px2 = estimate.variance_px2() + self.noise.unstated_px2();
        let follows = self.misfit.note(&self.errors, variance_px2);
        if !(follows && self.estimator.believes(estimate)) {
            if !PoseEstimator::is_undisturbed(estimate) || !self.misfit.is_steady(estimate.extent_px()) {
                return None;
            }
            // What lies still over the target's points leaves steady errors, too.
            if !has_whole_rims {
                return None;
            }
        }
        self.misfit.accept(variance_px2);
        self.estimator.allowance_px = self.misfit.allowance_px();
        Some(whole)
    }

    /// Describes what the search found, without leaving out any point.
    fn describe_all(&mut self, prior: &Prior) {
        let last = self.last.as_ref().map(|seen| &seen.estimate);
        self.estimator.describe_all(&mut self.searched, &self.finder, prior, last);
    }

    /// Takes in the reprojection errors of an estimate, of which noise is learnt where nothing else is seen to be wrong. Whether nothing lies over the target's points, which
    /// is looked at where they do not fit as they are stated.
    fn learn_noise(&mut self, whole: bool, frame: &Frame<'_>, prior: &Prior) -> bool {
        let estimate = if whole { &self.searched } else { &self.tracked };
        self.estimator.errors(estimate, &mut self.errors);
        let stated_px2 = estimate.variance_px2();
        let is_undisturbed =
            PoseEstimator::is_undisturbed(estimate) && may_be_noise(&self.errors, estimate.extent_px());
        let has_whole_rims =
            self.estimator.believes_with(0.0, estimate) || self.shows_whole_rims(whole, frame);
        if is_undisturbed && has_whole_rims {
            self.noise.note(&self.errors, stated_px2);
        } else {
            self.noise.disturb();
        }
        let before = std::mem::replace(&mut self.estimator.noise_px2, self.noise.unstated_px2());
        if before == 0.0 && self.estimator.noise_px2 > 0.0 && whole {
            // The covariances contain it.
            self.describe_all(prior);
        }
        has_whole_rims
    }

    /// Whether nothing lies over the target's points of an estimate, which is seen at their rims.
    fn shows_whole_rims(&mut self, whole: bool, frame: &Frame<'_>) -> bool {
        self.examined.clone_from(if whole { &self.searched.dots } else { &self.tracked.dots });
        if let Some(faults) = &self.faults {
            faults.undo_disturb(0, frame.header.frame_id, &mut self.examined);
        }
        self.finder.examine_occlusion(&frame.image, &mut self.examined, &mut self.harmed);
        self.harmed.is_empty()
    }

    /// Makes the estimate of the present frame the last accepted one.
    fn keep(&mut self, exposure: MonoNs, X_WC: Option<Pose>, whole: bool) {
        self.spare.extend(self.before.take().map(|seen| seen.estimate));
        self.before = self.last.take();
        let mut estimate = self.spare.pop().unwrap_or_default();
        std::mem::swap(&mut estimate, if whole { &mut self.searched } else { &mut self.tracked });
        self.last = Some(TrustedEstimate { exposure, X_WC, estimate });
    }
}
