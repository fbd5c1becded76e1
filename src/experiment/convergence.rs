//! Random starts in six degrees of freedom: which share of them each scheme brings home, and what becomes of the others.
//!
//! The camera moves freely. Under the velocity schemes it takes the twist of each frame for 0.04 s; under the torque
//! schemes it is a ball of 1 kg with the camera in its middle, on which the held wrench acts.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::cell::{POINTS, project};
use super::feature_source::camera;
use super::findings::Findings;
use super::plot::{Panel, Series, figure};
use super::schemes::{Scheme, set_point};
use super::{ExperimentError, Options};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, Twist, integrate_body_twist, rotation_angle};
use crate::linalg::Random;
use crate::messages::MAX_JOINTS;
use crate::pose::{Correspondence, planar_pose};
use crate::robot::CameraJacobian;
use crate::servo::{
    Arm, Damping, DepthSource, FeatureGains, Gain, HybridGains, Interaction, InteractionAt, Law, LawOutput,
    OperationalSpace, OrientationError, Selection, SetPoint, TwistWeights, View, VisibilityGuard,
};
use crate::sim::{ClosedLoop, frame_every, run};
use nalgebra::{Matrix6, Rotation3, Unit, Vector2, Vector3, Vector6};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::ControlFlow::{self, Break, Continue};

/// Largest rotation between start and goal, rad.
const ROTATION_RAD: f64 = std::f64::consts::FRAC_PI_3;
const FRAME_S: f64 = 0.04;
const SUBSTEPS: usize = 10;
/// A run is over after this time.
const SPAN_S: f64 = 120.0;
const FRAMES: u64 = (SPAN_S / FRAME_S) as u64;
/// Converged: so near to the goal.
const NEAR: (f64, f64) = (0.5e-3, 0.1 * std::f64::consts::PI / 180.0);
/// Right in the image: root mean square over the points, px.
const NEAR_PX: f64 = 0.1;
/// Farther away than this: diverged, m.
const FAR_M: f64 = 5.0;
/// The ball of the torque schemes.
const MASS_KG: f64 = 1.0;
const INERTIA_KG_M2: f64 = 0.25;
/// Slower than this (m/s, rad/s) away from the goal counts as standing still.
const STILL: f64 = 1e-7;

/// What became of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum StartOutcome {
    /// Within 0.5 mm and 0.1 degree of the goal.
    Converged,
    /// The image is right to 0.1 px, but the camera is still on its way along a direction that hardly shows in it.
    ImageOnly,
    /// A point left the image.
    LeftImage,
    /// A point came behind the camera, or the plane was seen from its edge.
    TargetLost,
    /// The law had no finite answer.
    NoAnswer,
    /// More than 5 m away.
    Diverged,
    /// At rest elsewhere: a local minimum.
    LocalMinimum,
    /// Still on the way after 120 s.
    TooSlow,
}

impl StartOutcome {
    /// For files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::ImageOnly => "in the image only",
            Self::LeftImage => "left the image",
            Self::TargetLost => "lost sight",
            Self::NoAnswer => "no answer",
            Self::Diverged => "diverged",
            Self::LocalMinimum => "local minimum",
            Self::TooSlow => "too slow",
        }
    }
}

/// One run: what became of it, and how far the image was from the desired one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConvergenceRun {
    /// What became of it.
    pub outcome: StartOutcome,
    /// When, s.
    pub time_s: f64,
    /// Root mean square over the points at the start, px.
    pub first_error_px: f64,
    /// The same at the end, px; NaN where a point is behind the camera.
    pub last_error_px: f64,
}

/// The desired pose: the square centred, 0.6 m ahead, parallel to the image.
#[must_use]
pub(super) fn goal() -> Pose {
    Pose::translation(-0.05, -0.05, 0.6)
}

/// What is compared: the schemes of the comparison as the text has them, D with the depths of the true pose, C with a
/// preconditioned K_Ps; and all of them with estimated depths and the target kept in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawVariant {
    /// For files.
    pub name: &'static str,
    scheme: Scheme,
    depth: DepthSource,
    /// Whether features are kept in the image.
    guarded: bool,
}

