//! The guardian's process: watches the messages between control and an external drive, and stops the arm when control is late, dead, hung or wrong.
//!
//! ```text
//! drive/command, drive/state ─► Guardian (core) ─ finding ─► stop word ─┬─► the drive, in its next cycle: brakes by itself, and holds
//! /proc/CONTROL/stat ─────────►                                         └─► control, in its next tick: a fault until it is reset
//! ```
//! It looks each millisecond, sends nothing, and outlives control until the arm rests.

use super::priority::{self, Rank};
use super::{Membership, ProcessError, StopFlag};
use crate::config::{Clock, Config, DriveKind, RealtimePolicy, assemble};
use crate::guardian::{
    ControlLife, GuardedAxis, GuardedJoint, GuardedLimits, GuardedSide, GuardedSpace, GuardedSphere,
    Guardian, GuardianFinding,
};
use crate::ipc::{Halt, Instance, IpcError, Receiver, Role, StopWord, process_state};
use crate::messages::{DriveCommandMsg, DriveStateMsg, drive_flag};
use crate::motion::{ArmPlaces, CheckedPoint, HalfSpace, WorkspaceSettings, checked_points};
use crate::robot::Robot;
use crate::rt::{now, prepare_process, sleep_until};
use crate::time::{SpanNs, TICK};
use tracing::{error, info};

/// Longest wait, after the end of control, for an arm that does not rest. Chosen by hand: as long as `vservo-drive-ur` waits for that.
pub(super) const OUTLIVES: SpanNs = SpanNs(3_000_000_000);

/// Whether a run of `config` has a guardian: an arm in control's own process stands when that does, and simulated time waits for everybody.
pub(crate) fn is_wanted(config: &Config) -> bool {
    config.safety.guardian && config.clock == Clock::Realtime && config.drive.kind == DriveKind::External
}

/// Guards the run of `instance` until a stop is requested, control has ended, and the arm rests.
///
/// # Errors
/// When the instance cannot be joined, or its messages are not received while no run is under way.
pub fn run(config: &Config, instance: &Instance, stop: &StopFlag) -> Result<(), ProcessError> {
    let limits = limits(config)?;
    let membership = Membership::join(instance, Role::Guardian, config)?;
    if config.realtime.policy != RealtimePolicy::Off
        && let Some(Err(refusal)) = prepare_process(&config.realtime.request)
    {
        info!("memory not locked ({refusal})");
    }
    priority::take(config, Rank::Guardian)?;
    let (commands, states) = membership.services().drive_recorders()?;
    membership.services().require_room_for_peers()?;
    let mut watch = GuardianWatch {
        instance,
        commands,
        states,
        guardian: Guardian::new(limits),
        word: None,
        joint_names: config.robot.joint_names(),
    };
    // From here on nothing that is sent is missed: the supervisor starts control now.
    membership.tell_progress(1);
    let (mut next, mut over) = (now(), None);
    loop {
        membership.beat();
        watch.look()?;
        if stop.is_requested() && !instance.is_running(Role::Control) {
            let (guardian, since) = (&watch.guardian, now() - *over.get_or_insert_with(now));
            let is_calm = !guardian.has_stopped() || guardian.is_at_rest();
            if (!guardian.is_armed() && is_calm) || since > OUTLIVES {
                return Ok(());
            }
        }
        next = next.max(now() - TICK) + TICK;
        sleep_until(next);
    }
}

/// What it sees, and what it can do.
struct GuardianWatch<'a> {
    instance: &'a Instance,
    commands: Receiver<DriveCommandMsg>,
    states: Receiver<DriveStateMsg>,
    guardian: Guardian,
    /// There is none before control has made it.
    word: Option<StopWord>,
    joint_names: Vec<String>,
}

