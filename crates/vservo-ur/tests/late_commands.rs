//! Commands that come late: behind the emulator the joints keep the acceleration that is allowed, whatever the rate of states and robot.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Q, address, assert_at_rest, settings, started};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use vservo_ur::emulator::{Emulator, EmulatorSettings, JointModel, Torque};
use vservo_ur::{ArmSettings, Command, Joints, Series};

/// Largest acceleration that is commanded, rad/s2, and at how many radians a second the swing goes on: at 2 rad/s at most.
const MOST: f64 = 10.0;
const OMEGA: f64 = 5.0;

/// Stiff joints that remember how they moved: the first one's position and velocity in each cycle.
struct Watched {
    q: Joints,
    seen: Arc<Mutex<Vec<(f64, f64)>>>,
}

impl JointModel for Watched {
    fn step(&mut self, q: &Joints, qd: &Joints, _: f64) -> (Joints, Joints) {
        self.q = *q;
        self.seen.lock().unwrap().push((q[0], qd[0]));
        (*q, *qd)
    }

    fn push(&mut self, _: &Torque, _: f64) -> (Joints, Joints) {
        (self.q, [0.0; 6])
    }
}

/// The first joint swings from rest with the acceleration that is allowed: how far it is, its velocity and acceleration.
fn course(t: f64) -> (f64, f64, f64) {
    let (amplitude, phase) = (MOST / OMEGA / OMEGA, OMEGA * t);
    (amplitude * (1.0 - phase.cos()), amplitude * OMEGA * phase.sin(), MOST * phase.cos())
}

/// What a swing of some seconds does to the joints: the largest acceleration in a cycle, and the farthest that they were from where they should be behind a lag of `lag_s`.
/// States that `late` names by their number are not answered: the next command is later by so much.
fn swing(
    series: Series,
    rate_hz: f64,
    by_velocity: bool,
    lag_s: f64,
    late: impl Fn(u64) -> bool,
) -> (f64, f64) {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let joints = Box::new(Watched { q: Q, seen: Arc::clone(&seen) });
    let robot = Emulator::start(EmulatorSettings { address: address(), series, q: Q, running: true, joints })
        .unwrap();
    let second = Duration::from_secs(1);
    let limits = [MOST; 6];
    let mut arm = started(ArmSettings {
        rate_hz: Some(rate_hz),
        acceleration_rad_s2: limits,
        watchdog: second,
        silence: second,
        ..settings(&robot)
    })
    .unwrap();
    let (mut states, begin) = (0, arm.last().unwrap().robot_s);
    let mut apart: f64 = 0.0;
    let mut last = begin;
    while last - begin < 4.0 {
        let Some(state) = arm.next(Duration::from_millis(50)).unwrap() else { continue };
        last = state.robot_s;
        states += 1;
        let t = last - begin;
        if t > 1.0 {
            apart = apart.max((state.q[0] - Q[0] - course(t - lag_s).0).abs());
        }
        if late(states) {
            continue;
        }
        let (dq, v, a) = course(t);
        let (mut q, mut qd, mut qdd) = (Q, [0.0; 6], [0.0; 6]);
        (q[0], qd[0], qdd[0]) = (Q[0] + dq, v, a);
        let at = Some(state.stamp);
        let command = if by_velocity {
            Command::Velocity { qd, qdd, at }
        } else {
            Command::Position { q, qd, qdd, at }
        };
        arm.command(command).unwrap();
    }
    let cycles = seen.lock().unwrap().clone();
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    assert_eq!(robot.log(), [""; 0]);
    let changes = cycles.windows(2).map(|w| (w[1].1 - w[0].1).abs());
    (changes.fold(0.0, f64::max) * series.rate_hz(), apart)
}

/// Lag of `servoj`.
const SERVOJ_S: f64 = 0.034;

/// Single commands, two and three in a row, and all of 60 ms, again and again: without what the program does about it the joints take 20 to 50 rad/s2.
#[test]
fn late_commands_leave_the_acceleration_within_its_limit() {
    for (series, rate_hz) in
        [(Series::ESeries, 500.0), (Series::ESeries, 250.0), (Series::ESeries, 125.0), (Series::Cb3, 125.0)]
    {
        let per_60_ms = (0.06 * rate_hz) as u64;
        let late = move |k: u64| {
            let few = k % 50 == 7 || (20..22).contains(&(k % 50)) || (35..38).contains(&(k % 50));
            few || (k > 300 && k % 300 < per_60_ms)
        };
        for by_velocity in [false, true] {
            let (most, _) = swing(series, rate_hz, by_velocity, 0.0, late);
            assert!(most < 1.1 * MOST, "{series:?} {rate_hz} Hz, by velocity {by_velocity}: {most} rad/s2");
            assert!(most > 0.8 * MOST, "{most} rad/s2: it has swung");
        }
    }
}

/// Commands that come a little late are carried on: the joints are hardly farther from their course than without.
#[test]
fn late_commands_are_carried_on_to_their_instant() {
    let late = |k: u64| k % 10 < 4;
    let lag_s = SERVOJ_S;
    let (_, apart) = swing(Series::ESeries, 500.0, false, lag_s, |_| false);
    let (_, carried) = swing(Series::ESeries, 500.0, false, lag_s, late);
    assert!(apart < 0.01 && carried < apart + 2e-3, "{apart} {carried} rad");
}
