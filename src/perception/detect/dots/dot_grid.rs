//! Identification of the dots of a grid among regions, also where a part of the grid is hidden.
//!
//! ```text
//! regions ─► each a seed: the lattice about it (walk.rs) ─► homography of the cells ─► large or small
//!         ─► the alignment with the grid in which all sizes agree (lay.rs); else the next seed
//! ```
//! A *walk* extends a lattice from a seed dot to its neighbours, cell by cell. Its steps may follow a diagonal of a tilted grid, which is
//! corrected when the sizes of the dots are compared. Mirrored grids are not considered. The work of a search is bounded by the cells of all walks.
//!
//! A grid of equal dots is found only complete; of its symmetric orientations the upright one is taken.

mod lay;
mod walk;

use super::blob::Blob;
use crate::camera_model::CameraModel;
use crate::messages::TargetStatus;
use crate::pose::{Correspondence, homography};
use crate::target::DotGrid;
use nalgebra::{Matrix2, Matrix3, Vector2};
use walk::SIDE;

/// Greatest logarithm of a dot's area over that which its cell calls for. Derived: large dots of usual grids have 2.56 times the area of small
/// ones, of which the logarithm is 0.94; half of it, less a little, so that between both there are sizes which are neither.
const AREA_TOLERANCE: f64 = 0.42;
/// Least share of the cells whose dots have a dot's size. Chosen by hand: of a grid half hidden a row of slivers at the cover's edge is less than a
/// third; with half of it, discs of any sizes would make a grid here and there (test `dots_that_are_no_grid_are_none`).
const MIN_CLEAR: f64 = 0.7;
/// So many more dots than those of a window identify the part also where they do not form a window. Chosen by hand: each has one bit, so that a place of
/// chance is as good once in eight; as many must speak against any other place as the margin asks for.
const MORE: usize = 3;
/// Cells that all walks of one search may take, for each candidate that there may be. Chosen by hand: dots of the grid are walked once or twice,
/// clutter as often as it has seeds; a bound on time.
const MAX_WALKED: usize = 8;

/// A detected dot in a cell of the lattice.
#[derive(Debug, Clone, Copy)]
struct LatticeDot {
    at: [i32; 2],
    candidate: usize,
    /// Displacements to the next cells here, px of the undistorted image.
    steps: [Vector2<f64>; 2],
    /// Area of the dot, in areas of a cell.
    area: f64,
    large: bool,
    /// Whether its size is that of a small or a large dot.
    clear: bool,
}

