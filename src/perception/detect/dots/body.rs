//! Identification of the dots of a body: which region is which dot, by the pose of the body that explains most of them.
//!
//! ```text
//! three regions as three dots ─► do sizes and distances allow it? ─► up to four poses (P3P) ─► dots turned to the camera, tilted as their ellipses are?
//!                             ─► all regions near a dot of this pose ─► least squares ─► the assignment with most dots, where no other has as many
//! ```
//! Dots have one size, so that the size of an ellipse tells how far away it is, to some percent: what lies further apart in depth than the body is large
//! belongs to something else.

use super::blob::Blob;
use super::offset::centre_offset;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::messages::TargetStatus;
use crate::pose::{Correspondence3, p3p, refine_3d};
use crate::target::{Disc, DotBody};
use nalgebra::{Point3, Vector2, Vector3};

/// Most regions among which the body is looked for. Chosen by hand: a body shows half of its dots, 12 of 24, and as many other regions are 2 024 choices of three.
pub(super) const MAX_BODY_CANDIDATES: usize = 24;
/// Assignments that are kept. Chosen by hand: an image with more of them is ambiguous.
const MAX_FITS: usize = 32;
/// Each region is taken together with so many of those nearest to it, two at a time. Chosen by hand: two of four are the body's also where as much lies between its dots as
/// there are dots.
const NEIGHBOURS: usize = 4;
/// Choices of three regions that are tried in all ways once an assignment stands, to see whether another one is as good. Chosen by hand: of a rival that explains nearly all
/// regions each choice shows it, of one that explains half of them one in eight.
const CHOICES_WITH_FIT: usize = 12;
/// Poses of three dots that one look for the body may compute, as a bound on time: some 18 ms of a core. Measured: a cube with 17 dots, of which 5 to 11 are in view, takes
/// 4 400 in the median and 22 600 at most (`dots_are_told_apart_from_all_around`).
const MAX_POSES: usize = 30_000;
/// How far off all depths together may be that follow from the sizes of ellipses, as share. Chosen by hand: a threshold 0.4 px off the rims of dots of 5 px radius is 8 % of them.
const DEPTH_SHARE: f64 = 0.12;
/// How far off one depth may be beside that, as share: so much, and so many pixels over the longer half axis. Derived: 20 degrees off the axis of the camera an ellipse is longer by up
/// to 6 %, those of one body by 2 % against each other; the pixels were chosen by hand, three deviations of the size of a region.
const SIZE_SHARE: f64 = 0.02;
const SIZE_PX: f64 = 0.3;
/// The same of the ratio of the axes. Derived: those 6 %, and what a threshold half a pixel off makes of a short axis.
const RATIO_SHARE: f64 = 0.06;
const RATIO_PX: f64 = 0.5;
/// Least cosine of the tilt of a dot that can be seen. Derived: a flatter region is not taken for a dot (`MIN_AXIS_RATIO` of `blob.rs`).
const LEAST_COSINE: f64 = 0.2;
/// Distance from a dot of a pose of three within which a region is taken for it, px. Chosen by hand: three centres that are 0.3 px off put a fourth one off by some px.
const NEAR_PX: f64 = 4.0;
/// The same after least squares. Chosen by hand: regions are then as far off as their thresholds and the lens make them, twice [`MAX_RMS_PX`] and more.
const FITTED_PX: f64 = 2.0;
/// Greatest root mean square distance of regions from the dots of their pose, px. Chosen by hand: regions are off by 0.1 to 0.3 px, a lens by some tenths.
const MAX_RMS_PX: f64 = 0.7;
/// Least share of the dots turned to the camera that are to be found. Chosen by hand: some of them may be covered; where half of them may be, five of eight or nine regions of another
/// body are an assignment by chance more often.
const MIN_SHARE: f64 = 0.6;
/// Another assignment of as many dots is as good unless its residual is so many times larger. Chosen by hand: residuals of five dots, four numbers, vary by half.
const CLEARLY: f64 = 3.0;

/// What no region is assigned to.
const NONE: u8 = u8::MAX;

