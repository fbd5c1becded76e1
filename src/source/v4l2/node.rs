//! A video node as everything here sees it: plain values and one trait. `device.rs` is the kernel's; tests put a scripted one in
//! its place, which unplugs itself, lies and fails as the script says.

use crate::source::stamp::StampClock;
use rustix::io::Errno;
use serde::{Serialize, Serializer};
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::time::{MonoNs, SpanNs};

/// A pixel format's four letters.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct FourCc(pub [u8; 4]);

impl FourCc {
    /// From the kernel's number.
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        Self(code.to_le_bytes())
    }

    /// The kernel's number.
    #[must_use]
    pub fn code(self) -> u32 {
        u32::from_le_bytes(self.0)
    }
}

impl fmt::Display for FourCc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text: String =
            self.0.iter().map(|b| if b.is_ascii_graphic() { char::from(*b) } else { ' ' }).collect();
        f.write_str(text.trim_end())
    }
}

impl fmt::Debug for FourCc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Serialize for FourCc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// What a node is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// It gives images, into mapped buffers.
    Capture,
    /// It gives images by `read` alone.
    CaptureWithoutStreaming,
    /// It gives what stands beside the images of another node.
    Metadata,
    /// It converts what it is given.
    Converter,
    /// It takes images, or tunes a radio, or anything else.
    Other,
}

impl NodeKind {
    /// What it is, behind "is".
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::Capture => "a capture device",
            Self::CaptureWithoutStreaming => "a capture device that cannot stream into mapped buffers",
            Self::Metadata => "the metadata node of a camera",
            Self::Converter => "a converter of images (codec or scaler)",
            Self::Other => "not a capture device",
        }
    }
}

/// What a node says of itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NodeInfo {
    /// Its driver.
    pub driver: String,
    /// The name of the camera.
    pub card: String,
    /// Where it is connected: `usb-0000:00:14.0-2`.
    pub bus_info: String,
    /// What it is for.
    pub kind: NodeKind,
    /// Whether its images come in planes.
    pub planar: bool,
}

/// Time from frame to frame, s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Interval {
    /// Numerator.
    pub numerator: u32,
    /// Denominator.
    pub denominator: u32,
}

impl Interval {
    /// The interval of so many frames a second; to a thousandth of a hertz.
    #[must_use]
    pub fn of_rate(rate_hz: f64) -> Self {
        let nearest = rate_hz.round();
        // A whole rate, up to rounding of the number in the run file.
        if (rate_hz - nearest).abs() < 1e-9 && nearest >= 1.0 {
            return Self { numerator: 1, denominator: nearest as u32 };
        }
        // 29.97 and its kin are meant as 30000/1001.
        let ntsc = (rate_hz * 1.001).round();
        // A rate of the NTSC standard, n / 1.001, written with two decimals: 29.97.
        if ntsc >= 1.0 && (ntsc / 1.001 - rate_hz).abs() < 0.006 {
            return Self { numerator: 1001, denominator: (ntsc * 1000.0) as u32 };
        }
        Self { numerator: 1000, denominator: (rate_hz * 1000.0).round().max(1.0) as u32 }
    }

    /// Frames per second; 0 where it says nothing.
    #[must_use]
    pub fn rate_hz(self) -> f64 {
        if self.numerator == 0 { 0.0 } else { f64::from(self.denominator) / f64::from(self.numerator) }
    }
}

/// Sizes of images that are offered, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SizeOffer {
    /// This one.
    Discrete {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// From one to another in steps.
    Stepwise {
        /// Smallest columns and rows.
        smallest: [u32; 2],
        /// Largest.
        largest: [u32; 2],
        /// Steps.
        step: [u32; 2],
    },
}

impl SizeOffer {
    /// Whether an image of so many columns and rows is among them.
    #[must_use]
    pub fn has(self, width: u32, height: u32) -> bool {
        match self {
            Self::Discrete { width: w, height: h } => (w, h) == (width, height),
            Self::Stepwise { smallest, largest, step } => {
                [width, height].iter().enumerate().all(|(i, side)| {
                    let (Some(low), Some(high), Some(step)) = (smallest.get(i), largest.get(i), step.get(i))
                    else {
                        return false;
                    };
                    (low..=high).contains(&side) && (side - low).is_multiple_of((*step).max(1))
                })
            }
        }
    }
}

