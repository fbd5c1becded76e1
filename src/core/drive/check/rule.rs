//! The rules of the contract, and what is found of them.

use crate::drive::CommandMode;
use serde::{Serialize, Serializer};
use std::fmt;

/// The rules as one table: name, what the drive must do in a few words, how to mend it.
macro_rules! rules {
    ($($(#[$doc:meta])* $name:ident: $words:literal, $remedy:literal;)*) => {
        /// What a drive must do.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
        #[serde(rename_all = "snake_case")]
        pub enum DriveRule {
            $($(#[$doc])* $name,)*
        }

        impl DriveRule {
            /// All rules, in the order in which they are told.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// What the drive must do, in a few words.
            #[must_use]
            pub fn describe(self) -> &'static str {
                match self {
                    $(Self::$name => $words,)*
                }
            }

            /// How to mend a drive that breaks it.
            #[must_use]
            pub fn remedy(self) -> &'static str {
                match self {
                    $(Self::$name => $remedy,)*
                }
            }
        }
    };
}

rules! {
    /// START is answered by a state with flag INITIAL and tick 0, in time.
    Answer: "answers START",
        "subscribe to drive/command, then publish drive/state, and answer START by a state of tick 0 with flag INITIAL";
    /// Every START is answered.
    EveryStart: "answers every START",
        "START may come again when its answer was late: answer each time";
    /// Every state has the joints of the robot file.
    Joints: "joints of the robot file",
        "start the drive with the robot of the run file, and put the count into `joints` of every state";
    /// The names of the joints, where they are told, are those of the robot file in its order.
    JointNames: "joints by name",
        "send the names on drive/text with every START, before the state with INITIAL, in the order of the states: those of the robot file, with sign 1 and zero offset 0";
    /// What the drive tells of itself is right, and lets control command it.
    Properties: "period and watchdog",
        "send `period_ms` and `watchdog_ms` on drive/text with every START: the period of the states, and how long the arm goes on without a command, three cycles of control and more";
    /// The mask of modes is not empty, has known bits alone, and stays the same.
    Modes: "command modes",
        "set bit 0 for torque, 1 for velocity, 2 for position in `modes`, the same in every state, and name one of them in drive.mode";
    /// Flags have known bits, INITIAL only answers START, and the arm is 0.
    Flags: "flags and arm",
        "use TRUTH and INITIAL alone, INITIAL in answers to START alone, and arm 0";
    /// The state of the robot is one that there is.
    RobotState: "state of the robot",
        "put a code of the list into `robot_state`, or 0 where the drive does not know: control takes an unknown one for a fault";
    /// Every number of a state is finite.
    Finite: "finite numbers",
        "send no state while the robot's values are not known, and zeros where nothing is measured";
    /// Positions and velocities lie within the limits of the robot file.
    Range: "within the limits",
        "send rad, m, rad/s and m/s, zeroed as the robot file is, or mend its limits";
    /// With TRUTH, what is true is near to what is measured.
    Truth: "truth near what is measured",
        "set TRUTH only where q_true and qd_true are of the same moment as q";
    /// `sequence` counts what was sent, from 0, without gaps and doubles.
    Sequence: "sequence without gaps",
        "count every state that is sent by one, from 0, and send from one place";
    /// `tick` counts the states in real time, and answers the command in lockstep.
    Tick: "tick",
        "real time: add one for each state; lockstep: the command's tick plus one, once";
    /// Stamps are of `CLOCK_MONOTONIC`, in nanoseconds.
    Clock: "stamps of CLOCK_MONOTONIC",
        "stamp with clock_gettime(CLOCK_MONOTONIC) in nanoseconds, not with the time of day";
    /// No stamp lies in the future.
    Future: "no stamp in the future",
        "stamp with the moment of the sample, not of the next one";
    /// Stamps rise from state to state.
    Rising: "stamps rise",
        "send each sample once, in order, with the stamp of its own sample";
    /// States come without pauses beyond `safety.drive_timeout_ms`.
    Rate: "rate of states",
        "send at 1 kHz or as fast as the robot does, also while the arm stands; else raise safety.drive_timeout_ms";
    /// States are younger than `safety.drive_timeout_ms` when they come.
    Age: "age of states",
        "send each sample at once, or raise safety.drive_timeout_ms";
    /// The arm rests when the trial begins.
    Rest: "rests at the start",
        "answer START when the arm stands";
    /// Under a held command the arm stands.
    Hold: "holds still",
        "hold the position (mode position), or control the velocity to zero, against gravity";
    /// The arm keeps to its reference, all the time.
    Course: "keeps to its reference",
        "see the rules below that are broken: units, order, sign";
    /// The joint that moves is the one that was commanded.
    Order: "order of joints",
        "map the joints in the order of the robot file, commands and states alike";
    /// It moves to the side that was commanded.
    Sign: "sign",
        "turn the sign of this joint's commands, or of its states";
    /// It moves as far as it was commanded, along the same curve.
    Follow: "follows",
        "command rad and m (not degrees), without a limit or filter that cuts a slow motion";
    /// It lags by a time that can be made up for.
    Lag: "lag",
        "stamp with the moment of the sample, and obey the newest command at once";
    /// The velocity reported is the derivative of the position.
    Velocity: "velocity reported",
        "report rad/s and m/s at the moment of the stamp, or the difference of positions";
    /// The program does not end before LAST.
    Stays: "stays until LAST",
        "run until LAST, and leave the reason in drive.txt in VSERVO_ROOT when you cannot";
    /// After LAST the arm rests.
    LastRest: "rests after LAST",
        "brake and hold the arm after LAST";
    /// After LAST the program ends with exit code 0, in time.
    LastExit: "ends after LAST",
        "end with exit code 0 when LAST has come and the arm rests";
    /// Without commands the arm is braked.
    Silence: "brakes without commands",
        "brake when no command has come for 0.1 s, and hold the arm by your own means";
    /// A drive that ends without commands says so.
    SilenceTold: "tells why it ended",
        "end with another exit code than 0, and leave the reason in drive.txt in VSERVO_ROOT";
    /// A command of another number of joints moves nothing.
    RefusesJoints: "refuses another joint count",
        "compare `joints` of each command with your own, and brake or end";
    /// A command that is not finite moves nothing.
    RefusesNumbers: "refuses numbers not finite",
        "look whether each number is finite before it goes to the robot, and brake or end";
}

impl fmt::Display for DriveRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.describe())
    }
}

