//! Identification of the four dots: which four regions are the target, and which of them is P1.
//!
//! Four regions in convex order can be P1..P4 in four orders; the image is assumed not to be mirrored, and a chiral target must fit better
//! than its mirror image. Each order gives a homography of the square (closed form), which predicts every dot's ellipse in pixels
//! without a free scale. The best order is accepted where it fits at every dot, and clearly better than each other order. The
//! homography of a true pose has orthogonal first columns of equal length, which most accidental quadrilaterals have not.

use super::blob::Blob;
use super::offset::disc_moments;
use super::turns::Turns;
use super::unit_square::{ORTHOGONALITY, ORTHOGONALITY_OF_UNKNOWN_LENS, UnitSquare};
use crate::camera_model::CameraModel;
use crate::messages::TargetStatus;
use crate::target::FourDots;
use nalgebra::{Matrix2, Vector2};

/// Most regions among which the target is looked for. Chosen by hand: 1820 choices of four; twice as many regions make 20 times as many choices,
/// half as many leave out a target among five larger things.
pub(super) const MAX_CANDIDATES: usize = 16;
/// Choices that may fit. Chosen by hand: an image with more of them is ambiguous.
const MAX_FITS: usize = 64;
/// Greatest error of shape, or of the area's logarithm, at which a dot still fits. Chosen by hand: the square through four centres is a little off
/// where dots are tilted, and a threshold moves rims; half of it loses views of 70 degrees, twice of it lets clutter be P1.
const TOLERANCE: f64 = 0.35;
/// What a rim that is ragged or thresholded off its middle may add, for a dot of 1 px radius. Derived: a rim 0.4 px off changes the logarithm of
/// an area by twice that over the radius.
const TOLERANCE_SMALL_PX: f64 = 0.8;

/// Four regions taken for P1..P4.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FourDotsFit {
    /// Regions in the order P1..P4.
    blobs: [Blob; 4],
    /// Mean error of area and shape; 0 is perfect.
    error: f64,
}

/// Result for a choice of four regions.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Choice {
    Fits(FourDotsFit),
    /// Forms the square, but more than one corner may be P1; with the error of the best order.
    Ambiguous(f64),
    No,
}

/// A region with the quantities that do not depend on the other three.
#[derive(Debug, Clone, Copy)]
struct DotCandidate {
    blob: Blob,
    /// Normalized coordinates, and the pixels' derivative by these.
    s: Vector2<f64>,
    J: Matrix2<f64>,
    /// Greatest error of shape, or of the area's logarithm, at which it still fits.
    tolerance: f64,
}

/// Identifies the target among quadrilaterals. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Square {
    camera: CameraModel,
    side: f64,
    /// Logarithms of the dots' squared radii, P1 to P4.
    log_radii2: [f64; 4],
    /// The same of its mirror image, where that looks different.
    mirrored: Option<[f64; 4]>,
    /// By how much the error of the second-best order must be larger.
    margin: f64,
    /// By how much a view of the square may differ from one.
    orthogonality: f64,
    seen: Vec<DotCandidate>,
    turns: Turns,
}

impl Square {
    pub(super) fn new(camera: CameraModel, target: &FourDots) -> Self {
        let radii = target.radii_m();
        let [first, second, third, fourth] = radii;
        let chiral = !target.symmetry().mirrored;
        // the wrong corner, or the mirror image, is off by ln (R1/R)^2 at two of four dots, or more
        let ratio = if chiral { (first / second).min(second / third) } else { first / second };
        let margin = 0.4 * ratio.ln();
        let logs = |radii: [f64; 4]| radii.map(|r| 2.0 * r.ln());
        Self {
            camera,
            side: target.side_m(),
            log_radii2: logs(radii),
            mirrored: chiral.then(|| logs([first, fourth, third, second])),
            margin,
            orthogonality: ORTHOGONALITY,
            seen: Vec::with_capacity(MAX_CANDIDATES),
            turns: Turns::with_limit(MAX_CANDIDATES),
        }
    }

    /// The same where the lens is not known.
    pub(super) fn for_unknown_lens(self) -> Self {
        Self { orthogonality: ORTHOGONALITY_OF_UNKNOWN_LENS, ..self }
    }

