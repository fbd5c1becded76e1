//! Which four regions are the target, and which of them is P1.
//!
//! Four regions in convex order can be P1..P4 in four ways: the picture is not thought to be mirrored. A chiral target must fit better
//! than its mirror image does in each of these ways. Each way gives a
//! homography of the square (closed form), and that predicts every dot's ellipse, in pixels, without any free scale.
//! The way that fits best is taken: it must fit at every dot, and clearly better than each other way, whether that fits or
//! not. A true pose's homography has orthogonal first columns of equal length,
//! which most chance quadrilaterals have not.

use super::blob::Blob;
use super::offset::disc_moments;
use crate::camera_model::CameraModel;
use crate::messages::TargetStatus;
use crate::target::FourDots;
use nalgebra::{Matrix2, Vector2};

/// Most regions among which the target is looked for: 1820 choices of four.
pub(super) const MOST_CANDIDATES: usize = 16;
/// Choices that may fit; more of them are no clear picture.
const MOST_FITS: usize = 64;
/// Greatest error of shape, or of the area's logarithm, at which a dot still fits.
const TOLERANCE: f64 = 0.35;
/// What a rim that is ragged or thresholded off its middle may add, for a dot of 1 px radius.
const TOLERANCE_SMALL_PX: f64 = 0.8;
/// Greatest difference from orthogonal columns of equal length.
const ORTHOGONALITY: f64 = 0.35;

/// Four regions taken for P1..P4.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fit {
    /// Regions in the order P1..P4.
    blobs: [Blob; 4],
    /// Mean error of area and shape; 0 is perfect.
    error: f64,
}

/// What a choice of four regions is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Choice {
    Fits(Fit),
    /// Forms the square, but more than one corner may be P1; with the error of the best way.
    Ambiguous(f64),
    No,
}

/// Tells targets from other quadrilaterals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Square {
    camera: CameraModel,
    side: f64,
    radii: [f64; 4],
    /// Those of the mirror image, where that looks different.
    mirrored: Option<[f64; 4]>,
    /// By how much the second-best way must be worse.
    margin: f64,
}

impl Square {
    pub(super) fn new(camera: CameraModel, target: &FourDots) -> Self {
        let radii = target.radii_m();
        let [first, second, third, fourth] = radii;
        let mirrored = (!target.symmetry().mirrored).then_some([first, fourth, third, second]);
        // the wrong corner, or the mirror image, is off by ln (R1/R)^2 at two of four dots, or more
        let ratio = if mirrored.is_some() { (first / second).min(second / third) } else { first / second };
        let margin = 0.4 * ratio.ln();
        Self { camera, side: target.side_m(), radii, mirrored, margin }
    }

    /// The four regions that are the target, with their ids: the best of all choices of four candidates.
    ///
    /// # Errors
    /// The status that says why there is no target.
    pub(super) fn find(
        &self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        let fit = self.best_choice(candidates)?;
        chosen.clear();
        chosen.extend((0..).zip(fit.blobs));
        Ok(())
    }

    /// Whether regions that were found where the dots were expected can be those: all four must fit each other; three say too
    /// little about each other, so that they only need to be there.
    pub(super) fn confirm(&self, found: &[(u32, Blob)]) -> bool {
        match found {
            [(_, a), (_, b), (_, c), (_, d)] => self.fits(&[*a, *b, *c, *d]),
            _ => found.len() == 3,
        }
    }

