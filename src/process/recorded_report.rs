//! A report, and the evidence for an explanation, from a recording or from the folder of an earlier report.

use super::control::{RecordedResults, recorded_results};
use super::report_folder::{CONFIG, MEASUREMENTS, PAGE, SUMMARY, TRACE};
use super::report_images::ReportImages;
use super::{NewReport, ProcessError, ReportFolder, run_report};
use crate::config::Config;
use crate::explain::{Explanation, RunEvidence, explain};
use crate::messages::{FrameHeader, Measurement};
use crate::record::RecordingReader;
use crate::replay::{RecordedRun, ReplayError};
use crate::report::compare_page::{PairedRun, compare_page};
use crate::report::csv_table::CsvTable;
use crate::report::run_page::run_facts;
use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Frames that wait for their measurements. Derived: as many as `replay` keeps.
const WAITING: usize = 128;

/// What a recorded run left, for an explanation.
///
/// # Errors
/// When it cannot be replayed.
pub fn evidence_of_recording<R: Read>(
    reader: RecordingReader<R>,
    config: Config,
) -> Result<RunEvidence, ReplayError> {
    let RecordedResults { summary, files, .. } =
        recorded_results(&mut RecordedRun::of_any(reader)?, &config)?;
    let table = |wanted: &str| {
        let found = files.iter().find(|(name, _)| *name == wanted);
        found.map(|(_, text)| CsvTable::parse(text)).unwrap_or_default()
    };
    Ok(RunEvidence { trace: table(TRACE), measurements: table(MEASUREMENTS), summary, config })
}

/// The same from the folder of a report.
///
/// # Errors
/// When there is none.
pub fn evidence_of_report(path: &Path) -> Result<RunEvidence, ProcessError> {
    let folder = ReportFolder::of_run(path);
    let text = |name: &str| folder.read(name).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    let summary = text(SUMMARY).and_then(|text| serde_json::from_str(&text).ok());
    let (Some(summary), Some(config)) = (summary, text(CONFIG)) else {
        return Err(ProcessError::NoCommand(format!(
            "{}: no recording, and no folder of a report of this version ({SUMMARY}, {CONFIG})",
            path.display()
        )));
    };
    let table = |name: &str| CsvTable::parse(&text(name).unwrap_or_default());
    let config = Config::parse(CONFIG, &config, path, &[])?;
    Ok(RunEvidence { trace: table(TRACE), measurements: table(MEASUREMENTS), summary, config })
}

/// Makes the report of a recorded run, which `readers` read, one for the results and one for the images; where the page is. `commands` repeat it.
///
/// # Errors
/// When it cannot be replayed, or a file cannot be written.
pub fn write_recorded<R: Read>(
    report: NewReport,
    config: &Config,
    readers: [RecordingReader<R>; 2],
    path: &Path,
    commands: &[String],
) -> Result<PathBuf, ProcessError> {
    let wrong = |cause: ReplayError| ProcessError::Replay { path: path.into(), cause: Box::new(cause) };
    let [of_results, mut of_images] = readers;
    let results = RecordedRun::of_any(of_results).and_then(|mut run| recorded_results(&mut run, config));
    let RecordedResults { summary, files, .. } = results.map_err(wrong)?;
    for (name, text) in files {
        report.folder().write(name, text)?;
    }
    images(&mut of_images, report.folder(), config).map_err(wrong)?;
    run_report::write(report, config, &summary, commands)
}

/// Makes one page of two recorded runs; where it is. Each has its name.
///
/// # Errors
/// When a file cannot be written.
pub fn write_compared(report: NewReport, runs: [(String, RunEvidence); 2]) -> Result<PathBuf, ProcessError> {
    let compared = |(name, evidence): (String, RunEvidence)| -> Result<PairedRun, ProcessError> {
        let Explanation { verdict, findings, .. } = explain(&evidence);
        let RunEvidence { summary, config, trace, measurements } = evidence;
        // what was just written as TOML is TOML
        let table = config.to_toml()?.parse::<toml::Table>().unwrap_or_default();
        let mut settings = Vec::new();
        flatten("", &table, &mut settings);
        Ok(PairedRun {
            name,
            verdict,
            findings: findings.into_iter().map(|finding| finding.what).collect(),
            facts: run_facts(&summary),
            settings,
            joints: config.robot.joints.iter().map(|joint| joint.name.clone()).collect(),
            trace,
            measurements,
        })
    };
    let [a, b] = runs.map(compared);
    report.folder().write(PAGE, compare_page(&[a?, b?]))?;
    report.publish()
}

/// The keys of a table by their paths.
fn flatten(path: &str, table: &toml::Table, into: &mut Vec<(String, String)>) {
    for (key, value) in table {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match value {
            toml::Value::Table(inner) => flatten(&path, inner, into),
            value => into.push((path, value.to_string())),
        }
    }
}

/// The frames that a report shows.
fn images<R: Read>(
    reader: &mut RecordingReader<R>,
    folder: &ReportFolder,
    config: &Config,
) -> Result<(), ReplayError> {
    let mut images = ReportImages::new(Some(folder), &config.camera);
    let mut frames: VecDeque<(FrameHeader, Vec<u8>)> = VecDeque::new();
    let mut measurements: VecDeque<Measurement> = VecDeque::new();
    let mut header: Option<FrameHeader> = None;
    let id = config.camera.id;
    let topics = ["frame_header", "frame"].map(|name| format!("/camera/{id}/{name}"));
    let of_vision = format!("/vision/{id}/measurement");
    while let Some(message) = reader.next_message()? {
        let topic = message.topic();
        if topic == topics[0] {
            header = Some(message.record()?);
        } else if topic == topics[1] {
            frames.extend(header.take().zip(message.image().ok().map(|image| image.pixels.to_vec())));
        } else if topic == of_vision {
            measurements.push_back(message.record()?);
        }
        let of = |m: &Measurement, h: &FrameHeader| (m.frame_id, m.exposure) == (h.frame_id, h.exposure);
        while let Some(m) = measurements.front().copied() {
            let Some(at) = frames.iter().position(|(header, _)| of(&m, header)) else { break };
            frames.drain(..at);
            if let Some((header, pixels)) = frames.pop_front() {
                images.note_pixels(&header, &pixels);
                images.note_measurement(&m);
            }
            measurements.pop_front();
        }
        // What has no other half is passed over.
        if frames.len() > WAITING {
            frames.pop_front();
        }
        if measurements.len() > WAITING {
            measurements.pop_front();
        }
    }
    images.write();
    Ok(())
}
