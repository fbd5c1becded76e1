//! An arm in another process: a simulator, or the driver of a real robot, behind messages.
//!
//! ```text
//! DriveLink::receive ─► newest DriveStateMsg ─► read    (late? too old?)
//! DriveLink::send    ◄─ DriveCommandMsg      ◄─ write
//! ```
//! How messages travel is the link's matter; nothing here waits or allocates.

use super::{
    CommandMode, Drive, DriveCommand, DriveFault, DriveHealth, DriveState, RobotReport, TorqueContents,
};
use crate::messages::{DriveCommandMsg, DriveStateMsg, MAX_JOINTS, RobotState, drive_flag};
use crate::robot::Robot;
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// The slowest cycle of a drive, 125 Hz (a CB3 of Universal Robots), so that one whose first states are far apart is not taken for slower.
const SLOWEST: SpanNs = SpanNs(8_000_000);
/// A state older than this is old even if it is new: sampled in the tick before the last one. A slower drive is late by its cycle, less a tick, after that.
const LATE: SpanNs = SpanNs(2 * TICK.0);

/// Carries messages to and from a drive; never waits.
pub trait DriveLink: Send {
    /// The next state that has come, oldest first.
    fn receive(&mut self) -> Option<DriveStateMsg>;

    /// Sends a command; one that cannot be taken is lost.
    fn send(&mut self, command: &DriveCommandMsg);
}

/// The controller's end of an external drive.
pub struct ExternalDrive<const N: usize> {
    link: Box<dyn DriveLink>,
    mode: CommandMode,
    timeout: SpanNs,
    state: DriveState<N>,
    /// The torques that the newest state carries; `None` where all are zero, which drives send that measure none.
    measured: Option<SVector<f64, N>>,
    /// When `state` was sampled.
    stamp: MonoNs,
    /// Shortest time between two states; none before the second.
    cycle: Option<SpanNs>,
    /// When a new state was last found.
    fresh_at: MonoNs,
    first: Option<MonoNs>,
    now: MonoNs,
    /// That of the last command.
    last_tick: Option<u64>,
    health: DriveHealth,
    /// Whether the robot is asked to clear its error.
    clears: bool,
    contents: TorqueContents,
    /// The arm whose weight the robot holds by itself.
    self_carried: Option<Box<Robot<N>>>,
}

impl<const N: usize> ExternalDrive<N> {
    /// A drive behind `link`, commanded by `mode`, whose states may be no older than `timeout`; its arm is thought to
    /// rest in `q` until it says otherwise.
    #[must_use]
    pub fn new(link: Box<dyn DriveLink>, mode: CommandMode, timeout: SpanNs, q: SVector<f64, N>) -> Self {
        Self {
            link,
            mode,
            timeout,
            state: DriveState { q, qd: SVector::zeros(), truth: None },
            measured: None,
            stamp: MonoNs(i64::MIN),
            cycle: None,
            fresh_at: MonoNs::ZERO,
            first: None,
            now: MonoNs::ZERO,
            last_tick: None,
            health: DriveHealth::default(),
            clears: false,
            contents: TorqueContents::WHOLE,
            self_carried: None,
        }
    }

    /// Sends torques with these contents alone. Without gravity the weight of `robot`, tool included, is taken from them; without friction
    /// control must know of none, and nothing is taken from them here.
    #[must_use]
    pub fn with_contents(mut self, contents: TorqueContents, robot: Robot<N>) -> Self {
        self.contents = contents;
        self.self_carried = (!contents.gravity && self.mode == CommandMode::Torque).then(|| Box::new(robot));
        self
    }

    fn send(&mut self, command: &DriveCommand<N>, tick: u64, flags: u32) {
        let weight =
            self.self_carried.as_ref().map_or(SVector::zeros(), |robot| robot.gravity(&self.state.q));
        self.link.send(&DriveCommandMsg {
            tick,
            sequence: 0, // whoever sends it counts
            stamp: self.now,
            joints: N as u32,
            mode: self.mode as u32,
            flags: flags | self.contents.flags(self.mode),
            arm: 0,
            q_r: padded(&command.q_r),
            qd_r: padded(&command.qd_r),
            qdd_r: padded(&command.qdd_r),
            tau: padded(&(command.tau - weight)),
        });
    }

