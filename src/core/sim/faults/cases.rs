//! What a campaign puts wrong, and which ends are right for it.
//!
//! The numbers here, sizes and times, were chosen by hand, so that each fault matters in the motion and could happen in a cell.

use crate::control::safety::Fault;
use crate::linalg::Random;

/// When faults begin, s: from the first motion on, until the shipped arms are all but at their goals.
const FROM_S: (f64, f64) = (0.05, 0.9);

/// An arm of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CampaignArm {
    /// Its name.
    pub name: &'static str,
    /// Shipped run file.
    pub file: &'static str,
    /// Its joints.
    pub joints: usize,
    /// Changes to it, which make the arm unlike its model, or its drive another one.
    pub set: &'static [&'static str],
}

/// The arms of a campaign: as their models are, with untold loads, rotors and friction, and before a drive with a servo of its own.
pub const CAMPAIGN_ARMS: [CampaignArm; 6] = [
    CampaignArm { name: "ur5", file: "ur5", joints: 6, set: &[] },
    CampaignArm { name: "panda", file: "panda", joints: 7, set: &[] },
    CampaignArm { name: "xarm7", file: "xarm7", joints: 7, set: &[] },
    CampaignArm {
        name: "ur5-unlike",
        file: "ur5",
        joints: 6,
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
        joints: 7,
        set: &[
            "drive.simulated.payload_kg=1.5",
            "drive.simulated.payload_com_m=[-0.02,0.03,0.06]",
            "drive.simulated.untold_rotor_share=0.3",
            "drive.simulated.friction_spread=0.4",
            "drive.simulated.command_delay_ticks=2",
        ],
    },
    CampaignArm { name: "ur5-velocity", file: "ur5", joints: 6, set: &["drive.mode=velocity"] },
];

/// The laws of a campaign: position-based (10.76), image-based by the mean of both matrices (10.90), hybrid.
pub const CAMPAIGN_LAWS: [(&str, &[&str]); 3] = [
    ("B", &["servo.scheme=position_resolved_velocity"]),
    ("D-mean", &["servo.scheme=image_resolved_velocity", "servo.interaction=mean"]),
    ("hybrid", &["servo.scheme=hybrid"]),
];

/// Which ends of a run are right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RightEnds {
    /// Faults by which it may end; converging is right beside them.
    pub faults: &'static [Fault],
    /// The view never comes back: it must hold until its time is over, and nothing else.
    pub only_holds: bool,
    /// The arm has lost what could brake it: it need not rest at the end if no true joint has been faster than its limit by this factor.
    pub moves_within: f64,
}

/// It must converge.
const CONVERGES: RightEnds = RightEnds { faults: &[], only_holds: false, moves_within: 0.0 };
/// It must hold.
const HOLDS: RightEnds = RightEnds { faults: &[], only_holds: true, moves_within: 0.0 };
/// What is told of encoders that are not where the arm is.
const ENCODER: RightEnds = RightEnds {
    faults: &[Fault::DriveStateImplausible, Fault::TrackingError],
    only_holds: false,
    moves_within: 0.0,
};
/// What is told of an arm that does less than it is told.
const WEAK: RightEnds = RightEnds {
    faults: &[Fault::DoesNotFollow, Fault::TrackingError, Fault::Contact, Fault::StuckReading],
    only_holds: false,
    moves_within: 0.0,
};

/// The same of a motor that does nothing at all.
const GONE: RightEnds = RightEnds {
    faults: &[
        Fault::DoesNotFollow,
        Fault::TrackingError,
        Fault::Contact,
        Fault::StuckReading,
        Fault::TooFast,
    ],
    moves_within: f64::INFINITY,
    ..WEAK
};

/// What is told of an encoder that stays where it is. Torques do not brake what is not seen, which is left to the drive's brakes; but they must not have driven it.
const FROZEN: RightEnds = RightEnds {
    faults: &[
        Fault::EncoderFrozen,
        Fault::StuckReading,
        Fault::DriveStateImplausible,
        Fault::TrackingError,
        Fault::DoesNotFollow,
    ],
    only_holds: false,
    moves_within: 1.1,
};

/// One way in which something is wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultCase {
    /// Its name.
    pub name: &'static str,
    /// The keys of its entry in `[[faults]]` that are always the same; empty: nothing is wrong.
    pub fault: &'static str,
    /// The keys that each seed draws, and from where to where, with equal chances of equal ratios.
    pub drawn: &'static [(&'static str, f64, f64)],
    /// Whether it is of a joint, which each seed draws.
    pub of_joint: bool,
    /// Which ends are right.
    pub ends: RightEnds,
}

impl FaultCase {
    /// Its entry in `[[faults]]`, with where each key that is drawn lies.
    #[must_use]
    pub fn told(&self) -> String {
        let drawn = self.drawn.iter().map(|(key, from, to)| format!(",{key}={from}..{to}"));
        let joint = if self.of_joint { ",joint=any" } else { "" };
        format!("{}{}{joint}", self.fault, drawn.collect::<String>())
    }

