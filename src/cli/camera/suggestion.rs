//! What a probe tells, and the table that it suggests for a run file.

use crate::config::Config;
use crate::source::v4l2::{ProbeReport, Spread, StampClock};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// A probe's result, for programs.
#[derive(Debug, Serialize)]
pub(super) struct Probed {
    #[serde(flatten)]
    pub(super) report: ProbeReport,
    pub(super) suggestion: String,
}

/// For people.
pub(super) fn lines(r: &ProbeReport) -> Vec<String> {
    let spread = |s: &Spread| {
        format!("{:.2} ms, 99 of 100 within {:.2} ms, at most {:.2} ms", s.p50_ms, s.p99_ms, s.max_ms)
    };
    let said = r.said_hz.map_or("says no rate".into(), |hz| format!("says {hz:.3} Hz"));
    let clock = match (r.stamp_clock, r.stamp_at_start) {
        (Some(StampClock::Monotonic), true) => "monotonic clock, of the exposure's start",
        (Some(StampClock::Monotonic), false) => "monotonic clock, of the frame's end",
        (Some(StampClock::Copied), _) => "copied from somebody else",
        (Some(StampClock::Unknown) | None, _) => "unknown clock",
    };
    let exposure = match (r.exposure_is_read, r.exposure_is_automatic) {
        (true, true) => "the device's word; it changes by itself",
        (true, false) => "the device's word",
        (false, _) => "assumed: the device does not say",
    };
    let mut lines = vec![
        format!("{}: {} ({}, {})", r.path.display(), r.info.card, r.info.driver, r.info.bus_info),
        format!("  format      {} {}x{} px", r.format, r.width, r.height),
        format!("  rate        {:.3} Hz; asked for {} Hz, the device {said}", r.obtained_hz, r.asked_hz),
        format!(
            "  frames      {} in {:.1} s, lost {} (damaged {}, come together with a newer one {})",
            r.frames, r.duration_s, r.lost, r.corrupt, r.superseded
        ),
        format!("  stamps      {clock}; in the future {}; jitter {}", r.stamps_clamped, spread(&r.jitter)),
        format!("  exposure    {:.2} ms, {exposure}", r.exposure_ms),
        format!("  latency     from the middle of the exposure to grey levels {}", spread(&r.latency)),
        format!("  conversion  into grey levels {}", spread(&r.conversion)),
    ];
    if let Some(doubt) = r.stamps_doubted {
        lines.push(format!("  {doubt}: frames are dated by their arrival (see `vservo calibrate latency`)"));
    }
    lines
}

