//! Whether the arm may move, and what has to be switched before.

use super::{Arm, ArmState};
use crate::UrError;
use crate::dashboard::Dashboard;
use crate::robot::{RobotMode, RuntimeState};
use std::time::Duration;

/// Longest time for the motors to get power, and for the brakes to open. Chosen by hand: an e-Series boots in half a minute.
const POWER: Duration = Duration::from_secs(60);
const BRAKES: Duration = Duration::from_secs(20);
/// A slider below this share slows the arm. Derived: it is told in whole percents, and what is told as 100 % is that.
pub(super) const SLIDER: f64 = 0.995;

/// Longest wait for the end of a program that is still there. Derived: one that an earlier session of this driver left ends by its watchdog after 0.1 s, and brakes for
/// 0.8 s from 3 rad/s; as much again for a robot that is slow.
const ENDS: Duration = Duration::from_secs(2);

impl Arm {
    /// Sees to it that the arm may move: refuses in words what somebody must see to. With `enable` the motors get power and the brakes are opened;
    /// a stop is never unlocked here. Whether it may: `false` where `stop`, which is asked while that is waited for, said that nobody wants it any more.
    ///
    /// # Errors
    /// When the robot is stopped, not powered, slowed down, not under remote control, or moved by another program.
    pub fn make_ready(&mut self, enable: bool, stop: &dyn Fn() -> bool) -> Result<bool, UrError> {
        let state = self.newest()?;
        if !state.safety.lets_move() {
            return Err(UrError::Stopped { safety: state.safety });
        }
        if state.mode != RobotMode::Running {
            if !enable {
                return Err(UrError::NotRunning { mode: state.mode });
            }
            self.enable(stop)?;
        }
        if stop() {
            return Ok(false);
        }
        let state = self.newest()?;
        if state.slider < SLIDER {
            return Err(UrError::SpeedSlider { percent: 100.0 * state.slider });
        }
        let mut dashboard =
            Dashboard::connect(self.settings.host, self.settings.patience, self.settings.clock)?;
        if !dashboard.is_under_remote_control(self.series)? {
            return Err(UrError::LocalControl);
        }
        // The controller would end it for ours, in the middle of whatever it does with the arm.
        let is_free = |s: &ArmState| s.runtime == RuntimeState::Stopped && s.rests();
        if self.await_state(ENDS, |s| is_free(s) || stop())?.is_none() {
            let runtime = self.last.map_or(state.runtime, |s| s.runtime);
            return Err(UrError::OtherProgram { runtime });
        }
        Ok(!stop())
    }

    fn enable(&mut self, stop: &dyn Fn() -> bool) -> Result<(), UrError> {
        let mut dashboard =
            Dashboard::connect(self.settings.host, self.settings.patience, self.settings.clock)?;
        let not_idle = |s: &ArmState| !matches!(s.mode, RobotMode::Idle | RobotMode::Running);
        if self.last.as_ref().is_some_and(not_idle) {
            dashboard.power_on()?;
            self.await_mode(POWER, stop, ("off", "power"), |mode| {
                mode == RobotMode::Idle || mode == RobotMode::Running
            })?;
        }
        if !stop() && self.last.is_some_and(|s| s.mode != RobotMode::Running) {
            dashboard.release_brakes()?;
            let ways = ("closed brakes", "open ones");
            self.await_mode(BRAKES, stop, ways, |mode| mode == RobotMode::Running)?;
        }
        Ok(())
    }

    fn await_mode(
        &mut self,
        patience: Duration,
        stop: &dyn Fn() -> bool,
        (from, to): (&'static str, &'static str),
        is: impl Fn(RobotMode) -> bool,
    ) -> Result<(), UrError> {
        let found = self.await_state(patience, |s| is(s.mode) || !s.safety.lets_move() || stop())?;
        match found.or(self.last) {
            Some(s) if !s.safety.lets_move() => Err(UrError::Stopped { safety: s.safety }),
            Some(s) if is(s.mode) || stop() => Ok(()),
            Some(ArmState { mode, safety, .. }) => {
                Err(UrError::NotEnabled { from, to, seconds: patience.as_secs_f64(), mode, safety })
            }
            None => Err(UrError::NotStarted),
        }
    }
}
