//! From a grey frame to the points of a target: search of the whole frame, and tracking in windows.
//!
//! What all targets made of dots share stands here: thresholds, regions, windows, centroids. Which regions are which dots is
//! the business of each kind: [`Pattern`].

use super::blob::Blob;
use super::dot::{DotMeter, Found};
use super::dot_grid::Lattice;
use super::four_dots::{MOST_CANDIDATES, Square};
use super::offset::centre_offset;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::imaging::{Components, Connectivity, Histogram, ImageView, LocalThreshold, Runs, Window};
use crate::messages::TargetStatus;
use crate::target::{Mark, Target};
use nalgebra::Vector2;

/// Rows that the histogram samples.
const SAMPLED_ROWS: usize = 120;
/// Least difference between the classes of a threshold, grey levels.
const LEAST_CONTRAST: f64 = 12.0;
/// Least separability of the classes: one Gaussian has 0.64, a uniform ramp 0.75.
const LEAST_SEPARABILITY: f64 = 0.76;

/// Where a point of the target should be, and how its dot should look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Which point.
    pub id: u32,
    /// Centroid, px.
    pub px: Vector2<f64>,
    /// Covariance `[xx, xy, yy]` of a point uniform in its image, px^2.
    pub covariance_px2: [f64; 3],
    /// Area, px^2.
    pub area_px2: f64,
    /// How far off the prediction may be, px.
    pub slack_px: f64,
    /// Greatest level that counts as dark.
    pub threshold: u8,
}

/// What tells which region is which dot: one kind for each kind of target.
#[derive(Debug, Clone)]
enum Pattern {
    FourDots(Square),
    DotGrid(Box<Lattice>),
}

impl Pattern {
    /// The regions that are the target's, with their ids, rising.
    fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        match self {
            Self::FourDots(square) => square.find(candidates, chosen),
            Self::DotGrid(lattice) => lattice.find(candidates, chosen),
        }
    }

    /// Whether regions found where they were expected can be the target's.
    fn confirm(&self, chosen: &[(u32, Blob)]) -> bool {
        match self {
            Self::FourDots(square) => square.confirm(chosen),
            Self::DotGrid(lattice) => lattice.confirm(chosen),
        }
    }

    /// Whether `count` points of a search are enough, although others had no contrast.
    fn serves_in_part(&self, count: usize) -> bool {
        match self {
            Self::FourDots(_) => false,
            Self::DotGrid(lattice) => count >= lattice.least(),
        }
    }
}

/// Finds one target. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct Finder {
    camera: CameraModel,
    marks: Box<[Mark]>,
    runs: Runs,
    components: Components,
    local: LocalThreshold,
    pattern: Pattern,
    /// Fewer regions cannot be the target, and of more the largest are looked at.
    least_candidates: usize,
    most_candidates: usize,
    meter: DotMeter,
    candidates: Vec<(f64, Blob)>,
    chosen: Vec<(u32, Blob)>,
}

impl Finder {
    /// A finder for frames of `camera` and one target.
    #[must_use]
    pub fn new(camera: CameraModel, target: &Target) -> Self {
        let i = camera.intrinsics();
        let limit = (i.width_px as usize * i.height_px as usize / 16).max(4096);
        let count = target.points().len();
        let (pattern, most_candidates) = match target {
            Target::FourDots(dots) => (Pattern::FourDots(Square::new(camera, dots)), MOST_CANDIDATES),
            Target::DotGrid(grid) => {
                let most = 2 * count + 32;
                (Pattern::DotGrid(Box::new(Lattice::new(camera, grid, most))), most)
            }
        };
        Self {
            camera,
            marks: target.marks().into(),
            runs: Runs::with_limit(limit),
            components: Components::with_limit(limit),
            local: LocalThreshold::with_size(i.width_px as usize, i.height_px as usize),
            pattern,
            least_candidates: target.least_to_find(),
            most_candidates,
            meter: DotMeter::new(free_distance(target).clamp(0.1, 2.0), count),
            candidates: Vec::with_capacity(most_candidates + 1),
            chosen: Vec::with_capacity(count),
        }
    }

