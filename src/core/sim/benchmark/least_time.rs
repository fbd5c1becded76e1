//! The least time in which the arm can come from its start to any posture that shows the goal: one bound for all laws.
//!
//! `T = min over q_g of max over joints i of t_i(|q_g,i - q_s,i|)`, with t_i the least time of a joint from rest to rest within its limits of velocity,
//! acceleration and jerk ([`min_time_s`]). The postures q_g are those that searches from the start, from the goal and from everywhere in the ranges find, each
//! joint also whole turns farther; of redundant arms the one with the least time among them is improved by random steps along what leaves the camera where it is.

use crate::geometry::Pose;
use crate::linalg::Random;
use crate::motion::{MotionLimits, min_time_s};
use crate::servo::PostureSearch;
use nalgebra::SVector;
use std::f64::consts::TAU;

/// Random postures from which the search begins anew. Chosen by hand: the eight postures of an arm with six joints are found by a start in ten each, all by
/// 40 with 98 %.
const SEARCHES: usize = 40;
/// Steps of a redundant arm, and the first and last of their lengths, rad or m. Chosen by hand: twice as many change the bound of Panda and xArm7 by less than 1 %.
const STEPS: u32 = 200;
/// The first length. Chosen by hand, as told there.
const LONG: f64 = 0.3;
/// The last length. Chosen by hand, as told there.
const FINE: f64 = 0.01;
/// A posture is at the goal when its camera is within this of it, m and rad: far below what an image shows.
const THERE: f64 = 1e-6;

/// Whether the camera at `q` is at `X_WD`.
pub(super) fn is_there<const N: usize>(
    search: &PostureSearch<'_, N>,
    q: &SVector<f64, N>,
    X_WD: &Pose,
) -> bool {
    let off = search.X_WC(q).inv_mul(X_WD);
    off.translation.vector.norm() < THERE
        && off.rotation.angle() < THERE
        && search.robot.outside_limits(q).is_none()
}

/// The bound, s, from `q_start` to the camera pose `X_WD`, which `q_goal` has.
pub(super) fn least_time_s<const N: usize>(
    search: &PostureSearch<'_, N>,
    limits: &MotionLimits<N>,
    q_start: &SVector<f64, N>,
    q_goal: &SVector<f64, N>,
    X_WD: &Pose,
) -> f64 {
    let mut random = Random::new(3);
    let mut least = (f64::INFINITY, *q_goal);
    let consider = |q: &SVector<f64, N>, least: &mut (f64, SVector<f64, N>)| {
        let q = nearest_turns(search, q, q_start);
        let time_s = min_time_s(limits, q_start, &q);
        if time_s < least.0 {
            *least = (time_s, q);
        }
    };
    consider(q_goal, &mut least);
    for k in 0..=SEARCHES {
        let from = if k == 0 { *q_start } else { search.anywhere(&mut random) };
        let q = search.towards(&from, X_WD);
        if is_there(search, &q, X_WD) {
            consider(&q, &mut least);
        }
    }
    if N > 6 {
        for k in 0..STEPS {
            let length = LONG * (FINE / LONG).powf(f64::from(k) / f64::from(STEPS));
            let step = SVector::<f64, N>::from_fn(|_, _| random.between(-length, length));
            let q = search.towards(&(least.1 + step), X_WD);
            if is_there(search, &q, X_WD) {
                consider(&q, &mut least);
            }
        }
    }
    least.0
}

/// Each joint that can make whole turns at the one next to where it starts.
fn nearest_turns<const N: usize>(
    search: &PostureSearch<'_, N>,
    q: &SVector<f64, N>,
    q_start: &SVector<f64, N>,
) -> SVector<f64, N> {
    let limits = search.robot.limits();
    SVector::from_fn(|i, _| {
        let turned = q[i] - TAU * ((q[i] - q_start[i]) / TAU).round();
        let may = !search.robot.is_prismatic(i) && turned >= limits[i].lower && turned <= limits[i].upper;
        if may { turned } else { q[i] }
    })
}
