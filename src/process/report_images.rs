//! ReportImages that vision leaves for a report.

use super::report_folder::FRAMES;
use super::{ProcessError, ReportFolder};
use crate::config::Camera;
use crate::ipc::ReceivedFrame;
use crate::messages::{FrameHeader, Measurement};
use crate::report::frame_archive::{FrameArchive, KeptImage};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::io::{Error, ErrorKind};
use tracing::error;

/// The images of a run, where a report was asked for; else nothing.
pub(super) struct ReportImages(Option<(ReportFolder, FrameArchive)>);

impl ReportImages {
    pub(super) fn new(folder: Option<&ReportFolder>, camera: &Camera) -> Self {
        let i = camera.model.intrinsics();
        Self(folder.map(|folder| (folder.clone(), FrameArchive::new((i.width_px, i.height_px)))))
    }

    pub(super) fn note_frame(&mut self, frame: &ReceivedFrame) {
        self.note_pixels(&frame.header(), frame.pixels());
    }

    pub(super) fn note_pixels(&mut self, header: &FrameHeader, pixels: &[u8]) {
        if let Some((_, book)) = &mut self.0 {
            book.note_frame(header, pixels);
        }
    }

    pub(super) fn note_measurement(&mut self, m: &Measurement) {
        if let Some((_, book)) = &mut self.0 {
            book.note_measurement(m);
        }
    }

    /// Encodes and writes them, after the run. A failure is reported, and the page is made without them.
    pub(super) fn write(&self) {
        let Some((folder, book)) = &self.0 else { return };
        let written = book.images().try_for_each(|image| {
            let png = encoded(image).map_err(|e| ProcessError::Write {
                path: folder.path().join(image.file_name()),
                cause: Error::new(ErrorKind::InvalidData, e),
            })?;
            folder.write(&image.file_name(), png).map(drop)
        });
        let written = written.and_then(|()| folder.write(FRAMES, book.to_csv()));
        if let Err(cause) = written {
            error!("report: {cause}");
        }
    }
}

/// A grey PNG; quickly, because the supervisor waits.
fn encoded(image: &KeptImage) -> Result<Vec<u8>, image::ImageError> {
    let mut png = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive);
    let (width, height) = image.size_px;
    encoder.write_image(&image.grey, width, height, ExtendedColorType::L8)?;
    Ok(png)
}
