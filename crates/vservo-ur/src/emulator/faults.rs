//! What goes wrong, on demand.

use crate::SafetyMode;
use std::str::FromStr;

/// A fault that an emulator is told to have, from that moment on.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Fault {
    /// The safety system stops the arm and its program.
    Stop(SafetyMode),
    /// The arm loses power.
    PowerOff,
    /// Switched off and on: connections are lost, clock and registers begin anew.
    Reboot,
    /// RTDE connections are reset.
    ResetConnections,
    /// RTDE is silent, the connection stays.
    Mute,
    /// Registers that come are not taken.
    Deaf,
    /// Nor for some time, s, after which the newest are: a network that stands still.
    DeafFor(f64),
    /// The time of states stands.
    StaleStamps,
    /// Packages come in halves, 1 ms apart.
    HalfPackages,
    /// Packages come byte by byte.
    ByteByByte,
    /// A package that is cut short, with the next one behind it.
    CutPackage,
    /// A package of an unknown type.
    UnknownType,
    /// Positions that are no numbers.
    NotANumber,
    /// The first joint is read 1 rad off.
    JumpingJoint,
    /// The program is stopped on the pendant.
    StopProgram,
    /// The program is paused on the pendant.
    PauseProgram,
    /// Programs are not run.
    RefusePrograms,
    /// The RTDE protocol version is refused.
    WrongProtocol,
    /// The software is 3.2 or 5.2.
    OldSoftware,
    /// The software is this minor version, with this number of bug fixes.
    Software {
        /// 22 of 5.22.1.
        minor: u32,
        /// 1 of it.
        bugfix: u32,
    },
    /// The input registers belong to somebody else.
    RegistersInUse,
    /// Variables are not known.
    UnknownVariables,
    /// The answers to set-ups never come.
    SilentSetup,
    /// The robot is under local control.
    LocalControl,
    /// The dashboard does not answer.
    SilentDashboard,
    /// The primary interface is not served for some time, s: clients are dropped, and new ones hear nothing.
    SilentPrimaryFor(f64),
    /// The speed slider is moved.
    Slider(f64),
    /// States are lost: two of three.
    LoseStates,
    /// States come so much later than they were sampled, s: a network with a queue.
    LateBy(f64),
}

/// Words of faults, for command lines.
const WORDS: [(&str, Fault); 27] = [
    ("protective-stop", Fault::Stop(SafetyMode::ProtectiveStop)),
    ("emergency-stop", Fault::Stop(SafetyMode::RobotEmergencyStop)),
    ("safeguard-stop", Fault::Stop(SafetyMode::SafeguardStop)),
    ("power-off", Fault::PowerOff),
    ("reboot", Fault::Reboot),
    ("reset-connections", Fault::ResetConnections),
    ("mute", Fault::Mute),
    ("deaf", Fault::Deaf),
    ("stale-stamps", Fault::StaleStamps),
    ("half-packages", Fault::HalfPackages),
    ("byte-by-byte", Fault::ByteByByte),
    ("cut-package", Fault::CutPackage),
    ("unknown-type", Fault::UnknownType),
    ("not-a-number", Fault::NotANumber),
    ("jumping-joint", Fault::JumpingJoint),
    ("stop-program", Fault::StopProgram),
    ("pause-program", Fault::PauseProgram),
    ("refuse-programs", Fault::RefusePrograms),
    ("wrong-protocol", Fault::WrongProtocol),
    ("old-software", Fault::OldSoftware),
    ("software-without-torques", Fault::Software { minor: 22, bugfix: 0 }),
    ("registers-in-use", Fault::RegistersInUse),
    ("local-control", Fault::LocalControl),
    ("silent-dashboard", Fault::SilentDashboard),
    ("silent-primary", Fault::SilentPrimaryFor(f64::INFINITY)),
    ("lose-states", Fault::LoseStates),
    ("late-states", Fault::LateBy(0.05)),
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

/// How states are cut into pieces.
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
    pub(super) mute: bool,
    /// Until when, by the robot's clock, s.
    pub(super) deaf_until_s: Option<f64>,
    pub(super) stale_at_s: Option<f64>,
    pub(super) pieces: Pieces,
    pub(super) cut_once: bool,
    pub(super) unknown_type_once: bool,
    pub(super) not_a_number: bool,
    pub(super) jump_rad: f64,
    pub(super) refuse_programs: bool,
    pub(super) wrong_protocol: bool,
    pub(super) registers_in_use: bool,
    pub(super) unknown_variables: bool,
    pub(super) silent_setup: bool,
    pub(super) silent_dashboard: bool,
    /// Until when, by the robot's clock, s.
    pub(super) silent_primary_until_s: Option<f64>,
    pub(super) lose_states: bool,
    pub(super) late_s: f64,
    /// RTDE connections that began before this number are reset.
    pub(super) reset_before: u64,
}
