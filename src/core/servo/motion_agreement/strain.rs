//! How far a description would have to be off for the believed mount to explain what was seen.
//!
//! A mount that is turned by 20 degrees about any axis, with a lever arm of 5 cm, and a lens a quarter longer than it is told turn the first motion of the image by so much that a mount which is wrong by
//! 90 degrees may explain it as well. Which of the two it was is told by how likely the errors are that it would take: the least, over a turn `r` and a displacement `p` of the camera against its mount, a factor
//! `k` of its way and a factor `g` of the focal length, of
//!
//! ```text
//! sum |left(r, p, k, g)|^2 / (n (UNMODELLED extent^2 + NOISE^2)) + |r|^2 / TURN^2 + |p|^2 / LEVER_M^2 + (ln k / depth)^2 + (ln g / focal)^2
//! X(r, p) = E^-1 X E,   E = (r, p)
//! ```
//! over the `n` features of each of some motions, with the `extent` of what should have moved and has. Which is a sum of squared standard deviations, found by Gauss and Newton. A lens `g` times as long
//! shows all features `g` times as far from the middle of the image as the told one.

use super::{JUDGED, SetPoint, View, feature_motion};
use crate::geometry::Pose;
use crate::linalg::Ldlt;
use nalgebra::{SVector, Vector2, Vector3};

/// Strain up to which a description that is off explains what a wrong mount would explain, too. Measured, of one motion of 1 mm after the first one: of 540 drawn mounts that are 0 to 20 degrees and up to 5 cm
/// off, with lenses by -25 to 30 % and depths by up to a factor of three, those that look like a wrong one have strains of 1 to 8; of 72 that are wrong by quarters or have other axes, and 4 degrees besides, 12 and
/// more, mostly 30: a turn by a quarter is one.
pub(super) const CREDIBLE: f64 = 10.0;
/// Share of the square of the displacement by which a description that is off in another way changes it. Chosen by hand: a twentieth of what a camera is believed with.
const UNMODELLED: f64 = 0.003;
/// Noise of a dot, normalized. Derived: [`JUDGED`] is fifteen times that.
pub(super) const NOISE: f64 = JUDGED / 15.0;
/// Standard deviation of the turn by which a mount is off, rad. Chosen by hand: mounts are measured to 15 degrees by the eye.
const TURN: f64 = 0.26;
/// The same of its displacement, m. Chosen by hand as [`TURN`].
const LEVER_M: f64 = 0.04;
/// What is believed of a description, in logarithms.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beliefs {
    /// By how much the focal length is another one than it is told, and the standard deviation of that.
    focal_at: f64,
    focal: f64,
    /// Standard deviation of the target's size or distance.
    depth: f64,
}

/// What is believed where a mount is judged. Chosen by hand: a target may be three times as large as it is told, and a lens a fifth longer.
pub(super) const OF_MOUNT: Beliefs = Beliefs { focal_at: 0.0, focal: 0.2, depth: 1.2 };
/// What is believed where the focal length is asked for: nothing. Chosen by hand: a lens three times as long or as short as it is told.
pub(super) const OF_LENS: Beliefs = Beliefs { focal_at: 0.0, focal: 1.0, depth: 1.2 };
/// What is believed of a description that is right but for a focal length by this factor, as a logarithm. Chosen by hand: lens and target are measured to a fifth by the eye.
pub(super) const fn told_but_for(focal_at: f64) -> Beliefs {
    Beliefs { focal_at, focal: 0.2, depth: 0.2 }
}
/// Steps of Gauss and Newton. Chosen by hand: after five the sum is that of twenty to a hundredth, up to some 30, which are three of the [longest](LONGEST_STEP) away.
const STEPS: usize = 8;
/// The longest step, in standard deviations of all unknowns together. Chosen by hand: derivatives hold as far.
const LONGEST_STEP: f64 = 2.0;
/// Change of an unknown by which the derivatives are taken, in its standard deviations. Chosen by hand: their error is as large as that of rounding by then.
const DIFFERENCE: f64 = 1e-4;

/// What a description is off by to explain what was seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeastStrain {
    /// The sum of the squared standard deviations that it takes.
    pub(super) strain: f64,
    /// Logarithm of the focal length as a share of the told one, and its standard deviation.
    pub(super) focal: f64,
    pub(super) focal_sd: f64,
}

/// What a description may be off by, in units of its standard deviations: turn, lever arm, logarithms of depth and focal length.
type SupposedErrors = SVector<f64, 8>;

/// Two views, and the motion of the believed camera from the first to the second.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenMotion {
    pub(super) base: View,
    pub(super) X_CB: Pose,
    pub(super) view: View,
}

impl SeenMotion {
    /// How far the features have moved or should have, whichever is more: root mean square.
    pub(super) fn extent(&self, set_point: &SetPoint) -> Option<f64> {
        let motion = feature_motion(&self.base, &self.X_CB, &self.view, set_point)?;
        Some(motion.moved.max(motion.seen))
    }

