//! Requests and replies.

use super::{HEADER_SIZE, Reader, VERSION, WireError, Writer};
use crate::Joints;

/// What a message asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum RequestKind {
    Connect,
    Move,
    StopMove,
    SetCollisionBehavior,
    SetJointImpedance,
    SetCartesianImpedance,
    SetGuidingMode,
    SetEEToK,
    SetNEToEE,
    SetLoad,
    AutomaticErrorRecovery,
    GetRobotModel,
}

impl RequestKind {
    const ALL: [Self; 12] = [
        Self::Connect,
        Self::Move,
        Self::StopMove,
        Self::SetCollisionBehavior,
        Self::SetJointImpedance,
        Self::SetCartesianImpedance,
        Self::SetGuidingMode,
        Self::SetEEToK,
        Self::SetNEToEE,
        Self::SetLoad,
        Self::AutomaticErrorRecovery,
        Self::GetRobotModel,
    ];

    /// Of its number on the wire.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn of(number: u32) -> Result<Self, WireError> {
        Self::ALL.get(number as usize).copied().ok_or(WireError::UnknownCommand { number })
    }

    /// The maker's name of it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Connect => "Connect",
            Self::Move => "Move",
            Self::StopMove => "Stop Move",
            Self::SetCollisionBehavior => "Set Collision Behavior",
            Self::SetJointImpedance => "Set Joint Impedance",
            Self::SetCartesianImpedance => "Set Cartesian Impedance",
            Self::SetGuidingMode => "Set Guiding Mode",
            Self::SetEEToK => "Set EE to K",
            Self::SetNEToEE => "Set NE to EE",
            Self::SetLoad => "Set Load",
            Self::AutomaticErrorRecovery => "Automatic Error Recovery",
            Self::GetRobotModel => "Get Robot Model",
        }
    }

    /// Bytes of a request's payload.
    fn payload(self) -> usize {
        match self {
            Self::Connect => 4,
            Self::Move => 113,
            Self::SetCollisionBehavior => 416,
            Self::SetJointImpedance => 56,
            Self::SetCartesianImpedance => 48,
            Self::SetGuidingMode => 7,
            Self::SetEEToK | Self::SetNEToEE => 128,
            Self::SetLoad => 104,
            Self::StopMove | Self::AutomaticErrorRecovery | Self::GetRobotModel => 0,
        }
    }
}

/// What makes torques of the values of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveController {
    /// The robot, by joint.
    JointImpedance,
    /// The robot, by the pose of its end.
    CartesianImpedance,
    /// The commands.
    External,
}

/// What the commands of a motion are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MoveGenerator {
    /// Positions of the joints.
    JointPosition,
    /// Velocities of the joints.
    JointVelocity,
    /// Poses, which are not commanded here.
    CartesianPosition,
    /// Twists, which are not commanded here.
    CartesianVelocity,
    /// Torques alone.
    None,
}

/// What came of a `Move`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the maker's words
pub enum MoveStatus {
    Success,
    MotionStarted,
    Preempted,
    PreemptedBySafety,
    RejectedBySafety,
    NotPossible,
    SingularStart,
    InvalidArgument,
    ReflexAborted,
    EmergencyAborted,
    InputErrorAborted,
    Aborted,
}

impl MoveStatus {
    const ALL: [Self; 12] = [
        Self::Success,
        Self::MotionStarted,
        Self::Preempted,
        Self::PreemptedBySafety,
        Self::RejectedBySafety,
        Self::NotPossible,
        Self::SingularStart,
        Self::InvalidArgument,
        Self::ReflexAborted,
        Self::EmergencyAborted,
        Self::InputErrorAborted,
        Self::Aborted,
    ];

    /// Of its byte on the wire; one that nobody knows has aborted the motion.
    #[must_use]
    pub fn of(byte: u8) -> Self {
        Self::ALL.get(usize::from(byte)).copied().unwrap_or(Self::Aborted)
    }

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Success => "it has ended as it was asked to",
            Self::MotionStarted => "it has begun",
            Self::Preempted => "another command took its place",
            Self::PreemptedBySafety => "a safety function has ended it",
            Self::RejectedBySafety => "a safety function is active: switch it off in Desk",
            Self::NotPossible => "the robot is in no mode in which that is possible",
            Self::SingularStart => "it cannot begin at a singular posture",
            Self::InvalidArgument => "an argument is out of its range",
            Self::ReflexAborted => "a reflex has ended it",
            Self::EmergencyAborted => "the user stop was pressed",
            Self::InputErrorAborted => "a command was no number",
            Self::Aborted => "the robot has ended it, or somebody in Desk",
        }
    }
}

/// Contacts and collisions: where the robot tells a touch (lower), and where it stops (upper), while it accelerates and while it does not.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)] // N m and N
pub struct CollisionBehavior {
    pub lower_torques_acceleration: Joints,
    pub upper_torques_acceleration: Joints,
    pub lower_torques_nominal: Joints,
    pub upper_torques_nominal: Joints,
    pub lower_forces_acceleration: [f64; 6],
    pub upper_forces_acceleration: [f64; 6],
    pub lower_forces_nominal: [f64; 6],
    pub upper_forces_nominal: [f64; 6],
}

