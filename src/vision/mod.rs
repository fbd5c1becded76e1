//! The vision core: a frame in, a [`Measurement`] out.
//!
//! ```text
//! Frame --> Detector (windows, else whole frame) --> centroids --> pose --> centre offsets --> features, pose, covariance
//!              ^ expected dots: from Prior, else constant velocity of the last two measurements
//! ```
//! No clock, no allocation, no error: what goes wrong is a [`TargetStatus`]. What was found is believed only where one
//! pose explains it, see [`VisionSettings::model_sd_px`].

use crate::camera_model::CameraModel;
use crate::detect::{Detector, Dot, Expected, centre_offset, dot_covariance_px2};
use crate::geometry::{Pose, rotation_angle};
use crate::imaging::ImageView;
use crate::messages::{FeaturePoint, FrameHeader, Measurement, TargetStatus, frame_flag, measurement_flag};
use crate::pose::{Correspondence, PoseSolution, RefinedPose, planar_pose, refine};
use crate::target::DotTarget;
use crate::time::MonoNs;
use nalgebra::Vector2;

/// Centre offsets below this need no second turn, px.
const SMALL_OFFSET_PX: f64 = 0.05;

/// Largest misfit of a good measurement: `T = 4 rms^2 / sigma^2`, the sum of squares of the 8 reprojection errors over
/// the mean variance of a coordinate. With 6 parameters of the pose it has a chi-square distribution with 2 degrees of
/// freedom, which exceeds 20 once in 22 000 times; in strong blur the stated variances are a few times too small.
const LARGEST_MISFIT: f64 = 50.0;
/// Largest shift of one dot by what is dark beside it, px: two dots at a shadow's edge may move as a pose would move them.
const LARGEST_DISTURBANCE_PX: f64 = 0.5;

/// A frame as the camera published it.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Stamps and shape.
    pub header: FrameHeader,
    /// The picture.
    pub image: ImageView<'a>,
}

/// What is known about the scene before the frame is looked at.
#[derive(Debug, Clone, Copy, Default)]
pub struct Prior {
    /// Where the object should be at the frame's exposure. `None`: the last two measurements are extrapolated.
    pub predicted_X_CO: Option<Pose>,
}

/// How vision works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisionSettings {
    /// Whether to look in predicted windows first; otherwise every frame is searched as a whole.
    pub track: bool,
    /// How far off a prediction may be, px, beside what its age adds.
    pub slack_px: f64,
    /// Two poses count as ambiguous when the worse one's error, in standard deviations of the features,
    /// exceeds the better one's by less than this.
    pub ambiguity_sigmas: f64,
    /// How far the real lens and the real dots are from their description, one standard deviation of each coordinate,
    /// px. Allows for so much when it is asked whether one pose explains the dots; not part of any stated deviation.
    pub model_sd_px: f64,
}

impl Default for VisionSettings {
    fn default() -> Self {
        Self { track: true, slack_px: 3.0, ambiguity_sigmas: 3.0, model_sd_px: 0.0 }
    }
}

/// The dots of one frame that was measured.
#[derive(Debug, Clone, Copy)]
struct Seen {
    exposure: MonoNs,
    dots: [Dot; 4],
    X_CO: Option<Pose>,
}

/// The dots of one frame, and what they say.
#[derive(Debug, Clone, Copy)]
struct Sight {
    dots: [Dot; 4],
    /// Whether the windows were enough.
    tracked: bool,
    /// Images of the centres, px, and normalized.
    centres: [(Vector2<f64>, Vector2<f64>); 4],
    pose: Option<RefinedPose>,
    ambiguous: bool,
    /// Reprojection error of the pose; infinite without one.
    rms_px: f64,
}

/// Measures the target in frame after frame.
#[derive(Debug, Clone)]
pub struct Vision {
    camera: CameraModel,
    target: DotTarget,
    settings: VisionSettings,
    detector: Detector,
    last: Option<Seen>,
    before: Option<Seen>,
    lost: u64,
}

impl Vision {
    /// Prepares all buffers for one camera and target.
    #[must_use]
    pub fn new(camera: CameraModel, target: DotTarget, settings: VisionSettings) -> Self {
        let detector = Detector::new(camera, &target);
        Self { camera, target, settings, detector, last: None, before: None, lost: 0 }
    }

    /// The camera that frames are taken to come from.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// The target that is looked for.
    #[must_use]
    pub fn target(&self) -> &DotTarget {
        &self.target
    }

