//! Random sampling consensus: the model that most data agree with, where some of them are wrong (Fischler and Bolles 1981).
//!
//! ```text
//! sample of K ─► its models ─► the best of them by score ─► refined on its inliers (local optimisation) ─► best so far ─► how many samples
//! score = sum over all data of the squared error, cut at the threshold's square (MSAC, Torr and Zisserman 2000)
//! ```
//! Each new best is refined on its inliers (Chum, Matas, Kittler 2003), which makes up for the noise of the sample. Repeatable: the samples
//! are a function of the seed.

use super::Random;

/// How long to search, and what agrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConsensusSettings {
    /// Greatest distance of an inlier from where it should be, normalized units; three standard deviations do.
    pub threshold: f64,
    /// Probability of having met a sample without outliers.
    pub confidence: f64,
    /// Most samples.
    pub max_trials: u32,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for ConsensusSettings {
    /// Two pixels at a focal length of 800.
    fn default() -> Self {
        Self { threshold: 2.5e-3, confidence: 0.999, max_trials: 2000, seed: 1 }
    }
}

impl ConsensusSettings {
    /// Whether a search can be made with them, for inliers of deviation `sd`.
    pub(crate) fn are_usable(&self, sd: f64) -> bool {
        let cut = self.threshold * self.threshold;
        cut > 0.0 && cut.is_finite() && self.confidence < 1.0 && sd >= 0.0
    }
}

/// The model that most data agree with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConsensusResult<R> {
    /// The model refined on the inliers, with its covariance.
    pub refined: R,
    /// Data that agree.
    pub inliers: usize,
    /// Samples tried.
    pub trials: u32,
}

/// A kind of model that is searched for, by samples of `K`.
pub(crate) trait ConsensusModel<const K: usize>: Copy {
    /// What is measured.
    type Datum: Copy;
    /// The model refined on many data.
    type Refined: Copy;
    /// Why there is none.
    type Error;
    /// Fewest data that make a model worth the name.
    const FEWEST: usize;
    /// Thresholds of the refinements of a new best, in squares of the inliers': wider ones let more of the true inliers in.
    const WIDER: &'static [f64];

    /// Models that go through a sample.
    fn of_sample(sample: &[Self::Datum; K]) -> impl Iterator<Item = Self>;
    /// The best model of a sample with what only the best needs; `None` where it cannot be.
    fn settled(self, sample: &[Self::Datum; K]) -> Option<Self>;
    /// Squared error of a datum, infinite where it cannot be.
    fn error2(&self, datum: &Self::Datum) -> f64;
    /// The best model near this one for data that agree with it, whose coordinates have the standard deviation `sd`.
    fn refine(&self, data: &[Self::Datum], sd: f64) -> Result<Self::Refined, Self::Error>;
    /// A refined model, to compare data with.
    fn of_refined(refined: &Self::Refined) -> Self;
    /// What to say where only so many data agree.
    fn too_few(agree: usize) -> Self::Error;
}

/// The search, with the buffers that it keeps.
#[derive(Debug, Clone)]
pub(crate) struct Consensus<D> {
    inliers: Vec<bool>,
    subset: Vec<D>,
}

/// A model and how well it does.
#[derive(Clone, Copy)]
struct ScoredModel<M> {
    model: M,
    score: f64,
    agree: usize,
}

impl<M> ScoredModel<M> {
    /// Gives up, with an infinite score, once the score has reached `hopeless`.
    #[inline]
    fn of<const K: usize>(model: M, data: &[<M as ConsensusModel<K>>::Datum], cut: f64, hopeless: f64) -> Self
    where
        M: ConsensusModel<K>,
    {
        let (mut score, mut agree) = (0.0, 0);
        for datum in data {
            let error2 = model.error2(datum);
            let below = error2 < cut;
            agree += usize::from(below);
            score += if below { error2 } else { cut };
            if score >= hopeless {
                return Self { model, score: f64::INFINITY, agree: 0 };
            }
        }
        Self { model, score, agree }
    }
}

