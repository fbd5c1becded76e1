//! Keys that change nothing beside what else the run file says: each is told with what it needs, so that nobody tunes one in vain.
//!
//! Told are keys that are written and that have another value than their default: a run file may list them all.

use crate::config::check::Validation;
use crate::config::default_keys;
use crate::config::raw::{
    AreaKind, DampingOn, Depth, FeatureGain, PoseFrom, RawConfig, SchemeKind, SetPointKind,
};
use crate::drive::CommandMode;
use crate::servo::{InteractionAt, UpdatePolicy};
use toml::Value;

/// Keys or tables with a condition without which they have no effect.
struct Conditional {
    keys: &'static [&'static str],
    acts: fn(&RawConfig) -> bool,
    only_with: &'static str,
}

const VELOCITY_LAW: &str = "a law of joint velocities (servo.scheme = \"position_resolved_velocity\", \"image_resolved_velocity\" or \"hybrid\")";
const IMAGE_LAW: &str = "an image-based law (servo.scheme = \"image_pd\" or \"image_resolved_velocity\")";
const TORQUE_MODE: &str = "a drive that is commanded by torques (drive.mode = \"torque\")";

const CONDITIONS: [Conditional; 23] = [
    Conditional {
        keys: &[
            "servo.gain_1_s",
            "servo.adaptive_gain",
            "servo.smooth_start_1_s",
            "servo.limit_avoidance_1_s",
        ],
        acts: is_velocity_law,
        only_with: VELOCITY_LAW,
    },
    Conditional {
        keys: &["servo.gain_at_goal_1_s", "servo.first_motion_m_s"],
        acts: |raw| is_velocity_law(raw) && !raw.servo.object.moves,
        only_with: "a law of joint velocities before an object at rest (servo.object.moves = false)",
    },
    Conditional {
        keys: &["servo.pd"],
        acts: is_torque_law,
        only_with: "a law of torques (servo.scheme = \"position_pd\" or \"image_pd\")",
    },
    Conditional {
        keys: &["servo.pd.feature_gain", "servo.pd.feature_stiffness_nm"],
        acts: |raw| !is_torque_law(raw) || is_image_law(raw),
        only_with: "servo.scheme = \"image_pd\"",
    },
    Conditional {
        keys: &["servo.pd.feature_damping_nms"],
        acts: |raw| !is_torque_law(raw) || (is_image_law(raw) && !has_pose_gains(raw) && damps_task(raw)),
        only_with: "servo.scheme = \"image_pd\", servo.pd.feature_gain = \"scalar\" or \"matrix\" and servo.pd.damping = \"task\"",
    },
    Conditional {
        keys: &["servo.pd.position_stiffness_n_m", "servo.pd.orientation_stiffness_nm_rad"],
        acts: |raw| !is_torque_law(raw) || has_pose_gains(raw),
        only_with: "servo.scheme = \"position_pd\", or \"image_pd\" with servo.pd.feature_gain = \"preconditioned\"",
    },
    Conditional {
        keys: &["servo.pd.position_damping_ns_m", "servo.pd.orientation_damping_nms_rad"],
        acts: |raw| !is_torque_law(raw) || (has_pose_gains(raw) && damps_task(raw)),
        only_with: "servo.pd.damping = \"task\", and servo.scheme = \"position_pd\", or \"image_pd\" with servo.pd.feature_gain = \"preconditioned\"",
    },
    Conditional {
        keys: &["servo.pd.joint_damping_nms_rad_or_ns_m"],
        acts: |raw| !is_torque_law(raw) || !damps_task(raw),
        only_with: "servo.pd.damping = \"joints\"",
    },
    Conditional {
        keys: &["servo.lead_ms"],
        acts: |raw| raw.servo.update == UpdatePolicy::Predict && raw.servo.scheme != SchemeKind::LookAndMove,
        only_with: "a law that predicts its views (servo.update = \"predict\")",
    },
    Conditional {
        keys: &["servo.depth"],
        acts: depth_acts,
        only_with: "a law that takes a depth: hybrid, or an image-based one whose servo.interaction is \"current\" or \"mean\" (or \"desired\", \
                    with servo.depth = \"constant\")",
    },
    Conditional {
        keys: &["servo.constant_depth_m"],
        acts: |raw| (raw.servo.depth == Depth::Constant && depth_acts(raw)) || has_features(raw),
        only_with: "servo.depth = \"constant\" of an image-based or hybrid law, or a goal of features",
    },
    Conditional { keys: &["servo.interaction"], acts: is_image_law, only_with: IMAGE_LAW },
    Conditional { keys: &["servo.weights"], acts: is_image_law, only_with: IMAGE_LAW },
    Conditional {
        keys: &["servo.orientation_error"],
        acts: |raw| !is_image_law(raw) && raw.servo.scheme != SchemeKind::LookAndMove,
        only_with: "a law that compares orientations (servo.scheme = \"position_pd\", \"position_resolved_velocity\" or \"hybrid\")",
    },
    Conditional {
        keys: &["servo.segments", "servo.area"],
        acts: |raw| {
            let by_homography = raw.servo.pose_from == PoseFrom::Homography;
            is_image_law(raw) || raw.servo.scheme == SchemeKind::Hybrid || by_homography
        },
        only_with: IMAGE_LAW,
    },
    Conditional {
        keys: &["servo.outline"],
        acts: |raw| raw.servo.area != AreaKind::None,
        only_with: "servo.area",
    },
    Conditional {
        keys: &["servo.search_s"],
        acts: |raw| raw.servo.return_to_last_seen,
        only_with: "servo.return_to_last_seen = true: an arm that does not go back to where it saw its target looks around from nowhere",
    },
    Conditional {
        keys: &["servo.visibility.margin_px", "servo.visibility.rate_1_s"],
        acts: |raw| raw.servo.visibility.guard,
        only_with: "servo.visibility.guard = true",
    },
    Conditional {
        keys: &[
            "servo.object.acceleration_m_s2",
            "servo.object.acceleration_rad_s2",
            "servo.object.max_uncertainty_m",
        ],
        acts: |raw| raw.servo.object.moves,
        only_with: "servo.object.moves = true",
    },
    Conditional {
        keys: &["servo.path.feed_forward"],
        acts: |raw| !raw.servo.path.poses.is_empty(),
        only_with: "[[servo.path.poses]]",
    },
    Conditional {
        keys: &["servo.set_point.features"],
        acts: |raw| raw.servo.set_point.kind == SetPointKind::Features,
        only_with: "servo.set_point.kind = \"features\"",
    },
    Conditional {
        keys: &["servo.set_point.measurements"],
        acts: |raw| raw.servo.set_point.kind == SetPointKind::Taught || raw.run.serve,
        only_with: "a goal that is taught in the run (servo.set_point.kind = \"taught\", or run.serve)",
    },
    Conditional {
        keys: &[
            "motion.natural_frequency_rad_s",
            "motion.damping_ratio",
            "motion.effort_rise_ms",
            "motion.disturbance_rad_s",
            "motion.velocity_observer_rad_s",
        ],
        acts: |raw| raw.drive.mode.is_none_or(|mode| mode == CommandMode::Torque),
        only_with: TORQUE_MODE,
    },
];

