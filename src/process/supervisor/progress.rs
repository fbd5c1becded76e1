//! The line that shows how a run goes: rewritten in place on a terminal, one line a second elsewhere.

use crate::messages::{CameraState, ControlState, Status, TargetStatus, status_flag};
use crate::rt::{CLEAR_LINE, LogFormat, Stderr, log_format, now, tell};
use crate::time::{MonoNs, SpanNs};
use std::io::{IsTerminal, Write, stderr};

/// Periods of the line on a terminal, where it is rewritten, and elsewhere, where each one stays. Chosen by hand, for people.
const ON_TERMINAL: SpanNs = SpanNs(100_000_000);
const ELSEWHERE: SpanNs = SpanNs(1_000_000_000);

pub(super) struct Progress {
    terminal: bool,
    /// A daemon's log has a line for each change alone.
    served: bool,
    state: Option<(u32, u32)>,
    next: MonoNs,
    open_line: bool,
}

impl Progress {
    pub(super) fn new(served: bool) -> Self {
        let terminal = stderr().is_terminal() && log_format() == LogFormat::Text;
        Self { terminal, served, state: None, next: MonoNs::ZERO, open_line: false }
    }

    pub(super) fn show(&mut self, status: &Status) {
        let changed = self.state.replace((status.state, status.camera_state));
        let changed = changed != Some((status.state, status.camera_state));
        if self.served && !self.terminal {
            if !changed {
                return;
            }
        } else if now() < self.next {
            return;
        }
        self.next = now() + if self.terminal { ON_TERMINAL } else { ELSEWHERE };
        let line = line(status);
        if self.terminal {
            let _ = Stderr.write_all(format!("{CLEAR_LINE}{line}").as_bytes());
        } else {
            tell(line);
        }
        self.open_line = self.terminal;
    }

    pub(super) fn end(&mut self) {
        if std::mem::take(&mut self.open_line) {
            let _ = writeln!(Stderr);
        }
    }
}

fn line(s: &Status) -> String {
    let state = ControlState::from_code(s.state).as_str();
    let target = TargetStatus::from_code(s.target);
    let mut line = format!("{:8.2} s  {state:<9}", s.time_s);
    if s.feature_error_px.is_finite() {
        line += &format!("  feature error {:9.3} px", s.feature_error_px);
    }
    if s.position_error_m.is_finite() {
        let degrees = s.orientation_error_rad.to_degrees();
        line += &format!("  camera {:8.2} mm {degrees:7.3} deg from the goal", s.position_error_m * 1e3);
    }
    if s.V_C.iter().all(|x| x.is_finite()) && s.measurements > 0 {
        let [vx, vy, vz] = [s.V_C[0], s.V_C[1], s.V_C[2]].map(|v| v * 1e3);
        let [wx, wy, wz] = [s.V_C[3], s.V_C[4], s.V_C[5]].map(f64::to_degrees);
        line +=
            &format!("  camera v {vx:+7.1} {vy:+7.1} {vz:+7.1} mm/s  w {wx:+6.1} {wy:+6.1} {wz:+6.1} deg/s");
    }
    let camera = CameraState::from_code(s.camera_state);
    if camera.is_away() {
        line += &format!("  (camera {} for {:.1} s)", camera.as_str(), s.camera_state_s);
    } else if target != TargetStatus::Found && s.measurements > 0 {
        line += &format!("  ({})", target.as_str());
    } else if s.flags & status_flag::DEGRADED != 0 {
        line += "  (degraded: a part of the target is hidden)";
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_progress_line_shows_what_is_known() {
        let mut s = Status {
            time_s: 1.5,
            state: ControlState::Servoing as u32,
            measurements: 3,
            V_C: [f64::NAN; 6],
            ..Status::default()
        };
        s.feature_error_px = 12.0;
        s.position_error_m = f64::NAN;
        assert_eq!(line(&s), "    1.50 s  servoing   feature error    12.000 px");
        s.V_C = [0.1, -0.02, 0.0, 0.0, 0.0, -std::f64::consts::PI];
        assert_eq!(
            line(&s),
            "    1.50 s  servoing   feature error    12.000 px  camera v  +100.0   -20.0    +0.0 mm/s  w   +0.0   +0.0 -180.0 deg/s"
        );
        s.V_C = [f64::NAN; 6];
        s.target = TargetStatus::NoContrast as u32;
        s.feature_error_px = f64::NAN;
        assert_eq!(line(&s), "    1.50 s  servoing   (no contrast in the frame)");
        s.target = TargetStatus::Found as u32;
        s.flags = status_flag::DEGRADED;
        assert_eq!(line(&s), "    1.50 s  servoing   (degraded: a part of the target is hidden)");
        (s.camera_state, s.camera_state_s) = (CameraState::Gone as u32, 3.24);
        assert_eq!(line(&s), "    1.50 s  servoing   (camera unplugged for 3.2 s)");
    }
}
