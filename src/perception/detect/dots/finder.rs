//! Detection of a target made of dots: search of the whole frame, and tracking in windows.
//!
//! This module has what all such targets share: regions, windows, centroids. The identification of the dots is
//! that of each kind of target ([`DotPattern`]); `search.rs` chooses the thresholds.
//!
//! A square of four dots and its mirror image differ only in the order of the corners: in a mirror, two corners are exchanged
//! across the diagonal through P1. For a view over mirrors use a grid of dots, which is never confused with its mirror image.

use super::blob::Blob;
use super::body::{BodyDots, MAX_BODY_CANDIDATES};
use super::dot::DotMeter;
use super::dot_grid::Lattice;
use super::fill::filled;
use super::four_dots::{MAX_CANDIDATES, Square};
use super::offset::centre_offset;
use super::rims;
use crate::camera_model::CameraModel;
use crate::detect::{Detection, PredictedPoint};
use crate::geometry::Pose;
use crate::imaging::{Components, Connectivity, ImageView, LocalThreshold, Runs, Window};
use crate::messages::TargetStatus;
use crate::target::{Disc, DotBody, Target};
use nalgebra::Vector2;

/// A region may grow so many times by filling its holes. Chosen by hand: glare over two thirds of a dot leaves a rim; of a thinner ring it is
/// likelier that it is a letter or a cable.
const MAX_FILLED: u64 = 3;
/// Among more ellipses than these, those are looked for that stand out from what is around them. Chosen by hand: eight are 70 choices of four,
/// sixteen 1820, so that a look around each pays.
const FEW_CANDIDATES: usize = 8;
/// The same of the dots of a body. Chosen by hand: half of the most that it has, as many as it shows.
const FEW_OF_A_BODY: usize = 12;
/// Runs that there is room for in the smallest frame. Chosen by hand: one run in 16 px, as larger frames have, of 256 x 256 px.
const MIN_RUNS: usize = 4096;
/// Candidates for a grid that there is room for at least: its dots may be the smallest of all that is round in the frame. Chosen by hand: a small
/// grid among 450 other dots; twice as many take twice the time of clutter.
const MIN_ROOM: usize = 512;
/// Regions of a search whose holes are filled. Chosen by hand, as a bound on time: texture makes thousands of regions with holes.
const MAX_HOLED: usize = 64;

/// Identification of the dots, one variant for each kind of target.
#[derive(Debug, Clone)]
enum DotPattern {
    FourDots(Box<Square>),
    DotGrid(Box<Lattice>),
    Body(Box<BodyDots>),
    /// Unrelated dots, known only by their last positions.
    Any,
    /// A target without dots.
    None,
}

impl DotPattern {
    /// The regions that belong to the target, with their ids, rising.
    fn find(
        &mut self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        match self {
            Self::FourDots(square) => square.find(candidates, chosen),
            Self::DotGrid(lattice) => lattice.find(candidates, chosen),
            Self::Body(body) => body.find(candidates, chosen),
            Self::Any | Self::None => Err(TargetStatus::NoMatch),
        }
    }

    /// Whether tracked regions can be the target's.
    fn confirm(&mut self, chosen: &[(u32, Blob)]) -> bool {
        match self {
            Self::FourDots(square) => square.confirm(chosen),
            Self::DotGrid(lattice) => lattice.confirm(chosen),
            Self::Body(body) => body.confirm(chosen),
            Self::Any => !chosen.is_empty(),
            Self::None => false,
        }
    }

    /// Radius of all dots, m, where it is measured with them.
    fn told_radius_m(&self) -> Option<f64> {
        match self {
            Self::DotGrid(lattice) => lattice.told_radius_m(),
            Self::FourDots(_) | Self::Body(_) | Self::Any | Self::None => None,
        }
    }

    /// Whether `count` points of a search are enough, although others had no contrast.
    fn serves_in_part(&self, count: usize) -> bool {
        match self {
            Self::FourDots(_) | Self::Any | Self::None => false,
            Self::DotGrid(lattice) => count >= lattice.least(),
            Self::Body(_) => count >= DotBody::LEAST,
        }
    }
}

/// How thoroughly a search examines its regions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SearchEffort {
    /// As the threshold gives them.
    Quick,
    /// Only those that differ from their surroundings, each with its own threshold.
    Careful,
    /// The same, with their holes filled.
    Filled,
}

/// Finder of one target made of dots. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct DotFinder {
    camera: CameraModel,
    /// Of each point the frame of the plate or face that its dot is on, X_OF, and the dot in that frame.
    dots: Box<[(Pose, Disc)]>,
    pub(super) runs: Runs,
    components: Components,
    /// The same of a window about one region: those of the frame stay.
    near_runs: Runs,
    near_components: Components,
    pub(super) local: LocalThreshold,
    pattern: DotPattern,
    /// Bounds on the number of candidates: fewer cannot be the target, and of more the largest are used.
    min_candidates: usize,
    max_candidates: usize,
    meter: DotMeter,
    candidates: Vec<(f64, Blob)>,
    chosen: Vec<(u32, Blob)>,
    /// The frame with its levels inverted; empty where dots are dark.
    inverted: Vec<u8>,
    light_on_dark: bool,
}

