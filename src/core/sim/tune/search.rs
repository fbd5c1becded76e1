//! The search: few trials, several at a time.

/// Places over the range of a key at the beginning, both ends among them. Chosen so that four, then twice halfway to the neighbours, leave a twelfth of the range
/// between trials; with two keys that is 21 trials less than a twentieth of a grid of 21 by 21.
const PLACES: usize = 4;
/// How often the distance to the neighbours is halved.
const HALVINGS: usize = 2;

/// A key that is searched.
#[derive(Debug, Clone, PartialEq)]
pub struct TuneKey {
    /// Its place in the run file: `servo.gain_1_s`.
    pub name: String,
    /// Least and greatest value.
    pub range: (f64, f64),
}

impl TuneKey {
    /// Gains act by their ratios: where the range allows it, distances are those of logarithms.
    fn scaled(&self, value: f64) -> f64 {
        if self.range.0 > 0.0 { value.ln() } else { value }
    }

    fn value(&self, scaled: f64) -> f64 {
        let value = if self.range.0 > 0.0 { scaled.exp() } else { scaled };
        // four digits are enough for what a person reads in a run file; the bound only keeps the logarithm of 0 away, chosen by hand
        let digits = 10_f64.powf(3.0 - value.abs().max(1e-9).log10().floor());
        ((value * digits).round() / digits).clamp(self.range.0, self.range.1)
    }

    /// The value at a share of the range, 0 to 1.
    #[must_use]
    pub fn at(&self, share: f64) -> f64 {
        self.value(self.scaled(self.range.0) + share * self.length())
    }

    fn length(&self) -> f64 {
        self.scaled(self.range.1) - self.scaled(self.range.0)
    }
}

/// Searches from `start` on for the values of `keys` whose cost is least. `evaluate` gives the costs of several values at once. All that was tried,
/// in order; the first is `start`.
pub fn search(
    keys: &[TuneKey],
    start: &[f64],
    evaluate: &mut dyn FnMut(&[Vec<f64>]) -> Vec<f64>,
) -> Vec<(Vec<f64>, f64)> {
    let mut tried: Vec<(Vec<f64>, f64)> = Vec::new();
    let mut try_all = |tried: &mut Vec<(Vec<f64>, f64)>, candidates: Vec<Vec<f64>>| {
        let mut new: Vec<Vec<f64>> = Vec::new();
        for candidate in candidates {
            if !new.contains(&candidate) && tried.iter().all(|(values, _)| *values != candidate) {
                new.push(candidate);
            }
        }
        let costs = if new.is_empty() { Vec::new() } else { evaluate(&new) };
        tried.extend(new.into_iter().zip(costs));
    };
    try_all(&mut tried, vec![start.to_vec()]);
    for (k, key) in keys.iter().enumerate() {
        let step = key.length() / (PLACES - 1) as f64;
        let places = (0..PLACES).map(|i| with(&best(&tried), k, key.at(i as f64 / (PLACES - 1) as f64)));
        let places = places.collect();
        try_all(&mut tried, places);
        for halving in 1..=HALVINGS {
            let neighbours = around(&best(&tried), k, key, step / f64::from(1 << halving as u32));
            try_all(&mut tried, neighbours);
        }
    }
    for (k, key) in keys.iter().enumerate() {
        let step = key.length() / (PLACES - 1) as f64 / f64::from(1 << HALVINGS as u32);
        // The last key was searched with the values of the others.
        if k + 1 < keys.len() {
            let neighbours = around(&best(&tried), k, key, step);
            try_all(&mut tried, neighbours);
        }
        let between = towards_the_better(&tried, k, key);
        try_all(&mut tried, between.into_iter().collect());
    }
    tried
}