    /// The cycle of the drive is the shortest time between two of its states: a drive slower than control is not late in the ticks between.
    fn note_cycle(&mut self, stamp: MonoNs) {
        if self.stamp.0 != i64::MIN && stamp > self.stamp {
            let between = stamp - self.stamp;
            self.cycle = Some(self.cycle.map_or(between, |cycle| cycle.min(between)));
        }
    }

    fn note_lateness(&mut self, now: MonoNs, fresh: bool) {
        let cycle = self.cycle.map_or(TICK, |cycle| cycle.clamp(TICK, SLOWEST));
        let is_due = now - self.fresh_at >= cycle;
        if fresh {
            self.fresh_at = now;
        }
        let age = now - self.stamp;
        self.health.is_old = !fresh || age > LATE;
        let is_late = (!fresh && is_due) || age > SpanNs(LATE.0 + cycle.0 - TICK.0);
        self.health.late_states += u64::from(is_late);
    }

    fn take(&mut self, m: &DriveStateMsg) {
        if m.joints as usize != N {
            self.health.fault.get_or_insert(DriveFault::OutOfStep);
            return;
        }
        let truth = m.flags & drive_flag::TRUTH != 0;
        self.state = DriveState {
            q: vector(&m.q),
            qd: vector(&m.qd),
            truth: truth.then(|| (vector(&m.q_true), vector(&m.qd_true))),
        };
        self.measured = Some(vector(&m.tau)).filter(|tau: &SVector<f64, N>| tau.amax() > 0.0);
        self.health.robot = RobotReport { state: RobotState::from_code(m.robot_state), code: m.robot_code };
        self.stamp = m.stamp;
    }
}

impl<const N: usize> Drive<N> for ExternalDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        let first = *self.first.get_or_insert(now);
        self.now = now;
        let mut fresh = false;
        while let Some(state) = self.link.receive() {
            if state.stamp >= self.stamp {
                self.note_cycle(state.stamp);
                self.take(&state);
                fresh = true;
            }
        }
        self.note_lateness(now, fresh);
        // Before the first tick the arm is held by the drive: the wait for the loop to start does not count.
        if now - self.stamp.max(first) > self.timeout {
            self.health.fault.get_or_insert(DriveFault::Stale);
        }
        self.state
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        let tick = ((self.now - self.first.unwrap_or(self.now)).0 / TICK.0).max(0).unsigned_abs();
        self.send(command, tick, if self.clears { drive_flag::CLEAR } else { 0 });
        self.last_tick = Some(tick);
    }

    fn measured_torque(&self) -> Option<SVector<f64, N>> {
        self.measured
    }

    /// What the drive takes is asked when it is connected, before the first tick.
    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }

    fn health(&self) -> DriveHealth {
        self.health
    }

    fn reset(&mut self) {
        self.health.fault = None;
    }

    fn clear_robot(&mut self, asked: bool) {
        self.clears = asked;
    }

    fn end(&mut self, last: &DriveCommand<N>) {
        if let Some(tick) = self.last_tick.take() {
            self.send(last, tick + 1, drive_flag::LAST);
        }
    }
}

fn vector<const N: usize>(v: &[f64; MAX_JOINTS]) -> SVector<f64, N> {
    SVector::from_iterator(v.iter().copied().chain(std::iter::repeat(0.0)).take(N))
}

fn padded<const N: usize>(v: &SVector<f64, N>) -> [f64; MAX_JOINTS] {
    let mut out = [0.0; MAX_JOINTS];
    for (to, from) in out.iter_mut().zip(v.iter()) {
        *to = *from;
    }
    out
}

#[cfg(test)]
mod tests;
