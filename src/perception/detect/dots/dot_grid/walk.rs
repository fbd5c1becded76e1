//! The lattice around a seed dot, extended from it along two steps, cell by cell.
//!
//! ```text
//! a seed, its ellipse ─► the metric in which it is a circle ─► two steps, there equal and at right angles, most of them also backwards
//!                     ─► cell by cell at the extrapolated positions, dots of a possible size ─► outliers of one homography are left out
//! ```

use super::{Lattice, LatticeDot};
use crate::detect::dots::blob::Blob;
use crate::pose::{Correspondence, homography};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::PI;

/// Cells on each side of the seed. Derived: grids have at most 32 columns and rows, so that any dot may be the seed; some are left for diagonals.
const REACH: i32 = 40;
pub(super) const SIDE: usize = 2 * REACH as usize + 1;
/// Neighbours of a seed among which its steps are chosen: those of a dot amid others in a lattice.
const NEIGHBOURS: usize = 8;
/// Where the seed is a circle, its steps are at right angles and of one length. Perspective, and rims of a few pixels, leave this much:
/// greatest cosine between them, and greatest ratio of their lengths. Chosen by hand: 70 degrees; diagonals make 45 degrees and 1.41, of which
/// sizes tell later. Half loses seeds of small dots. Views on which nothing was tuned test these: `grids_are_found_whatever_lies_around`.
const MAX_COSINE: f64 = 0.35;
const MAX_RATIO: f64 = 1.45;
/// A step is as long as the dots' radii make it, up to this factor; and before they have their own threshold, where blur may take
/// half of the radius of a dot of 2 px. Chosen by hand: a diagonal is just out of the first; twice as wide only takes time.
const STEP_TOLERANCE: f64 = 1.4;
const STEP_TOLERANCE_ROUGH: f64 = 2.0;
/// Length of a step of equal dots, in radii: from dots that touch, which is derived, to dots of a fourteenth, chosen by hand: printed grids have
/// radii of a fifth to a third, and smaller dots in more room are likelier clutter.
const EQUAL_STEPS: (f64, f64) = (2.0, 14.0);
/// Largest distance of a dot from its extrapolated position, in steps: perspective changes one into the next by less. Chosen by hand, with some room
/// to the half of a step, where another dot would be as near; half of it loses tilted grids at a short distance.
const OFF_LATTICE: f64 = 0.28;
/// How far it may lie from its place under the homography of all, in steps. A lens that is not the camera's bends a lattice by about as much.
/// Chosen by hand: half of it breaks such lattices up, twice of it leaves what stood beside the grid by chance.
const OFF_PLANE: f64 = 0.15;
/// Greatest share of the cells that are left out for that; where more would be, the lattice is bent, and stays as it was walked. Chosen by hand:
/// what chance puts beside a grid is a cell here and there; half of it leaves those of a grid amid clutter in.
const MAX_OFF: f64 = 0.3;
/// Greatest logarithm of a region's area over that of the smallest or the largest dot in a cell, as roughly as one step determines it; and again
/// before a dot has its own threshold. Chosen by hand: steps that are off by a quarter in both directions make 0.45, thresholds the rest;
/// half a radius lost is 1.4 of the second, and the rest as before. Sizes are compared with all cells later, so that these only keep time short.
const AREA: f64 = 0.8;
const AREA_ROUGH: f64 = 1.8;

impl Lattice {
    /// The candidates in the undistorted image.
    pub(super) fn place(&mut self, candidates: &[(f64, Blob)]) {
        let undistorted = |b: &Blob| self.camera.normalized_of(&Vector2::new(b.x, b.y)) * self.focal_px;
        self.points.clear();
        self.points.extend(candidates.iter().map(|(_, blob)| undistorted(blob)));
        self.areas.clear();
        self.areas.extend(self.points.iter().zip(candidates).map(|(point, (area, _))| {
            let s = point / self.focal_px;
            area * self.focal_px.powi(2) / self.camera.pixel_jacobian(&s).determinant().abs()
        }));
        self.by_x.clear();
        self.by_x.extend(self.points.iter().zip(0..).map(|(p, i)| (p.x, i)));
        self.by_x.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        self.taken.clear();
        self.taken.resize(self.points.len(), false);
    }

    /// Keeps only those candidates that belong to any lattice, before each gets its own threshold, which takes far longer.
    pub(in crate::detect::dots) fn thin(&mut self, candidates: &mut Vec<(f64, Blob)>) {
        self.rough = true;
        self.place(candidates);
        let mut left = self.max_walked();
        for seed in 0..self.points.len() {
            if left > 0 && self.taken.get(seed) == Some(&false) {
                self.walk(seed, candidates);
                left = left.saturating_sub(self.walked);
            }
        }
        self.rough = false;
        let mut taken = self.taken.iter();
        candidates.retain(|_| taken.next() == Some(&true));
    }

