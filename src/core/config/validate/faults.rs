//! `[[faults]]`.
//!
//! Ranges, and sizes where none is told, were chosen by hand: no cell has worse, or what is worse is a fault of another kind.

use crate::config::check::Validation;
use crate::config::raw::{DriveKind, FaultKind, RawConfig, RawFault};
use crate::config::{Camera, Clock};
use crate::faults::{
    FaultWindow, FaultyProcess, FrameFault, FrameFaults, InjectedFaults, JointFault, MAX_FAULTS,
    MeasurementFault, ProcessFault,
};
use crate::time::SpanNs;

/// The faults that a run file names. `joints`: of its arm, where it is known.
pub(super) fn faults(raw: &RawConfig, joints: Option<usize>, check: &mut Validation<'_>) -> InjectedFaults {
    let mut all = InjectedFaults::default();
    if raw.faults.len() > MAX_FAULTS {
        let message =
            format!("has {} entries, at most {MAX_FAULTS} are possible in one run", raw.faults.len());
        check.wrong("faults", message);
        return all;
    }
    for (i, one) in raw.faults.iter().enumerate() {
        let at = format!("faults[{i}]");
        fault(&at, one, raw, joints, check, &mut all);
    }
    all
}

/// Gives the frames of each camera their faults, each camera by a seed of its own.
pub(super) fn give<'a>(faults: &InjectedFaults, seed: u64, cameras: impl Iterator<Item = &'a mut Camera>) {
    for camera in cameras.filter(|camera| !faults.frames.is_empty() && camera.source.kind().is_simulated()) {
        let own = FrameFaults::new(&faults.frames, seed ^ u64::from(camera.id.0).rotate_right(8));
        camera.schedule = camera.schedule.with_faults(own);
    }
}

