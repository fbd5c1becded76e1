//! Which format a device is asked for: the cheapest way to grey among those that have the size, and the rate if any has.
//!
//! What a device lists is a promise at best: it is asked, and what it made of that is read back.

use super::V4l2Error;
use super::fault::{is_gone, refused};
use super::node::{
    BufferFormat, FIELD_NONE, FormatName, FourCc, Interval, RateOffer, SizeOffer, VideoNode, is_rate,
};
use crate::imaging::grey::PixelFormat;
use rustix::io::Errno;
use serde::Serialize;
use std::path::Path;

/// The format of these letters, where it can be turned into grey.
pub(super) fn known(fourcc: FourCc) -> Option<PixelFormat> {
    PixelFormat::from_fourcc(fourcc.0)
}

/// The letters of a format.
fn letters(format: PixelFormat) -> FourCc {
    FourCc(format.fourcc())
}

/// A size that is offered, and its rates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfferedSize {
    /// The size, or a range of them.
    pub size: SizeOffer,
    /// Rates at it; of a range: at its largest. None where the device does not say.
    pub rates: Vec<RateOffer>,
}

/// A format that is offered, with its sizes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfferedFormat {
    /// The format.
    #[serde(flatten)]
    pub format: FormatName,
    /// Whether it can be used here.
    pub usable: bool,
    /// Its sizes; none where the device does not say.
    pub sizes: Vec<OfferedSize>,
}

/// `30, 15, 5`; empty where the device does not say.
#[must_use]
pub fn rates_line(rates: &[RateOffer]) -> String {
    rates.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// All that a node offers, with rates at each size.
pub(super) fn offered(node: &dyn VideoNode) -> Vec<OfferedFormat> {
    let sizes = |fourcc| {
        let one = |size| {
            let (width, height) = match size {
                SizeOffer::Discrete { width, height } => (width, height),
                SizeOffer::Stepwise { largest: [width, height], .. } => (width, height),
            };
            OfferedSize { size, rates: node.rates(fourcc, width, height) }
        };
        node.sizes(fourcc).into_iter().map(one).collect()
    };
    let mut seen = Vec::new();
    let formats = node.formats().into_iter().filter(|format| {
        let is_new = !seen.contains(&format.fourcc);
        seen.push(format.fourcc);
        is_new
    });
    formats
        .map(|format| OfferedFormat {
            usable: known(format.fourcc).is_some(),
            sizes: sizes(format.fourcc),
            format,
        })
        .collect()
}

/// Most entries of a line, chosen by hand; `vservo camera --list` shows the others.
const TOLD: usize = 24;

fn told(mut all: Vec<String>) -> String {
    let mut seen = Vec::new();
    all.retain(|one| {
        !seen.contains(one) && {
            seen.push(one.clone());
            true
        }
    });
    if all.is_empty() {
        return "nothing".into();
    }
    let more = if all.len() > TOLD { ", and more (`vservo camera --list`)" } else { "" };
    all.truncate(TOLD);
    all.join(", ") + more
}

/// The letters of all formats.
fn formats_line<'a>(offers: impl IntoIterator<Item = &'a OfferedFormat>) -> String {
    told(offers.into_iter().map(|offer| offer.format.fourcc.to_string()).collect())
}

/// The sizes of all formats.
fn sizes_line<'a>(offers: impl IntoIterator<Item = &'a OfferedFormat>) -> String {
    told(offers.into_iter().flat_map(|offer| &offer.sizes).map(|size| size.size.to_string()).collect())
}

/// What is wanted of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FormatRequest {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) rate_hz: f64,
    pub(super) format: Option<PixelFormat>,
}

/// The formats worth asking for, the best first: those that have the rate before those that do not, the cheapest first among the
/// former, the fastest among the latter. `rates` gives those of a format at the wanted size.
pub(super) fn candidates(
    offers: &[OfferedFormat],
    request: &FormatRequest,
    rates: impl Fn(FourCc) -> Vec<RateOffer>,
) -> Result<Vec<(PixelFormat, FourCc)>, V4l2Error> {
    let FormatRequest { width, height, .. } = *request;
    let wanted = |format: PixelFormat| request.format.is_none_or(|only| only == format);
    let offer_of = |format| offers.iter().find(|offer| known(offer.format.fourcc) == Some(format));
    let has_format: Vec<_> = PixelFormat::ALL
        .into_iter()
        .filter(|format| wanted(*format))
        .filter_map(|format| Some((format, offer_of(format)?)))
        .collect();
    if has_format.is_empty() {
        let known: Vec<_> = PixelFormat::ALL.iter().map(|format| letters(*format).to_string()).collect();
        let requested = request.format.map_or_else(
            || format!("any of {}, which are those that can be turned into grey", known.join(", ")),
            |format| letters(format).to_string(),
        );
        return Err(V4l2Error::NoFormat { requested, offered: formats_line(offers) });
    }
    let has_size = |offer: &OfferedFormat| {
        offer.sizes.is_empty() || offer.sizes.iter().any(|s| s.size.has(width, height))
    };
    let mut ranked: Vec<_> = has_format
        .iter()
        .enumerate()
        .filter(|(_, (_, offer))| has_size(offer))
        .map(|(cost, (format, offer))| {
            let rates = rates(offer.format.fourcc);
            let fits = rates.is_empty() || rates.iter().any(|rate| rate.has(request.rate_hz));
            let fastest = rates.iter().map(|rate| rate.highest_hz()).fold(0.0, f64::max);
            let shortfall = if fits { 0.0 } else { -fastest };
            ((!fits, shortfall, cost), (*format, offer.format.fourcc))
        })
        .collect();
    if ranked.is_empty() {
        let format = request.format.map_or(String::new(), |format| format!(" in {}", letters(format)));
        let offered = sizes_line(has_format.iter().map(|(_, offer)| *offer));
        return Err(V4l2Error::NoSize { width, height, format, offered });
    }
    ranked.sort_by(|(a, _), (b, _)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    Ok(ranked.into_iter().map(|(_, candidate)| candidate).collect())
}

/// What was agreed on with a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Agreed {
    pub(super) format: PixelFormat,
    pub(super) layout: BufferFormat,
    /// What the device says to keep; `None` where it has no rate to set.
    pub(super) interval: Option<Interval>,
}

