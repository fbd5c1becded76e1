//! Displacement of a camera from conjugate points of which some are wrong: random samples of five, and refinement.
//!
//! As [`crate::pose::PoseConsensus`]: scores are Sampson errors cut at the threshold (MSAC), each new best is refined on its
//! inliers, the samples are a function of the seed.

use super::StereoError;
use super::epipolar::{Conjugates, check, essential_matrix, sampson_error2};
use super::five_point::essential_5_point;
use super::relative_pose::{RefinedRelativePose, cut_score, refine_relative, relative_pose};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::linalg::sampling::{distinct, trials};
use crate::pose::ConsensusSettings;
use nalgebra::Matrix3;

/// The displacement that most pairs agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativeConsensusPose {
    /// The displacement refined on the inliers, with its covariance.
    pub refined: RefinedRelativePose,
    /// Pairs that agree.
    pub inliers: usize,
    /// Samples tried.
    pub trials: u32,
}

/// Owns the buffers of the search; made once and reused.
#[derive(Debug, Clone, Default)]
pub struct RelativeConsensus {
    inliers: Vec<bool>,
    subset: Vec<Conjugates>,
}

impl RelativeConsensus {
    /// Buffers for `count` pairs; more are made room for when they come.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self { inliers: Vec::with_capacity(count), subset: Vec::with_capacity(count) }
    }

    /// Which pairs agreed in the last search that succeeded.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        &self.inliers
    }

    /// Searches the displacement that most of at least six pairs agree on; the threshold is that of the Sampson error.
    ///
    /// `sigma`: standard deviation of an inlier's coordinates, normalized units; it scales the covariance only.
    ///
    /// # Errors
    /// [`StereoError::TooFewPoints`] (also when fewer than six agree on anything), [`StereoError::NotFinite`],
    /// [`StereoError::BadGuess`] for settings or noise that are no positive numbers, [`StereoError::Degenerate`],
    /// [`StereoError::NotConverged`].
    pub fn search(
        &mut self,
        pairs: &[Conjugates],
        settings: &ConsensusSettings,
        sigma: f64,
    ) -> Result<RelativeConsensusPose, StereoError> {
        check(pairs, 6)?;
        let cut = settings.threshold * settings.threshold;
        if !(cut > 0.0 && cut.is_finite() && settings.confidence < 1.0 && sigma >= 0.0) {
            return Err(StereoError::BadGuess);
        }
        let mut random = Random::new(settings.seed);
        let (mut best, mut least, mut agree) = (Pose::identity(), f64::INFINITY, 0);
        let (mut needed, mut tried) = (settings.most_trials, 0);
        while tried < needed {
            tried += 1;
            let sample = distinct::<5>(&mut random, pairs.len()).map(|i| pairs[i]);
            let Ok(found) = essential_5_point(&sample) else { continue };
            let (mut E, mut score): (Option<Matrix3<f64>>, f64) = (None, least);
            for candidate in found.as_slice() {
                let (this, _) = cut_score(candidate, pairs, cut, score);
                if this < score {
                    (E, score) = (Some(*candidate), this);
                }
            }
            // The sample itself has to lie in front of both cameras.
            let Some(Ok((X, 5))) = E.map(|E| relative_pose(&E, &sample)) else { continue };
            best = self.optimised(X, pairs, cut);
            (least, agree) = cut_score(&essential_matrix(&best), pairs, cut, f64::INFINITY);
            needed = trials(agree as f64 / pairs.len() as f64, 5, settings.confidence, settings.most_trials);
        }
        if agree < 6 {
            return Err(StereoError::TooFewPoints { needed: 6, given: agree });
        }
        let mut refined = self.on_inliers(&best, pairs, cut, sigma)?;
        for _ in 0..10 {
            let (score, _) = cut_score(&essential_matrix(&refined.X_12), pairs, cut, f64::INFINITY);
            if !(score < least * (1.0 - 1e-9)) {
                break;
            }
            least = score;
            refined = self.on_inliers(&refined.X_12, pairs, cut, sigma)?;
        }
        Ok(RelativeConsensusPose { refined, inliers: self.subset.len(), trials: tried })
    }

    fn on_inliers(
        &mut self,
        X_12: &Pose,
        pairs: &[Conjugates],
        cut: f64,
        sigma: f64,
    ) -> Result<RefinedRelativePose, StereoError> {
        self.inliers.clear();
        self.subset.clear();
        let E = essential_matrix(X_12);
        for pair in pairs {
            let agrees = sampson_error2(&E, pair) < cut;
            self.inliers.push(agrees);
            if agrees {
                self.subset.push(*pair);
            }
        }
        refine_relative(X_12, &self.subset, sigma)
    }

    /// The best of refinements on the inliers, at first with a wider threshold.
    fn optimised(&mut self, X_12: Pose, pairs: &[Conjugates], cut: f64) -> Pose {
        let score = |X: &Pose| cut_score(&essential_matrix(X), pairs, cut, f64::INFINITY).0;
        let (mut best, mut least) = (X_12, score(&X_12));
        for wider in [4.0, 1.0] {
            let Ok(end) = self.on_inliers(&best, pairs, wider * cut, 0.0) else { break };
            let this = score(&end.X_12);
            if this < least {
                (best, least) = (end.X_12, this);
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn outliers_are_left_out() {
        let (X, sigma) = (camera_pose(), 0.5 / 800.0);
        let mut search = RelativeConsensus::with_capacity(50);
        for (wrong, seed) in [(0, 1), (15, 2), (25, 3)] {
            let mut random = Random::new(seed);
            let mut pairs = noisy(&scene(&X, 50, seed), sigma, &mut random);
            for pair in pairs.iter_mut().take(wrong) {
                pair.s_2 = Vector2::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3));
            }
            let settings = ConsensusSettings { threshold: 2e-3, ..ConsensusSettings::default() };
            let found = search.search(&pairs, &settings, sigma).unwrap();
            let best = refine_relative(&X, &pairs[wrong..], sigma).unwrap();
            let off = found.refined.X_12.rotation.angle_to(&X.rotation);
            let floor = best.X_12.rotation.angle_to(&X.rotation);
            assert!(off < 2.0 * floor + 2e-3, "{wrong}: {off} {floor}");
            assert!(found.refined.X_12.translation.vector.dot(&X.translation.vector) > 0.0);
            assert!(found.inliers >= 48 - wrong, "{}", found.inliers);
            assert_eq!(search.search(&pairs, &settings, sigma), Ok(found));
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let pairs: Vec<_> = scene(&camera_pose(), 9, 3).iter().map(|p| p.0).collect();
        let mut search = RelativeConsensus::default();
        let settings = ConsensusSettings::default();
        assert_eq!(
            search.search(&pairs[..5], &settings, 0.0).err(),
            Some(StereoError::TooFewPoints { needed: 6, given: 5 })
        );
        let bad = ConsensusSettings { threshold: f64::NAN, ..settings };
        assert_eq!(search.search(&pairs, &bad, 0.0).err(), Some(StereoError::BadGuess));
    }
}
