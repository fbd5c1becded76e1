//! What a run takes over from what its drive tells of itself: its period, its lag where the run file does not say one, and torques that rise no more quickly than it takes them.
//!
//! ```text
//! gate        |tau_i - tau_i of the tick before| <= rate_i T,  rate_i the smaller of the drive's and effort_i / motion.effort_rise_ms
//! reference   jerk_i = s max_jerk_i,  s = min(1, SHARE rate_i / sum_j |B_ij(q_start)| max_jerk_j)
//! ```
//! The first is what a drive can count on, whatever is asked for; the second lets a reference ask for little of what would have to be cut, because a loop whose torques are cut
//! again and again swings.

use crate::config::Config;
use crate::drive::{CommandMode, DriveProperties};
use crate::robot::Robot;
use crate::time::SpanNs;
use nalgebra::SVector;

/// Share of the rates that the acceleration of the reference may need at the start posture. Chosen by hand: the other half is for the weight, for friction, for the joint controller, and for
/// postures in which the arm is more inert.
const SHARE: f64 = 0.5;

/// The configuration of a run before a drive that told this of itself, and the share of the jerk limits that is left in it.
#[must_use]
pub fn before_drive<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    told: &DriveProperties,
) -> (Config, f64) {
    let takes_torques = config.drive.mode == CommandMode::Torque && told.effort_rate.len() == N;
    let (mut config, share) = match takes_torques {
        true => within_effort_rates(config, robot, &told.effort_rate),
        false => (config.clone(), 1.0),
    };
    config.drive.period = told.period;
    if let Some(lag) = told.lag {
        config = behind_lag(config, robot, lag);
    }
    (config, share)
}

/// The configuration of a run whose arm is behind its commands by this. What the run file says itself stays.
fn behind_lag<const N: usize>(mut config: Config, robot: &Robot<N>, lag: SpanNs) -> Config {
    if config.effective.servo.lead_ms.is_none() {
        config.servo.lead = lag;
    }
    if config.effective.safety.max_tracking_error_rad_or_m.is_none() {
        config.safety.max_tracking_error += way_behind(robot, lag);
    }
    config
}

/// How far the fastest joint is behind by a lag, rad or m.
fn way_behind<const N: usize>(robot: &Robot<N>, lag: SpanNs) -> f64 {
    lag.as_s() * robot.limits().iter().map(|limit| limit.velocity).fold(0.0, f64::max)
}

/// What the run file says otherwise than a drive does of its lag, in words.
#[must_use]
pub fn contradicted_lag<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    told: &DriveProperties,
) -> Vec<String> {
    let Some(lag) = told.lag else { return Vec::new() };
    let lag_ms = lag.as_s() * 1e3;
    let mut words = Vec::new();
    let lead_ms = config.effective.servo.lead_ms.filter(|lead_ms| !told.agrees_with_lag(*lead_ms));
    if let Some(lead_ms) = lead_ms {
        words.push(format!(
            "the drive's arm is {lag_ms:.0} ms behind its commands, and servo.lead_ms = {lead_ms} of the run file says otherwise: that is kept to; leave it out for what the drive tells"
        ));
    }
    let (most, behind) = (config.effective.safety.max_tracking_error_rad_or_m, way_behind(robot, lag));
    if let Some(most) = most.filter(|most| *most < behind) {
        words.push(format!(
            "the drive's arm is {lag_ms:.0} ms behind its commands, which is {behind:.2} rad or m at the fastest joint's limit: safety.max_tracking_error_rad_or_m = {most} of the run file ends a quick run; leave it out for what goes with the drive"
        ));
    }
    words
}

