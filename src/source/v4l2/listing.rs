//! What there is: every video node of this machine with all that it offers.

use super::controls;
use super::fault::V4l2Error;
use super::format::{OfferedFormat, known, offered};
use super::host::{ThisMachine, links_to};
use super::name::{self, open_error};
use super::node::{CameraHost, ControlKind, ControlOffer, FourCc, NodeInfo, NodeKind, SizeOffer, VideoNode};
use crate::imaging::grey::PixelFormat;
use serde::Serialize;
use std::path::PathBuf;

/// A control, and its value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfferedControl {
    /// The control.
    #[serde(flatten)]
    pub control: ControlOffer,
    /// Its value now; `None` where it cannot be read.
    pub value: Option<i64>,
}

/// A video node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ListedNode {
    /// Its path.
    pub path: PathBuf,
    /// Links to it that say what it is and where it is connected.
    pub links: Vec<PathBuf>,
    /// Serial number of its USB device.
    pub serial: Option<String>,
    /// What it says of itself; `None` where it could not be opened.
    pub info: Option<NodeInfo>,
    /// Why it could not be opened.
    pub error: Option<String>,
    /// Formats with sizes and rates, of a capture device.
    pub formats: Vec<OfferedFormat>,
    /// Controls, of a capture device.
    pub controls: Vec<OfferedControl>,
}

/// All video nodes of this machine, in the order of their numbers. Nothing is set on any of them.
#[must_use]
pub fn list() -> Vec<ListedNode> {
    list_of(&ThisMachine)
}

pub(super) fn list_of(host: &dyn CameraHost) -> Vec<ListedNode> {
    let nodes = host.nodes().into_iter().map(|file| {
        let mut listed = ListedNode {
            links: links_to(&file.path),
            serial: file.serial,
            path: file.path,
            info: None,
            error: None,
            formats: Vec::new(),
            controls: Vec::new(),
        };
        match host.open(&listed.path) {
            Ok(node) => {
                listed.info = Some(node.info().clone());
                if node.info().kind == NodeKind::Capture {
                    listed.formats = offered(node.as_ref());
                    let value = |control: ControlOffer| {
                        let is_readable =
                            !matches!(control.kind, ControlKind::Button | ControlKind::Compound);
                        let value =
                            is_readable.then(|| node.control(control.id, control.kind).ok()).flatten();
                        OfferedControl { control, value }
                    };
                    listed.controls = node.controls().into_iter().map(value).collect();
                }
            }
            Err(e) => {
                let error: V4l2Error = open_error(&listed.path, e);
                listed.error = Some(error.to_string());
            }
        }
        listed
    });
    nodes.collect()
}

/// Size and rate that suit most purposes, among those that a device offers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsualCapture {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Frames per second.
    pub rate_hz: f64,
}

/// What a device is tried with where nobody says: VGA at 30 Hz, or what is nearest to that.
///
/// # Errors
/// [`V4l2Error`] when the device cannot be opened.
pub fn usual(
    device: &str,
    format: Option<PixelFormat>,
    size: Option<(u32, u32)>,
) -> Result<UsualCapture, V4l2Error> {
    let found = name::resolve(&ThisMachine, device)?;
    Ok(usual_of(found.node.as_ref(), format, size))
}

fn usual_of(node: &dyn VideoNode, format: Option<PixelFormat>, size: Option<(u32, u32)>) -> UsualCapture {
    // Chosen by hand: the size and rate of the shipped run files, which nearly all cameras have.
    const VGA: (u32, u32) = (640, 480);
    const USUAL_HZ: f64 = 30.0;
    let is_wanted =
        |fourcc: FourCc| known(fourcc).is_some_and(|found| format.is_none_or(|wanted| wanted == found));
    let formats: Vec<FourCc> = node.formats().iter().map(|f| f.fourcc).filter(|f| is_wanted(*f)).collect();
    let pixels = |(width, height): (u32, u32)| i64::from(width) * i64::from(height);
    let nearest = || {
        let sizes = formats.iter().flat_map(|fourcc| node.sizes(*fourcc));
        let sizes = sizes.map(|offer| match offer {
            SizeOffer::Discrete { width, height } => (width, height),
            range if range.has(VGA.0, VGA.1) => VGA,
            SizeOffer::Stepwise { largest: [width, height], .. } => (width, height),
        });
        // The best is the usual one, then the one with as many pixels.
        sizes.min_by_key(|size| (pixels(*size) - pixels(VGA)).abs())
    };
    let (width, height) = size.or_else(nearest).unwrap_or(VGA);
    let rates: Vec<_> = formats.iter().flat_map(|fourcc| node.rates(*fourcc, width, height)).collect();
    let fastest = rates.iter().map(|rate| rate.highest_hz()).fold(0.0, f64::max);
    let has_usual = rates.is_empty() || rates.iter().any(|rate| rate.has(USUAL_HZ));
    // the highest rate that a run file may ask for, else the suggestion would be refused
    let rate_hz = if has_usual || fastest <= 0.0 { USUAL_HZ } else { fastest.min(1000.0) };
    UsualCapture { width, height, rate_hz }
}

impl OfferedControl {
    /// `gain: 10 (0 to 255 in steps of 1, at first 0)`
    #[must_use]
    pub fn line(&self) -> String {
        let c = &self.control;
        let value = match (c.kind, self.value) {
            (ControlKind::Button, _) => "a button: true presses it".into(),
            (ControlKind::Compound, _) => "not a single number".into(),
            (ControlKind::Boolean, Some(n)) => (n != 0).to_string(),
            (ControlKind::Bitmask, Some(n)) => format!("{n:#x}"),
            (_, Some(n)) => n.to_string(),
            (_, None) => "cannot be read".into(),
        };
        let range = match c.kind {
            ControlKind::Integer | ControlKind::Integer64 => {
                format!(" ({} to {} in steps of {}, at first {})", c.minimum, c.maximum, c.step, c.default)
            }
            ControlKind::Bitmask => {
                format!(" (bits of {:#x}, at first {:#x})", c.maximum & 0xffff_ffff, c.default & 0xffff_ffff)
            }
            ControlKind::Boolean => format!(" (at first {})", c.default != 0),
            ControlKind::Menu | ControlKind::IntegerMenu => {
                let entries: Vec<_> = c.menu.iter().map(|(n, name)| format!("{n} \"{name}\"")).collect();
                format!(" (one of {}; at first {})", entries.join(", "), c.default)
            }
            ControlKind::Button | ControlKind::Compound => String::new(),
        };
        let marks = match (c.read_only, c.inactive) {
            (true, _) => ", read only",
            (false, true) => ", without effect now",
            _ => "",
        };
        format!("{}: {value}{range}{marks}", controls::key_of(&c.name))
    }
}
