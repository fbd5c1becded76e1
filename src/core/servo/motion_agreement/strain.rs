//! How far a description would have to be off for the believed mount to explain what was seen.
//!
//! A mount that is turned by 20 degrees about any axis, with a lever arm of 5 cm, and a lens a quarter longer than it is told turn the first motion of the image by so much that a mount which is wrong by
//! 90 degrees may explain it as well. Which of the two it was is told by how likely the errors are that it would take: the least, over a turn `r` and a displacement `p` of the camera against its mount, a factor
//! `k` of its way and a factor `g` of its turns, of
//!
//! ```text
//! sum |left(r, p, k, g)|^2 / (n (UNMODELLED extent^2 + NOISE^2)) + |r|^2 / TURN^2 + |p|^2 / LEVER_M^2 + (ln k / DEPTH)^2 + (ln g / FOCAL)^2
//! X(r, p) = E^-1 X E,   E = (r, p)
//! ```
//! over the `n` features of each of some motions, with the `extent` of what should have moved and has. Which is a sum of squared standard deviations, found by Gauss and Newton.

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
const NOISE: f64 = JUDGED / 15.0;
/// Standard deviation of the turn by which a mount is off, rad. Chosen by hand: mounts are measured to 15 degrees by the eye.
const TURN: f64 = 0.26;
/// The same of its displacement, m. Chosen by hand as [`TURN`].
const LEVER_M: f64 = 0.04;
/// The same of the logarithm of the target's size or distance. Chosen by hand: a target may be believed three times as large as it is.
const DEPTH: f64 = 1.2;
/// The same of the logarithm of the focal length. Chosen by hand: a lens a fifth longer than it is told.
const FOCAL: f64 = 0.2;
/// Steps of Gauss and Newton. Chosen by hand: after five the sum is that of twenty to a hundredth, up to some 30, which are three of the [longest](LONGEST_STEP) away.
const STEPS: usize = 8;
/// The longest step, in standard deviations of all unknowns together. Chosen by hand: derivatives hold as far.
const LONGEST_STEP: f64 = 2.0;
/// Change of an unknown by which the derivatives are taken, in its standard deviations. Chosen by hand: their error is as large as that of rounding by then.
const DIFFERENCE: f64 = 1e-4;

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

    fn predicted(&self, errors: &SupposedErrors, set_point: &SetPoint) -> Option<View> {
        self.base.predicted_at(&moved_by(&self.X_CB, errors), set_point)
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
    fn add(&mut self, motion: &SeenMotion, errors: &SupposedErrors, set_point: &SetPoint) -> Option<()> {
        let weight = motion.weight(set_point)?;
        let there = motion.predicted(errors, set_point)?;
        let mut beside = [there; 8];
        for (j, beside) in beside.iter_mut().enumerate() {
            let mut changed = *errors;
            changed[j] += DIFFERENCE;
            *beside = motion.predicted(&changed, set_point)?;
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

/// The strain that it puts on the description to explain all of these motions of one camera. `None` where nothing explains them.
pub(super) fn strain(motions: &[SeenMotion], set_point: &SetPoint) -> Option<f64> {
    let (mut errors, mut least) = (SupposedErrors::zeros(), None);
    for _ in 0..=STEPS {
        let mut normal =
            StrainEquations { matrix: [[0.0; 8]; 8], right: -errors, strain: errors.norm_squared() };
        let added = motions.iter().try_for_each(|motion| normal.add(motion, &errors, set_point));
        let factors = added.and_then(|()| Ldlt::new(&normal.matrix, &[1.0; 8]));
        // A step that leads behind the camera is the last.
        let Some(factors) = factors else { break };
        least = Some(least.map_or(normal.strain, |least: f64| least.min(normal.strain)));
        let change = SupposedErrors::from(factors.solve(&normal.right.into()));
        errors += change * (LONGEST_STEP / change.norm().max(LONGEST_STEP));
    }
    least.filter(|least| least.is_finite())
}

/// The camera's motion `X_CB` if the description is off by `errors`.
fn moved_by(X_CB: &Pose, errors: &SupposedErrors) -> Pose {
    let part = |at: usize| Vector3::new(errors[at], errors[at + 1], errors[at + 2]);
    let E = Pose::new(part(3) * LEVER_M, part(0) * TURN);
    let mut X = E.inv_mul(X_CB) * E;
    X.translation.vector *= (errors[6] * DEPTH).exp();
    Pose::new(X.translation.vector, X.rotation.scaled_axis() * (errors[7] * FOCAL).exp())
}