impl fmt::Display for SizeOffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Discrete { width, height } => write!(f, "{width}x{height}"),
            Self::Stepwise { smallest: [w, h], largest: [W, H], step: [dw, dh] } => {
                write!(f, "{w}x{h} to {W}x{H} in steps of {dw}x{dh}")
            }
        }
    }
}

/// Rates that are offered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RateOffer {
    /// This one.
    Discrete(Interval),
    /// Any, or in steps, between two intervals.
    Between {
        /// Of the highest rate.
        shortest: Interval,
        /// Of the lowest.
        longest: Interval,
    },
}

impl RateOffer {
    /// Its highest rate, Hz.
    #[must_use]
    pub fn highest_hz(self) -> f64 {
        match self {
            Self::Discrete(interval) | Self::Between { shortest: interval, .. } => interval.rate_hz(),
        }
    }

    /// Whether a rate is among them, to one in a hundred.
    #[must_use]
    pub fn has(self, rate_hz: f64) -> bool {
        match self {
            Self::Discrete(interval) => is_rate(interval.rate_hz(), rate_hz),
            Self::Between { shortest, longest } => {
                rate_hz <= shortest.rate_hz() * 1.01 && rate_hz >= longest.rate_hz() * 0.99
            }
        }
    }
}

/// Whether a device that runs at `obtained_hz` does what was asked for.
#[must_use]
pub(super) fn is_rate(obtained_hz: f64, requested_hz: f64) -> bool {
    // Chosen by hand: 30 Hz and 29.97 Hz of the NTSC standard are the same rate, 25 and 24 Hz are not.
    (obtained_hz - requested_hz).abs() <= 0.01 * requested_hz
}

impl fmt::Display for RateOffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let short = |i: &Interval| (i.rate_hz() * 1000.0).round() / 1000.0;
        match self {
            Self::Discrete(interval) => write!(f, "{}", short(interval)),
            Self::Between { shortest, longest } => write!(f, "{} to {}", short(longest), short(shortest)),
        }
    }
}

/// A pixel format that a node offers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormatName {
    /// Its letters.
    pub fourcc: FourCc,
    /// The driver's words for it.
    pub description: String,
}

/// What an image of a node looks like in memory, as the driver has set it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BufferFormat {
    /// Pixel format.
    pub(super) fourcc: FourCc,
    /// Columns, px.
    pub(super) width: u32,
    /// Rows, px.
    pub(super) height: u32,
    /// The kernel's number of the order of fields; 1: whole images.
    pub(super) field: u32,
    /// From row to row of the first plane, bytes.
    pub(super) stride: u32,
    /// Largest image in the first plane, bytes.
    pub(super) size: u32,
}

/// Images whose rows all come from one exposure.
pub(super) const FIELD_NONE: u32 = 1;

/// Kinds of controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// A number.
    Integer,
    /// A number of 64 bits.
    Integer64,
    /// Yes or no.
    Boolean,
    /// One of several words.
    Menu,
    /// One of several numbers.
    IntegerMenu,
    /// Bits.
    Bitmask,
    /// Does something when it is written.
    Button,
    /// Text, arrays and records, which are left alone.
    Compound,
}

/// A control that a node offers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlOffer {
    /// The kernel's number.
    pub id: u32,
    /// Its name as it is written in a run file.
    pub name: String,
    /// Its kind.
    pub kind: ControlKind,
    /// Smallest value.
    pub minimum: i64,
    /// Largest value.
    pub maximum: i64,
    /// Distance of values.
    pub step: u64,
    /// What the driver starts with.
    pub default: i64,
    /// Entries of a menu: number and name.
    pub menu: Vec<(i64, String)>,
    /// Whether it can only be read.
    pub read_only: bool,
    /// Whether another control keeps it from having an effect.
    pub inactive: bool,
}

