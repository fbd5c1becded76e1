//! Which error of the camera's pose a run to the goal may end with: by what its views on the straight way will tell of lens, mount, stamps and size.

use super::CameraPath;
use crate::calibration::from_run::{CONFIDENCE, RunCell, RunViews, SeenPoint, SeenView, fit_run};
use crate::config::Config;
use crate::robot::Robot;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;
use serde::Serialize;

/// Time that the way takes, s, and the standard deviation of a point, px. Chosen by hand: what the shipped run files need, and what real images have.
const WAY_S: f64 = 2.0;
const SD_PX: f64 = 0.05;
/// Every how many-th place of the way is a view. Chosen by hand: twenty views, some of a run's.
const EVERY: usize = 3;

/// What a run will be able to promise of its end, where the description is right.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BoundAhead {
    /// Share of all cases in which the errors will be within the bounds, each by itself.
    pub confidence: f64,
    /// Of the distance of the camera from its desired place, m.
    pub position_bound_m: f64,
    /// Of the angle of the camera from its desired orientation, rad.
    pub orientation_bound_rad: f64,
    /// The part of the description whose exact knowledge would narrow the bound of the distance the most; `null` where none would by a third.
    pub narrowed_by: Option<String>,
}

impl BoundAhead {
    /// Of a run of `config` that goes the straight `way`; `None` of a goal that is no pose, and where the target is in view too seldom.
    pub(super) fn of<const N: usize>(config: &Config, robot: &Robot<N>, way: &CameraPath) -> Option<Self> {
        let X_DO =
            config.set_point.X_DO().filter(|_| config.set_point.is_of_pose() && config.stereo.is_none())?;
        let (camera, mount) = (&config.camera.model, &config.camera.mount);
        let X_WO = config.X_WO()?;
        let step_s = WAY_S / way.postures.len().max(1) as f64;
        let postures: Vec<_> = way
            .postures
            .iter()
            .map(|q| SVector::<f64, N>::from_fn(|i, _| q.get(i).copied().unwrap_or_default()))
            .collect();
        let mut run = RunViews::default();
        for (k, q) in postures.iter().enumerate() {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(postures.len() - 1));
            let qd =
                (postures.get(after)? - postures.get(before)?) / (step_s * (after - before).max(1) as f64);
            let stamp = MonoNs(0) + SpanNs::from_s(step_s * k as f64);
            run.track.push(stamp, *q, qd);
            let X_CO = mount.X_WC(robot, q).inv_mul(&X_WO);
            let seen = config.target.features().map(|point| {
                let px = camera.project(&(X_CO * point.p_O)).filter(|px| camera.contains(px, 0.0))?;
                Some(SeenPoint { p_O: point.p_O, px, sd_px: SD_PX })
            });
            if let Some(points) = seen.collect::<Option<Vec<_>>>().filter(|_| k.is_multiple_of(EVERY)) {
                run.views.push(SeenView { stamp, points, X_CO });
            }
        }
        let cell = RunCell { robot, mount, camera };
        let end = fit_run(&cell, &run).ok()?.end_pose((postures.last()?, X_DO));
        Some(Self {
            confidence: CONFIDENCE,
            position_bound_m: end.position_bound_m,
            orientation_bound_rad: end.angle_bound_rad,
            narrowed_by: end.narrowed_by.map(|part| part.as_str().to_owned()),
        })
    }

    /// In words.
    pub(super) fn line(&self) -> String {
        let least = self
            .narrowed_by
            .as_ref()
            .map_or_else(String::new, |part| format!("; the least certain is the {part}"));
        format!(
            "after the straight way the camera will be known to be within {:.2} mm and {:.3} deg of the goal, with {:.0} % certainty{least}",
            self.position_bound_m * 1e3,
            self.orientation_bound_rad.to_degrees(),
            self.confidence * 100.0
        )
    }
}
