//! Schemes C and D: image-based laws, (10.79)-(10.91), as a task for the camera's twist.
//!
//! C hands over the wrench `L^T K_Ps e_s` and the damping `L^T K_Ds L`, so that `u = g + J^T (...)` is (10.84) with
//! `J_L = L_s J` of (10.83). D hands over the normal equations of (10.91).

use super::resolve::damped_factors;
use super::{
    DepthSource, FeatureKind, Interaction, InteractionAt, PoseGains, SetPoint, TwistTask, View, WrenchTask,
};
use crate::features::{Feature, NormalEquations, PointFeature, SegmentFeature};
use crate::messages::MAX_FEATURES;
use nalgebra::{Matrix6, SMatrix, SVector, Vector2, Vector6};

/// Most numbers of an error: segments have four.
const MOST_NUMBERS: usize = 4 * MAX_FEATURES;

/// Image points with their depths, current or desired.
#[derive(Clone, Copy)]
struct Side<'a> {
    s: &'a [Vector2<f64>],
    depths: Depths<'a>,
}

#[derive(Clone, Copy)]
enum Depths<'a> {
    Listed(&'a [f64]),
    Same(f64),
    /// Third row of a pose `X_CO` over the points in O.
    Row([f64; 4], &'a [nalgebra::Point3<f64>]),
}

impl Side<'_> {
    #[inline(always)]
    fn point(&self, i: usize) -> Option<PointFeature> {
        let z_m = match self.depths {
            Depths::Listed(z) => *z.get(i)?,
            Depths::Same(z) => z,
            Depths::Row([x, y, z, t], points) => {
                let p = points.get(i)?;
                x * p.x + y * p.y + z * p.z + t
            }
        };
        // The comparison also catches NaN.
        (z_m > 0.0).then_some(PointFeature { s: *self.s.get(i)?, z_m })
    }

    #[inline(always)]
    fn segment(&self, i: usize, j: usize) -> Option<SegmentFeature> {
        let (a, b) = (self.point(i)?, self.point(j)?);
        Some(SegmentFeature { s: [a.s, b.s], z_m: [a.z_m, b.z_m] })
    }
}

/// Normal equations of the selected features for unit gain: `L_s^T W L_s` and `L_s^T W e_s`, e_s of (10.79).
///
/// Hidden features are left out. `None` when the view is of other features, or one of them has no interaction matrix.
#[must_use]
pub fn image_task(set_point: &SetPoint, view: &View, interaction: Interaction) -> Option<TwistTask> {
    let (now, goal) = sides(set_point, view, interaction)?;
    let mut equations = NormalEquations::<6>::new();
    let mut error2 = 0.0;
    for &(kind, weight) in set_point.selection().features() {
        match kind {
            FeatureKind::Point(i) => {
                let s_d = set_point.features().get(i)?;
                let Some(s) = view.feature(i) else { continue };
                let e = s_d - s;
                error2 += e.norm_squared();
                match interaction.at {
                    InteractionAt::Current => {
                        let p = now.point(i)?;
                        equations.add_point(&p.s, p.z_m, &e, weight);
                    }
                    InteractionAt::Desired => {
                        let p = goal.point(i)?;
                        equations.add_point(&p.s, p.z_m, &e, weight);
                    }
                    InteractionAt::Mean => {
                        let L = mean(&now.point(i)?, &goal.point(i)?)?;
                        equations.add_rows(&L, &e, weight);
                    }
                }
            }
            FeatureKind::Segment(i, j) => {
                if view.feature(i).is_none() || view.feature(j).is_none() {
                    continue;
                }
                let (a, b) = (now.segment(i, j)?, goal.segment(i, j)?);
                let e = a.error(&b.value());
                error2 += e.norm_squared();
                equations.add_rows(&interaction.of(&a, &b)?, &e, weight);
            }
        }
    }
    Some(TwistTask::new(&equations, error2.sqrt()))
}

/// The current and the desired features with the depths of the law's choice; `None` when they are of different points.
fn sides<'a>(
    set_point: &'a SetPoint,
    view: &'a View,
    interaction: Interaction,
) -> Option<(Side<'a>, Side<'a>)> {
    if view.features().len() != set_point.features().len() {
        return None;
    }
    let z_d = match interaction.depth {
        DepthSource::Constant(z_m) => Depths::Same(z_m),
        _ => Depths::Listed(set_point.depths_m()),
    };
    let pose = match interaction.depth {
        DepthSource::Estimated => view.X_CO(),
        DepthSource::Known => view.X_CO_known(),
        DepthSource::Desired | DepthSource::Constant(_) => None,
    };
    let z = pose.map_or(z_d, |X_CO| {
        let R = X_CO.rotation.to_rotation_matrix();
        let row = R.matrix().row(2);
        Depths::Row([row[0], row[1], row[2], X_CO.translation.z], set_point.points())
    });
    let now = Side { s: view.features(), depths: z };
    Some((now, Side { s: set_point.features(), depths: z_d }))
}

/// The gain matrix of a preconditioned scheme C, constant and positive definite:
/// `K_Ps = (L_d^+)^T K_P L_d^+ + k (1 - L_d L_d^+)`, L_d the interaction matrix at the goal.
///
/// At the goal `L_d^T K_Ps L_d = K_P`: the camera is drawn home as stiffly along every direction, where the textbook's
/// `K_Ps = k I` is as unlike as L_s is ill-conditioned. The second part draws at errors that no small motion explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureGains {
    /// K_P: of translations, N/m, and rotations, N m/rad.
    pub K_P: PoseGains,
    /// k, N m.
    pub rest: f64,
}

