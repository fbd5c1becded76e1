//! The report of a run: gathers what control and vision left in its folder, and makes the page.

use super::report_folder::{CONFIG, EVENTS, FRAMES, GOAL, MEASUREMENTS, PAGE, POSES, SUMMARY, TICKS, TRACE};
use super::run_place::when_and_where;
use super::{NewReport, ProcessError, ReportFolder};
use crate::config::{Clock, Config, FurtherTarget};
use crate::control::outcome::Outcome;
use crate::explain::{Explanation, RunEvidence, explain};
use crate::report::csv_table::{CsvTable, csv_cell};
use crate::report::page::base64;
use crate::report::run_page::{ImageData, JointSummary, RunRecord, run_facts, run_page, run_verdict};
use crate::report::summary::Summary;
use crate::source::load_image;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, GrayImage, ImageEncoder};
use rustix::fs::statvfs;
use std::fmt::Write;
use std::io::Error;
use std::path::{Path, PathBuf};

/// Largest width of the images in the page; the files beside it have full size. Chosen by hand: the width of a page on a screen.
const WIDEST_PX: u32 = 1280;
/// JPEG quality of the images in the page. Chosen by hand: with less edges show blocks, with more the page only becomes larger.
const JPEG_QUALITY: u8 = 88;
/// Of the program.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Writes the page and what belongs to it; where the page is. `commands` repeat the run.
///
/// # Errors
/// When a file cannot be written, or one that control or vision should have left is not there: after the page was made of the rest.
pub fn write(
    report: NewReport,
    config: &Config,
    summary: &Summary,
    commands: &[String],
) -> Result<PathBuf, ProcessError> {
    let folder = report.folder();
    let written = config.to_toml()?;
    folder.write(CONFIG, &written)?;
    let json = serde_json::to_string_pretty(summary).unwrap_or_default() + "\n";
    folder.write(SUMMARY, json)?;
    folder.write(EVENTS, events_csv(summary))?;
    folder.write(TICKS, tick_times_csv(summary))?;
    let mut missing = Vec::new();
    let mut table = |name: &str| {
        let bytes = folder.read(name);
        if bytes.is_none() {
            missing.push(name.to_owned());
        }
        CsvTable::parse(&String::from_utf8_lossy(&bytes.unwrap_or_default()))
    };
    let evidence = RunEvidence {
        summary: summary.clone(),
        config: config.clone(),
        trace: table(TRACE),
        measurements: table(MEASUREMENTS),
    };
    let Explanation { findings, speed, .. } = explain(&evidence);
    let record = RunRecord {
        trace: evidence.trace,
        measurements: evidence.measurements,
        findings: findings.into_iter().map(|f| [f.what, f.evidence, f.change]).collect(),
        speed,
        config: written,
        goal: table(GOAL),
        poses: table(POSES),
        frames: table(FRAMES),
        ..described(config, summary, commands)
    };
    let images = images(folder, &record.frames);
    let facts = record.facts.iter().cloned().chain(when_and_where()).collect();
    folder.write(PAGE, run_page(&RunRecord { images, facts, ..record }))?;
    // A run that was over before it began has nothing to show.
    let Some(name) = missing.first().filter(|_| summary.ticks > 0) else { return report.publish() };
    let absent =
        |folder: &Path| Err(ProcessError::Write { path: folder.join(name), cause: not_left(folder) });
    // What is there of it is better than nothing, and worse than an earlier report that is whole.
    if report.replaces() {
        absent(report.target())
    } else {
        absent(report.publish()?.with_file_name("").as_path())
    }
}

/// Why a file is not there that another process should have left in `folder`: as a rule there was no room for it.
fn not_left(folder: &Path) -> Error {
    let there = if folder.exists() { folder } else { Path::new(".") };
    let left = statvfs(there).map(|s| s.f_bavail.saturating_mul(s.f_frsize) / 1024);
    let left = left.map_or(String::new(), |kib| format!(" ({kib} KiB are left now: df {})", there.display()));
    let said = "it is not whole, as a message above says: the disk was full, where that has no other reason";
    Error::other(format!("{said}{left}"))
}