    fn predicted(&self, errors: &SupposedErrors, beliefs: Beliefs, set_point: &SetPoint) -> Option<View> {
        let longer = (beliefs.focal_at + errors[7] * beliefs.focal).exp();
        let shown = |view: &View, by: f64| view.moved(|i| Some(view.feature(i)? * by));
        let seen = shown(&self.base, longer.recip())?;
        shown(&seen.predicted_at(&moved_by(&self.X_CB, errors, beliefs), set_point)?, longer)
    }

    /// What is left of each feature that both views show, by its index.
    fn left<'a>(&'a self, there: &'a View) -> impl Iterator<Item = (usize, Vector2<f64>)> + 'a {
        self.view.seen().filter_map(|(i, s)| Some((i, s - there.feature(i)?)))
    }

    /// The weight of the square of what is left of a feature.
    fn weight(&self, set_point: &SetPoint) -> Option<f64> {
        let count = self.left(&self.base).count();
        let extent = self.extent(set_point)?;
        Some((count as f64 * (UNMODELLED * extent * extent + NOISE * NOISE)).recip())
    }
}

/// Normal equations of all that is left.
struct StrainEquations {
    matrix: [[f64; 8]; 8],
    right: SupposedErrors,
    strain: f64,
}

impl StrainEquations {
    fn add(
        &mut self,
        motion: &SeenMotion,
        errors: &SupposedErrors,
        beliefs: Beliefs,
        set_point: &SetPoint,
    ) -> Option<()> {
        let weight = motion.weight(set_point)?;
        let there = motion.predicted(errors, beliefs, set_point)?;
        let mut beside = [there; 8];
        for (j, beside) in beside.iter_mut().enumerate() {
            let mut changed = *errors;
            changed[j] += DIFFERENCE;
            *beside = motion.predicted(&changed, beliefs, set_point)?;
        }
        for (i, off) in motion.left(&there) {
            self.strain += weight * off.norm_squared();
            let slopes = beside.each_ref().map(|beside| {
                beside
                    .feature(i)
                    .zip(there.feature(i))
                    .map_or_else(Vector2::zeros, |(b, a)| (b - a) / DIFFERENCE)
            });
            for ((slope, row), right) in slopes.iter().zip(&mut self.matrix).zip(self.right.iter_mut()) {
                *right += weight * slope.dot(&off);
                for (entry, other) in row.iter_mut().zip(&slopes) {
                    *entry += weight * slope.dot(other);
                }
            }
        }
        Some(())
    }
}

/// The least strain that it puts on a description which is believed so to explain all of these motions of one camera. `None` where nothing explains them.
pub(super) fn explained(
    motions: &[SeenMotion],
    beliefs: Beliefs,
    set_point: &SetPoint,
) -> Option<LeastStrain> {
    let (mut errors, mut least) = (SupposedErrors::zeros(), None::<LeastStrain>);
    for _ in 0..=STEPS {
        let mut normal =
            StrainEquations { matrix: [[0.0; 8]; 8], right: -errors, strain: errors.norm_squared() };
        let added = motions.iter().try_for_each(|motion| normal.add(motion, &errors, beliefs, set_point));
        let factors = added.and_then(|()| Ldlt::new(&normal.matrix, &[1.0; 8]));
        // A step that leads behind the camera is the last.
        let Some(factors) = factors else { break };
        if least.is_none_or(|least| normal.strain < least.strain) {
            let mut of_focal = [0.0; 8];
            of_focal[7] = 1.0;
            let variance = factors.solve(&of_focal)[7];
            let focal = beliefs.focal_at + errors[7] * beliefs.focal;
            let focal_sd = variance.sqrt() * beliefs.focal;
            least = Some(LeastStrain { strain: normal.strain, focal, focal_sd });
        }
        let change = SupposedErrors::from(factors.solve(&normal.right.into()));
        errors += change * (LONGEST_STEP / change.norm().max(LONGEST_STEP));
    }
    least.filter(|least| least.strain.is_finite())
}

/// Whether a description that is a little off explains all of these motions: how the camera is mounted, how long its lens is, and how large the target.
pub(super) fn is_credible(motions: &[SeenMotion], set_point: &SetPoint) -> bool {
    explained(motions, OF_MOUNT, set_point).is_some_and(|least| least.strain < CREDIBLE)
}

/// The camera's motion `X_CB` before a target of the told distance, if the description is off by `errors`.
fn moved_by(X_CB: &Pose, errors: &SupposedErrors, beliefs: Beliefs) -> Pose {
    let part = |at: usize| Vector3::new(errors[at], errors[at + 1], errors[at + 2]);
    let E = Pose::new(part(3) * LEVER_M, part(0) * TURN);
    let mut X = E.inv_mul(X_CB) * E;
    // A target of the told size is as much farther away as the lens is longer.
    X.translation.vector *= (errors[6] * beliefs.depth - beliefs.focal_at).exp();
    X
}
