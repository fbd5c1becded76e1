//! Schemes C and D: image-based laws, (10.79)-(10.91), as a task for the camera's twist.
//!
//! Data flow: the selected features of view and set-point and their interaction matrices `L_s` are collected feature by feature, hidden ones left
//! out. Scheme C yields the wrench `L^T K_Ps e_s` and the damping `L^T K_Ds L`, so that `u = g + J^T (...)` is (10.84) with `J_L = L_s J` of
//! (10.83). Scheme D yields the normal equations of (10.91).

mod stacked;

pub(super) use stacked::rows_by;
pub use stacked::{image_error, image_task_by, image_wrench_by, weighted_rows};

use super::resolve::damped_factors;
use super::{
    DepthRow, DepthSource, FeatureKind, Interaction, InteractionAt, OutlineFeature, PoseGains, SetPoint,
    TwistTask, View, WrenchTask,
};
use crate::features::{
    AreaFeature, EllipseFeature, Feature, ImageMoments, MomentFeature, NormalEquations, PointFeature,
    SegmentFeature,
};
use crate::messages::MAX_FEATURES;
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector2, Vector3, Vector6};

/// Image points (normalized) with their depths (m), of the current view or of the set-point.
#[derive(Clone, Copy)]
struct ImagePoints<'a> {
    s: &'a [Vector2<f64>],
    depths: Depths<'a>,
}

#[derive(Clone, Copy)]
enum Depths<'a> {
    Listed(&'a [f64]),
    Same(f64),
    /// Depths that a pose `X_CO` gives to the points, which are given in O.
    Row(DepthRow, &'a [nalgebra::Point3<f64>]),
}

impl ImagePoints<'_> {
    #[inline(always)]
    fn point(&self, i: usize) -> Option<PointFeature> {
        let z_m = match self.depths {
            Depths::Listed(z) => *z.get(i)?,
            Depths::Same(z) => z,
            Depths::Row(row, points) => row.depth_m(points.get(i)?),
        };
        // The comparison also catches NaN.
        (z_m > 0.0).then_some(PointFeature { s: *self.s.get(i)?, z_m })
    }

    #[inline(always)]
    fn segment(&self, i: usize, j: usize) -> Option<SegmentFeature> {
        let (a, b) = (self.point(i)?, self.point(j)?);
        Some(SegmentFeature { s: [a.s, b.s], z_m: [a.z_m, b.z_m] })
    }

    /// Area feature of the polygon with the corners `outline` (indices of points). `None` where the polygon has no area.
    fn area(&self, outline: &[u8]) -> Option<AreaFeature> {
        let mut corners = [Vector2::zeros(); MAX_FEATURES];
        // 1/z = A x + B y + C by least squares: exact for points in a plane
        let (mut matrix, mut vector) = (Matrix3::zeros(), Vector3::zeros());
        for (corner, i) in corners.iter_mut().zip(outline) {
            let point = self.point(usize::from(*i))?;
            *corner = point.s;
            let row = point.s.push(1.0);
            matrix += row * row.transpose();
            vector += row / point.z_m;
        }
        let moments = ImageMoments::of_polygon(corners.get(..outline.len())?);
        Some(AreaFeature::new(moments, matrix.cholesky()?.solve(&vector)))
    }
}

/// What is done with each selected feature that is not hidden. `None` ends the loop: a feature has no interaction matrix.
trait Visitor {
    fn point(&mut self, now: &ImagePoints<'_>, goal: &ImagePoints<'_>, i: usize, weight: f64) -> Option<()> {
        self.pair(&now.point(i)?, &goal.point(i)?, weight)
    }

    fn pair<const K: usize>(
        &mut self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
        weight: f64,
    ) -> Option<()>;

    /// Told of a hidden feature, of which that many numbers are left out.
    fn skip(&mut self, _numbers: usize) {}
}

/// Calls the visitor for each selected feature that is not hidden.
#[inline(always)]
fn visit(
    (set_point, view): (&SetPoint, &View),
    (now, goal): (&ImagePoints<'_>, &ImagePoints<'_>),
    visitor: &mut impl Visitor,
) -> Option<()> {
    let selection = set_point.selection();
    for &(kind, weight) in selection.features() {
        match kind {
            FeatureKind::Point(i) => {
                if view.feature(i).is_some() {
                    visitor.point(now, goal, i, weight)?;
                } else {
                    visitor.skip(kind.numbers());
                }
            }
            FeatureKind::Segment(i, j) => {
                if view.feature(i).is_some() && view.feature(j).is_some() {
                    visitor.pair(&now.segment(i, j)?, &goal.segment(i, j)?, weight)?;
                } else {
                    visitor.skip(kind.numbers());
                }
            }
            FeatureKind::Outline(feature) => {
                let outline = selection.outline();
                if outline.iter().all(|i| view.feature(usize::from(*i)).is_some()) {
                    visit_area(feature, &now.area(outline)?, &goal.area(outline)?, weight, visitor)?;
                } else {
                    visitor.skip(kind.numbers());
                }
            }
        }
    }
    Some(())
}

