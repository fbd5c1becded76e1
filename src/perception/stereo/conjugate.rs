//! The conjugate of a point, searched along its epipolar line by correlation, Sect. 10.4.1.
//!
//! The line is walked by the depth of the point, so that it bends with both lenses: at each depth a window around the point of
//! image 1 is compared with one around its place in image 2 (zero-mean normalized cross-correlation). The best place is refined
//! between the steps.

use super::rectification::sample;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use nalgebra::{Point3, Vector2};
use thiserror::Error;

/// Most places that one search looks at, so that its memory is bounded. Chosen: two a pixel of a row of 4096.
const MAX_PLACES: usize = 8192;
/// Greatest half width of the window, px. Chosen by hand: 961 pixels; time grows with them, and over so wide a window depth is hardly one.
const MAX_RADIUS_PX: usize = 15;
const MAX_WINDOW: usize = (2 * MAX_RADIUS_PX + 1) * (2 * MAX_RADIUS_PX + 1);

/// Where to look, and what counts as found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConjugateSettings {
    /// The window covers `2 r + 1` pixels each way; 1 to 15.
    pub radius_px: usize,
    /// Least depth in camera 1, m.
    pub nearest_m: f64,
    /// Greatest depth in camera 1, m; may be infinite.
    pub farthest_m: f64,
    /// Least correlation, 0 to 1.
    pub min_correlation: f64,
    /// A second place farther than the window's radius from the best, whose correlation comes as close to it as this,
    /// makes the match ambiguous.
    pub margin: f64,
}

impl Default for ConjugateSettings {
    fn default() -> Self {
        Self { radius_px: 5, nearest_m: 0.1, farthest_m: f64::INFINITY, min_correlation: 0.8, margin: 0.02 }
    }
}

/// A conjugate point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conjugate {
    /// In image 2, px, on the epipolar line.
    pub px: Vector2<f64>,
    /// Correlation of the windows, at most 1.
    pub correlation: f64,
    /// Depth in camera 1 that it stands for, m.
    pub depth_m: f64,
}

/// Why there is no conjugate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum NoConjugate {
    /// The settings are out of their bounds, or a number is not finite.
    #[error(
        "conjugate: radius 1 to 15 px, 0 < nearest < farthest, correlations from 0 to 1, a point inside image 1"
    )]
    BadSettings,
    /// The window leaves image 1, or has no texture.
    #[error("conjugate: the window around the point leaves the image or has no texture")]
    NoTexture,
    /// The epipolar line does not cross image 2 between the depths.
    #[error("conjugate: the epipolar line is not in image 2 between the depths given")]
    OutOfView,
    /// Nothing on the line looks like the point.
    #[error("conjugate: nothing on the epipolar line looks like the point")]
    NotFound,
    /// Two places on the line look like the point.
    #[error("conjugate: several places on the epipolar line look like the point")]
    Ambiguous,
}

/// Owns the windows; made once and reused.
#[derive(Debug, Clone)]
pub struct ConjugateSearch {
    window: Vec<f64>,
    /// Inverse depth, place, correlation of each place looked at.
    places: Vec<(f64, Vector2<f64>, f64)>,
}

impl Default for ConjugateSearch {
    fn default() -> Self {
        Self { window: Vec::with_capacity(MAX_WINDOW), places: Vec::with_capacity(MAX_PLACES) }
    }
}

/// Both cameras and their images.
#[derive(Debug, Clone, Copy)]
struct Views<'a> {
    camera_2: &'a CameraModel,
    image_2: &'a ImageView<'a>,
    X_21: Pose,
    /// The point's direction in camera 1.
    s_1: Vector2<f64>,
}

impl Views<'_> {
    /// Image 2 of the point at the inverse depth.
    fn place(&self, inverse_depth: f64) -> Option<Vector2<f64>> {
        // p / |depth| keeps its direction down to an inverse depth of zero.
        let p = self.X_21.rotation * self.s_1.push(1.0) + self.X_21.translation.vector * inverse_depth;
        self.camera_2.project(&Point3::from(p)).filter(|px| self.camera_2.contains(px, 0.0))
    }
}