impl DotFinder {
    /// A finder for frames of `camera` and one target, of dark dots on a light plate or the other way round.
    #[must_use]
    pub fn new(camera: CameraModel, target: &Target, light_on_dark: bool) -> Self {
        let count = target.points().len();
        let (pattern, max_candidates) = match target {
            Target::FourDots(dots) => {
                (DotPattern::FourDots(Box::new(Square::new(camera, dots))), MAX_CANDIDATES)
            }
            Target::DotGrid(grid) => {
                let most = (2 * count + 32).max(MIN_ROOM);
                (DotPattern::DotGrid(Box::new(Lattice::new(camera, grid, most))), most)
            }
            Target::DotBody(body) => {
                (DotPattern::Body(Box::new(BodyDots::new(camera, body))), MAX_BODY_CANDIDATES)
            }
            Target::Chessboard(_) | Target::Tags(_) | Target::Shape(_) => (DotPattern::None, 0),
        };
        let meter = DotMeter::new(free_distances(target), light_on_dark);
        let dots = (0..count).map_while(|i| target.dot(i)).collect();
        let min_candidates = target.min_to_find();
        Self {
            min_candidates,
            ..Self::with(camera, pattern, dots, count, max_candidates, meter, light_on_dark)
        }
    }

    /// Tracker of unrelated dots, known only by their last positions, with ids below `count`: for [`Self::track`] alone. Each dot must lie at least its
    /// radius from everything else; `px` is the centre of its image.
    #[must_use]
    pub fn of_any(camera: CameraModel, count: usize, light_on_dark: bool) -> Self {
        let meter = DotMeter::new(vec![1.0; count].into(), light_on_dark);
        Self::with(camera, DotPattern::Any, Box::default(), count, 0, meter, light_on_dark)
    }

    /// The same for a lens that is not known: a square may look less like one.
    #[must_use]
    pub fn for_unknown_lens(self) -> Self {
        let pattern = match self.pattern {
            DotPattern::FourDots(square) => DotPattern::FourDots(Box::new(square.for_unknown_lens())),
            other => other,
        };
        Self { pattern, ..self }
    }

    fn with(
        camera: CameraModel,
        pattern: DotPattern,
        dots: Box<[(Pose, Disc)]>,
        count: usize,
        max_candidates: usize,
        meter: DotMeter,
        light_on_dark: bool,
    ) -> Self {
        let i = camera.intrinsics();
        let pixels = i.width_px as usize * i.height_px as usize;
        let limit = (pixels / 16).max(MIN_RUNS);
        Self {
            camera,
            dots,
            runs: Runs::with_limit(limit),
            components: Components::with_limit(limit),
            near_runs: Runs::with_limit((limit / 4).max(MIN_RUNS)),
            near_components: Components::with_limit((limit / 4).max(MIN_RUNS)),
            local: LocalThreshold::with_size(i.width_px as usize, i.height_px as usize),
            pattern,
            min_candidates: 1,
            max_candidates,
            meter,
            candidates: Vec::with_capacity(max_candidates + 1),
            chosen: Vec::with_capacity(count),
            inverted: vec![0; if light_on_dark { pixels } else { 0 }],
            light_on_dark,
        }
    }

