//! An arm that was recorded, for dry runs: it is where it was, at the same time since the begin, whatever it is told.
//!
//! ```text
//! recording ─► [`RecordedMotion`] ─► the state whose stamp is nearest to now - begin ─► read
//!                                    write ─► nothing
//! ```
//! The robot is what its drive told then: a protective stop that was recorded is one again. Commands are computed, checked and traced as before a real arm, and move nothing. What can be told only of an arm that obeys is not judged of this one
//! ([`ControllerSettings::obeys`](crate::control::controller::ControllerSettings)).

use super::{CommandMode, Drive, DriveCommand, DriveHealth, DriveState, RobotReport};
use crate::messages::{JointState, MAX_JOINTS, joint_flag};
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// A state counts for the ticks that are nearest to it: in real time neither the recorded ticks nor those of the run are exactly a millisecond apart.
const NEAREST: SpanNs = SpanNs(TICK.0 / 2);

/// What comes next of a recorded motion.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)] // it is moved through a ring, which has room for the largest in any case
pub enum NextState {
    /// A state, in the order of stamps, and what the drive told of its robot until then.
    State(JointState, RobotReport),
    /// The next state has not been read yet.
    Late,
    /// None follows.
    Over,
}

/// The states of a recorded arm; never waits in real time.
pub trait RecordedMotion: Send {
    /// The next one.
    fn next_state(&mut self) -> NextState;
}

/// The drive.
pub struct RecordedDrive<const N: usize> {
    motion: Box<dyn RecordedMotion>,
    /// The run's first tick, and the stamp of the first state, which belong together.
    begin: Option<MonoNs>,
    origin: Option<MonoNs>,
    state: DriveState<N>,
    robot: RobotReport,
    ahead: Option<(JointState, RobotReport)>,
    late_states: u64,
    /// Whether nothing came at the last tick.
    is_old: bool,
    is_over: bool,
}

impl<const N: usize> RecordedDrive<N> {
    /// The arm of `motion`, thought to stand in `q` (rad or m) until its first state has come.
    #[must_use]
    pub fn new(motion: Box<dyn RecordedMotion>, q: SVector<f64, N>) -> Self {
        Self {
            motion,
            begin: None,
            origin: None,
            state: DriveState { q, qd: SVector::zeros(), truth: None },
            robot: RobotReport::default(),
            ahead: None,
            late_states: 0,
            is_old: false,
            is_over: false,
        }
    }

    fn take(&mut self, recorded: &JointState) {
        let truth = recorded.flags & joint_flag::TRUTH != 0;
        self.state = DriveState {
            q: vector(&recorded.q),
            qd: vector(&recorded.qd),
            truth: truth.then(|| (vector(&recorded.q_true), vector(&recorded.qd_true))),
        };
    }
}

impl<const N: usize> Drive<N> for RecordedDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        self.is_old = false;
        let reached = (now + NEAREST) - *self.begin.get_or_insert(now);
        loop {
            if self.ahead.is_none() {
                match self.motion.next_state() {
                    NextState::State(state, robot) => self.ahead = Some((state, robot)),
                    NextState::Late => {
                        self.late_states += 1;
                        self.is_old = true;
                        break;
                    }
                    NextState::Over => {
                        self.is_over = true;
                        break;
                    }
                }
            }
            let Some((next, robot)) = self.ahead else { break };
            let origin = *self.origin.get_or_insert(next.stamp);
            if next.stamp - origin > reached {
                break;
            }
            self.ahead = None;
            self.take(&next);
            self.robot = robot;
        }
        self.state
    }

    fn write(&mut self, _command: &DriveCommand<N>) {}

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }

    fn health(&self) -> DriveHealth {
        let (late_states, is_old, robot) = (self.late_states, self.is_old, self.robot);
        DriveHealth { late_states, is_old, robot, fault: None }
    }

    fn is_over(&self) -> bool {
        self.is_over
    }
}

fn vector<const N: usize>(v: &[f64; MAX_JOINTS]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| v.get(i).copied().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::RobotState;
    use std::collections::VecDeque;

    struct Listed(VecDeque<NextState>);

    impl RecordedMotion for Listed {
        fn next_state(&mut self) -> NextState {
            self.0.pop_front().unwrap_or(NextState::Over)
        }
    }

    fn at(stamp_us: i64, q: f64) -> NextState {
        let mut state =
            JointState { stamp: MonoNs(7_000_000_000 + stamp_us * 1000), ..JointState::default() };
        (state.q[0], state.qd[0]) = (q, -q);
        NextState::State(state, RobotReport::default())
    }

    fn drive(states: &[NextState]) -> RecordedDrive<1> {
        RecordedDrive::new(Box::new(Listed(states.iter().copied().collect())), SVector::zeros())
    }

    #[test]
    fn each_tick_has_the_nearest_state_since_the_begin() {
        // Ticks with the jitter of real time, one of which was missed.
        let mut arm = drive(&[at(0, 0.0), at(1030, 1.0), at(1990, 2.0), at(4010, 4.0)]);
        let read: Vec<_> =
            [0, 1000, 2040, 3000, 3990].map(|us| arm.read(MonoNs(5_000 + us * 1000)).q[0]).into();
        assert_eq!(read, [0.0, 1.0, 2.0, 2.0, 4.0]);
        assert!(arm.is_over(), "with the last state it is known that none follows");
        arm.write(&DriveCommand {
            tau: SVector::zeros(),
            q_r: SVector::zeros(),
            qd_r: SVector::zeros(),
            qdd_r: SVector::zeros(),
        });
        assert_eq!(arm.read(MonoNs(9_000_000)).q[0], 4.0, "it stays where it was last");
        assert_eq!(arm.health().late_states, 0);
    }

    #[test]
    fn the_robot_is_what_it_was_at_that_time() {
        let stopped = RobotReport { state: RobotState::ProtectiveStop, code: 17 };
        let of = |stamp_us, robot| match at(stamp_us, 0.0) {
            NextState::State(state, _) => NextState::State(state, robot),
            other => other,
        };
        let ready = RobotReport { state: RobotState::Ready, code: 0 };
        let mut arm = drive(&[of(0, ready), of(1000, stopped), of(2000, ready)]);
        let told: Vec<_> = [0, 1, 2]
            .map(|ms| {
                arm.read(MonoNs(ms * 1_000_000));
                arm.health().robot
            })
            .into();
        assert_eq!(told, [ready, stopped, ready]);
    }

    #[test]
    fn a_state_that_was_not_read_in_time_is_late_and_no_end() {
        let mut arm = drive(&[at(0, 0.5), NextState::Late, NextState::Late, at(1000, 1.0), at(2000, 2.0)]);
        let read: Vec<_> = [0, 1, 2].map(|ms| arm.read(MonoNs(ms * 1_000_000)).q[0]).into();
        assert_eq!((read, arm.health().late_states, arm.is_over()), (vec![0.5, 0.5, 2.0], 2, true));
    }
}
