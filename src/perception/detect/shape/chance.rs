//! The probability that an accidental outline fits as well as one that was fitted.
//!
//! An image full of polygons contains some that are nearly the outline of the target: the map has eight parameters, and fulfils the
//! first eight constraints for any polygon. The remaining constraints distinguish a polygon from the target:
//!
//! ```text
//! k = min(C - p, L + D - 6)
//! ```
//! of `C` numbers that the edges give (two of a side of which two pieces are seen, one of a side with one piece or of a piece of a curve)
//! and the map's `p` parameters. Letters and signs have parallel sides, which is not by accident: of these, `L` offsets of sides and `D` directions
//! count, of which an affine map determines six.
//!
//! For a border that lies within `R` of the outline after the first alignment, these constraints are assumed uniform within `R`; the probability that they
//! lie as near to 0 as those of the fit, at the distance `rho`, is the volume of a ball over that of a cube,
//!
//! ```text
//! P = pi^(k/2) / Gamma(k/2 + 1) (rho / 2 R)^k        rho^2 = max(chi^2 - (pieces - C), k) v C / pieces
//! ```
//! with the variance `v` of a piece, so that noise alone sets the least `rho`. Of `n` borders that were aligned so far,
//! `n P` are expected to fit as well by accident.

/// Evidence of the edges of a fitted outline.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Evidence {
    /// Number `k` of constraints beyond those that the map's parameters fulfil; 0 where none is left.
    pub(super) surplus: u32,
    /// Distance `rho` of the constraints from those of the target, px.
    pub(super) off_px: f64,
}

/// Edges by the parts of the outline: how many pieces of each count, and whether it is straight, then its class of parallel parts.
pub(super) fn surplus(
    parts: impl Iterator<Item = (u32, Option<usize>)> + Clone,
    parameters: usize,
) -> (u32, u32) {
    let (mut numbers, mut offsets, mut directions) = (0, 0, 0);
    for (i, (pieces, class)) in parts.clone().enumerate() {
        match class {
            None => {
                numbers += pieces;
                offsets += pieces;
            }
            Some(class) => {
                numbers += pieces.min(2);
                offsets += pieces.min(1);
                let told = |(n, c): (u32, Option<usize>)| n > 1 && c == Some(class);
                directions += u32::from(pieces > 1 && !parts.clone().take(i).any(told));
            }
        }
    }
    (numbers, numbers.saturating_sub(parameters as u32).min((offsets + directions).saturating_sub(6)))
}

impl Evidence {
    /// Of so many pieces and `numbers` that they give, with the sum of squared offsets over their variances and the mean variance, px^2.
    pub(super) fn new(surplus: u32, numbers: u32, pieces: f64, chi2: f64, variance_px2: f64) -> Self {
        let beyond = (chi2 - (pieces - f64::from(numbers))).max(f64::from(surplus));
        let off_px = (beyond * variance_px2 * f64::from(numbers) / pieces.max(1.0)).sqrt();
        Self { surplus, off_px }
    }

    /// Probability that an accidental border, aligned to within `reach_px`, fits as well.
    pub(super) fn chance(&self, reach_px: f64) -> f64 {
        if self.surplus == 0 {
            return 1.0;
        }
        let share = self.off_px / (2.0 * reach_px);
        // V(k) = V(k-2) 2 pi / k
        let mut volume = if self.surplus.is_multiple_of(2) { 1.0 } else { 2.0 * share };
        for k in (1..=self.surplus).rev().step_by(2).filter(|k| *k > 1) {
            volume *= std::f64::consts::TAU / f64::from(k) * share * share;
        }
        volume.min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;

    fn sides(classes: &[usize], pieces: u32) -> (u32, u32) {
        surplus(classes.iter().map(|c| (pieces, Some(*c))), 8)
    }

    #[test]
    fn what_the_map_takes_up_tells_nothing() {
        // any four sides, five, six; an L, a T, an arrow
        assert_eq!(sides(&[0, 1, 2, 3], 3), (8, 0));
        assert_eq!(sides(&[0, 1, 2, 3, 4], 3), (10, 2));
        assert_eq!(sides(&[0, 1, 2, 3, 4, 5], 9), (12, 4));
        assert_eq!(sides(&[0, 1, 0, 1, 0, 1], 2), (12, 2));
        assert_eq!(sides(&[0, 1, 0, 1, 0, 1, 0, 1], 2), (16, 4));
        assert_eq!(sides(&[0, 1, 2, 3, 1, 0, 1], 2), (14, 5));
        // one piece on each side tells no directions
        assert_eq!(sides(&[0, 1, 2, 3, 4, 5], 1), (6, 0));
        assert_eq!(surplus([(20, None)].into_iter(), 5), (20, 14));
    }

    /// The formula against draws from the cube.
    #[test]
    fn chance_is_the_share_of_the_cube() {
        let mut random = Random::new(4);
        for (k, off_px) in [(1, 0.3), (2, 0.5), (3, 0.8), (4, 0.9), (5, 1.0)] {
            let (reach_px, draws) = (1.2, 200_000);
            let mut within = 0;
            for _ in 0..draws {
                let square: f64 = (0..k).map(|_| random.between(-reach_px, reach_px).powi(2)).sum();
                within += i32::from(square < off_px * off_px);
            }
            let (told, drawn) =
                (Evidence { surplus: k, off_px }.chance(reach_px), f64::from(within) / f64::from(draws));
            assert!((told / drawn - 1.0).abs() < 0.05, "{k}: {told} {drawn}");
        }
        assert_eq!(Evidence { surplus: 0, off_px: 0.0 }.chance(1.0), 1.0);
    }

    #[test]
    fn noise_alone_counts_as_little_as_it_is() {
        // 60 pieces of 0.02 px, twelve numbers, as noise has them; then off by a tenth of a pixel
        let honest = Evidence::new(4, 12, 60.0, 52.0, 4e-4);
        let off = Evidence::new(4, 12, 60.0, 52.0 + 60.0 * 25.0, 4e-4);
        assert!((honest.off_px - (4.0f64 * 4e-4 / 5.0).sqrt()).abs() < 1e-12);
        assert!(off.off_px > 0.3 && off.chance(2.0) > 1e4 * honest.chance(2.0));
    }
}
