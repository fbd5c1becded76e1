//! What was found, drawn over the image.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use super::ImageAnswer;
use crate::camera_model::CameraModel;
use crate::pipeline::segment_pixels;
use crate::print::letters;
use crate::source::encode_png;
use crate::target::Kind;
use image::{ExtendedColorType, GrayImage, Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector2};

const POINT: Rgb<u8> = Rgb([0, 255, 64]);
const TAG: Rgb<u8> = Rgb([255, 64, 255]);
const AXES: [Rgb<u8>; 3] = [Rgb([255, 48, 48]), Rgb([48, 255, 48]), Rgb([80, 120, 255])];

const EDGE_SHAPE: Rgb<u8> = Rgb([255, 160, 0]);
/// Corners of an ellipse that is drawn.
const CORNERS: u32 = 90;

/// PNG bytes; `None` where they cannot be made.
pub(super) fn draw(
    image: &GrayImage,
    answer: &ImageAnswer,
    target: Option<(&Kind, &CameraModel)>,
) -> Option<Vec<u8>> {
    let mut out = RgbImage::from_fn(image.width(), image.height(), |x, y| {
        let [level] = image.get_pixel(x, y).0;
        Rgb([level; 3])
    });
    edge_shapes(&mut out, answer);
    for tag in answer.tags.iter().flatten() {
        for (from, to) in tag.corners_px.iter().zip(tag.corners_px.iter().cycle().skip(1)) {
            line(&mut out, Vector2::from(*from), Vector2::from(*to), TAG);
        }
        let middle = tag.corners_px.iter().fold(Vector2::zeros(), |sum, c| sum + Vector2::from(*c) / 4.0);
        text(&mut out, middle, &tag.id.to_string(), TAG);
    }
    for feature in &answer.features {
        let p = Vector2::new(feature.u_px, feature.v_px);
        line(&mut out, p - Vector2::x() * 4.0, p + Vector2::x() * 4.0, POINT);
        line(&mut out, p - Vector2::y() * 4.0, p + Vector2::y() * 4.0, POINT);
        text(&mut out, p + Vector2::new(3.0, -9.0), &feature.id.to_string(), POINT);
    }
    if let (Some(pose), Some((kind, camera))) = (&answer.pose, target) {
        let [x, y, z, w] = pose.rotation_xyzw;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let X_CO = Isometry3::from_parts(Translation3::from(pose.position_m), rotation);
        let plate = kind.target.plate();
        let length_m = 0.3 * (plate.high_m - plate.low_m).amin();
        // towards the camera: z_o points away from it
        let ends = [[length_m, 0.0, 0.0], [0.0, length_m, 0.0], [0.0, 0.0, -length_m]];
        for (end, colour) in ends.into_iter().zip(AXES) {
            let of = |p: Point3<f64>| camera.project(&(X_CO * p));
            if let (Some(from), Some(to)) = (of(Point3::origin()), of(Point3::from(end))) {
                for offset in [Vector2::zeros(), Vector2::x(), Vector2::y()] {
                    line(&mut out, from + offset, to + offset, colour);
                }
            }
        }
    }
    encode_png(out.as_raw(), out.width(), out.height(), ExtendedColorType::Rgb8).ok()
}

/// Segments and ellipses.
fn edge_shapes(out: &mut RgbImage, answer: &ImageAnswer) {
    for segment in answer.segments.iter().flatten() {
        let [from, to] = segment.ends_px.map(Vector2::from);
        line(out, from, to, EDGE_SHAPE);
    }
    for (ellipse, at) in answer.ellipses.iter().flatten().zip(&answer.features) {
        let (sin, cos) = ellipse.axis_rad.sin_cos();
        let [a, b] = ellipse.axes_px;
        let rim = |i: u32| {
            let (s, c) = (std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS)).sin_cos();
            Vector2::new(at.u_px + a * c * cos - b * s * sin, at.v_px + a * c * sin + b * s * cos)
        };
        (0..CORNERS).for_each(|i| line(out, rim(i), rim(i + 1), EDGE_SHAPE));
    }
}

fn dot(out: &mut RgbImage, p: Vector2<f64>, colour: Rgb<u8>) {
    let (x, y) = (p.x.round(), p.y.round());
    if x >= 0.0 && y >= 0.0 && x < f64::from(out.width()) && y < f64::from(out.height()) {
        out.put_pixel(x as u32, y as u32, colour);
    }
}

pub(in crate::cli) fn line(out: &mut RgbImage, from: Vector2<f64>, to: Vector2<f64>, colour: Rgb<u8>) {
    segment_pixels(from, to).for_each(|px| dot(out, px, colour));
}

fn text(out: &mut RgbImage, at: Vector2<f64>, text: &str, colour: Rgb<u8>) {
    for (x, y) in letters(text) {
        dot(out, at + Vector2::new(f64::from(x), f64::from(y)), colour);
    }
}
