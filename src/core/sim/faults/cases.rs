//! What a campaign puts wrong, and which ends are right for it.
//!
//! The numbers here, sizes and times, were chosen by hand, so that each fault matters in the motion and could happen in a cell.

use crate::control::safety::Fault;

/// An arm of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CampaignArm {
    /// Its name.
    pub name: &'static str,
    /// Shipped run file.
    pub file: &'static str,
    /// Changes to it, which make the arm unlike its model, or its drive another one.
    pub set: &'static [&'static str],
}

/// The arms of a campaign: as their models are, with untold loads, rotors and friction, and before a drive with a servo of its own.
pub const CAMPAIGN_ARMS: [CampaignArm; 6] = [
    CampaignArm { name: "ur5", file: "ur5", set: &[] },
    CampaignArm { name: "panda", file: "panda", set: &[] },
    CampaignArm { name: "xarm7", file: "xarm7", set: &[] },
    CampaignArm {
        name: "ur5-unlike",
        file: "ur5",
        set: &[
            "drive.simulated.payload_kg=2.5",
            "drive.simulated.payload_com_m=[0.03,-0.02,0.08]",
            "drive.simulated.untold_rotor_share=0.5",
            "drive.simulated.untold_coulomb_share=0.02",
            "drive.simulated.command_delay_ticks=1",
        ],
    },
    CampaignArm {
        name: "panda-unlike",
        file: "panda",
        set: &[
            "drive.simulated.payload_kg=1.5",
            "drive.simulated.payload_com_m=[-0.02,0.03,0.06]",
            "drive.simulated.untold_rotor_share=0.3",
            "drive.simulated.friction_spread=0.4",
            "drive.simulated.command_delay_ticks=2",
        ],
    },
    CampaignArm { name: "ur5-velocity", file: "ur5", set: &["drive.mode=velocity"] },
];

/// The laws of a campaign: position-based (10.76), image-based by the mean of both matrices (10.90), hybrid.
pub const CAMPAIGN_LAWS: [(&str, &[&str]); 3] = [
    ("B", &["servo.scheme=position_resolved_velocity"]),
    ("D-mean", &["servo.scheme=image_resolved_velocity", "servo.interaction=mean"]),
    ("hybrid", &["servo.scheme=hybrid"]),
];

/// Which ends of a run are right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RightEnds {
    /// Faults by which it may end; converging is right beside them.
    pub faults: &'static [Fault],
    /// The view never comes back: it must hold until its time is over, and nothing else.
    pub only_holds: bool,
    /// The arm has lost what could brake it: it cannot be asked to rest.
    pub has_no_brake: bool,
}

/// It must converge.
const CONVERGES: RightEnds = RightEnds { faults: &[], only_holds: false, has_no_brake: false };
/// It must hold.
const HOLDS: RightEnds = RightEnds { faults: &[], only_holds: true, has_no_brake: false };
/// What is told of encoders that are not where the arm is.
const ENCODER: RightEnds = RightEnds {
    faults: &[Fault::DriveStateImplausible, Fault::TrackingError],
    only_holds: false,
    has_no_brake: false,
};
/// What is told of an arm that does less than it is told.
const WEAK: RightEnds = RightEnds {
    faults: &[Fault::DoesNotFollow, Fault::TrackingError, Fault::Contact],
    only_holds: false,
    has_no_brake: false,
};

/// The same of a motor that does nothing at all.
const GONE: RightEnds = RightEnds {
    faults: &[Fault::DoesNotFollow, Fault::TrackingError, Fault::Contact, Fault::TooFast],
    has_no_brake: true,
    ..WEAK
};

/// One way in which something is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultCase {
    /// Its name.
    pub name: &'static str,
    /// The keys of its entry in `[[faults]]`, without `from_s`; empty: nothing is wrong.
    pub fault: &'static str,
    /// Other changes to the run file.
    pub set: &'static [&'static str],
    /// Which ends are right.
    pub ends: RightEnds,
}

const fn case(name: &'static str, fault: &'static str, ends: RightEnds) -> FaultCase {
    FaultCase { name, fault, set: &[], ends }
}

/// All of them.
pub const FAULT_CASES: &[FaultCase] = &[
    case("none", "", CONVERGES),
    case("drop", "kind='drop',duration_s=1.0,probability=0.5", CONVERGES),
    case("drop-all", "kind='drop',duration_s=0.6", CONVERGES),
    case("delay", "kind='delay',duration_s=1.0,probability=0.3,delay_ms=80.0", CONVERGES),
    case("duplicate", "kind='duplicate',duration_s=0.6,probability=0.6", CONVERGES),
    case("freeze-short", "kind='freeze',duration_s=0.16", CONVERGES),
    case("freeze", "kind='freeze',duration_s=0.6", CONVERGES),
    case("black", "kind='black',duration_s=0.6", CONVERGES),
    case("black-for-good", "kind='black',duration_s=100.0", HOLDS),
    case("saturated", "kind='saturated',duration_s=0.6", CONVERGES),
    case("torn", "kind='torn',duration_s=1.0,probability=0.5", CONVERGES),
    case("corrupt", "kind='corrupt',duration_s=1.0,share=0.1", CONVERGES),
    case("clock-jump", "kind='clock_jump',duration_s=100.0,delay_ms=200.0", HOLDS),
    case("clock-back", "kind='clock_jump',duration_s=100.0,delay_ms=-200.0", HOLDS),
    case("clock-flicker", "kind='clock_jump',duration_s=1.0,probability=0.3,delay_ms=-100.0", CONVERGES),
    case("false-target", "kind='false_target',duration_s=0.6", CONVERGES),
    case("overtaken", "kind='overtaken',duration_s=1.0,probability=0.5", CONVERGES),
    case("stale", "kind='stale',duration_s=0.6,probability=0.6", CONVERGES),
    case("jump", "kind='jump',duration_s=1.0,probability=0.2,size_px=20.0", CONVERGES),
    case("jump-lasting", "kind='jump',duration_s=0.6,size_px=20.0", CONVERGES),
    case("mislabelled", "kind='mislabelled',duration_s=1.0,probability=0.2", CONVERGES),
    case(
        "encoder-spike",
        "kind='encoder_spike',duration_s=1.0,probability=0.01,size_rad_or_m=0.005,joint=1",
        ENCODER,
    ),
    case("encoder-leap", "kind='encoder_spike',duration_s=0.001,size_rad_or_m=0.2,joint=1", ENCODER),
    case("encoder-freeze-short", "kind='encoder_freeze',duration_s=0.02,joint=1", ENCODER),
    case(
        "encoder-freeze",
        "kind='encoder_freeze',duration_s=100.0,joint=1",
        RightEnds {
            faults: &[
                Fault::EncoderFrozen,
                Fault::DriveStateImplausible,
                Fault::TrackingError,
                Fault::DoesNotFollow,
            ],
            only_holds: false,
            has_no_brake: false,
        },
    ),
    case("encoder-offset", "kind='encoder_offset',duration_s=100.0,size_rad_or_m=0.01,joint=1", ENCODER),
    case("torque-loss", "kind='torque_loss',duration_s=0.6,share=0.3,joint=1", WEAK),
    case("torque-gone", "kind='torque_loss',duration_s=100.0,share=1.0,joint=0", GONE),
    case("stale-state", "kind='stale_state',duration_s=1.0,probability=0.3", ENCODER),
    case("lost-command", "kind='lost_command',duration_s=1.0,probability=0.2", CONVERGES),
    case("lost-commands", "kind='lost_command',duration_s=0.03", WEAK),
];
