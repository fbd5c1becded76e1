//! What the servo law of a run goes by: where the depths in its matrix come from.

use crate::config::{Config, Task};
use crate::servo::{DepthSource, InteractionAt, Law};

/// Where the depths in the law's matrix come from; `None` where it has none: position-based laws, calibrations.
pub(super) fn depth(config: &Config) -> Option<String> {
    if config.task != Task::Servo {
        return None;
    }
    match &config.servo.law {
        Law::ImageVelocity { interaction, .. }
        | Law::ImageTorque { interaction, .. }
        | Law::PreconditionedTorque { interaction, .. } => {
            let only_at_goal = interaction.at == InteractionAt::Desired;
            Some(match interaction.depth {
                _ if interaction.at == InteractionAt::Estimated => {
                    "the image Jacobian is learnt from the arm's motion, without depths".into()
                }
                DepthSource::Constant(z_m) => format!("L_s takes {z_m} m for the depth of every feature"),
                _ if only_at_goal => {
                    "L_s is that of the desired features, with the depths of the desired pose".into()
                }
                DepthSource::Desired => "L_s takes the depths of the desired pose".into(),
                DepthSource::Estimated => "L_s takes the depths that vision estimates".into(),
                DepthSource::Initial => "L_s keeps the depths of the first measurement".into(),
                DepthSource::Known => "L_s takes the true depths of the scene".into(),
            })
        }
        Law::Hybrid { depth, .. } => Some(match depth {
            DepthSource::Constant(z_m) => format!("J_p takes {z_m} m for z_d"),
            DepthSource::Desired | DepthSource::Estimated => "J_p takes z_d of the desired pose".into(),
            DepthSource::Initial => "J_p keeps the depth of the first measurement".into(),
            DepthSource::Known => "J_p takes the true depth of the scene".into(),
        }),
        Law::PositionTorque { .. } | Law::PositionVelocity { .. } => None,
    }
}
