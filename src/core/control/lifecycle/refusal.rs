//! Why a request is refused, as a code and in words.

/// The reason why a request is refused.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Refusal {
    /// There is a fault.
    InFault = 1,
    /// There is no fault that could be reset.
    NoFault = 2,
    /// The arm still moves.
    StillMoving = 3,
    /// It was started before.
    AlreadyStarted = 4,
    /// Nothing was started that could be held.
    NotStarted = 5,
    /// The goal is being taught.
    Teaching = 6,
    /// The run ends.
    Ending = 7,
    /// No request has this code.
    UnknownRequest = 8,
    /// There is no such arm.
    UnknownArm = 9,
    /// The run still waits for what it needs.
    NotReady = 10,
    /// There is no such camera, or there are two with a goal each.
    UnknownCamera = 11,
    /// The numbers of the request are none that it takes.
    WrongNumbers = 12,
    /// A goal of other points than those of the target.
    OtherPoints = 13,
    /// A goal in which the target is not in the image.
    OutOfView = 14,
    /// A posture outside the joints' ranges.
    OutOfRange = 15,
    /// No posture of this arm has the camera there.
    OutOfReach = 16,
    /// Farther than one jog goes.
    TooFar = 17,
    /// The law has no single gain.
    NoGain = 18,
    /// The run has no arm that it moves.
    NoArm = 19,
    /// A posture beyond a limit in space, or a way there through one.
    OutOfWorkspace = 20,
    /// The robot is in an emergency stop.
    RobotEmergencyStop = 21,
    /// The robot has no power, or its brakes are closed.
    RobotOff = 22,
    /// The robot has a fault of its own.
    RobotFault = 23,
    /// There is no such target.
    UnknownTarget = 24,
    /// A goal so far away that the target could not be found in the image.
    TooSmall = 25,
    /// A goal from which the camera looks at the back of the target.
    FromBehind = 26,
    /// A goal from which the camera sees the plane of the target edge-on.
    EdgeOn = 27,
}

impl Refusal {
    /// All reasons.
    pub const ALL: [Self; 27] = [
        Self::InFault,
        Self::NoFault,
        Self::StillMoving,
        Self::AlreadyStarted,
        Self::NotStarted,
        Self::Teaching,
        Self::Ending,
        Self::UnknownRequest,
        Self::UnknownArm,
        Self::NotReady,
        Self::UnknownCamera,
        Self::WrongNumbers,
        Self::OtherPoints,
        Self::OutOfView,
        Self::OutOfRange,
        Self::OutOfReach,
        Self::TooFar,
        Self::NoGain,
        Self::NoArm,
        Self::OutOfWorkspace,
        Self::RobotEmergencyStop,
        Self::RobotOff,
        Self::RobotFault,
        Self::UnknownTarget,
        Self::TooSmall,
        Self::FromBehind,
        Self::EdgeOn,
    ];

    /// The reason and the remedy, for people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::InFault => "there is a fault: see to its cause, then `reset`",
            Self::NoFault => "there is no fault",
            Self::StillMoving => "the arm still moves: wait until it stands",
            Self::AlreadyStarted => "it was started already: `hold` or `stop` first",
            Self::NotStarted => "nothing was started that could be held",
            Self::Teaching => "the goal is being taught: wait, or `hold` to give that up",
            Self::Ending => "the run is ending",
            Self::UnknownRequest => "this run knows no such request: do both run the same version of vservo?",
            Self::UnknownArm => "this run has one arm, number 0",
            Self::NotReady => "the run is still starting: it waits for its external drive",
            Self::UnknownCamera => "a goal is for camera 0 of a run with one; two keep those of the run file",
            Self::WrongNumbers => "its numbers are none that this run takes",
            Self::TooSmall => "the target would be smaller than 8 px at that goal: is it given in m?",
            Self::FromBehind => {
                "the camera would see the back of the target: its z must point away from the camera"
            }
            Self::EdgeOn => {
                "the camera would see the target edge-on, by more than 88 degrees, where nothing finds it: turn it more towards the camera"
            }
            Self::OtherPoints => {
                "the goal is of other points than the target of this run: teach it with the same run file, or give a pose"
            }
            Self::OutOfView => {
                "the target would not be in the image at that goal: a goal is the pose of the target in the camera, x to the right, y down, z \
                 ahead"
            }
            Self::OutOfRange => "a joint would leave its range there",
            Self::OutOfReach => "no posture of this arm near the present one has the camera there",
            Self::TooFar => {
                "one jog moves a joint by 0.2 rad or 0.05 m at most, and the camera by 0.05 m and 0.2 rad: `goto` goes farther"
            }
            Self::NoGain => {
                "this law has no single gain: that of schemes B, D and hybrid can be set where servo.gain_1_s is one number and \
                 servo.adaptive_gain is left out"
            }
            Self::NoArm => "this run has no arm that it could move",
            Self::OutOfWorkspace => {
                "the arm would be beyond a limit of [workspace] there, or on the straight way of its joints: go round it by another posture"
            }
            Self::RobotEmergencyStop => {
                "the robot is in an emergency stop, which is not cleared from here: release its button, power the robot and open its brakes at the \
                 robot, then `reset` again"
            }
            Self::RobotOff => {
                "the robot has no power or its brakes are closed, and it is not powered from here: do that at the robot, then `reset` again"
            }
            Self::UnknownTarget => {
                "the run has no such target: `[target]` of its run file is number 0, and `[targets.NAME]` follow in the order of their names"
            }
            Self::RobotFault => {
                "the robot has a fault of its own, which is not cleared from here: see to it at the robot, then `reset` again"
            }
        }
    }

    /// The reason of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|refusal| *refusal as u32 == code)
    }
}