/// What scheme C collects of its features, W their weights: L_d taken at the goal, L as the law's choice has it.
struct Pairs {
    /// L_d^T W L_d.
    goal: Matrix6<f64>,
    /// L_d^T W L.
    mixed: Matrix6<f64>,
    /// L_d^T W e.
    at_goal: Vector6<f64>,
    /// L^T W e.
    now: Vector6<f64>,
}

impl Pairs {
    fn add<const K: usize>(
        &mut self,
        L_d: &SMatrix<f64, K, 6>,
        L: &SMatrix<f64, K, 6>,
        e: &SVector<f64, K>,
        weight: f64,
    ) {
        let weighted = L_d.transpose() * weight;
        self.goal += weighted * L_d;
        self.mixed += weighted * L;
        self.at_goal += weighted * e;
        self.now += L.transpose() * e * weight;
    }
}

/// Scheme C with a preconditioned K_Ps: the wrench `L^T K_Ps e_s` of (10.84), and the damping `L^T K_Ds L` with
/// `K_Ds = (L^+)^T K_D L^+`, which is K_D on the camera's twist in every view.
///
/// Motions of the camera that the desired features do not show are left alone. `None` as for [`image_task`].
#[must_use]
pub fn preconditioned_wrench(
    set_point: &SetPoint,
    view: &View,
    K_Ps: &FeatureGains,
    K_D: &PoseGains,
    interaction: Interaction,
) -> Option<WrenchTask> {
    let (now, goal) = sides(set_point, view, interaction)?;
    let mut all = Pairs {
        goal: Matrix6::zeros(),
        mixed: Matrix6::zeros(),
        at_goal: Vector6::zeros(),
        now: Vector6::zeros(),
    };
    for &(kind, weight) in set_point.selection().features() {
        match kind {
            FeatureKind::Point(i) => {
                if view.feature(i).is_none() {
                    continue;
                }
                let (a, b) = (now.point(i)?, goal.point(i)?);
                all.add(&b.interaction()?, &interaction.of(&a, &b)?, &(b.s - a.s), weight);
            }
            FeatureKind::Segment(i, j) => {
                if view.feature(i).is_none() || view.feature(j).is_none() {
                    continue;
                }
                let (a, b) = (now.segment(i, j)?, goal.segment(i, j)?);
                all.add(&b.interaction()?, &interaction.of(&a, &b)?, &a.error(&b.value()), weight);
            }
        }
    }
    let factors = damped_factors(&all.goal.data.0)?;
    let solve = |x: Vector6<f64>| Vector6::from(factors.solve(&x.into()));
    let mut B = Matrix6::zeros();
    for (i, column) in all.mixed.column_iter().enumerate() {
        B.set_column(i, &solve(column.into()));
    }
    let twist = solve(all.at_goal);
    let wrench = B.tr_mul(&K_Ps.K_P.component_mul(&twist)) + (all.now - all.mixed.tr_mul(&twist)) * K_Ps.rest;
    Some(WrenchTask { wrench, damping: Matrix6::from_diagonal(K_D) })
}

impl Interaction {
    /// The interaction matrix of a feature that is `now` and shall be at `goal`.
    fn of<const K: usize>(
        &self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
    ) -> Option<SMatrix<f64, K, 6>> {
        match self.at {
            InteractionAt::Current => now.interaction(),
            InteractionAt::Desired => goal.interaction(),
            InteractionAt::Mean => mean(now, goal),
        }
    }
}

/// The mean of two interaction matrices of a feature.
fn mean<const K: usize>(a: &impl Feature<K>, b: &impl Feature<K>) -> Option<SMatrix<f64, K, 6>> {
    Some((a.interaction()? + b.interaction()?) * 0.5)
}

/// Scheme C: wrench and damping of (10.84) with `K_Ps = k_P W` and `K_Ds = k_D W`, W the features' weights.
///
/// `k_P` in N m (force per normalized unit, brought to the joints by J_L), `k_D` in N m s. With `k_D` = 0 damping is left to
/// the joints.
#[must_use]
pub fn image_wrench(task: &TwistTask, k_P: f64, k_D: f64) -> WrenchTask {
    WrenchTask { wrench: task.vector * k_P, damping: task.matrix * k_D }
}

/// The stacked error e_s of the selected features, and how many numbers it has; for plots and checks. NaN for hidden ones.
#[must_use]
pub fn image_error(set_point: &SetPoint, view: &View) -> Option<(SVector<f64, MOST_NUMBERS>, usize)> {
    let mut e = SVector::<f64, MOST_NUMBERS>::zeros();
    let mut count = 0;
    let unit = Depths::Same(1.0);
    let (now, goal) =
        (Side { s: view.features(), depths: unit }, Side { s: set_point.features(), depths: unit });
    for &(kind, _) in set_point.selection().features() {
        match kind {
            FeatureKind::Point(i) => {
                let d = goal.point(i)?.s - now.point(i)?.s;
                e.fixed_rows_mut::<2>(count).copy_from(&d);
                count += 2;
            }
            FeatureKind::Segment(i, j) => {
                let d = now.segment(i, j)?.error(&goal.segment(i, j)?.value());
                e.fixed_rows_mut::<4>(count).copy_from(&d);
                count += 4;
            }
        }
    }
    Some((e, count))
}
