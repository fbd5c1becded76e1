//! How far the law is from instability at the start and at the goal: the true motion of the features as the law sees them, against its own
//! estimate, (10.91).
//!
//! ```text
//! scene:  lens, mount, target, arm ─► pixels ─► believed lens ─► features: their motion by differences, J_L
//! law:    features, its depths, believed mount and arm          ─► Lhat_s, Jhat_L
//! ```
//! The truth is differentiated, and not computed by interaction matrices: what the law believes has no part in it.

use crate::config::{Config, Scene, Task};
use crate::geometry::{Pose, integrate_body_twist};
use crate::messages::MAX_FEATURES;
use crate::pose::{Correspondence3, refine_3d};
use crate::robot::{Robot, RobotError};
use crate::servo::{
    DepthRow, Interaction, Law, Margins, Stability, StabilityMargin, View, error_motion, weighted_rows,
};
use nalgebra::{DMatrix, DVector, SVector, Vector2, Vector6};

/// Half a difference, m or rad: the errors of differences, its square, and of rounding, 1e-16 over it, are both far below a margin's digits.
const STEP: f64 = 1e-5;
/// Noise of the pixels by which vision would estimate the pose, normalized; without noise it has no part in the estimate.
const SD: f64 = 1e-3;

/// Of the law of `config` at `q_start` and `q_goal`; `None` for other laws than scheme D, and without a scene.
///
/// # Errors
/// [`RobotError`] when the true arm cannot be built.
pub(super) fn stability<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    q_start: &SVector<f64, N>,
    q_goal: Option<&SVector<f64, N>>,
) -> Result<Option<Stability>, RobotError> {
    let (Law::ImageVelocity { interaction, .. }, Some(scene), Task::Servo, None, None) =
        (&config.servo.law, &config.scene, config.task, &config.stereo, &config.servo.estimation)
    else {
        return Ok(None);
    };
    let arm = scene.arm.build::<N>()?;
    let cell = PreflightCell { config, scene, arm: &arm, robot, interaction: *interaction };
    let initial = cell.view(&cell.X_CO(q_start), None).and_then(|view| view.X_CO().map(DepthRow::of));
    let start = cell.margins(q_start, initial);
    let goal = q_goal.and_then(|q| cell.margins(q, initial));
    Ok(start.map(|start| Stability { start, goal }))
}

struct PreflightCell<'a, const N: usize> {
    config: &'a Config,
    scene: &'a Scene,
    /// As it is.
    arm: &'a Robot<N>,
    /// As it is believed to be.
    robot: &'a Robot<N>,
    interaction: Interaction,
}

impl<const N: usize> PreflightCell<'_, N> {
    /// Where the object really is in the camera when the encoders read `q`.
    fn X_CO(&self, q: &SVector<f64, N>) -> Pose {
        let offset = &self.scene.q_offset;
        let q = SVector::from_fn(|i, _| q[i] + offset.get(i).copied().unwrap_or_default());
        self.scene.mount.X_WC(self.arm, &q).inv_mul(&self.scene.X_WO)
    }

    /// What vision without noise makes of an object really at `X_CO`.
    fn view(&self, X_CO: &Pose, initial: Option<DepthRow>) -> Option<View> {
        let lens = &self.config.camera.model;
        let mut s = [Vector2::zeros(); MAX_FEATURES];
        let mut count = 0;
        for (place, point) in s.iter_mut().zip(self.scene.target.features()) {
            *place = lens.normalized_of(&self.scene.camera.project(&(X_CO * point.p_O))?);
            count += 1;
        }
        let s = s.get(..count)?;
        let points = self.config.set_point.points();
        let pairs: Vec<_> = points.iter().zip(s).map(|(r, s)| Correspondence3 { r: *r, s: *s }).collect();
        let found = refine_3d(X_CO, &pairs, SD).ok().map(|found| found.X_CO);
        let view = View::new(s.iter().copied(), found)?;
        Some(view.with_known(Some(*X_CO)).with_initial(initial))
    }

    fn error(&self, X_CO: &Pose, initial: Option<DepthRow>) -> Option<DVector<f64>> {
        weighted_rows(&self.config.set_point, &self.view(X_CO, initial)?, self.interaction).map(|(_, e)| e)
    }

    fn margins(&self, q: &SVector<f64, N>, initial: Option<DepthRow>) -> Option<Margins> {
        let X_CO = self.X_CO(q);
        let view = self.view(&X_CO, initial)?;
        let (L, _) = weighted_rows(&self.config.set_point, &view, self.interaction)?;
        let by_camera = |j: usize, step: f64| {
            let V = Vector6::from_fn(|i, _| if i == j { 1.0 } else { 0.0 });
            integrate_body_twist(&Pose::identity(), &V, step).inv_mul(&X_CO)
        };
        let by_joints = |j: usize, step: f64| {
            let mut q = *q;
            q[j] += step;
            self.X_CO(&q)
        };
        let motion = |numbers: usize, X_CO: &dyn Fn(usize, f64) -> Pose| {
            error_motion(numbers, STEP, |j, step| self.error(&X_CO(j, step), initial))
        };
        let (_, J) = self.config.camera.mount.camera(self.robot, q);
        let J = DMatrix::from_column_slice(6, N, J.matrix().as_slice());
        Some(Margins {
            camera: StabilityMargin::of(&motion(6, &by_camera)?, &L)?,
            joints: StabilityMargin::of(&motion(N, &by_joints)?, &(L * J))?,
        })
    }
}
