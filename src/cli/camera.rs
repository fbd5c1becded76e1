//! `vservo camera --list`, `--probe`, `--snapshot`: looking at cameras without a run.

use super::camera_arguments::{CameraArguments, CameraQuestion};
use super::{RoleArguments, json, lost, shown};
use crate::config::{Config, PixelFormatName, Source, V4l2Settings};
use crate::input::printable;
use crate::process::{ProcessError, StopFlag};
use crate::rt::{now, write_file};
use crate::source::v4l2::{self, CaptureRequest, Probe, V4l2Camera};
use crate::source::{SourceError, encode_png};
use crate::time::SpanNs;
use image::ExtendedColorType;
use std::fmt::Write as _;
use std::path::Path;

mod check;
mod suggestion;

/// Time before a measurement, in which automatic exposure settles and old frames of a stream pass. Chosen by hand: some ten frames; twice only
/// makes one wait.
const WARM_UP: SpanNs = SpanNs(500_000_000);
/// Longest wait for the first frame. Chosen by hand: USB cameras take up to a second or two to start.
const FIRST_FRAME: SpanNs = SpanNs(5_000_000_000);
/// Longest measurement, s. Chosen by hand: ten minutes are enough for rates and latencies to drift, and a slip of the unit is refused.
const LONGEST_PROBE_S: f64 = 600.0;

/// Does what was asked for, if anything was beside the process.
pub(super) fn look(arguments: &CameraArguments) -> Option<Result<u8, ProcessError>> {
    if let Some(CameraQuestion::Check(arguments)) = &arguments.question {
        return Some(check::check(arguments));
    }
    if arguments.list {
        return Some(Ok(list(arguments.json)));
    }
    if let Some(device) = &arguments.probe {
        return Some(probe(arguments, device));
    }
    arguments.snapshot.as_ref().map(|out| snapshot(arguments, out))
}

fn list(as_json: bool) -> u8 {
    let nodes = v4l2::list();
    if as_json {
        return shown(&json(&nodes), 0);
    }
    if nodes.is_empty() {
        return shown("no video device: is a camera plugged in, and its driver loaded?\n", 0);
    }
    shown(&nodes.iter().map(described).collect::<String>(), 0)
}

fn described(node: &v4l2::ListedNode) -> String {
    let mut text = node.path.display().to_string();
    match (&node.info, &node.error) {
        (Some(info), _) => {
            let _ = write!(
                text,
                ": {} ({}, {}), {}",
                info.card,
                info.driver,
                info.bus_info,
                info.kind.describe()
            );
            if info.planar {
                text += ", in planes";
            }
        }
        (None, Some(error)) => text = error.clone(),
        (None, None) => {}
    }
    let mut lines = vec![text];
    lines.extend(node.links.iter().map(|link| format!("  {}", link.display())));
    for offer in &node.formats {
        let unusable = if offer.usable { "" } else { ", not used here" };
        lines.push(format!("  {} ({}{unusable})", offer.format.fourcc, offer.format.description));
        for size in &offer.sizes {
            let rates = v4l2::rates_line(&size.rates);
            let rates = if rates.is_empty() { String::new() } else { format!(" at {rates} Hz") };
            lines.push(format!("    {}{rates}", size.size));
        }
    }
    if !node.controls.is_empty() {
        lines.push("  [camera.v4l2.controls]".into());
        lines.extend(node.controls.iter().map(|control| format!("    {}", control.line())));
    }
    lines.iter().map(|line| printable(line) + "\n").collect()
}

/// What is wanted of a device that is named on the command line.
fn request(arguments: &CameraArguments, device: &str) -> Result<CaptureRequest, ProcessError> {
    let format = arguments.format.map(|format| PixelFormatName::from(format).into());
    let settings = V4l2Settings::of_device(device, format);
    let usual = match (arguments.size, arguments.rate) {
        (Some(_), Some(_)) => None,
        _ => {
            let size = arguments.size.map(|size| (size.width, size.height));
            Some(v4l2::usual(device, settings.format, size).map_err(SourceError::from)?)
        }
    };
    let (width, height) = match (arguments.size, usual) {
        (Some(size), _) => (size.width, size.height),
        (None, usual) => usual.map_or((640, 480), |usual| (usual.width, usual.height)),
    };
    let rate_hz = arguments.rate.or(usual.map(|usual| usual.rate_hz)).unwrap_or(30.0);
    let exposure = SpanNs::from_s(0.004);
    Ok(CaptureRequest { settings, width, height, region: None, rate_hz, exposure })
}

