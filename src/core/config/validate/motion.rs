//! `[motion]`: limits and gains, one for all joints or one each, and a controller that fits the drive.

use crate::config::check::Validation;
use crate::config::raw::{DriveKind, JointControl, RawConfig};
use crate::config::{Motion, SimulatedArm};
use crate::drive::CommandMode;
use crate::robot::RobotDescription;
use std::ops::RangeInclusive;

/// Bandwidth of the velocity observer where encoders have steps or noise. Measured (`tests/cores/everything_at_once.rs`): with 150 rad/s 57 of 120 arms came home, with
/// 300 72, with 400 78, with 600 fewer again; the observer takes less where steps are coarse.
const VELOCITY_OBSERVER_RAD_S: f64 = 400.0;
/// The same where noise is more than a step. Measured: before noise of 1e-4 rad a UR5, a Panda and the SCARA tremble by 0.07, 0.08 and 0.06 px, and by 0.16, 0.22 and 0.19 px with 150 rad/s and
/// noise that is taken for a step; 30 rad/s leave a tenth less, and are below the natural frequency of the joint controllers.
const VELOCITY_OBSERVER_OF_NOISE_RAD_S: f64 = 50.0;
/// Standard deviations of its noise within which a position says little. Chosen by hand: 95 % of the readings are within two.
const NOISE_SDS: f64 = 2.0;

/// The table `[motion]` for the joints of `robot`, where there is one, and a drive that obeys `mode`, of which
/// `arm` is what it is like where it is simulated.
pub(super) fn motion(
    raw: &RawConfig,
    (mode, arm): (CommandMode, &SimulatedArm),
    robot: Option<&RobotDescription>,
    check: &mut Validation<'_>,
) -> Motion {
    let m = &raw.motion;
    let joints = robot.map(RobotDescription::joint_count);
    if m.controller == JointControl::PassThrough && mode == CommandMode::Torque {
        check.wrong(
            "motion.controller",
            "pass_through gives no torque, and the drive is commanded by torque: set drive.mode to velocity or position, \
             or take inverse_dynamics, operational_space or pd_gravity",
        );
    }
    let pd = m.controller == JointControl::PdGravity;
    for (key, list) in [
        ("motion.stiffness_n_m_rad_or_n_m", &m.stiffness_n_m_rad_or_n_m),
        ("motion.damping_n_m_s_rad_or_n_s_m", &m.damping_n_m_s_rad_or_n_s_m),
    ] {
        if !pd && !list.is_empty() {
            check.wrong(key, "is a gain of motion.controller = \"pd_gravity\" alone");
        }
    }
    let mut optional = |key: &str, list: &[f64], most: f64| {
        if list.is_empty() { Vec::new() } else { joint_list(key, list, joints, 0.0..=most, check) }
    };
    let stiffness = optional("motion.stiffness_n_m_rad_or_n_m", &m.stiffness_n_m_rad_or_n_m, 1e7);
    let damping = optional("motion.damping_n_m_s_rad_or_n_s_m", &m.damping_n_m_s_rad_or_n_s_m, 1e7);
    let told = optional("motion.encoder_step_rad_or_m", &m.encoder_step_rad_or_m, 0.1);
    // What is simulated is known, if nothing else was said.
    let simulated = raw.drive.kind == DriveKind::Simulated;
    let steps = || arm.encoder_step.iter().zip(&arm.encoder_noise_sd);
    let (encoder_step, encoder_noise) = match (told.is_empty(), joints) {
        (true, Some(_)) if simulated => (
            steps().map(|(step, sd)| step + NOISE_SDS * sd).collect(),
            steps().map(|(_, sd)| NOISE_SDS * sd).collect(),
        ),
        (true, Some(joints)) => (vec![0.0; joints], vec![0.0; joints]),
        _ => {
            let joints = told.len();
            (told, vec![0.0; joints])
        }
    };
    let observer_rad_s = if !simulated || steps().all(|(step, sd)| *step == 0.0 && *sd == 0.0) {
        0.0
    } else if encoder_noise.iter().any(|noise| *noise > 0.0) && steps().any(|(step, sd)| sd > step) {
        VELOCITY_OBSERVER_OF_NOISE_RAD_S
    } else {
        VELOCITY_OBSERVER_RAD_S
    };
    Motion {
        stiffness,
        damping,
        disturbance_rad_s: check.range("motion.disturbance_rad_s", m.disturbance_rad_s, 0.0..=300.0),
        velocity_observer_rad_s: m.velocity_observer_rad_s.map_or(observer_rad_s, |bandwidth| {
            check.range("motion.velocity_observer_rad_s", bandwidth, 0.0..=400.0)
        }),
        encoder_step,
        encoder_noise,
        max_acceleration: joint_list(
            "motion.max_acceleration_rad_s2_or_m_s2",
            &m.max_acceleration_rad_s2_or_m_s2,
            joints,
            1e-3..=1e4,
            check,
        ),
        max_jerk: joint_list(
            "motion.max_jerk_rad_s3_or_m_s3",
            &m.max_jerk_rad_s3_or_m_s3,
            joints,
            1e-2..=1e7,
            check,
        ),
        controller: m.controller,
        effort_rise: check.span_ms("motion.effort_rise_ms", m.effort_rise_ms, 0.1..=10_000.0),
        effort_rates: Vec::new(),
        natural_frequency_rad_s: check.range(
            "motion.natural_frequency_rad_s",
            m.natural_frequency_rad_s,
            1.0..=300.0,
        ),
        damping_ratio: check.range("motion.damping_ratio", m.damping_ratio, 0.1..=5.0),
    }
}

/// A list with one entry for each joint, made from one that has one entry for all or one for each.
pub(super) fn joint_list(
    key: &str,
    list: &[f64],
    joints: Option<usize>,
    allowed: RangeInclusive<f64>,
    check: &mut Validation<'_>,
) -> Vec<f64> {
    for (i, value) in list.iter().enumerate() {
        check.range(&format!("{key}[{i}]"), *value, allowed.clone());
    }
    match (list, joints) {
        (_, None) => Vec::new(),
        ([one], Some(joints)) => vec![*one; joints],
        (list, Some(joints)) if list.len() == joints => list.to_vec(),
        (list, Some(joints)) => {
            check.wrong(key, format!("has {} entries, needs 1 or {joints}", list.len()));
            Vec::new()
        }
    }
}
