//! Pose from points with outliers (RANSAC): random samples of three, P3P, and refinement of the best pose on its inliers.
//!
//! The loop is that of all consensus here ([`crate::linalg::sampling`]); errors are those of reprojection (10.36).

use super::points::check;
use super::{Correspondence3, PoseError, RefinedPose, p3p, refine_3d};
use crate::geometry::Pose;
use crate::linalg::sampling::{Consensus, ConsensusModel};

pub use crate::linalg::sampling::{ConsensusResult, ConsensusSettings};

/// Fewest points of a pose: three of a sample, and one that must agree with it.
const FEWEST: usize = 4;

/// The pose with the most inliers.
pub type ConsensusPose = ConsensusResult<RefinedPose>;

/// RANSAC for poses. Owns the buffers of the search, which are reused.
#[derive(Debug, Clone)]
pub struct PoseConsensus(Consensus<Correspondence3>);

impl PoseConsensus {
    /// Buffers for `count` points; more are made room for when they come.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self(Consensus::with_capacity(count))
    }

    /// Which points were inliers of the last successful search.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        self.0.inliers()
    }

    /// Searches the pose with the most inliers among at least four points.
    ///
    /// `sd`: standard deviation of an inlier's coordinates, normalized units; it scales the covariance only.
    ///
    /// # Errors
    /// [`PoseError::TooFewPoints`] (also when fewer than four agree on any pose), [`PoseError::NotFinite`],
    /// [`PoseError::BadGuess`] for settings or noise that are no positive numbers.
    pub fn search(
        &mut self,
        points: &[Correspondence3],
        settings: &ConsensusSettings,
        sd: f64,
    ) -> Result<ConsensusPose, PoseError> {
        check(points, FEWEST)?;
        if !settings.are_usable(sd) {
            return Err(PoseError::BadGuess);
        }
        self.0.search::<3, PoseModel>(points, settings, sd)
    }
}

/// A pose, also as matrix.
#[derive(Clone, Copy)]
struct PoseModel {
    X_CO: Pose,
    R: [[f64; 3]; 3],
    p: [f64; 3],
}

impl PoseModel {
    fn new(X_CO: &Pose) -> Self {
        let R = X_CO.rotation.to_rotation_matrix();
        Self {
            X_CO: *X_CO,
            R: std::array::from_fn(|i| std::array::from_fn(|j| R[(i, j)])),
            p: X_CO.translation.vector.into(),
        }
    }
}

impl ConsensusModel<3> for PoseModel {
    type Datum = Correspondence3;
    type Refined = RefinedPose;
    type Error = PoseError;
    const FEWEST: usize = FEWEST;
    // Chosen by hand: the pose of three noisy points is off by several times their noise, and each refinement narrows the bound.
    const WIDER: &'static [f64] = &[4.0, 2.0, 1.0];

    fn of_sample(sample: &[Correspondence3; 3]) -> impl Iterator<Item = Self> {
        let poses = p3p(sample).ok();
        let count = poses.as_ref().map_or(0, |poses| poses.as_slice().len());
        (0..count).filter_map(move |i| Some(Self::new(poses.as_ref()?.as_slice().get(i)?)))
    }

    fn settled(self, _: &[Correspondence3; 3]) -> Option<Self> {
        Some(self)
    }

    /// Squared reprojection error; infinite behind the camera.
    #[inline(always)]
    fn error2(&self, point: &Correspondence3) -> f64 {
        let r = &point.r;
        let [x, y, z] = [0, 1, 2].map(|i| {
            let row = &self.R[i];
            row[0] * r.x + row[1] * r.y + row[2] * r.z + self.p[i]
        });
        if !(z > 0.0) {
            return f64::INFINITY;
        }
        let over = 1.0 / z;
        let (ex, ey) = (point.s.x - x * over, point.s.y - y * over);
        ex * ex + ey * ey
    }

    fn refine(&self, points: &[Correspondence3], sd: f64) -> Result<RefinedPose, PoseError> {
        refine_3d(&self.X_CO, points, sd)
    }

    fn of_refined(refined: &RefinedPose) -> Self {
        Self::new(&refined.X_CO)
    }

    fn too_few(agree: usize) -> PoseError {
        PoseError::TooFewPoints { needed: FEWEST, given: agree }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{gap, gauss, see_3d};
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    /// 60 points, `wrong` of them anywhere in the image.
    fn scene(wrong: usize, seed: u64) -> (Pose, Vec<Correspondence3>) {
        let mut random = Random::new(seed);
        let mut noise = gauss(seed + 1);
        let object: Vec<[f64; 3]> = (0..60).map(|_| [(); 3].map(|()| random.between(-0.1, 0.1))).collect();
        let X = Pose::new([0.05, -0.03, 0.7].into(), [0.4, -0.3, random.between(-3.0, 3.0)].into());
        let mut points = see_3d(&X, &object, || 6e-4 * noise());
        for point in points.iter_mut().take(wrong) {
            point.s = Vector2::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3));
        }
        (X, points)
    }

    #[test]
    fn outliers_are_left_out() {
        let mut search = PoseConsensus::with_capacity(60);
        for (wrong, seed) in [(0, 1), (12, 2), (30, 3), (40, 4)] {
            let (X, points) = scene(wrong, seed);
            let found = search.search(&points, &ConsensusSettings::default(), 6e-4).unwrap();
            // As good as a refinement on the true inliers from the truth.
            let best = refine_3d(&X, &points[wrong..], 6e-4).unwrap();
            assert!(
                gap(&found.refined.X_CO, &best.X_CO) < 1e-3,
                "{wrong}: {}",
                gap(&found.refined.X_CO, &best.X_CO)
            );
            assert!(search.inliers()[wrong..].iter().filter(|x| **x).count() + 2 >= 60 - wrong);
            assert_eq!(search.inliers().iter().filter(|x| **x).count(), found.inliers);
            assert_eq!(search.search(&points, &ConsensusSettings::default(), 6e-4), Ok(found));
        }
    }

    #[test]
    fn nothing_agrees_with_noise() {
        let (_, points) = scene(60, 9);
        let settings = ConsensusSettings { threshold: 1e-5, max_trials: 200, ..ConsensusSettings::default() };
        let found = PoseConsensus::with_capacity(60).search(&points, &settings, 1e-4);
        assert!(matches!(found, Err(PoseError::TooFewPoints { needed: 4, .. })), "{found:?}");
    }

    #[test]
    fn bad_input_is_refused() {
        let (_, mut points) = scene(0, 1);
        let mut search = PoseConsensus::with_capacity(60);
        let settings = ConsensusSettings::default();
        assert_eq!(
            search.search(&points[..3], &settings, 0.0),
            Err(PoseError::TooFewPoints { needed: 4, given: 3 })
        );
        let nothing = ConsensusSettings { threshold: 0.0, ..settings };
        assert_eq!(search.search(&points, &nothing, 0.0), Err(PoseError::BadGuess));
        points[5].r.x = f64::NAN;
        assert_eq!(search.search(&points, &settings, 0.0), Err(PoseError::NotFinite { index: 5 }));
    }
}
