//! Rectification: two cameras turned, in thought, until their image planes are parallel and aligned, as (10.51)-(10.53) want
//! them. Conjugate points then lie in one row.
//!
//! Both cameras meet half way between their directions, then x turns into the base line (Bouguet's way). `R_R1` is the
//! rotation of camera 1 in the rectified frame: `p_R = R_R1 p_1`.

use super::StereoError;
use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::Pose;
use crate::imaging::ImageView;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// Rotations of both cameras and the ideal camera that both become.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectification {
    /// Camera 1 in the rectified frame.
    pub R_R1: Rotation3<f64>,
    /// Camera 2 in the rectified frame.
    pub R_R2: Rotation3<f64>,
    /// x of the rectified camera 2 in the rectified camera 1, m: negative when camera 2 is on the left.
    pub baseline_m: f64,
    /// The ideal camera of both rectified images.
    pub camera: CameraModel,
}

impl Rectification {
    /// For camera 2 at `X_12` in camera 1. The image has camera 1's size; its focal length and centre are such that every pixel
    /// of it that both cameras can fill is filled at no less than the resolution they have on average.
    ///
    /// # Errors
    /// [`StereoError::BadGuess`] for a pose that is not finite, [`StereoError::Degenerate`] without a base line, or with one
    /// along which a camera looks (the images cannot be made parallel to it).
    pub fn new(camera_1: &CameraModel, camera_2: &CameraModel, X_12: &Pose) -> Result<Self, StereoError> {
        let o = X_12.translation.vector;
        if !(o.iter().chain(X_12.rotation.coords.iter()).all(|x| x.is_finite())) {
            return Err(StereoError::BadGuess);
        }
        if o.norm_squared() == 0.0 {
            return Err(StereoError::Degenerate);
        }
        // Half way between both cameras, H: rotations H <- 1 and H <- 2.
        let half = UnitQuaternion::from_scaled_axis(X_12.rotation.scaled_axis() * 0.5);
        let (to_half_1, to_half_2) = (half.inverse(), half);
        let along = to_half_1 * o;
        // The x axis towards camera 2, or away from it, whichever is nearer to where x is.
        let x = along.normalize() * if along.x < 0.0 { -1.0 } else { 1.0 };
        let z = Vector3::z() - x * x.z;
        // sin^2 of 10 degrees. Chosen by hand: nearer to the base line the rectified images would be stretched without bound.
        if !(z.norm_squared() > 0.03) {
            return Err(StereoError::Degenerate); // within 10 degrees of the optical axes
        }
        let z = z.normalize();
        let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]).transpose());
        let (R_R1, R_R2) = (turn * to_half_1.to_rotation_matrix(), turn * to_half_2.to_rotation_matrix());
        let baseline_m = (R_R1 * o).x;
        let camera = common_camera(&[(camera_1, R_R1), (camera_2, R_R2)])?;
        Ok(Self { R_R1, R_R2, baseline_m, camera })
    }

    /// Where a direction of camera 1 (normalized) lies in the rectified image 1, normalized; `None` beyond its horizon.
    #[must_use]
    pub fn rectified_1(&self, s_1: &Vector2<f64>) -> Option<Vector2<f64>> {
        seen(&(self.R_R1 * s_1.push(1.0)))
    }

    /// The same for camera 2.
    #[must_use]
    pub fn rectified_2(&self, s_2: &Vector2<f64>) -> Option<Vector2<f64>> {
        seen(&(self.R_R2 * s_2.push(1.0)))
    }

    /// The table that makes rectified images of camera 1's images.
    #[must_use]
    pub fn map_1(&self, camera_1: &CameraModel) -> RectificationMap {
        RectificationMap::new(&self.camera, camera_1, &self.R_R1)
    }

    /// The table that makes rectified images of camera 2's images.
    #[must_use]
    pub fn map_2(&self, camera_2: &CameraModel) -> RectificationMap {
        RectificationMap::new(&self.camera, camera_2, &self.R_R2)
    }
}

fn seen(p: &Vector3<f64>) -> Option<Vector2<f64>> {
    (p.z > 0.0).then(|| p.xy() / p.z)
}

