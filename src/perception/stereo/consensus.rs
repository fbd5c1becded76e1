//! Displacement of a camera from conjugate points with outliers: random samples of five, and refinement.
//!
//! The loop is that of all consensus here ([`crate::linalg::sampling`]); errors are Sampson's.

use super::StereoError;
use super::epipolar::{Conjugates, check, essential_matrix, sampson_error2};
use super::five_point::essential_5_point;
use super::relative_pose::{RefinedRelativePose, refine_relative, relative_pose};
use crate::geometry::Pose;
use crate::linalg::sampling::{Consensus, ConsensusModel};
use crate::pose::{ConsensusResult, ConsensusSettings};
use nalgebra::Matrix3;

/// Fewest pairs of a displacement: five of a sample, and one that must agree with it.
const FEWEST: usize = 6;

/// The displacement that most pairs agree on.
pub type RelativeConsensusPose = ConsensusResult<RefinedRelativePose>;

/// Owns the buffers of the search; made once and reused.
#[derive(Debug, Clone)]
pub struct RelativeConsensus(Consensus<Conjugates>);

impl RelativeConsensus {
    /// Buffers for `count` pairs; more are made room for when they come.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self(Consensus::with_capacity(count))
    }

    /// Which pairs agreed in the last search that succeeded.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        self.0.inliers()
    }

    /// Searches the displacement that most of at least six pairs agree on; the threshold is that of the Sampson error.
    ///
    /// `sd`: standard deviation of an inlier's coordinates, normalized units; it scales the covariance only.
    ///
    /// # Errors
    /// [`StereoError::TooFewPoints`] (also when fewer than six agree on anything), [`StereoError::NotFinite`],
    /// [`StereoError::BadGuess`] for settings or noise that are no positive numbers, [`StereoError::Degenerate`],
    /// [`StereoError::NotConverged`].
    pub fn search(
        &mut self,
        pairs: &[Conjugates],
        settings: &ConsensusSettings,
        sd: f64,
    ) -> Result<RelativeConsensusPose, StereoError> {
        check(pairs, FEWEST)?;
        if !settings.are_usable(sd) {
            return Err(StereoError::BadGuess);
        }
        self.0.search::<5, EssentialModel>(pairs, settings, sd)
    }
}

/// An essential matrix, and the displacement that it stands for once that is known.
#[derive(Clone, Copy)]
struct EssentialModel {
    E: Matrix3<f64>,
    X_12: Pose,
}

impl ConsensusModel<5> for EssentialModel {
    type Datum = Conjugates;
    type Refined = RefinedRelativePose;
    type Error = StereoError;
    const FEWEST: usize = FEWEST;
    // Chosen by hand: the displacement of five noisy pairs is off by several times their noise, and the refinement narrows the bound.
    const WIDER: &'static [f64] = &[4.0, 1.0];

    fn of_sample(sample: &[Conjugates; 5]) -> impl Iterator<Item = Self> {
        let found = essential_5_point(sample).ok();
        let count = found.as_ref().map_or(0, |found| found.as_slice().len());
        (0..count).filter_map(move |i| {
            Some(Self { E: *found.as_ref()?.as_slice().get(i)?, X_12: Pose::identity() })
        })
    }

    /// The sample itself has to lie in front of both cameras.
    fn settled(self, sample: &[Conjugates; 5]) -> Option<Self> {
        match relative_pose(&self.E, sample) {
            Ok((X_12, 5)) => Some(Self { E: essential_matrix(&X_12), X_12 }),
            _ => None,
        }
    }

    #[inline(always)]
    fn error2(&self, pair: &Conjugates) -> f64 {
        sampson_error2(&self.E, pair)
    }

    fn refine(&self, pairs: &[Conjugates], sd: f64) -> Result<RefinedRelativePose, StereoError> {
        refine_relative(&self.X_12, pairs, sd)
    }

    fn of_refined(refined: &RefinedRelativePose) -> Self {
        Self { E: essential_matrix(&refined.X_12), X_12: refined.X_12 }
    }

    fn too_few(agree: usize) -> StereoError {
        StereoError::TooFewPoints { needed: FEWEST, given: agree }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{camera_pose, noisy, scene};
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    #[test]
    fn outliers_are_left_out() {
        let (X, sd) = (camera_pose(), 0.5 / 800.0);
        let mut search = RelativeConsensus::with_capacity(50);
        for (wrong, seed) in [(0, 1), (15, 2), (25, 3)] {
            let mut random = Random::new(seed);
            let mut pairs = noisy(&scene(&X, 50, seed), sd, &mut random);
            for pair in pairs.iter_mut().take(wrong) {
                pair.s_2 = Vector2::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3));
            }
            let settings = ConsensusSettings { threshold: 2e-3, ..ConsensusSettings::default() };
            let found = search.search(&pairs, &settings, sd).unwrap();
            let best = refine_relative(&X, &pairs[wrong..], sd).unwrap();
            let off = found.refined.X_12.rotation.angle_to(&X.rotation);
            let floor = best.X_12.rotation.angle_to(&X.rotation);
            assert!(off < 2.0 * floor + 2e-3, "{wrong}: {off} {floor}");
            assert!(found.refined.X_12.translation.vector.dot(&X.translation.vector) > 0.0);
            assert!(found.inliers >= 48 - wrong, "{}", found.inliers);
            assert_eq!(search.search(&pairs, &settings, sd), Ok(found));
        }
    }

    #[test]
    fn bad_input_is_refused() {
        let pairs: Vec<_> = scene(&camera_pose(), 9, 3).iter().map(|p| p.0).collect();
        let mut search = RelativeConsensus::with_capacity(9);
        let settings = ConsensusSettings::default();
        assert_eq!(
            search.search(&pairs[..5], &settings, 0.0).err(),
            Some(StereoError::TooFewPoints { needed: 6, given: 5 })
        );
        let bad = ConsensusSettings { threshold: f64::NAN, ..settings };
        assert_eq!(search.search(&pairs, &bad, 0.0).err(), Some(StereoError::BadGuess));
    }
}
