//! Faults and the reactions to them.
//!
//! | fault | reaction |
//! | --- | --- |
//! | the last good measurement grows old, from `slow_down_from` of `measurement_timeout` on | the motion command fades: the arm slows down |
//! | no good measurement for `measurement_timeout`, or a moving object too uncertain | reference slows down within its limits, arm holds, run goes on; the next good measurement resumes it |
//! | the arm does not start within `start_tolerance` of where the run file says | it does not move, run ends as fault, unless it may start elsewhere |
//! | drive reports NaN, infinity, or an implausible state (10 times the speed limit without having been seen to come to it, a jump, a whole range outside the range) | the arm is assumed to be on its reference, which slows down; run ends as fault |
//! | a joint is faster than 1.5 times its limit over 20 ms, or before a drive that obeys torques 1.25 times in most of 100 ms or a third of 0.4 s | reference is put on the measured arm and slows down, run ends as fault |
//! | a joint does not follow its reference over 400 ms, or is farther from it than `tracking_error` | likewise |
//! | a joint swings about its reference (under a law that outputs torques there is none): four times within 0.5 s, with 0.5 rad/s and more | likewise |
//! | a drive that obeys velocities does not do as commanded: what a joint moved differs from it by more than `max_tracking_error` in sum, half of what it moved forgiven | likewise |
//! | before a drive that obeys torques: an encoder's reading leaps, or stays the same in motion, for up to 30 ticks | the joint is believed to do what it was told, and the run goes on |
//! | for longer | fault; a joint whose encoder is frozen is braked by what it is told, and not by its encoder (`encoders.rs`) |
//! | one of the three faults above or a contact, of a joint whose reading stays the same to the last digit although it is told to move | likewise, told as a reading that is stuck: nothing tells a frozen encoder from a joint that is held |
//! | the first motion of the image is that of a camera which is turned by 70 degrees and more against its mount (`servo/motion_agreement.rs`) | likewise |
//! | the first motion of the image, and a small turn of the camera, are those of a lens that is more than 1.6 times as long or as short as told (`servo/motion_agreement/lens.rs`) | likewise |
//! | something touches the arm: a torque from outside of nine standard deviations, or a drive's lag of as many (`safety.contact`) | likewise; goes back by what it pressed or more, or floats |
//! | a checked point of the arm, as commanded or measured, is beyond a plane of `[workspace]` for 5 ms (`gate/space_bound.rs`), or camera or flange are commanded too fast | likewise |
//! | commands had to be changed before the drive for 100 ms, or are not finite | likewise |
//! | any end of a run: goal, time, request, fault | the reference slows down within its limits, and the run ends when the measured arm is at rest (`run_end`) |
//! | `max_missed_deadlines_in_a_row` ticks missed in a row | protective stop: reference slows down, arm holds, run ends as fault |
//! | the measured arm still moves 3 s after its reference came to rest | the run ends as fault, with the last command |
//! | the reference rests, and no usable state tells whether the arm does; before a drive that closes its own loop for 0.2 s | the run ends as fault, with the last command |
//! | a stop is latched (`ipc/stop_word.rs`) | the reference slows down, the run ends as fault |
//! | the companion takes no trace for 3 s | likewise: no measurement and no order arrives any more, and nothing else would end the run |
//! | lockstep: a measurement does not come for 10 s | reference slows down, arm holds, run ends as fault |
//! | external drive: states stop, drive leaves, hangs or answers out of step | as for NaN; in lockstep, where no state comes without a drive, the run is over |
//! | external drive: the robot reports a protective or an emergency stop, lost power, closed brakes, a fault, or that what obeys commands was stopped | a fault in these words, in the tick of that state; the reference slows down and goes to the measured arm |
//!
//! A served run does not end by a fault: the arm stands, and waits for a reset.

mod arm;
mod contact;
mod encoders;
mod freshness;
mod rest;
mod stopped_joint;
mod swing;

pub use arm::{ABSURD_SPEED, ArmWatch};
pub use contact::{Contact, ContactNumbers, ContactReaction, ContactWatch};
pub use encoders::{EncoderTraits, EncoderWatch, ExpectedMotion};
pub use freshness::{Freshness, MeasurementWatch};
pub(in crate::control) use rest::REST_SPEED;
pub use rest::RestWatch;

use crate::drive::DriveFault;
use crate::messages::RobotState;
use crate::servo::CameraError;

