//! Threshold at the valley between two modes of the histogram, as Sect. 10.2.1 chooses it.
//!
//! For dark objects the background is the mode furthest to the light, and the threshold the least frequent level between it and the
//! next mode to the dark; for light objects the other way about. Modes of a noisy histogram: it is smoothed, and a peak counts when
//! it stands out by a share of the greatest one.

use super::{Histogram, Polarity};

/// Passes of the binomial filter `[1 2 1] / 4`. Derived: each has a variance of 1/2, so that together they have a standard deviation of 2 levels.
const SMOOTHING: usize = 8;

/// A threshold between two modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Valley {
    /// Greatest level of the dark side.
    pub threshold: u8,
    /// Level of the background's mode.
    pub background: u8,
    /// Level of the next mode, that of objects.
    pub object: u8,
}

impl Histogram {
    /// Number of pixels.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.bins().iter().map(|&n| u64::from(n)).sum()
    }

    /// The normalized histogram: the share of each level. All zero without pixels.
    #[must_use]
    pub fn normalized(&self) -> [f64; 256] {
        let scale = 1.0 / self.count().max(1) as f64;
        self.bins().map(|n| f64::from(n) * scale)
    }

    /// The valley beside the background's mode. `min_prominence`, 0..=1, says how far a peak of the smoothed histogram must rise
    /// above the valleys on both sides, as a share of the greatest peak, to be a mode: 0.02 is a start; small objects need less,
    /// noise more. `None` with fewer than two modes.
    #[must_use]
    pub fn valley(&self, polarity: Polarity, min_prominence: f64) -> Option<Valley> {
        let smooth = smoothed(&self.normalized());
        let least = smooth.iter().fold(0.0, |a: f64, &b| a.max(b)) * min_prominence.clamp(0.0, 1.0);
        let mut modes = (0..256).filter(|&level| is_mode(&smooth, level, least));
        let (background, object) = match polarity {
            Polarity::Dark => {
                let mut modes = modes.rev();
                (modes.next()?, modes.next()?)
            }
            Polarity::Light => (modes.next()?, modes.next()?),
        };
        let (low, high) = (background.min(object), background.max(object));
        let between = smooth.get(low..high)?;
        let lowest = between.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        // the middle of where it is lowest: often there is nothing at all
        let first = between.iter().position(|&v| v <= lowest)?;
        let last = between.iter().rposition(|&v| v <= lowest)?;
        Some(Valley {
            threshold: (low + (first + last) / 2) as u8,
            background: background as u8,
            object: object as u8,
        })
    }
}

fn smoothed(shares: &[f64; 256]) -> [f64; 256] {
    let mut smooth = *shares;
    for _ in 0..SMOOTHING {
        let mut before = 0.0;
        for i in 0..256 {
            let behind = smooth.get(i + 1).copied().unwrap_or(0.0);
            let own = smooth[i];
            smooth[i] = 0.25 * before + 0.5 * own + 0.25 * behind;
            before = own;
        }
    }
    smooth
}

/// Whether there is a peak at the level, the first of its plateau, that stands out by more than `least`.
fn is_mode(h: &[f64; 256], level: usize, least: f64) -> bool {
    let Some((darker, [top, lighter @ ..])) = h.split_at_checked(level) else { return false };
    let left = descent(*top, darker.iter().rev(), true);
    let right = descent(*top, lighter.iter(), false);
    *top > 0.0 && left.min(right) > 0.0 && left.min(right) >= least
}

/// By how much `values`, which lead away from a peak of height `top`, fall before something higher comes; all of `top` where nothing does,
/// because beyond the ends of a histogram there is nothing. With `equal_ends` something as high ends the descent too.
fn descent<'a>(top: f64, values: impl Iterator<Item = &'a f64>, equal_ends: bool) -> f64 {
    let mut lowest = top;
    for &v in values {
        if v > top || (equal_ends && v == top) {
            return top - lowest;
        }
        lowest = lowest.min(v);
    }
    top
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::ImageView;
    use proptest::prelude::*;

    fn histogram(pixels: &[u8]) -> Histogram {
        Histogram::of(&ImageView::new(pixels, pixels.len(), 1).unwrap())
    }

    /// Three bumps of different sizes.
    fn bumps(modes: &[(i32, i32, usize)]) -> Histogram {
        let mut pixels = Vec::new();
        let mut state = 1u64;
        for &(middle, spread, count) in modes {
            for _ in 0..count {
                let mut sum = 0;
                for _ in 0..4 {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    sum += (state >> 33) as i32 % (2 * spread + 1) - spread;
                }
                pixels.push((middle + sum / 2).clamp(0, 255) as u8);
            }
        }
        histogram(&pixels)
    }

    #[test]
    fn the_threshold_lies_beside_the_background() {
        // dark object, light object, background in between: as Fig. 10.1
        let h = bumps(&[(40, 8, 3000), (140, 8, 9000), (220, 8, 1500)]);
        let dark = h.valley(Polarity::Dark, 0.02).unwrap();
        assert!(dark.background.abs_diff(220) < 5 && dark.object.abs_diff(140) < 5, "{dark:?}");
        assert!((155..205).contains(&dark.threshold), "{dark:?}");
        let light = h.valley(Polarity::Light, 0.02).unwrap();
        assert!(light.background.abs_diff(40) < 5 && light.object.abs_diff(140) < 5, "{light:?}");
        assert!((56..124).contains(&light.threshold), "{light:?}");
        // the smallest peak is left out
        let most = h.valley(Polarity::Dark, 0.25).unwrap();
        assert!(most.background.abs_diff(140) < 5 && most.object.abs_diff(40) < 5, "{most:?}");
        assert_eq!(h.valley(Polarity::Dark, 0.9), None);
    }

    #[test]
    fn two_levels_are_split_half_way() {
        for (a, b) in [(0, 255), (10, 60), (100, 112)] {
            let valley = histogram(&[[a; 90], [b; 90]].concat()).valley(Polarity::Dark, 0.02).unwrap();
            assert!(valley.threshold.abs_diff(a / 2 + b / 2) <= 2, "{valley:?}");
            assert!(valley.object.abs_diff(a) <= 1 && valley.background.abs_diff(b) <= 1, "{valley:?}");
        }
    }

    #[test]
    fn one_mode_has_no_valley() {
        assert_eq!(Histogram::default().valley(Polarity::Dark, 0.0), None);
        assert_eq!(histogram(&[255; 9]).valley(Polarity::Light, 0.0), None);
        assert_eq!(bumps(&[(128, 20, 9000)]).valley(Polarity::Dark, 0.1), None);
        assert_eq!(histogram(&(0..=255).collect::<Vec<_>>()).valley(Polarity::Dark, 0.0), None);
    }

    proptest! {
        #[test]
        fn modes_are_on_both_sides(pixels in prop::collection::vec(any::<u8>(), 1..300), least in -0.5..1.5) {
            let h = histogram(&pixels);
            prop_assert!((h.normalized().iter().sum::<f64>() - 1.0).abs() < 1e-9);
            prop_assert_eq!(h.count(), pixels.len() as u64);
            if let Some(v) = h.valley(Polarity::Dark, least) {
                prop_assert!(v.object <= v.threshold && v.threshold < v.background);
                let light = h.valley(Polarity::Light, least).unwrap();
                prop_assert!(light.background <= light.threshold && light.threshold < light.object);
                prop_assert!(light.background <= v.object && v.background >= light.object);
            }
            prop_assert_eq!(h.valley(Polarity::Dark, f64::NAN), h.valley(Polarity::Dark, f64::NAN));
        }
    }
}