    /// Measures one frame. All fields of the measurement are filled except `vision_start`, `vision_end`,
    /// `frames_received` and `frames_dropped`, which belong to the process around.
    pub fn process(&mut self, frame: &Frame<'_>, prior: &Prior) -> Measurement {
        let header = &frame.header;
        let mut m = Measurement {
            frame_id: header.frame_id,
            exposure: header.exposure,
            frame_sent: header.sent,
            camera: header.camera,
            flags: header.flags & frame_flag::LAST,
            ..Measurement::default()
        };
        match self.find(frame, prior) {
            Ok(sight) if self.is_consistent(&sight) => {
                sight.fill(&mut m);
                let X_CO = sight.pose.map(|pose| pose.X_CO);
                self.before = self.last;
                self.last = Some(Seen { exposure: header.exposure, dots: sight.dots, X_CO });
            }
            // The target is there, only not to be believed: the last good sight predicts the next one.
            Ok(sight) => {
                m.status = TargetStatus::Inconsistent as u32;
                m.reprojection_rms_px = sight.rms_px;
            }
            Err(status) => {
                m.status = status as u32;
                self.lost += u64::from(self.last.is_some());
                (self.last, self.before) = (None, None);
            }
        }
        m.target_lost = self.lost;
        m
    }

    /// The dots: those in the windows where they can be believed, else those of the whole frame.
    fn find(&mut self, frame: &Frame<'_>, prior: &Prior) -> Result<Sight, TargetStatus> {
        let i = self.camera.intrinsics();
        let size = (frame.image.width(), frame.image.height());
        if size != (i.width_px as usize, i.height_px as usize) {
            return Err(TargetStatus::WrongSize);
        }
        let mut refused = None;
        if self.settings.track
            && let Some(expected) = self.expected(frame.header.exposure, prior)
            && let Some(dots) = self.detector.track(&frame.image, &expected)
        {
            let sight = self.describe(dots, true, prior);
            if self.is_consistent(&sight) {
                return Ok(sight);
            }
            refused = Some(sight); // perhaps something else was in the windows
        }
        match (self.detector.search(&frame.image), refused) {
            (Ok(dots), _) => Ok(self.describe(dots, false, prior)),
            (Err(_), Some(sight)) => Ok(sight),
            (Err(status), None) => Err(status),
        }
    }

    /// Whether the dots can be believed: one pose explains them, and nothing dark lies beside one.
    fn is_consistent(&self, sight: &Sight) -> bool {
        let stated = sight.dots.iter().map(|d| d.sigma_px * d.sigma_px).sum::<f64>() / 4.0;
        let variance = stated + self.settings.model_sd_px * self.settings.model_sd_px;
        sight.pose.is_some()
            && 4.0 * sight.rms_px * sight.rms_px <= LARGEST_MISFIT * variance
            && sight.dots.iter().all(|d| d.disturbance_px <= LARGEST_DISTURBANCE_PX)
    }

    /// Where the dots should be. Needs a measurement before: how dark is dark is taken from there.
    fn expected(&self, exposure: MonoNs, prior: &Prior) -> Option<[Expected; 4]> {
        let last = self.last.as_ref()?;
        let slack_px = self.settings.slack_px;
        let threshold = |dot: &Dot| (0.5 * (dot.dark_level + dot.plate_level)).clamp(0.0, 255.0) as u8;
        let mut out = last.dots.map(|dot| Expected {
            px: dot.px,
            covariance_px2: dot.covariance_px2,
            area_px2: dot.area_px2,
            slack_px,
            threshold: threshold(&dot),
        });
        if let Some(X_CO) = &prior.predicted_X_CO {
            let (points, radii) = (self.target.points(), self.target.radii_m());
            for (((dot, r), p), radius) in out.iter_mut().zip(&points).zip(self.target.points_O()).zip(radii)
            {
                dot.px = self.camera.project(&(X_CO * p))?;
                let (covariance, area) = dot_covariance_px2(X_CO, &self.camera, r, radius)?;
                (dot.covariance_px2, dot.area_px2) = (covariance.map(|c| c + 1.0 / 12.0), area);
            }
        } else if let Some(before) = &self.before {
            // one step ahead at the last velocity; over a gap at most three steps
            let step = (last.exposure - before.exposure).as_s();
            let ahead = (exposure - last.exposure).as_s();
            let ratio = if step > 0.0 && ahead > 0.0 { (ahead / step).min(3.0) } else { 0.0 };
            for ((dot, new), old) in out.iter_mut().zip(&last.dots).zip(&before.dots) {
                let motion = (new.px - old.px) * ratio;
                dot.px += motion;
                dot.slack_px += 0.3 * motion.norm();
            }
        }
        Some(out)
    }

