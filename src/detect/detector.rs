//! Search of the whole frame, and tracking in windows.

use super::blob::Blob;
use super::dot::{Dot, DotMeter};
use super::identity::{Choice, Fit, Identity};
use crate::camera_model::CameraModel;
use crate::imaging::{Components, Connectivity, Histogram, ImageView, LocalThreshold, Runs, Window};
use crate::messages::TargetStatus;
use crate::target::DotTarget;
use nalgebra::Vector2;

/// Most regions among which the target is looked for: 1820 choices of four.
const MOST_CANDIDATES: usize = 16;
/// Choices that may fit; more of them are no clear picture.
const MOST_FITS: usize = 64;
/// Rows that the histogram samples.
const SAMPLED_ROWS: usize = 120;
/// Least difference between the classes of a threshold, grey levels.
const LEAST_CONTRAST: f64 = 12.0;
/// Least separability of the classes: one Gaussian has 0.64, a uniform ramp 0.75.
const LEAST_SEPARABILITY: f64 = 0.76;

/// Where a dot should be, and how it should look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
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

/// Finds the target. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct Detector {
    runs: Runs,
    components: Components,
    local: LocalThreshold,
    identity: Identity,
    meter: DotMeter,
    candidates: Vec<(f64, Blob)>,
}

impl Detector {
    /// A detector for frames of `camera` and one target.
    #[must_use]
    pub fn new(camera: CameraModel, target: &DotTarget) -> Self {
        let i = camera.intrinsics();
        let limit = (i.width_px as usize * i.height_px as usize / 16).max(4096);
        let radii = target.radii_m();
        // free distance around P1, and around the others, in their radii
        let gap =
            |radius: f64| (target.margin_m() - radius).min(target.side_m() - radius - radii[0]) / radius;
        Self {
            runs: Runs::with_limit(limit),
            components: Components::with_limit(limit),
            local: LocalThreshold::with_size(i.width_px as usize, i.height_px as usize),
            identity: Identity::new(camera, target),
            meter: DotMeter::new(gap(radii[0]).min(gap(radii[1])).clamp(0.1, 2.0)),
            candidates: Vec::with_capacity(MOST_CANDIDATES + 1),
        }
    }

    /// Searches the whole frame.
    ///
    /// # Errors
    /// The status that says why there is no target; never [`TargetStatus::Found`] or `WrongSize`.
    pub fn search(&mut self, image: &ImageView<'_>) -> Result<[Dot; 4], TargetStatus> {
        let histogram = Histogram::of_rows(image, image.height() / SAMPLED_ROWS);
        let Some(otsu) = histogram.otsu() else { return Err(TargetStatus::NoContrast) };
        let window = Window::whole(image);
        self.runs.find(image, &window, otsu.threshold);
        let global = self.search_runs(image, &window);
        let Err(first) = global else { return global };
        // A threshold for the whole frame fails where light is uneven: half-way between the local extremes instead.
        // Contrast of a few times the noise, which is at most the dark class's own spread.
        let contrast = (0.25 * (otsu.light_mean - otsu.dark_mean)).clamp(30.0, 80.0) as u8;
        self.local.set(image, contrast, otsu.threshold);
        self.runs.find_local(image, &mut self.local);
        let local = self.search_runs(image, &window);
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

    /// Looks for the dots where they are expected, in their order P1..P4. `None` when one of them is not there alone
    /// and whole, or they do not form the target.
    pub fn track(&mut self, image: &ImageView<'_>, expected: &[Expected; 4]) -> Option<[Dot; 4]> {
        let mut blobs = [None; 4];
        for (blob, dot) in blobs.iter_mut().zip(expected) {
            let [xx, _, yy] = dot.covariance_px2;
            let margin = 3.0 + dot.slack_px;
            let (half_x, half_y) = (2.0 * xx.max(0.0).sqrt() + margin, 2.0 * yy.max(0.0).sqrt() + margin);
            let window = Window::around(dot.px.x, dot.px.y, half_x, half_y, image);
            self.runs.find(image, &window, dot.threshold);
            self.components.find(&self.runs, &window, Connectivity::Eight);
            let distance = |b: &Blob| (b.x - dot.px.x).hypot(b.y - dot.px.y);
            *blob = self
                .components
                .as_slice()
                .iter()
                .filter_map(Blob::of)
                .filter(|b| b.area > 0.5 * dot.area_px2 && b.area < 2.0 * dot.area_px2)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        }
        let [Some(a), Some(b), Some(c), Some(d)] = blobs else { return None };
        let blobs = [a, b, c, d];
        if !self.identity.confirm(&blobs) {
            return None;
        }
        self.meter.measure(image, &blobs)
    }

    /// Regions of the current runs, the ellipses among them, the four that are the target, their centroids.
    fn search_runs(&mut self, image: &ImageView<'_>, window: &Window) -> Result<[Dot; 4], TargetStatus> {
        if self.runs.overflowed() {
            return Err(TargetStatus::TooFewRegions);
        }
        self.components.find(&self.runs, window, Connectivity::Eight);
        self.candidates.clear();
        for component in self.components.as_slice() {
            let Some(blob) = Blob::of(component) else { continue };
            // of too many the largest are kept: specks go first
            let at = self.candidates.partition_point(|(area, _)| *area >= blob.area);
            if at < MOST_CANDIDATES {
                self.candidates.insert(at, (blob.area, blob));
                self.candidates.truncate(MOST_CANDIDATES);
            }
        }
        let fit = self.best_choice()?;
        self.meter.measure(image, &fit.blobs).ok_or(TargetStatus::NoMatch)
    }

    /// The best of all choices of four candidates.
    fn best_choice(&self) -> Result<Fit, TargetStatus> {
        let candidates = &self.candidates;
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
                        match self.identity.choose(&[*a, *b, *c, *d]) {
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
}
