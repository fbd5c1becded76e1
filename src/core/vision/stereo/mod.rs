//! The vision core of two cameras: frames of both in, [`Measurement`]s out, of an object that is known only by the ids of
//! its points.
//!
//! ```text
//! left frame  ─► Finder ─► points by id ─┐ exposure stamps                    by id                      TaughtView
//!                                        ├─► Pairing ─► pair ─► StereoRig ─► points in space, covariance ─┴─► X_CO, covariance
//! right frame ─► Finder ─► points by id ─┘                      triangulation                   absolute orientation
//! ```
//! A frame is processed when it arrives, and its pixels are not needed any longer: the detections, not the pixels, wait for those of the other
//! camera. Position and size of the target on the object do not enter: the target's description only tells the finders how
//! points get their ids. Centres are used as measured, without the corrections that a known target allows; the same offsets are in
//! the taught view, so that they cancel at the goal; [`StereoRig::with_model_sd_px`] allows for them on the way.
//!
//! Terms: a *pair* is a frame of the left and one of the right camera whose exposure stamps lie within the tolerance; *triangulation* gives a point in space
//! from both images, in the left camera's frame; the *taught view* holds the points at the goal; the *absolute orientation* is the
//! rigid displacement between two sets of points, here from the taught points to the present ones, (10.54).

mod pairing;
mod rig;
mod taught;
#[cfg(test)]
mod tests;

pub use pairing::{Match, Pairing, PairingCounts, Side};
pub use rig::{SpacePoint, StereoRig};
pub use taught::{ObjectPose, TaughtPoint, TaughtView, TaughtViewError};

use super::noise_level::{NoiseLevel, may_be_noise};
use super::steady_misfit::Errors;
use super::{Frame, misfit};
use crate::camera_model::Response;
use crate::detect::{Detection, Finder};
use crate::faults::MeasurementFaults;
use crate::imaging::ImageView;
use crate::messages::{FeaturePoint, FrameHeader, MAX_FEATURES, Measurement, TargetStatus};
use crate::messages::{frame_flag, measurement_flag};
use crate::stereo::{MeasuredPair, StereoError};
use crate::target::Target;
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector2;

/// From so many points on up to a third are left out as outliers, so that at least four remain and are redundant.
const ENOUGH_TO_CHOOSE: usize = 6;
/// Fewest points that determine a pose, since triangulated points have all three coordinates.
const LEAST: usize = 3;

/// Detections of one camera in one frame.
#[derive(Debug, Clone)]
struct CameraDetections {
    header: FrameHeader,
    found: Vec<Detection>,
    /// Why there are no detections.
    miss: Option<TargetStatus>,
}

/// A measurement, and which camera is the cause where it has no target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoMeasurement {
    /// The measurement of a pair. For a frame without its counterpart it has that frame's number and stamp, and no target.
    pub measurement: Measurement,
    /// The camera that did not detect the target, or whose frame is missing.
    pub blind: Option<Side>,
}

/// Measures the pose of an object with two calibrated cameras.
#[derive(Debug, Clone)]
pub struct StereoVision {
    rig: StereoRig,
    left: Finder,
    right: Finder,
    taught: TaughtView,
    pairing: Pairing<CameraDetections>,
    /// Unused buffers of detections.
    spare: Vec<Vec<Detection>>,
    room: usize,
    points: Vec<SpacePoint>,
    pairs: Vec<MeasuredPair>,
    /// Scatter of the points from pair to pair of images that the finders do not state, and room for reprojection errors in both images.
    noise: NoiseLevel,
    errors: Errors,
    was_found: bool,
    lost: u64,
    /// What is put wrong about its measurements on purpose.
    faults: Option<MeasurementFaults>,
}

impl StereoVision {
    /// Vision for the cameras `rig`. Allocates all buffers. Frames whose stamps differ by `tolerance` or less are a pair.
    #[must_use]
    pub fn new(rig: StereoRig, target: &Target, taught: TaughtView, tolerance: SpanNs) -> Self {
        let room = target.points().len();
        Self {
            left: Finder::new(*rig.left(), target),
            right: Finder::new(*rig.right(), target),
            rig,
            taught,
            pairing: Pairing::new(tolerance),
            spare: (0..4).map(|_| Vec::with_capacity(room)).collect(),
            room,
            points: Vec::with_capacity(room),
            pairs: Vec::with_capacity(room),
            noise: NoiseLevel::with_room_for(2 * room),
            errors: Vec::with_capacity(2 * room),
            was_found: false,
            lost: 0,
            faults: None,
        }
    }

    /// The same with faults of its measurements.
    #[must_use]
    pub fn with_faults(self, faults: MeasurementFaults) -> Self {
        Self { faults: Some(faults), ..self }
    }

    /// The same for cameras of these responses ([`Finder::for_response`]).
    #[must_use]
    pub fn for_responses(mut self, left: &Response, right: &Response) -> Self {
        self.left = self.left.for_response(left);
        self.right = self.right.for_response(right);
        self
    }

