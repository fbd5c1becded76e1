//! What measurements say of the description of the cell: how many fit it only with a model error, how large that is, and some views that tell what may be wrong.

use crate::calibration::{LensView, lens_differences};
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::messages::{Measurement, measurement_flag};
use crate::target::Target;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Views that are kept. Chosen by hand: the estimate of a lens becomes surer with the square root of their number, and twice as many would be twice the work at the end of a run.
const VIEWS: usize = 24;
/// Turn of the target in the camera, rad, or change of its position as a share of its distance, from which on a view is another one. Chosen by hand: a motion by a
/// right angle or twice the distance leaves 16 views.
const OTHER_VIEW: f64 = 0.1;

/// Makes room among views of a whole run: of the old ones as many are kept in each part of it.
pub(super) fn drop_every_second<T>(views: &mut Vec<T>) {
    let mut keep = false;
    views.retain(|_| {
        keep = !keep;
        keep
    });
}

/// Counts measurements with a model error, and keeps views.
#[derive(Debug, Clone, Default)]
pub struct ModelErrorLog {
    count: u64,
    max_rms_px: f64,
    views: Vec<Measurement>,
}

/// A number of the description that the views of a run contradict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DescriptionError {
    /// The key of the run file.
    pub key: String,
    /// What the run file says.
    pub described: f64,
    /// What fits.
    pub estimated: f64,
    /// Standard deviation of that.
    pub sd: f64,
}

/// Measurements that fit the description of lens and target only with a model error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelError {
    /// How many.
    pub measurements: u64,
    /// Largest reprojection error among them, root mean square, px.
    pub max_rms_px: f64,
    /// What explains it, the surest first; empty where neither focal length, principal point nor k1 does.
    pub differences: Vec<DescriptionError>,
}

impl ModelErrorLog {
    /// Memory is taken once.
    pub(super) fn new() -> Self {
        Self { views: Vec::with_capacity(VIEWS), ..Self::default() }
    }

    /// Takes in a measurement in which the target was found.
    pub(super) fn note(&mut self, m: &Measurement) {
        if m.flags & measurement_flag::MODEL_ERROR != 0 {
            self.count += 1;
            self.max_rms_px = self.max_rms_px.max(m.reprojection_rms_px);
        }
        // Views without a misfit tell, too, be they before the first one: a lens would show in them, a shadow that came later would not.
        if m.features().len() < 4 {
            return;
        }
        let Some(pose) = m.pose() else { return };
        if self.views.last().and_then(Measurement::pose).is_some_and(|last| !is_other_view(&last, &pose)) {
            return;
        }
        if self.views.len() >= VIEWS {
            drop_every_second(&mut self.views);
        }
        self.views.push(*m);
    }

    /// What there is to tell; `None` where all measurements fit. `lens` and `target` are the described ones.
    #[must_use]
    pub fn report(&self, lens: &CameraModel, target: &Target) -> Option<ModelError> {
        let differences = || {
            let views: Vec<LensView> = self.views.iter().filter_map(|m| view(m, target)).collect();
            let told = lens_differences(lens, &views).into_iter().map(|d| DescriptionError {
                key: format!("camera.lens.{}", d.key),
                described: d.described,
                estimated: d.estimated,
                sd: d.sd,
            });
            told.collect()
        };
        (self.count > 0).then(|| ModelError {
            measurements: self.count,
            max_rms_px: self.max_rms_px,
            differences: differences(),
        })
    }
}

fn is_other_view(last: &Pose, now: &Pose) -> bool {
    let moved = (last.translation.vector - now.translation.vector).norm();
    last.rotation.angle_to(&now.rotation) > OTHER_VIEW || moved > OTHER_VIEW * now.translation.vector.norm()
}

fn view(m: &Measurement, target: &Target) -> Option<LensView> {
    let point = |f: &crate::messages::FeaturePoint| {
        let at = target.points().iter().find(|p| u64::from(p.id) == f.id)?;
        Some((at.p_O, Vector2::new(f.u_px, f.v_px)))
    };
    Some(LensView { points: m.features().iter().filter_map(point).collect(), X_CO: m.pose()? })
}

impl ModelError {
    /// The line of the summary.
    #[must_use]
    pub fn to_text(&self) -> String {
        let Self { measurements, max_rms_px, differences } = self;
        let of = |d: &DescriptionError| {
            let digits = if d.sd < 1.0 { 3 } else { 1 };
            let DescriptionError { key, described, estimated, sd } = d;
            format!("{key} {estimated:.digits$} +- {sd:.digits$} fits (the run file says {described})")
        };
        let remedy = if differences.is_empty() {
            "look at [target] (sizes, flatness), [camera.lens] and, with a rolling shutter, camera.v4l2.readout_ms".to_string()
        } else {
            let told: Vec<_> = differences.iter().map(of).collect();
            format!("{}: `vservo calibrate camera` tells all of the lens", told.join(", "))
        };
        format!("{measurements} measurements fit the description to {max_rms_px:.2} px only; {remedy}")
    }
}
