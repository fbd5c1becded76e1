//! Search of a whole frame with several thresholds, until the target is found.
//!
//! ```text
//! one for the frame (Otsu) ─► between local extremes: nearer to the darkest, nearer to the lightest, half-way
//!                         ─► a sweep over the frame's levels ─► the first and half-way again, holes filled
//! ```
//! The first is sufficient for most frames; each of the others is tried only after all before it have failed. The first is postponed until before
//! the sweep where it makes so many runs that they are mostly noise or texture.

use super::finder::{DotFinder, SearchEffort};
use crate::detect::Detection;
use crate::imaging::{Histogram, ImageView, Otsu, Window};
use crate::messages::TargetStatus;

/// Pixels that the histogram samples, in whole rows, and the fewest and the most of these. Chosen by hand: as many as 320 x 240 has, so that
/// large frames cost what small ones do; [`TAIL`] is 15 of them. Half would do for Otsu's threshold, but leave the sweep's ends to chance.
const SAMPLED_PIXELS: usize = 76_800;
const SAMPLED_ROWS: (usize, usize) = (60, 120);
/// Rows from whose neighbouring pixels the noise is estimated. Chosen by hand: 12 800 pairs of a frame 640 px wide, of which the median is known to 1 %.
const NOISE_ROWS: usize = 40;
/// Least contrast of a part of the frame in which something may be dark: so many times the noise, within these levels. Derived: extremes of
/// 300 000 normal deviates lie 9.2 deviations apart, so that noise alone makes hardly a region. The levels were chosen by hand: the least
/// difference of a dot that is measured, and what a dot has in any light.
const CONTRAST_SDS: f64 = 10.0;
const CONTRAST_LEVELS: (f64, f64) = (12.0, 80.0);
/// Noise and uneven light alone make no more contrast than this anywhere. Derived: extremes of a million normal deviates are further apart in one
/// frame of forty; the levels, for light, were chosen by hand.
const FLAT_SDS: f64 = 10.5;
const FLAT_LEVELS: f64 = 8.0;
/// Thresholds of the sweep. Chosen by hand: every other one first, 11, then those between; twice as many take twice the time of a search
/// that finds nothing, and the sweep begins where all else has found nothing.
const SWEEP: u32 = 21;
/// Share of the pixels that may be darker, or lighter, than the range of the sweep. Chosen by hand: a third of what four dots of 4 px radius have of a
/// frame of 640 x 480, so that a target is not cut off.
const TAIL: f64 = 2e-4;
/// Places of a threshold between the local extremes, in 256ths of their difference: the first show most targets, in the fewest runs. Chosen by
/// hand: near either end, since blur and uneven light leave most room there; half-way comes late, since noise of the ground makes most runs there.
const SHARES: [u8; 5] = [36, 184, 72, HALF, 220];
const HALF: u8 = 128;
/// Pixels for each run: with fewer, another threshold is likelier to show the target, and sooner. Small frames may have so many runs. Chosen by
/// hand: a scene has some runs a row, a row of noise one in four pixels; what is put off is searched later, so that it only changes the order.
const PIXELS_OF_RUN: usize = 64;
const FEW_RUNS: usize = 1000;

/// What a frame without a dot is called that nowhere differs from its own noise: where its darker and its lighter pixels are as far apart as dots in any light, a
/// pattern as fine as noise has filled it. Of samples with one level only, all pixels are looked at.
fn why_flat(dark: &ImageView<'_>, otsu: Option<&Otsu>) -> TargetStatus {
    let apart = otsu.map_or_else(
        || {
            let levels = || (0..dark.height()).flat_map(|y| dark.row(y).iter().copied());
            f64::from(levels().max().unwrap_or(0) - levels().min().unwrap_or(0))
        },
        |otsu| otsu.light_mean - otsu.dark_mean,
    );
    if apart >= CONTRAST_LEVELS.1 { TargetStatus::NoMatch } else { TargetStatus::NoContrast }
}