    /// The cameras.
    #[must_use]
    pub fn rig(&self) -> &StereoRig {
        &self.rig
    }

    /// The taught view: the points at the goal.
    #[must_use]
    pub fn taught(&self) -> &TaughtView {
        &self.taught
    }

    /// Numbers of pairs and of frames without a pair.
    #[must_use]
    pub fn counts(&self) -> PairingCounts {
        self.pairing.counts()
    }

    /// Detects the points in a frame of `side` and stores them until the other camera's frame comes. The frame is not needed afterwards.
    pub fn look(&mut self, side: Side, frame: &Frame<'_>) {
        let mut found = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(self.room));
        let miss = self.find(side, &frame.image, &mut found).err();
        if let Some(faults) = &self.faults {
            faults.disturb(side as u64, frame.header.frame_id, &mut found);
        }
        self.pairing.file(
            side,
            frame.header.exposure,
            CameraDetections { header: frame.header, found, miss },
        );
    }

    /// Stores an invalid frame of `side`, whose pixels do not fit its header, as one without detections.
    pub fn look_past(&mut self, side: Side, header: FrameHeader) {
        let (found, miss) = (self.spare.pop().unwrap_or_default(), Some(TargetStatus::WrongSize));
        self.pairing.file(side, header.exposure, CameraDetections { header, found, miss });
    }

    /// Ends the waiting of frames of `side` with exposures up to `until`: the other camera's frames are late or lost.
    pub fn give_up(&mut self, side: Side, until: MonoNs) {
        self.pairing.give_up(side, until);
    }

    /// Header of the oldest frame of `side` that waits for the other camera's.
    #[must_use]
    pub fn waiting(&self, side: Side) -> Option<&FrameHeader> {
        self.pairing.front(side).map(|detections| &detections.header)
    }

    /// The next measurement, oldest first; `None` while all frames wait for the other camera's. All fields are filled except
    /// `vision_start`, `vision_end`, `frames_received` and `frames_dropped`, which belong to the process around.
    pub fn next_measurement(&mut self) -> Option<StereoMeasurement> {
        Some(match self.pairing.next_match()? {
            Match::Both { left, right } => {
                let mut m = begun(&left.header);
                m.frame_sent = left.header.sent.max(right.header.sent);
                m.flags |= right.header.flags & frame_flag::LAST;
                let blind = self.measure(&left, &right, &mut m);
                self.spare.extend([left.found, right.found]);
                StereoMeasurement { measurement: self.counted(m), blind }
            }
            Match::Alone(side, detections) => {
                let m = Measurement { status: TargetStatus::NoPair as u32, ..begun(&detections.header) };
                self.spare.push(detections.found);
                StereoMeasurement { measurement: self.counted(m), blind: Some(side.other()) }
            }
        })
    }

    /// Triangulated points of a single pair of images, from which a view is taught. Empty where fewer than three are in both.
    ///
    /// # Errors
    /// The camera that does not detect the target, and why.
    pub fn points_in(
        rig: &StereoRig,
        left: (&mut Finder, ImageView<'_>),
        right: (&mut Finder, ImageView<'_>),
    ) -> Result<Vec<SpacePoint>, (Side, TargetStatus)> {
        let mut found = [Vec::new(), Vec::new()];
        for ((finder, image), (side, found)) in
            [left, right].into_iter().zip([Side::Left, Side::Right].into_iter().zip(&mut found))
        {
            finder.search(&image, found).map_err(|status| (side, status))?;
        }
        let ([left, right], mut points) = (found, Vec::new());
        rig.triangulate(&left, &right, &mut points);
        Ok(points)
    }

    fn find(
        &mut self,
        side: Side,
        image: &ImageView<'_>,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        found.clear();
        let (camera, finder) = match side {
            Side::Left => (self.rig.left(), &mut self.left),
            Side::Right => (self.rig.right(), &mut self.right),
        };
        let i = camera.intrinsics();
        if (image.width(), image.height()) != (i.width_px as usize, i.height_px as usize) {
            return Err(TargetStatus::WrongSize);
        }
        finder.search(image, found)
    }

    /// Fills pose and features; returns the camera that is the cause where there are none.
    fn measure(
        &mut self,
        left: &CameraDetections,
        right: &CameraDetections,
        m: &mut Measurement,
    ) -> Option<Side> {
        let both = [(left.miss, Side::Left), (right.miss, Side::Right)];
        if let Some((status, side)) = both.into_iter().find_map(|(miss, side)| Some((miss?, side))) {
            m.status = status as u32;
            self.noise.interrupt();
            return Some(side);
        }
        self.triangulate(left, right);
        let before = self.rig.noise_px2;
        self.learn_noise(left, right);
        if self.rig.noise_px2 != before {
            // The covariances contain it.
            self.triangulate(left, right);
        }
        match self.orientation() {
            Ok(pose) => self.fill(&pose, m),
            Err(status) => {
                m.status = status as u32;
                m.reprojection_rms_px = f64::INFINITY;
            }
        }
        None
    }

    /// The taught points that are in both images.
    fn triangulate(&mut self, left: &CameraDetections, right: &CameraDetections) {
        self.rig.triangulate(&left.found, &right.found, &mut self.points);
        let taught = &self.taught;
        self.points.retain(|point| taught.p_O(point.id).is_some());
    }

    /// Takes in the reprojection errors of all points in both images, of which noise is learnt.
    fn learn_noise(&mut self, left: &CameraDetections, right: &CameraDetections) {
        self.errors.clear();
        let pose = self.taught.pose(&self.points, &mut self.pairs).ok();
        for point in self.points.iter().filter(|_| self.points.len() >= LEAST) {
            let p_L = pose.as_ref().and_then(|pose| Some(pose.X_CO * self.taught.p_O(point.id)?));
            let Some([at_left, at_right]) = p_L.and_then(|p_L| self.rig.project(&p_L)) else { continue };
            self.errors.push((2 * point.id, at_left - point.left_px));
            self.errors.push((2 * point.id + 1, at_right - point.right_px));
        }
        let count = self.points.len().max(1) as f64;
        let centre = self.points.iter().map(|point| point.left_px).sum::<Vector2<f64>>() / count;
        let squares = self.points.iter().map(|point| (point.left_px - centre).norm_squared()).sum::<f64>();
        if may_be_noise(&self.errors, (squares / count).sqrt()) {
            let all = || left.found.iter().chain(&right.found);
            let stated = all().map(|dot| dot.sd_px * dot.sd_px).sum::<f64>();
            self.noise.note(&self.errors, stated / all().count().max(1) as f64);
        } else {
            self.noise.disturb();
        }
        self.rig.noise_px2 = self.noise.unstated_px2();
    }

    /// The pose of the object by absolute orientation, without outliers.
    fn orientation(&mut self) -> Result<ObjectPose, TargetStatus> {
        let least = self.points.len() - self.points.len() / 3;
        loop {
            let pose = match self.taught.pose(&self.points, &mut self.pairs) {
                Ok(pose) => pose,
                Err(StereoError::TooFewPoints { .. }) => return Err(TargetStatus::TooFewShared),
                Err(_) => return Err(TargetStatus::Inconsistent),
            };
            if pose.misfit <= misfit::largest(pose.freedom as f64) {
                return Ok(pose);
            }
            let count = self.points.len();
            if count < ENOUGH_TO_CHOOSE || count <= least.max(LEAST) {
                return Err(TargetStatus::Inconsistent);
            }
            let off = |(point, pair): (&SpacePoint, &MeasuredPair)| {
                point.misfit + taught::mismatch(&pose.X_CO, pair).unwrap_or(f64::INFINITY)
            };
            let each = self.points.iter().zip(&self.pairs).map(off).enumerate();
            let Some((worst, _)) = each.max_by(|a, b| a.1.total_cmp(&b.1)) else {
                return Err(TargetStatus::Inconsistent);
            };
            self.points.remove(worst);
        }
    }

    fn fill(&self, pose: &ObjectPose, m: &mut Measurement) {
        m.status = TargetStatus::Found as u32;
        m.set_pose(&pose.X_CO);
        for (row, values) in m.pose_covariance.chunks_exact_mut(6).zip(pose.covariance.row_iter()) {
            row.iter_mut().zip(values.iter()).for_each(|(slot, value)| *slot = *value);
        }
        if self.points.len() < self.taught.count() {
            m.flags |= measurement_flag::PARTIAL;
        }
        let (mut squares, mut images) = (0.0, 0.0);
        for (place, point) in m.features.iter_mut().zip(&self.points) {
            *place = FeaturePoint {
                id: point.id.into(),
                u_px: point.left_px.x,
                v_px: point.left_px.y,
                x: point.left_s.x,
                y: point.left_s.y,
                sd_px: point.sd_px,
            };
            let expected = self.taught.p_O(point.id).and_then(|p_O| self.rig.project(&(pose.X_CO * p_O)));
            if let Some([left, right]) = expected {
                squares += (left - point.left_px).norm_squared() + (right - point.right_px).norm_squared();
                images += 2.0;
            }
        }
        m.feature_count = self.points.len().min(MAX_FEATURES) as u32;
        m.reprojection_rms_px = f64::sqrt(squares / images);
    }

    /// Adds the count of target losses. A rejected measurement, or one without a pair, is no loss.
    fn counted(&mut self, mut m: Measurement) -> Measurement {
        match m.target_status() {
            TargetStatus::Found => self.was_found = true,
            TargetStatus::Inconsistent | TargetStatus::NoPair => {}
            _ => self.lost += u64::from(std::mem::take(&mut self.was_found)),
        }
        m.target_lost = self.lost;
        if let Some(faults) = &mut self.faults {
            faults.apply(&mut m);
        }
        m
    }
}

/// A measurement with the fields that come from the frame's header.
fn begun(header: &FrameHeader) -> Measurement {
    Measurement {
        frame_id: header.frame_id,
        exposure: header.exposure,
        frame_sent: header.sent,
        camera: header.camera,
        flags: header.flags & frame_flag::LAST,
        ..Measurement::default()
    }
}