fn fault(
    at: &str,
    f: &RawFault,
    raw: &RawConfig,
    joints: Option<usize>,
    check: &mut Validation<'_>,
    all: &mut InjectedFaults,
) {
    let key = |name: &str| format!("{at}.{name}");
    let before = check.count_problems();
    let from = SpanNs::from_s(check.range(&key("from_s"), f.from_s, 0.0..=1e5));
    let duration = SpanNs::from_s(check.range(&key("duration_s"), f.duration_s, 1e-3..=1e5));
    let probability = check.range(&key("probability"), f.probability, 0.0..=1.0);
    // Whatever the kind: a number that stands there is looked at.
    let earliest = if f.kind == Some(FaultKind::ClockJump) { -500.0 } else { 0.0 };
    let delay_ms = f.delay_ms.map(|ms| check.range(&key("delay_ms"), ms, earliest..=500.0));
    let size_px = f.size_px.map(|px| check.range(&key("size_px"), px, 0.0..=1000.0));
    let size = f.size_rad_or_m.map(|size| check.range(&key("size_rad_or_m"), size, -1.0..=1.0));
    let share = f.share.map(|share| check.range(&key("share"), share, 0.0..=1.0));
    let last = joints.map_or(u32::MAX, |joints| joints.saturating_sub(1) as u32);
    let joint = check.count(&key("joint"), f.joint.unwrap_or(0), 0..=last) as usize;
    let Some(kind) = f.kind else {
        check.wrong(&key("kind"), "is missing: say what is wrong, for example kind = \"drop\"");
        return;
    };
    let window = FaultWindow { from, until: SpanNs(from.0.saturating_add(duration.0)), probability, seed: 0 };
    let sized = |size: Option<f64>, usual: f64| size.unwrap_or(usual);
    let (takes, of_drive): (&[&str], bool) = match kind {
        FaultKind::Delay | FaultKind::ClockJump => (&["delay_ms"], false),
        FaultKind::Corrupt => (&["share"], false),
        FaultKind::Jump | FaultKind::FalseTarget | FaultKind::PointNoise => (&["size_px"], false),
        FaultKind::EncoderSpike | FaultKind::EncoderOffset => (&["size_rad_or_m", "joint"], true),
        FaultKind::EncoderFreeze => (&["joint"], true),
        FaultKind::TorqueLoss => (&["share", "joint"], true),
        FaultKind::StaleState | FaultKind::LostCommand => (&[], true),
        FaultKind::ProcessDies | FaultKind::ProcessHangs => (&["process"], false),
        FaultKind::ProcessSlows => (&["process", "delay_ms"], false),
        _ => (&[], false),
    };
    for (name, is_given) in [
        ("delay_ms", f.delay_ms.is_some()),
        ("size_px", f.size_px.is_some()),
        ("size_rad_or_m", f.size_rad_or_m.is_some()),
        ("share", f.share.is_some()),
        ("joint", f.joint.is_some()),
        ("process", f.process.is_some()),
    ] {
        if is_given && !takes.contains(&name) {
            check.wrong(&key(name), "says nothing about a fault of this kind: leave it out");
        }
    }
    if of_drive && raw.drive.kind != DriveKind::Simulated {
        check.wrong(&key("kind"), "is a fault of the simulated arm: it needs drive.kind = \"simulated\"");
    }
    if !of_drive && !raw.camera.source.is_simulated() {
        check.wrong(&key("kind"), "is a fault of a simulated camera: it needs camera.source = \"synthetic\"");
    }
    let of_process =
        matches!(kind, FaultKind::ProcessDies | FaultKind::ProcessHangs | FaultKind::ProcessSlows);
    if of_process && raw.run.clock != Clock::Realtime {
        check.wrong(
            &key("kind"),
            "is a fault of a process, which lockstep waits for: it needs run.clock = \"realtime\"",
        );
    }
    // What is refused is not computed with.
    if check.count_problems() > before {
        return;
    }
    let frame = match kind {
        FaultKind::Drop => FrameFault::Drop,
        FaultKind::Delay => FrameFault::Delay(SpanNs::from_s(1e-3 * sized(delay_ms, 100.0))),
        FaultKind::Duplicate => FrameFault::Duplicate,
        FaultKind::Freeze => FrameFault::Freeze,
        FaultKind::Black => FrameFault::Black,
        FaultKind::Saturated => FrameFault::Saturated,
        FaultKind::Torn => FrameFault::Torn,
        FaultKind::Mirror => FrameFault::Mirror,
        FaultKind::ClockJump => FrameFault::ClockJump(SpanNs::from_s(1e-3 * sized(delay_ms, 200.0))),
        FaultKind::FalseTarget => FrameFault::FalseTarget(sized(size_px, 60.0).round() as usize),
        FaultKind::Corrupt => FrameFault::Corrupt(sized(share, 0.2)),
        FaultKind::Stale => return all.measurements.push((MeasurementFault::Stale, window)),
        FaultKind::Overtaken => return all.measurements.push((MeasurementFault::Overtaken, window)),
        FaultKind::Jump => {
            return all.measurements.push((MeasurementFault::Jump(sized(size_px, 20.0)), window));
        }
        FaultKind::PointNoise => {
            return all.measurements.push((MeasurementFault::PointNoise(sized(size_px, 1.0)), window));
        }
        FaultKind::Mislabelled => return all.measurements.push((MeasurementFault::Mislabelled, window)),
        FaultKind::EncoderSpike => {
            return all.joints.push((JointFault::Spike(sized(size, 0.02)), joint, window));
        }
        FaultKind::EncoderFreeze => return all.joints.push((JointFault::Freeze, joint, window)),
        FaultKind::EncoderOffset => {
            return all.joints.push((JointFault::Offset(sized(size, 0.02)), joint, window));
        }
        FaultKind::TorqueLoss => {
            return all.joints.push((JointFault::TorqueLoss(sized(share, 0.5)), joint, window));
        }
        FaultKind::StaleState => return all.joints.push((JointFault::StaleState, joint, window)),
        FaultKind::LostCommand => return all.joints.push((JointFault::LostCommand, joint, window)),
        FaultKind::ProcessDies | FaultKind::ProcessHangs | FaultKind::ProcessSlows => {
            let fault = match kind {
                FaultKind::ProcessDies => ProcessFault::Dies,
                FaultKind::ProcessHangs => ProcessFault::Hangs,
                _ => ProcessFault::Slows(SpanNs::from_s(1e-3 * sized(delay_ms, 100.0))),
            };
            let process = f.process.unwrap_or(FaultyProcess::Vision);
            return all.processes.push((process, fault, window));
        }
    };
    all.frames.push((frame, window));
}