/// Opens a camera and lets it settle.
fn warmed_up(request: CaptureRequest, stop: &StopFlag) -> Result<V4l2Camera, ProcessError> {
    let (pixels, device, rate_hz) =
        (request.width as usize * request.height as usize, request.settings.device.clone(), request.rate_hz);
    let mut camera = v4l2::open(request).map_err(SourceError::from)?;
    let mut settling = Probe::new(rate_hz, pixels, now());
    let begin = now();
    while !stop.is_requested() {
        let _ = settling.take(&mut camera, &mut now)?;
        let past = now() - begin;
        if settling.frames() > 0 && past >= WARM_UP {
            break;
        }
        if settling.frames() == 0 && past > FIRST_FRAME {
            return Err(ProcessError::NoFrame { device, waited_s: past.as_s() });
        }
    }
    Ok(camera)
}

fn require_duration(duration_s: f64) -> Result<f64, ProcessError> {
    let is_meant = duration_s > 0.0 && duration_s <= LONGEST_PROBE_S;
    if is_meant { Ok(duration_s) } else { Err(ProcessError::ProbeDuration(duration_s)) }
}

fn probe(arguments: &CameraArguments, device: &str) -> Result<u8, ProcessError> {
    let duration_s = require_duration(arguments.duration_s)?;
    let stop = StopFlag::on_signals()?;
    let request = request(arguments, device)?;
    let (pixels, rate_hz) = (request.width as usize * request.height as usize, request.rate_hz);
    let mut camera = warmed_up(request, &stop)?;
    let mut probe = Probe::new(rate_hz, pixels, now());
    let (begin, duration) = (now(), SpanNs::from_s(duration_s));
    while now() - begin < duration && !stop.is_requested() {
        probe.take(&mut camera, &mut now)?;
    }
    let none = || ProcessError::NoFrame { device: device.into(), waited_s: duration_s };
    let report = probe.report(&camera, now()).ok_or_else(none)?;
    let toml = suggestion::table(device, &report);
    Ok(if arguments.json {
        shown(&json(&suggestion::Probed { report, suggestion: toml }), 0)
    } else {
        let lines: String = suggestion::lines(&report).iter().map(|line| printable(line) + "\n").collect();
        shown(&format!("{lines}\nput this into the run file:\n\n{toml}"), 0)
    })
}

fn snapshot(arguments: &CameraArguments, out: &Path) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    super::check_writable(out)?;
    let request = match &arguments.device {
        Some(device) => request(arguments, device)?,
        None => {
            let config = Config::load(arguments.config.as_deref(), &arguments.set)?;
            let config = super::seen_by(arguments.camera, config)?;
            match &config.camera.source {
                Source::V4l2(settings) => CaptureRequest::of(&config.camera, settings),
                Source::Synthetic { .. } | Source::Replay { .. } | Source::External(_) => {
                    let instead = "\"v4l2\", or name one with --device";
                    return Err(ProcessError::NoRealCamera { instead });
                }
            }
        }
    };
    let device = request.settings.device.clone();
    let (width, height) =
        request.region.map_or((request.width, request.height), |region| (region.width, region.height));
    let (pixels, rate_hz) = (width as usize * height as usize, request.rate_hz);
    let mut camera = warmed_up(request, &stop)?;
    let mut probe = Probe::new(rate_hz, pixels, now());
    let begin = now();
    let png = loop {
        if stop.is_requested() || now() - begin > FIRST_FRAME {
            return Err(ProcessError::NoFrame { device, waited_s: (now() - begin).as_s() });
        }
        if let Some(grey) = probe.take(&mut camera, &mut now)? {
            break encode_png(grey, width, height, ExtendedColorType::L8);
        }
    };
    let written = png.map_err(std::io::Error::other).and_then(|png| write_file(out, png));
    match written {
        Ok(()) => Ok(shown(&format!("{}: {width}x{height} px\n", printable(&out.display().to_string())), 0)),
        Err(cause) => Ok(lost(out, cause, 0)),
    }
}

impl From<CameraArguments> for RoleArguments {
    fn from(a: CameraArguments) -> Self {
        let CameraArguments { config, instance, set, camera, supervised_by, config_on_stdin, .. } = a;
        Self {
            config,
            instance,
            set,
            camera,
            summary: None,
            json: false,
            supervised_by,
            config_on_stdin,
            report: None,
        }
    }
}