/// A dot of the body.
#[derive(Debug, Clone, Copy)]
struct BodyDot {
    p_O: Point3<f64>,
    inward: Vector3<f64>,
    X_OF: Pose,
    disc: Disc,
}

/// Two dots of the body.
#[derive(Debug, Clone, Copy)]
struct DotPair {
    /// Squared distance, m^2.
    apart2: f64,
    /// Angle between the normals of their faces, rad.
    angle: f64,
}

/// A region, with what follows from it alone.
#[derive(Debug, Clone, Copy)]
struct BodyCandidate {
    px: Vector2<f64>,
    s: Vector2<f64>,
    /// Longer half axis, normalized, and the shorter over the longer one.
    axis: f64,
    ratio: f64,
    /// How far that may be off.
    ratio_off: f64,
    /// The least and the greatest angle of its normal to the line of sight by that ratio, rad.
    tilt: [f64; 2],
    depth_m: f64,
    depth_off_m: f64,
}

/// Which dot each region is, and how well that fits.
#[derive(Debug, Clone, Copy)]
struct Assignment {
    dots: [u8; MAX_BODY_CANDIDATES],
    count: usize,
    rms_px: f64,
}

impl Assignment {
    /// Whether one region is different dots in both, or one dot different regions.
    fn contradicts(&self, other: &Self) -> bool {
        let pairs = || self.dots.iter().zip(&other.dots);
        pairs().any(|(a, b)| a != b && *a != NONE && *b != NONE)
            || pairs().any(|(a, b)| a != b && *a != NONE && other.dots.contains(a) && *b == NONE)
    }
}

/// Identifies the dots of one body. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct BodyDots {
    camera: CameraModel,
    focal_px: f64,
    dots: Box<[BodyDot]>,
    /// Dot `a` and dot `b`, at `a` times their number plus `b`.
    dot_pairs: Box<[DotPair]>,
    /// Greatest distance of two dots, m.
    extent_m: f64,
    seen: Vec<BodyCandidate>,
    /// Choices of three regions that were tried.
    tried: Vec<[usize; 3]>,
    fits: Vec<Assignment>,
    pairs: Vec<Correspondence3>,
}

impl BodyDots {
    pub(super) fn new(camera: CameraModel, body: &DotBody) -> Self {
        let i = camera.intrinsics();
        let of = |(k, point): (usize, &crate::target::TargetPoint)| {
            let (X_OF, disc) = body.dot(k)?;
            Some(BodyDot { p_O: point.p_O, inward: body.inward(k), X_OF, disc })
        };
        let dots: Box<[_]> = body.points().iter().enumerate().filter_map(of).collect();
        let apart = |a: &BodyDot| dots.iter().map(|b| (b.p_O - a.p_O).norm()).fold(0.0, f64::max);
        let extent_m = dots.iter().map(apart).fold(0.0, f64::max);
        let pair = |a: &BodyDot, b: &BodyDot| DotPair {
            apart2: (a.p_O - b.p_O).norm_squared(),
            angle: a.inward.angle(&b.inward),
        };
        let dot_pairs = dots.iter().flat_map(|a| dots.iter().map(|b| pair(a, b))).collect();
        Self {
            camera,
            focal_px: (i.fx_px * i.fy_px).sqrt(),
            dots,
            dot_pairs,
            extent_m,
            seen: Vec::with_capacity(MAX_BODY_CANDIDATES),
            tried: Vec::with_capacity(MAX_BODY_CANDIDATES * NEIGHBOURS * (NEIGHBOURS - 1) / 2),
            fits: Vec::with_capacity(MAX_FITS),
            pairs: Vec::with_capacity(MAX_BODY_CANDIDATES),
        }
    }