/// All variants.
pub const LAW_VARIANTS: [LawVariant; 12] = {
    const fn with_desired_depth(name: &'static str, scheme: Scheme) -> LawVariant {
        LawVariant { name, scheme, depth: DepthSource::Desired, guarded: false }
    }
    const fn guarded(name: &'static str, scheme: Scheme) -> LawVariant {
        LawVariant { name, scheme, depth: DepthSource::Estimated, guarded: true }
    }
    [
        with_desired_depth("A", Scheme::A),
        with_desired_depth("B", Scheme::B),
        with_desired_depth("C", Scheme::C),
        with_desired_depth("D", Scheme::D),
        LawVariant { name: "D-true-depth", scheme: Scheme::D, depth: DepthSource::Known, guarded: false },
        with_desired_depth("hybrid", Scheme::Hybrid),
        LawVariant {
            name: "C-preconditioned",
            scheme: Scheme::C,
            depth: DepthSource::Estimated,
            guarded: false,
        },
        guarded("A-guarded", Scheme::A),
        guarded("B-guarded", Scheme::B),
        guarded("C-guarded", Scheme::C),
        guarded("D-guarded", Scheme::D),
        guarded("hybrid-guarded", Scheme::Hybrid),
    ]
};

/// The laws in six degrees of freedom: the gains of the comparison where they carry over, else critically damped ones.
fn law(variant: &LawVariant) -> Law {
    let interaction = Interaction { at: InteractionAt::Current, depth: variant.depth };
    let (orientation, space) = (OrientationError::AngleAxis, OperationalSpace::Six);
    let inertia = Vector6::new(MASS_KG, MASS_KG, MASS_KG, INERTIA_KG_M2, INERTIA_KG_M2, INERTIA_KG_M2);
    match variant.scheme {
        Scheme::A => Law::PositionTorque {
            K_P: (inertia * 4.0).into(),
            damping: Damping::Task((inertia * 4.0).into()),
            orientation,
            space,
        },
        Scheme::B => Law::PositionVelocity {
            K: Vector6::new(1.0, 1.0, 1.0, 2.0, 2.0, 2.0).into(),
            gain: Gain::Constant(1.0),
            orientation,
            space,
            weights: TwistWeights::Unit,
        },
        // K_P and K_D of A; L_s at the goal too, which with such gains is quicker than at the current features.
        Scheme::C if variant.depth != DepthSource::Desired => Law::PreconditionedTorque {
            K_Ps: FeatureGains { K_P: (inertia * 4.0).into(), rest: 10.0 },
            damping: Damping::Task((inertia * 4.0).into()),
            interaction: Interaction { at: InteractionAt::Desired, ..interaction },
        },
        // Damped on the camera's twist: damping in the image leaves the weak directions to swing. A transposed Jacobian
        // is as slow in them as L_s is ill-conditioned; the strong ones take no more at 25 Hz.
        Scheme::C => Law::ImageTorque {
            K_Ps: 10.0.into(),
            damping: Damping::Joints([12.0, 12.0, 12.0, 3.0, 3.0, 3.0, 0.0]),
            interaction,
        },
        Scheme::D => Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction },
        Scheme::Hybrid => Law::Hybrid {
            gains: HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(2.0).into() },
            gain: Gain::Constant(1.0),
            orientation,
            space,
            depth: DepthSource::Desired,
        },
    }
}

/// The guard of the variants: points have no size here.
fn guard(camera: &CameraModel) -> VisibilityGuard {
    VisibilityGuard {
        camera: *camera,
        margin_px: 10.0,
        mark_radius_m: 0.0,
        rate_1_s: 4.0,
        acceleration: [f64::INFINITY; MAX_JOINTS],
    }
}

fn in_view(camera: &CameraModel, X_CO: &Pose) -> bool {
    POINTS.iter().all(|p| camera.project(&(X_CO * p)).is_some_and(|px| camera.contains(&px, 0.0)))
}

