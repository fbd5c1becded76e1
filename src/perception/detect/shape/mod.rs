//! Free shapes: a polygon or an ellipse, dark on a light plate or light on a dark one, detected by its outline alone.
//!
//! ```text
//! thresholds ─► regions with moments ─► Candidate: whitened, turned, homography through the border's pixels
//!                                          ─► Fitter: homography through sub-pixel edges all along the outline ─► images of the points
//! ```
//! The points of a polygon are its corners, projected by the fitted homography, with the covariance that follows from that of the edges,
//! also where a corner itself is rounded or occluded. Of an ellipse the centre of its image is reported, and the ellipse itself. Positions
//! are pixels of the distorted image.
//!
//! Terms: a *candidate* is a region whose moments may be the outline's; *whitening* is the affine map after which a region spreads alike in all directions;
//! a *warp* is the map from the outline's plane to the image, a homography or that of an ellipse; a *piece* is a short stretch of the
//! outline at which the offset of the edge is measured; the *chance* is the probability of an equally good accidental fit.

mod candidate;
mod chance;
mod corners;
mod distinct;
mod edge;
mod fit;
mod miss;
mod outline;
mod search;
mod warp;

pub use miss::ShapeMiss;

use super::{Detection, PredictedPoint};
use crate::camera_model::CameraModel;
use crate::imaging::{Components, Contours, ImageView, LocalThreshold, Moments, Runs};
use crate::messages::TargetStatus;
use crate::pose::Correspondence;
use crate::target::{Mark, Shape};
use candidate::{ShapeCandidate, by_points};
use fit::{Fitted, Fitter};
use nalgebra::{Matrix2, SMatrix, Vector2};
use outline::ShapeOutline;
use warp::{Oval, Projective, Warp};

/// Most border pixels of all regions of a frame. Chosen by hand: a bound on memory, 8 MB, which only noise all over a large frame reaches.
const MAX_BORDER: usize = 1 << 20;
/// A search reaches so far from the border pixels, px. Chosen by hand: thresholds move borders by a pixel or two in blur; half loses blurred shapes, the double
/// takes in edges of things nearby.
const REACH_PX: f64 = 2.0;
/// Least visible share of the outline, in a search and in tracking. Chosen by hand: a region that is not occluded shows all but what glare or
/// dust takes, and at 0.8 parts of other outlines pass; where the shape is known to be near, a bit more than half is enough, and what is half
/// hidden is tracked (test `what_is_seen_before_is_tracked_also_half_hidden`).
const SEEN: f64 = 0.9;
const SEEN_TRACKED: f64 = 0.6;
/// Largest offset of the edges from the outline, root mean square: px, and share of the root of the area. Chosen by hand: edges are measured
/// to some hundredths of a pixel, but prints and the lens's model may be off by some thousandths of the size. Half refuses those, twice takes
/// other outlines for this one.
const OFF_PX: f64 = 0.15;
const OFF: f64 = 0.002;
/// Largest ratio of the offsets' variance to what noise explains, beyond [`WELL_PX`]. Chosen by hand: offsets four times as large as noise makes
/// them. Without noise the ratio is meaningless, so that offsets as small as [`OFF_PX`] are always good.
const MAX_CHI2: f64 = 15.0;
const WELL_PX: f64 = 0.15;

/// The last fit.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::large_enum_variant)] // of values that live for a frame
enum FittedShape {
    Polygon(Fitted<8, Projective>),
    Ellipse(Fitted<5, Oval>),
}

/// An ellipse in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseSeen {
    /// Centre, px.
    pub centre_px: Vector2<f64>,
    /// Half its axes, the longer first, px.
    pub semi_axes_px: [f64; 2],
    /// From the columns' axis towards the rows' to the longer one, in (-pi/2, pi/2], rad.
    pub turn_rad: f64,
}

/// Finder of one shape. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct ShapeFinder {
    camera: CameraModel,
    outline: ShapeOutline,
    ellipse: bool,
    /// Positions of the points in the object's plane, m.
    points_m: Box<[Vector2<f64>]>,
    light_on_dark: bool,
    runs: Runs,
    components: Components,
    contours: Contours,
    local: LocalThreshold,
    /// Regions that may be the shape: area, index.
    order: Vec<(u64, usize)>,
    /// Number of borders that the current search has aligned to the outline, and whether one of them fits no better than by chance.
    aligned: usize,
    by_chance: bool,
    candidate: ShapeCandidate,
    fitter: Fitter,
    pairs: Vec<Correspondence>,
    seen: Option<FittedShape>,
    covariances: Vec<(u32, [f64; 3])>,
}

