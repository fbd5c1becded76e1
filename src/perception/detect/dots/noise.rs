//! Levels of a dot and of the plate around it, and the noise of the pixels on the rim, from that inside dots and on the plate.

use super::light::LightFit;
use super::ring::{RING, Ring};
use crate::imaging::MAX_LEVEL;

/// A dot whose roughness (squared difference of neighbours) exceeds that of the others so many times, and by so much, is
/// partly occluded or structured, and not used for the noise. Chosen by hand: the mean of 30 squared differences has a relative deviation of about 0.3,
/// so that noise alone does not reach five times; the level counts where there is no noise but rounding. Half leaves out dots of structured paper,
/// the double lets glare enlarge the noise.
const ROUGH_TIMES: f64 = 5.0;
const ROUGH_LEVELS2: f64 = 1.0;
/// Variance inside dots over that on the plate, at most: more is blur. Chosen by hand: 100 pixels determine a variance to a seventh.
const MAX_INSIDE: f64 = 1.15;
/// Levels as near as this many deviations to the greatest have lost some of their noise by clipping. Derived: at two 4 % of its variance, at one a
/// quarter, at four nothing.
const CUT_SDS: f64 = 2.0;

/// From this share on of the places where the light would be measured at the end of levels it is not measured there. Chosen by hand: three points
/// of a ring are a glint; half of it takes glints for a clipped plate, the double fits a light to plates that are clipped on one side.
const CLIPPED_SHARE: f64 = 0.125;

/// Levels of one dot and its surroundings, before its centroid is computed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Levels {
    pub(super) dot: f64,
    pub(super) plate: f64,
    /// Sum of squared differences of neighbours inside the dot, and their number.
    pub(super) rough: u32,
    pub(super) pairs: u32,
    pub(super) ring: Ring,
}

impl Levels {
    /// Mean squared difference of neighbours.
    pub(super) fn roughness(&self) -> f64 {
        f64::from(self.rough) / f64::from(self.pairs.max(1))
    }

    pub(super) fn contrast(&self) -> f64 {
        (self.plate - self.dot).abs()
    }
}

/// Whether the plate, or dots that are lighter, are at the end of levels, so that nobody knows how light they are, and how light changes over them.
pub(super) fn is_clipped(levels: &[Option<Levels>], light_on_dark: bool, noise: f64) -> bool {
    // of levels without noise rounding takes a half
    let full = MAX_LEVEL - (CUT_SDS * noise).max(0.5);
    let (mut clipped, mut all) = (0, 0);
    for levels in levels.iter().flatten() {
        let (over, count) = if light_on_dark {
            (usize::from(levels.dot >= full), 1)
        } else {
            (levels.ring.levels().filter(|level| *level >= full).count(), levels.ring.count())
        };
        (clipped, all) = (clipped + over, all + count);
    }
    clipped as f64 > CLIPPED_SHARE * all as f64
}

/// Noise of pixels on the rim, between those inside dots and on the plate. Blur makes small dots uneven inside; the plate may show
/// more than the dots where light itself is noisy. A plate, or dots, as light as levels go show none of it.
pub(super) fn common_noise(
    inside: f64,
    levels: &[Option<Levels>],
    rests: &[[f64; RING]],
    light: &LightFit,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (levels, rest) in levels.iter().zip(rests) {
        let Some(ring) = levels.as_ref().map(|l| &l.ring).filter(|ring| ring.pixels > 1) else { continue };
        for (variance, rest) in ring.variance.iter().zip(rest) {
            let (variance, one) = if rest.is_nan() { (0.0, 0.0) } else { (*variance, 1.0) };
            sum += variance;
            count += one;
        }
    }
    let (a, b) = (inside * inside, if count > 0.0 { sum / count } else { light.variance });
    let cut = |level: fn(&Levels) -> f64, variance: f64| {
        let full = |l: &&Levels| level(l) > MAX_LEVEL - CUT_SDS * variance.sqrt();
        2 * levels.iter().flatten().filter(full).count() > levels.iter().flatten().count()
    };
    let many = count >= RING as f64 || light.samples >= RING;
    if !many || cut(|l| l.plate, a) {
        inside
    } else if cut(|l| l.dot, b) {
        b.sqrt()
    } else {
        (0.5 * (a.min(MAX_INSIDE * b) + b)).sqrt()
    }
}

/// Standard deviation of the pixels' noise, grey levels: neighbours differ by twice its variance. Rough (occluded) dots
/// are left out, relative to the smoothest quarter. Also returns the roughness from which on dots are left out.
pub(super) fn noise_of(levels: &[Option<Levels>], roughness: &mut Vec<f64>) -> (f64, f64) {
    roughness.clear();
    roughness.extend(levels.iter().flatten().map(Levels::roughness));
    roughness.sort_unstable_by(f64::total_cmp);
    let Some(quarter) = roughness.get(roughness.len() / 4) else { return (0.0, f64::INFINITY) };
    let most = ROUGH_TIMES * quarter + ROUGH_LEVELS2;
    let (mut rough, mut pairs) = (0.0, 0.0);
    for level in levels.iter().flatten().filter(|l| l.roughness() <= most) {
        rough += f64::from(level.rough);
        pairs += f64::from(level.pairs);
    }
    ((rough / (2.0 * pairs.max(1.0))).sqrt(), most)
}