    /// The four regions that are the target, with their ids: the best of all choices of four candidates.
    ///
    /// # Errors
    /// The status that says why there is no target.
    pub(super) fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        let fit = self.best_choice(candidates)?;
        chosen.clear();
        chosen.extend((0..).zip(fit.blobs));
        Ok(())
    }

    /// Whether tracked regions can be the target: all four must fit the square; three have too little redundancy for a check.
    pub(super) fn confirm(&self, found: &[(u32, Blob)]) -> bool {
        match found {
            [(_, a), (_, b), (_, c), (_, d)] => self.fits(&[*a, *b, *c, *d]),
            _ => found.len() == 3,
        }
    }

    /// The best of all choices of four candidates.
    fn best_choice(&mut self, candidates: &[(f64, Blob)]) -> Result<FourDotsFit, TargetStatus> {
        if candidates.len() < 4 {
            return Err(TargetStatus::TooFewRegions);
        }
        let mut seen = std::mem::take(&mut self.seen);
        seen.clear();
        seen.extend(candidates.iter().take(MAX_CANDIDATES).map(|(_, blob)| self.seen(blob)));
        self.turns.set(seen.iter().map(|seen| (seen.blob.x, seen.blob.y)));
        let result = self.best_of(&seen);
        self.seen = seen;
        result
    }

    fn best_of(&self, seen: &[DotCandidate]) -> Result<FourDotsFit, TargetStatus> {
        let mut tally = Tally::default();
        for (i, first) in seen.iter().enumerate() {
            // areas are sorted; no tilt makes one dot 40 times another
            let end = seen.partition_point(|other| other.blob.area * 40.0 >= first.blob.area);
            for j in i + 1..end {
                for k in j + 1..end {
                    for l in k + 1..end {
                        let which = [i, j, k, l];
                        let Some(order) = self.turns.convex_order(which) else { continue };
                        let [Some(a), Some(b), Some(c), Some(d)] = order.map(|at| seen.get(at)) else {
                            continue;
                        };
                        tally.add(self.choose([a, b, c, d]), which)?;
                    }
                }
            }
        }
        tally.result()
    }

    fn seen(&self, blob: &Blob) -> DotCandidate {
        let s = self.camera.normalized_of(&Vector2::new(blob.x, blob.y));
        let minor = (blob.area / std::f64::consts::PI).sqrt().min(blob.axes().1);
        let tolerance = TOLERANCE + TOLERANCE_SMALL_PX / minor.max(1.0);
        DotCandidate { blob: *blob, s, J: self.camera.pixel_jacobian(&s), tolerance }
    }

    /// Looks for P1..P4 in four regions in convex order.
    fn choose(&self, seen: [&DotCandidate; 4]) -> Choice {
        let Some(view) = self.view(&seen) else { return Choice::No };
        // most choices end here: a square of dots without a larger one among them fits loosely
        if !(0..4).any(|first| self.has_sizes(&view, &seen, first, 5.0 * self.margin)) {
            return Choice::No;
        }
        let Some(shapes) = view.shape_errors(&seen) else { return Choice::No };
        let (mut best, mut second) = (None::<(f64, usize, bool)>, f64::INFINITY);
        let mut reflection = f64::INFINITY;
        for first in 0..4 {
            let (mut mean, mut fits) = (0.0, true);
            for (((log, radius), shape), seen) in way(&self.log_radii2, &view, first).zip(shapes).zip(seen) {
                let error = (log - radius).abs();
                mean += 0.25 * (error + 0.5 * shape);
                fits &= error < seen.tolerance;
            }
            if let Some(radii) = &self.mirrored {
                let errors = way(radii, &view, first).zip(shapes);
                let mean =
                    errors.map(|((log, radius), shape)| 0.25 * ((log - radius).abs() + 0.5 * shape)).sum();
                reflection = reflection.min(mean);
            }
            match best {
                Some((known, ..)) if mean >= known => second = second.min(mean),
                _ => {
                    second = best.map_or(second, |(known, ..)| known);
                    best = Some((mean, first, fits));
                }
            }
        }
        match best {
            Some((error, first, true)) if second.min(reflection) > error + self.margin => {
                let mut blobs = seen.map(|seen| seen.blob);
                blobs.rotate_left(first);
                Choice::Fits(FourDotsFit { blobs, error })
            }
            Some((error, ..)) => Choice::Ambiguous(error),
            None => Choice::No,
        }
    }

    /// Whether regions in the order P1..P4 fit that order.
    fn fits(&self, blobs: &[Blob; 4]) -> bool {
        let seen = blobs.each_ref().map(|blob| self.seen(blob));
        let seen = seen.each_ref();
        self.view(&seen)
            .is_some_and(|view| self.has_sizes(&view, &seen, 0, 0.0) && view.shape_errors(&seen).is_some())
    }

    /// The view of the square with these regions as corners; `None` when they are no image of a square.
    fn view(&self, seen: &[&DotCandidate; 4]) -> Option<SquareView> {
        let H = UnitSquare::to(&seen.map(|seen| seen.s));
        let H = H.filter(|H| H.is_view_of_a_square(self.orthogonality))?;
        let mut view = SquareView { covariances: [[0.0; 3]; 4], areas: [0.0; 4], logs: [0.0; 4] };
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let dots = view.covariances.iter_mut().zip(&mut view.areas).zip(&mut view.logs);
        for ((((covariance, area), log), seen), corner) in dots.zip(seen).zip(corners) {
            let A = seen.J * H.jacobian(&seen.s, corner)? / self.side;
            (*covariance, *area) = disc_moments(&A, 1.0);
            *log = (seen.blob.area / *area).ln();
        }
        Some(view)
    }

    /// Whether the areas are those of the dots where P1 is the region `first`; `loose` is added to the tolerance.
    fn has_sizes(&self, view: &SquareView, seen: &[&DotCandidate; 4], first: usize, loose: f64) -> bool {
        // NaN does not fit
        way(&self.log_radii2, view, first)
            .zip(seen)
            .all(|((log, radius), seen)| (log - radius).abs() < seen.tolerance + loose)
    }
}

