//! Assembly of what sees for control: which cameras it goes by, and law and goal of a second one.

use super::AssembleError;
use crate::camera_model::CameraModel;
use crate::config::{Camera, Config, Scene};
use crate::control::controller::SecondServo;
use crate::control::safety::MeasurementWatch;
use crate::mission::SecondGoal;
use crate::mission::truth::{TrueSight, Truth};
use crate::servo::VisualServo;
use nalgebra::Vector2;

/// Rejects configurations that control does not support: several cameras that are no pair and have no second view, or a pair without a goal.
///
/// # Errors
/// [`AssembleError::SeveralCameras`], [`AssembleError::NotTaught`].
pub fn require_controllable(config: &Config) -> Result<(), AssembleError> {
    if config.stereo.as_ref().is_some_and(|stereo| stereo.taught.is_none()) && config.scene.is_none() {
        return Err(AssembleError::NotTaught);
    }
    match config.cameras().count() {
        0 | 1 => Ok(()),
        2 if config.stereo.is_some() || config.second_view.is_some() => Ok(()),
        several => Err(AssembleError::SeveralCameras(several)),
    }
}

/// Rejects configurations in which a second camera has a goal of its own, for `what` goes by one goal.
///
/// # Errors
/// [`AssembleError::SecondView`].
pub fn require_one_view(config: &Config, what: &'static str) -> Result<(), AssembleError> {
    config.second_view.as_ref().map_or(Ok(()), |_| Err(AssembleError::SecondView(what)))
}

/// Focal lengths that turn normalized errors of a camera into pixels.
pub(super) fn f_px(camera: &Camera) -> Vector2<f64> {
    let i = camera.model.intrinsics();
    Vector2::new(i.fx_px, i.fy_px)
}

/// The truth of a `scene` that control sees by the lens `believed`; `None`: by a pair of cameras.
pub(super) fn truth<const N: usize>(
    scene: &Scene,
    believed: Option<&CameraModel>,
) -> Result<Truth<N>, AssembleError> {
    let targets =
        std::iter::once(&scene.target).chain(scene.further_targets.iter().map(|object| &object.target));
    let points = targets.map(|target| target.features().map(|point| point.p_O).collect());
    let sight = believed.map(|believed| TrueSight {
        camera: scene.camera,
        believed: *believed,
        points: points.collect(),
    });
    Ok(Truth { robot: scene.arm.build()?, mount: scene.mount, objects: scene.places().collect(), sight })
}

/// The law of a second camera, whose measurements `watch` is to watch.
pub(super) fn second_servo<const N: usize>(
    config: &Config,
    watch: MeasurementWatch,
) -> Option<SecondServo<N>> {
    let second = config.second_view.as_ref()?;
    let servo = VisualServo::new(second.cell.servo.clone(), second.cell.set_point.clone());
    Some(SecondServo::new(second.cell.camera.id.into(), servo, watch, second.weight))
}

/// The goal of a second camera.
pub(super) fn second_goal<const N: usize>(config: &Config) -> Result<Option<SecondGoal<N>>, AssembleError> {
    let Some(second) = &config.second_view else { return Ok(None) };
    let cell = &second.cell;
    let truth = cell.scene.as_ref().map(|scene| truth(scene, Some(&cell.camera.model))).transpose()?;
    Ok(Some(SecondGoal::new(cell.camera.id.into(), cell.set_point.clone(), f_px(&cell.camera), truth)))
}