/// The same words for each turn of a camera.
macro_rules! turned_camera {
    ($degrees:literal) => {
        concat!(
            "the image moves as if the camera were turned about its optical axis against its mount, by about ",
            $degrees,
            " degrees, so that the arm went away from its goal: turn camera.mount by as much about its z, or find it with `vservo calibrate hand-eye`"
        )
    };
}

/// The same words for a lens that is longer or shorter.
macro_rules! wrong_lens {
    ($how:literal) => {
        concat!(
            "the image moves as one of a lens that is much ",
            $how,
            " than camera.lens says, by half and more, so that the arm would not come to its goal: see to fx_px and fy_px (are they those of this lens, and of images of this size?), or find them with `vservo calibrate camera`; `vservo run --uncalibrated` needs none"
        )
    };
}

/// The faults that end a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The drive reported a joint state that is not finite.
    DriveStateNotFinite,
    /// The drive reported an implausible joint state.
    DriveStateImplausible,
    /// A joint is too far from its reference.
    TrackingError,
    /// Too many deadlines in a row were missed.
    DeadlinesMissed,
    /// The drive's states are no longer usable.
    Drive(DriveFault),
    /// The measured arm did not come to rest although its reference did.
    NotAtRest,
    /// The reference came to rest, and no usable state tells whether the arm did.
    RestUnknown,
    /// In lockstep: camera and vision do not deliver a measurement that is due.
    PeersSilent,
    /// The arm does not start where the run file says.
    StartsElsewhere,
    /// A joint is faster than its velocity limit allows.
    TooFast,
    /// A joint stands while its reference moves.
    DoesNotFollow,
    /// A joint oscillates about its reference.
    Oscillates,
    /// Something acts on the arm from outside.
    Contact,
    /// The image moves as if the camera were turned about its optical axis against its mount, by about 90 degrees.
    CameraTurned90,
    /// The same by about 180 degrees.
    CameraTurned180,
    /// The same by about 270 degrees.
    CameraTurned270,
    /// The same as if the camera's axes were others, or had other signs.
    CameraAxesExchanged,
    /// The image moves as one of a lens that is much longer than `camera.lens` says.
    LensLonger,
    /// The same of a much shorter one.
    LensShorter,
    /// The encoder of a joint stands still while the joint moves.
    EncoderFrozen,
    /// The reading of a joint stays the same although the joint is told to move: its encoder is frozen, it is held, or its motor does nothing.
    StuckReading,
    /// A part of the arm is beyond a plane that it must not pass.
    LeavesWorkspace,
    /// Camera or flange are commanded to be faster than they may.
    TooFastInSpace,
    /// Somebody latched a stop.
    StopLatched,
    /// Commands would have exceeded the limits, or were not finite.
    CommandsRefused,
    /// Real time: the thread beside the real-time thread takes no traces any more.
    CompanionSilent,
    /// The robot has stopped the arm by a protective stop.
    RobotProtectiveStop,
    /// The robot is in an emergency stop.
    RobotEmergencyStop,
    /// The robot has no power, or its brakes are closed.
    RobotOff,
    /// The robot has a fault of its own.
    RobotError,
    /// What obeys commands on the robot was stopped.
    RobotHalted,
}

impl Fault {
    /// All faults, with their codes in the protocol of the messages; those of a drive are 17 to 20. A code never changes its meaning.
    const CODES: [(Self, u32); 34] = [
        (Self::DriveStateNotFinite, 1),
        (Self::DriveStateImplausible, 2),
        (Self::TrackingError, 3),
        (Self::DeadlinesMissed, 4),
        (Self::NotAtRest, 6),
        (Self::PeersSilent, 7),
        (Self::StartsElsewhere, 8),
        (Self::TooFast, 9),
        (Self::DoesNotFollow, 10),
        (Self::CommandsRefused, 11),
        (Self::CompanionSilent, 12),
        (Self::Oscillates, 13),
        (Self::Contact, 14),
        (Self::StopLatched, 15),
        (Self::CameraTurned90, 16),
        (Self::CameraTurned180, 21),
        (Self::CameraTurned270, 22),
        (Self::CameraAxesExchanged, 23),
        (Self::EncoderFrozen, 24),
        (Self::LensLonger, 25),
        (Self::LensShorter, 26),
        (Self::LeavesWorkspace, 30),
        (Self::TooFastInSpace, 31),
        (Self::RobotProtectiveStop, 32),
        (Self::RobotEmergencyStop, 33),
        (Self::RobotOff, 34),
        (Self::RobotError, 35),
        (Self::RobotHalted, 36),
        (Self::RestUnknown, 37),
        (Self::StuckReading, 38),
        (Self::Drive(DriveFault::Stale), 17),
        (Self::Drive(DriveFault::Left), 18),
        (Self::Drive(DriveFault::Silent), 19),
        (Self::Drive(DriveFault::OutOfStep), 20),
    ];