impl CollisionBehavior {
    /// The same bounds for all joints, N m, and for all directions of the end, N and N m.
    #[must_use]
    pub fn uniform(torque: f64, force: f64) -> Self {
        let (torques, forces) = ([torque; 7], [force; 6]);
        Self {
            lower_torques_acceleration: torques,
            upper_torques_acceleration: torques,
            lower_torques_nominal: torques,
            upper_torques_nominal: torques,
            lower_forces_acceleration: forces,
            upper_forces_acceleration: forces,
            lower_forces_nominal: forces,
            upper_forces_nominal: forces,
        }
    }
}

/// What hangs on the end effector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// kg.
    pub mass_kg: f64,
    /// Centre of mass in the flange's frame, m.
    pub com_F: [f64; 3],
    /// Inertia about it, column by column, kg m2.
    pub inertia_kg_m2: [f64; 9],
}

/// A request.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)] // requests are few, and must not allocate
pub enum Request {
    /// The first one.
    Connect {
        /// What the client speaks.
        version: u16,
        /// Where it takes states.
        udp_port: u16,
    },
    /// Begins a motion.
    Move {
        /// What makes torques.
        controller: MoveController,
        /// What is commanded.
        generator: MoveGenerator,
    },
    /// Ends it.
    StopMove,
    /// Contacts and collisions.
    SetCollisionBehavior(CollisionBehavior),
    /// Stiffness of the joints, N m/rad.
    SetJointImpedance(Joints),
    /// A load.
    SetLoad(Load),
    /// Clears the errors that end by that.
    AutomaticErrorRecovery,
    /// The robot's URDF.
    GetRobotModel,
    /// One that only others send, well formed.
    Other(RequestKind),
}

/// How far a motion may be off its path, m, rad and rad, of path and of goal: what the maker's own client asks for in every motion.
const DEVIATION: [f64; 6] = [10.0, 3.12, std::f64::consts::TAU, 10.0, 3.12, std::f64::consts::TAU];
/// Bytes of the longest request.
pub(crate) const LONGEST: usize = HEADER_SIZE + 416;

impl Request {
    /// What it asks for.
    #[must_use]
    pub fn kind(&self) -> RequestKind {
        match self {
            Self::Connect { .. } => RequestKind::Connect,
            Self::Move { .. } => RequestKind::Move,
            Self::StopMove => RequestKind::StopMove,
            Self::SetCollisionBehavior(_) => RequestKind::SetCollisionBehavior,
            Self::SetJointImpedance(_) => RequestKind::SetJointImpedance,
            Self::SetLoad(_) => RequestKind::SetLoad,
            Self::AutomaticErrorRecovery => RequestKind::AutomaticErrorRecovery,
            Self::GetRobotModel => RequestKind::GetRobotModel,
            Self::Other(kind) => *kind,
        }
    }

    /// As bytes, into room for the longest; how many.
    pub(crate) fn encode(&self, number: u32, room: &mut [u8; LONGEST]) -> usize {
        let size = HEADER_SIZE + self.kind().payload();
        let mut writer = Writer::new(room);
        writer.put(&header(self.kind(), number, size));
        match self {
            Self::Connect { version, udp_port } => {
                writer.put(&version.to_le_bytes());
                writer.put(&udp_port.to_le_bytes());
            }
            Self::Move { controller, generator } => {
                writer.put(&(*controller as u32).to_le_bytes());
                writer.put(&(*generator as u32).to_le_bytes());
                writer.f64s(&DEVIATION);
                // Not the generator that takes commands at any rate, and its velocities.
                writer.put(&[0]);
                writer.f64s(&[0.0; 7]);
            }
            Self::SetCollisionBehavior(b) => {
                for torques in [
                    &b.lower_torques_acceleration,
                    &b.upper_torques_acceleration,
                    &b.lower_torques_nominal,
                    &b.upper_torques_nominal,
                ] {
                    writer.f64s(torques);
                }
                for forces in [
                    &b.lower_forces_acceleration,
                    &b.upper_forces_acceleration,
                    &b.lower_forces_nominal,
                    &b.upper_forces_nominal,
                ] {
                    writer.f64s(forces);
                }
            }
            Self::SetJointImpedance(stiffness) => writer.f64s(stiffness),
            Self::SetLoad(load) => {
                writer.f64s(&[load.mass_kg]);
                writer.f64s(&load.com_F);
                writer.f64s(&load.inertia_kg_m2);
            }
            Self::StopMove | Self::AutomaticErrorRecovery | Self::GetRobotModel | Self::Other(_) => {}
        }
        size
    }
}

fn header(kind: RequestKind, number: u32, size: usize) -> [u8; HEADER_SIZE] {
    let mut bytes = [0; HEADER_SIZE];
    let mut writer = Writer::new(&mut bytes);
    writer.put(&(kind as u32).to_le_bytes());
    writer.put(&number.to_le_bytes());
    writer.put(&(size as u32).to_le_bytes());
    bytes
}

