//! A region of the image: cut by the device where it can, else while the frame is turned into grey.

use super::fault::refused;
use super::node::{SensorArea, VideoNode};
use super::{CaptureRequest, V4l2Error};
use crate::imaging::grey::{NotGrey, ToGrey};
use rustix::io::Errno;

/// What is captured and what of it is kept, px.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Cut {
    /// Columns and rows that the device gives.
    pub(super) captured: (u32, u32),
    /// Columns and rows that are kept.
    pub(super) kept: (u32, u32),
    /// First column that is kept.
    pub(super) left: u32,
    /// First row.
    pub(super) top: u32,
    /// A whole image, where only whole ones can be decoded.
    whole: Vec<u8>,
}

impl Cut {
    fn new(captured: (u32, u32), (left, top): (u32, u32), kept: (u32, u32)) -> Self {
        Self { captured, kept, left, top, whole: Vec::new() }
    }
}

fn text(area: &SensorArea) -> String {
    let SensorArea { left, top, width, height } = area;
    format!("{width}x{height} at column {left}, row {top}")
}

/// Cuts as the run file says.
pub(super) fn cut(
    node: &mut dyn VideoNode,
    request: &CaptureRequest,
    news: &mut Vec<String>,
) -> Result<Cut, V4l2Error> {
    let full = (request.width, request.height);
    let Some(region) = request.region else {
        // What somebody cut before stays with the device.
        if let (Ok(whole), Ok(now)) = (node.whole_area(), node.area())
            && whole != now
        {
            let _ = node.set_crop(whole);
        }
        return Ok(Cut::new(full, (0, 0), full));
    };
    let kept = (region.width, region.height);
    let here = Cut::new(full, (region.left.cast_unsigned(), region.top.cast_unsigned()), kept);
    // Where the sensor has another size than the image, a region of one is not a region of the other: cut here.
    match node.whole_area() {
        Ok(bounds) if (bounds.width, bounds.height) == full => {
            let asked =
                SensorArea { left: bounds.left + region.left, top: bounds.top + region.top, ..region };
            match node.set_crop(asked) {
                Ok(taken) if taken == asked => return Ok(Cut::new(kept, (0, 0), kept)),
                Ok(taken) => {
                    let taken =
                        SensorArea { left: taken.left - bounds.left, top: taken.top - bounds.top, ..taken };
                    return Err(V4l2Error::Region { asked: text(&region), taken: text(&taken) });
                }
                Err(Errno::NOTTY | Errno::INVAL) => {}
                Err(e) => return Err(refused("the region".into(), e)),
            }
        }
        Ok(_) | Err(_) => {}
    }
    news.push(format!(
        "camera.roi: the device cannot cut {} by itself: whole frames are captured, and cut when they are turned into grey",
        text(&region)
    ));
    Ok(here)
}

/// Turns an image into grey that can only be decoded as a whole, and keeps the region.
pub(super) fn convert_whole(
    grey: &mut ToGrey,
    raw: &[u8],
    cut: &mut Cut,
    out: &mut [u8],
) -> Result<(), NotGrey> {
    if cut.captured == cut.kept {
        return grey.convert(raw, 0, out);
    }
    let (width, height) = (cut.captured.0 as usize, cut.captured.1 as usize);
    cut.whole.resize(width * height, 0);
    grey.convert(raw, 0, &mut cut.whole)?;
    let rows = cut.whole.chunks_exact(width.max(1)).skip(cut.top as usize);
    let (left, kept) = (cut.left as usize, cut.kept.0 as usize);
    for (to, from) in out.chunks_exact_mut(kept.max(1)).zip(rows) {
        if let Some(from) = from.get(left..left + kept) {
            to.copy_from_slice(from);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::grey::PixelFormat;
    use image::codecs::jpeg::JpegEncoder;

    /// An image of a slope: the grey level says where a pixel was.
    #[test]
    fn a_region_of_a_jpeg_is_that_of_the_whole_image() {
        const W: u32 = 32;
        const H: u32 = 16;
        let slope: Vec<u8> = (0..H).flat_map(|y| (0..W).map(move |x| (4 * x + 6 * y) as u8)).collect();
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, 95)
            .encode(&slope, W, H, image::ExtendedColorType::L8)
            .unwrap();
        let mut grey = ToGrey::new(PixelFormat::Mjpg, W, H);
        let mut cut = Cut::new((W, H), (5, 3), (20, 10));
        let mut out = vec![0; 200];
        convert_whole(&mut grey, &jpeg, &mut cut, &mut out).unwrap();
        for (i, level) in (0_u32..).zip(&out) {
            let wanted = 4 * (5 + i % 20) + 6 * (3 + i / 20);
            assert!(u32::from(*level).abs_diff(wanted) <= 6, "{i}: {level} {wanted}");
        }
        let mut whole = vec![0; (W * H) as usize];
        convert_whole(&mut grey, &jpeg, &mut Cut::new((W, H), (0, 0), (W, H)), &mut whole).unwrap();
        assert!(whole[0] <= 6 && whole[(W * H - 1) as usize] >= 208);
    }
}