impl DotFinder {
    /// The search in `dark`, the frame in which dots are dark; they are measured in `image`.
    pub(super) fn search_dark(
        &mut self,
        dark: &ImageView<'_>,
        image: &ImageView<'_>,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        found.clear();
        let histogram = sampled(dark);
        let Some(otsu) = histogram.otsu() else { return Err(why_flat(dark, None)) };
        // what is put off may be the clearest image of a grid, of which not all thresholds are tried
        let few = (dark.width() * dark.height() / PIXELS_OF_RUN).max(FEW_RUNS);
        let most = if self.insists() { few } else { usize::MAX };
        self.runs.limit_to(most);
        self.runs.find(dark, &Window::whole(dark), otsu.threshold);
        self.runs.limit_to(usize::MAX);
        let put_off = self.insists() && self.runs.overflowed();
        let mut first = Err(TargetStatus::NoMatch);
        if !put_off {
            first = self.search_twice(image, found);
            if first.is_ok() {
                return first;
            }
        }

        // A threshold for the whole frame fails where light is uneven, and where the target is small: one between the local extremes
        // instead, and nothing where these are noise.
        let noise = noise(dark);
        let (least, most) = CONTRAST_LEVELS;
        let contrast = (CONTRAST_SDS * noise).clamp(least, most);
        let greatest = self.local.set(dark, contrast as u8, 0);
        if f64::from(greatest) < (FLAT_SDS * noise + FLAT_LEVELS).max(least) {
            let found = put_off && self.search_otsu(dark, image, otsu.threshold, found).is_ok();
            return if found { Ok(()) } else { Err(why_flat(dark, Some(&otsu))) };
        }
        // Two targets stay two, whatever else shows only one of them; but half-way, where blur spoils sizes least, has the last word.
        let mut ambiguous = first == Err(TargetStatus::Ambiguous);
        let mut second = Err(TargetStatus::NoMatch);
        for share in SHARES {
            if share != HALF && ambiguous {
                continue;
            }
            self.local.move_to(share);
            self.runs.find_local(dark, &mut self.local);
            let result = self.search_runs(image, SearchEffort::Careful, found);
            if result.is_ok() {
                return result;
            }
            ambiguous |= result == Err(TargetStatus::Ambiguous);
            if share == HALF {
                second = result;
            }
        }
        if ambiguous {
            return Err(TargetStatus::Ambiguous);
        }
        if put_off {
            first = self.search_otsu(dark, image, otsu.threshold, found);
            if first.is_ok() {
                return first;
            }
        }
        let reason = match (first, second) {
            (Err(TargetStatus::Ambiguous), _) => TargetStatus::Ambiguous,
            (Err(TargetStatus::TooFewRegions), Err(TargetStatus::TooFewRegions)) => {
                TargetStatus::TooFewRegions
            }
            _ => TargetStatus::NoMatch,
        };
        if !self.insists() || reason == TargetStatus::Ambiguous {
            return Err(reason);
        }
        match self.search_sweep(dark, image, &histogram, otsu.threshold, found) {
            Err(status) if status != TargetStatus::Ambiguous => Err(reason),
            result => result,
        }
    }

    /// The frame's own threshold, however many runs it makes.
    fn search_otsu(
        &mut self,
        dark: &ImageView<'_>,
        image: &ImageView<'_>,
        threshold: u8,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        self.runs.find(dark, &Window::whole(dark), threshold);
        self.search_twice(image, found)
    }

    /// The current runs as they are, and where there are dots but not what they should be, carefully: the threshold may have spoiled
    /// their sizes.
    fn search_twice(
        &mut self,
        image: &ImageView<'_>,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        match self.search_runs(image, SearchEffort::Quick, found) {
            Err(quick) if quick != TargetStatus::TooFewRegions && !self.runs.overflowed() => {
                self.search_regions(image, SearchEffort::Careful, found)
            }
            result => result,
        }
    }

    /// All thresholds of the frame, then holes filled.
    fn search_sweep(
        &mut self,
        dark: &ImageView<'_>,
        image: &ImageView<'_>,
        histogram: &Histogram,
        first: u8,
        found: &mut Vec<Detection>,
    ) -> Result<(), TargetStatus> {
        let window = Window::whole(dark);
        let (low, high) = tails(histogram);
        let mut tried = Tried::new(histogram, first);
        // every other one first
        for k in (1..=SWEEP).step_by(2).chain((2..=SWEEP).step_by(2)) {
            let threshold = (low + (high - low) * k / (SWEEP + 1)) as u8;
            if !tried.shows_more(threshold) {
                continue;
            }
            self.runs.find(dark, &window, threshold);
            let result = self.search_runs(image, SearchEffort::Careful, found);
            if matches!(result, Ok(()) | Err(TargetStatus::Ambiguous)) {
                return result;
            }
        }

        // Glare leaves holes in dots.
        self.runs.find(dark, &window, first);
        if self.search_runs(image, SearchEffort::Filled, found).is_ok() {
            return Ok(());
        }
        self.local.move_to(HALF);
        self.runs.find_local(dark, &mut self.local);
        self.search_runs(image, SearchEffort::Filled, found)
    }
}

/// Thresholds that were tried, and what they left on either side.
struct Tried<'a> {
    histogram: &'a Histogram,
    thresholds: [u8; SWEEP as usize + 1],
    count: usize,
    /// Pixels of the histogram between two thresholds that are too few to show anything else.
    few: f64,
}

impl<'a> Tried<'a> {
    fn new(histogram: &'a Histogram, first: u8) -> Self {
        let all: f64 = histogram.bins().iter().map(|&n| f64::from(n)).sum();
        Self { histogram, thresholds: [first; SWEEP as usize + 1], count: 1, few: TAIL * all }
    }

    /// Whether a threshold (pixels at most that level are dark) shows another image than each of those before it; it is then one of those.
    fn shows_more(&mut self, threshold: u8) -> bool {
        let bins = self.histogram.bins();
        let between = |other: u8| {
            let (low, high) = (usize::from(other.min(threshold)), usize::from(other.max(threshold)));
            bins.iter().take(high + 1).skip(low + 1).map(|&n| f64::from(n)).sum::<f64>()
        };
        if self.thresholds.iter().take(self.count).any(|&other| between(other) <= self.few) {
            return false;
        }
        if let Some(slot) = self.thresholds.get_mut(self.count) {
            *slot = threshold;
            self.count += 1;
        }
        true
    }
}

