//! What an external drive says on `drive/text`: the names of its joints, which must be those of the robot file, and its maker's words about the robot.

use crate::config::Config;
use crate::drive::{CommandMode, DriveProperties, check_joint_names};
use crate::input::printable;
use crate::ipc::{IpcError, Receiver, Services};
use crate::messages::{DriveTextMsg, RobotState, text_kind};
use crate::process::ProcessError;
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use tracing::{info, warn};

/// Least time between two lines about what a drive says. Chosen by hand: a drive that says something new in every cycle does not fill the log.
const QUIET: SpanNs = SpanNs(1_000_000_000);

pub(super) struct DriveWords {
    texts: Receiver<DriveTextMsg>,
    /// The joints of the robot file.
    robot: Vec<String>,
    has_names: bool,
    /// Whether torques are commanded.
    is_torque: bool,
    /// What the drive told of itself.
    properties: DriveProperties,
    /// The newest words, and whether they were handed on.
    words: DriveTextMsg,
    is_new: bool,
    /// Whether they are still to be logged, and when the last were.
    to_log: bool,
    logged: Option<MonoNs>,
}

impl DriveWords {
    /// To be opened before the drive is started, so that its first words are not missed.
    pub(super) fn open(services: &Services, config: &Config) -> Result<Self, IpcError> {
        Ok(Self {
            texts: services.drive_text_receiver()?,
            robot: config.robot.joints.iter().map(|joint| joint.name.clone()).collect(),
            has_names: false,
            is_torque: config.drive.mode == CommandMode::Torque,
            properties: DriveProperties::default(),
            words: DriveTextMsg::default(),
            is_new: false,
            to_log: false,
            logged: None,
        })
    }

    /// Takes what has come.
    pub(super) fn take(&mut self) -> Result<(), ProcessError> {
        while let Some(text) = self.texts.receive()? {
            match text.kind {
                text_kind::JOINTS => {
                    check_joint_names(&text, &self.robot)?;
                    self.has_names = true;
                }
                text_kind::ROBOT => {
                    let says = |text: &DriveTextMsg| (text.robot_state, text.robot_code, text.text);
                    if says(&text) != says(&self.words) {
                        (self.words, self.is_new, self.to_log) = (*text, true, true);
                    }
                }
                text_kind::PROPERTIES => self.take_properties(DriveProperties::parse(&text.text())?)?,
                _ => {} // of a later version
            }
        }
        self.log();
        Ok(())
    }

    /// Refuses a drive that cannot be commanded.
    fn take_properties(&mut self, told: DriveProperties) -> Result<(), ProcessError> {
        told.check(self.robot.len())?;
        let is_first = self.properties == DriveProperties::default();
        if self.is_torque && !is_first && told.effort_rate != self.properties.effort_rate {
            warn!(
                "the drive takes torques at other rates than it told first: those of its first states are kept to"
            );
        }
        self.properties = told;
        Ok(())
    }

    /// What the drive has told of itself.
    pub(super) fn properties(&self) -> &DriveProperties {
        &self.properties
    }

    fn log(&mut self) {
        let time = now();
        if !self.to_log || self.logged.is_some_and(|logged| time - logged < QUIET) {
            return;
        }
        self.to_log = false;
        let words = one_line(&self.words);
        if words.is_empty() {
            return; // what was said is over
        }
        self.logged = Some(time);
        let robot_state = RobotState::from_code(self.words.robot_state).as_str();
        warn!(robot_state, robot_code = self.words.robot_code, "the drive says: {words}");
    }

    /// Says it where the first answer to START came without names.
    pub(super) fn tell_of_names(&self) {
        if !self.has_names {
            info!(
                "the drive tells no names of its joints: they are taken to be those of the robot file, in its order"
            );
        }
    }

    /// The newest words, once.
    pub(super) fn next(&mut self) -> Option<DriveTextMsg> {
        std::mem::take(&mut self.is_new).then_some(self.words)
    }

    /// What was said of a robot that does not obey, where it still does not by the newest state.
    pub(super) fn at_the_end(&self, newest: RobotState) -> Option<String> {
        let stopped = |state: RobotState| !state.obeys();
        let words = one_line(&self.words);
        (stopped(RobotState::from_code(self.words.robot_state)) && stopped(newest) && !words.is_empty())
            .then_some(words)
    }
}

fn one_line(text: &DriveTextMsg) -> String {
    printable(&text.text().split_whitespace().collect::<Vec<_>>().join(" "))
}