/// Tables for a run file that fit what was found.
pub(super) fn table(device: &str, r: &ProbeReport) -> String {
    // Chosen by hand: a measurement over a second is off by a frame, and 29.97 Hz of the NTSC standard is written as 30.
    let near = (r.obtained_hz - r.asked_hz).abs() <= 0.02 * r.asked_hz;
    // the range that run files must keep to
    let rate_hz = if near { r.asked_hz } else { (r.obtained_hz * 10.0).round() / 10.0 }.clamp(0.1, 1000.0);
    let period_ms = 1e3 / rate_hz;
    let exposure_ms = (r.exposure_ms.min(period_ms) * 100.0).floor() / 100.0;
    let latency_ms = r.latency.p99_ms.ceil().clamp(1.0, 500.0);
    // Two periods and a latency: a frame may be lost before the arm slows down.
    let min_ms = 2.0 * period_ms + 2.0 * latency_ms;
    let timeout_ms = (min_ms / 0.75 / 10.0).ceil() * 10.0;
    let mut text = String::new();
    let _ = write!(
        text,
        "[camera]\nsource = \"v4l2\"\nwidth_px = {}\nheight_px = {}\nrate_hz = {rate_hz:?}\nexposure_ms = {exposure_ms:?}\n\
         latency_ms = {latency_ms:?}\n\n[camera.v4l2]\ndevice = {}\nformat = \"{}\"\n",
        r.width,
        r.height,
        toml::Value::String(device.into()),
        r.format
    );
    if (r.width, r.height) != (640, 480) {
        let f_px = 800.0 * (f64::from(r.width) / 640.0).min(f64::from(r.height) / 480.0);
        // Chosen by hand: the least that the file's validation would take with a margin.
        let f_px = f_px.max(10.0).round();
        let _ = write!(
            text,
            "\n# A guess: calibrate the lens.\n[camera.lens]\nfx_px = {f_px:?}\nfy_px = {f_px:?}\n"
        );
    }
    // Chosen by hand: the default of the key, which needs no line.
    if timeout_ms > 200.0 {
        let _ = write!(text, "\n[safety]\nmeasurement_timeout_ms = {timeout_ms:?}\n");
    }
    if let Err(problems) = Config::parse("the table above", &text, Path::new("."), &[]) {
        for line in problems.lines() {
            let _ = writeln!(text, "# {}", crate::input::printable(&line));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::v4l2::{FourCc, NodeInfo, NodeKind};

    fn report(width: u32, height: u32, asked_hz: f64, obtained_hz: f64) -> ProbeReport {
        let info = NodeInfo {
            driver: "uvcvideo".into(),
            card: "HD Webcam".into(),
            bus_info: "usb-0000:00:14.0-2".into(),
            kind: NodeKind::Capture,
            planar: false,
        };
        ProbeReport {
            path: "/dev/video0".into(),
            info,
            format: FourCc(*b"YUYV"),
            width,
            height,
            asked_hz,
            said_hz: Some(asked_hz),
            obtained_hz,
            frames: 90,
            lost: 1,
            corrupt: 0,
            superseded: 1,
            duration_s: 3.0,
            jitter: Spread::default(),
            latency: Spread { p50_ms: 21.0, p99_ms: 33.3, max_ms: 40.0 },
            conversion: Spread::default(),
            exposure_ms: 15.6,
            exposure_is_read: true,
            exposure_is_automatic: true,
            stamp_clock: Some(StampClock::Monotonic),
            stamp_at_start: true,
            stamps_clamped: 0,
            stamps_doubted: None,
        }
    }

    /// Whatever camera it is of, the check of run files takes it, without a doubt.
    #[test]
    fn every_suggestion_is_a_run_file() {
        for (width, height) in [(640, 480), (320, 240), (160, 120), (1280, 720), (1920, 1080), (640, 360)] {
            for (asked, obtained) in [(30.0, 29.97), (90.0, 30.3), (5.0, 5.0), (25.0, 12.51), (120.0, 119.9)]
            {
                let text = table("USB \"Camera\"\\ 2", &report(width, height, asked, obtained));
                assert!(!text.contains("# the table"), "{text}");
                let config = Config::parse("probe", &text, Path::new("."), &[]).unwrap();
                // Lens and mount are to be calibrated, which is told.
                let told = |w: &crate::config::Problem| w.key == "camera.lens" || w.key == "camera.mount";
                assert!(config.warnings.iter().all(told), "{:?}\n{text}", config.warnings);
                let v4l2 = &config.effective.camera.v4l2;
                assert_eq!(v4l2.device, "USB \"Camera\"\\ 2");
            }
        }
        assert!(table("/dev/video0", &report(640, 480, 90.0, 30.31)).contains("rate_hz = 30.3\n"));
    }

    #[test]
    fn the_lines_say_what_was_assumed() {
        let text = lines(&report(640, 480, 30.0, 29.97)).join("\n");
        assert!(
            text.contains("29.970 Hz; asked for 30 Hz") && text.contains("of the exposure's start"),
            "{text}"
        );
        let unknown = ProbeReport {
            exposure_is_read: false,
            stamp_clock: Some(StampClock::Unknown),
            stamps_doubted: Some("no clock"),
            ..report(640, 480, 30.0, 30.0)
        };
        let text = lines(&unknown).join("\n");
        assert!(
            text.contains("assumed") && text.contains("unknown clock") && text.contains("by their arrival")
        );
    }
}