    /// That of a robot in this state; `None` where commands are obeyed, as far as is known.
    #[must_use]
    pub fn of_robot(state: RobotState) -> Option<Self> {
        match state {
            RobotState::Unknown | RobotState::Ready | RobotState::Moving | RobotState::Reduced => None,
            RobotState::ProtectiveStop => Some(Self::RobotProtectiveStop),
            RobotState::EmergencyStop => Some(Self::RobotEmergencyStop),
            RobotState::Off | RobotState::Braked | RobotState::Enabling => Some(Self::RobotOff),
            RobotState::Fault => Some(Self::RobotError),
            RobotState::Halted => Some(Self::RobotHalted),
        }
    }

    /// That of a camera that is not as told.
    #[must_use]
    pub fn of_camera(error: CameraError) -> Self {
        match error {
            CameraError::Turned(0 | 1) => Self::CameraTurned90,
            CameraError::Turned(2) => Self::CameraTurned180,
            CameraError::Turned(_) => Self::CameraTurned270,
            CameraError::OtherAxes => Self::CameraAxesExchanged,
            CameraError::LongerLens => Self::LensLonger,
            CameraError::ShorterLens => Self::LensShorter,
        }
    }

    /// Its code in a message, never 0.
    #[must_use]
    pub fn code(self) -> u32 {
        Self::CODES.iter().find(|(fault, _)| *fault == self).map_or(u32::MAX, |(_, code)| *code)
    }