    /// The lattice about a candidate, in `best`; whether there is one with enough cells.
    pub(super) fn walk(&mut self, seed: usize, candidates: &[(f64, Blob)]) -> bool {
        self.walked = 1;
        let Some(steps) = candidates.get(seed).and_then(|(_, blob)| self.steps_at(seed, blob)) else {
            return false;
        };
        self.walk_from(seed, steps);
        std::mem::swap(&mut self.cells, &mut self.best);
        self.walked = self.best.len();
        if self.best.len() < self.least() {
            return false;
        }
        if !self.rough {
            self.straighten();
        }
        for cell in &self.best {
            if let Some(taken) = self.taken.get_mut(cell.candidate) {
                *taken = true;
            }
        }
        self.best.len() >= self.least()
    }

    /// The two steps from a dot to its neighbours in the lattice, the second one clockwise of the first as y_o is of x_o.
    fn steps_at(&self, seed: usize, blob: &Blob) -> Option<[Vector2<f64>; 2]> {
        let from = *self.points.get(seed)?;
        // lengths in radii of the dot: of a uniform ellipse the covariance is a quarter of its axes' squares
        let J = self.camera.pixel_jacobian(&(from / self.focal_px)) / self.focal_px;
        let [xx, xy, yy] = blob.covariance;
        let metric = J.transpose() * Matrix2::new(xx, xy, xy, yy).try_inverse()? * J / 4.0;
        let (low, high) = self.step_radii();
        let reach = high * (metric.m22 / metric.determinant()).sqrt();
        let mut nearest = [(f64::INFINITY, Vector2::zeros()); NEIGHBOURS];
        for (x, i) in self.within(from.x - reach, from.x + reach) {
            let Some(step) = self.points.get(i).map(|point| point - from) else { continue };
            let length = step.dot(&(metric * step));
            if i != seed && length < nearest[NEIGHBOURS - 1].0 && length < high * high && x.is_finite() {
                let at = nearest.partition_point(|(known, _)| *known <= length);
                nearest.get_mut(at..)?.rotate_right(1);
                *nearest.get_mut(at)? = (length, step);
            }
        }
        let there = nearest.iter().take_while(|(length, _)| length.is_finite());
        for (i, (a, first)) in there.clone().enumerate().filter(|(_, (a, _))| *a > low * low) {
            let backwards = |step: &Vector2<f64>| {
                self.nearest(&(from - step), OFF_LATTICE * step.norm(), |_| true).is_some()
            };
            for (b, second) in there.clone().skip(i + 1).take_while(|(b, _)| *b < a * MAX_RATIO.powi(2)) {
                let cosine = first.dot(&(metric * second)) / (a * b).sqrt();
                if cosine.abs() < MAX_COSINE && (backwards(first) || backwards(second)) {
                    return Some(if first.perp(second) > 0.0 {
                        [*first, *second]
                    } else {
                        [*second, *first]
                    });
                }
            }
        }
        None
    }

    /// Least and greatest length of a step in radii of a dot.
    fn step_radii(&self) -> (f64, f64) {
        if self.grid.is_equal() {
            return EQUAL_STEPS;
        }
        let radii = |radius_m: f64| self.grid.pitch_m() / radius_m;
        let tolerance = if self.rough { STEP_TOLERANCE_ROUGH } else { STEP_TOLERANCE };
        (radii(self.grid.large_radius_m()) / tolerance, radii(self.grid.radius_m()) * tolerance)
    }