/// The configuration of a run whose drive takes torques at these rates, N m/s or N/s of each joint, and the share of the jerk limits that is left in it.
fn within_effort_rates<const N: usize>(config: &Config, robot: &Robot<N>, rates: &[f64]) -> (Config, f64) {
    let mut slower = config.clone();
    slower.motion.effort_rates = rates.to_vec();
    let (jerk, q) = (&config.motion.max_jerk, &config.start.q);
    let of_joint = |list: &[f64], i: usize| list.get(i).copied().unwrap_or(0.0);
    let inertia = robot.mass_matrix(&SVector::from_fn(|i, _| of_joint(q, i)));
    let share = (0..N).zip(rates).map(|(i, rate)| {
        let needed: f64 = (0..N).map(|j| inertia[(i, j)].abs() * of_joint(jerk, j)).sum();
        if needed > 0.0 { SHARE * rate / needed } else { 1.0 }
    });
    let share = share.fold(1.0, f64::min);
    slower.motion.max_jerk.iter_mut().for_each(|jerk| *jerk *= share);
    (slower, share)
}

/// Largest change of each joint's torque in a second, N m/s or N/s.
pub(super) fn effort_rate<const N: usize>(config: &Config, robot: &Robot<N>) -> SVector<f64, N> {
    let (limits, motion) = (robot.limits(), &config.motion);
    SVector::from_fn(|i, _| {
        let own = limits.get(i).map_or(0.0, |limit| limit.effort) / motion.effort_rise.as_s();
        motion.effort_rates.get(i).map_or(own, |rate| own.min(*rate))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the drive tells counts where the run file says nothing, and the run file where it does, which is told.
    #[test]
    fn a_lag_is_taken_over_where_the_run_file_says_none() {
        let lag = |set: &[&str], ms: f64| {
            let set: Vec<_> = set.iter().map(ToString::to_string).collect();
            let config = Config::load(Some("ur5".as_ref()), &set).unwrap();
            let robot: Robot<6> = config.robot.build().unwrap();
            let told = DriveProperties { lag: Some(SpanNs::from_s(1e-3 * ms)), ..Default::default() };
            let before = before_drive(&config, &robot, &told).0;
            let lead_ms = before.servo.lead.as_s() * 1e3;
            (lead_ms, before.safety.max_tracking_error, contradicted_lag(&config, &robot, &told).join("\n"))
        };
        let fastest = 1.0_f64.max(std::f64::consts::PI);
        for ms in [0.0, 38.0, 130.0] {
            let (lead_ms, most, words) = lag(&[], ms);
            assert!((lead_ms - ms).abs() < 1e-6, "{lead_ms}");
            assert!((most - 0.1 - 1e-3 * ms * fastest).abs() < 0.02 * most, "{most}");
            assert_eq!(words, "");
        }
        let own = ["servo.lead_ms=38", "safety.max_tracking_error_rad_or_m=0.25"];
        let (lead_ms, most, words) = lag(&own, 40.0);
        assert_eq!((lead_ms, most, words.as_str()), (38.0, 0.25, ""));
        let (lead_ms, most, words) = lag(&own, 130.0);
        assert_eq!((lead_ms, most), (38.0, 0.25));
        assert!(
            words.contains("130 ms behind its commands, and servo.lead_ms = 38")
                && words.contains("error_rad_or_m = 0.25"),
            "{words}"
        );
    }

    #[test]
    fn quick_drives_change_nothing_and_slow_ones_the_jerk() {
        let config = Config::load(None, &[]).unwrap();
        let robot: Robot<4> = config.robot.build().unwrap();
        let own = effort_rate(&config, &robot);
        let (quick, share) = within_effort_rates(&config, &robot, &[1e9; 4]);
        assert_eq!((share, effort_rate(&quick, &robot)), (1.0, own));
        assert_eq!(quick.motion.max_jerk, config.motion.max_jerk);
        let rates: Vec<f64> = own.iter().map(|rate| rate / 40.0).collect();
        let (slow, share) = within_effort_rates(&config, &robot, &rates);
        assert_eq!(effort_rate(&slow, &robot).as_slice(), rates);
        assert!(share > 0.0 && share < 0.5, "{share}");
        let inertia = robot.mass_matrix(&SVector::from_column_slice(&config.start.q));
        let jerk = SVector::<f64, 4>::from_column_slice(&slow.motion.max_jerk);
        let needed = inertia.abs() * jerk;
        assert!(
            needed.iter().zip(&rates).all(|(needed, rate)| *needed <= 0.5001 * rate),
            "{needed} {rates:?}"
        );
    }
}
