//! A drive's place in an instance, without any pointer of a caller.

use crate::failure::{ErrorCode, Failure};
use std::time::Duration;
use vservo::drive::DriveProperties;
use vservo::ipc::{Instance, QuietSender, Receiver, Sender, Services, StopWord, WakeListener};
use vservo::messages::{
    DRIVE_TEXT_BYTES, DriveCommandMsg, DriveStateMsg, DriveTextMsg, MAX_JOINTS, MessageRecord, RobotState,
    drive_flag,
};
use vservo::rt::now;
use vservo::time::SpanNs;

/// The instance where nothing names one, as the other programs have it.
const USUAL_INSTANCE: &str = "default";
/// Modes of a command: torque, velocity, position.
const MODES: u32 = 3;

/// The ends of the services that are a drive's.
#[derive(Debug)]
pub(crate) struct DrivePorts {
    commands: Receiver<DriveCommandMsg>,
    bell: WakeListener,
    states: Sender<DriveStateMsg>,
    texts: QuietSender<DriveTextMsg>,
    /// Where the guardian's stop is written; none before START, and before a control without one.
    word: Option<StopWord>,
    states_sent: u64,
    texts_sent: u64,
    instance: Instance,
    /// Whether a panic has gone through it: nothing is known of it any more.
    is_broken: bool,
    /// Last: the ports leave before the node that they belong to.
    _services: Services,
}

/// The instance of this name, or of the environment, whose other variables must fit it.
pub(crate) fn instance_of(name: Option<&str>) -> Result<Instance, Failure> {
    let from_environment = std::env::var("VSERVO_INSTANCE").ok().filter(|_| name.is_none());
    let told = name.or(from_environment.as_deref()).unwrap_or(USUAL_INSTANCE);
    let instance: Instance = told.parse().map_err(|error| Failure::argument(format!("{error}")))?;
    if from_environment.is_some() {
        // They follow from the name in this version. A supervisor of another one is told here, and not by services that nobody else finds.
        for (variable, ours) in instance.environment() {
            match std::env::var(variable) {
                Ok(theirs) if theirs != ours => {
                    return Err(Failure::argument(format!(
                        "{variable} is {theirs}, and {ours} for this library: vservo is of another version"
                    )));
                }
                _ => {}
            }
        }
    }
    Ok(instance)
}

/// Refuses a header of another version.
pub(crate) fn require_types(command: &str, state: &str, text: &str) -> Result<(), Failure> {
    let ours = [DriveCommandMsg::LAYOUT, DriveStateMsg::LAYOUT, DriveTextMsg::LAYOUT];
    for (theirs, ours) in [command, state, text].into_iter().zip(ours.map(|layout| layout.type_name)) {
        if theirs != ours {
            return Err(Failure::argument(format!(
                "vservo.h has {theirs}, this library {ours}: make it anew by `vservo layouts --lang c`, with the vservo that this library is built from"
            )));
        }
    }
    Ok(())
}

fn are_finite<'a>(values: impl IntoIterator<Item = &'a f64>) -> bool {
    values.into_iter().all(|value| value.is_finite())
}

/// Whether a drive of so many joints may obey it.
pub(crate) fn is_valid_command(command: &DriveCommandMsg, joints: u32) -> bool {
    let n = (command.joints as usize).min(MAX_JOINTS);
    let lists = [&command.q_r, &command.qd_r, &command.qdd_r, &command.tau];
    command.joints == joints
        && (1..=MAX_JOINTS as u32).contains(&joints)
        && command.mode < MODES
        && are_finite(lists.iter().flat_map(|list| list.iter().take(n)))
}

impl DrivePorts {
    pub(crate) fn open(instance: Instance) -> Result<Self, Failure> {
        let services = Services::join(&instance)?;
        // In this order: with both, the drive counts as present.
        let texts = services.drive_text_sender()?;
        let (commands, bell) = services.drive_command_receiver()?;
        let states = services.drive_state_sender()?;
        Ok(Self {
            commands,
            bell,
            states,
            texts,
            word: None,
            states_sent: 0,
            texts_sent: 0,
            instance,
            is_broken: false,
            _services: services,
        })
    }

    /// Leaves, and takes along what is left of an instance in which nobody is any more.
    pub(crate) fn close(self) {
        let instance = self.instance.clone();
        drop(self);
        instance.remove_leftovers(None);
    }

    /// Uses it, unless a panic has come through it before; one that does now leaves it unusable.
    pub(crate) fn used(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<i32, Failure>,
    ) -> Result<i32, Failure> {
        // Set until it is known that no panic came through.
        if std::mem::replace(&mut self.is_broken, true) {
            let words = "this handle met a defect of this library before; brake, and end".into();
            return Err(Failure { code: ErrorCode::Internal, words });
        }
        let result = work(self);
        self.is_broken = false;
        result
    }

    /// Whether a command is there, after a wait of at most so long.
    pub(crate) fn wait(&self, longest_ns: i64) -> Result<bool, Failure> {
        let longest = Duration::from_nanos(longest_ns.try_into().unwrap_or(0));
        // Also where one is there already: bells that nobody hears would fill their queue.
        let is_there = self.commands.is_waiting()?;
        self.bell.wait(if is_there { Duration::ZERO } else { longest })?;
        Ok(is_there || self.commands.is_waiting()?)
    }

