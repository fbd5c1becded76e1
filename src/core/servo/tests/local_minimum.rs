//! Errors in the null space of L_s^T: the law asks for nothing, and [`felt_share`] says so.

use super::{goal, pose, seen, square};
use crate::features::point_rows;
use crate::geometry::Pose;
use crate::servo::*;
use nalgebra::{DMatrix, DVector, Vector2, Vector6};
use proptest::prelude::*;

const AT_GOAL: Interaction = Interaction { at: InteractionAt::Desired, depth: DepthSource::Desired };

fn laws(K: &FeatureMatrix) -> [Law; 4] {
    let (gain, damping) = (Gain::Constant(1.0), Damping::Joints([1.0; crate::messages::MAX_JOINTS]));
    let K_P = Vector6::new(500.0, 400.0, 300.0, 20.0, 10.0, 30.0).into();
    [
        Law::ImageVelocity { K_s: 1.0.into(), gain, interaction: AT_GOAL },
        Law::ImageVelocity { K_s: K.clone(), gain, interaction: AT_GOAL },
        Law::ImageTorque { K_Ps: K.clone(), damping, interaction: AT_GOAL },
        Law::PreconditionedTorque {
            K_Ps: FeatureGains { K_P, rest: 300.0 },
            damping: Damping::Task(PoseGains::repeat(1.0)),
            interaction: AT_GOAL,
        },
    ]
}

/// The six numbers that a law asks for: a twist, or a wrench.
fn asked(law: &Law, set_point: &SetPoint, view: &View) -> Vector6<f64> {
    match law.task(set_point, view).unwrap() {
        Task::Twist(task) => task.vector,
        Task::Wrench(task) => task.wrench,
    }
}

proptest! {
    /// `K e = n` with `L^T n = 0`, by the singular vectors of L as printed: nothing is asked for, and nothing felt; with a part in the range of L
    /// that is three quarters of n's norm the share is 0.6.
    #[test]
    fn an_error_in_the_null_space_is_not_felt(X_DO in pose(), a in prop::collection::vec(0.5..2.0f64, 8), k in 0..2usize) {
        let points = square().map(|p| X_DO * p);
        let mut L = DMatrix::zeros(8, 6);
        for (i, p) in points.iter().enumerate() {
            L.view_mut((2 * i, 0), (2, 6)).copy_from(&point_rows(&(p.coords.xy() / p.z), p.z));
        }
        // In views whose L is nearly singular rounding is as large as what is to be shown.
        let singular_values = L.singular_values();
        prop_assume!(singular_values.min() > 1e-3 * singular_values.max());
        let null = (DMatrix::identity(8, 8) - &L * L.clone().pseudo_inverse(1e-9).unwrap()).svd(true, false);
        // What the singular vectors of a projector leave in the range of L is taken off again, twice as for Gram-Schmidt.
        let Q = L.clone().qr().q();
        let mut n: DVector<f64> = null.u.unwrap().column(k) * 0.01;
        (0..2).for_each(|_| n -= &Q * (Q.transpose() * &n));
        // What was taken off may have been a thousandth of it.
        n = n.normalize() * 0.01;
        prop_assert!((L.transpose() * &n).norm() < 1e-12);
        let K = FeatureMatrix::diagonal(&a).unwrap();
        let in_range = L.column(5).normalize() * 0.0075;
        for (i, law) in laws(&K).iter().enumerate() {
            let gain = |j: usize| if i == 1 || i == 2 { a[j] } else { 1.0 };
            let view_of = |y: &DVector<f64>| {
                let e = |j: usize| y[j] / gain(j);
                let s = (0..4).map(|j| {
                    let p = points[j].coords;
                    Vector2::new(p.x / p.z - e(2 * j), p.y / p.z - e(2 * j + 1))
                });
                View::new(s, Some(X_DO)).unwrap()
            };
            let set_point = goal(&X_DO);
            let still = view_of(&n);
            let felt = felt_share(law, &set_point, &still).unwrap();
            let (stiff, moving) = (asked(law, &set_point, &still).norm(), view_of(&(&n + &in_range)));
            // Rounding of features to 1e-16 is 1e-14 of n, and a thousand times as much of what a nearly singular L leaves, squared.
            prop_assert!(felt < 1e-7 && stiff < 1e-7 * asked(law, &set_point, &moving).norm(), "{i} {felt} {stiff}");
            if i < 3 {
                let felt = felt_share(law, &set_point, &moving).unwrap();
                prop_assert!((felt - 0.6).abs() < 1e-9, "{i} {felt}");
            }
        }
        let b = Law::PositionVelocity {
            K: PoseGains::repeat(1.0),
            gain: Gain::Constant(1.0),
            orientation: OrientationError::AngleAxis,
            space: OperationalSpace::Six,
            weights: TwistWeights::Unit,
        };
        prop_assert_eq!(felt_share(&b, &goal(&X_DO), &seen(&(Pose::translation(0.01, 0.0, 0.0) * X_DO), &square())), None);
    }
}
