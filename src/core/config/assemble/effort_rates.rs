//! Torques that rise no more quickly than a drive takes them.
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
    (config, share)
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