/// Whether the square's front faces the camera.
fn faces(X_CO: &Pose) -> bool {
    let centre = X_CO * nalgebra::Point3::new(0.05, 0.05, 0.0);
    (X_CO.rotation * Vector3::z()).dot(&centre.coords) > 0.0
}

/// Start number `n`: any axis, up to 60 degrees, 0.3 to 1.2 m away, the whole square in view.
#[must_use]
pub fn start(camera: &CameraModel, n: usize) -> Pose {
    // By its number, so that any thread may run it.
    let mut random = Random::new((n as u64).wrapping_mul(0xD1B5_4A32_D192_ED03));
    loop {
        let axis = Vector3::from_fn(|_, _| random.between(-1.0, 1.0));
        let length = axis.norm();
        let turn = random.between(0.0, ROTATION_RAD);
        let centre =
            Vector3::new(random.between(-0.4, 0.4), random.between(-0.3, 0.3), random.between(0.3, 1.2));
        if !(0.1..=1.0).contains(&length) {
            continue;
        }
        let R = Rotation3::from_axis_angle(&Unit::new_normalize(axis), turn);
        let p = centre - R * Vector3::new(0.05, 0.05, 0.0);
        let X_CO = Pose::from_parts(p.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&R));
        if in_view(camera, &X_CO) && faces(&X_CO) {
            return X_CO;
        }
    }
}

/// One run from a start to its outcome.
#[must_use]
pub fn run_from(from: &Pose, camera: &CameraModel, variant: &LawVariant, goal: &SetPoint) -> ConvergenceRun {
    let error_px = |X_CO: &Pose| goal.error_rms_px_at(X_CO, &Vector2::repeat(camera.intrinsics().fx_px));
    let mut free = FreeCameraLoop {
        camera,
        set_point: goal,
        locates: variant.scheme.is_position_based() || variant.depth == DepthSource::Estimated,
        guard: variant.guarded.then(|| guard(camera)),
        law: law(variant),
        X_CO: *from,
        V: Twist::zeros(),
        estimate: None,
    };
    let (outcome, time_s) = run(&frame_every(1), &mut free);
    let last_error_px = error_px(&free.X_CO);
    let image_only = outcome == StartOutcome::TooSlow && last_error_px <= NEAR_PX;
    let outcome = if image_only { StartOutcome::ImageOnly } else { outcome };
    ConvergenceRun { outcome, time_s, first_error_px: error_px(from), last_error_px }
}

/// A run; its ticks are frames. It ends with its outcome and time, s.
struct FreeCameraLoop<'a> {
    camera: &'a CameraModel,
    set_point: &'a SetPoint,
    locates: bool,
    guard: Option<VisibilityGuard>,
    law: Law,
    X_CO: Pose,
    V: Twist,
    estimate: Option<Pose>,
}

