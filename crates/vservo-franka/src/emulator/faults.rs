//! What can go wrong with a robot and its wire.

use crate::robot::RobotError;
use crate::wire::RobotState;
use std::collections::VecDeque;
use std::str::FromStr;

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The robot stops by a reflex.
    Reflex(RobotError),
    /// The next reflexes are not cleared by request.
    ManualRecovery,
    /// Somebody presses the user stop.
    UserStop,
    /// Somebody guides the arm by hand.
    Guiding,
    /// The brakes close.
    Brakes,
    /// User stop, guiding, reflexes and brakes are over.
    Ready,
    /// No motion is begun.
    RefuseMotions,
    /// The robot speaks another version of the interface.
    OldVersion,
    /// The robot does not answer requests.
    SilentTcp,
    /// No states are sent.
    Mute,
    /// Commands are not heard.
    Deaf,
    /// Two of three states are lost.
    LoseStates,
    /// Another program of the robot's machine sends what is no state.
    StrangeDatagrams,
    /// One of five commands is lost.
    LoseCommands,
    /// Replies come in halves.
    HalfPackets,
    /// Replies come byte by byte.
    ByteByByte,
    /// Replies come 20 states before the states in which the same is said.
    EarlyReplies,
    /// A reply of a size that there is none of.
    WrongSize,
    /// States that end too early.
    ShortStates,
    /// States repeat the number of an old one.
    StaleNumbers,
    /// A position is no number.
    NotANumber,
    /// A position jumps.
    JumpingJoint,
    /// The connection is closed.
    Close,
}

/// Words of faults, for command lines.
const WORDS: [(&str, Fault); 23] = [
    ("reflex", Fault::Reflex(RobotError::JointReflex)),
    ("manual-recovery", Fault::ManualRecovery),
    ("user-stop", Fault::UserStop),
    ("guiding", Fault::Guiding),
    ("brakes", Fault::Brakes),
    ("ready", Fault::Ready),
    ("refuse-motions", Fault::RefuseMotions),
    ("old-version", Fault::OldVersion),
    ("silent-tcp", Fault::SilentTcp),
    ("mute", Fault::Mute),
    ("deaf", Fault::Deaf),
    ("lose-states", Fault::LoseStates),
    ("strange-datagrams", Fault::StrangeDatagrams),
    ("lose-commands", Fault::LoseCommands),
    ("half-packets", Fault::HalfPackets),
    ("byte-by-byte", Fault::ByteByByte),
    ("early-replies", Fault::EarlyReplies),
    ("wrong-size", Fault::WrongSize),
    ("short-states", Fault::ShortStates),
    ("stale-numbers", Fault::StaleNumbers),
    ("not-a-number", Fault::NotANumber),
    ("jumping-joint", Fault::JumpingJoint),
    ("close", Fault::Close),
];

impl FromStr for Fault {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        let known = WORDS.iter().find(|(known, _)| *known == word).map(|(_, fault)| *fault);
        known.ok_or_else(|| {
            format!("`{word}` is no fault; there are: {}", WORDS.map(|(word, _)| word).join(", "))
        })
    }
}

/// How replies are cut into pieces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Pieces {
    #[default]
    Whole,
    Halves,
    Bytes,
}

/// The faults that there are now.
#[derive(Debug, Clone, Default)]
pub(super) struct Faults {
    pub(super) manual_recovery: bool,
    pub(super) refuse_motions: bool,
    pub(super) old_version: bool,
    pub(super) silent_tcp: bool,
    pub(super) mute: bool,
    pub(super) deaf: bool,
    pub(super) lose_states: bool,
    pub(super) strange_datagrams: bool,
    pub(super) lose_commands: bool,
    pub(super) pieces: Pieces,
    /// States of which mode, motion and errors are told later than the rest.
    pub(super) held_back: Option<VecDeque<RobotState>>,
    pub(super) wrong_size: bool,
    pub(super) short_states: bool,
    pub(super) stale_number: Option<u64>,
    pub(super) not_a_number: bool,
    pub(super) jump_rad: f64,
    pub(super) close: bool,
}

impl Faults {
    /// Lets a state say of mode, motion and errors what was so some states ago.
    pub(super) fn hold_back(&mut self, state: &mut RobotState) {
        let Some(held) = &mut self.held_back else { return };
        held.push_back(*state);
        // Chosen by hand: longer than any machine sleeps between a state and a reply.
        let told = if held.len() > 20 { held.pop_front() } else { held.front().copied() };
        let Some(told) = told else { return };
        (state.mode, state.generator, state.controller) = (told.mode, told.generator, told.controller);
        (state.errors, state.reflex_reason) = (told.errors, told.reflex_reason);
    }
}