    /// The fault of a code in a message; `None` for 0 and unknown ones.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::CODES.iter().find(|(_, known)| *known == code).map(|(fault, _)| *fault)
    }

    /// Whether there is no usable joint state any more.
    #[must_use]
    pub fn blinds(self) -> bool {
        matches!(self, Self::DriveStateNotFinite | Self::DriveStateImplausible | Self::Drive(_))
    }

    /// Whether something may press against the arm.
    #[must_use]
    pub fn is_contact(self) -> bool {
        matches!(self, Self::Contact | Self::StuckReading)
    }

    /// Whether the robot has stopped the arm by itself.
    #[must_use]
    pub fn is_of_robot(self) -> bool {
        matches!(
            self,
            Self::RobotProtectiveStop
                | Self::RobotEmergencyStop
                | Self::RobotOff
                | Self::RobotError
                | Self::RobotHalted
        )
    }

    /// The description, for people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::DriveStateNotFinite => "the drive reported a joint state that is not finite",
            Self::DriveStateImplausible => {
                "the drive reported a joint state that no arm has: a speed of more than 10 times the joint's limit, a leap, or \
                 a position more than a range away from its range"
            }
            Self::TrackingError => {
                "a joint is farther from its reference than safety.max_tracking_error_rad_or_m; one that gives way as a run begins bears more than [tool] tells"
            }
            Self::DeadlinesMissed => {
                "more deadlines in a row were missed than safety.max_missed_deadlines_in_a_row"
            }
            Self::Drive(fault) => fault.describe(),
            Self::NotAtRest => "the arm still moves although it was brought to rest: see to its drive",
            Self::RestUnknown => {
                "the run ends while nobody can tell whether the arm stands, because what the drive says of its joints is not usable: see that it stands before you go near"
            }
            Self::PeersSilent => {
                "a measurement did not come although the loop waited for it: the camera or the vision process hangs"
            }
            Self::StartsElsewhere => {
                "the arm does not start where robot.q_start_rad_or_m says: move it there, correct the run file, or allow it by \
                 robot.start_elsewhere = true (within robot.start_tolerance_rad_or_m it is the same place)"
            }
            Self::TooFast => {
                "a joint was faster than its velocity limit: look for a delay between command and motion, or for a payload that \
                 the robot file does not know"
            }
            Self::DoesNotFollow => {
                "a joint does not follow its reference: is it jammed, braked, or its drive switched off?"
            }
            Self::Oscillates => {
                "a joint oscillates about its reference: lower motion.natural_frequency_rad_s or servo.gain_1_s, look for a delay between \
                 command and motion, tell the rotors' inertia (armature_kg_m2) and what the arm carries ([tool])"
            }
            Self::Contact => {
                "something touches the arm, or holds one of its joints: clear its way; where nothing does, tell what it carries ([tool]) and its friction, or set \
                 safety.contact = \"ignore\""
            }
            Self::CameraTurned90 => turned_camera!("90"),
            Self::CameraTurned180 => turned_camera!("180"),
            Self::CameraTurned270 => turned_camera!("270"),
            Self::EncoderFrozen => {
                "the reading of a joint's encoder stopped dead in its motion, as no joint does, and stays the same to the last digit: see to the encoder and its cable"
            }
            Self::StuckReading => {
                "the reading of a joint stays the same to the last digit although the joint is told to move: its encoder is frozen, or something holds the joint (a jam, its brake, its friction), or its motor does \
                 nothing: see to the encoder and its cable, then to the joint and its drive"
            }
            Self::CameraAxesExchanged => {
                "the image moves as if the camera had other axes than camera.mount says, or some of other signs, or as if it were mirrored, so that the arm went away from its goal: see to \
                 the frame of the mount (z along the optical axis, x to the right of the image, y down), or find it with `vservo calibrate hand-eye`; switch the mirroring of images off"
            }
            Self::LensLonger => wrong_lens!("longer"),
            Self::LensShorter => wrong_lens!("shorter"),
            Self::LeavesWorkspace => {
                "a part of the arm is beyond a plane or box of [workspace], or in another part: lead it back by `vservo ctl goto` or `jog` after a reset, or correct the plane; \
                 an arm that passed it in motion follows worse than workspace.margin_m allows"
            }
            Self::TooFastInSpace => {
                "camera or flange were faster than [workspace] allows, by a tenth and for 0.1 s: under a law that outputs torques (A, C), whose reference is the measured arm, lower its gains ([servo.pd]), or tell what \
                 the arm carries ([tool]); elsewhere they were commanded so, by a defect of the program"
            }
            Self::RobotProtectiveStop => {
                "the robot reports a protective stop, by which it has stopped the arm itself: find its cause at the robot; `vservo ctl reset` has \
                 it unlocked (a safeguard stop ends where the safeguard is: close and reset that first)"
            }
            Self::RobotEmergencyStop => {
                "the robot reports an emergency stop: release its button, power the robot and open its brakes at the robot, then `vservo ctl reset`"
            }
            Self::RobotOff => {
                "the robot reports that it has no power or closed brakes: see to that at the robot, then `vservo ctl reset`"
            }
            Self::RobotError => {
                "the robot reports a fault of its own: see to it at the robot, whose log tells which, then `vservo ctl reset`"
            }
            Self::RobotHalted => {
                "the robot reports that what obeys commands there was stopped: `vservo ctl reset` has it started again"
            }
            Self::StopLatched => {
                "a stop was latched from outside: see to its reason, then `vservo ctl reset`"
            }
            Self::CommandsRefused => {
                "commands to the drive would have passed the limits, or were no numbers, and were held back"
            }
            Self::CompanionSilent => {
                "the thread that carries messages to and from the real-time thread hangs: look for a full pipe at stderr, or for a \
                 disk that does not answer"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn codes_come_back_and_are_no_two_the_same() {
        for (fault, code) in Fault::CODES {
            assert_eq!((fault.code(), Fault::from_code(code)), (code, Some(fault)));
        }
        assert_eq!(
            Fault::CODES.iter().map(|(_, code)| *code).collect::<HashSet<_>>().len(),
            Fault::CODES.len()
        );
        assert_eq!(Fault::from_code(0), None);
    }

    /// Each reason is told in words of its own; a robot's are those that its states make, and only what makes joints unknown blinds.
    #[test]
    fn faults_are_told_apart() {
        let faults = Fault::CODES.map(|(fault, _)| fault);
        let words: HashSet<_> = faults.iter().map(|fault| fault.describe()).collect();
        assert!(words.len() == faults.len() && words.iter().all(|words| words.contains(' ')));
        for fault in faults {
            let makes = |state: &RobotState| Fault::of_robot(*state) == Some(fault);
            assert_eq!(fault.is_of_robot(), RobotState::ALL.iter().any(makes), "{fault:?}");
        }
        assert!(Fault::DriveStateNotFinite.blinds() && Fault::DriveStateImplausible.blinds());
        assert!(!Fault::TooFast.blinds() && !Fault::StopLatched.blinds());
    }

    #[test]
    fn a_robot_that_obeys_has_no_fault_and_every_other_has_one() {
        for state in RobotState::ALL {
            let fault = Fault::of_robot(state);
            assert_eq!(fault.is_none(), state.obeys(), "{state:?}");
            assert!(!fault.is_some_and(Fault::blinds), "{state:?}: its joints are measured as before");
            assert!(fault.is_none_or(Fault::is_of_robot), "{state:?}");
        }
    }
}