/// Halfway from the best values to the better of their nearest neighbours along the key `k`; `None` where it has none on both sides.
fn towards_the_better(tried: &[(Vec<f64>, f64)], k: usize, key: &TuneKey) -> Option<Vec<f64>> {
    let best = best(tried);
    let here = key.scaled(*best.get(k)?);
    let on_line = tried.iter().filter(|(values, _)| with(values, k, 0.0) == with(&best, k, 0.0));
    let line: Vec<(f64, f64)> =
        on_line.filter_map(|(values, cost)| Some((key.scaled(*values.get(k)?) - here, *cost))).collect();
    let below = line.iter().filter(|(x, _)| *x < 0.0).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let above = line.iter().filter(|(x, _)| *x > 0.0).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let better = if below.1 < above.1 { below.0 } else { above.0 };
    Some(with(&best, k, key.value(here + 0.5 * better)))
}

/// The values that cost least.
fn best(tried: &[(Vec<f64>, f64)]) -> Vec<f64> {
    let least = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    least.map_or_else(Vec::new, |(values, _)| values.clone())
}

fn with(values: &[f64], k: usize, value: f64) -> Vec<f64> {
    values.iter().enumerate().map(|(i, v)| if i == k { value } else { *v }).collect()
}

fn around(values: &[f64], k: usize, key: &TuneKey, step: f64) -> Vec<Vec<f64>> {
    let Some(here) = values.get(k).map(|v| key.scaled(*v)) else { return Vec::new() };
    [here - step, here + step].map(|scaled| with(values, k, key.value(scaled))).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    fn key(name: &str, low: f64, high: f64) -> TuneKey {
        TuneKey { name: name.into(), range: (low, high) }
    }

    /// Settling time of a loop with delay: slow where the gain is low, swinging where it is high; the tail has a gain of its own.
    fn settling(gain: f64, tail: f64, delay_s: f64, share: f64) -> f64 {
        let swing = (gain * delay_s - 0.5).max(0.0);
        let tail_swing = (tail * delay_s - 0.6).max(0.0);
        if gain * delay_s > 1.5 {
            return 1e6 + gain;
        }
        0.3 + (1.0 - share) * 4.0 / gain + share * 4.0 / tail + 3.0 * swing + 5.0 * tail_swing
    }

    /// The search is not a grid: 98 of 100 loops are within a tenth of the best of one, all within a fifth.
    #[test]
    fn within_a_tenth_of_a_full_grid_in_a_twentieth() {
        let mut random = Random::new(3);
        let mut beyond = 0;
        for _ in 0..2000 {
            let (delay_s, share) = (random.between(0.01, 0.2), random.between(0.1, 0.9));
            let start = [random.between(1.0, 60.0), random.between(1.0, 60.0)];
            let keys = [key("gain", 1.0, 60.0), key("tail", 1.0, 60.0)];
            let tried = search(&keys, &start, &mut |all| {
                all.iter().map(|v| settling(v[0], v[1], delay_s, share)).collect()
            });
            let found = tried.iter().map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
            let grid = (0..21).flat_map(|i| (0..21).map(move |j| (i, j)));
            let at = |i: i32| 60_f64.powf(f64::from(i) / 20.0);
            let least =
                grid.map(|(i, j)| settling(at(i), at(j), delay_s, share)).fold(f64::INFINITY, f64::min);
            assert!(tried.len() <= 441 / 20, "{} trials", tried.len());
            assert!(found <= 1.2 * least, "{found} for {least}");
            beyond += u32::from(found > 1.1 * least);
        }
        assert!(beyond <= 40, "{beyond} of 2000");
    }

    #[test]
    fn nothing_is_tried_twice_or_out_of_range() {
        let keys = [key("a", 1.0, 10.0), key("b", -2.0, 2.0)];
        let tried = search(&keys, &[1.0, 0.0], &mut |all| all.iter().map(|v| v[0] + v[1].abs()).collect());
        for (i, (values, _)) in tried.iter().enumerate() {
            assert!((1.0..=10.0).contains(&values[0]) && (-2.0..=2.0).contains(&values[1]));
            assert!(tried[..i].iter().all(|(other, _)| other != values));
        }
        assert_eq!(best(&tried), [1.0, 0.0]);
    }
}
