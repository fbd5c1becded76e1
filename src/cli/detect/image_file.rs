//! Image files from the command line, as grey images; sizes are checked before anything is decoded.

use crate::source::{SourceError, load_image};
use image::GrayImage;
use std::path::Path;

/// The image in a file: PNG, PNM or JPEG, of any depth and colour; or why there is none.
pub(in crate::cli) fn load(path: &Path) -> Result<GrayImage, String> {
    load_image(path).map_err(|error| match error {
        SourceError::Image { cause, .. } => format!("cannot be decoded: {cause}"),
        SourceError::Damaged(_) => "cannot be decoded: it ends before its image does".into(),
        SourceError::NotAFile { kind, .. } => format!("is {kind}, not an image file"),
        SourceError::TooLarge { mib, largest_mib, .. } => {
            format!("has {mib} MiB, an image of the largest size at most {largest_mib}")
        }
        SourceError::Size { found_width, found_height, width, height, .. } => {
            format!("is {found_width}x{found_height} px, at most {width}x{height} are taken")
        }
        other => other.to_string(),
    })
}