/// An ideal camera whose image is centred on what both see.
fn common_camera(both: &[(&CameraModel, Rotation3<f64>); 2]) -> Result<CameraModel, StereoError> {
    let mut centre = Vector2::zeros();
    let mut focal = 0.0;
    for (camera, R) in both {
        let i = camera.intrinsics();
        let (w, h) = (f64::from(i.width_px), f64::from(i.height_px));
        let middle = Vector2::new(0.5 * (w - 1.0), 0.5 * (h - 1.0));
        let s = seen(&(R * camera.normalized_of(&middle).push(1.0))).ok_or(StereoError::Degenerate)?;
        centre += s * 0.5;
        focal += 0.25 * (i.fx_px + i.fy_px);
    }
    let i = both[0].0.intrinsics();
    let (w, h) = (f64::from(i.width_px), f64::from(i.height_px));
    let intrinsics = Intrinsics {
        fx_px: focal,
        fy_px: focal,
        cx_px: 0.5 * (w - 1.0) - focal * centre.x,
        cy_px: 0.5 * (h - 1.0) - focal * centre.y,
        width_px: i.width_px,
        height_px: i.height_px,
    };
    CameraModel::new(intrinsics, Distortion::default()).map_err(|_| StereoError::Degenerate)
}

/// For each pixel of a rectified image where it is in the camera's image.
#[derive(Debug, Clone)]
pub struct RectificationMap {
    width: usize,
    height: usize,
    /// Column and row in the camera's image, px; NaN where the camera sees nothing.
    places: Vec<[f32; 2]>,
}

impl RectificationMap {
    fn new(rectified: &CameraModel, camera: &CameraModel, R: &Rotation3<f64>) -> Self {
        let i = rectified.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        let back = R.inverse();
        let mut places = Vec::with_capacity(width * height);
        for v in 0..height {
            for u in 0..width {
                let s = Vector2::new((u as f64 - i.cx_px) / i.fx_px, (v as f64 - i.cy_px) / i.fy_px);
                let p = back * s.push(1.0);
                let px = camera.project(&p.into()).filter(|px| camera.contains(px, 0.0));
                places.push(px.map_or([f32::NAN; 2], |px| [px.x as f32, px.y as f32]));
            }
        }
        Self { width, height, places }
    }

    /// Columns and rows of the rectified image.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Fills `rectified`, row by row, from the image of the camera; 0 where the camera sees nothing. Where `rectified` is too short or too
    /// long, the rest is left as it is.
    pub fn rectify(&self, image: &ImageView<'_>, rectified: &mut [u8]) {
        for (out, [u, v]) in rectified.iter_mut().zip(&self.places) {
            *out = sample(image, f64::from(*u), f64::from(*v)).map_or(0, |x| (x + 0.5) as u8);
        }
    }
}