    /// Extends the lattice cell by cell by the dots at the extrapolated positions.
    fn walk_from(&mut self, seed: usize, steps: [Vector2<f64>; 2]) {
        self.map.fill(0);
        self.cells.clear();
        self.used.clear();
        self.used.resize(self.points.len(), false);
        let area_of = |areas: &[f64], i: usize| areas.get(i).copied().unwrap_or(0.0);
        let area = |radius_m: f64| PI * (radius_m / self.grid.pitch_m()).powi(2);
        let (least, most) = if self.grid.is_equal() {
            let cell = steps[0].perp(&steps[1]);
            (area_of(&self.areas, seed) / cell, area_of(&self.areas, seed) / cell)
        } else {
            (area(self.grid.radius_m()), area(self.grid.large_radius_m()))
        };
        let tolerance = if self.rough { AREA_ROUGH } else { AREA };
        let (least, most) = (least * (-tolerance).exp(), most * tolerance.exp());
        self.put(LatticeDot { at: [0, 0], candidate: seed, steps, area: 0.0, large: false, clear: false });
        let mut next = 0;
        while let Some(cell) = self.cells.get(next).copied() {
            next += 1;
            let Some(from) = self.points.get(cell.candidate).copied() else { break };
            for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
                let mut at = cell.at;
                at[axis] += sign;
                if slot(at).is_none() || self.at(at).is_some() {
                    continue;
                }
                let step = cell.steps[axis] * f64::from(sign);
                let limit = OFF_LATTICE * step.norm().min(cell.steps[1 - axis].norm());
                let spanned = cell.steps[0].perp(&cell.steps[1]);
                // a region is one dot, and stands in one cell
                let may_be = |i: usize| {
                    self.used.get(i) == Some(&false)
                        && (least * spanned..most * spanned).contains(&area_of(&self.areas, i))
                };
                let Some((candidate, point)) = self.nearest(&(from + step), limit, may_be) else { continue };
                let mut steps = cell.steps;
                steps[axis] = (point - from) * f64::from(sign);
                // the other step where its neighbour is known already: perspective bends both
                let mut beside = cell.at;
                beside[1 - axis] += 1;
                let mut corner = at;
                corner[1 - axis] += 1;
                if let (Some(_), Some(corner)) = (self.at(beside), self.at(corner))
                    && let Some(other) = self.points.get(corner.candidate)
                {
                    steps[1 - axis] = other - point;
                }
                self.put(LatticeDot { at, candidate, steps, area: 0.0, large: false, clear: false });
            }
        }
    }

    fn put(&mut self, cell: LatticeDot) {
        if let Some(place) = slot(cell.at).and_then(|i| self.map.get_mut(i))
            && self.cells.len() < self.cells.capacity()
        {
            self.cells.push(cell);
            *place = self.cells.len() as u32;
            if let Some(used) = self.used.get_mut(cell.candidate) {
                *used = true;
            }
        }
    }

    fn at(&self, at: [i32; 2]) -> Option<&LatticeDot> {
        let index = *self.map.get(slot(at)?)?;
        self.cells.get((index as usize).checked_sub(1)?)
    }

    /// Candidates by their x.
    fn within(&self, low: f64, high: f64) -> impl Iterator<Item = (f64, usize)> {
        let from = self.by_x.partition_point(|(x, _)| *x < low);
        self.by_x.iter().skip(from).take_while(move |(x, _)| *x <= high).copied()
    }

    /// The nearest to a place of those that `may_be`.
    fn nearest(
        &self,
        wanted: &Vector2<f64>,
        limit: f64,
        may_be: impl Fn(usize) -> bool,
    ) -> Option<(usize, Vector2<f64>)> {
        let mut best = None;
        let mut least = limit * limit;
        for (_, i) in self.within(wanted.x - limit, wanted.x + limit) {
            let Some(point) = self.points.get(i) else { continue };
            let distance = (point - wanted).norm_squared();
            if distance < least && may_be(i) {
                least = distance;
                best = Some((i, *point));
            }
        }
        best
    }

    /// Leaves out of `best` what lies off the plane's homography, the worst first: what stood beside the grid by chance.
    fn straighten(&mut self) {
        let walked = self.best.len();
        // a homography needs four
        let least = ((1.0 - MAX_OFF) * walked as f64).max(4.0);
        let mut left_out = 0;
        loop {
            let kept = walked - left_out;
            if !self.pairs_of_best(kept) {
                return;
            }
            let Ok(H) = homography(&self.pairs) else { return };
            let off = |(pair, cell): (&Correspondence, &LatticeDot)| {
                let h = H * pair.r.push(1.0);
                let size = cell.steps[0].norm().min(cell.steps[1].norm());
                (h.xy() / h.z - pair.s).norm() * self.focal_px / size
            };
            let offs = self.pairs.iter().zip(&self.best).map(off).enumerate();
            let Some((worst, off)) = offs.max_by(|a, b| a.1.total_cmp(&b.1)) else { return };
            if off < OFF_PLANE {
                self.best.truncate(kept);
                return;
            }
            left_out += 1;
            if ((walked - left_out) as f64) < least {
                return;
            }
            // behind those that stay: it may come back when all do
            self.best.swap(worst, kept - 1);
        }
    }

    /// Cells and places of the first so many of `best`, in `pairs`.
    pub(super) fn pairs_of_best(&mut self, count: usize) -> bool {
        self.pairs.clear();
        for cell in self.best.iter().take(count) {
            let Some(s) = self.points.get(cell.candidate) else { return false };
            let r = Vector2::new(f64::from(cell.at[0]), f64::from(cell.at[1]));
            self.pairs.push(Correspondence { r, s: s / self.focal_px });
        }
        true
    }
}

/// Index of a cell in the map, if it has one.
fn slot([i, j]: [i32; 2]) -> Option<usize> {
    let inside = i.abs() <= REACH && j.abs() <= REACH;
    inside.then(|| (j + REACH) as usize * SIDE + (i + REACH) as usize)
}