/// Identifies the dots of one grid. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    camera: CameraModel,
    grid: DotGrid,
    /// Mean focal length, px.
    focal_px: f64,
    /// Candidates in the undistorted image, px.
    points: Vec<Vector2<f64>>,
    /// Of the same their areas there, px^2.
    areas: Vec<f64>,
    /// Their x and indices, by x.
    by_x: Vec<(f64, usize)>,
    /// Candidates that belong to a lattice already, and those of the current walk.
    taken: Vec<bool>,
    used: Vec<bool>,
    cells: Vec<LatticeDot>,
    best: Vec<LatticeDot>,
    /// Cells of the last walk.
    walked: usize,
    /// Whether sizes come from the threshold of the frame, not from one of each dot.
    rough: bool,
    /// Index in `cells` + 1 of the dot in each cell.
    map: Vec<u32>,
    pairs: Vec<Correspondence>,
    present: Vec<bool>,
    /// Dots of a grid beside the one that was found.
    another: Vec<(u32, Blob)>,
    /// Radius of the dots of the last grid of equal dots, m.
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
            areas: Vec::with_capacity(most),
            by_x: Vec::with_capacity(most),
            taken: Vec::with_capacity(most),
            used: Vec::with_capacity(most),
            cells: Vec::with_capacity(most),
            best: Vec::with_capacity(most),
            walked: 0,
            rough: false,
            map: vec![0; SIDE * SIDE],
            pairs: Vec::with_capacity(most),
            present: vec![false; grid.points().len()],
            another: Vec::with_capacity(most),
            radius_m: None,
        }
    }

    /// Fewest dots that identify a part of the grid.
    pub(super) fn least(&self) -> usize {
        self.grid.min_to_find()
    }

    /// Radius of the dots, m, as measured in the last frame, where the target does not state it.
    pub(super) fn told_radius_m(&self) -> Option<f64> {
        self.radius_m
    }

    /// Whether tracked dots suffice for the grid: enough of them, not all in one row or column.
    pub(super) fn confirm(&self, found: &[(u32, Blob)]) -> bool {
        let place = |id: u32| (id as usize % self.grid.columns(), id as usize / self.grid.columns());
        let Some(first) = found.first().map(|(id, _)| place(*id)) else { return false };
        let others =
            |axis: fn((usize, usize)) -> usize| found.iter().any(|(id, _)| axis(place(*id)) != axis(first));
        found.len() >= 5 && others(|p| p.0) && others(|p| p.1)
    }

    /// The regions that are dots of the grid, with their ids, rising. A grid of which some dot is there twice is ambiguous; what a cover leaves of one grid in two parts is not, nor is a grid that is walked again, from a disc beside it:
    /// then the walk with more dots counts, without those of which the two say different things.
    pub(super) fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        chosen.clear();
        self.place(candidates);
        let mut reason = TargetStatus::NoMatch;
        let mut left = self.max_walked();
        let mut another = std::mem::take(&mut self.another);
        let mut found_radius_m = None;
        for seed in 0..self.points.len() {
            if self.taken.get(seed) != Some(&false) {
                continue;
            }
            let enough = self.walk(seed, candidates);
            left = left.saturating_sub(self.walked);
            if enough {
                let is_first = chosen.is_empty();
                let dots = if is_first { &mut *chosen } else { &mut another };
                match self.identify(candidates, dots) {
                    Ok(()) if is_first => found_radius_m = Some(self.radius_m),
                    Ok(()) => match shared(chosen, &another) {
                        // another grid of the same kind
                        (agree, differ) if agree <= differ && differ > 0 => {
                            (found_radius_m, reason) = (None, TargetStatus::Ambiguous);
                            break;
                        }
                        // the same grid, walked from something beside it
                        (agree, _) if agree > 0 => {
                            if another.len() > chosen.len() {
                                std::mem::swap(chosen, &mut another);
                                found_radius_m = Some(self.radius_m);
                            }
                            chosen.retain(|(id, blob)| {
                                place_of(*id, &another).is_none_or(|at| at == place(blob))
                            });
                        }
                        _ => {}
                    },
                    Err(TargetStatus::Ambiguous) if is_first => reason = TargetStatus::Ambiguous,
                    _ => {}
                }
                if found_radius_m.is_none() {
                    chosen.clear();
                }
            }
            if left == 0 {
                break;
            }
        }
        self.another = another;
        if let Some(radius_m) = found_radius_m {
            self.radius_m = radius_m;
            return Ok(());
        }
        chosen.clear();
        Err(reason)
    }

    fn max_walked(&self) -> usize {
        MAX_WALKED * self.points.capacity()
    }

    /// Identifies the cells of the lattice with dots of the grid.
    fn identify(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        chosen.clear();
        if !self.tell_sizes(candidates) {
            return Err(TargetStatus::NoMatch);
        }
        // partly occluded dots are in their cells, but their sizes are not informative
        let walked = self.best.len();
        self.best.retain(|cell| cell.clear);
        if self.best.len() < self.least() || (self.best.len() as f64) < MIN_CLEAR * walked as f64 {
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

    /// Classifies the dots as large or small, by their areas relative to the cells.
    fn tell_sizes(&mut self, candidates: &[(f64, Blob)]) -> bool {
        if !self.pairs_of_best(self.best.len()) {
            return false;
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

/// How many ids are in both lists, in which ids rise, with the same region, and with different ones.
fn shared(one: &[(u32, Blob)], other: &[(u32, Blob)]) -> (usize, usize) {
    let places = one.iter().filter_map(|(id, blob)| Some((place(blob), place_of(*id, other)?)));
    places.fold(
        (0, 0),
        |(agree, differ), (a, b)| if a == b { (agree + 1, differ) } else { (agree, differ + 1) },
    )
}

/// Where an id is in a list in which ids rise.
fn place_of(id: u32, dots: &[(u32, Blob)]) -> Option<[f64; 2]> {
    let at = dots.binary_search_by_key(&id, |(known, _)| *known).ok()?;
    dots.get(at).map(|(_, blob)| place(blob))
}

/// Two dots of one frame's regions are the same region where they have the same centre.
fn place(blob: &Blob) -> [f64; 2] {
    [blob.x, blob.y]
}

/// Factor by which a homography enlarges areas at `r`: the determinant of its derivative.
fn area_scale(H: &Matrix3<f64>, r: &Vector2<f64>) -> f64 {
    let h = H * r.push(1.0);
    let s = h.xy() / h.z;
    let J = Matrix2::new(H.m11 - s.x * H.m31, H.m12 - s.x * H.m32, H.m21 - s.y * H.m31, H.m22 - s.y * H.m32)
        / h.z;
    J.determinant().abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};
    use crate::linalg::Random;
    use std::f64::consts::PI;

    /// A disc's region of radius `r` at `(x, y)`.
    fn disc(x: f64, y: f64, r: f64) -> (f64, Blob) {
        let area = PI * r * r;
        (area, Blob { x, y, covariance: [0.25 * r * r, 0.0, 0.25 * r * r], area })
    }

    fn lattice() -> (Lattice, DotGrid) {
        let intrinsics = Intrinsics {
            fx_px: 600.0,
            fy_px: 600.0,
            cx_px: 319.5,
            cy_px: 239.5,
            width_px: 640,
            height_px: 480,
        };
        let camera = CameraModel::new(intrinsics, Distortion::default()).unwrap();
        let grid = DotGrid::with_pitch(7, 5, 0.03).unwrap();
        (Lattice::new(camera, &grid, 512), grid)
    }

    /// The grid's dots seen from the front with this pitch, px, about a place.
    fn dots_of(grid: &DotGrid, pitch_px: f64, (x, y): (f64, f64)) -> Vec<(f64, Blob)> {
        let scale = pitch_px / grid.pitch_m();
        let dots = grid.discs();
        dots.iter()
            .map(|d| disc(x + scale * d.centre_m.x, y + scale * d.centre_m.y, scale * d.radius_m))
            .collect()
    }

    #[test]
    fn a_grid_walked_from_a_disc_beside_it_stays_one() {
        let (mut lattice, grid) = lattice();
        let mut random = Random::new(5);
        let mut within = |low: f64, high: f64| low + (high - low) * random.uniform();
        let mut lost = 0;
        for draw in 0..1000 {
            let pitch = within(12.0, 40.0);
            let mut candidates = dots_of(&grid, pitch, (200.0, 150.0));
            let (wide, high) = (200.0 + 6.0 * pitch, 150.0 + 4.0 * pitch);
            for _ in 0..40 {
                let (x, y) = (
                    within(200.0 - 3.0 * pitch, wide + 3.0 * pitch),
                    within(150.0 - 3.0 * pitch, high + 3.0 * pitch),
                );
                let off = |v: f64, low: f64, high: f64| (low - v).max(v - high).max(0.0);
                if off(x, 200.0, wide).max(off(y, 150.0, high)) > 0.8 * pitch {
                    candidates.push(disc(x, y, pitch * within(0.15, 0.35)));
                }
            }
            candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
            let mut chosen = Vec::new();
            let result = lattice.find(&candidates, &mut chosen);
            assert_ne!(result, Err(TargetStatus::Ambiguous), "draw {draw}");
            lost += usize::from(result.is_err());
            for (id, blob) in &chosen {
                let (column, row) = (f64::from(id % 7), f64::from(id / 7));
                let off = (blob.x - 200.0 - pitch * column).hypot(blob.y - 150.0 - pitch * row);
                assert!(off < 1e-9, "draw {draw}: dot {id} is {off} px off");
            }
        }
        // what stands beside the grid by chance can break its lattice
        assert!(lost <= 5, "{lost} of 1000");
    }

    #[test]
    fn two_grids_of_a_kind_are_ambiguous() {
        let (mut lattice, grid) = lattice();
        let mut candidates = dots_of(&grid, 20.0, (60.0, 60.0));
        candidates.extend(dots_of(&grid, 24.0, (300.0, 250.0)));
        candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen = Vec::new();
        assert_eq!(lattice.find(&candidates, &mut chosen), Err(TargetStatus::Ambiguous));
        assert!(chosen.is_empty());
    }
}