impl ClosedLoop for FreeCameraLoop<'_> {
    type Observation = [Vector2<f64>; 4];
    type Outcome = (StartOutcome, f64);

    fn sense(&mut self, frame: u64) -> ControlFlow<Self::Outcome> {
        if frame >= FRAMES {
            return Break((StartOutcome::TooSlow, SPAN_S));
        }
        let X_DC = goal() * self.X_CO.inverse();
        let away = X_DC.translation.vector.norm();
        let angle = rotation_angle(&X_DC.rotation.to_rotation_matrix());
        if away <= NEAR.0 && angle <= NEAR.1 && self.V.norm() < 0.1 {
            return Break((StartOutcome::Converged, time_s(frame)));
        }
        if away < FAR_M { Continue(()) } else { Break((StartOutcome::Diverged, time_s(frame))) }
    }

    fn see(&mut self, frame: u64, _: u64) -> ControlFlow<Self::Outcome, Self::Observation> {
        let Some(s) = project(&self.X_CO).filter(|_| faces(&self.X_CO)) else {
            return Break((StartOutcome::TargetLost, time_s(frame)));
        };
        if !in_view(self.camera, &self.X_CO) {
            return Break((StartOutcome::LeftImage, time_s(frame)));
        }
        if self.locates {
            self.estimate = locate(&s, self.estimate.as_ref());
            if self.estimate.is_none() {
                return Break((StartOutcome::NoAnswer, time_s(frame)));
            }
        }
        Continue(s)
    }

    fn act(&mut self, frame: u64, seen: Option<Self::Observation>) -> ControlFlow<Self::Outcome> {
        let J = CameraJacobian::of_moving_camera(Matrix6::identity());
        let arm = Arm { J, qd: self.V, gravity: Vector6::zeros() };
        let law_output = seen
            .and_then(|s| View::new(s.into_iter(), self.estimate))
            .map(|view| view.with_known(Some(self.X_CO)))
            .and_then(|view| {
                let task = self.law.task(self.set_point, &view).ok()?;
                let law_output = self.law.output(&task, &arm)?;
                let Some(guard) = &self.guard else { return Some(law_output) };
                Some(guard.hold(self.set_point, &view, (&task, &self.law.joint_damping()), &arm, law_output))
            });
        let still = match law_output {
            None => return Break((StartOutcome::NoAnswer, time_s(frame))),
            Some(LawOutput::Velocity(twist)) => {
                self.V = twist;
                self.X_CO = integrate_body_twist(&Pose::identity(), &twist, FRAME_S).inverse() * self.X_CO;
                twist.norm() < STILL
            }
            Some(LawOutput::Torque(wrench)) => {
                (self.X_CO, self.V) = ball(&self.X_CO, &self.V, &wrench);
                self.V.norm() < STILL && wrench.norm() < STILL
            }
        };
        if still { Break((StartOutcome::LocalMinimum, time_s(frame))) } else { Continue(()) }
    }
}

fn time_s(frame: u64) -> f64 {
    frame as f64 * FRAME_S
}

/// Pose from the four points; of two solutions the one nearer to that of the frame before.
fn locate(s: &[Vector2<f64>; 4], before: Option<&Pose>) -> Option<Pose> {
    let mut points = [Correspondence { r: Vector2::zeros(), s: Vector2::zeros() }; 4];
    for ((point, p), s) in points.iter_mut().zip(&POINTS).zip(s) {
        *point = Correspondence { r: p.coords.xy(), s: *s };
    }
    let both = planar_pose(&points).ok()?;
    // Without noise the true solution fits exactly; the mirrored one is taken for near only where it fits as well.
    let twins = both.other.is_some_and(|other| other.rms < both.best.rms + 1e-9);
    Some(match before {
        Some(before) if twins => both.nearest(before).X_CO,
        _ => both.best.X_CO,
    })
}

/// The free ball under a held wrench (in its own frame) for one frame.
fn ball(X_CO: &Pose, V: &Twist, wrench: &Vector6<f64>) -> (Pose, Twist) {
    let (mut X_CO, mut V) = (*X_CO, *V);
    let h = FRAME_S / SUBSTEPS as f64;
    for _ in 0..SUBSTEPS {
        let (v, w): (Vector3<f64>, Vector3<f64>) = (V.fixed_rows::<3>(0).into(), V.fixed_rows::<3>(3).into());
        let a = wrench.fixed_rows::<3>(0) / MASS_KG - w.cross(&v);
        let b = wrench.fixed_rows::<3>(3) / INERTIA_KG_M2;
        let next = V + Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z) * h;
        X_CO = integrate_body_twist(&Pose::identity(), &((V + next) * 0.5), h).inverse() * X_CO;
        V = next;
    }
    (X_CO, V)
}

