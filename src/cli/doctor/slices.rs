//! Two programs that took turns on one machine: which is later?
//!
//! The tail of all wake-ups together is that of the one slice in which the host did something else. So each slice gives its
//! own quantile, the median slice speaks for the program, and the spread between slices says what a difference is worth.

use std::fmt;

/// One quantile of a program over its slices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Median {
    /// Of the median slice.
    pub median: f64,
    /// Interquartile range of the slices: half of them lie within so much.
    pub spread: f64,
}

/// What a comparison comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SliceComparison {
    /// The first is later than the second.
    Later,
    /// The first is earlier than the second.
    Earlier,
    /// Nothing that the slices of either do not differ by among themselves.
    NoDifference,
}

impl fmt::Display for SliceComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Later => "later",
            Self::Earlier => "earlier",
            Self::NoDifference => "no difference beyond the spread",
        })
    }
}

/// The quantile `share` (0 to 1) of each slice, and of these the median and the spread; `None` where a slice is empty or
/// there is none.
#[must_use]
pub fn median_slice(slices: &[Vec<f64>], share: f64) -> Option<Median> {
    let of_each: Option<Vec<f64>> = slices.iter().map(|slice| at(&sorted(slice), share)).collect();
    let of_each = sorted(&of_each?);
    let quartile = |share| between(&of_each, share);
    Some(Median { median: quartile(0.5)?, spread: quartile(0.75)? - quartile(0.25)? })
}

/// A difference counts only when it exceeds the spread of both and the `resolution` of what was measured.
#[must_use]
pub fn compare(ours: Median, theirs: Median, resolution: f64) -> SliceComparison {
    let worth = ours.spread.max(theirs.spread).max(resolution);
    match ours.median - theirs.median {
        difference if difference > worth => SliceComparison::Later,
        difference if difference < -worth => SliceComparison::Earlier,
        _ => SliceComparison::NoDifference,
    }
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values
}

/// The smallest value that a share `share` of all does not exceed.
fn at(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}

/// The quantile with linear interpolation between neighbours: slices are few.
fn between(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * (sorted.len().checked_sub(1)?) as f64;
    let (low, high) = (sorted.get(place as usize)?, sorted.get(place.ceil() as usize)?);
    Some(low + (high - low) * place.fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slices of 1000 wake-ups: `usual`, and the last two of each as late as told.
    fn slices(usual: f64, late: &[f64]) -> Vec<Vec<f64>> {
        late.iter().map(|late| [vec![*late; 2], vec![usual; 998]].concat()).collect()
    }

    #[test]
    fn one_stall_of_the_host_changes_nothing() {
        let calm = slices(10.0, &[90.0, 92.0, 94.0, 96.0, 98.0, 100.0, 102.0, 104.0]);
        let mut stalled = calm.clone();
        stalled[3] = vec![5_000.0; 1000];
        let (a, b) = (median_slice(&calm, 0.999).unwrap(), median_slice(&stalled, 0.999).unwrap());
        assert_eq!((a.median, a.spread), (97.0, 7.0));
        assert!((b.median - a.median).abs() <= 2.0 && b.spread < 10.0, "{b:?}");
        assert_eq!(compare(b, a, 0.0), SliceComparison::NoDifference);
        assert_eq!(median_slice(&calm, 0.5), Some(Median { median: 10.0, spread: 0.0 }));
    }

    #[test]
    fn what_exceeds_the_spread_of_both_is_a_difference() {
        let at = |median, spread| Median { median, spread };
        assert_eq!(compare(at(20.0, 3.0), at(10.0, 9.0), 0.0), SliceComparison::Later);
        assert_eq!(compare(at(10.0, 3.0), at(20.0, 9.0), 0.0), SliceComparison::Earlier);
        assert_eq!(compare(at(20.0, 3.0), at(10.0, 10.0), 0.0), SliceComparison::NoDifference);
        assert_eq!(compare(at(20.0, 10.0), at(10.0, 3.0), 0.0), SliceComparison::NoDifference);
        assert_eq!(
            compare(at(1.4, 0.0), at(0.5, 0.0), 1.0),
            SliceComparison::NoDifference,
            "whole microseconds"
        );
    }

    #[test]
    fn nothing_is_said_of_nothing() {
        assert_eq!(median_slice(&[], 0.5), None);
        assert_eq!(median_slice(&[vec![1.0], vec![]], 0.5), None);
        assert_eq!(median_slice(&[vec![1.0]], 0.5), Some(Median { median: 1.0, spread: 0.0 }));
    }
}
