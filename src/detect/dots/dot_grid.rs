//! Which regions are which dots of a grid, also where a part of it is hidden.
//!
//! ```text
//! regions ─► lattice: from a seed along two steps, cell by cell ─► homography of the cells ─► large or small
//!         ─► of all ways to lay what is seen into the grid the one in which all sizes agree
//! ```
//! Steps that are short in the picture need not be the grid's own: a tilted grid may be walked along a diagonal. That is
//! put right when sizes are compared. The picture is never mirrored.
//!
//! Equal dots are a grid when they are all there; of the ways in which it looks the same the upright one is taken.

mod lay;

use super::blob::Blob;
use crate::camera_model::CameraModel;
use crate::messages::TargetStatus;
use crate::pose::{Correspondence, homography};
use crate::target::DotGrid;
use nalgebra::{Matrix2, Matrix3, Vector2};

/// Cells on each side of the seed.
const REACH: i32 = 40;
const SIDE: usize = 2 * REACH as usize + 1;
/// Seeds that are tried.
const SEEDS: usize = 8;
/// Neighbours of a seed among which its steps are chosen.
const NEIGHBOURS: usize = 8;
/// Least sine of the angle between two steps.
const LEAST_SINE: f64 = 0.3;
/// How far a dot may lie from where the lattice goes on, in steps.
const OFF_LATTICE: f64 = 0.28;
/// Greatest logarithm of a dot's area over that which its cell calls for.
const AREA_TOLERANCE: f64 = 0.42;
/// Least share of the cells whose dots have a dot's size.
const LEAST_CLEAR: f64 = 0.7;
/// So many more dots than those of a window tell the place also where they do not form one.
const MORE: usize = 3;
/// A dot seen in a cell of the lattice.
#[derive(Debug, Clone, Copy)]
struct Cell {
    at: [i32; 2],
    candidate: usize,
    /// The steps at this place, px of the undistorted picture.
    steps: [Vector2<f64>; 2],
    /// Of the dot, in cells.
    area: f64,
    large: bool,
    /// Whether its size is that of a dot at all.
    clear: bool,
}

/// Tells the dots of one grid. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    camera: CameraModel,
    grid: DotGrid,
    /// Mean focal length, px.
    focal_px: f64,
    /// Candidates in the undistorted picture, px.
    points: Vec<Vector2<f64>>,
    taken: Vec<bool>,
    cells: Vec<Cell>,
    best: Vec<Cell>,
    /// Index in `cells` + 1 of the dot in each cell.
    map: Vec<u32>,
    pairs: Vec<Correspondence>,
    present: Vec<bool>,
    /// Of a grid of equal dots found last: their radius, m.
    radius_m: Option<f64>,
}

impl Lattice {
    /// For at most `most` candidates.
    pub(super) fn new(camera: CameraModel, grid: &DotGrid, most: usize) -> Self {
        let i = camera.intrinsics();
        Self {
            camera,
            grid: grid.clone(),
            focal_px: (i.fx_px * i.fy_px).sqrt(),
            points: Vec::with_capacity(most),
            taken: Vec::with_capacity(most),
            cells: Vec::with_capacity(most),
            best: Vec::with_capacity(most),
            map: vec![0; SIDE * SIDE],
            pairs: Vec::with_capacity(most),
            present: vec![false; grid.points().len()],
            radius_m: None,
        }
    }

    /// Fewest dots that tell which part of the grid they are.
    pub(super) fn least(&self) -> usize {
        self.grid.least_to_find()
    }

    /// The dots' radius, m, where the target does not say it: as it was found last.
    pub(super) fn told_radius_m(&self) -> Option<f64> {
        self.radius_m
    }

    /// Whether dots found where they were expected can be the grid: enough of them, not all in one row or column.
    pub(super) fn confirm(&self, found: &[(u32, Blob)]) -> bool {
        let place = |id: u32| (id as usize % self.grid.columns(), id as usize / self.grid.columns());
        let Some(first) = found.first().map(|(id, _)| place(*id)) else { return false };
        let others =
            |axis: fn((usize, usize)) -> usize| found.iter().any(|(id, _)| axis(place(*id)) != axis(first));
        found.len() >= 5 && others(|p| p.0) && others(|p| p.1)
    }