    pub(crate) fn receive(&mut self) -> Result<Option<DriveCommandMsg>, Failure> {
        let command = self.commands.receive()?.map(|command| *command);
        if command.is_some_and(|command| command.flags & drive_flag::START != 0) {
            // Control makes the page anew before its first START.
            self.word = self.instance.open_stop_word().map_err(Failure::transport)?;
        }
        Ok(command)
    }

    pub(crate) fn send(&mut self, mut state: DriveStateMsg) -> Result<(), Failure> {
        let n = state.joints as usize;
        if n == 0 || n > MAX_JOINTS {
            return Err(Failure::value(format!("a state of {n} joints; there are 1 to {MAX_JOINTS}")));
        }
        let lists = [
            ("q", &state.q),
            ("qd", &state.qd),
            ("tau", &state.tau),
            ("q_true", &state.q_true),
            ("qd_true", &state.qd_true),
        ];
        let in_use = if state.flags & drive_flag::TRUTH != 0 { lists.len() } else { 3 };
        for (name, list) in lists.iter().take(in_use) {
            if !are_finite(list.iter().take(n)) {
                return Err(Failure::value(format!("{name} of a state is not finite: it is not sent")));
            }
        }
        state.sequence = self.states_sent;
        self.states.send(&state)?;
        self.states_sent += 1;
        Ok(())
    }

    pub(crate) fn send_joint_names(
        &mut self,
        names: &[&str],
        signs: Option<&[f64]>,
        zero_offsets: Option<&[f64]>,
    ) -> Result<(), Failure> {
        if let Some(name) = names.iter().find(|name| name.trim().is_empty() || name.contains('\n')) {
            return Err(Failure::argument(format!("`{}` is no name of a joint", name.escape_debug())));
        }
        let bytes: usize = names.iter().map(|name| name.len() + 1).sum();
        if bytes > DRIVE_TEXT_BYTES {
            return Err(Failure::argument(format!(
                "names of {bytes} bytes; a text holds {DRIVE_TEXT_BYTES}"
            )));
        }
        let mut text = DriveTextMsg::of_joints(names);
        if let Some(signs) = signs {
            if signs.iter().any(|sign| sign.abs() != 1.0) {
                return Err(Failure::value("a sign of a joint is 1 or -1"));
            }
            text.signs.iter_mut().zip(signs).for_each(|(to, from)| *to = *from);
        }
        if let Some(zero_offsets) = zero_offsets {
            if !are_finite(zero_offsets) {
                return Err(Failure::value("an offset of a joint is not finite"));
            }
            text.zero_offsets.iter_mut().zip(zero_offsets).for_each(|(to, from)| *to = *from);
        }
        self.send_text(text)
    }

    pub(crate) fn send_properties(
        &mut self,
        period_ns: i64,
        watchdog_ns: i64,
        lag_ns: i64,
        effort_rates: &[f64],
    ) -> Result<(), Failure> {
        if period_ns < 0 || watchdog_ns < 0 {
            return Err(Failure::value("a time below zero; zero tells none"));
        }
        if effort_rates.iter().any(|rate| !(rate.is_finite() && *rate > 0.0)) {
            return Err(Failure::value("an effort rate that is not above zero, or not finite"));
        }
        let told = |ns: i64| (ns > 0).then_some(SpanNs(ns));
        let (period, watchdog) = (told(period_ns), told(watchdog_ns));
        // An arm without a lag is told, too.
        let lag = (lag_ns >= 0).then_some(SpanNs(lag_ns));
        let properties = DriveProperties { period, watchdog, lag, effort_rate: effort_rates.to_vec() };
        let lines = properties.to_string();
        if lines.len() >= DRIVE_TEXT_BYTES {
            return Err(Failure::value(format!(
                "rates of {} bytes; a text holds {DRIVE_TEXT_BYTES}",
                lines.len()
            )));
        }
        self.send_text(DriveTextMsg::of_properties(&lines))
    }

    pub(crate) fn send_robot_text(&mut self, state: u32, code: u32, words: &str) -> Result<(), Failure> {
        if !RobotState::ALL.iter().any(|known| *known as u32 == state) {
            return Err(Failure::value(format!("{state} is no state of a robot")));
        }
        self.send_text(DriveTextMsg::of_robot(RobotState::from_code(state), code, words))
    }

    fn send_text(&mut self, mut text: DriveTextMsg) -> Result<(), Failure> {
        (text.sequence, text.stamp) = (self.texts_sent, now());
        self.texts.send(|| text)?;
        self.texts_sent += 1;
        Ok(())
    }

    pub(crate) fn is_stopped_by_guardian(&self) -> bool {
        self.word.as_ref().is_some_and(StopWord::is_stopped_by_guardian)
    }
}

/// Leaves the reason of an end, where there is an instance to leave it in.
pub(crate) fn leave_reason(instance: &Instance, reason: &str) -> Result<(), Failure> {
    instance.leave_words_of_drive(reason);
    if instance.words_of_drive().is_none() && !reason.trim().is_empty() {
        let place = instance.directory();
        return Err(Failure::transport(format!("{}: no reason can be left there", place.display())));
    }
    Ok(())
}