    /// The entry in `[[faults]]` of a `seed`, on an arm of so many `joints`; empty: nothing is wrong.
    #[must_use]
    pub fn entry(&self, seed: u64, joints: usize) -> String {
        if self.fault.is_empty() {
            return String::new();
        }
        let name =
            self.name.bytes().fold(seed, |hash, byte| hash.wrapping_mul(31).wrapping_add(u64::from(byte)));
        let mut random = Random::new(name);
        let (first_s, last_s) = FROM_S;
        let mut entry = format!("from_s={:.3},{}", random.between(first_s, last_s), self.fault);
        for (key, from, to) in self.drawn {
            let value = from * (to / from).powf(random.between(0.0, 1.0));
            entry += &format!(",{key}={value:.4}");
        }
        if self.of_joint {
            entry += &format!(",joint={}", (random.uniform() * joints as f64) as usize);
        }
        entry
    }
}

const fn case(
    name: &'static str,
    fault: &'static str,
    drawn: &'static [(&'static str, f64, f64)],
    ends: RightEnds,
) -> FaultCase {
    FaultCase { name, fault, drawn, of_joint: false, ends }
}

const fn joint(
    name: &'static str,
    fault: &'static str,
    drawn: &'static [(&'static str, f64, f64)],
    ends: RightEnds,
) -> FaultCase {
    FaultCase { of_joint: true, ..case(name, fault, drawn, ends) }
}

/// A time that is over before the run is, s.
const WHILE: (&str, f64, f64) = ("duration_s", 0.3, 1.2);
/// The same for what happens to some frames or states only, which needs longer until it has happened.
const LONG: (&str, f64, f64) = ("duration_s", 0.6, 2.0);

/// All of them.
pub const FAULT_CASES: &[FaultCase] = &[
    case("none", "", &[], CONVERGES),
    case("drop", "kind='drop'", &[LONG, ("probability", 0.2, 0.8)], CONVERGES),
    case("drop-all", "kind='drop'", &[WHILE], CONVERGES),
    case("delay", "kind='delay'", &[LONG, ("probability", 0.1, 0.6), ("delay_ms", 30.0, 150.0)], CONVERGES),
    case("duplicate", "kind='duplicate'", &[LONG, ("probability", 0.3, 1.0)], CONVERGES),
    case("freeze-short", "kind='freeze'", &[("duration_s", 0.05, 0.2)], CONVERGES),
    case("freeze", "kind='freeze'", &[WHILE], CONVERGES),
    case("black", "kind='black'", &[WHILE], CONVERGES),
    case("black-for-good", "kind='black',duration_s=100.0", &[], HOLDS),
    case("saturated", "kind='saturated'", &[WHILE], CONVERGES),
    case("torn", "kind='torn'", &[LONG, ("probability", 0.2, 0.8)], CONVERGES),
    case("corrupt", "kind='corrupt'", &[LONG, ("share", 0.03, 0.3)], CONVERGES),
    case("clock-jump", "kind='clock_jump',duration_s=100.0", &[("delay_ms", 150.0, 500.0)], HOLDS),
    case("clock-back", "kind='clock_jump',duration_s=100.0", &[("delay_ms", -150.0, -500.0)], HOLDS),
    case(
        "clock-flicker",
        "kind='clock_jump'",
        &[LONG, ("probability", 0.1, 0.5), ("delay_ms", -50.0, -200.0)],
        CONVERGES,
    ),
    case("false-target", "kind='false_target'", &[WHILE], CONVERGES),
    case("overtaken", "kind='overtaken'", &[LONG, ("probability", 0.2, 0.8)], CONVERGES),
    case("stale", "kind='stale'", &[LONG, ("probability", 0.2, 0.8)], CONVERGES),
    case("jump", "kind='jump'", &[LONG, ("probability", 0.1, 0.4), ("size_px", 10.0, 40.0)], CONVERGES),
    case("jump-lasting", "kind='jump'", &[WHILE, ("size_px", 10.0, 40.0)], CONVERGES),
    case("mislabelled", "kind='mislabelled'", &[LONG, ("probability", 0.1, 0.4)], CONVERGES),
    joint(
        "encoder-spike",
        "kind='encoder_spike'",
        &[LONG, ("probability", 0.005, 0.02), ("size_rad_or_m", 0.003, 0.02)],
        ENCODER,
    ),
    joint("encoder-leap", "kind='encoder_spike',duration_s=0.001", &[("size_rad_or_m", 0.05, 0.5)], ENCODER),
    joint("encoder-freeze-short", "kind='encoder_freeze'", &[("duration_s", 0.005, 0.025)], ENCODER),
    joint("encoder-freeze", "kind='encoder_freeze',duration_s=100.0", &[], FROZEN),
    joint(
        "encoder-offset",
        "kind='encoder_offset',duration_s=100.0",
        &[("size_rad_or_m", 0.005, 0.02)],
        ENCODER,
    ),
    joint("torque-loss", "kind='torque_loss'", &[WHILE, ("share", 0.1, 0.6)], WEAK),
    joint("torque-gone", "kind='torque_loss',duration_s=100.0,share=1.0", &[], GONE),
    case("stale-state", "kind='stale_state'", &[LONG, ("probability", 0.1, 0.5)], ENCODER),
    case("lost-command", "kind='lost_command'", &[LONG, ("probability", 0.1, 0.4)], CONVERGES),
    case("lost-commands", "kind='lost_command'", &[("duration_s", 0.01, 0.04)], WEAK),
];