impl GuardianWatch<'_> {
    fn look(&mut self) -> Result<(), ProcessError> {
        // Before the messages: what comes after it is no silence.
        let time = now();
        if self.word.is_none() {
            self.word = self.instance.open_stop_word().ok().flatten();
        }
        let stands = self.word.as_ref().is_some_and(StopWord::is_stopped_by_guardian);
        if stands && !self.guardian.has_stopped() {
            self.guardian.stop(); // by a guardian that was here before
        } else if !stands && self.guardian.has_stopped() {
            info!("the guardian's stop was reset");
            self.instance.leave_words_of_guardian(""); // what comes later has other reasons
            self.guardian.reset();
        }
        let mut finding = None;
        let taken = self.take(&mut finding);
        let process = self.word.as_ref().map_or(0, StopWord::control_process);
        if let Some(finding) = finding.or_else(|| self.guardian.look(time, || life_of(process))) {
            self.stop(&finding);
        }
        // In the middle of a run messages that are not received are a silence, and end in a stop.
        if self.guardian.is_armed() { Ok(()) } else { Ok(taken?) }
    }

    /// Takes everything that has come; the first finding in it.
    fn take(&mut self, finding: &mut Option<GuardianFinding>) -> Result<(), IpcError> {
        while let Some(command) = self.commands.receive()? {
            if command.flags & drive_flag::START != 0 {
                self.word = None; // another control may have made another
            }
            *finding = finding.or(self.guardian.command(&command));
        }
        while let Some(state) = self.states.receive()? {
            *finding = finding.or(self.guardian.state(&state));
        }
        Ok(())
    }

    /// First the stop, then its words.
    fn stop(&self, finding: &GuardianFinding) {
        if let Some(word) = &self.word {
            let _ = word.ask(Halt::Guardian);
        }
        let words = format!("the guardian has stopped the arm: {}", finding.describe(&self.joint_names));
        error!("{words}");
        self.instance.leave_words_of_guardian(&words);
    }
}

/// What the kernel says of a process. Where it says nothing of this one either, that is no sign of death.
fn life_of(process: u32) -> ControlLife {
    match process_state(process) {
        Some('T') => ControlLife::Suspended,
        Some('Z' | 'X') => ControlLife::Dead,
        Some(_) => ControlLife::Runs,
        None if process != 0 && process_state(std::process::id()).is_some() => ControlLife::Dead,
        None => ControlLife::Runs,
    }
}

fn limits(config: &Config) -> Result<GuardedLimits, ProcessError> {
    crate::dispatch_robot!(config.robot, |robot| {
        let limits = assemble::motion_limits(config, &robot)?;
        let joint = |i: usize| GuardedJoint {
            lower: limits.lower[i],
            upper: limits.upper[i],
            velocity: limits.velocity[i],
            acceleration: limits.acceleration[i],
            effort: robot.limits()[i].effort,
        };
        // By then a control that found the drive silent has no motion left to command: twice the longest time in which a joint brakes from its largest velocity.
        let braked = SpanNs::from_s(2.0 * limits.velocity.component_div(&limits.acceleration).max());
        Ok(GuardedLimits {
            joints: (0..robot.limits().len()).map(joint).collect(),
            silence: config.safety.guardian_timeout,
            states: SpanNs(config.safety.drive_timeout.0 + braked.0),
            space: config.workspace.as_ref().map(|space| space_of(&robot, space)).unwrap_or_default(),
        })
    })?
}