fn is_torque_law(raw: &RawConfig) -> bool {
    matches!(raw.servo.scheme, SchemeKind::PositionPd | SchemeKind::ImagePd)
}

fn is_velocity_law(raw: &RawConfig) -> bool {
    !is_torque_law(raw) && raw.servo.scheme != SchemeKind::LookAndMove
}

fn is_image_law(raw: &RawConfig) -> bool {
    matches!(raw.servo.scheme, SchemeKind::ImagePd | SchemeKind::ImageResolvedVelocity)
}

/// Whether a torque law has the gains of positions and orientations.
fn has_pose_gains(raw: &RawConfig) -> bool {
    raw.servo.scheme == SchemeKind::PositionPd || raw.servo.pd.feature_gain == FeatureGain::Preconditioned
}

fn damps_task(raw: &RawConfig) -> bool {
    raw.servo.pd.damping == DampingOn::Task
}

/// Whether the law's matrix takes its depths as `servo.depth` says; that of the desired features has the depths of the goal anyway.
fn depth_acts(raw: &RawConfig) -> bool {
    let of_goal = matches!(raw.servo.depth, Depth::Constant | Depth::Desired);
    match raw.servo.interaction {
        _ if raw.servo.scheme == SchemeKind::Hybrid => true,
        InteractionAt::Estimated => false,
        InteractionAt::Desired => is_image_law(raw) && of_goal,
        _ => is_image_law(raw),
    }
}