impl ShapeFinder {
    /// A finder for frames of `camera` and one shape.
    #[must_use]
    pub fn new(camera: CameraModel, shape: &Shape) -> Self {
        let i = camera.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        let pixels = width.saturating_mul(height);
        let limit = (pixels / 16).clamp(4096, MAX_BORDER);
        let count = shape.points().len();
        Self {
            camera,
            outline: ShapeOutline::of(shape),
            ellipse: !matches!(shape.mark(), Mark::Polygon(_)),
            points_m: shape.points().iter().map(|p| p.p_O.coords.xy()).collect(),
            light_on_dark: !shape.plate().light,
            runs: Runs::with_limit(limit),
            components: Components::with_limit(limit),
            contours: Contours::with_limits(limit, (pixels / 4).clamp(4096, MAX_BORDER)),
            local: LocalThreshold::with_size(width, height),
            order: Vec::with_capacity(search::MAX_CANDIDATES + 1),
            aligned: 0,
            by_chance: false,
            candidate: ShapeCandidate::new(),
            fitter: Fitter::new(),
            pairs: Vec::with_capacity(count),
            seen: None,
            covariances: Vec::with_capacity(count),
        }
    }

    /// Searches the whole frame: fills `found` with the points that lie within it, ids rising.
    ///
    /// # Errors
    /// The status that says why there is no shape; [`Self::search_or_why`] tells more. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        self.search_or_why(image, found).map_err(TargetStatus::from)
    }

    /// As [`Self::search`].
    ///
    /// # Errors
    /// Why there is no shape. `found` is then empty.
    pub fn search_or_why(
        &mut self,
        image: &ImageView<'_>,
        found: &mut Vec<Detection>,
    ) -> Result<(), ShapeMiss> {
        found.clear();
        self.seen = None;
        let i = self.camera.intrinsics();
        if (image.width(), image.height()) != (i.width_px as usize, i.height_px as usize) {
            return Err(ShapeMiss::WrongSize);
        }
        self.seen = Some(self.search_thresholds(image)?);
        self.report(found);
        Ok(())
    }

    /// Tracks the outline from predictions of four or more points (for an ellipse, the last image is shifted with its centre): fills
    /// `found` with the points that lie within the frame. Returns whether it was detected; `found` is empty when not.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedPoint],
        found: &mut Vec<Detection>,
    ) -> bool {
        found.clear();
        let slack_px = expected.iter().map(|e| e.slack_px).fold(0.0, f64::max).clamp(0.0, 40.0) + 1.0;
        let rise = self.rise();
        let before = self.seen.take();
        self.seen = if self.ellipse {
            expected.first().and_then(|e| {
                let Some(FittedShape::Ellipse(before)) = before else { return None };
                let mut start = before.warp;
                let centre = self.camera.normalized_of(&e.px);
                start.0.fixed_rows_mut::<2>(0).copy_from(&centre);
                let fitter = &mut self.fitter;
                fitter
                    .fit(image, &self.camera, &self.outline, start, slack_px, rise)
                    .map(FittedShape::Ellipse)
            })
        } else {
            self.pairs.clear();
            for e in expected {
                let Some(place) = self.points_m.get(e.id as usize) else { continue };
                let r = self.outline.of_plane(place);
                self.pairs.push(Correspondence { r, s: self.camera.normalized_of(&e.px) });
            }
            by_points(&self.pairs).and_then(|start| {
                let fitter = &mut self.fitter;
                fitter
                    .fit(image, &self.camera, &self.outline, start, slack_px, rise)
                    .map(FittedShape::Polygon)
            })
        };
        self.seen = self.seen.filter(|seen| self.is_good(seen, SEEN_TRACKED));
        if self.seen.is_none() {
            return false;
        }
        self.report(found);
        !found.is_empty()
    }

    /// Covariance `[xx, xy, yy]` of each point of the last frame, px^2, ids rising. The points of one frame are correlated: all follow from
    /// one homography.
    #[must_use]
    pub fn covariances_px2(&self) -> &[(u32, [f64; 3])] {
        &self.covariances
    }

    /// The ellipse of the last frame, where the target is an ellipse; for a lens with distortion, the ellipse that approximates its image about the
    /// centre.
    #[must_use]
    pub fn ellipse(&self) -> Option<EllipseSeen> {
        let seen = self.seen.as_ref().filter(|_| self.ellipse)?;
        let a = self.about_centre(seen);
        // [xx, xy, yy] of a point uniform in it is a quarter of the squared axes
        let spread = a * a.transpose();
        let m =
            Moments { mu20: spread.m11, mu11: spread.m12, mu02: spread.m22, m00: 1.0, ..Moments::default() };
        let p = m.principal();
        Some(EllipseSeen {
            centre_px: self.image_of(seen, &Vector2::zeros()),
            semi_axes_px: [p.greater.sqrt(), p.smaller.sqrt()],
            turn_rad: p.angle_rad,
        })
    }

    /// Blur of the outline in the last frame: standard deviation, the pixel's own included, px.
    #[must_use]
    pub fn blur_px(&self) -> Option<f64> {
        self.seen.as_ref().map(|seen| match seen {
            FittedShape::Polygon(fitted) => fitted.blur_px,
            FittedShape::Ellipse(fitted) => fitted.blur_px,
        })
    }

    /// 1 where the surroundings are lighter than the shape, -1 where they are darker.
    fn rise(&self) -> f64 {
        if self.light_on_dark { -1.0 } else { 1.0 }
    }

    fn image_of(&self, seen: &FittedShape, u: &Vector2<f64>) -> Vector2<f64> {
        self.camera.pixel_of(&match seen {
            FittedShape::Polygon(fitted) => fitted.warp.at(u),
            FittedShape::Ellipse(fitted) => fitted.warp.at(u),
        })
    }

    /// Derivative of the image (px) by the outline's coordinates at its centroid, 2 x 2.
    fn about_centre(&self, seen: &FittedShape) -> Matrix2<f64> {
        let small = 1e-4;
        let along = |u: Vector2<f64>| {
            (self.image_of(seen, &(u * small)) - self.image_of(seen, &(u * -small))) / (2.0 * small)
        };
        Matrix2::from_columns(&[along(Vector2::x()), along(Vector2::y())])
    }

    /// Whether a fit is acceptable: at least the share `least` of the outline is visible, and offsets and misfit are small.
    fn is_good(&self, seen: &FittedShape, least: f64) -> bool {
        let (share, rms_px, chi2) = match seen {
            FittedShape::Polygon(f) => (f.share, f.rms_px, f.chi2),
            FittedShape::Ellipse(f) => (f.share, f.rms_px, f.chi2),
        };
        let size_px = (self.outline.area * self.about_centre(seen).determinant().abs()).sqrt();
        share >= least && rms_px <= OFF_PX + OFF * size_px && (rms_px < WELL_PX || chi2 < MAX_CHI2)
    }

    fn report(&mut self, found: &mut Vec<Detection>) {
        self.covariances.clear();
        let Some(seen) = self.seen else { return };
        let about = self.about_centre(&seen);
        let [xx, xy, yy] = self.outline.spread;
        let spread = about * Matrix2::new(xx, xy, xy, yy) * about.transpose();
        let area_px2 = self.outline.area * about.determinant().abs();
        let levels = match &seen {
            FittedShape::Polygon(fitted) => fitted.levels,
            FittedShape::Ellipse(fitted) => fitted.levels,
        };
        for (id, u) in (0..).zip(&self.outline.points) {
            let (px, covariance) = match &seen {
                FittedShape::Polygon(fitted) => self.point(fitted, u),
                FittedShape::Ellipse(fitted) => self.point(fitted, u),
            };
            if !self.camera.contains(&px, 0.0) {
                continue;
            }
            self.covariances.push((id, [covariance.m11, covariance.m12, covariance.m22]));
            found.push(Detection {
                id,
                px,
                sd_px: (0.5 * covariance.trace()).sqrt(),
                area_px2,
                covariance_px2: [spread.m11, spread.m12, spread.m22],
                dark_level: levels[0].min(levels[1]),
                plate_level: levels[0].max(levels[1]),
                disturbance_px: 0.0,
            });
        }
    }

    /// Image of a point and its covariance, px^2.
    fn point<const N: usize, W: Warp<N>>(
        &self,
        fitted: &Fitted<N, W>,
        u: &Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>) {
        let s = fitted.warp.at(u);
        let row: SMatrix<f64, 2, N> = self.camera.pixel_jacobian(&s) * fitted.warp.derivative(u);
        (self.camera.pixel_of(&s), row * fitted.covariance * row.transpose())
    }
}