/// What became of a rule; the later the worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RuleVerdict {
    /// It could not be seen.
    NotTested,
    /// It is kept.
    Ok,
    /// It is broken.
    Broken,
}

impl RuleVerdict {
    /// The word of the table.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NotTested => "not tested",
            Self::Ok => "ok",
            Self::Broken => "broken",
        }
    }
}

/// What was found of a rule.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RuleFinding {
    /// Which.
    pub rule: DriveRule,
    /// The mode in which the arm was moved, for rules about motion.
    #[serde(serialize_with = "mode_word")]
    pub mode: Option<CommandMode>,
    /// What became of it.
    pub verdict: RuleVerdict,
    /// What was measured, or why nothing was.
    pub measured: String,
}

fn mode_word<S: Serializer>(mode: &Option<CommandMode>, serializer: S) -> Result<S::Ok, S::Error> {
    mode.map(CommandMode::as_str).serialize(serializer)
}

impl RuleFinding {
    /// A rule that could not be tested, and why.
    #[must_use]
    pub fn untested(rule: DriveRule, why: &str) -> Self {
        Self { rule, mode: None, verdict: RuleVerdict::NotTested, measured: why.into() }
    }
}

/// The findings of a trial in the making.
pub(super) struct TrialFindings {
    mode: CommandMode,
    pub(super) all: Vec<RuleFinding>,
}

impl TrialFindings {
    pub(super) fn new(mode: CommandMode) -> Self {
        Self { mode, all: Vec::new() }
    }

    /// Notes that `rule` is kept, or what breaks it.
    pub(super) fn say(&mut self, rule: DriveRule, broken: Option<String>, measured: impl Into<String>) {
        let (verdict, measured) = match broken {
            Some(how) => (RuleVerdict::Broken, how),
            None => (RuleVerdict::Ok, measured.into()),
        };
        self.all.push(RuleFinding { rule, mode: None, verdict, measured });
    }

    /// The same, of a rule about motion in the mode of this trial.
    pub(super) fn say_in_mode(
        &mut self,
        rule: DriveRule,
        broken: Option<String>,
        measured: impl Into<String>,
    ) {
        self.say(rule, broken, measured);
        if let Some(last) = self.all.last_mut() {
            last.mode = Some(self.mode);
        }
    }

    pub(super) fn untested(&mut self, rule: DriveRule, why: &str) {
        self.all.push(RuleFinding::untested(rule, why));
    }
}