    /// Searches the whole frame: fills `found` with the detected points, ids rising. A target of four dots is detected completely
    /// or not at all.
    ///
    /// # Errors
    /// The status that says why there is no target; never [`TargetStatus::Found`] or `WrongSize`. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        let mut inverted = std::mem::take(&mut self.inverted);
        let result = match invert(image, &Window::whole(image), &mut inverted) {
            Some(dark) if self.light_on_dark => self.search_dark(&dark, image, found),
            _ => self.search_dark(image, image, found),
        };
        self.inverted = inverted;
        result
    }

    /// Examines the rims of the dots detected in `image`: centres of dots that are partly occluded or unevenly lit are measured by the rest of their
    /// rims, and their ids are added to `harmed`. Takes longer than the detection.
    pub fn examine_occlusion(&self, image: &ImageView<'_>, found: &mut [Detection], harmed: &mut Vec<u32>) {
        rims::examine_occlusion(image, found, self.light_on_dark, harmed);
    }

    /// Tracks the points in windows about their predictions (ids rising): fills `found` with those that were detected unambiguously and not occluded.
    /// Returns whether they can be the target; `found` is empty when not.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedPoint],
        found: &mut Vec<Detection>,
    ) -> bool {
        found.clear();
        self.chosen.clear();
        for dot in expected {
            let margin = 3.5 + dot.slack_px;
            let near = |b: &Blob| b.area > 0.5 * dot.area_px2 && b.area < 2.0 * dot.area_px2;
            let blob = self.region(image, &dot.px, &dot.covariance_px2, margin, dot.threshold, near);
            self.chosen.extend(blob.map(|blob| (dot.id, blob)));
        }
        if matches!(self.pattern, DotPattern::Any) {
            self.leave_out_doubles(expected);
        }
        if !self.pattern.confirm(&self.chosen) {
            return false;
        }
        self.meter.measure(image, &self.chosen, found);
        true
    }

    /// Removes ids that were assigned to the same dot, except the one with the nearest prediction. (For a target its geometry excludes this.)
    fn leave_out_doubles(&mut self, expected: &[PredictedPoint]) {
        let off = |(id, blob): &(u32, Blob)| {
            let place = expected.iter().find(|dot| dot.id == *id);
            place.map_or(f64::INFINITY, |dot| (dot.px - Vector2::new(blob.x, blob.y)).norm())
        };
        let mut i = 0;
        while let Some(one) = self.chosen.get(i).copied() {
            let same = |other: &(u32, Blob)| {
                other.0 != one.0 && (other.1.x - one.1.x).hypot(other.1.y - one.1.y) < 1.0
            };
            if self.chosen.iter().any(|other| same(other) && off(other) <= off(&one)) {
                self.chosen.remove(i);
            } else {
                i += 1;
            }
        }
    }

    /// Bias of the centroid of dot `id`: its offset from the projection of the point, px, for the target at `X_CO`, because the projection
    /// of a disc's centre is not the centre of its image.
    #[must_use]
    pub fn bias_px(&self, id: u32, X_CO: &Pose) -> Vector2<f64> {
        let dot = self.dots.get(id as usize);
        dot.map_or(Vector2::zeros(), |(X_OF, disc)| {
            centre_offset(&(X_CO * X_OF), &self.camera, &disc.centre_m, disc.radius_m)
        })
    }

    /// The region nearest to a prediction, of those that are `alike`, in a window `margin` px larger than its ellipse, by `threshold`.
    fn region(
        &mut self,
        image: &ImageView<'_>,
        px: &Vector2<f64>,
        covariance: &[f64; 3],
        margin: f64,
        threshold: u8,
        alike: impl Fn(&Blob) -> bool,
    ) -> Option<Blob> {
        let [xx, _, yy] = covariance;
        let (half_x, half_y) = (2.0 * xx.max(0.0).sqrt() + margin, 2.0 * yy.max(0.0).sqrt() + margin);
        let window = Window::around(px.x, px.y, half_x, half_y, image);
        match invert(image, &window, &mut self.inverted) {
            Some(dark) => self.near_runs.find(&dark, &window, 255 - threshold),
            None => self.near_runs.find(image, &window, threshold),
        }
        self.near_components.find(&self.near_runs, &window, Connectivity::Eight);
        let distance = |b: &Blob| (b.x - px.x).hypot(b.y - px.y);
        let nearest = |a: &Blob, b: &Blob| distance(a).total_cmp(&distance(b));
        let regions = self.near_components.as_slice().iter();
        let whole = regions.clone().filter_map(Blob::of).filter(&alike).min_by(nearest);
        let runs = self.near_runs.as_slice();
        whole.or_else(|| regions.filter_map(|c| Blob::of(&filled(runs, c))).filter(alike).min_by(nearest))
    }

    /// Regions of the current runs, and the search among them.
    pub(super) fn search_runs(
        &mut self,
        image: &ImageView<'_>,
        look: SearchEffort,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        if self.runs.overflowed() {
            return Err(TargetStatus::NoMatch);
        }
        self.components.find(&self.runs, &Window::whole(image), Connectivity::Eight);
        self.search_regions(image, look, found)
    }

    /// From the current regions to blobs, the target among them, and centroids. With more effort than quick, blobs are thresholded individually, and
    /// only those that differ from their surroundings are used.
    pub(super) fn search_regions(
        &mut self,
        image: &ImageView<'_>,
        look: SearchEffort,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        let round = self.gather(image, look);
        let few = match self.pattern {
            DotPattern::FourDots(_) => FEW_CANDIDATES,
            DotPattern::Body(_) => FEW_OF_A_BODY,
            DotPattern::DotGrid(_) | DotPattern::Any | DotPattern::None => usize::MAX,
        };
        let cluttered = look == SearchEffort::Quick && round > few;
        if cluttered {
            self.gather(image, SearchEffort::Careful);
        }
        if self.candidates.len() < self.min_candidates {
            return Err(TargetStatus::TooFewRegions);
        }
        if look != SearchEffort::Quick {
            let mut candidates = std::mem::take(&mut self.candidates);
            if let DotPattern::DotGrid(lattice) = &mut self.pattern {
                lattice.thin(&mut candidates);
            }
            for (area, blob) in &mut candidates {
                *blob = self.settled(image, blob);
                *area = blob.area;
            }
            candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
            self.candidates = candidates;
        }
        self.pattern.find(&self.candidates, &mut self.chosen)?;
        if let Some(radius_m) = self.pattern.told_radius_m() {
            self.dots.iter_mut().for_each(|(_, disc)| disc.radius_m = radius_m);
        }
        let mut chosen = std::mem::take(&mut self.chosen);
        chosen.iter_mut().for_each(|(_, blob)| *blob = self.settled(image, blob));
        self.chosen = chosen;
        self.meter.measure(image, &self.chosen, found);
        // a region without contrast to its surroundings is no dot
        if found.len() == self.chosen.len() || self.pattern.serves_in_part(found.len()) {
            return Ok(());
        }
        found.clear();
        Err(TargetStatus::NoMatch)
    }

    /// Collects the blobs among the regions, the largest first. Returns their number.
    fn gather(&mut self, image: &ImageView<'_>, look: SearchEffort) -> usize {
        self.candidates.clear();
        let (mut round, mut holed) = (0, 0);
        for component in self.components.as_slice() {
            let mut blob = Blob::of(component);
            if blob.is_none()
                && look == SearchEffort::Filled
                && holed < MAX_HOLED
                && Blob::may_have_holes(component, MAX_FILLED)
            {
                holed += 1;
                let whole = filled(self.runs.as_slice(), component);
                blob = Blob::of(&whole).filter(|_| whole.m00 < MAX_FILLED * component.m00);
            }
            let Some(blob) = blob else { continue };
            round += 1;
            // of too many the largest are kept: specks go first
            let at = self.candidates.partition_point(|(area, _)| *area >= blob.area);
            if at < self.max_candidates
                && (look == SearchEffort::Quick || self.meter.stands_out(image, &blob))
            {
                self.candidates.insert(at, (blob.area, blob));
                self.candidates.truncate(self.max_candidates);
            }
        }
        round
    }

    /// Whether all thresholds of the frame are tried too. They are not for grids, of which local thresholds find 99 in 100.
    pub(super) fn insists(&self) -> bool {
        matches!(self.pattern, DotPattern::FourDots(_))
    }

    /// The region with the threshold half-way between its own dot and plate, as tracking uses it.
    fn settled(&mut self, image: &ImageView<'_>, blob: &Blob) -> Blob {
        let Some(level) = self.meter.middle(image, blob) else { return *blob };
        // chosen by hand, wider than in tracking: a threshold near either level may take half of a small dot
        let near = |b: &Blob| b.area > 0.4 * blob.area && b.area < 2.5 * blob.area;
        let place = Vector2::new(blob.x, blob.y);
        self.region(image, &place, &blob.covariance, 4.0, level as u8, near).unwrap_or(*blob)
    }
}