    /// Features and pose from the dots' centroids.
    fn describe(&self, dots: [Dot; 4], tracked: bool, prior: &Prior) -> Sight {
        let (r, radii) = (self.target.points(), self.target.radii_m());
        let mut px = dots.map(|dot| dot.px);
        let mut points = [Correspondence { r: Vector2::zeros(), s: Vector2::zeros() }; 4];
        let set = |points: &mut [Correspondence; 4], px: &[Vector2<f64>; 4]| {
            for ((point, r), px) in points.iter_mut().zip(&r).zip(px) {
                *point = Correspondence { r: *r, s: self.camera.normalized_of(px) };
            }
        };
        set(&mut points, &px);
        let i = self.camera.intrinsics();
        let f = (i.fx_px * i.fy_px).sqrt();
        let sigma_px = (dots.iter().map(|d| d.sigma_px * d.sigma_px).sum::<f64>() / 4.0).sqrt();
        let (mut pose, mut ambiguous): (Option<RefinedPose>, bool) = (None, false);
        if let Ok(both) = planar_pose(&points) {
            let chosen;
            (chosen, ambiguous) = self.choose(&both.best, both.other.as_ref(), prior, sigma_px / f);
            // the offsets depend on the pose, and it on them: each turn leaves a few hundredths of what was wrong
            let mut X_CO = chosen;
            for _ in 0..2 {
                let mut greatest = 0.0f64;
                for ((px, dot), (r, radius)) in px.iter_mut().zip(&dots).zip(r.iter().zip(radii)) {
                    let offset = centre_offset(&X_CO, &self.camera, r, radius);
                    *px = dot.px - offset;
                    greatest = greatest.max(offset.norm_squared());
                }
                set(&mut points, &px);
                let Ok(refined) = refine(&X_CO, &points, sigma_px / f) else { break };
                X_CO = refined.X_CO;
                pose = Some(refined);
                if greatest < SMALL_OFFSET_PX * SMALL_OFFSET_PX {
                    break;
                }
            }
        }
        let rms_px = pose.as_ref().map_or(f64::INFINITY, |pose| {
            let squares = self.target.points_O().into_iter().zip(&px).map(|(p, px)| {
                let seen = self.camera.project(&(pose.X_CO * p));
                seen.map_or(f64::INFINITY, |seen| (seen - px).norm_squared())
            });
            (squares.sum::<f64>() / 4.0).sqrt()
        });
        let mut centres = px.map(|px| (px, px));
        centres.iter_mut().zip(&points).for_each(|((_, s), point)| *s = point.s);
        Sight { dots, tracked, centres, pose, ambiguous, rms_px }
    }

    /// Of two poses that explain the picture almost equally well, the one nearer to what was expected; and whether there
    /// are two.
    fn choose(
        &self,
        best: &PoseSolution,
        other: Option<&PoseSolution>,
        prior: &Prior,
        sigma: f64,
    ) -> (Pose, bool) {
        let Some(other) = other else { return (best.X_CO, false) };
        // rms over four points: their sum of squares grows by the square of the limit
        let limit = self.settings.ambiguity_sigmas * sigma;
        if 4.0 * (other.rms * other.rms - best.rms * best.rms) > limit * limit {
            return (best.X_CO, false);
        }
        let known = prior.predicted_X_CO.or_else(|| self.last.as_ref().and_then(|seen| seen.X_CO));
        let Some(known) = known else { return (best.X_CO, true) };
        let away =
            |X_CO: &Pose| rotation_angle(&(known.rotation.inverse() * X_CO.rotation).to_rotation_matrix());
        (if away(&other.X_CO) < away(&best.X_CO) { other.X_CO } else { best.X_CO }, true)
    }
}

impl Sight {
    /// Tells it.
    fn fill(&self, m: &mut Measurement) {
        m.status = TargetStatus::Found as u32;
        m.feature_count = 4;
        for ((feature, dot), (px, s)) in m.features.iter_mut().zip(&self.dots).zip(&self.centres) {
            *feature = FeaturePoint { u_px: px.x, v_px: px.y, x: s.x, y: s.y, sigma_px: dot.sigma_px };
        }
        if self.tracked {
            m.flags |= measurement_flag::TRACKED;
        }
        if self.ambiguous {
            m.flags |= measurement_flag::AMBIGUOUS;
        }
        let Some(pose) = &self.pose else { return };
        m.set_pose(&pose.X_CO);
        for (row, values) in m.pose_covariance.chunks_exact_mut(6).zip(pose.covariance.row_iter()) {
            row.iter_mut().zip(values.iter()).for_each(|(slot, value)| *slot = *value);
        }
        m.reprojection_rms_px = self.rms_px;
    }
}