    /// The regions that are dots of the body, with their ids, rising.
    ///
    /// # Errors
    /// The status that says why there is no target.
    pub(super) fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        let candidates = candidates.get(..MAX_BODY_CANDIDATES).unwrap_or(candidates);
        self.take(candidates.iter().map(|(_, blob)| blob));
        let complete = self.assign_all();
        let better =
            |a: &&Assignment, b: &&Assignment| a.count.cmp(&b.count).then(b.rms_px.total_cmp(&a.rms_px));
        let Some(best) = self.fits.iter().max_by(better) else { return Err(TargetStatus::NoMatch) };
        let as_good = |other: &Assignment| {
            other.count >= best.count && other.rms_px < CLEARLY * best.rms_px && other.contradicts(best)
        };
        if !complete || self.fits.len() == MAX_FITS || self.fits.iter().any(as_good) {
            return Err(TargetStatus::Ambiguous);
        }
        chosen.clear();
        let found = candidates.iter().zip(best.dots).filter(|(_, dot)| *dot != NONE);
        chosen.extend(found.map(|((_, blob), dot)| (u32::from(dot), *blob)));
        chosen.sort_unstable_by_key(|(id, _)| *id);
        Ok(())
    }

    /// Whether tracked regions can be the body's: one pose explains them.
    pub(super) fn confirm(&mut self, found: &[(u32, Blob)]) -> bool {
        if found.len() < 4 || found.len() > MAX_BODY_CANDIDATES {
            return false;
        }
        self.take(found.iter().map(|(_, blob)| blob));
        let mut dots = [NONE; MAX_BODY_CANDIDATES];
        for (dot, (id, _)) in dots.iter_mut().zip(found) {
            *dot = u8::try_from(*id).unwrap_or(NONE);
        }
        // Three that lie far apart: of three in a row nothing follows.
        let count = found.len();
        let triples =
            (0..count).flat_map(|i| (i + 1..count).flat_map(move |j| (j + 1..count).map(move |k| [i, j, k])));
        let area = |triple: &[usize; 3]| {
            let [a, b, c] = triple.map(|i| self.seen.get(i).map_or_else(Vector2::zeros, |seen| seen.s));
            (b - a).perp(&(c - a)).abs()
        };
        let Some(widest) = triples.max_by(|a, b| area(a).total_cmp(&area(b))) else { return false };
        let Some(start) = self.triple(widest, widest.map(|i| dots.get(i).map_or(0, |dot| usize::from(*dot))))
        else {
            return false;
        };
        let Ok(poses) = p3p(&start) else { return false };
        poses
            .as_slice()
            .iter()
            .any(|X_CO| self.fitted(X_CO, &dots).is_some_and(|(_, rms_px)| rms_px < MAX_RMS_PX))
    }

    fn take<'a>(&mut self, blobs: impl Iterator<Item = &'a Blob>) {
        let (camera, focal_px) = (&self.camera, self.focal_px);
        let radius_m = self.dots.first().map_or(0.0, |dot| dot.disc.radius_m);
        self.seen.clear();
        self.seen.extend(blobs.map(|blob| {
            let px = Vector2::new(blob.x, blob.y);
            let s = camera.normalized_of(&px);
            let (major, minor) = blob.axes();
            // a lens stretches what is far from its axis; chosen by hand, so that where it folds back nothing is divided by zero
            let scale = camera.pixel_jacobian(&s).determinant().abs().sqrt().max(0.1 * focal_px);
            let axis = major / scale;
            let (ratio, ratio_off) = (minor / major, RATIO_SHARE + RATIO_PX / major);
            let tilt = [ratio + ratio_off, ratio - ratio_off].map(|cosine| cosine.clamp(0.0, 1.0).acos());
            let depth_m = radius_m / axis;
            let depth_off_m = (SIZE_SHARE + SIZE_PX / major) * depth_m;
            BodyCandidate { px, s, axis, ratio, ratio_off, tilt, depth_m, depth_off_m }
        }));
    }

    /// The assignments that explain enough dots. Returns whether as many choices of regions were tried as show that no other is as good: a rival explains as many
    /// regions, so that those of nearly every choice are among its own.
    fn assign_all(&mut self) -> bool {
        self.fits.clear();
        self.tried.clear();
        let (mut left, mut with_fit) = (MAX_POSES, 0);
        for seed in 0..self.seen.len() {
            let neighbours = self.neighbours(seed);
            for (n, j) in neighbours.iter().enumerate() {
                for k in neighbours.iter().skip(n + 1) {
                    let mut regions = [seed, *j, *k];
                    regions.sort_unstable();
                    if regions.contains(&usize::MAX)
                        || self.tried.contains(&regions)
                        || !self.are_near_in_depth(regions)
                    {
                        continue;
                    }
                    self.tried.push(regions);
                    self.assign_triple(regions, &mut left);
                    with_fit += usize::from(!self.fits.is_empty());
                    if with_fit >= CHOICES_WITH_FIT {
                        return true;
                    }
                    if left == 0 {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// The regions nearest to a region; [`usize::MAX`] in the places of those that there are not.
    fn neighbours(&self, of: usize) -> [usize; NEIGHBOURS] {
        let mut nearest = [(f64::INFINITY, usize::MAX); NEIGHBOURS];
        let Some(seed) = self.seen.get(of) else { return [usize::MAX; NEIGHBOURS] };
        for (i, other) in self.seen.iter().enumerate().filter(|(i, _)| *i != of) {
            let mut entry = ((other.s - seed.s).norm_squared(), i);
            for place in &mut nearest {
                if entry.0 < place.0 {
                    std::mem::swap(place, &mut entry);
                }
            }
        }
        nearest.map(|(_, i)| i)
    }

    fn are_near_in_depth(&self, regions: [usize; 3]) -> bool {
        let depths = regions.map(|i| self.seen.get(i).map_or(f64::NAN, |seen| seen.depth_m));
        let (least, most) = depths.iter().fold((f64::INFINITY, 0.0f64), |(a, b), z| (a.min(*z), b.max(*z)));
        most * (1.0 - DEPTH_SHARE) - least * (1.0 + DEPTH_SHARE) < self.extent_m
    }

    /// Three regions as any three dots.
    fn assign_triple(&mut self, regions: [usize; 3], left: &mut usize) {
        let count = self.dots.len();
        let [i, j, k] = regions;
        for a in 0..count {
            for b in (0..count).filter(|b| *b != a) {
                if !self.may_be([i, j], [a, b]) {
                    continue;
                }
                for c in (0..count).filter(|c| *c != a && *c != b) {
                    if !self.may_be([i, k], [a, c]) || !self.may_be([j, k], [b, c]) {
                        continue;
                    }
                    let Some(points) = self.triple(regions, [a, b, c]) else { continue };
                    *left = left.saturating_sub(1);
                    let Ok(poses) = p3p(&points) else { continue };
                    for X_CO in poses.as_slice() {
                        let shown = regions.into_iter().zip([a, b, c]);
                        if shown.clone().all(|(region, dot)| self.shows(region, dot, X_CO)) {
                            self.extend(X_CO);
                        }
                    }
                    if *left == 0 {
                        return;
                    }
                }
            }
        }
    }

    fn triple(&self, regions: [usize; 3], dots: [usize; 3]) -> Option<[Correspondence3; 3]> {
        let pair = |n: usize| {
            let (region, dot) = (self.seen.get(*regions.get(n)?)?, self.dots.get(*dots.get(n)?)?);
            Some(Correspondence3 { r: dot.p_O, s: region.s })
        };
        Some([pair(0)?, pair(1)?, pair(2)?])
    }

    /// Whether two regions can be two dots: across the line of sight they are not further apart than these, and along it not further than their sizes tell; and
    /// from the line of sight their normals are as far apart as the tilts of the ellipses allow.
    fn may_be(&self, [i, j]: [usize; 2], [a, b]: [usize; 2]) -> bool {
        let (Some(p), Some(q)) = (self.seen.get(i), self.seen.get(j)) else { return false };
        let count = self.dots.len();
        let Some(DotPair { apart2, angle }) = self.dot_pairs.get(a * count + b) else { return false };
        // The two lines of sight are as far apart as the regions are in the image.
        let between2 = (p.s - q.s).norm_squared();
        let ([p_least, p_most], [q_least, q_most]) = (p.tilt, q.tilt);
        let (least, most) = ((p_least - q_most).max(q_least - p_most), p_most + q_most);
        let turned = between2.sqrt();
        if *angle > most + turned || *angle < least - turned {
            return false;
        }
        let depth_m = 0.5 * (p.depth_m + q.depth_m);
        let across2 = between2 * depth_m * depth_m;
        let along = (p.depth_m - q.depth_m).abs() + p.depth_off_m + q.depth_off_m;
        let more = (1.0 + DEPTH_SHARE) * (1.0 + DEPTH_SHARE);
        across2 < *apart2 * more * more && *apart2 < (across2 + along * along) * more
    }

    /// Whether a region has the size and the tilt of a dot at this pose.
    fn shows(&self, region: usize, dot: usize, X_CO: &Pose) -> bool {
        let (Some(seen), Some(dot)) = (self.seen.get(region), self.dots.get(dot)) else { return false };
        let p = (X_CO * dot.p_O).coords;
        let cosine = (X_CO.rotation * dot.inward).dot(&p) / p.norm();
        cosine > LEAST_COSINE
            && (cosine - seen.ratio).abs() < seen.ratio_off
            && (seen.axis * p.z / dot.disc.radius_m - 1.0).abs() < 2.0 * DEPTH_SHARE
    }

    /// Every region near a dot that this pose shows there, each dot once; and how many dots are turned to the camera within the image.
    fn matched(&self, X_CO: &Pose, within_px: f64) -> (Assignment, usize) {
        let mut found = Assignment { dots: [NONE; MAX_BODY_CANDIDATES], count: 0, rms_px: f64::INFINITY };
        let mut turned = 0;
        for (number, dot) in self.dots.iter().enumerate() {
            let p = X_CO * dot.p_O;
            if (X_CO.rotation * dot.inward).dot(&p.coords) < LEAST_COSINE * p.coords.norm() {
                continue;
            }
            let Some(px) = self.camera.project(&p) else { continue };
            turned += usize::from(self.camera.contains(&px, 0.0));
            let off = |seen: &BodyCandidate| (seen.px - px).norm();
            let free = self.seen.iter().enumerate().filter(|(i, _)| found.dots.get(*i) == Some(&NONE));
            let near =
                free.filter(|(_, seen)| off(seen) < within_px).min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
            if let Some((i, _)) = near
                && self.shows(i, number, X_CO)
                && let Some(place) = found.dots.get_mut(i)
            {
                *place = number as u8;
                found.count += 1;
            }
        }
        (found, turned)
    }

    /// Keeps the assignment that follows from a pose of three dots, where it explains enough.
    fn extend(&mut self, X_CO: &Pose) {
        let enough = |(found, turned): &(Assignment, usize)| {
            found.count >= DotBody::LEAST && found.count as f64 >= MIN_SHARE * *turned as f64
        };
        let first = self.matched(X_CO, NEAR_PX);
        if !enough(&first) || self.is_known(&first.0) {
            return;
        }
        let Some((refined, _)) = self.fitted(X_CO, &first.0.dots) else { return };
        let second = self.matched(&refined, FITTED_PX);
        if !enough(&second) || self.is_known(&second.0) {
            return;
        }
        let Some((_, rms_px)) = self.fitted(&refined, &second.0.dots) else { return };
        if rms_px < MAX_RMS_PX && self.fits.len() < MAX_FITS {
            self.fits.push(Assignment { rms_px, ..second.0 });
        }
    }

    fn is_known(&self, found: &Assignment) -> bool {
        self.fits.iter().any(|known| known.dots == found.dots)
    }

    /// The pose of least squares from `X_CO`, with the offsets of dots' centres at it, and the root mean square residual, px.
    fn fitted(&mut self, X_CO: &Pose, dots: &[u8; MAX_BODY_CANDIDATES]) -> Option<(Pose, f64)> {
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.clear();
        for (seen, dot) in self.seen.iter().zip(dots).filter(|(_, dot)| **dot != NONE) {
            let Some(dot) = self.dots.get(usize::from(*dot)) else { continue };
            let X_CF = X_CO * dot.X_OF;
            let offset = centre_offset(&X_CF, &self.camera, &dot.disc.centre_m, dot.disc.radius_m);
            pairs.push(Correspondence3 { r: dot.p_O, s: self.camera.normalized_of(&(seen.px - offset)) });
        }
        let refined = refine_3d(X_CO, &pairs, 1.0 / self.focal_px);
        self.pairs = pairs;
        refined.ok().map(|refined| (refined.X_CO, refined.rms * self.focal_px))
    }
}