    /// The regions that are dots of the grid, with their ids, rising.
    pub(super) fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        chosen.clear();
        self.points.clear();
        let undistorted = |b: &Blob| self.camera.normalized_of(&Vector2::new(b.x, b.y)) * self.focal_px;
        self.points.extend(candidates.iter().map(|(_, blob)| undistorted(blob)));
        self.walk();
        if self.best.len() < self.least() {
            return Err(TargetStatus::NoMatch);
        }
        if !self.tell_sizes(candidates) {
            return Err(TargetStatus::NoMatch);
        }
        // slivers of dots at something's edge stand in their cells, and tell nothing
        let walked = self.best.len();
        self.best.retain(|cell| cell.clear);
        if self.best.len() < self.least() || (self.best.len() as f64) < LEAST_CLEAR * walked as f64 {
            return Err(TargetStatus::NoMatch);
        }
        if self.grid.is_equal() {
            return self.lay_upright(candidates, chosen);
        }
        let (way, margin) = self.lay()?;
        let mut large = 0;
        self.present.fill(false);
        for cell in &self.best {
            if let Some(id) = self.fits(&way, cell)
                && let Some((_, blob)) = candidates.get(cell.candidate)
            {
                chosen.push((id, *blob));
                large += usize::from(cell.large);
                if let Some(present) = self.present.get_mut(id as usize) {
                    *present = true;
                }
            }
        }
        chosen.sort_unstable_by_key(|(id, _)| *id);
        // Without a whole window the place must follow from more dots, and more than one must speak against any other; dots
        // of one size could be any grid's.
        let small = chosen.len() - large;
        let tells = chosen.len() >= self.least() + MORE && margin >= 2 && large.min(small) >= 2;
        if self.has_window() || tells { Ok(()) } else { Err(TargetStatus::NoMatch) }
    }

    /// Walks the lattice from several seeds; the longest walk is in `best`.
    fn walk(&mut self) {
        self.best.clear();
        self.taken.clear();
        self.taken.resize(self.points.len(), false);
        let mut tried = 0;
        for seed in 0..self.points.len() {
            let enough = 2 * self.best.len() > self.points.len();
            if tried == SEEDS || enough {
                break;
            }
            if self.taken.get(seed).copied().unwrap_or(true) {
                continue;
            }
            tried += 1;
            if let Some(steps) = self.steps_at(seed) {
                self.walk_from(seed, steps);
                if self.cells.len() > self.best.len() {
                    std::mem::swap(&mut self.cells, &mut self.best);
                }
            }
        }
    }

    /// The two shortest steps from a candidate to neighbours in different directions, the second one clockwise of the first as y_o
    /// is of x_o.
    fn steps_at(&self, seed: usize) -> Option<[Vector2<f64>; 2]> {
        let from = self.points.get(seed)?;
        let mut nearest = [(f64::INFINITY, Vector2::zeros()); NEIGHBOURS];
        for (i, point) in self.points.iter().enumerate() {
            let step = point - from;
            let (length, last) = (step.norm_squared(), NEIGHBOURS - 1);
            if i != seed && length < nearest.get(last)?.0 {
                let at = nearest.partition_point(|(known, _)| *known <= length);
                nearest.get_mut(at..)?.rotate_right(1);
                *nearest.get_mut(at)? = (length, step);
            }
        }
        let (length, first) = *nearest.first().filter(|(length, _)| length.is_finite())?;
        let (_, second) = nearest.iter().skip(1).find(|(other, step)| {
            other.is_finite() && first.perp(step).abs() > LEAST_SINE * (length * other).sqrt()
        })?;
        Some(if first.perp(second) > 0.0 { [first, *second] } else { [*second, first] })
    }

    /// Takes cell by cell what lies where the lattice goes on.
    fn walk_from(&mut self, seed: usize, steps: [Vector2<f64>; 2]) {
        self.cells.clear();
        self.map.fill(0);
        self.put(Cell { at: [0, 0], candidate: seed, steps, area: 0.0, large: false, clear: false });
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
                let Some((candidate, point)) = self.nearest(&(from + step), limit) else { continue };
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
                self.put(Cell { at, candidate, steps, area: 0.0, large: false, clear: false });
            }
        }
    }

    fn put(&mut self, cell: Cell) {
        if let Some(place) = slot(cell.at).and_then(|i| self.map.get_mut(i))
            && self.cells.len() < self.cells.capacity()
        {
            self.cells.push(cell);
            *place = self.cells.len() as u32;
            if let Some(taken) = self.taken.get_mut(cell.candidate) {
                *taken = true;
            }
        }
    }

    fn at(&self, at: [i32; 2]) -> Option<&Cell> {
        let index = *self.map.get(slot(at)?)?;
        self.cells.get((index as usize).checked_sub(1)?)
    }

    fn nearest(&self, wanted: &Vector2<f64>, limit: f64) -> Option<(usize, Vector2<f64>)> {
        let distance = |p: &Vector2<f64>| (p - wanted).norm_squared();
        let nearest = self.points.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        let (i, point) = nearest.filter(|(_, p)| distance(p) < limit * limit)?;
        // a region is one dot, and stands in one cell
        let free = self.cells.iter().all(|cell| cell.candidate != i);
        free.then_some((i, *point))
    }

    /// Large or small: areas against those of the cells.
    fn tell_sizes(&mut self, candidates: &[(f64, Blob)]) -> bool {
        self.pairs.clear();
        for cell in &self.best {
            if let Some(s) = self.points.get(cell.candidate) {
                let r = Vector2::new(f64::from(cell.at[0]), f64::from(cell.at[1]));
                self.pairs.push(Correspondence { r, s: s / self.focal_px });
            }
        }
        let Ok(H) = homography(&self.pairs) else { return false };
        let area = |radius_m: f64| std::f64::consts::PI * (radius_m / self.grid.pitch_m()).powi(2);
        let (small, large) = (area(self.grid.radius_m()).ln(), area(self.grid.large_radius_m()).ln());
        for (cell, pair) in self.best.iter_mut().zip(&self.pairs) {
            let Some((area, _)) = candidates.get(cell.candidate) else { return false };
            let scale = area_scale(&H, &pair.r) * self.camera.pixel_jacobian(&pair.s).determinant().abs();
            cell.area = area / scale;
        }
        if self.grid.is_equal() {
            return self.compare_sizes();
        }
        for cell in &mut self.best {
            let log = cell.area.ln();
            cell.large = log > 0.5 * (small + large);
            cell.clear = (log - if cell.large { large } else { small }).abs() < AREA_TOLERANCE;
        }
        true
    }

    /// Equal dots have the size of the middle one, and leave some of the plate between them.
    fn compare_sizes(&mut self) -> bool {
        self.best.sort_unstable_by(|a, b| a.area.total_cmp(&b.area));
        let Some(middle) = self.best.get(self.best.len() / 2).map(|cell| cell.area) else { return false };
        let radius = (middle / std::f64::consts::PI).sqrt();
        self.radius_m = Some(radius * self.grid.pitch_m());
        for cell in &mut self.best {
            cell.clear = (cell.area / middle).ln().abs() < AREA_TOLERANCE;
        }
        radius < 0.5
    }
}

/// Index of a cell in the map, if it has one.
fn slot([i, j]: [i32; 2]) -> Option<usize> {
    let inside = i.abs() <= REACH && j.abs() <= REACH;
    inside.then(|| (j + REACH) as usize * SIDE + (i + REACH) as usize)
}

/// By how much a homography enlarges areas at `r`.
fn area_scale(H: &Matrix3<f64>, r: &Vector2<f64>) -> f64 {
    let h = H * r.push(1.0);
    let s = h.xy() / h.z;
    let J = Matrix2::new(H.m11 - s.x * H.m31, H.m12 - s.x * H.m32, H.m21 - s.y * H.m31, H.m22 - s.y * H.m32)
        / h.z;
    J.determinant().abs()
}