/// Starts `0..count` of one variant, run on every core.
///
/// # Errors
/// [`ExperimentError::Cell`], [`ExperimentError::Worker`].
pub fn runs_of(variant: &LawVariant, count: usize) -> Result<Vec<ConvergenceRun>, ExperimentError> {
    let camera = camera()?;
    let goal = set_point(&goal(), Selection::all_points(POINTS.len()))?;
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(count.max(1));
    let worker = |cause: String| ExperimentError::Worker { cause };
    let not_run = ConvergenceRun {
        outcome: StartOutcome::TooSlow,
        time_s: f64::NAN,
        first_error_px: f64::NAN,
        last_error_px: f64::NAN,
    };
    let mut all = vec![not_run; count];
    let share = count.div_ceil(workers).max(1);
    std::thread::scope(|scope| {
        let mut handles = Vec::new();
        for (i, part) in all.chunks_mut(share).enumerate() {
            let (camera, goal) = (&camera, &goal);
            let work = move || {
                for (k, slot) in part.iter_mut().enumerate() {
                    *slot = run_from(&start(camera, i * share + k), camera, variant, goal);
                }
            };
            let name = format!("convergence-{i}");
            let spawned = std::thread::Builder::new().name(name).spawn_scoped(scope, work);
            handles.push(spawned.map_err(|e| worker(e.to_string()))?);
        }
        handles.into_iter().try_for_each(|h| h.join().map_err(|_| worker("it panicked".into())))
    })?;
    Ok(all)
}

pub(super) fn convergence(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let camera = camera()?;
    let mut out = Findings::default();
    let mut table = String::from("start,rotation_rad,distance_m");
    let mut columns = Vec::new();
    let mut panel = Panel::new("converged within t", "t [s]", "share of the starts [%]").y_range(0.0, 100.0);
    for (i, variant) in LAW_VARIANTS.iter().enumerate() {
        (options.progress)(&format!("scheme {}: {} starts", variant.name, options.count));
        let runs = runs_of(variant, options.count)?;
        let mut counts = BTreeMap::new();
        runs.iter().for_each(|run| *counts.entry(run.outcome).or_insert(0usize) += 1);
        let home = counts.get(&StartOutcome::Converged).copied().unwrap_or(0);
        let percent = 100.0 * home as f64 / options.count.max(1) as f64;
        let in_image = home + counts.get(&StartOutcome::ImageOnly).copied().unwrap_or(0);
        let in_image_percent = 100.0 * in_image as f64 / options.count.max(1) as f64;
        let others: Vec<_> = counts
            .iter()
            .filter(|(outcome, _)| **outcome != StartOutcome::Converged)
            .map(|(outcome, count)| format!("{} {count}", outcome.name()))
            .collect();
        out.lines.push(format!("{:12} {percent:6.2} % converged; {}", variant.name, others.join(", ")));
        let reasons: Map<String, Value> =
            counts.iter().map(|(outcome, count)| (outcome.name().to_string(), json!(count))).collect();
        out.metric(
            variant.name,
            json!({ "starts": options.count, "converged_percent": percent,
                    "converged_in_image_percent": in_image_percent, "outcomes": reasons }),
        );
        let mut times: Vec<f64> =
            runs.iter().filter(|f| f.outcome == StartOutcome::Converged).map(|f| f.time_s).collect();
        times.sort_by(f64::total_cmp);
        let share =
            times.iter().enumerate().map(|(n, t)| (*t, 100.0 * (n + 1) as f64 / options.count as f64));
        panel.push(Series::line(i, share.collect::<Vec<_>>()).label(variant.name));
        let _ = write!(table, ",{0},{0}_time_s,{0}_error_px", variant.name);
        columns.push(runs);
    }
    table.push('\n');
    for n in 0..options.count {
        let X_DC = goal() * start(&camera, n).inverse();
        let angle = rotation_angle(&X_DC.rotation.to_rotation_matrix());
        let _ = write!(table, "{n},{angle:.6},{:.6}", X_DC.translation.vector.norm());
        for run in columns.iter().filter_map(|column| column.get(n)) {
            let ConvergenceRun { outcome, time_s, last_error_px, .. } = run;
            let _ = write!(table, ",{},{time_s:.2},{last_error_px:.4}", outcome.name());
        }
        table.push('\n');
    }
    out.table("starts", table);
    let caption = format!("{} random starts, rotations up to 60 degrees, the target in view.", options.count);
    out.figure("convergence", caption, figure(1, [panel]));
    Ok(out)
}
