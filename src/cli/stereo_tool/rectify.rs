//! `vservo stereo rectify`: both images as two cameras with parallel and aligned image planes would have taken them.

use super::look::SideBySide;
use super::matching::view;
use super::pairs::Rig;
use super::rows;
use crate::cli::detect::{image_file, refused};
use crate::cli::{StereoRectifyArguments, json, lost, shown, write_result};
use crate::process::ProcessError;
use crate::source::encode_png;
use crate::stereo::{Rectification, RectificationMap};
use image::{ExtendedColorType, GrayImage};
use serde_json::json as object;

/// Rows that are drawn through both images. Chosen by eye, about ten in an image: this number was chosen by hand.
const ROWS: u32 = 12;

pub(super) fn rectify(arguments: &StereoRectifyArguments) -> Result<u8, ProcessError> {
    match run(arguments) {
        Ok(code) => Ok(code),
        Err((message, code)) => Ok(refused(&message, code)),
    }
}

fn run(arguments: &StereoRectifyArguments) -> Result<u8, (String, u8)> {
    let rig = Rig::read(&arguments.pair).map_err(|e| (e, 3))?;
    let rectified =
        Rectification::new(&rig.camera_1, &rig.camera_2, &rig.X_12).map_err(|e| (e.to_string(), 5))?;
    let make = |path: &std::path::Path, map: &RectificationMap, size: (u32, u32)| {
        let image = image_file::load(path).map_err(|reason| (format!("{}: {reason}", path.display()), 3))?;
        if image.dimensions() != size {
            let (w, h) = image.dimensions();
            return Err((format!("{}: is {w}x{h} px, its camera {}x{}", path.display(), size.0, size.1), 3));
        }
        let (width, height) = map.size();
        let mut out = GrayImage::new(width as u32, height as u32);
        map.rectify(&view(&image)?, out.as_mut());
        Ok(out)
    };
    let size = |camera: &crate::camera_model::CameraModel| {
        let i = camera.intrinsics();
        (i.width_px, i.height_px)
    };
    let left = make(&arguments.left, &rectified.map_1(&rig.camera_1), size(&rig.camera_1))?;
    let right = make(&arguments.right, &rectified.map_2(&rig.camera_2), size(&rig.camera_2))?;
    let i = rectified.camera.intrinsics();
    let text = if arguments.json {
        json(&object!({
            "camera": { "width_px": i.width_px, "height_px": i.height_px, "fx_px": i.fx_px, "fy_px": i.fy_px, "cx_px": i.cx_px, "cy_px": i.cy_px },
            "baseline_m": rectified.baseline_m,
            "R_R1": rows(rectified.R_R1.matrix()),
            "R_R2": rows(rectified.R_R2.matrix()),
        }))
    } else {
        format!(
            "f {:.3} px, centre ({:.2}, {:.2}) px, base line {:.5} m; depth = {:.4} m px / (u1 - u2)\n",
            i.fx_px,
            i.cx_px,
            i.cy_px,
            rectified.baseline_m,
            i.fx_px * rectified.baseline_m
        )
    };
    let mut exit_code = shown(&text, 0);
    if let Err(cause) = std::fs::create_dir_all(&arguments.out) {
        return Ok(lost(&arguments.out, cause, exit_code));
    }
    for (name, image) in [("left.png", &left), ("right.png", &right)] {
        let bytes = encode_png(image.as_raw(), image.width(), image.height(), ExtendedColorType::L8);
        exit_code = match bytes {
            Ok(bytes) => write_result(&arguments.out.join(name), bytes, exit_code),
            Err(e) => lost(&arguments.out, std::io::Error::other(e), exit_code),
        };
    }
    let mut both = SideBySide::new(&left, &right);
    (1..ROWS).for_each(|k| both.row(f64::from(k * i.height_px / ROWS), [86, 180, 233]));
    Ok(both.png().map_or(exit_code, |bytes| write_result(&arguments.out.join("rows.png"), bytes, exit_code)))
}
