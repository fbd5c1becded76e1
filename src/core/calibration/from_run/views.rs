//! What a run has seen of its target, and where its joints were.

use crate::calibration::JointTrack;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::messages::{FeaturePoint, JointState, Measurement, measurement_flag};
use crate::robot::{Mount, Robot};
use crate::target::Target;
use crate::time::MonoNs;
use nalgebra::{Point3, SVector, Vector2};

/// Motion of the target in the image from which on a view says something new, px. Chosen by hand: a finder's error that depends on how a mark lies in the pixels
/// repeats with a pixel.
pub(crate) const NEW_PX: f64 = 2.0;
/// Largest number of views; of more, every n-th counts. Chosen by hand: the fit takes some seconds with so many.
const MOST: usize = 600;

/// What is believed of a cell.
#[derive(Debug, Clone, Copy)]
pub struct RunCell<'a, const N: usize> {
    /// The arm.
    pub robot: &'a Robot<N>,
    /// Where the camera sits.
    pub mount: &'a Mount,
    /// Its lens.
    pub camera: &'a CameraModel,
}

/// A point of the target in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenPoint {
    /// Where it is believed to be in O, m.
    pub p_O: Point3<f64>,
    /// Where it was seen, px.
    pub px: Vector2<f64>,
    /// Standard deviation of each coordinate, px; 0 where it is not known.
    pub sd_px: f64,
}

impl SeenPoint {
    /// The point `f` of `m`, which is believed to be at `p_O`. What is stated where the description does not fit contains that: it says nothing of noise.
    pub(crate) fn of(m: &Measurement, f: &FeaturePoint, p_O: Point3<f64>) -> Self {
        let is_noise = m.flags & measurement_flag::MODEL_ERROR == 0;
        let sd_px = if is_noise { f.sd_px } else { 0.0 };
        Self { p_O, px: Vector2::new(f.u_px, f.v_px), sd_px }
    }
}

/// The target in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenView {
    /// The middle of its exposure as the camera has stamped it, `camera.stamp_offset_ms` included.
    pub stamp: MonoNs,
    /// Its points.
    pub points: Vec<SeenPoint>,
    /// The pose that vision found.
    pub X_CO: Pose,
}

impl SeenView {
    /// What `m` has of `target`, the first one of the run; `None` where it has no pose, or is of another.
    #[must_use]
    pub fn of(m: &Measurement, target: &Target) -> Option<Self> {
        let X_CO = m.pose().filter(|_| m.found() && m.target_number == 0)?;
        let points = m.features().iter().filter_map(|f| {
            let point = target.points().iter().find(|point| u64::from(point.id) == f.id)?;
            Some(SeenPoint::of(m, f, point.p_O))
        });
        let points: Vec<_> = points.filter(|p| p.px.iter().all(|x| x.is_finite())).collect();
        // fewer fix no pose
        (points.len() >= 4).then_some(Self { stamp: m.exposure, points, X_CO })
    }

    /// Farthest that a point of both views has moved, px; infinite where they share none.
    fn moved_px(&self, other: &Self) -> f64 {
        let shared = self.points.iter().filter_map(|a| {
            let b = other.points.iter().find(|b| b.p_O == a.p_O)?;
            Some((a.px - b.px).norm())
        });
        shared.reduce(f64::max).unwrap_or(f64::INFINITY)
    }
}

/// A run.
#[derive(Debug, Clone, Default)]
pub struct RunViews<const N: usize> {
    /// Its joints.
    pub track: JointTrack<N>,
    /// What it has seen, each view different from the one before.
    pub views: Vec<SeenView>,
    /// Views that were like the one before.
    pub repeated: usize,
}

impl<const N: usize> RunViews<N> {
    /// Takes in where the encoders saw the joints.
    pub fn note_state(&mut self, state: &JointState) {
        let joints = |all: &[f64]| SVector::from_fn(|i, _| all.get(i).copied().unwrap_or_default());
        self.track.push(state.stamp, joints(&state.q), joints(&state.qd));
    }

    /// Takes in a view. One that is like the last one says nothing new, and its errors are the same ones.
    pub fn note_view(&mut self, view: SeenView) {
        if self.views.last().is_some_and(|last| last.moved_px(&view) < NEW_PX) {
            self.repeated += 1;
        } else {
            self.views.push(view);
        }
    }

    /// Some hundred of the views, over the whole run.
    pub(super) fn thinned(&self) -> Vec<&SeenView> {
        self.views.iter().step_by(self.views.len().div_ceil(MOST).max(1)).collect()
    }
}