/// Whether a goal is given by features, whose depths may have to be taken from somewhere.
fn has_features(raw: &RawConfig) -> bool {
    raw.servo.set_point.kind == SetPointKind::Features || !raw.goals.is_empty()
}

/// Warns of every key that is written in vain.
pub(super) fn without_effect(raw: &RawConfig, check: &mut Validation<'_>) {
    let all = CONDITIONS.iter().filter(|condition| !(condition.acts)(raw));
    let mut idle = all
        .flat_map(|one| one.keys.iter().map(|key| (*key, one.only_with)))
        .filter(|(key, _)| check.is_written(key));
    let Some(first) = idle.next() else { return };
    let told: Vec<_> = std::iter::once(first).chain(idle).collect();
    let (defaults, values) = (default_keys(), toml::Table::try_from(raw).unwrap_or_default());
    for (key, only_with) in told {
        if at(&values, key) != at(&defaults, key) {
            check.doubtful(key, format!("has no effect here, only with {only_with}"));
        }
    }
}

/// The value at a dotted key.
fn at<'a>(table: &'a toml::Table, key: &str) -> Option<&'a Value> {
    let mut parts = key.split('.');
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |value, part| value.get(part))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn warnings(set: &[&str]) -> Vec<String> {
        let set: Vec<_> = set.iter().map(ToString::to_string).collect();
        let warnings = Config::load(None, &set).unwrap().warnings;
        warnings.iter().map(ToString::to_string).filter(|told| told.contains("has no effect")).collect()
    }

    #[test]
    fn a_key_that_changes_nothing_is_told_with_what_it_needs() {
        let position = "servo.scheme=position_resolved_velocity";
        for (set, key, needs) in [
            (&["servo.scheme=image_pd", "servo.gain_1_s=3"][..], "servo.gain_1_s", "image_resolved_velocity"),
            (&["servo.pd.damping=joints"], "servo.pd", "position_pd"),
            (&[position, "servo.depth=constant"], "servo.depth", "hybrid"),
            (&[position, "servo.interaction=current"], "servo.interaction", "image_pd"),
            (&["servo.constant_depth_m=0.4"], "servo.constant_depth_m", "constant"),
            (&["servo.object.acceleration_m_s2=1"], "servo.object.acceleration_m_s2", "moves = true"),
            (
                &["servo.return_to_last_seen=false", "servo.search_s=3"],
                "servo.search_s",
                "return_to_last_seen",
            ),
            (
                &["servo.set_point.features=[[0,0],[0.1,0],[0.1,0.1],[0,0.1]]"],
                "servo.set_point.features",
                "kind",
            ),
            (
                &["drive.mode=velocity", "motion.controller=pass_through", "motion.disturbance_rad_s=5"],
                "motion.disturbance_rad_s",
                "torque",
            ),
        ] {
            let told = warnings(set);
            assert_eq!(told.len(), 1, "{set:?}: {told:?}");
            let is_of_key = told[0].contains(&format!(" {key}: has no effect"));
            assert!(is_of_key && told[0].contains(needs), "{set:?}: {told:?}");
        }
    }

    #[test]
    fn a_key_with_its_default_or_with_an_effect_is_not_told() {
        for set in [
            &["servo.scheme=image_pd", "servo.gain_1_s=15.0"][..],
            &["servo.depth=constant", "servo.constant_depth_m=0.4"],
            &["servo.scheme=image_pd", "servo.pd.feature_stiffness_nm=200"],
            &["servo.object.moves=true", "servo.object.acceleration_m_s2=1"],
        ] {
            assert_eq!(warnings(set), Vec::<String>::new(), "{set:?}");
        }
    }

    #[test]
    fn each_key_of_the_list_exists() {
        let Ok(all) = toml::Table::try_from(RawConfig::default()) else {
            unreachable!("defaults have a form")
        };
        let optional = ["servo.adaptive_gain", "servo.lead_ms", "motion.velocity_observer_rad_s"];
        for key in CONDITIONS.iter().flat_map(|one| one.keys) {
            assert!(at(&all, key).is_some() || optional.contains(key), "{key}");
        }
    }
}