/// Grey value between pixels, bilinear; up to half a pixel beyond the outermost centres the nearest ones count.
pub(super) fn sample(image: &ImageView<'_>, u_px: f64, v_px: f64) -> Option<f64> {
    let (w, h) = (image.width() as f64, image.height() as f64);
    if !(u_px >= -0.5 && v_px >= -0.5 && u_px <= w - 0.5 && v_px <= h - 0.5) {
        return None;
    }
    let (u, v) = (u_px.clamp(0.0, w - 1.0), v_px.clamp(0.0, h - 1.0));
    let (x, y) = (u as usize, v as usize);
    let (a, b) = (u - x as f64, v - y as f64);
    let pixels = image.pixels();
    let width = image.width();
    let right = usize::from(x + 1 < width);
    let below = if y + 1 < image.height() { width } else { 0 };
    let at = y * width + x;
    let get = |i: usize| pixels.get(i).copied().map(f64::from);
    let (p, q) = (get(at)?, get(at + right)?);
    let (r, s) = (get(at + below)?, get(at + below + right)?);
    Some((p * (1.0 - a) + q * a) * (1.0 - b) + (r * (1.0 - a) + s * a) * b)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, scene};
    use super::super::{Conjugates, triangulate_parallel};
    use super::*;

    fn camera(fx_px: f64) -> CameraModel {
        let intrinsics =
            Intrinsics { fx_px, fy_px: fx_px, cx_px: 160.0, cy_px: 120.0, width_px: 320, height_px: 240 };
        CameraModel::new(intrinsics, Distortion { k1: -0.1, ..Distortion::default() }).unwrap()
    }

    #[test]
    fn rectified_conjugates_share_rows_and_depths_are_parallel() {
        for X in [
            camera_pose(),
            camera_pose().inverse(),
            Pose::new([0.02, 0.3, 0.0].into(), [0.1, 0.0, 0.05].into()),
        ] {
            let both = Rectification::new(&camera(300.0), &camera(310.0), &X).unwrap();
            assert!((both.R_R1 * X.translation.vector - Vector3::x() * both.baseline_m).norm() < 1e-12);
            // The cameras keep their displacement.
            let between = both.R_R1.inverse() * both.R_R2;
            assert!((between.matrix() - X.rotation.to_rotation_matrix().matrix()).norm() < 1e-12);
            for (pair, p) in scene(&X, 20, 4) {
                let (Some(a), Some(b)) = (both.rectified_1(&pair.s_1), both.rectified_2(&pair.s_2)) else {
                    continue;
                };
                assert!((a.y - b.y).abs() < 1e-12);
                if (X.inverse() * p).z > 0.0 {
                    let q = triangulate_parallel(both.baseline_m, &Conjugates { s_1: a, s_2: b }).unwrap();
                    assert!((both.R_R1 * p - q).norm() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn images_show_conjugates_in_one_row() {
        let X = Pose::new([0.1, 0.01, 0.0].into(), [0.02, -0.05, 0.03].into());
        let cameras = [camera(300.0), camera(310.0)];
        let both = Rectification::new(&cameras[0], &cameras[1], &X).unwrap();
        // A bright blob around the image of one point.
        let p = nalgebra::Point3::new(0.02, -0.03, 1.0);
        let blob = |camera: &CameraModel, p: &nalgebra::Point3<f64>| {
            let at = camera.project(p).unwrap();
            let grey = |i: usize| {
                let d = Vector2::new((i % 320) as f64, (i / 320) as f64) - at;
                (200.0 * (-d.norm_squared() / 18.0).exp()) as u8
            };
            (0..320 * 240).map(grey).collect::<Vec<u8>>()
        };
        let images = [blob(&cameras[0], &p), blob(&cameras[1], &(X.inverse() * p))];
        let maps = [both.map_1(&cameras[0]), both.map_2(&cameras[1])];
        let centre = |k: usize| {
            let view = ImageView::new(&images[k], 320, 240).unwrap();
            let mut image = vec![0; 320 * 240];
            maps[k].rectify(&view, &mut image);
            let (mut sum, mut at) = (0.0, Vector2::zeros());
            for (i, x) in image.iter().enumerate() {
                sum += f64::from(*x);
                at += Vector2::new((i % 320) as f64, (i / 320) as f64) * f64::from(*x);
            }
            at / sum
        };
        let (a, b) = (centre(0), centre(1));
        assert!((a.y - b.y).abs() < 0.05, "{a} {b}");
        let depth = both.camera.intrinsics().fx_px * both.baseline_m / (a.x - b.x);
        assert!((depth - (both.R_R1 * p).z).abs() < 0.01, "{depth}");
        assert_eq!(maps[0].size(), (320, 240));
    }

    #[test]
    fn between_pixels() {
        let image = ImageView::new(&[0, 100, 50, 150], 2, 2).unwrap();
        assert_eq!(sample(&image, 0.5, 0.5), Some(75.0));
        assert_eq!(sample(&image, -0.5, 0.0), Some(0.0));
        assert_eq!(sample(&image, 1.5, 1.5), Some(150.0));
        assert_eq!(sample(&image, 1.6, 0.0), None);
        assert_eq!(sample(&image, f64::NAN, 0.0), None);
        let one = ImageView::new(&[7], 1, 1).unwrap();
        assert_eq!(sample(&one, 0.4, -0.4), Some(7.0));
    }

    #[test]
    fn bad_input_is_refused() {
        let c = camera(300.0);
        let run = |X: &Pose| Rectification::new(&c, &c, X).err();
        assert_eq!(run(&Pose::identity()), Some(StereoError::Degenerate));
        assert_eq!(run(&Pose::translation(0.0, 0.0, 1.0)), Some(StereoError::Degenerate));
        assert_eq!(run(&Pose::translation(f64::NAN, 0.0, 1.0)), Some(StereoError::BadGuess));
    }
}