/// A fair sample of the frame's levels.
fn sampled(image: &ImageView<'_>) -> Histogram {
    let (fewest, most) = SAMPLED_ROWS;
    let rows = (SAMPLED_PIXELS / image.width()).clamp(fewest, most);
    Histogram::of_rows(image, image.height() / rows)
}

/// Standard deviation of the pixels' noise, levels: by the median of neighbours' differences, of which most are on even ground.
fn noise(image: &ImageView<'_>) -> f64 {
    let mut counts = [0u32; 256];
    let step = (image.height() / NOISE_ROWS).max(1);
    for y in (step / 2..image.height()).step_by(step) {
        for pair in image.row(y).as_chunks::<2>().0 {
            counts[usize::from(pair[0].abs_diff(pair[1]))] += 1;
        }
    }
    let half = 0.5 * counts.iter().map(|&n| f64::from(n)).sum::<f64>();
    let mut below = 0.0;
    for (difference, &count) in (0u32..).zip(&counts) {
        let count = f64::from(count);
        if below + count > half {
            // a difference of 0 is one of less than a half, one of d lies within a half of d
            let (from, width) = if difference == 0 { (0.0, 0.5) } else { (f64::from(difference) - 0.5, 1.0) };
            let median = from + width * (half - below) / count;
            return median / (0.674_49 * std::f64::consts::SQRT_2);
        }
        below += count;
    }
    0.0
}

/// Levels below and above which few pixels lie.
fn tails(histogram: &Histogram) -> (u32, u32) {
    let bins = histogram.bins();
    let few = TAIL * bins.iter().map(|&n| f64::from(n)).sum::<f64>();
    let beyond = |sum: &mut f64, &n: &u32| {
        *sum += f64::from(n);
        Some(*sum)
    };
    let low = bins.iter().scan(0.0, beyond).take_while(|sum| *sum <= few).count();
    let high = bins.iter().rev().scan(0.0, beyond).take_while(|sum| *sum <= few).count();
    (low.min(255) as u32, 255_usize.saturating_sub(high).max(low.min(255)) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{CameraModel, Distortion, Intrinsics};
    use crate::linalg::Random;
    use crate::target::{DotGrid, FourDots};

    #[test]
    fn noise_is_told_beside_edges() {
        let mut random = Random::new(2);
        for sd in [0.5, 1.0, 3.0, 8.0] {
            let pixels: Vec<u8> = (0..320 * 240)
                .map(|i| (if i / 20 % 2 == 0 { 60.0 } else { 190.0 } + sd * random.gaussian()).round() as u8)
                .collect();
            let got = noise(&ImageView::new(&pixels, 320, 240).unwrap());
            assert!((got / sd - 1.0).abs() < 0.25, "{got} of {sd}");
        }
        assert!(noise(&ImageView::new(&[7; 100], 10, 10).unwrap()) < 0.5);
        assert_eq!(noise(&ImageView::new(&[7], 1, 1).unwrap()), 0.0);
    }

    #[test]
    fn tails_hold_few_pixels() {
        let mut pixels = vec![100u8; 9998];
        pixels.extend([3, 250]);
        let (low, high) = tails(&Histogram::of(&ImageView::new(&pixels, 10_000, 1).unwrap()));
        assert_eq!((low, high), (100, 100));
        pixels.extend([50; 400]);
        let (low, high) = tails(&Histogram::of(&ImageView::new(&pixels, 10_400, 1).unwrap()));
        assert_eq!((low, high), (50, 100));
    }

    #[test]
    fn black_and_white_patterns_have_contrast() {
        let mut random = Random::new(4);
        let noise: Vec<bool> = (0..640 * 480).map(|_| random.uniform() < 0.5).collect();
        let camera = CameraModel::new(
            Intrinsics {
                fx_px: 600.0,
                fy_px: 600.0,
                cx_px: 320.0,
                cy_px: 240.0,
                width_px: 640,
                height_px: 480,
            },
            Distortion::default(),
        )
        .unwrap();
        let status = |white: &dyn Fn(usize) -> bool, range: [u8; 2]| {
            let pixels: Vec<u8> = (0..640 * 480).map(|i| range[usize::from(white(i))]).collect();
            let image = ImageView::new(&pixels, 640, 480).unwrap();
            for target in [FourDots::default().into(), DotGrid::with_pitch(7, 5, 0.03).unwrap().into()] {
                let mut finder = DotFinder::new(camera, &target, false);
                let status = finder.search(&image, &mut Vec::new()).unwrap_err();
                assert_eq!(status == TargetStatus::NoContrast, range[1] < 100, "{status:?}");
            }
        };
        for range in [[0, 255], [0, 4]] {
            status(&|i| noise[i], range);
            status(&|i| i % 2 == 0, range);
            status(&|i| i / 640 % 2 == 0, range);
        }
    }
}
