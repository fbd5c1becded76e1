//! An axis: from values to places, and the values that are written beside it.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

/// Values from one end to the other, evenly or by their logarithms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

/// Least distance of the ends of a logarithmic axis from each other: a factor, so that one of 1, 2 and 5 lies between.
const MIN_FACTOR: f64 = 4.0;
/// Most decades of a logarithmic axis. Chosen: more cannot be read.
const MAX_DECADES: f64 = 18.0;

impl Axis {
    /// From `low` to `high`, with room where they are the same.
    #[must_use]
    pub fn linear(low: f64, high: f64) -> Self {
        if !(low.is_finite() && high.is_finite()) {
            return Self { low: 0.0, high: 1.0, log: false };
        }
        let middle = 0.5 * low + 0.5 * high;
        let half = (0.5 * high - 0.5 * low).max(1e-3 * middle.abs()).max(1e-9);
        Self { low: middle - half, high: middle + half, log: false }
    }

    /// From `low` to `high` by their logarithms; what is not positive has no place on it.
    #[must_use]
    pub fn logarithmic(low: f64, high: f64) -> Self {
        let high = if high.is_finite() && high > 0.0 { high.clamp(1e-250, 1e250) } else { 1.0 };
        let low = if low > 0.0 { low.min(high) } else { high };
        let low = low.max(high / 10f64.powf(MAX_DECADES));
        let room = (MIN_FACTOR * low / high).max(1.0).sqrt();
        Self { low: low / room, high: high * room, log: true }
    }

    /// The axis that shows these values: logarithmic where that is wanted.
    pub(super) fn of(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let usable = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if log { Self::logarithmic(low, high) } else { Self::linear(low, high) }
    }

    /// The ends.
    #[must_use]
    pub fn ends(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Longer by this share at both ends.
    #[must_use]
    pub fn widened(self, share: f64) -> Self {
        let (low, high) =
            if self.log { (self.low.log10(), self.high.log10()) } else { (self.low, self.high) };
        let margin = share * (high - low);
        let (low, high) = (low - margin, high + margin);
        if self.log {
            Self { low: 10f64.powf(low), high: 10f64.powf(high), ..self }
        } else {
            Self { low, high, ..self }
        }
    }

    /// Where a value lies: 0 at the low end, 1 at the high one. `None` for one that has no place.
    #[must_use]
    pub fn place(&self, value: f64) -> Option<f64> {
        let share = if self.log {
            if !(value > 0.0) {
                return None;
            }
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        share.is_finite().then_some(share)
    }

    /// Round values with their texts, about `wanted` of them and at least one.
    #[must_use]
    pub fn ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let wanted = wanted.clamp(1, 20);
        if self.log { self.log_ticks(wanted) } else { self.linear_ticks(wanted) }
    }

    fn linear_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let step = round_up((self.high - self.low) / (wanted as f64 + 1.0));
        let first = (self.low / step - 1e-9).ceil();
        (0..=2 * wanted)
            .map(|k| (first + k as f64) * step)
            .take_while(|v| *v <= self.high + 1e-9 * step)
            .map(|v| (v, fixed(v, step)))
            .collect()
    }

    fn log_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let decades = (self.high / self.low).log10();
        let inside = |v: &f64| *v >= self.low * 0.999 && *v <= self.high * 1.001;
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        if decades < 0.7 * wanted as f64 {
            let parts: &[f64] = if decades < 0.35 * wanted as f64 { &[1.0, 2.0, 5.0] } else { &[1.0] };
            let values = (first..=last).flat_map(|k| parts.iter().map(move |p| p * 10f64.powi(k)));
            let ticks: Vec<_> = values.filter(inside).map(|v| (v, short(v))).collect();
            if !ticks.is_empty() {
                return ticks;
            }
        }
        let every = (decades / wanted as f64).ceil().max(1.0) as i32;
        let powers = (first..=last).filter(|k| k.rem_euclid(every) == 0).map(|k| 10f64.powi(k));
        powers.filter(inside).map(|v| (v, short(v))).collect()
    }
}

/// The next of 1, 2, 5, 10, 20 ...
fn round_up(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= step * 0.999).unwrap_or(10.0 * power)
}

/// With as many digits as the step has.
fn fixed(value: f64, step: f64) -> String {
    if value.abs() < 1e-9 * step.abs() {
        return "0".into();
    }
    let digits = (-step.log10() + 1e-9).ceil().max(0.0) as usize;
    if digits <= 5 && value.abs() < 1e6 {
        return format!("{value:.digits$}");
    }
    // As many digits as tell neighbours apart.
    let power = |v: f64| v.abs().log10().floor() as i32;
    let digits = (power(value) - power(step * 1.001)).clamp(0, 9) as usize;
    format!("{value:.digits$e}")
}

/// Without digits that say nothing.
fn short(value: f64) -> String {
    if (1e-4..1e5).contains(&value.abs()) {
        let text = format!("{value:.4}");
        return text.trim_end_matches('0').trim_end_matches('.').into();
    }
    scientific(value)
}

fn scientific(value: f64) -> String {
    let text = format!("{value:.1e}");
    text.replace(".0e", "e")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn texts(axis: Axis, wanted: usize) -> Vec<String> {
        axis.ticks(wanted).into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn round_values_with_the_digits_they_need() {
        assert_eq!(
            texts(Axis::linear(0.0, 2.2), 5),
            ["0.0", "0.5", "1.0", "1.5", "2.0"].map(|t| t.replace("0.0", "0"))
        );
        assert_eq!(texts(Axis::linear(-30.0, 70.0), 4), ["-20", "0", "20", "40", "60"]);
        assert_eq!(texts(Axis::logarithmic(0.02, 300.0), 5), ["0.1", "1", "10", "100"]);
        assert_eq!(texts(Axis::logarithmic(1e-9, 1e3), 4), ["1e-9", "1e-6", "0.001", "1", "1000"]);
        assert_eq!(texts(Axis::logarithmic(2.0, 6.0), 5), ["2", "5"]);
    }

    #[test]
    fn a_quantity_that_does_not_change_has_an_axis() {
        let axis = Axis::linear(3.0, 3.0);
        assert_eq!(axis.place(3.0), Some(0.5));
        assert!(!axis.ticks(4).is_empty());
        assert_eq!(Axis::logarithmic(0.0, 0.0).place(0.0), None);
    }

    proptest! {
        #[test]
        fn ticks_lie_on_the_axis_and_are_not_too_many(a in -1e9..1e9f64, b in -1e9..1e9f64, n in 1usize..12, log in any::<bool>()) {
            let axis = Axis::of([a, b].into_iter(), log);
            let ticks = axis.ticks(n);
            prop_assert!(ticks.len() <= 2 * n + 4, "{ticks:?}");
            for (value, text) in &ticks {
                let place = axis.place(*value).unwrap();
                prop_assert!((-1e-3..=1.001).contains(&place), "{text} at {place}");
            }
            let mut all: Vec<_> = ticks.iter().map(|t| &t.1).collect();
            all.dedup();
            prop_assert_eq!(all.len(), ticks.len(), "each has a text of its own: {:?}", ticks);
        }
    }
}
