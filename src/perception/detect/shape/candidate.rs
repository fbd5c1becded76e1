//! Candidates: from a region to a first map of the outline onto it.
//!
//! ```text
//! second moments ─► both whitened: equal up to a rotation ─► the rotations with which the extents in all directions agree best
//! ─► affine map ─► homography through nearest border pixels, step by step
//! ```
//! The whitening removes the affine part of the camera's map near the centroid, but for a rotation. Mirror images are not considered.

use super::outline::{DIRECTIONS, ShapeOutline, extents, whitening};
use super::warp::{Projective, Warp};
use crate::camera_model::CameraModel;
use crate::imaging::{Moments, Point};
use crate::linalg::Ldlt;
use crate::pose::{Correspondence, homography};
use nalgebra::{Rotation2, SMatrix, SVector, Vector2};

/// Most border pixels that are used. Chosen by hand: of a border of 2000 px every fourth, which does not change the distance across it;
/// twice as many take twice the time.
const MAX_BORDER: usize = 512;
/// Places along the outline that are held against them. Chosen by hand: sixteen for each of the map's parameters; half leaves short sides with
/// one or two, twice takes twice the time.
const PLACES: u32 = 128;
/// Turns that are tried at most. Chosen by hand: an outline nearly alike in four directions, and one more; each costs an alignment and a fit.
pub(super) const MAX_TURNS: usize = 5;
/// Largest difference of the extents, root mean square over all directions, for whitened regions (whose own are about 2). Chosen by hand: a
/// quarter of them, for perspective; half refuses tilted shapes at a short distance, twice has nearly every region aligned, which takes time.
const EXTENTS_APART: f64 = 0.45;
/// Steps towards the border pixels: with the affine part alone, and of all. Chosen by hand: perspective is not observable before the rest is nearly
/// right; and a bound, since [`ShapeCandidate::settle`] ends when a step gains less than a fiftieth.
const AFFINE_STEPS: usize = 4;
const STEPS: usize = 14;
/// Largest distance of outline and border pixels: px, and share of the region's size. Chosen by hand: pixels lie up to half a pixel off, and as
/// much again by the threshold; the share is for borders that dust or glare dents. Half loses those, twice has other outlines fitted.
const APART_PX: f64 = 1.0;
const APART: f64 = 0.025;

/// Border of a region with its properties. The buffers are reused.
#[derive(Debug, Clone)]
pub(super) struct ShapeCandidate {
    border: Vec<Vector2<f64>>,
    moments: Moments,
    /// Square root of the area, px.
    size_px: f64,
    /// Area within the border, px^2.
    pub(super) area_px2: u64,
    /// Number of distances that were computed since it was set to 0.
    pub(super) work: u64,
}

impl ShapeCandidate {
    pub(super) fn new() -> Self {
        Self {
            border: Vec::with_capacity(MAX_BORDER),
            moments: Moments::default(),
            size_px: 0.0,
            area_px2: 0,
            work: 0,
        }
    }