/// The pixels of a window with their levels inverted, in a buffer for the whole frame; `None` without such a buffer.
fn invert<'a>(image: &ImageView<'_>, window: &Window, buffer: &'a mut [u8]) -> Option<ImageView<'a>> {
    let width = image.width();
    if buffer.len() != image.pixels().len() {
        return None;
    }
    for y in window.y0..window.y1 {
        let part = y * width + window.x0..y * width + window.x1;
        let (Some(from), Some(to)) = (image.pixels().get(part.clone()), buffer.get_mut(part)) else { break };
        from.iter().zip(to).for_each(|(from, to)| *to = 255 - from);
    }
    ImageView::new(buffer, width, image.height()).ok()
}

/// Least distance from each dot's rim to a neighbour's, or to the plate's edge, in the dot's radii.
fn free_distances(target: &Target) -> Box<[f64]> {
    if let Target::DotBody(body) = target {
        let of = |i| Some((body.free_m(i) / body.dot(i)?.1.radius_m).clamp(0.1, 3.0)); // chosen as below
        return (0..body.points().len()).map_while(of).collect();
    }
    let (marks, plate) = (target.discs(), target.plate());
    let free = |(i, mark): (usize, &Disc)| {
        let (a, b) = (mark.centre_m - plate.low_m, plate.high_m - mark.centre_m);
        let mut least = a.x.min(a.y).min(b.x).min(b.y) - mark.radius_m;
        for (_, other) in marks.iter().enumerate().filter(|(j, _)| *j != i) {
            least = least.min((mark.centre_m - other.centre_m).norm() - mark.radius_m - other.radius_m);
        }
        // chosen by hand: dots that all but touch still need something between them; from three radii on more room does not help
        (least / mark.radius_m).clamp(0.1, 3.0)
    };
    marks.iter().enumerate().map(free).collect()
}
