//! The watch over arms that are integrated here, and over drives of several rates.

use super::*;
use crate::motion::{InverseDynamicsControl, JointLaw, ObserverSettings};
use nalgebra::Vector6;

/// An arm that moves to and fro by 8 rad/s^2, of whose ticks twelve in a row may be missed; the most standard deviations after 1.5 s. `told`: the times say so.
fn felt_with_a_gap(gap: bool, told: bool) -> f64 {
    let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
    let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0));
    let mut control = JointController::new(law, ObserverSettings::none());
    let mut watch = ContactWatch::new(&robot, &control, CommandMode::Torque);
    let home = Vector6::new(0.4, -1.4, 1.3, -1.0, -1.5, 0.3);
    let (mut q, mut qd) = (home, Vector6::zeros());
    let (mut most, mut ticks) = (0.0_f64, 0);
    for k in 0..3000_i64 {
        let qdd = Vector6::repeat(8.0 * (k as f64 * 8e-3).cos());
        let tau = robot.inverse_dynamics(&q, &qd, &qdd);
        (q, qd) = robot.integrate(&q, &qd, &tau, 1e-3);
        if gap && (1500..1512).contains(&k) {
            continue;
        }
        ticks += 1;
        let timing = DriveTiming::default();
        let now = MonoNs(if told { k } else { ticks } * 1_000_000);
        let state = DriveState { q, qd, truth: None };
        let command = DriveCommand { tau, q_r: q, qd_r: qd, qdd_r: SVector::zeros() };
        watch.note((now, timing), &robot, &mut control, Some((&state, &command)), None);
        if k > 1500 {
            most = most.max(watch.excess().max());
        }
    }
    most
}

#[test]
fn ticks_that_were_missed_are_no_contact() {
    let [none, told, untold] =
        [(false, true), (true, true), (true, false)].map(|(gap, told)| felt_with_a_gap(gap, told));
    assert!(none < 1.0 && told < 1.0, "an arm that is its model: {none} {told}");
    assert!(untold > 3.0, "it would be felt otherwise: {untold}");
}

/// A joint behind a drive with a state every `period` ms, which follows its reference `lag` ms late until `stop` and then stands: when something holds it.
fn held_behind(mode: CommandMode, period: i64, lag: i64, stop: i64) -> Option<i64> {
    let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
    let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0));
    let mut control = JointController::new(law, ObserverSettings::none());
    let mut watch = ContactWatch::new(&robot, &control, mode);
    let mut timing = DriveTiming::default();
    let reference = |ms: i64| Vector6::repeat(-0.4 * (1.0 - (1e-3 * ms as f64 * 2.0).cos()));
    let speed = |ms: i64| (reference(ms + 1) - reference(ms)) * 1e3;
    (0..3000).find(|&ms| {
        let seen = ms - ms % period;
        let at = (seen - lag).clamp(0, stop);
        let state = DriveState {
            q: reference(at),
            qd: if at < stop { speed(at) } else { SVector::zeros() },
            truth: None,
        };
        timing.note(seen != ms);
        let command = DriveCommand {
            tau: SVector::zeros(),
            q_r: reference(ms + 1),
            qd_r: speed(ms),
            qdd_r: SVector::zeros(),
        };
        watch.note((MonoNs(ms * 1_000_000), timing), &robot, &mut control, Some((&state, &command)), None);
        watch.is_touched()
    })
}

#[test]
fn a_joint_that_is_held_behind_a_slower_drive_is_told() {
    for (mode, lag) in [(CommandMode::Position, 34), (CommandMode::Velocity, 4)] {
        for period in [1, 2, 4, 8] {
            assert_eq!(held_behind(mode, period, lag, i64::MAX), None, "{mode:?} {period} ms: free");
            let held = held_behind(mode, period, lag, 400).unwrap_or(i64::MAX);
            assert!(held < 400 + lag + 80, "{mode:?} {period} ms: {held}");
        }
    }
}

#[test]
fn a_force_at_the_flange_is_found_from_the_joints_torques() {
    let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
    let q = Vector6::new(0.4, -1.4, 1.3, -1.0, -1.5, 0.3);
    for wanted in [Vector3::new(30.0, 0.0, 0.0), Vector3::new(-5.0, 12.0, 40.0)] {
        let torque = robot.jacobian(&q).fixed_rows::<3>(0).tr_mul(&wanted);
        let found = force(&robot, &q, &torque, &Vector6::repeat(0.5)).unwrap();
        assert!((found - wanted).norm() < 0.01 * wanted.norm(), "{found} {wanted}");
    }
}

#[test]
fn what_holds_one_joint_is_no_force_at_the_flange() {
    let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
    let q = Vector6::new(0.4, -1.4, 1.3, -1.0, -1.5, 0.3);
    for joint in 0..6 {
        let mut torque = Vector6::zeros();
        torque[joint] = 30.0;
        assert_eq!(force(&robot, &q, &torque, &Vector6::repeat(0.5)), None, "joint {joint}");
    }
}

/// A joint behind a drive that closes its own loop, which goes on at a tenth of what is commanded from 1 s on, as it does that pushes something away.
fn slowed_behind(mode: CommandMode, period: i64, lag: i64, slows: bool) -> Option<i64> {
    let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
    let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0));
    let mut control = JointController::new(law, ObserverSettings::none());
    let mut watch = ContactWatch::new(&robot, &control, mode);
    let mut timing = DriveTiming::default();
    let reference = |ms: i64| -0.4 * (1.0 - (2e-3 * ms as f64).cos());
    let place = |ms: i64| match ms {
        ms if ms < 1000 || !slows => reference(ms),
        ms => reference(1000) + 0.1 * (reference(ms) - reference(1000)),
    };
    (0..3000).find(|&ms| {
        let at = (ms - ms % period - lag).max(0);
        let speed = |ms: i64, place: &dyn Fn(i64) -> f64| Vector6::repeat((place(ms + 1) - place(ms)) * 1e3);
        let state = DriveState { q: Vector6::repeat(place(at)), qd: speed(at, &place), truth: None };
        timing.note(ms % period != 0);
        let command = DriveCommand {
            tau: SVector::zeros(),
            q_r: Vector6::repeat(reference(ms + 1)),
            qd_r: speed(ms, &reference),
            qdd_r: SVector::zeros(),
        };
        watch.note((MonoNs(ms * 1_000_000), timing), &robot, &mut control, Some((&state, &command)), None);
        watch.is_touched()
    })
}

#[test]
fn lags_tell_a_contact_behind_slower_drives() {
    for (mode, lag) in [(CommandMode::Position, 34), (CommandMode::Velocity, 4)] {
        for period in [1, 2, 4, 8] {
            assert_eq!(slowed_behind(mode, period, lag, false), None, "{mode:?} {period} ms: free");
            let at = slowed_behind(mode, period, lag, true).unwrap_or(i64::MAX);
            // 0.7 rad/s: 20 mrad after 30 ms, and what its noise is taken for.
            assert!((1000..1000 + lag + 100).contains(&at), "{mode:?} {period} ms: {at}");
        }
    }
}
