//! The vision core of two cameras: frames of both in, [`Measurement`]s out, of an object that is known only by the ids of
//! its points.
//!
//! ```text
//! left frame  ─► Finder ─► points by id ─┐ exposure stamps                    by id                      TaughtView
//!                                        ├─► Pairing ─► pair ─► StereoRig ─► points in space, covariance ─┴─► X_CO, covariance
//! right frame ─► Finder ─► points by id ─┘                      triangulation                   absolute orientation
//! ```
//! A frame is looked at when it comes and is then done with: what waits for its mate are the points that were found, not the pixels.
//! Where the target of the run file lies on the object, and how large it is, does not enter: its description only tells the finders how
//! points get their ids. Centres are taken as they are measured, without the offsets that a known target allows for; these are the
//! same in the taught view, so that they vanish where the arm is going; [`StereoRig::with_model_sd_px`] allows for them on the way.

mod pairing;
mod rig;
mod taught;
#[cfg(test)]
mod tests;

pub use pairing::{Match, Pairing, PairingCounts, Side};
pub use rig::{SpacePoint, StereoRig};
pub use taught::{ObjectPose, TaughtPoint, TaughtView, TaughtViewError};

use super::{Frame, misfit};
use crate::camera_model::Response;
use crate::detect::{Finder, Found};
use crate::imaging::ImageView;
use crate::messages::{FeaturePoint, FrameHeader, MAX_FEATURES, Measurement, TargetStatus};
use crate::messages::{frame_flag, measurement_flag};
use crate::stereo::{MeasuredPair, StereoError};
use crate::target::Target;
use crate::time::{MonoNs, SpanNs};

/// From so many points on some are left out that do not fit, up to a third of them, so that four at least are left to contradict each other.
const ENOUGH_TO_CHOOSE: usize = 6;
/// So many points fix a pose, since points of a pair have all three coordinates.
const LEAST: usize = 3;

/// What one camera saw in one frame.
#[derive(Debug, Clone)]
struct CameraDetections {
    header: FrameHeader,
    found: Vec<Found>,
    /// Why there are none.
    miss: Option<TargetStatus>,
}

/// A measurement, and which camera is to blame where it has no target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoMeasurement {
    /// What both cameras say together. Without a pair it has the number and stamp of the frame that is alone.
    pub measurement: Measurement,
    /// The camera that did not see the target, or whose frame is missing.
    pub blind: Option<Side>,
}

/// Measures an object before two cameras.
#[derive(Debug, Clone)]
pub struct StereoVision {
    rig: StereoRig,
    left: Finder,
    right: Finder,
    taught: TaughtView,
    pairing: Pairing<CameraDetections>,
    /// Buffers of detections that are not in use.
    spare: Vec<Vec<Found>>,
    room: usize,
    points: Vec<SpacePoint>,
    pairs: Vec<MeasuredPair>,
    was_found: bool,
    lost: u64,
}

impl StereoVision {
    /// Prepares all buffers. Frames whose stamps lie `tolerance` apart or less are a pair.
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
            was_found: false,
            lost: 0,
        }
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

    /// The view that the object is compared with.
    #[must_use]
    pub fn taught(&self) -> &TaughtView {
        &self.taught
    }

    /// How often frames found their mates.
    #[must_use]
    pub fn counts(&self) -> PairingCounts {
        self.pairing.counts()
    }

    /// Looks for the points in a frame of `side`, and files them for pairing. The frame is not needed any more.
    pub fn look(&mut self, side: Side, frame: &Frame<'_>) {
        let mut found = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(self.room));
        let miss = self.find(side, &frame.image, &mut found).err();
        self.pairing.file(
            side,
            frame.header.exposure,
            CameraDetections { header: frame.header, found, miss },
        );
    }

    /// Files a frame of `side` that is none: its pixels do not fit its header.
    pub fn look_past(&mut self, side: Side, header: FrameHeader) {
        let (found, miss) = (self.spare.pop().unwrap_or_default(), Some(TargetStatus::WrongSize));
        self.pairing.file(side, header.exposure, CameraDetections { header, found, miss });
    }

    /// For frames of `side` exposed up to `until` no mate is to be waited for any more.
    pub fn give_up(&mut self, side: Side, until: MonoNs) {
        self.pairing.give_up(side, until);
    }

    /// The oldest frame of `side` that waits for its mate.
    #[must_use]
    pub fn waiting(&self, side: Side) -> Option<&FrameHeader> {
        self.pairing.front(side).map(|detections| &detections.header)
    }

    /// The next measurement, oldest first; `None` where all frames that are here wait for their mates. All fields are filled except
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

    /// The points in one pair of images by themselves: what a view is taught from. Empty where fewer than three are in both.
    ///
    /// # Errors
    /// The camera that does not see the target, and why.
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
        found: &mut Vec<Found>,
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

    /// Fills pose and features; the camera that is to blame where there are none.
    fn measure(
        &mut self,
        left: &CameraDetections,
        right: &CameraDetections,
        m: &mut Measurement,
    ) -> Option<Side> {
        let both = [(left.miss, Side::Left), (right.miss, Side::Right)];
        if let Some((status, side)) = both.into_iter().find_map(|(miss, side)| Some((miss?, side))) {
            m.status = status as u32;
            return Some(side);
        }
        self.rig.triangulate(&left.found, &right.found, &mut self.points);
        let taught = &self.taught;
        self.points.retain(|point| taught.p_O(point.id).is_some());
        match self.orientation() {
            Ok(pose) => self.fill(&pose, m),
            Err(status) => {
                m.status = status as u32;
                m.reprojection_rms_px = f64::INFINITY;
            }
        }
        None
    }

    /// The pose that explains the points, without those that do not fit.
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

    /// With how often the target was lost. A measurement that is refused, or has no mate, loses nothing.
    fn counted(&mut self, mut m: Measurement) -> Measurement {
        match m.target_status() {
            TargetStatus::Found => self.was_found = true,
            TargetStatus::Inconsistent | TargetStatus::NoPair => {}
            _ => self.lost += u64::from(std::mem::take(&mut self.was_found)),
        }
        m.target_lost = self.lost;
        m
    }
}

/// A measurement of a frame as far as the frame tells.
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