/// The axes of the joints, the spheres on the arm and the planes, as they stand with all joints at zero.
fn space_of<const N: usize>(robot: &Robot<N>, settings: &WorkspaceSettings) -> GuardedSpace {
    let zero = nalgebra::SVector::zeros();
    let (skeleton, places) = (robot.skeleton(&zero), ArmPlaces::of(robot, settings, &zero));
    let axis = |i: usize| GuardedAxis {
        point: skeleton.origin(i).into(),
        direction: skeleton.axis(i).into(),
        slides: i < N && robot.is_prismatic(i),
    };
    let sphere = |point: &CheckedPoint| GuardedSphere {
        center: point.at(&places).into(),
        joints: point.joints,
        radius_m: point.radius_m,
    };
    let side = |side: &HalfSpace| GuardedSide { normal: side.normal.into(), offset_m: side.offset_m };
    GuardedSpace {
        axes: std::array::from_fn(axis),
        spheres: checked_points(robot, settings).iter().map(sphere).collect(),
        sides: settings.sides.iter().map(side).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::MAX_JOINTS;
    use std::process::Command;

    #[test]
    fn the_kernel_tells_suspended_and_dead_processes() {
        assert_eq!(life_of(std::process::id()), ControlLife::Runs);
        assert_eq!(life_of(0), ControlLife::Runs, "nobody is no sign of death");
        let mut child = Command::new("sleep").arg("600").spawn().unwrap();
        let signal = |name: &str| {
            Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
        };
        signal("-STOP");
        while life_of(child.id()) != ControlLife::Suspended {
            std::thread::yield_now();
        }
        signal("-CONT");
        signal("-KILL");
        while life_of(child.id()) != ControlLife::Dead {
            std::thread::yield_now();
        }
        child.wait().unwrap();
        assert_eq!(life_of(child.id()), ControlLife::Dead);
    }

    /// What is turned about axes as they stand at zero, against frames that go from link to link, on arms that turn and slide.
    #[test]
    fn planes_are_left_where_the_frames_of_the_arm_say_so() {
        fn farthest<const N: usize>(name: &str) {
            let robot = crate::robot::load(name).unwrap().build::<N>().unwrap();
            let half = |normal: nalgebra::Vector3<f64>, offset_m: f64| HalfSpace {
                name: String::new(),
                normal: normal.normalize(),
                offset_m,
            };
            let settings = WorkspaceSettings {
                camera_speed_m_s: f64::INFINITY,
                camera_turn_rad_s: f64::INFINITY,
                flange_speed_m_s: f64::INFINITY,
                margin_m: 0.01,
                sides: vec![half([0.3, -0.5, 0.8].into(), 0.1), half([-1.0, 0.2, 0.1].into(), -0.3)],
                link_radius_m: vec![0.06; N],
                camera: Some(([0.03, -0.02, 0.06].into(), 0.03)),
                tool: Some(([0.0, 0.05, 0.15].into(), 0.02)),
                self_collision: false,
            };
            let space = space_of(&robot, &settings);
            for k in 0..50 {
                let q = nalgebra::SVector::<f64, N>::from_fn(|i, _| {
                    3.0 * f64::sin(f64::from(k) * 1.7 + i as f64 * 2.3)
                });
                let mut padded = [0.0; MAX_JOINTS];
                padded[..N].copy_from_slice(q.as_slice());
                let places = ArmPlaces::of(&robot, &settings, &q);
                let beyond = checked_points(&robot, &settings)
                    .iter()
                    .flat_map(|point| {
                        settings.sides.iter().map(|s| point.radius_m - s.depth_m(&point.at(&places)))
                    })
                    .fold(f64::NEG_INFINITY, f64::max);
                let (found, _) = space.farthest(&padded);
                assert!((found - beyond).abs() < 1e-9, "{name}: {found} {beyond}");
            }
        }
        farthest::<6>("ur5");
        farthest::<7>("panda");
        farthest::<4>("scara");
    }

    #[test]
    fn a_guardian_is_wanted_by_external_drives_in_real_time() {
        let wanted = |set: &[&str]| {
            let set: Vec<String> = set.iter().map(ToString::to_string).collect();
            is_wanted(&Config::load(None, &set).unwrap())
        };
        assert!(wanted(&["drive.kind=external"]));
        assert!(!wanted(&[]) && !wanted(&["drive.kind=external", "run.clock=lockstep"]));
        assert!(!wanted(&["drive.kind=external", "safety.guardian=false"]));
    }
}