    /// The best of all choices of four candidates.
    fn best_choice(&self, candidates: &[(f64, Blob)]) -> Result<Fit, TargetStatus> {
        if candidates.len() < 4 {
            return Err(TargetStatus::TooFewRegions);
        }
        let mut best: Option<(Fit, u32)> = None;
        let mut second = f64::INFINITY;
        let mut unclear = f64::INFINITY;
        let (mut fits, mut fit_count) = ([0u32; MOST_FITS], 0);
        for (i, (_, a)) in candidates.iter().enumerate() {
            for (j, (_, b)) in candidates.iter().enumerate().skip(i + 1) {
                for (k, (_, c)) in candidates.iter().enumerate().skip(j + 1) {
                    for (l, (_, d)) in candidates.iter().enumerate().skip(k + 1) {
                        // areas are sorted; no tilt makes one dot 40 times another
                        if d.area * 40.0 < a.area {
                            break;
                        }
                        let which = 1 << i | 1 << j | 1 << k | 1 << l;
                        match self.choose(&[*a, *b, *c, *d]) {
                            Choice::Fits(fit) => {
                                match best {
                                    Some((known, _)) if fit.error >= known.error => {
                                        second = second.min(fit.error)
                                    }
                                    _ => {
                                        second = best.map_or(second, |(known, _)| second.min(known.error));
                                        best = Some((fit, which));
                                    }
                                }
                                let Some(slot) = fits.get_mut(fit_count) else {
                                    return Err(TargetStatus::Ambiguous);
                                };
                                *slot = which;
                                fit_count += 1;
                            }
                            Choice::Ambiguous(error) => unclear = unclear.min(error),
                            Choice::No => {}
                        }
                    }
                }
            }
        }
        match best {
            // two targets in view, or clutter that passes for one
            Some((fit, _)) if second.min(unclear) < 1.5 * fit.error + 0.05 => Err(TargetStatus::Ambiguous),
            // however different in size and sharpness: no dot of the one belongs to the other
            Some((_, which)) if fits.iter().take(fit_count).any(|other| other & which == 0) => {
                Err(TargetStatus::Ambiguous)
            }
            Some((fit, _)) => Ok(fit),
            None if unclear.is_finite() => Err(TargetStatus::Ambiguous),
            None => Err(TargetStatus::NoMatch),
        }
    }

    /// Looks for P1..P4 in four regions of any order.
    fn choose(&self, blobs: &[Blob; 4]) -> Choice {
        let Some(blobs) = convex_order(blobs) else { return Choice::No };
        let s = blobs.map(|b| self.camera.normalized_of(&Vector2::new(b.x, b.y)));
        if !UnitSquare::to(&s).is_some_and(|H| H.is_view_of_a_square()) {
            return Choice::No;
        }
        let ways = [0, 1, 2, 3].map(|first| {
            let (mut turned, mut points) = (blobs, s);
            turned.rotate_left(first);
            points.rotate_left(first);
            (turned, points)
        });
        // most choices end here: a square of dots without a larger one among them fits loosely
        if !ways.iter().any(|(blobs, s)| self.misfit(blobs, s, (&self.radii, 5.0 * self.margin)).is_some()) {
            return Choice::No;
        }
        let mut best: Option<Fit> = None;
        let (mut second, mut best_fits) = (f64::INFINITY, false);
        let mut reflection = f64::INFINITY;
        for (blobs, s) in &ways {
            let Some(misfit) = self.misfit(blobs, s, (&self.radii, f64::INFINITY)) else { continue };
            let mirrored = self.mirrored.and_then(|radii| self.misfit(blobs, s, (&radii, f64::INFINITY)));
            reflection = mirrored.map_or(reflection, |mirrored| reflection.min(mirrored.mean));
            match best {
                Some(fit) if misfit.mean >= fit.error => second = second.min(misfit.mean),
                _ => {
                    second = best.map_or(second, |fit| fit.error);
                    best = Some(Fit { blobs: *blobs, error: misfit.mean });
                    best_fits = misfit.beyond < 0.0;
                }
            }
        }
        match best {
            Some(fit) if best_fits && second.min(reflection) > fit.error + self.margin => Choice::Fits(fit),
            Some(fit) => Choice::Ambiguous(fit.error),
            None => Choice::No,
        }
    }

    /// Whether regions that are said to be P1..P4 fit that order.
    fn fits(&self, blobs: &[Blob; 4]) -> bool {
        let s = blobs.map(|b| self.camera.normalized_of(&Vector2::new(b.x, b.y)));
        UnitSquare::to(&s).is_some_and(|H| H.is_view_of_a_square())
            && self.misfit(blobs, &s, (&self.radii, 0.0)).is_some()
    }

    /// How far regions in this order are from the dots that it predicts; `None` when one is so far that it cannot be that
    /// dot. `loose` is added to the tolerance of areas.
    fn misfit(
        &self,
        blobs: &[Blob; 4],
        s: &[Vector2<f64>; 4],
        (radii, loose): (&[f64; 4], f64),
    ) -> Option<Misfit> {
        let H = UnitSquare::to(s)?;
        let mut out = Misfit { mean: 0.0, beyond: f64::NEG_INFINITY };
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        for (((blob, s), corner), radius) in blobs.iter().zip(s).zip(corners).zip(radii) {
            let A = self.camera.pixel_jacobian(s) * H.jacobian(s, corner)? / self.side;
            let (c, area) = disc_moments(&A, *radius);
            let area_error = (blob.area / area).ln().abs();
            // the shape alone: both ellipses at unit area
            let (scale, seen) = (area / blob.area, blob.covariance);
            let d = [seen[0] * scale - c[0], seen[1] * scale - c[1], seen[2] * scale - c[2]];
            let norm2 = |m: &[f64; 3]| m[0] * m[0] + 2.0 * m[1] * m[1] + m[2] * m[2];
            let shape_error = (norm2(&d) / norm2(&c)).sqrt();
            let minor = (blob.area / std::f64::consts::PI).sqrt().min(blob.axes().1);
            let tolerance = TOLERANCE + TOLERANCE_SMALL_PX / minor.max(1.0);
            // NaN does not fit
            if !(area_error < tolerance + loose && (shape_error < tolerance || loose.is_infinite())) {
                return None;
            }
            out.beyond = out.beyond.max(area_error.max(shape_error) - tolerance);
            out.mean += 0.25 * (area_error + 0.5 * shape_error);
        }
        Some(out)
    }
}