impl ConjugateSearch {
    /// The conjugate in image 2 of the pixel `px_1` of image 1; `X_12` is camera 2 in camera 1.
    ///
    /// # Errors
    /// [`NoConjugate`] says why there is none.
    #[allow(clippy::too_many_arguments)] // two views of two things each
    pub fn search(
        &mut self,
        (camera_1, image_1): (&CameraModel, &ImageView<'_>),
        (camera_2, image_2): (&CameraModel, &ImageView<'_>),
        X_12: &Pose,
        px_1: &Vector2<f64>,
        settings: &ConjugateSettings,
    ) -> Result<Conjugate, NoConjugate> {
        let usable = (1..=MAX_RADIUS_PX).contains(&settings.radius_px)
            && settings.nearest_m > 0.0
            && settings.farthest_m > settings.nearest_m
            && (0.0..=1.0).contains(&settings.min_correlation)
            && settings.margin >= 0.0
            && camera_1.contains(px_1, 0.0)
            && X_12.translation.vector.iter().chain(X_12.rotation.coords.iter()).all(|x| x.is_finite());
        if !usable {
            return Err(NoConjugate::BadSettings);
        }
        self.window.clear();
        if !cut(image_1, px_1, settings.radius_px, &mut self.window) {
            return Err(NoConjugate::NoTexture);
        }
        let views = Views { camera_2, image_2, X_21: X_12.inverse(), s_1: camera_1.normalized_of(px_1) };
        self.walk(&views, settings);
        if self.places.is_empty() {
            return Err(NoConjugate::OutOfView);
        }
        let best = (0..self.places.len()).max_by(|&a, &b| self.places[a].2.total_cmp(&self.places[b].2));
        let best = best.unwrap_or(0);
        let (_, at, correlation) = self.places[best];
        if !(correlation >= settings.min_correlation - 0.1) {
            return Err(NoConjugate::NotFound);
        }
        let apart = settings.radius_px as f64;
        let rival = |place: &&(f64, Vector2<f64>, f64)| {
            place.2 > correlation - settings.margin && (place.1 - at).norm() > apart
        };
        if self.places.iter().any(|place| rival(&place)) {
            return Err(NoConjugate::Ambiguous);
        }
        let found = self.refined(&views, best, settings);
        if found.correlation >= settings.min_correlation { Ok(found) } else { Err(NoConjugate::NotFound) }
    }

    /// Looks at places at most a pixel apart.
    fn walk(&mut self, views: &Views<'_>, settings: &ConjugateSettings) {
        self.places.clear();
        let (from, to) = (1.0 / settings.farthest_m, 1.0 / settings.nearest_m);
        // The longest step in the image over a coarse walk tells how fine inverse depth has to be cut.
        let coarse = 256;
        let at = |k: usize, n: usize| from + (to - from) * k as f64 / n as f64;
        let mut longest = 0.0_f64;
        let mut last: Option<Vector2<f64>> = None;
        for k in 0..=coarse {
            let place = views.place(at(k, coarse));
            if let (Some(a), Some(b)) = (last, place) {
                longest = longest.max((b - a).norm());
            }
            last = place;
        }
        let steps = ((coarse as f64 * longest.max(1.0)).ceil() as usize).min(MAX_PLACES - 1);
        let mut before: Option<Vector2<f64>> = None;
        for k in 0..=steps {
            let Some(px) = views.place(at(k, steps)) else { continue };
            if before.is_some_and(|before| (before - px).norm() < 0.5) {
                continue;
            }
            if let Some(correlation) = self.correlation(views.image_2, &px, settings.radius_px) {
                self.places.push((at(k, steps), px, correlation));
                before = Some(px);
            }
        }
    }

    /// The greatest correlation between the neighbours of a place, by parabolas through three ever nearer places.
    fn refined(&self, views: &Views<'_>, best: usize, settings: &ConjugateSettings) -> Conjugate {
        let (mut middle, mut px, mut correlation) = self.places[best];
        // places are at most a pixel apart: further away is a gap, and would be no neighbour
        let neighbour = |i: usize| self.places.get(i).filter(|n| (n.1 - px).norm() < 3.0).map(|n| n.0);
        let gaps = [best.checked_sub(1).and_then(neighbour), neighbour(best + 1)];
        let mut step = gaps.iter().flatten().map(|n| (n - middle).abs()).fold(0.0, f64::max);
        let look = |inverse_depth: f64| {
            let px = views.place(inverse_depth)?;
            Some((px, self.correlation(views.image_2, &px, settings.radius_px)?))
        };
        for _ in 0..6 {
            let (Some(left), Some(right)) = (look(middle - step), look(middle + step)) else { break };
            let bend = left.1 - 2.0 * correlation + right.1;
            let shift = if bend < 0.0 { 0.5 * (left.1 - right.1) / bend } else { 0.0 };
            let next = middle + step * shift.clamp(-1.0, 1.0);
            let Some(there) = look(next) else { break };
            if there.1 >= correlation {
                (middle, px, correlation) = (next, there.0, there.1);
            }
            step *= 0.5;
        }
        Conjugate { px, correlation, depth_m: 1.0 / middle }
    }

    /// Correlation of the window with one of image 2, which need not have texture.
    fn correlation(&self, image: &ImageView<'_>, px: &Vector2<f64>, radius_px: usize) -> Option<f64> {
        let r = radius_px as f64;
        let (mut sum, mut squares, mut product) = (0.0, 0.0, 0.0);
        let side = 2 * radius_px + 1;
        for (k, a) in self.window.iter().enumerate() {
            let b = sample(image, px.x + (k % side) as f64 - r, px.y + (k / side) as f64 - r)?;
            sum += b;
            squares += b * b;
            product += a * b;
        }
        let spread = squares - sum * sum / self.window.len() as f64;
        // The window has zero mean and unit length. An even patch, whose levels differ by rounding, must not be like anything.
        Some(if spread > 1e-6 { product / spread.sqrt() } else { 0.0 })
    }
}

/// The window around `px`, with zero mean and unit length; false when it leaves the image or is even.
fn cut(image: &ImageView<'_>, px: &Vector2<f64>, radius_px: usize, window: &mut Vec<f64>) -> bool {
    let r = radius_px as f64;
    let side = 2 * radius_px + 1;
    for k in 0..side * side {
        match sample(image, px.x + (k % side) as f64 - r, px.y + (k / side) as f64 - r) {
            Some(x) => window.push(x),
            None => return false,
        }
    }
    let mean = window.iter().sum::<f64>() / window.len() as f64;
    let spread: f64 = window.iter().map(|x| (x - mean) * (x - mean)).sum();
    // A standard deviation of one grey level.
    if !(spread > window.len() as f64) {
        return false;
    }
    let over = 1.0 / spread.sqrt();
    for x in window.iter_mut() {
        *x = (*x - mean) * over;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};

    fn camera(k1: f64) -> CameraModel {
        let intrinsics = Intrinsics {
            fx_px: 300.0,
            fy_px: 300.0,
            cx_px: 160.0,
            cy_px: 120.0,
            width_px: 320,
            height_px: 240,
        };
        CameraModel::new(intrinsics, Distortion { k1, ..Distortion::default() }).unwrap()
    }

    fn X_12() -> Pose {
        Pose::new([0.1, 0.01, 0.0].into(), [0.0, -0.05, 0.01].into())
    }

    /// A plane at z = 1 m in frame 1 with a pattern of waves that does not repeat, as a camera at `X_1C` sees it.
    fn image(camera: &CameraModel, X_1C: &Pose) -> Vec<u8> {
        let grey = |i: usize| {
            let s = camera.normalized_of(&Vector2::new((i % 320) as f64, (i / 320) as f64));
            let ray = X_1C.rotation * s.push(1.0);
            let o = X_1C.translation.vector;
            let p = o + ray * ((1.0 - o.z) / ray.z);
            let waves = (60.0 * p.x + 11.0 * p.y).sin()
                + (37.0 * p.y - 23.0 * p.x + 7.0 * p.x * p.x).sin()
                + (91.0 * p.x * p.y + 29.0 * p.y).sin();
            (128.0 + 40.0 * waves) as u8
        };
        (0..320 * 240).map(grey).collect()
    }

    #[test]
    fn conjugates_come_to_a_small_part_of_a_pixel() {
        let (c1, c2) = (camera(-0.1), camera(0.05));
        let (a, b) = (image(&c1, &Pose::identity()), image(&c2, &X_12()));
        let (a, b) = (ImageView::new(&a, 320, 240).unwrap(), ImageView::new(&b, 320, 240).unwrap());
        let mut search = ConjugateSearch::default();
        let settings = ConjugateSettings { nearest_m: 0.4, farthest_m: 4.0, ..ConjugateSettings::default() };
        let (mut found, mut worst, mut squares) = (0, 0.0_f64, 0.0);
        for k in 0..60 {
            let px_1 = Vector2::new(60.0 + 3.3 * f64::from(k), 40.0 + 37.7 * f64::from(k % 5));
            let s = c1.normalized_of(&px_1);
            let p = Point3::new(s.x, s.y, 1.0);
            let truth = c2.project(&(X_12().inverse() * p)).filter(|px| c2.contains(px, 8.0));
            let result = search.search((&c1, &a), (&c2, &b), &X_12(), &px_1, &settings);
            if let (Some(truth), Ok(conjugate)) = (truth, result) {
                found += 1;
                worst = worst.max((conjugate.px - truth).norm());
                squares += (conjugate.px - truth).norm_squared();
                assert!((conjugate.depth_m - 1.0).abs() < 0.03, "{conjugate:?}");
            }
        }
        let rms = (squares / f64::from(found)).sqrt();
        assert!(found > 35 && worst < 0.3 && rms < 0.1, "{found} found, worst {worst}, rms {rms}");
    }

    #[test]
    fn reasons() {
        let c = camera(0.0);
        let flat = vec![100; 320 * 240];
        let stripes: Vec<u8> = (0..320 * 240).map(|i| if (i / 8) % 2 == 0 { 50 } else { 200 }).collect();
        let waves = image(&c, &Pose::identity());
        let view = |pixels| ImageView::new(pixels, 320, 240).unwrap();
        let (flat, stripes, waves) = (view(&flat), view(&stripes), view(&waves));
        let mut search = ConjugateSearch::default();
        let mut run =
            |a: &ImageView<'_>, b: &ImageView<'_>, px: [f64; 2], X: &Pose, settings: &ConjugateSettings| {
                search.search((&c, a), (&c, b), X, &Vector2::from(px), settings).map(|_| ())
            };
        let side = Pose::translation(0.1, 0.0, 0.0);
        let plain = ConjugateSettings { nearest_m: 0.5, ..ConjugateSettings::default() };
        assert_eq!(run(&flat, &flat, [150.0, 100.0], &side, &plain), Err(NoConjugate::NoTexture));
        assert_eq!(run(&waves, &waves, [1.0, 1.0], &side, &plain), Err(NoConjugate::NoTexture));
        assert_eq!(run(&waves, &flat, [150.0, 100.0], &side, &plain), Err(NoConjugate::NotFound));
        assert_eq!(run(&stripes, &stripes, [150.0, 100.0], &side, &plain), Err(NoConjugate::Ambiguous));
        let away = Pose::new([0.1, 0.0, 0.0].into(), [0.0, 2.0, 0.0].into());
        assert_eq!(run(&waves, &waves, [150.0, 100.0], &away, &plain), Err(NoConjugate::OutOfView));
        let bad = ConjugateSettings { radius_px: 0, ..plain };
        assert_eq!(run(&waves, &waves, [150.0, 100.0], &side, &bad), Err(NoConjugate::BadSettings));
        assert_eq!(run(&waves, &waves, [f64::NAN, 0.0], &side, &plain), Err(NoConjugate::BadSettings));
    }
}
