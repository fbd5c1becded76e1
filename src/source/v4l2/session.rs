//! One opening of a camera: from its node to a stream, and from filled buffers to the newest good one.
//!
//! ```text
//! input ─► crop ─► format, size, rate ─► controls ─► buffers ─► all queued ─► streaming
//!                                                                   ▲             │ filled, one or several
//!                                              requeued, exactly once each ◄── older ones, damaged ones
//!                                                                   ▲             │ the newest
//!                                                                   └── converted where it lies, into shared memory
//! ```

use super::V4l2Error;
use super::controls::{self, ExposureControls};
use super::crop::{self, Cut};
use super::fault::{is_gone, refused};
use super::format::{self, Agreed, FormatRequest};
use super::node::{FIELD_NONE, FilledBuffer, VideoNode};
use crate::imaging::grey::{NotGrey, PixelFormat, ToGrey};
use crate::time::SpanNs;
use rustix::io::Errno;
use std::path::{Path, PathBuf};

use super::CaptureRequest;

/// Fewest buffers with which one can be converted while another is filled.
const FEWEST_BUFFERS: u32 = 2;

/// What happened to the frames that were not used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Losses {
    /// Damaged, by the driver's word or by their length.
    pub(super) damaged: u64,
    /// Older than another one that was there too.
    pub(super) superseded: u64,
}

/// An open camera, ready to stream or streaming.
#[derive(Debug)]
pub(super) struct Session {
    path: PathBuf,
    node: Box<dyn VideoNode>,
    agreed: Agreed,
    cut: Cut,
    grey: ToGrey,
    asked_buffers: u32,
    buffers: u32,
    exposure: ExposureControls,
    taken: Option<FilledBuffer>,
}

impl Session {
    /// Sets everything but the stream. Returns notes for people.
    pub(super) fn prepare(
        path: &Path,
        mut node: Box<dyn VideoNode>,
        request: &CaptureRequest,
    ) -> Result<(Self, Vec<String>), V4l2Error> {
        let mut news = Vec::new();
        let settings = &request.settings;
        let failed = |what: &str, e: Errno| match e {
            Errno::BUSY => V4l2Error::Busy { path: path.into() },
            e if is_gone(e) => V4l2Error::Gone { path: path.into() },
            e => refused(what.into(), e),
        };
        if let Some(input) = settings.input {
            node.select_input(input).map_err(|e| failed(&format!("input {input}"), e))?;
        }
        let cut = crop::cut(node.as_mut(), request, &mut news)?;
        let (width, height) = cut.captured;
        let requested = FormatRequest { width, height, rate_hz: request.rate_hz, format: settings.format };
        let (agreed, told) = format::negotiate(node.as_mut(), path, &requested, settings.strict_rate)?;
        news.extend(told);
        news.extend(controls::apply(node.as_mut(), settings, request.exposure)?);
        let exposure = ExposureControls::of(&node.controls());
        let (out_width, out_height) = cut.kept;
        let grey = if agreed.format == PixelFormat::Mjpg {
            ToGrey::new(agreed.format, width, height)
        } else {
            ToGrey::new(agreed.format, out_width, out_height)
        };
        let session = Self {
            path: path.into(),
            node,
            agreed,
            cut,
            grey,
            asked_buffers: settings.buffers,
            buffers: 0,
            exposure,
            taken: None,
        };
        Ok((session, news))
    }

    /// Makes the buffers, gives all of them to the driver and begins to stream.
    pub(super) fn begin(&mut self) -> Result<(), V4l2Error> {
        let path = self.path.clone();
        let failed = |what: &str, e: Errno| match e {
            Errno::BUSY => V4l2Error::Busy { path: path.clone() },
            Errno::NOSPC => V4l2Error::Bandwidth { path: path.clone() },
            e if is_gone(e) => V4l2Error::Gone { path: path.clone() },
            e => refused(what.into(), e),
        };
        self.buffers = self
            .node
            .allocate(self.asked_buffers)
            .map_err(|e| failed(&format!("{} buffers", self.asked_buffers), e))?;
        if self.buffers < FEWEST_BUFFERS {
            return Err(refused(format!("more than {} buffer(s)", self.buffers), Errno::NOMEM));
        }
        self.queue_all_and_start().map_err(|e| failed("to stream", e))
    }

    fn queue_all_and_start(&mut self) -> Result<(), Errno> {
        self.taken = None;
        for index in 0..self.buffers {
            self.node.queue(index)?;
        }
        self.node.start()
    }

    /// Stops and begins again with the same buffers: what helps after a stream error.
    pub(super) fn restart(&mut self) -> Result<(), Errno> {
        self.taken = None; // stopping gives all buffers back
        self.node.stop()?;
        self.queue_all_and_start()
    }

    /// Gives the taken buffer back to the driver.
    pub(super) fn give_back(&mut self) -> Result<(), Errno> {
        match self.taken.take() {
            Some(buffer) => self.node.queue(buffer.index),
            None => Ok(()),
        }
    }

    /// Takes the newest filled buffer; older and damaged ones go back at once.
    pub(super) fn take_newest(&mut self, losses: &mut Losses) -> Result<Option<FilledBuffer>, Errno> {
        self.give_back()?;
        // A driver that fills faster than this comes round is not followed for ever.
        for _ in 0..=self.buffers {
            let buffer = match self.node.dequeue() {
                Ok(buffer) => buffer,
                Err(Errno::AGAIN) => break,
                Err(e) => return Err(e),
            };
            if self.is_damaged(&buffer) {
                losses.damaged += 1;
                self.node.queue(buffer.index)?;
            } else if let Some(older) = self.taken.replace(buffer) {
                losses.superseded += 1;
                self.node.queue(older.index)?;
            }
        }
        Ok(self.taken)
    }

    fn is_damaged(&self, buffer: &FilledBuffer) -> bool {
        buffer.damaged
            || buffer.field > FIELD_NONE
            || buffer.index >= self.buffers
            || self.node.payload(buffer).len() < self.min_bytes()
    }

    /// Bytes without which an image is not whole.
    fn min_bytes(&self) -> usize {
        let layout = &self.agreed.layout;
        self.agreed.format.min_payload_bytes(layout.width, layout.height, layout.stride as usize)
    }

    /// Converts the taken buffer, where it lies, into `out`. The one pass over a frame's pixels.
    pub(super) fn convert(&mut self, out: &mut [u8]) -> Result<(), NotGrey> {
        let Some(buffer) = self.taken else { return Ok(()) };
        let payload = self.node.payload(&buffer);
        let (stride, format) = (self.agreed.layout.stride as usize, self.agreed.format);
        if format == PixelFormat::Mjpg {
            return crop::convert_whole(&mut self.grey, payload, &mut self.cut, out);
        }
        let bytes_per_pixel = format.min_stride_bytes(2) / 2;
        let from = self.cut.top as usize * stride + bytes_per_pixel * self.cut.left as usize;
        self.grey.convert(payload.get(from..).unwrap_or_default(), stride, out)
    }

    /// The node.
    pub(super) fn node(&self) -> &dyn VideoNode {
        self.node.as_ref()
    }

    /// What was agreed on.
    pub(super) fn agreed(&self) -> &Agreed {
        &self.agreed
    }

    /// How many buffers there are.
    pub(super) fn buffers(&self) -> u32 {
        self.buffers
    }

    /// Length of the exposure as the device says, and whether the device changes it by itself.
    pub(super) fn exposure(&self) -> (Option<SpanNs>, bool) {
        let node = self.node.as_ref();
        (self.exposure.read(node), self.exposure.is_automatic(node))
    }

    /// Where its node lies.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}