fn visit_area(
    feature: OutlineFeature,
    now: &AreaFeature,
    goal: &AreaFeature,
    weight: f64,
    visitor: &mut impl Visitor,
) -> Option<()> {
    let now = now.in_sense_of(goal);
    match feature {
        OutlineFeature::Area => visitor.pair(&now, goal, weight),
        OutlineFeature::Ellipse => {
            visitor.pair(&EllipseFeature::of_area(&now), &EllipseFeature::of_area(goal), weight)
        }
        OutlineFeature::Moments => {
            let reference_m = goal.depth_m()? * goal.moments().area().sqrt();
            let [now, goal] = [now, *goal].map(|area| MomentFeature::new(area, reference_m));
            visitor.pair(&now, &goal, weight)
        }
    }
}

/// `L_s^T W L_s`, `L_s^T W e_s` and the squared norm of `e_s`.
struct Equations {
    interaction: Interaction,
    equations: NormalEquations<6>,
    error2: f64,
}

impl Visitor for Equations {
    #[inline(always)]
    fn point(&mut self, now: &ImagePoints<'_>, goal: &ImagePoints<'_>, i: usize, weight: f64) -> Option<()> {
        let e = goal.s.get(i)? - now.s.get(i)?;
        self.error2 += e.norm_squared();
        let p = match self.interaction.at {
            InteractionAt::Current => now.point(i)?,
            InteractionAt::Desired => goal.point(i)?,
            InteractionAt::Mean | InteractionAt::Estimated => {
                let L = mean(&now.point(i)?, &goal.point(i)?)?;
                self.equations.add_rows(&L, &e, weight);
                return Some(());
            }
        };
        self.equations.add_point(&p.s, p.z_m, &e, weight);
        Some(())
    }

    fn pair<const K: usize>(
        &mut self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
        weight: f64,
    ) -> Option<()> {
        let e = now.error(&goal.value());
        self.error2 += e.norm_squared();
        self.equations.add_rows(&self.interaction.of(now, goal)?, &e, weight);
        Some(())
    }
}

/// Normal equations of the selected features for unit gain: `L_s^T W L_s` (6 x 6) and `L_s^T W e_s`, with `e_s = s_d - s` of (10.79) and the
/// features' weights W. The twist is that of the camera in C.
///
/// Hidden features are left out. `None` when the view does not belong to the set-point's features, or one of them has no interaction matrix.
#[must_use]
pub fn image_task(set_point: &SetPoint, view: &View, interaction: Interaction) -> Option<TwistTask> {
    let (now, goal) = sides(set_point, view, interaction)?;
    let mut all = Equations { interaction, equations: NormalEquations::new(), error2: 0.0 };
    visit((set_point, view), (&now, &goal), &mut all)?;
    Some(TwistTask::new(&all.equations, all.error2.sqrt()))
}

/// Directions whose square is a smaller share of the greatest one's count as not determined by the features. Chosen by hand between the rounding of
/// squares, 2e-16, and the weakest direction of a target that is a fiftieth of its distance, which has a hundred times as much.
const MIN_SHARE: f64 = 1e-12;
/// Bound of the entries of an interaction matrix of features that are defined. Chosen by hand: beyond it a feature has nearly lost its meaning
/// (the axis of a nearly round area), and squares lose the small ones.
const MAX_SQUARE: f64 = 1e12;

/// In how many directions of the camera's motion, 0 to 6, the selected features change at the goal. `None` where one of them is not defined there.
#[must_use]
pub fn determined_directions(set_point: &SetPoint) -> Option<usize> {
    let at_goal = View::new(set_point.features().iter().copied(), None)?;
    let at_desired = Interaction { at: InteractionAt::Desired, depth: DepthSource::Desired };
    let matrix = image_task(set_point, &at_goal, at_desired)?.matrix;
    let is_defined = matrix.iter().all(|x| x.abs() < MAX_SQUARE);
    let squares = is_defined.then(|| matrix.symmetric_eigenvalues())?;
    Some(squares.iter().filter(|x| **x > MIN_SHARE * squares.max()).count())
}

