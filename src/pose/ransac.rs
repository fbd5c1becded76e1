//! Pose from points of which some are wrong: random samples of three, P3P, and refinement of the best on all that agree.
//!
//! A trial's score is the sum over the points of the squared reprojection error (10.36), cut at the threshold's square
//! (MSAC, Torr and Zisserman 2000). Each new best is refined on its inliers (local optimisation, Chum, Matas, Kittler 2003).
//! Repeatable: the samples are a function of the seed.

use super::points::check;
use super::{Correspondence3, PoseError, RefinedPose, p3p, refine_3d};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::linalg::sampling::{distinct, trials};

/// How long to search, and what agrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConsensusSettings {
    /// Greatest distance of an inlier from where it should be, normalized units; three standard deviations do.
    pub threshold: f64,
    /// Probability of having met a sample without outliers.
    pub confidence: f64,
    /// Most samples.
    pub most_trials: u32,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for ConsensusSettings {
    /// Two pixels at a focal length of 800.
    fn default() -> Self {
        Self { threshold: 2.5e-3, confidence: 0.999, most_trials: 2000, seed: 1 }
    }
}

/// The pose that most points agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConsensusPose {
    /// The pose refined on the inliers, with its covariance.
    pub refined: RefinedPose,
    /// Points that agree.
    pub inliers: usize,
    /// Samples tried.
    pub trials: u32,
}

/// Owns the buffers of the search; made once and reused.
#[derive(Debug, Clone, Default)]
pub struct PoseConsensus {
    inliers: Vec<bool>,
    subset: Vec<Correspondence3>,
}

impl PoseConsensus {
    /// Buffers for `count` points; more are made room for when they come.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self { inliers: Vec::with_capacity(count), subset: Vec::with_capacity(count) }
    }

    /// Which points agreed in the last search that succeeded.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        &self.inliers
    }

    /// Searches the pose that most of at least four points agree on.
    ///
    /// `sigma`: standard deviation of an inlier's coordinates, normalized units; it scales the covariance only.
    ///
    /// # Errors
    /// [`PoseError::TooFewPoints`] (also when fewer than four agree on any pose), [`PoseError::NotFinite`],
    /// [`PoseError::BadGuess`] for settings or noise that are no positive numbers.
    pub fn search(
        &mut self,
        points: &[Correspondence3],
        settings: &ConsensusSettings,
        sigma: f64,
    ) -> Result<ConsensusPose, PoseError> {
        check(points, 4)?;
        let cut = settings.threshold * settings.threshold;
        if !(cut > 0.0 && cut.is_finite() && settings.confidence < 1.0 && sigma >= 0.0) {
            return Err(PoseError::BadGuess);
        }
        let mut random = Random::new(settings.seed);
        let mut best = Trial { score: f64::INFINITY, inliers: 0, X_CO: Pose::identity() };
        let (mut needed, mut tried) = (settings.most_trials, 0);
        while tried < needed {
            tried += 1;
            let sample = distinct::<3>(&mut random, points.len());
            let Ok(poses) = p3p(&sample.map(|i| points[i])) else { continue };
            for X_CO in poses.as_slice() {
                let trial = Trial::of(X_CO, points, cut, best.score);
                if trial.score < best.score {
                    best = self.optimised(trial, points, cut);
                    let share = best.inliers as f64 / points.len() as f64;
                    needed = trials(share, 3, settings.confidence, settings.most_trials);
                }
            }
        }
        if best.inliers < 4 {
            return Err(PoseError::TooFewPoints { needed: 4, given: best.inliers });
        }
        // To the end: until the set of inliers stays.
        let mut refined = None;
        for _ in 0..10 {
            self.select(&best.X_CO, points, cut);
            refined = Some(refine_3d(&best.X_CO, &self.subset, sigma)?);
            let next = refined.map_or(best, |r| Trial::of(&r.X_CO, points, cut, f64::INFINITY));
            if !(next.score < best.score * (1.0 - 1e-9)) {
                break;
            }
            best = next;
        }
        let refined = refined.ok_or(PoseError::Degenerate)?;
        Ok(ConsensusPose { refined, inliers: self.subset.len(), trials: tried })
    }

    /// The best of refinements on the inliers, at first with a wider threshold, which lets more of the true ones in.
    fn optimised(&mut self, trial: Trial, points: &[Correspondence3], cut: f64) -> Trial {
        let mut best = trial;
        for wider in [4.0, 2.0, 1.0] {
            self.select(&best.X_CO, points, wider * cut);
            let Ok(end) = refine_3d(&best.X_CO, &self.subset, 0.0) else { break };
            let next = Trial::of(&end.X_CO, points, cut, best.score);
            if next.score < best.score {
                best = next;
            }
        }
        best
    }

    fn select(&mut self, X_CO: &Pose, points: &[Correspondence3], cut: f64) {
        self.inliers.clear();
        self.subset.clear();
        let view = PoseMatrix::new(X_CO);
        for point in points {
            let agrees = view.error2(point) <= cut;
            self.inliers.push(agrees);
            if agrees {
                self.subset.push(*point);
            }
        }
    }
}

/// A pose and how well it does.
#[derive(Debug, Clone, Copy)]
struct Trial {
    score: f64,
    inliers: usize,
    X_CO: Pose,
}

impl Trial {
    /// Gives up, with an infinite score, once the score has reached `hopeless`.
    fn of(X_CO: &Pose, points: &[Correspondence3], cut: f64, hopeless: f64) -> Self {
        let view = PoseMatrix::new(X_CO);
        let (mut score, mut inliers) = (0.0, 0);
        for point in points {
            let error2 = view.error2(point);
            inliers += usize::from(error2 <= cut);
            score += if error2 < cut { error2 } else { cut };
            if score >= hopeless {
                return Self { score: f64::INFINITY, inliers: 0, X_CO: *X_CO };
            }
        }
        Self { score, inliers, X_CO: *X_CO }
    }
}

/// A pose as matrix.
struct PoseMatrix {
    R: [[f64; 3]; 3],
    p: [f64; 3],
}

impl PoseMatrix {
    fn new(X_CO: &Pose) -> Self {
        let R = X_CO.rotation.to_rotation_matrix();
        Self {
            R: std::array::from_fn(|i| std::array::from_fn(|j| R[(i, j)])),
            p: X_CO.translation.vector.into(),
        }
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
}

#[cfg(test)]
mod tests {
    use super::super::testing::{gap, gauss, see_3d};
    use super::*;
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
        let settings =
            ConsensusSettings { threshold: 1e-5, most_trials: 200, ..ConsensusSettings::default() };
        let found = PoseConsensus::default().search(&points, &settings, 1e-4);
        assert!(matches!(found, Err(PoseError::TooFewPoints { needed: 4, .. })), "{found:?}");
    }

    #[test]
    fn bad_input_is_refused() {
        let (_, mut points) = scene(0, 1);
        let mut search = PoseConsensus::default();
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
