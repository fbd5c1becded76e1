//! Words of an external drive, `drive/text`: the names of its joints with START, and what its maker says where the robot has stopped.
//!
//! ```text
//! control ── START ────────────────► drive
//! control ◄─ JOINTS: names ───────── drive     before the state with INITIAL: control compares them with the robot file
//! control ◄─ PROPERTIES: lines ───── drive     likewise: how often its states come, how long it goes on without a command
//! control ◄─ INITIAL, tick 0 ─────── drive
//!
//! control ◄─ ROBOT: words ────────── drive     before the state that shows the stop
//! ```
//! A drive that sends nothing here is one that tells no names and no words.

use super::layout::{named_codes, record};
use super::{MAX_JOINTS, RobotState};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// Bytes of a text, its end included. Chosen by hand: seven names of 63 bytes with what separates them, or some sentences.
pub const DRIVE_TEXT_BYTES: usize = 512;

record! {
    "vservo.DriveText.v1",
    /// Words of an external drive.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct DriveTextMsg {
        /// Counts what the drive has sent on this service since it joined, from 0.
        pub sequence: u64,
        /// When it was sent, `CLOCK_MONOTONIC`.
        pub stamp: MonoNs,
        /// What the text is, one of [`text_kind`]: 1 the names of the joints, 2 the maker's words for what the robot is, 3 properties of the drive.
        pub kind: u32,
        /// Joints in use, with names.
        pub joints: u32,
        /// With words: the state of the robot that they are about, code of a [`RobotState`]; 0 where they are about none.
        pub robot_state: u32,
        /// With words: the maker's own code; 0 where there is none.
        pub robot_code: u32,
        /// With names: how each joint counts against the joint of that name in the maker's description: 1, or -1 the other way round; 0 where the drive does not tell.
        pub signs: [f64; MAX_JOINTS],
        /// With names: where that joint stands when this one is at zero, rad or m; 0 where the drive does not tell.
        pub zero_offsets: [f64; MAX_JOINTS],
        /// The text, UTF-8, with a zero byte at its end. Names are separated by line feeds, in the order of the drive's joints.
        pub text: [u8; DRIVE_TEXT_BYTES],
    }
}

named_codes! {
    /// Values of [`DriveTextMsg::kind`]. The numbers here are those of the protocol, which every drive's program must share.
    pub mod text_kind {
        /// Names of the joints.
        pub const JOINTS: u32 = 1;
        /// Words about the robot.
        pub const ROBOT: u32 = 2;
        /// What the drive tells of itself, a line each: `period_ms`, `watchdog_ms`, `effort_rate`. Chosen by hand: the next number.
        pub const PROPERTIES: u32 = 3;
    }
}

impl Default for DriveTextMsg {
    fn default() -> Self {
        Self {
            sequence: 0,
            stamp: MonoNs::ZERO,
            kind: 0,
            joints: 0,
            robot_state: 0,
            robot_code: 0,
            signs: [0.0; MAX_JOINTS],
            zero_offsets: [0.0; MAX_JOINTS],
            text: [0; DRIVE_TEXT_BYTES],
        }
    }
}

impl DriveTextMsg {
    /// The names of the joints of a drive whose joints are those of the maker's description.
    #[must_use]
    pub fn of_joints<S: AsRef<str>>(names: &[S]) -> Self {
        let names: Vec<_> = names.iter().map(AsRef::as_ref).collect();
        let mut signs = [0.0; MAX_JOINTS];
        signs.iter_mut().take(names.len()).for_each(|sign| *sign = 1.0);
        let (kind, joints) = (text_kind::JOINTS, names.len() as u32);
        Self { kind, joints, signs, text: text_bytes(&names.join("\n")), ..Self::default() }
    }

    /// Words about a robot in this state.
    #[must_use]
    pub fn of_robot(state: RobotState, code: u32, words: &str) -> Self {
        let (kind, robot_state, robot_code) = (text_kind::ROBOT, state as u32, code);
        Self { kind, robot_state, robot_code, text: text_bytes(words), ..Self::default() }
    }

    /// What a drive tells of itself, in lines.
    #[must_use]
    pub fn of_properties(lines: &str) -> Self {
        Self { kind: text_kind::PROPERTIES, text: text_bytes(lines), ..Self::default() }
    }

    /// The text; what is no UTF-8 is replaced.
    #[must_use]
    pub fn text(&self) -> String {
        text_of(&self.text)
    }

    /// The names, in the order of the drive's joints.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.text().lines().map(|name| name.trim().to_owned()).collect()
    }
}

/// A text in the bytes of a record, cut between two characters where it is too long.
fn text_bytes(text: &str) -> [u8; DRIVE_TEXT_BYTES] {
    let mut bytes = [0; DRIVE_TEXT_BYTES];
    // One byte is left for the end.
    let fits = text.floor_char_boundary(DRIVE_TEXT_BYTES - 1);
    let text = text.get(..fits).unwrap_or_default();
    bytes.iter_mut().zip(text.bytes()).for_each(|(to, from)| *to = from);
    bytes
}

/// The text in the bytes of a record.
pub(super) fn text_of(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(bytes.get(..end).unwrap_or_default()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn the_layout_is_fixed_and_named() {
        assert_eq!((size_of::<DriveTextMsg>(), align_of::<DriveTextMsg>()), (656, 8));
        assert_eq!((offset_of!(DriveTextMsg, kind), offset_of!(DriveTextMsg, robot_code)), (16, 28));
        assert_eq!((offset_of!(DriveTextMsg, signs), offset_of!(DriveTextMsg, zero_offsets)), (32, 88));
        assert_eq!(offset_of!(DriveTextMsg, text), 144);
        // SAFETY: the name is only read.
        assert_eq!(unsafe { DriveTextMsg::type_name() }, "vservo.DriveText.v1");
    }

    #[test]
    fn texts_come_back_and_long_ones_are_cut_between_characters() {
        let names = ["shoulder_pan_joint", "Drehgelenk für Ellbogen", "j3"];
        let told = DriveTextMsg::of_joints(&names);
        assert_eq!(
            (told.kind, told.joints, told.names()),
            (text_kind::JOINTS, 3, names.map(String::from).to_vec())
        );
        assert_eq!(told.signs, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(DriveTextMsg::default().names().is_empty());
        let long = "ü".repeat(400);
        let words = DriveTextMsg::of_robot(RobotState::ProtectiveStop, 703, &long);
        assert_eq!(words.text(), "ü".repeat((DRIVE_TEXT_BYTES - 1) / 2));
        // Whatever a drive writes, it is read.
        let hostile = DriveTextMsg { text: [0xff; DRIVE_TEXT_BYTES], ..words };
        assert_eq!(hostile.text().chars().count(), DRIVE_TEXT_BYTES);
    }
}