    /// Searches the whole frame: fills `found` with the points that are seen, ids rising. A target of four dots is found whole
    /// or not at all.
    ///
    /// # Errors
    /// The status that says why there is no target; never [`TargetStatus::Found`] or `WrongSize`. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Found>) -> Result<(), TargetStatus> {
        found.clear();
        let histogram = Histogram::of_rows(image, image.height() / SAMPLED_ROWS);
        let Some(otsu) = histogram.otsu() else { return Err(TargetStatus::NoContrast) };
        let window = Window::whole(image);
        self.runs.find(image, &window, otsu.threshold);
        let global = self.search_runs(image, &window, found);
        let Err(first) = global else { return global };
        // A threshold for the whole frame fails where light is uneven: half-way between the local extremes instead.
        // Contrast of a few times the noise, which is at most the dark class's own spread.
        let contrast = (0.25 * (otsu.light_mean - otsu.dark_mean)).clamp(30.0, 80.0) as u8;
        self.local.set(image, contrast, otsu.threshold);
        self.runs.find_local(image, &mut self.local);
        let local = self.search_runs(image, &window, found);
        let Err(second) = local else { return local };
        let flat =
            otsu.light_mean - otsu.dark_mean < LEAST_CONTRAST || otsu.separability < LEAST_SEPARABILITY;
        Err(match (first, second) {
            (TargetStatus::Ambiguous, _) | (_, TargetStatus::Ambiguous) => TargetStatus::Ambiguous,
            (TargetStatus::TooFewRegions, TargetStatus::TooFewRegions) if flat => TargetStatus::NoContrast,
            (TargetStatus::TooFewRegions, TargetStatus::TooFewRegions) => TargetStatus::TooFewRegions,
            _ => TargetStatus::NoMatch,
        })
    }

    /// Looks for the points where they are expected, ids rising: fills `found` with those that are there alone and whole. Whether they
    /// can be the target; `found` is empty when not.
    pub fn track(&mut self, image: &ImageView<'_>, expected: &[Expected], found: &mut Vec<Found>) -> bool {
        found.clear();
        self.chosen.clear();
        for dot in expected {
            let [xx, _, yy] = dot.covariance_px2;
            let margin = 3.0 + dot.slack_px;
            let (half_x, half_y) = (2.0 * xx.max(0.0).sqrt() + margin, 2.0 * yy.max(0.0).sqrt() + margin);
            let window = Window::around(dot.px.x, dot.px.y, half_x, half_y, image);
            self.runs.find(image, &window, dot.threshold);
            self.components.find(&self.runs, &window, Connectivity::Eight);
            let distance = |b: &Blob| (b.x - dot.px.x).hypot(b.y - dot.px.y);
            let blob = self
                .components
                .as_slice()
                .iter()
                .filter_map(Blob::of)
                .filter(|b| b.area > 0.5 * dot.area_px2 && b.area < 2.0 * dot.area_px2)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)));
            self.chosen.extend(blob.map(|blob| (dot.id, blob)));
        }
        if !self.pattern.confirm(&self.chosen) {
            return false;
        }
        self.meter.measure(image, &self.chosen, found);
        true
    }

    /// How far the centroid of the dot about point `id` lies from the image of the point, px, for the target at `X_CO`: the image
    /// of a disc's centre is not the centre of its image.
    #[must_use]
    pub fn bias_px(&self, id: u32, X_CO: &Pose) -> Vector2<f64> {
        let mark = self.marks.get(id as usize);
        mark.map_or(Vector2::zeros(), |m| centre_offset(X_CO, &self.camera, &m.centre_m, m.radius_m))
    }

    /// Regions of the current runs, the ellipses among them, those that are the target, their centroids.
    fn search_runs(
        &mut self,
        image: &ImageView<'_>,
        window: &Window,
        found: &mut Vec<Found>,
    ) -> Result<(), TargetStatus> {
        if self.runs.overflowed() {
            return Err(TargetStatus::TooFewRegions);
        }
        self.components.find(&self.runs, window, Connectivity::Eight);
        self.candidates.clear();
        for component in self.components.as_slice() {
            let Some(blob) = Blob::of(component) else { continue };
            // of too many the largest are kept: specks go first
            let at = self.candidates.partition_point(|(area, _)| *area >= blob.area);
            if at < self.most_candidates {
                self.candidates.insert(at, (blob.area, blob));
                self.candidates.truncate(self.most_candidates);
            }
        }
        if self.candidates.len() < self.least_candidates {
            return Err(TargetStatus::TooFewRegions);
        }
        self.pattern.find(&self.candidates, &mut self.chosen)?;
        self.meter.measure(image, &self.chosen, found);
        // what has no contrast to its surroundings was no dot
        if found.len() == self.chosen.len() || self.pattern.serves_in_part(found.len()) {
            return Ok(());
        }
        found.clear();
        Err(TargetStatus::NoMatch)
    }
}

/// Least distance from a dot's rim to a neighbour's, or to the plate's edge, in the dot's radii.
fn free_distance(target: &Target) -> f64 {
    let (marks, plate) = (target.marks(), target.plate());
    let mut least = f64::INFINITY;
    for (i, mark) in marks.iter().enumerate() {
        let (a, b) = (mark.centre_m - plate.low_m, plate.high_m - mark.centre_m);
        least = least.min((a.x.min(a.y).min(b.x).min(b.y) - mark.radius_m) / mark.radius_m);
        for (_, other) in marks.iter().enumerate().filter(|(j, _)| *j != i) {
            let between = (mark.centre_m - other.centre_m).norm() - mark.radius_m - other.radius_m;
            least = least.min(between / mark.radius_m);
        }
    }
    least
}