/// Asks for format, size and rate. Returns notes for people beside the agreed capture.
pub(super) fn negotiate(
    node: &mut dyn VideoNode,
    path: &Path,
    request: &FormatRequest,
    strict_rate: bool,
) -> Result<(Agreed, Option<String>), V4l2Error> {
    let offers = offered(node);
    let rates = |node: &dyn VideoNode, fourcc| node.rates(fourcc, request.width, request.height);
    let mut tried = Vec::new();
    let asked = candidates(&offers, request, |fourcc| rates(node, fourcc))?;
    for (format, fourcc) in asked {
        let layout = match node.set_format(fourcc, request.width, request.height) {
            Ok(layout) => layout,
            Err(Errno::BUSY) => return Err(V4l2Error::Busy { path: path.into() }),
            Err(e) if is_gone(e) => return Err(V4l2Error::Gone { path: path.into() }),
            Err(Errno::INVAL) => {
                tried.push(format!("{fourcc} {}x{} is refused", request.width, request.height));
                continue;
            }
            Err(e) => return Err(refused(format!("{fourcc} {}x{}", request.width, request.height), e)),
        };
        if (layout.fourcc, layout.width, layout.height) != (fourcc, request.width, request.height) {
            tried.push(format!(
                "{fourcc} {}x{} became {} {}x{}",
                request.width, request.height, layout.fourcc, layout.width, layout.height
            ));
            continue;
        }
        if layout.field > FIELD_NONE {
            return Err(V4l2Error::Interlaced { field: layout.field });
        }
        let interval = node.set_interval(Interval::of_rate(request.rate_hz)).map_err(|e| {
            if is_gone(e) { V4l2Error::Gone { path: path.into() } } else { refused("a rate".into(), e) }
        })?;
        let kept = node.layout().map_err(|e| refused("the question for its format".into(), e))?;
        if kept != layout {
            tried.push(format!("{fourcc} was left again for {} when the rate was set", kept.fourcc));
            continue;
        }
        check_layout(format, &layout)?;
        let news = rate_news(request.rate_hz, interval, &rates(node, fourcc), strict_rate)?;
        return Ok((Agreed { format, layout, interval }, news));
    }
    let offered = format!("{} in {}", formats_line(&offers), sizes_line(&offers));
    Err(V4l2Error::Substituted { tried: tried.join("; "), offered })
}

fn check_layout(format: PixelFormat, layout: &BufferFormat) -> Result<(), V4l2Error> {
    let (row, stride) = (format.min_stride_bytes(layout.width), layout.stride as usize);
    let least = format.min_payload_bytes(layout.width, layout.height, stride);
    if stride < row || least > layout.size as usize {
        return Err(V4l2Error::Layout(format!(
            "the driver says {} bytes from row to row and {} in an image of {} {}x{}, whose rows have {row}",
            stride, layout.size, layout.fourcc, layout.width, layout.height
        )));
    }
    Ok(())
}

/// What there is to tell about the rate.
fn rate_news(
    asked_hz: f64,
    interval: Option<Interval>,
    offered: &[RateOffer],
    strict: bool,
) -> Result<Option<String>, V4l2Error> {
    let rate = interval.map(Interval::rate_hz).filter(|hz| *hz > 0.0);
    if rate.is_some_and(|hz| is_rate(hz, asked_hz)) {
        return Ok(None);
    }
    let obtained = rate.map_or("what it likes (it has no rate to set)".into(), |hz| format!("{hz:.3} Hz"));
    let offered = match rates_line(offered) {
        line if line.is_empty() => "nothing that it tells of".into(),
        line => format!("{line} Hz"),
    };
    if strict {
        return Err(V4l2Error::Rate { asked_hz, obtained, offered });
    }
    Ok(Some(format!(
        "camera.rate_hz: asked for {asked_hz} Hz, the device takes {obtained}; it offers {offered} at this size and format"
    )))
}

#[cfg(test)]
mod tests;