/// A request of its payload.
///
/// # Errors
/// When it is longer or shorter than it has to be, or has values that are none.
pub fn read_request(kind: RequestKind, payload: &[u8]) -> Result<Request, WireError> {
    if payload.len() != kind.payload() {
        return Err(WireError::Size { size: (HEADER_SIZE + payload.len()) as u32 });
    }
    let mut reader = Reader::new(payload);
    Ok(match kind {
        RequestKind::Connect => Request::Connect {
            version: u16::from_le_bytes(reader.take("version")?),
            udp_port: u16::from_le_bytes(reader.take("port")?),
        },
        RequestKind::Move => {
            let controller = match reader.u32("controller")? {
                0 => MoveController::JointImpedance,
                1 => MoveController::CartesianImpedance,
                2 => MoveController::External,
                value => return Err(WireError::Value { what: "the controller", value }),
            };
            let generator = match reader.u32("motion generator")? {
                0 => MoveGenerator::JointPosition,
                1 => MoveGenerator::JointVelocity,
                2 => MoveGenerator::CartesianPosition,
                3 => MoveGenerator::CartesianVelocity,
                4 => MoveGenerator::None,
                value => return Err(WireError::Value { what: "the motion generator", value }),
            };
            Request::Move { controller, generator }
        }
        RequestKind::StopMove => Request::StopMove,
        RequestKind::SetCollisionBehavior => Request::SetCollisionBehavior(CollisionBehavior {
            lower_torques_acceleration: reader.f64s("torques")?,
            upper_torques_acceleration: reader.f64s("torques")?,
            lower_torques_nominal: reader.f64s("torques")?,
            upper_torques_nominal: reader.f64s("torques")?,
            lower_forces_acceleration: reader.f64s("forces")?,
            upper_forces_acceleration: reader.f64s("forces")?,
            lower_forces_nominal: reader.f64s("forces")?,
            upper_forces_nominal: reader.f64s("forces")?,
        }),
        RequestKind::SetJointImpedance => Request::SetJointImpedance(reader.f64s("stiffness")?),
        RequestKind::SetLoad => {
            let [mass_kg] = reader.f64s("mass")?;
            let (com_F, inertia_kg_m2) = (reader.f64s("centre")?, reader.f64s("inertia")?);
            Request::SetLoad(Load { mass_kg, com_F, inertia_kg_m2 })
        }
        RequestKind::AutomaticErrorRecovery => Request::AutomaticErrorRecovery,
        RequestKind::GetRobotModel => Request::GetRobotModel,
        other => Request::Other(other),
    })
}

/// A reply of a status, and what follows it.
#[must_use]
pub fn encode_reply(kind: RequestKind, number: u32, status: u8, more: &[u8]) -> Vec<u8> {
    let size = HEADER_SIZE + 1 + more.len();
    [&header(kind, number, size)[..], &[status], more].concat()
}

/// The reply to a `Connect`: 0 it may, 1 it speaks another version.
#[must_use]
pub fn encode_connect_reply(number: u32, version: u16) -> Vec<u8> {
    encode_reply(RequestKind::Connect, number, u8::from(version != VERSION), &version.to_le_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes as `sizeof` tells them for the maker's structures (version 10, gcc 12, packed by one).
    #[test]
    fn requests_are_as_long_as_the_makers() {
        let load = Load { mass_kg: 1.5, com_F: [0.1, 0.2, 0.3], inertia_kg_m2: [0.5; 9] };
        let cases = [
            (Request::Connect { version: 10, udp_port: 50_000 }, 16),
            (Request::Move { controller: MoveController::External, generator: MoveGenerator::None }, 125),
            (Request::StopMove, 12),
            (Request::SetCollisionBehavior(CollisionBehavior::uniform(20.0, 30.0)), 12 + 416),
            (Request::SetJointImpedance([3000.0; 7]), 12 + 56),
            (Request::SetLoad(load), 12 + 104),
            (Request::AutomaticErrorRecovery, 12),
            (Request::GetRobotModel, 12),
        ];
        for (request, size) in cases {
            let mut room = [0; LONGEST];
            let written = request.encode(7, &mut room);
            assert_eq!(written, size, "{request:?}");
            assert_eq!(room[8..12], (size as u32).to_le_bytes());
            assert_eq!(room[4..8], 7_u32.to_le_bytes());
            assert_eq!(read_request(request.kind(), &room[12..size]), Ok(request));
            assert!(read_request(request.kind(), &room[..size]).is_err());
        }
        assert_eq!(encode_reply(RequestKind::Move, 1, 0, &[]).len(), 13);
        assert_eq!(encode_connect_reply(0, 10).len(), 15);
        // The deviations of a path stand behind the two modes, the asynchronous generator's flag behind those.
        let mut room = [0; LONGEST];
        Request::Move { controller: MoveController::JointImpedance, generator: MoveGenerator::JointVelocity }
            .encode(0, &mut room);
        assert_eq!(room[12 + 8..12 + 16], 10.0_f64.to_le_bytes());
        assert_eq!((room[12 + 4], room[12 + 56]), (1, 0));
    }
}