    /// Sets the region by its moments, its border and the area within it.
    pub(super) fn set(&mut self, moments: &Moments, border: &[Point], area_px2: u64) {
        self.area_px2 = area_px2;
        self.moments = moments.of_squares();
        self.size_px = moments.m00.sqrt();
        self.border.clear();
        let stride = border.len().div_ceil(MAX_BORDER).max(1);
        let places = border.iter().step_by(stride).take(MAX_BORDER);
        self.border.extend(places.map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))));
    }

    /// Largest distance between a border and the aligned outline, px.
    pub(super) fn reach_px(&self) -> f64 {
        APART_PX + APART * self.size_px
    }

    /// The rotations (rad) with which outline and region agree, the best first. Returns their number, and the difference of the extents.
    pub(super) fn turns(&self, outline: &ShapeOutline, turns: &mut [f64; MAX_TURNS]) -> (usize, f64) {
        let none = (0, f64::INFINITY);
        let m = &self.moments;
        let Some(white) = whitening([m.mu20 / m.m00, m.mu11 / m.m00, m.mu02 / m.m00]) else { return none };
        let centre = Vector2::new(m.x, m.y);
        let seen = extents(self.border.iter().map(|p| white * (p - centre)));
        let apart = |shift: usize| {
            let pairs = outline.extents.iter().zip(seen.iter().cycle().skip(shift));
            (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / DIRECTIONS as f64).sqrt()
        };
        let mut all = [0.0; DIRECTIONS];
        all.iter_mut().enumerate().for_each(|(shift, value)| *value = apart(shift));
        let at = |i: usize| all.get(i % DIRECTIONS).copied().unwrap_or(f64::INFINITY);
        let mut best = [(f64::INFINITY, 0.0); MAX_TURNS];
        for i in 0..DIRECTIONS {
            let value = at(i);
            let lowest = value <= at(i + 1) && value < at(i + DIRECTIONS - 1);
            if lowest
                && value < EXTENTS_APART
                && let Some(last) = best.last_mut()
                && value < last.0
            {
                *last = (value, std::f64::consts::TAU * i as f64 / DIRECTIONS as f64);
                best.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            }
        }
        turns.iter_mut().zip(best).for_each(|(turn, (_, angle))| *turn = angle);
        (
            best.iter().filter(|(value, _)| value.is_finite()).count(),
            best.first().map_or(f64::INFINITY, |b| b.0),
        )
    }

    /// The homography that maps the rotated outline onto the region's border; `None` where none does.
    pub(super) fn settle(
        &mut self,
        camera: &CameraModel,
        outline: &ShapeOutline,
        turn: f64,
    ) -> Option<Projective> {
        let m = &self.moments;
        let colour = whitening([m.mu20 / m.m00, m.mu11 / m.m00, m.mu02 / m.m00])?.try_inverse()?;
        let affine = colour * Rotation2::new(turn) * whitening(outline.spread)?;
        let centre = Vector2::new(m.x, m.y);
        let pair = |x: f64, y: f64| {
            let r = Vector2::new(x, y);
            Correspondence { r, s: camera.normalized_of(&(affine * r + centre)) }
        };
        let mut warp = by_points(&[pair(-1.0, -1.0), pair(1.0, -1.0), pair(1.0, 1.0), pair(-1.0, 1.0)])?;
        let mut apart_px = f64::INFINITY;
        for step in 0..STEPS {
            self.work += u64::from(PLACES) * self.border.len() as u64;
            let (next, rms_px) = self.step(camera, outline, &warp, step < AFFINE_STEPS)?;
            // chosen by hand: the fit to the edges that follows needs no more than a pixel
            let settled = step > AFFINE_STEPS && rms_px > 0.98 * apart_px;
            (warp, apart_px) = (next, rms_px);
            if settled {
                break;
            }
        }
        (apart_px < self.reach_px()).then_some(warp)
    }

    /// One step towards the nearest border pixels. Returns their root mean square distance, px.
    fn step(
        &self,
        camera: &CameraModel,
        outline: &ShapeOutline,
        warp: &Projective,
        affine: bool,
    ) -> Option<(Projective, f64)> {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        let mut squares = 0.0;
        for i in 0..PLACES {
            let (u, t) = outline.at(outline.length() * (f64::from(i) + 0.5) / f64::from(PLACES));
            let s = warp.at(&u);
            let px = camera.pixel_of(&s);
            let derivative = camera.pixel_jacobian(&s) * warp.derivative(&u);
            // direction of the outline in the image
            let along = camera.pixel_of(&warp.at(&(u + t * 1e-4))) - px;
            let outward = Vector2::new(along.y, -along.x) / along.norm().max(f64::MIN_POSITIVE);
            let away = |p: &&Vector2<f64>| (*p - px).norm_squared();
            let nearest = self.border.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
            // border pixels lie half a pixel inside
            let off = (nearest - px).dot(&outward) + 0.5;
            squares += off * off;
            let row = derivative.transpose() * outward;
            normal += row * row.transpose();
            right += row * off;
        }
        // the border determines the perspective parameters least: they are damped
        let held = normal.trace() * if affine { 1e3 } else { 1e-9 };
        normal[(6, 6)] += held;
        normal[(7, 7)] += held;
        let step = SVector::<f64, 8>::from(Ldlt::of(&normal)?.solve(&right.data.0[0]));
        let next = Projective::of(warp.parameters() + step);
        next.is_plausible(1.0).then_some((next, (squares / f64::from(PLACES)).sqrt()))
    }
}

/// The homography through four points or more, in the outline's coordinates.
pub(super) fn by_points(pairs: &[Correspondence]) -> Option<Projective> {
    let H = homography(pairs).ok()?;
    let scale = 1.0 / H.m33;
    let p = [H.m11, H.m12, H.m13, H.m21, H.m22, H.m23, H.m31, H.m32].map(|h| h * scale);
    let warp = Projective(SVector::from(p));
    warp.is_plausible(1.0).then_some(warp)
}
