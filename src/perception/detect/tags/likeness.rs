//! Whether neighbouring levels are more alike than noise makes them: what lies on a tag shows so, and noise does not.

use super::side::{SideFit, SideRow};

/// Levels along a side that are alike by so many deviations of chance are looked at by the fit of the whole tag. Of 465 honest images 1 % had as many, by what
/// blur brings of the cells inside; of 365 with an untrue corner by shadow, highlight, spot or cover 87 %. Half doubts a tenth of the honest ones,
/// the double needs 64 rows to doubt any.
const ALIKE_SDS: f64 = 4.0;
/// And so do sides of which more rows than this share do not fit with the others. Measured: of 465 honest images none lost more than 0.03 of a side, of 35 with an
/// untrue corner under a cover half lost more than 0.08. Half doubts those few, the double lets a third of the covered sides pass.
const LOST_SHARE: f64 = 0.05;

impl SideFit {
    /// Whether the levels along the side do not differ as noise does: whether neighbouring rows are more alike than others (von Neumann's ratio,
    /// of which [`likeness`] tells the chance).
    pub(super) fn uneven(&self, rows: &[SideRow]) -> bool {
        let (mut n, mut squares) = (0.0, [0.0; 2]);
        let mut before: Option<&SideRow> = None;
        for row in rows.iter().filter(|r| r.used) {
            if let Some(before) = before {
                squares[0] += (row.light - before.light).powi(2);
                squares[1] += (row.dark - before.dark).powi(2);
            }
            n += 1.0;
            before = Some(row);
        }
        if n < (1.0 - LOST_SHARE) * rows.len() as f64 {
            return true;
        }
        let alike = |(squares, variance): (f64, f64)| likeness(squares / (n - 1.0), variance, n) > ALIKE_SDS;
        squares.into_iter().zip(self.level_variances).any(alike)
    }
}

/// By how many deviations, as white noise has them, neighbours among `n` values are more alike than others: `mean_step` is the mean square of the difference
/// of two neighbours, which of white noise is twice the variance; the share that it is of that has the deviation `n^-1/2` (von Neumann).
pub(super) fn likeness(mean_step: f64, variance: f64, n: f64) -> f64 {
    // levels of one value have no variance, and are not alike by harm
    if variance > 0.0 { (1.0 - 0.5 * mean_step / variance) * n.sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    #[test]
    fn noise_is_not_alike_and_a_wave_under_it_is() {
        let mut random = Random::new(3);
        let mut told = |wave: f64| {
            let values: Vec<f64> =
                (0..100).map(|i| wave * (0.1 * f64::from(i)).sin() + random.gaussian()).collect();
            let mean = values.iter().sum::<f64>() / 100.0;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 99.0;
            let steps = values.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>() / 99.0;
            likeness(steps, variance, 100.0)
        };
        assert!(told(0.0).abs() < 3.0);
        assert!(told(2.0) > ALIKE_SDS);
        assert_eq!(likeness(0.0, 0.0, 100.0), 0.0);
    }
}
