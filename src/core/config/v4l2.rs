//! `[camera.v4l2]`: a camera of the kernel's video interface.

use super::check::Validation;
use crate::imaging::grey::PixelFormat;
use crate::time::SpanNs;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

word! {
    /// How the sensor exposes its rows.
    Shutter {
        /// One after the other.
        Rolling,
        /// All at once.
        Global,
    }
}

/// A pixel format by the four letters that drivers name it by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum PixelFormatName {
    /// 8 bits of grey.
    Grey,
    /// 10 bits of grey in 16.
    Y10,
    /// 12 bits of grey in 16.
    Y12,
    /// 16 bits of grey.
    Y16,
    /// Grey in every other byte, from the first on.
    Yuyv,
    /// Grey in every other byte, from the second on.
    Uyvy,
    /// 8 bits of grey, and the colours behind them.
    Nv12,
    /// Blue, green and red.
    Bgr3,
    /// Red, green and blue.
    Rgb3,
    /// A JPEG file for each image.
    Mjpg,
}

impl From<PixelFormatName> for PixelFormat {
    fn from(name: PixelFormatName) -> Self {
        match name {
            PixelFormatName::Grey => Self::Grey,
            PixelFormatName::Y10 => Self::Y10,
            PixelFormatName::Y12 => Self::Y12,
            PixelFormatName::Y16 => Self::Y16,
            PixelFormatName::Yuyv => Self::Yuyv,
            PixelFormatName::Uyvy => Self::Uyvy,
            PixelFormatName::Nv12 => Self::Nv12,
            PixelFormatName::Bgr3 => Self::Bgr3,
            PixelFormatName::Rgb3 => Self::Rgb3,
            PixelFormatName::Mjpg => Self::Mjpg,
        }
    }
}

/// What a control of the camera is set to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum ControlValue {
    /// A number, or the number of a menu's entry.
    Number(i64),
    /// Yes or no.
    Switch(bool),
    /// The name of a menu's entry.
    Entry(String),
}

impl fmt::Display for ControlValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(n) => n.fmt(f),
            Self::Switch(on) => on.fmt(f),
            Self::Entry(name) => write!(f, "\"{name}\""),
        }
    }
}

impl<'de> Deserialize<'de> for ControlValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ControlValueVisitor)
    }
}

/// Reports what was found instead, which a derived choice does not.
struct ControlValueVisitor;

impl Visitor<'_> for ControlValueVisitor {
    type Value = ControlValue;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number, true or false, or the name of a menu's entry")
    }

    fn visit_i64<E>(self, v: i64) -> Result<ControlValue, E> {
        Ok(ControlValue::Number(v))
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<ControlValue, E> {
        i64::try_from(v)
            .map(ControlValue::Number)
            .map_err(|_| E::custom("is larger than any control's value"))
    }

    fn visit_bool<E>(self, v: bool) -> Result<ControlValue, E> {
        Ok(ControlValue::Switch(v))
    }

    fn visit_str<E>(self, v: &str) -> Result<ControlValue, E> {
        Ok(ControlValue::Entry(v.into()))
    }
}

table! {
    /// A camera of the kernel's video interface.
    RawV4l2 {
        /// Path (`/dev/video0`, `/dev/v4l/by-id/...`), name of the camera, or where it is connected
        /// (`usb-0000:00:14.0-2`); `vservo camera --list` shows them.
        device: String = String::new(),
        /// Pixel format; where it is left out, the one that is turned into grey most cheaply.
        #[serde(skip_serializing_if = "Option::is_none")]
        format: Option<PixelFormatName> = None,
        /// Which input of the device, from 0; as the driver has it where it is left out.
        #[serde(skip_serializing_if = "Option::is_none")]
        input: Option<u32> = None,
        /// Buffers that the driver fills in turn.
        buffers: u32 = 4,
        /// Sets `camera.exposure_ms` on the device; without it the exposure is read from there.
        set_exposure: bool = false,
        /// How the sensor exposes its rows.
        shutter: Shutter = Shutter::Rolling,
        /// From the first row to the last, ms: how much later the last one is exposed (rolling) or read (global).
        readout_ms: f64 = 0.0,
        /// Rejects a device that delivers another rate than `camera.rate_hz`; otherwise this is only reported.
        strict_rate: bool = false,
        /// Time without frames after which the run ends, s; until then the arm holds and the camera is awaited.
        give_up_s: f64 = 60.0,
        /// `[camera.v4l2.controls]`: by the names that `vservo camera --list` shows.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        controls: BTreeMap<String, ControlValue> = BTreeMap::new(),
    }
}

/// A camera of the kernel's video interface.
#[derive(Debug, Clone, PartialEq)]
pub struct V4l2Settings {
    /// Path, name or bus of the device.
    pub device: String,
    /// Pixel format; any where it is `None`.
    pub format: Option<PixelFormat>,
    /// Which input.
    pub input: Option<u32>,
    /// Buffers that the driver fills.
    pub buffers: u32,
    /// Whether the exposure is set on the device.
    pub set_exposure: bool,
    /// How the sensor exposes its rows.
    pub shutter: Shutter,
    /// From the first row to the last.
    pub readout: SpanNs,
    /// Whether another rate is refused.
    pub strict_rate: bool,
    /// Longest silence.
    pub give_up: SpanNs,
    /// Controls by name.
    pub controls: BTreeMap<String, ControlValue>,
}

impl V4l2Settings {
    /// What the defaults make of a device.
    #[must_use]
    pub fn of_device(device: &str, format: Option<PixelFormat>) -> Self {
        let raw = RawV4l2::default();
        Self {
            device: device.into(),
            format,
            input: raw.input,
            buffers: raw.buffers,
            set_exposure: raw.set_exposure,
            shutter: raw.shutter,
            readout: SpanNs::from_s(raw.readout_ms * 1e-3),
            strict_rate: raw.strict_rate,
            give_up: SpanNs::from_s(raw.give_up_s),
            controls: raw.controls,
        }
    }
}

/// The settings of a camera whose table is `at`; bounds hold whether it is used or not, a device is `needed` where it is.
pub(super) fn settings(raw: &RawV4l2, at: &str, needed: bool, check: &mut Validation<'_>) -> V4l2Settings {
    let key = |name: &str| format!("{at}.v4l2.{name}");
    if needed && raw.device.trim().is_empty() {
        check.wrong(
            &key("device"),
            "is missing: give the path, the name or the bus of the camera; `vservo camera --list` shows what there is",
        );
    }
    if let Some(name) = raw.controls.keys().find(|name| name.is_empty()) {
        check.wrong(&key("controls"), format!("`{name}` is no name of a control"));
    }
    if let Some(input) = raw.input {
        check.count(&key("input"), input, 0..=255);
    }
    V4l2Settings {
        device: raw.device.trim().into(),
        format: raw.format.map(PixelFormat::from),
        input: raw.input,
        buffers: check.count(&key("buffers"), raw.buffers, 2..=32),
        set_exposure: raw.set_exposure,
        shutter: raw.shutter,
        readout: check.span_ms(&key("readout_ms"), raw.readout_ms, 0.0..=1000.0),
        strict_rate: raw.strict_rate,
        give_up: SpanNs::from_s(check.range(&key("give_up_s"), raw.give_up_s, 1.0..=86_400.0)),
        controls: raw.controls.clone(),
    }
}