/// How far four regions in one order are from the dots that it predicts.
#[derive(Debug, Clone, Copy)]
struct Misfit {
    /// Mean error of area and shape.
    mean: f64,
    /// The greatest error, of an area or a shape, less what is tolerated: below 0 every dot fits.
    beyond: f64,
}

/// Homography of the unit square (0,0), (1,0), (1,1), (0,1) to a convex quadrilateral:
/// `x = (a u + b v + c) / w`, `y = (d u + e v + f) / w`, `w = g u + h v + 1`.
struct UnitSquare {
    a: f64,
    b: f64,
    d: f64,
    e: f64,
    g: f64,
    h: f64,
}

impl UnitSquare {
    fn to([p0, p1, p2, p3]: &[Vector2<f64>; 4]) -> Option<Self> {
        let (d1, d2, sum) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
        let den = d1.x * d2.y - d2.x * d1.y;
        if den == 0.0 {
            return None;
        }
        let g = (sum.x * d2.y - d2.x * sum.y) / den;
        let h = (d1.x * sum.y - sum.x * d1.y) / den;
        Some(Self {
            a: p1.x - p0.x + g * p1.x,
            b: p3.x - p0.x + h * p3.x,
            d: p1.y - p0.y + g * p1.y,
            e: p3.y - p0.y + h * p3.y,
            g,
            h,
        })
    }

    /// Of `[r1 r2 p]` the first two columns are orthogonal and of equal length.
    fn is_view_of_a_square(&self) -> bool {
        let (n1, n2) = (
            self.a * self.a + self.d * self.d + self.g * self.g,
            self.b * self.b + self.e * self.e + self.h * self.h,
        );
        let dot = self.a * self.b + self.d * self.e + self.g * self.h;
        dot * dot < ORTHOGONALITY * ORTHOGONALITY * n1 * n2 && (n1 / n2).ln().abs() < 2.0 * ORTHOGONALITY
    }

    /// Derivative of the image point `s` by the unit square's coordinates, at a corner.
    fn jacobian(&self, s: &Vector2<f64>, (u, v): (f64, f64)) -> Option<Matrix2<f64>> {
        let w = self.g * u + self.h * v + 1.0;
        let m = Matrix2::new(
            self.a - s.x * self.g,
            self.b - s.x * self.h,
            self.d - s.y * self.g,
            self.e - s.y * self.h,
        );
        (w > 1e-9).then(|| m / w)
    }
}

/// The regions in the order in which a walk around them meets them, x towards y; `None` when they are not the corners
/// of a convex quadrilateral.
fn convex_order(blobs: &[Blob; 4]) -> Option<[Blob; 4]> {
    let mut out = *blobs;
    let (cx, cy) = (0.25 * out.iter().map(|b| b.x).sum::<f64>(), 0.25 * out.iter().map(|b| b.y).sum::<f64>());
    // grows with the angle, from -2 to 2
    let turn = |b: &Blob| {
        let (x, y) = (b.x - cx, b.y - cy);
        let t = x / (x.abs() + y.abs());
        if y < 0.0 { t - 1.0 } else { 1.0 - t }
    };
    out.sort_unstable_by(|a, b| turn(a).total_cmp(&turn(b)));
    let [a, b, c, d] = &out;
    let cross = |p: &Blob, q: &Blob, r: &Blob| (q.x - p.x) * (r.y - q.y) - (q.y - p.y) * (r.x - q.x);
    let convex = cross(a, b, c) > 0.0 && cross(b, c, d) > 0.0 && cross(c, d, a) > 0.0 && cross(d, a, b) > 0.0;
    convex.then_some(out)
}