impl<D: Copy> Consensus<D> {
    /// Buffers for `count` data; more are made room for when they come.
    pub(crate) fn with_capacity(count: usize) -> Self {
        Self { inliers: Vec::with_capacity(count), subset: Vec::with_capacity(count) }
    }

    /// Which data agreed in the last search that succeeded.
    pub(crate) fn inliers(&self) -> &[bool] {
        &self.inliers
    }

    /// Searches the model that most of `data` agree on, with settings that [are usable](ConsensusSettings::are_usable).
    pub(crate) fn search<const K: usize, M: ConsensusModel<K, Datum = D>>(
        &mut self,
        data: &[D],
        settings: &ConsensusSettings,
        sd: f64,
    ) -> Result<ConsensusResult<M::Refined>, M::Error> {
        let cut = settings.threshold * settings.threshold;
        let mut random = Random::new(settings.seed);
        let mut best: Option<ScoredModel<M>> = None;
        let (mut needed, mut tried) = (settings.max_trials, 0);
        while tried < needed {
            tried += 1;
            let sample = distinct::<K>(&mut random, data.len()).map(|i| data[i]);
            let least = best.map_or(f64::INFINITY, |best| best.score);
            let mut of_sample: Option<ScoredModel<M>> = None;
            for model in M::of_sample(&sample) {
                let hopeless = of_sample.map_or(least, |best| best.score);
                let trial = ScoredModel::of(model, data, cut, hopeless);
                if trial.score < hopeless {
                    of_sample = Some(trial);
                }
            }
            let Some(trial) = of_sample else { continue };
            let Some(model) = trial.model.settled(&sample) else { continue };
            let trial = self.optimised(ScoredModel { model, ..trial }, data, cut);
            let share = trial.agree as f64 / data.len() as f64;
            needed = trials(share, K as u32, settings.confidence, settings.max_trials);
            best = Some(trial);
        }
        let agree = best.map_or(0, |best| best.agree);
        let Some(mut best) = best.filter(|_| agree >= M::FEWEST) else { return Err(M::too_few(agree)) };
        // to the end: until the set of inliers stays
        let mut refined = self.on_inliers(&best.model, data, cut, sd)?;
        for _ in 0..10 {
            let next = ScoredModel::of(M::of_refined(&refined), data, cut, f64::INFINITY);
            if !(next.score < best.score * (1.0 - 1e-9)) {
                break;
            }
            best = next;
            refined = self.on_inliers(&best.model, data, cut, sd)?;
        }
        Ok(ConsensusResult { refined, inliers: self.subset.len(), trials: tried })
    }

    /// The best of refinements on the inliers, at first with a wider threshold.
    fn optimised<const K: usize, M: ConsensusModel<K, Datum = D>>(
        &mut self,
        trial: ScoredModel<M>,
        data: &[D],
        cut: f64,
    ) -> ScoredModel<M> {
        let mut best = trial;
        for wider in M::WIDER {
            let Ok(refined) = self.on_inliers(&best.model, data, wider * cut, 0.0) else { break };
            let next = ScoredModel::of(M::of_refined(&refined), data, cut, best.score);
            if next.score < best.score {
                best = next;
            }
        }
        best
    }

    fn on_inliers<const K: usize, M: ConsensusModel<K, Datum = D>>(
        &mut self,
        model: &M,
        data: &[D],
        cut: f64,
        sd: f64,
    ) -> Result<M::Refined, M::Error> {
        self.inliers.clear();
        self.subset.clear();
        for datum in data {
            let agrees = model.error2(datum) < cut;
            self.inliers.push(agrees);
            if agrees {
                self.subset.push(*datum);
            }
        }
        model.refine(&self.subset, sd)
    }
}

/// `K` distinct indices below `count`; zeros when there are fewer than `K`.
fn distinct<const K: usize>(random: &mut Random, count: usize) -> [usize; K] {
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
fn trials(share: f64, size: u32, confidence: f64, most: u32) -> u32 {
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
