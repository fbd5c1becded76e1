//! `vservo teach-view CONFIG LEFT RIGHT [LEFT RIGHT]... --out FILE`: the view that a pair of cameras is to come back to, from images
//! of both in the desired pose; of several pairs of images the mean.

use super::{TeachViewArguments, shown, write_result};
use crate::config::assemble::{AssembleError, taught_points};
use crate::config::{Config, taught_file};
use crate::detect::Finder;
use crate::imaging::ImageView;
use crate::process::ProcessError;
use crate::source::{SourceError, load_image};
use crate::vision::{StereoVision, TaughtView};
use std::path::Path;

/// # Errors
/// When run file or images are wrong, or the target is not in both.
pub(super) fn teach_view(arguments: &TeachViewArguments) -> Result<u8, ProcessError> {
    let config = Config::load(Some(&arguments.config), &arguments.set)?;
    let Some(stereo) = &config.stereo else { return Err(AssembleError::NoStereo.into()) };
    let rig = &stereo.rig;
    let mut finders = [rig.left(), rig.right()].map(|camera| Finder::new(*camera, &config.target));
    let mut taught = Vec::new();
    for pair in arguments.images.chunks(2) {
        let [left, right] = pair else { return Err(ProcessError::OddImages(arguments.images.len())) };
        let [left, right] = [(left, rig.left()), (right, rig.right())].map(|(path, camera)| {
            let i = camera.intrinsics();
            let image = load_image(path)?;
            let found = image.dimensions();
            if found == (i.width_px, i.height_px) {
                return Ok(image);
            }
            Err(SourceError::Size {
                file: path.clone(),
                found_width: found.0,
                found_height: found.1,
                width: i.width_px,
                height: i.height_px,
            })
        });
        let (left, right) = (left?, right?);
        let view = |image| -> Result<ImageView<'_>, ProcessError> {
            let image: &image::GrayImage = image;
            let (width, height) = image.dimensions();
            Ok(ImageView::new(image.as_raw(), width as usize, height as usize)
                .map_err(AssembleError::from)?)
        };
        let [a, b] = &mut finders;
        let points = StereoVision::points_in(rig, (a, view(&left)?), (b, view(&right)?));
        taught.push(points.map_err(|(side, status)| AssembleError::NotSeen {
            side: side.as_str(),
            status: status.as_str(),
        })?);
    }
    let points = taught_points(&taught);
    // Whether a run will take it.
    TaughtView::new(&points, stereo.X_DO).map_err(AssembleError::from)?;
    let text = taught_file(&points);
    Ok(match &arguments.out {
        Some(path) => write_result(Path::new(path), text, 0),
        None => shown(&text, 0),
    })
}
