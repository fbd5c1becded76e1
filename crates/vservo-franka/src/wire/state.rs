//! A state of one cycle.

use super::{Reader, WireError, Writer};
use crate::{JOINTS, Joints, robot};

/// Bytes of a state.
pub const ROBOT_STATE_SIZE: usize = 1377;
/// Errors that a state has a byte for.
pub const ERRORS: usize = 41;
/// A pose without translation and rotation, column by column.
pub const RIGID: [f64; 16] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// What the robot tells in every cycle, as far as it is used here. Numbers but the first have single precision on the wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Counts milliseconds of the controller.
    pub message_id: u64,
    /// Mass of the end effector and of the load, kg.
    pub masses_kg: [f64; 2],
    /// Measured torques of the joints, N m.
    pub tau: Joints,
    /// Commanded ones without gravity, N m.
    pub tau_d: Joints,
    /// Measured positions, rad.
    pub q: Joints,
    /// Positions that are commanded now, rad.
    pub q_d: Joints,
    /// Measured velocities, rad/s.
    pub dq: Joints,
    /// Velocities that are commanded now, rad/s.
    pub dq_d: Joints,
    /// Accelerations that are commanded now, rad/s2.
    pub ddq_d: Joints,
    /// Torques from outside, filtered, N m.
    pub tau_external: Joints,
    /// What is commanded.
    pub generator: robot::Generator,
    /// What makes torques.
    pub controller: robot::Controller,
    /// Errors that there are: a bit each, in the maker's order.
    pub errors: u64,
    /// Errors that ended the last motion.
    pub reflex_reason: u64,
    /// The robot's mode.
    pub mode: robot::RobotMode,
    /// Share of the last hundred commands that came in time.
    pub success_rate: f64,
}

impl RobotState {
    /// A robot at rest.
    #[must_use]
    pub fn at(q: Joints) -> Self {
        let zero = [0.0; JOINTS];
        Self {
            message_id: 0,
            masses_kg: [0.0; 2],
            tau: zero,
            tau_d: zero,
            q,
            q_d: q,
            dq: zero,
            dq_d: zero,
            ddq_d: zero,
            tau_external: zero,
            generator: robot::Generator::Idle,
            controller: robot::Controller::Other,
            errors: 0,
            reflex_reason: 0,
            mode: robot::RobotMode::Idle,
            success_rate: 0.0,
        }
    }

    /// From bytes.
    ///
    /// # Errors
    /// When they are not as many as a state has.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let sized = <&[u8; ROBOT_STATE_SIZE]>::try_from(bytes);
        let bytes =
            sized.map_err(|_| WireError::Size { size: u32::try_from(bytes.len()).unwrap_or(u32::MAX) })?;
        let at = |place: usize| Reader::new(bytes.get(place..).unwrap_or_default());
        let joints = |place| at(place).f32s::<JOINTS>("joints");
        let [ee] = at(392).f32s("mass")?;
        let [load] = at(444).f32s("mass")?;
        let [success_rate] = at(1373).f32s("rate")?;
        Ok(Self {
            message_id: u64::from_le_bytes(at(0).take("number")?),
            masses_kg: [ee, load],
            tau: joints(512)?,
            tau_d: joints(540)?,
            q: joints(596)?,
            q_d: joints(624)?,
            dq: joints(652)?,
            dq_d: joints(680)?,
            ddq_d: joints(708)?,
            tau_external: joints(840)?,
            generator: robot::Generator::of(at(1288).u8("generator")?),
            controller: robot::Controller::of(at(1289).u8("controller")?),
            errors: bits(&at(1290).take::<ERRORS>("errors")?),
            reflex_reason: bits(&at(1331).take::<ERRORS>("reasons")?),
            mode: robot::RobotMode::of(at(1372).u8("mode")?),
            success_rate,
        })
    }

    /// As bytes. Poses of the end are those of a tool that is none; forces, elbow and accelerometers are zero.
    #[must_use]
    pub fn encode(&self) -> [u8; ROBOT_STATE_SIZE] {
        let mut bytes = [0; ROBOT_STATE_SIZE];
        let mut writer = Writer::new(&mut bytes);
        writer.put(&self.message_id.to_le_bytes());
        for _ in 0..6 {
            writer.f32s(&RIGID);
        }
        let [ee, load] = self.masses_kg;
        for mass in [ee, load] {
            writer.f32s(&[mass]);
            writer.f32s(&[0.0; 12]); // inertia, centre
        }
        writer.f32s(&[0.0; 4]); // elbow
        writer.f32s(&self.tau);
        writer.f32s(&self.tau_d);
        writer.f32s(&[0.0; JOINTS]);
        for values in [&self.q, &self.q_d, &self.dq, &self.dq_d, &self.ddq_d] {
            writer.f32s(values);
        }
        writer.f32s(&[0.0; 26]); // contacts, collisions
        writer.f32s(&self.tau_external);
        writer.f32s(&[0.0; 18]); // forces, twist
        writer.f32s(&[0.0, 0.0, -9.81]);
        writer.f32s(&[0.0; 6]);
        writer.f32s(&RIGID);
        writer.f32s(&[0.0; 12]);
        writer.f32s(&self.q); // motors, of rigid joints
        writer.f32s(&self.dq);
        writer.f32s(&[0.0; 36]); // accelerometers
        writer.put(&[self.generator.number(), self.controller.number()]);
        writer.put(&bytes_of(self.errors));
        writer.put(&bytes_of(self.reflex_reason));
        writer.put(&[self.mode.number()]);
        writer.f32s(&[self.success_rate]);
        debug_assert_eq!(writer.place(), ROBOT_STATE_SIZE);
        bytes
    }

    /// Whether every number is one.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let joints = [&self.q, &self.dq, &self.q_d, &self.dq_d, &self.ddq_d, &self.tau_d];
        joints.into_iter().flatten().all(|v| v.is_finite())
    }
}

