//! The robot behind an external drive, as it is shown.

use super::run_view::RunView;
use crate::input::printable;
use crate::messages::{DriveStateMsg, DriveTextMsg, RobotState, text_kind};
use serde::Serialize;

/// A robot behind its drive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RobotRow {
    /// What it is, in words, with the maker's code and words.
    pub words: String,
    /// The maker's code alone.
    pub code: Option<u32>,
    /// Whether it obeys commands.
    pub obeys: bool,
}

impl RunView {
    /// Takes in a state of an external drive, which tells the maker's code too.
    pub fn drive_state(&mut self, record: &DriveStateMsg) {
        self.robot_code = Some((RobotState::from_code(record.robot_state), record.robot_code));
    }

    /// Takes in words of an external drive: those about the robot.
    pub fn drive_text(&mut self, record: &DriveTextMsg) {
        if record.kind == text_kind::ROBOT {
            self.robot_text = Some((RobotState::from_code(record.robot_state), record.text()));
        }
    }

    /// The robot; `None` where its drive does not tell what it is.
    pub(super) fn robot_row(&self) -> Option<RobotRow> {
        if self.robot == RobotState::Unknown {
            return None;
        }
        // What the drive said last may be of another state than what control has heard.
        let code = self.robot_code.filter(|(state, code)| *state == self.robot && *code != 0);
        let code = code.map(|(_, code)| code);
        let told = code.map_or_else(String::new, |code| format!(" (code {code})"));
        let text = self.robot_text.as_ref().filter(|(state, text)| *state == self.robot && !text.is_empty());
        let text = text.map_or_else(String::new, |(_, text)| format!(": {}", printable(text)));
        let words = self.robot.as_str().replace('_', " ") + &told + &text;
        Some(RobotRow { words, code, obeys: self.robot.obeys() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{TraceMsg, trace_flag};
    use crate::monitor::CellFacts;
    use crate::time::MonoNs;

    #[test]
    fn a_robot_is_told_with_its_code_and_its_change_is_an_event() {
        let mut view = RunView::new(CellFacts::default());
        let tick = |state: RobotState| TraceMsg {
            flags: (state as u32) << trace_flag::ROBOT_STATE,
            ..TraceMsg::default()
        };
        view.tick(&tick(RobotState::Unknown));
        assert_eq!((view.robot_row(), view.snapshot(MonoNs(0), Vec::new()).robot), (None, None));
        view.tick(&tick(RobotState::Moving));
        let stopped = DriveStateMsg {
            robot_state: RobotState::ProtectiveStop as u32,
            robot_code: 703,
            ..DriveStateMsg::default()
        };
        view.drive_state(&stopped);
        let before = view.robot_row().unwrap();
        assert_eq!((before.words.as_str(), before.code, before.obeys), ("moving", None, true));
        view.tick(&tick(RobotState::ProtectiveStop));
        let now = view.snapshot(MonoNs(0), Vec::new()).robot.unwrap();
        assert_eq!(
            (now.words.as_str(), now.code, now.obeys),
            ("protective stop (code 703)", Some(703), false)
        );
        view.drive_text(&DriveTextMsg::of_robot(
            RobotState::ProtectiveStop,
            703,
            "C157A2: a joint hit something",
        ));
        view.drive_text(&DriveTextMsg::of_joints(&["shoulder"]));
        let words = view.robot_row().unwrap().words;
        assert_eq!(words, "protective stop (code 703): C157A2: a joint hit something");
        let events: Vec<_> = view.kept_events().iter().map(|(_, what)| what.as_str()).collect();
        assert_eq!(events, ["robot: moving", "robot: protective stop (code 703)"]);
    }
}
