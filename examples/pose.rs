//! The pose of a target from an image: of a file, or of one that is rendered here, whose truth is known.
//!
//! ```text
//! cargo run --release --example pose                    # a rendered image of the textbook's four dots
//! cargo run --release --example pose -- IMAGE.png 600 # an image of them, by a lens of 600 px
//! ```

#![allow(clippy::print_stdout, non_snake_case)] // a program for a terminal; frames are named as in the library

use vservo::prelude::*;
use vservo::scene::{Renderer, SceneLook, SensorModel};

type AnyError = Box<dyn std::error::Error>;

fn main() -> Result<(), AnyError> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next();
    let f_px: f64 = arguments.next().map_or(Ok(600.0), |f| f.parse())?;
    let image = file.map(|file| image::open(file).map(|image| image.into_luma8())).transpose()?;
    let (width_px, height_px) = image.as_ref().map_or((640, 480), |image| image.dimensions());
    let (cx_px, cy_px) = (0.5 * f64::from(width_px - 1), 0.5 * f64::from(height_px - 1));
    let lens = Intrinsics { fx_px: f_px, fy_px: f_px, cx_px, cy_px, width_px, height_px };
    let camera = CameraModel::new(lens, Distortion::default())?;
    let truth = Pose::new([-0.02, 0.01, 0.5].into(), [0.3, -0.2, 0.5].into());
    let (pixels, is_rendered) = match image {
        Some(image) => (image.into_raw(), false),
        None => {
            let mut pixels = vec![0; width_px as usize * height_px as usize];
            let target = FourDots::default();
            Renderer::new(camera, target, SceneLook::default(), SensorModel::default())?.render(
                &[truth],
                0,
                &mut pixels,
            );
            (pixels, true)
        }
    };
    let image = ImageView::new(&pixels, width_px as usize, height_px as usize)?;
    let mut vision = Vision::new(camera, FourDots::default(), VisionSettings::default());
    let header = FrameHeader { width_px, height_px, ..FrameHeader::default() };
    let seen = vision.process(&Frame { header, image }, &Prior::default());
    let Some(X_CO) = seen.pose() else { return Err(seen.target_status().as_str().into()) };
    for f in seen.features() {
        println!("P{} at {:8.3} {:8.3} px, give or take {:.3}", f.id + 1, f.u_px, f.v_px, f.sd_px);
    }
    println!(
        "the target lies at {:.5} m, turned by {:.5} rad",
        X_CO.translation,
        X_CO.rotation.scaled_axis().transpose()
    );
    if is_rendered {
        let off = truth.inverse() * X_CO;
        println!(
            "which is {:.3} mm and {:.5} rad off",
            off.translation.vector.norm() * 1e3,
            off.rotation.angle()
        );
    }
    Ok(())
}
