//! What became of the target in the image, and of the frames.

use super::{Cause, RunEvidence, RunFinding};
use crate::control::outcome::Outcome;
use std::collections::BTreeMap;

/// Share of frames whose loss is told. Chosen by hand: the law looks ahead over one missing frame without harm.
const LOST_SHARE: f64 = 0.1;
/// Frames in a row after whose loss the camera counts as silent. Chosen by hand: the arm holds after 200 ms, five frames at 25 Hz; twice of it.
const SILENT_FRAMES: f64 = 10.0;
/// How near to the border the target was when it left, as a share of the image's width and height. Chosen by hand.
const NEAR_BORDER: f64 = 0.1;
/// Frames over which the motion of the target in the image is looked ahead. Chosen by hand.
const AHEAD: f64 = 3.0;
/// Share of the measurements without the target at the end that makes a lost one. Chosen by hand: single losses are borne.
const LOST_AT_END: usize = 3;
/// Share of a failed run without frames that explains it, where they came again. Chosen by hand: what is left is time enough for most runs.
const SILENT_SHARE: f64 = 0.25;

pub(super) fn findings(evidence: &RunEvidence) -> Vec<RunFinding> {
    [frames_stopped(evidence), frames_lost(evidence), target(evidence)].into_iter().flatten().collect()
}

fn frames_stopped(evidence: &RunEvidence) -> Option<RunFinding> {
    let (duration_s, rate_hz) = (evidence.summary.duration_s, evidence.config.camera.rate_hz);
    // Measurements that come again with an exposure that was had are a camera's or vision's matter, not its silence.
    let table = &evidence.measurements;
    let came_s = (0..table.rows()).map(|row| match table.number("taken_s", row) {
        taken_s if taken_s.is_finite() => taken_s,
        _ => table.number("exposure_s", row),
    });
    let times_s: Vec<f64> = std::iter::once(0.0).chain(came_s).chain([duration_s]).collect();
    let silence = |(i, pair): (usize, &[f64])| (pair[0], pair[1] - pair[0], i + 2 == times_s.len());
    let counts = |&(_, silent_s, is_end): &(f64, f64, bool)| {
        silent_s * rate_hz > SILENT_FRAMES && (is_end || silent_s > SILENT_SHARE * duration_s)
    };
    let silences = times_s.windows(2).enumerate().map(silence).filter(counts);
    let longest = silences.max_by(|a, b| a.1.total_cmp(&b.1));
    let (last_s, silent_s, is_end) = longest.filter(|_| evidence.has_failed())?;
    Some(RunFinding {
        cause: Cause::FramesStopped,
        what: format!(
            "frames, or their measurements, came no more{}",
            if is_end { "" } else { " for a while" }
        ),
        evidence: format!(
            "the last one came at {last_s:.3} s, {silent_s:.2} s before the {}; {}",
            if is_end { "end" } else { "next" },
            evidence.summary.reason
        ),
        change: "no key: see to the camera, its cable and power; `vservo camera --list`".into(),
    })
}

fn frames_lost(evidence: &RunEvidence) -> Option<RunFinding> {
    let ids = evidence.measurements.numbers("frame_id");
    let (first, last) = (ids.first()?, ids.last()?);
    let sent = last - first + 1.0;
    // Of a long run the table has every second measurement or fewer.
    let kept = evidence.summary.frames.max(ids.len() as u64) as f64;
    let lost = (sent - kept) / sent;
    let skipped = evidence.summary.frames_dropped as f64 / sent;
    (lost > LOST_SHARE).then(|| RunFinding {
        cause: Cause::FramesLost,
        what: format!("{:.0} % of the frames are missing", lost * 100.0),
        evidence: format!(
            "{kept:.0} of {sent:.0} frames were measured, {:.0} % were skipped by vision, the others lost on their way",
            skipped * 100.0
        ),
        change: if skipped > 0.5 * lost {
            "vision is too slow: camera.rate_hz or the image smaller (camera.roi), a core for it".into()
        } else {
            "see to the camera's bandwidth: camera.rate_hz lower, camera.roi, another port; meanwhile servo.gain_1_s lower".into()
        },
    })
}

/// A target that was never found, or is not there at the end.
fn target(evidence: &RunEvidence) -> Option<RunFinding> {
    let table = &evidence.measurements;
    let found = |row: &usize| table.word("status", *row) == "Found";
    let rows = table.rows();
    if rows == 0 || evidence.summary.outcome == Outcome::Converged {
        return None;
    }
    let mut statuses = BTreeMap::new();
    for row in (0..rows).filter(|row| !found(row)) {
        *statuses.entry(table.word("status", row)).or_insert(0_usize) += 1;
    }
    let told: Vec<_> = statuses.iter().map(|(status, count)| format!("{status} {count} times")).collect();
    let Some(last) = (0..rows).rev().find(found) else {
        // What fits no pose is the lens's matter.
        return (!statuses.contains_key("Inconsistent")).then(|| RunFinding {
            cause: Cause::NeverSeen,
            what: "the target was never found".into(),
            evidence: format!("{rows} frames: {}", told.join(", ")),
            change: "[target] must be what hangs there; see to light, focus, and where the arm starts (robot.q_start_rad_or_m); `vservo view` draws what should be seen".into(),
        });
    };
    if rows - 1 - last < LOST_AT_END {
        return None;
    }
    let at_s = table.number("exposure_s", last);
    let without = rows - 1 - last;
    Some(match way_out(evidence, last) {
        Some(where_to) => RunFinding {
            cause: Cause::LeftTheImage,
            what: format!("the target left the image {where_to}"),
            evidence: format!(
                "it was seen last at {at_s:.3} s, near the border and on its way out; {without} frames without it followed"
            ),
            change: "start nearer to the goal, or a smaller servo.gain_1_s; servo.visibility.guard and margin_px keep it in; a lens that sees more".into(),
        },
        None => RunFinding {
            cause: Cause::Hidden,
            what: "the target is there and cannot be seen: hidden, or its light is gone".into(),
            evidence: format!(
                "it was seen last at {at_s:.3} s, away from the image's border; {without} frames without it followed ({})",
                told.join(", ")
            ),
            change: "no key: clear the view, see to the light; a target that serves partly hidden ([target] kind = \"dot_grid\", \"chessboard\", \"tags\")".into(),
        },
    })
}

/// Over which border some point of the target was to go after a measurement.
fn way_out(evidence: &RunEvidence, last: usize) -> Option<&'static str> {
    let table = &evidence.measurements;
    let i = evidence.config.camera.model.intrinsics();
    let (width, height) = (f64::from(i.width_px), f64::from(i.height_px));
    let number = table.number("target_number", last).max(0.0) as usize;
    let target = evidence.config.targets().nth(number).map(|(_, target)| target.points());
    let ids = target.into_iter().flatten().map(|point| point.id + 1);
    for id in ids {
        for (axis, size, low, high) in
            [("u", width, "on its left", "on its right"), ("v", height, "at its top", "at its bottom")]
        {
            let at = |row: usize| table.number(&format!("{axis}_{id}_px"), row);
            let now = at(last);
            let step = last.checked_sub(1).map_or(0.0, |before| now - at(before));
            let ahead = now + AHEAD * if step.is_finite() { step } else { 0.0 };
            if ahead < 0.0 || now < NEAR_BORDER * size && step < 0.0 {
                return Some(low);
            }
            if ahead > size || now > (1.0 - NEAR_BORDER) * size && step > 0.0 {
                return Some(high);
            }
        }
    }
    None
}
