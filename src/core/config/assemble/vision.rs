//! Assembly of what sees: a vision core for each target, with the faults that are put in, and the arm by which it predicts.

use crate::config::{Config, FurtherTarget};
use crate::faults::MeasurementFaults;
use crate::robot::RobotError;
use crate::vision::{ArmCarrier, Carrier, TargetSet, Vision};
use nalgebra::Vector2;

/// The vision core of a configuration.
#[must_use]
pub fn vision(config: &Config) -> Vision {
    let vision = Vision::new(config.camera.model, config.target.clone(), config.vision);
    with_faults(config, vision)
}

/// The vision cores of all targets of a configuration.
#[must_use]
pub fn target_set(config: &Config) -> TargetSet {
    let of = |further: &FurtherTarget| {
        with_faults(config, Vision::new(config.camera.model, further.target.clone(), config.vision))
    };
    TargetSet::new(vision(config), config.further_targets.iter().map(of))
}

fn with_faults(config: &Config, vision: Vision) -> Vision {
    match measurement_faults(config) {
        Some(faults) => vision.with_faults(faults),
        None => vision,
    }
}

/// The faults of the measurements of a configuration; `None` where it has none.
pub(super) fn measurement_faults(config: &Config) -> Option<MeasurementFaults> {
    let (list, i) = (&config.faults.measurements, config.camera.model.intrinsics());
    let f_px = Vector2::new(i.fx_px, i.fy_px);
    let made = || MeasurementFaults::new(list, config.seed, config.camera.rate_hz, f_px);
    (!list.is_empty()).then(made)
}

/// The arm and mount of a configuration, by which vision predicts the target.
///
/// # Errors
/// When the robot cannot be built.
pub fn carrier(config: &Config) -> Result<Box<dyn Carrier>, RobotError> {
    crate::dispatch_robot!(config.robot, |robot| {
        Box::new(ArmCarrier::new(robot, config.camera.mount)) as Box<dyn Carrier>
    })
}
