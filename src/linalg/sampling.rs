//! Random sampling consensus: which points are tried, and when enough have been (Fischler and Bolles 1981).

use super::Random;

/// `K` distinct indices below `count`; zeros when there are fewer than `K`.
pub(crate) fn distinct<const K: usize>(random: &mut Random, count: usize) -> [usize; K] {
    let mut chosen = [0; K];
    if count < K {
        return chosen;
    }
    for i in 0..K {
        // The i-th of those that are left, counted past the ones chosen before, which are held in order.
        let mut index = (random.bits() % (count - i) as u64) as usize;
        let mut at = 0;
        while at < i && chosen[at] <= index {
            (index, at) = (index + 1, at + 1);
        }
        chosen.copy_within(at..i, at + 1);
        chosen[at] = index;
    }
    chosen
}

/// Trials after which a sample of `size` inliers has been met with `confidence`, when `share` of all are inliers.
///
/// By multiplication alone: no logarithm whose last bit depends on a library.
pub(crate) fn trials(share: f64, size: u32, confidence: f64, most: u32) -> u32 {
    let missed = 1.0 - share.powi(size as i32);
    let (mut left, mut n) = (1.0, 0);
    while left > 1.0 - confidence && n < most {
        left *= missed;
        n += 1;
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_distinct_and_even() {
        let mut random = Random::new(1);
        let mut counts = [0; 7];
        for _ in 0..7000 {
            let sample = distinct::<3>(&mut random, 7);
            assert!(sample.is_sorted_by(|a, b| a < b) && sample[2] < 7, "{sample:?}");
            for i in sample {
                counts[i] += 1;
            }
        }
        assert!(counts.iter().all(|n| (2800..3200).contains(n)), "{counts:?}");
        assert_eq!(distinct::<5>(&mut random, 5), [0, 1, 2, 3, 4]);
        assert_eq!(distinct::<5>(&mut random, 4), [0; 5]);
    }

    #[test]
    fn trials_follow_the_formula() {
        let formula = |w: f64, k: i32| (0.01_f64.ln() / (1.0 - w.powi(k)).ln()).ceil() as u32;
        for (w, k) in [(0.5, 3), (0.8, 5), (0.3, 3)] {
            assert!(trials(w, k, 0.99, 100_000).abs_diff(formula(w, k as i32)) <= 1);
        }
        assert_eq!(trials(0.0, 3, 0.99, 50), 50);
        assert_eq!(trials(1.0, 3, 0.99, 50), 1);
    }
}