/// The areas of the regions and those of dots of such radii, as logarithms, where P1 is the region `first`.
fn way(log_radii2: &[f64; 4], view: &SquareView, first: usize) -> impl Iterator<Item = (f64, f64)> {
    let mut radii = *log_radii2;
    radii.rotate_right(first);
    view.logs.into_iter().zip(radii)
}

/// Predicted ellipses of dots of radius 1 m at the corners of the square.
#[derive(Debug, Clone, Copy)]
struct SquareView {
    covariances: [[f64; 3]; 4],
    areas: [f64; 4],
    /// Logarithm of the regions' areas over these.
    logs: [f64; 4],
}

impl SquareView {
    /// Errors of the regions' shapes, whatever the size of their dots; `None` when one is so far off that it cannot be a dot.
    fn shape_errors(&self, seen: &[&DotCandidate; 4]) -> Option<[f64; 4]> {
        let mut out = [0.0; 4];
        let dots = self.covariances.iter().zip(&self.areas);
        for (((c, area), seen), out) in dots.zip(seen).zip(&mut out) {
            // both ellipses at unit area
            let (scale, shape) = (area / seen.blob.area, seen.blob.covariance);
            let d = [shape[0] * scale - c[0], shape[1] * scale - c[1], shape[2] * scale - c[2]];
            let norm2 = |m: &[f64; 3]| m[0] * m[0] + 2.0 * m[1] * m[1] + m[2] * m[2];
            *out = (norm2(&d) / norm2(c)).sqrt();
            // NaN does not fit
            if !(*out < seen.tolerance) {
                return None;
            }
        }
        Some(out)
    }
}

/// Collects the choices that fit.
#[derive(Debug, Clone)]
struct Tally {
    /// The best of them, and its regions as bits.
    best: Option<(FourDotsFit, u32)>,
    second: f64,
    unclear: f64,
    fits: [u32; MAX_FITS],
    count: usize,
}

impl Default for Tally {
    fn default() -> Self {
        Self { best: None, second: f64::INFINITY, unclear: f64::INFINITY, fits: [0; MAX_FITS], count: 0 }
    }
}

impl Tally {
    /// # Errors
    /// `Ambiguous` when too many fit.
    fn add(&mut self, choice: Choice, regions: [usize; 4]) -> Result<(), TargetStatus> {
        let fit = match choice {
            Choice::Fits(fit) => fit,
            Choice::Ambiguous(error) => {
                self.unclear = self.unclear.min(error);
                return Ok(());
            }
            Choice::No => return Ok(()),
        };
        let which = regions.iter().fold(0, |bits, at| bits | 1 << at);
        match self.best {
            Some((known, _)) if fit.error >= known.error => self.second = self.second.min(fit.error),
            _ => {
                self.second = self.best.map_or(self.second, |(known, _)| self.second.min(known.error));
                self.best = Some((fit, which));
            }
        }
        let Some(slot) = self.fits.get_mut(self.count) else { return Err(TargetStatus::Ambiguous) };
        *slot = which;
        self.count += 1;
        Ok(())
    }

    fn result(&self) -> Result<FourDotsFit, TargetStatus> {
        match self.best {
            // two targets in view, or clutter that passes for one. Chosen by hand: a true view errs by some hundredths, the best of chance by tenths
            Some((fit, _)) if self.second.min(self.unclear) < 1.5 * fit.error + 0.05 => {
                Err(TargetStatus::Ambiguous)
            }
            // however different in size and sharpness: no dot of the one belongs to the other
            Some((_, which)) if self.fits.iter().take(self.count).any(|other| other & which == 0) => {
                Err(TargetStatus::Ambiguous)
            }
            Some((fit, _)) => Ok(fit),
            None if self.unclear.is_finite() => Err(TargetStatus::Ambiguous),
            None => Err(TargetStatus::NoMatch),
        }
    }
}