/// The current and the desired points with depths as `interaction` chooses them; `None` when they do not belong together.
fn sides<'a>(
    set_point: &'a SetPoint,
    view: &'a View,
    interaction: Interaction,
) -> Option<(ImagePoints<'a>, ImagePoints<'a>)> {
    if view.features().len() != set_point.features().len() {
        return None;
    }
    let z_d = match interaction.depth {
        DepthSource::Constant(z_m) => Depths::Same(z_m),
        _ => Depths::Listed(set_point.depths_m()),
    };
    let row = match interaction.depth {
        DepthSource::Estimated => view.X_CO().map(DepthRow::of),
        DepthSource::Known => view.X_CO_known().map(DepthRow::of),
        DepthSource::Initial => view.initial_depths().copied(),
        DepthSource::Desired | DepthSource::Constant(_) => None,
    };
    let z = row.map_or(z_d, |row| Depths::Row(row, set_point.points()));
    let now = ImagePoints { s: view.features(), depths: z };
    Some((now, ImagePoints { s: set_point.features(), depths: z_d }))
}

/// The gain matrix of a preconditioned scheme C, constant and positive definite:
/// `K_Ps = (L_d^+)^T K_P L_d^+ + k (1 - L_d L_d^+)`, L_d the interaction matrix at the goal.
///
/// At the goal `L_d^T K_Ps L_d = K_P`, so that the stiffness towards the goal is K_P for every motion of the camera. With the textbook's
/// `K_Ps = k I` the stiffnesses of different motions differ by the squared condition number of L_s. The second term acts on feature errors
/// outside of the range of L_d, which no small motion of the camera explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureGains {
    /// K_P: of translations, N/m, and rotations, N m/rad.
    pub K_P: PoseGains,
    /// k, N m.
    pub rest: f64,
}

/// The sums that preconditioned scheme C forms over its features, with weights W: L_d is the interaction matrix at the goal, L the one that the
/// law's [`Interaction`] chooses.
struct Pairs {
    interaction: Interaction,
    /// L_d^T W L_d.
    goal: Matrix6<f64>,
    /// L_d^T W L.
    mixed: Matrix6<f64>,
    /// L_d^T W e.
    at_goal: Vector6<f64>,
    /// L^T W e.
    now: Vector6<f64>,
}

impl Visitor for Pairs {
    fn pair<const K: usize>(
        &mut self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
        weight: f64,
    ) -> Option<()> {
        let (L_d, L) = (goal.interaction()?, self.interaction.of(now, goal)?);
        let e = now.error(&goal.value());
        let weighted = L_d.transpose() * weight;
        self.goal += weighted * L_d;
        self.mixed += weighted * L;
        self.at_goal += weighted * e;
        self.now += L.transpose() * e * weight;
        Some(())
    }
}

/// Scheme C with a preconditioned K_Ps: the wrench `L^T K_Ps e_s` of (10.84), and the damping `L^T K_Ds L` with
/// `K_Ds = (L^+)^T K_D L^+`, which is the damping K_D of the camera's twist at every view.
///
/// Motions of the camera that do not move the desired features get neither force nor damping. `None` as for [`image_task`].
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
        interaction,
        goal: Matrix6::zeros(),
        mixed: Matrix6::zeros(),
        at_goal: Vector6::zeros(),
        now: Vector6::zeros(),
    };
    visit((set_point, view), (&now, &goal), &mut all)?;
    let factors = damped_factors(&all.goal.data.0)?;
    let solve = |x: Vector6<f64>| Vector6::from(factors.solve(&x.into()));
    let mut B = Matrix6::zeros();
    for (i, column) in all.mixed.column_iter().enumerate() {
        B.set_column(i, &solve(column.into()));
    }
    let twist = solve(all.at_goal);
    let wrench = B.tr_mul(&K_Ps.K_P.times(&twist)) + (all.now - all.mixed.tr_mul(&twist)) * K_Ps.rest;
    Some(WrenchTask { wrench, damping: K_D.matrix() })
}

impl Interaction {
    /// The interaction matrix of a feature with the current value `now` and the desired value `goal`, as the [`Interaction`] chooses.
    fn of<const K: usize>(
        &self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
    ) -> Option<SMatrix<f64, K, 6>> {
        match self.at {
            InteractionAt::Current => now.interaction(),
            InteractionAt::Desired => goal.interaction(),
            InteractionAt::Mean | InteractionAt::Estimated => mean(now, goal),
        }
    }
}

/// The mean of two interaction matrices of a feature.
fn mean<const K: usize>(a: &impl Feature<K>, b: &impl Feature<K>) -> Option<SMatrix<f64, K, 6>> {
    Some((a.interaction()? + b.interaction()?) * 0.5)
}

/// Scheme C: wrench and damping of (10.84) with `K_Ps = k_P W` and `K_Ds = k_D W`, W the features' weights.
///
/// `k_P` in N m (force per normalized unit, mapped to the joints by J_L^T), `k_D` in N m s. With `k_D` = 0 only the damping of the joints acts.
#[must_use]
pub fn image_wrench(task: &TwistTask, k_P: f64, k_D: f64) -> WrenchTask {
    WrenchTask { wrench: task.vector * k_P, damping: task.matrix * k_D }
}