/// A part of a sensor, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct SensorArea {
    /// First column.
    pub left: i32,
    /// First row.
    pub top: i32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A buffer that the driver has filled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FilledBuffer {
    /// Which buffer.
    pub(super) index: u32,
    /// First byte of the image.
    pub(super) offset: usize,
    /// Bytes of the image.
    pub(super) length: usize,
    /// The driver's stamp.
    pub(super) stamp: MonoNs,
    /// By what clock.
    pub(super) clock: StampClock,
    /// Whether the stamp is of the exposure's start, not of the frame's end.
    pub(super) at_start: bool,
    /// The driver's count.
    pub(super) sequence: u32,
    /// Order of fields.
    pub(super) field: u32,
    /// The driver's word that the image is damaged.
    pub(super) damaged: bool,
}

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Waited {
    /// The time is over.
    TimeIsUp,
    /// There is something to take.
    Ready,
    /// Something is wrong; [`VideoNode::dequeue`] may say what.
    Troubled,
}

/// An open video node.
pub(super) trait VideoNode: fmt::Debug {
    /// What it says of itself.
    fn info(&self) -> &NodeInfo;
    /// Takes images from this input.
    fn select_input(&mut self, index: u32) -> Result<(), Errno>;
    /// Formats that it offers.
    fn formats(&self) -> Vec<FormatName>;
    /// Sizes in a format; none where it does not say.
    fn sizes(&self, fourcc: FourCc) -> Vec<SizeOffer>;
    /// Rates at a size; none where it does not say.
    fn rates(&self, fourcc: FourCc, width: u32, height: u32) -> Vec<RateOffer>;
    /// Sets format and size; what the driver made of it.
    fn set_format(&mut self, fourcc: FourCc, width: u32, height: u32) -> Result<BufferFormat, Errno>;
    /// Sets the rate; what the driver made of it, `None` where it has none to set.
    fn set_interval(&mut self, interval: Interval) -> Result<Option<Interval>, Errno>;
    /// Controls that it offers.
    fn controls(&self) -> Vec<ControlOffer>;
    /// The value of a control.
    fn control(&self, id: u32, kind: ControlKind) -> Result<i64, Errno>;
    /// Sets a control.
    fn set_control(&mut self, id: u32, kind: ControlKind, value: i64) -> Result<(), Errno>;
    /// Format and size as they are set.
    fn layout(&mut self) -> Result<BufferFormat, Errno>;
    /// What is captured where nothing is cut.
    fn whole_area(&self) -> Result<SensorArea, Errno>;
    /// What is captured now.
    fn area(&self) -> Result<SensorArea, Errno>;
    /// Cuts; what the driver made of it.
    fn set_crop(&mut self, area: SensorArea) -> Result<SensorArea, Errno>;
    /// Makes and maps buffers; how many there are.
    fn allocate(&mut self, count: u32) -> Result<u32, Errno>;
    /// Gives a buffer to the driver.
    fn queue(&mut self, index: u32) -> Result<(), Errno>;
    /// Begins to stream.
    fn start(&mut self) -> Result<(), Errno>;
    /// Ends streaming; the driver gives all buffers back.
    fn stop(&mut self) -> Result<(), Errno>;
    /// Waits until there is something to take.
    fn wait(&self, longest: Duration) -> Result<Waited, Errno>;
    /// Takes the oldest filled buffer.
    fn dequeue(&mut self) -> Result<FilledBuffer, Errno>;
    /// What lies in a taken buffer.
    fn payload(&self, buffer: &FilledBuffer) -> &[u8];
}

/// A video node's file, before it is opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NodeFile {
    /// Its path.
    pub(super) path: PathBuf,
    /// The serial number of the USB device it belongs to.
    pub(super) serial: Option<String>,
    /// Which of the nodes of its device it is.
    pub(super) index: Option<u32>,
}

/// The machine that cameras are connected to.
pub(super) trait CameraHost: fmt::Debug {
    /// All video nodes, in the order of their numbers.
    fn nodes(&self) -> Vec<NodeFile>;
    /// A file by the path that somebody gave, links followed.
    fn file(&self, path: &Path) -> Result<NodeFile, super::V4l2Error>;
    /// Opens a node.
    fn open(&self, path: &Path) -> Result<Box<dyn VideoNode>, Errno>;
    /// The monotonic clock.
    fn now(&self) -> MonoNs;
    /// Waits.
    fn pause(&self, span: SpanNs);
}