/// All of it that is known without the files.
fn described(config: &Config, summary: &Summary, commands: &[String]) -> RunRecord {
    let i = config.camera.model.intrinsics();
    let plate = config.target.plate();
    let events = summary.safety.events.iter().map(|e| (e.time_s, e.event.clone()));
    let files = [
        (TRACE, "every tick: joints, commands, limits that acted, camera"),
        (MEASUREMENTS, "every measurement: points, error, latencies, pose"),
        (GOAL, "where the points are to be"),
        (POSES, "frames of the cell at start and end"),
        (FRAMES, "what is in the images"),
        (EVENTS, "what happened"),
        (TICKS, "histogram of deadline to command"),
        (SUMMARY, "the summary"),
        (CONFIG, "the run file with all defaults"),
    ];
    RunRecord {
        title: format!("{} on {}", config.scheme_name(), config.robot.name),
        verdict: run_verdict(summary),
        is_good: matches!(summary.outcome, Outcome::Converged | Outcome::Finished | Outcome::Stopped),
        facts: run_facts(summary),
        version: VERSION.into(),
        seed: summary.seed,
        commands: commands.to_vec(),
        simulated_time: config.clock == Clock::Lockstep,
        has_arm: config.has_an_arm(),
        eye_in_hand: config.camera.mount.is_on_arm(),
        gravity_B: config.robot.gravity_B.into(),
        joints: config.robot.joints.iter().map(JointSummary::of).collect(),
        image_px: [f64::from(i.width_px), f64::from(i.height_px)],
        goal_error_px: config.goal.feature_error_px,
        plate_m: [plate.low_m.into(), plate.high_m.into()],
        further_targets: config.further_targets.iter().map(plate_of).collect(),
        events: events.collect(),
        events_left_out: summary.safety.events_left_out,
        tick_times: summary.tick_us.total_histogram.clone(),
        missed_deadlines: summary.missed_deadlines,
        files: files.map(|(name, what)| (name.to_owned(), what.to_owned())).into(),
        ..RunRecord::default()
    }
}

/// The name of a further target, and the corners of its plate, m.
fn plate_of(further: &FurtherTarget) -> (String, [[f64; 2]; 2]) {
    let plate = further.target.plate();
    (further.name.clone(), [plate.low_m.into(), plate.high_m.into()])
}

fn events_csv(summary: &Summary) -> String {
    let mut out = String::from("time_s,event\n");
    let gap = summary.safety.gap();
    for (i, e) in summary.safety.events.iter().enumerate() {
        if let Some((_, text)) = gap.as_ref().filter(|(at, _)| *at == i) {
            let _ = writeln!(out, ",{}", csv_cell(text)); // a String takes everything
        }
        let _ = writeln!(out, "{:.3},{}", e.time_s, csv_cell(&e.event));
    }
    out
}

fn tick_times_csv(summary: &Summary) -> String {
    let mut out = String::from("below_us,ticks\n");
    for (edge_us, count) in &summary.tick_us.total_histogram {
        let _ = writeln!(out, "{edge_us:.3},{count}");
    }
    out
}

/// The images as they go into the page; those that cannot be read are left out.
fn images(folder: &ReportFolder, frames: &CsvTable) -> Vec<ImageData> {
    let mut all: Vec<ImageData> = Vec::new();
    for row in 0..frames.rows() {
        let file = frames.word("file", row);
        if file.contains('/') || all.iter().any(|p| p.file == file) {
            continue;
        }
        if let Some(data) = load_image(&folder.path().join(file)).ok().and_then(|image| embedded(&image)) {
            all.push(ImageData { file: file.into(), data });
        }
    }
    all
}

fn embedded(image: &GrayImage) -> Option<String> {
    let small = reduced(image);
    let mut jpeg = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY);
    encoder.write_image(small.as_raw(), small.width(), small.height(), ExtendedColorType::L8).ok()?;
    Some(format!("data:image/jpeg;base64,{}", base64(&jpeg)))
}

/// At most so wide: means of squares of pixels.
fn reduced(image: &GrayImage) -> GrayImage {
    let by = image.width().div_ceil(WIDEST_PX).max(1);
    if by == 1 {
        return image.clone();
    }
    let (width, height) = ((image.width() / by).max(1), (image.height() / by).max(1));
    GrayImage::from_fn(width, height, |x, y| {
        let cells = (0..by).flat_map(|j| (0..by).map(move |i| (x * by + i, y * by + j)));
        let levels = cells.filter_map(|(x, y)| image.get_pixel_checked(x, y)).map(|p| u32::from(p.0[0]));
        let (sum, count) = levels.fold((0, 0), |(sum, count), level| (sum + level, count + 1));
        image::Luma([u8::try_from(sum / count.max(1)).unwrap_or(u8::MAX)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_images_shrink_by_whole_steps() {
        let image = GrayImage::from_fn(2600, 9, |x, _| image::Luma([if x % 2 == 0 { 100 } else { 104 }]));
        let small = reduced(&image);
        assert_eq!(small.dimensions(), (866, 3));
        assert!(small.pixels().all(|p| (101..=103).contains(&p.0[0])));
        assert!(embedded(&image).unwrap().starts_with("data:image/jpeg;base64,/9j/"));
    }

    #[test]
    fn events_with_commas_stay_one_cell() {
        let config = Config::load(None, &[]).unwrap();
        let mut summary = Summary::without_control(&config, crate::time::SpanNs(0));
        let event = "a, \"b\"".to_owned();
        summary.safety.events.push(crate::report::summary::SafetyEvent { time_s: 0.5, event: event.clone() });
        assert_eq!(CsvTable::parse(&events_csv(&summary)).word("event", 0), event);
    }
}