fn bits(bytes: &[u8; ERRORS]) -> u64 {
    bytes.iter().enumerate().filter(|(_, byte)| **byte != 0).fold(0, |bits, (i, _)| bits | 1 << i)
}

fn bytes_of(bits: u64) -> [u8; ERRORS] {
    std::array::from_fn(|i| u8::from(bits >> i & 1 != 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Controller, Generator, RobotMode};

    /// Places as `offsetof` tells them for the maker's structure (version 10, gcc 12, packed by one).
    #[test]
    fn places_are_those_of_the_makers_structure() {
        let joints = |first: f64| std::array::from_fn(|i| first + i as f64);
        let state = RobotState {
            message_id: 0x0102_0304_0506_0708,
            masses_kg: [0.5, 1.5],
            tau: joints(10.0),
            tau_d: joints(20.0),
            q: joints(30.0),
            q_d: joints(40.0),
            dq: joints(50.0),
            dq_d: joints(60.0),
            ddq_d: joints(70.0),
            tau_external: joints(80.0),
            generator: Generator::JointVelocity,
            controller: Controller::External,
            errors: 1 << 25,
            reflex_reason: 1 | 1 << 40,
            mode: RobotMode::Reflex,
            success_rate: 0.75,
        };
        let bytes = state.encode();
        assert_eq!(bytes.len(), 1377);
        let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let of_the_maker = [
            (8, 1.0),     // O_T_EE
            (328, 1.0),   // NE_T_EE
            (392, 0.5),   // m_ee
            (444, 1.5),   // m_load
            (512, 10.0),  // tau_J
            (540, 20.0),  // tau_J_d
            (596, 30.0),  // q
            (624, 40.0),  // q_d
            (652, 50.0),  // dq
            (680, 60.0),  // dq_d
            (708, 70.0),  // ddq_d
            (736, 0.0),   // joint_contact
            (840, 80.0),  // tau_ext_hat_filtered
            (948, -9.81), // the last of O_ddP_O
            (976, 1.0),   // O_T_EE_c
            (1088, 30.0), // theta
            (1116, 50.0), // dtheta
            (1373, 0.75), // control_command_success_rate
        ];
        for (place, value) in of_the_maker {
            assert_eq!(number(place), value, "{place}");
        }
        assert_eq!(bytes[..8], [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(
            (bytes[1288], bytes[1289], bytes[1290 + 25], bytes[1331], bytes[1331 + 40]),
            (2, 2, 1, 1, 1)
        );
        assert_eq!(bytes[1372], 4);
        assert_eq!(RobotState::decode(&bytes), Ok(state));
        assert!(RobotState::decode(&bytes[..1376]).is_err());
    }
}
