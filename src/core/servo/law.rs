//! The servo laws A, B, C, D and hybrid behind one interface.
//!
//! Data flow: [`Law::task`] turns a set-point and a view into a [`Task`] in the camera's frame, which does not depend on the arm. [`Law::output`] turns the
//! task and the state of the arm ([`Arm`]) into a [`LawOutput`]: joint velocities of a resolved-velocity law, or joint torques of a PD law with
//! gravity compensation.

use super::{
    DepthSource, FeatureGains, FeatureMatrix, Gain, GainMatrix, HybridGains, Interaction, OperationalSpace,
    OperationalSpaceError, OrientationError, PoseGains, SetPoint, TwistTask, TwistWeights, View, WrenchTask,
    hybrid_task, image_task, image_task_by, image_weights, image_wrench, image_wrench_by, joint_torque,
    joint_velocity, operational_pose, preconditioned_wrench,
};
use crate::messages::MAX_JOINTS;
use crate::robot::CameraJacobian;
use nalgebra::{Matrix6, SVector};

/// State of the arm at the time for which a law output is computed.
#[derive(Debug, Clone, Copy)]
pub struct Arm<const N: usize> {
    /// Geometric Jacobian of the camera, 6 x `N`, expressed in C.
    pub J: CameraJacobian<N>,
    /// Joint velocities, rad/s or m/s.
    pub qd: SVector<f64, N>,
    /// Gravity torques g(q), N m or N; read by torque laws only.
    pub gravity: SVector<f64, N>,
}

/// Damping of a torque law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Damping<K> {
    /// In the task space, as in (10.74), (10.84).
    Task(K),
    /// On qd: the diagonal of K_D for the joints, N m s/rad or N s/m.
    Joints([f64; MAX_JOINTS]),
}

impl<K> Damping<K> {
    fn on_joints<const N: usize>(&self) -> SVector<f64, N> {
        match self {
            Self::Task(_) => SVector::zeros(),
            Self::Joints(K_D) => SVector::from_fn(|i, _| K_D.get(i).copied().unwrap_or(0.0)),
        }
    }
}

/// A servo law with its gains.
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// Scheme A, position-based PD with gravity compensation, (10.74).
    PositionTorque {
        /// K_P, N/m and N m/rad.
        K_P: PoseGains,
        /// K_D, N s/m and N m s/rad, or damping on the joints.
        damping: Damping<PoseGains>,
        /// Representation of the orientation part of x~.
        orientation: OrientationError,
        /// Dimension m of the operational space.
        space: OperationalSpace,
    },
    /// Scheme B, position-based resolved velocity, (10.76).
    PositionVelocity {
        /// K, as multiple of `gain`.
        K: PoseGains,
        /// Common factor, 1/s.
        gain: Gain,
        /// Representation of the orientation part of x~.
        orientation: OrientationError,
        /// Dimension m of the operational space.
        space: OperationalSpace,
        /// What counts where the arm cannot follow the twist.
        weights: TwistWeights,
    },
    /// Scheme C, image-based PD with gravity compensation, (10.84).
    ImageTorque {
        /// K_Ps, N m: a scalar is multiplied by the features' weights, a matrix is used as it is, without them.
        K_Ps: FeatureMatrix,
        /// K_Ds, N m s, likewise; or damping on the joints.
        damping: Damping<FeatureMatrix>,
        /// L_s.
        interaction: Interaction,
    },
    /// Scheme C, (10.84), with a constant matrix K_Ps that gives every motion of the camera its own stiffness at the goal.
    PreconditionedTorque {
        /// K_Ps, with stiffnesses of the camera's motions at the goal, N/m and N m/rad.
        K_Ps: FeatureGains,
        /// K_Ds, with dampings of those motions, N s/m and N m s/rad; or damping on the joints.
        damping: Damping<PoseGains>,
        /// L_s.
        interaction: Interaction,
    },
    /// Scheme D, image-based resolved velocity, (10.89)-(10.91).
    ImageVelocity {
        /// K_s, as multiple of `gain`.
        K_s: FeatureMatrix,
        /// Common factor, 1/s.
        gain: Gain,
        /// L_s.
        interaction: Interaction,
    },
    /// Hybrid, (10.92)-(10.97).
    Hybrid {
        /// K_p and K_o, as multiples of `gain`.
        gains: HybridGains,
        /// Common factor, 1/s.
        gain: Gain,
        /// Representation of the rotation R_CD.
        orientation: OrientationError,
        /// Dimension m: how the homography is estimated.
        space: OperationalSpace,
        /// Where the depth z_d of the point comes from.
        depth: DepthSource,
    },
}

/// What a law computes from a view and a set-point in the camera's frame, independent of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// A desired twist of the camera, of resolved-velocity laws.
    Twist(TwistTask),
    /// A wrench on the camera, of torque laws.
    Wrench(WrenchTask),
}

/// Why a law has no task for a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoTask {
    /// The law needs the pose of the object, and the view or the set-point has none.
    NoPose,
    /// Fewer features are visible than the law needs.
    TooFew,
    /// What is seen fixes no motion: points on a line, one on top of the other or behind the camera, an orientation at which
    /// the orientation error has no rate.
    Singular,
}

/// What a law requests of the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LawOutput<const N: usize> {
    /// A joint velocity for the reference, rad/s or m/s.
    Velocity(SVector<f64, N>),
    /// Torques or forces for the drive, gravity included, N m or N.
    Torque(SVector<f64, N>),
}

impl<const N: usize> LawOutput<N> {
    /// Whether all of its numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let (Self::Velocity(numbers) | Self::Torque(numbers)) = self;
        numbers.iter().all(|x| x.is_finite())
    }
}

impl Law {
    /// Whether it consists of torques, so that the drive must accept torque commands.
    #[must_use]
    pub fn is_torque(&self) -> bool {
        matches!(
            self,
            Self::PositionTorque { .. } | Self::ImageTorque { .. } | Self::PreconditionedTorque { .. }
        )
    }

    /// Whether it has one gain, the same for all errors: a resolved-velocity law without a list or matrix of gains, and without adaptive gain.
    #[must_use]
    pub fn has_one_gain(&self) -> bool {
        match self {
            Self::PositionVelocity { K, gain: Gain::Constant(_), .. } => K.is_uniform(),
            Self::ImageVelocity { K_s: FeatureMatrix::Scalar(_), gain: Gain::Constant(_), .. } => true,
            Self::Hybrid { gains, gain: Gain::Constant(_), .. } => {
                gains.K_p.is_uniform() && gains.K_o.is_uniform()
            }
            _ => false,
        }
    }

    /// Sets that gain, 1/s. Returns whether there is one.
    pub fn set_gain(&mut self, gain_1_s: f64) -> bool {
        if !self.has_one_gain() {
            return false;
        }
        match self {
            Self::PositionVelocity { K, gain, .. } => {
                (*K, *gain) = (PoseGains::repeat(1.0), Gain::Constant(gain_1_s));
            }
            Self::ImageVelocity { K_s, gain, .. } => {
                (*K_s, *gain) = (FeatureMatrix::Scalar(1.0), Gain::Constant(gain_1_s));
            }
            Self::Hybrid { gains, gain, .. } => {
                let one = GainMatrix::repeat(1.0);
                (*gains, *gain) = (HybridGains { K_p: one, K_o: one }, Gain::Constant(gain_1_s));
            }
            Self::PositionTorque { .. } | Self::ImageTorque { .. } | Self::PreconditionedTorque { .. } => {}
        }
        true
    }

    /// Lets scheme B with m = 6 go by the image where the arm cannot follow its twist: for arms with fewer than six joints before the camera.
    pub fn weigh_by_image(&mut self) {
        match self {
            Self::PositionVelocity { space: OperationalSpace::Four, .. } => {}
            Self::PositionVelocity { weights, .. } => *weights = TwistWeights::Image,
            _ => {}
        }
    }

    /// The diagonal of K_D for damping on qd, N m s/rad or N s/m; zero for damping in the task space and for velocity laws.
    #[must_use]
    pub fn joint_damping<const N: usize>(&self) -> SVector<f64, N> {
        match self {
            Self::PositionTorque { damping, .. } | Self::PreconditionedTorque { damping, .. } => {
                damping.on_joints()
            }
            Self::ImageTorque { damping, .. } => damping.on_joints(),
            Self::PositionVelocity { .. } | Self::ImageVelocity { .. } | Self::Hybrid { .. } => {
                SVector::zeros()
            }
        }
    }

    /// The task for `view` and `set_point`: error and normal equations, or wrench and damping, in the camera's frame.
    ///
    /// # Errors
    /// [`NoTask`] when the view does not have what the law needs.
    pub fn task(&self, set_point: &SetPoint, view: &View) -> Result<Task, NoTask> {
        let why = || if self.has_enough(set_point, view) { NoTask::Singular } else { NoTask::TooFew };
        let pose_error = |space, orientation| {
            let X_DO = set_point.X_DO().ok_or(NoTask::NoPose)?;
            let X_CO = operational_pose(set_point, view, space);
            let none = if space == OperationalSpace::Six { NoTask::NoPose } else { why() };
            Ok(OperationalSpaceError::new(X_DO, &X_CO.ok_or(none)?, orientation))
        };
        match self {
            Self::PositionTorque { K_P, damping, orientation, space } => {
                let K_D = match damping {
                    Damping::Task(K_D) => *K_D,
                    Damping::Joints(_) => PoseGains::zeros(),
                };
                let wrench = pose_error(*space, *orientation)?.wrench(K_P, &K_D);
                wrench.map(Task::Wrench).ok_or(NoTask::Singular)
            }
            Self::PositionVelocity { K, orientation, space, weights, .. } => {
                let error = pose_error(*space, *orientation)?;
                let matrix = match weights {
                    TwistWeights::Unit => Some(Matrix6::identity()),
                    TwistWeights::Image => operational_pose(set_point, view, *space)
                        .and_then(|X_CO| image_weights(set_point.points(), &X_CO)),
                };
                let task = matrix.and_then(|matrix| error.twist_task(K, matrix));
                task.map(Task::Twist).ok_or(NoTask::Singular)
            }
            Self::ImageTorque { K_Ps, damping, interaction } => {
                let K_Ds = match damping {
                    Damping::Task(K_D) => Some(K_D),
                    Damping::Joints(_) => None,
                };
                let k_D = match K_Ds {
                    None => Some(0.0),
                    Some(FeatureMatrix::Scalar(k_D)) => Some(*k_D),
                    Some(FeatureMatrix::Entries(_)) => None,
                };
                let task = match (K_Ps, k_D) {
                    (FeatureMatrix::Scalar(k_P), Some(k_D)) => {
                        image_task(set_point, view, *interaction).map(|task| image_wrench(&task, *k_P, k_D))
                    }
                    _ => image_wrench_by(set_point, view, *interaction, K_Ps, K_Ds),
                };
                task.map(Task::Wrench).ok_or_else(why)
            }
            Self::PreconditionedTorque { K_Ps, damping, interaction } => {
                let K_D = match damping {
                    Damping::Task(K_D) => *K_D,
                    Damping::Joints(_) => PoseGains::zeros(),
                };
                let task = preconditioned_wrench(set_point, view, K_Ps, &K_D, *interaction);
                task.map(Task::Wrench).ok_or_else(why)
            }
            Self::ImageVelocity { K_s, interaction, .. } => {
                let task = match K_s {
                    FeatureMatrix::Scalar(k) => image_task(set_point, view, *interaction)
                        .map(|task| TwistTask { vector: task.vector * *k, ..task }),
                    FeatureMatrix::Entries(_) => image_task_by(set_point, view, *interaction, K_s),
                };
                task.map(Task::Twist).ok_or_else(why)
            }
            Self::Hybrid { gains, orientation, space, depth, .. } => {
                let task = hybrid_task(set_point, view, gains, *orientation, (*space, *depth));
                task.map(Task::Twist).ok_or_else(why)
            }
        }
    }

    /// Whether the view has as many of the set-point's features as the law needs at least: a homography needs four points, the four motions of a
    /// camera whose optical axis keeps its direction (m = 4) two.
    fn has_enough(&self, set_point: &SetPoint, view: &View) -> bool {
        let seen = set_point.selection().points().filter(|i| view.feature(*i).is_some()).count();
        let needed = match self {
            Self::PositionTorque { space, .. }
            | Self::PositionVelocity { space, .. }
            | Self::Hybrid { space, .. } => match space {
                OperationalSpace::Four => 2,
                OperationalSpace::Six | OperationalSpace::Homography => 4,
            },
            Self::ImageTorque { .. } | Self::PreconditionedTorque { .. } | Self::ImageVelocity { .. } => 1,
        };
        seen >= needed && view.features().len() == set_point.features().len()
    }

    /// Largest rate at which a part of the error falls where the arm follows the law output for `task`, 1/s; of torque laws where the arm moves as fast as their damping lets
    /// it. Zero where it is not known: damping on the joints, or matrices over features.
    #[must_use]
    pub fn rate_1_s(&self, task: &Task) -> f64 {
        let (gain, quickest) = match self {
            Self::PositionVelocity { gain, K, .. } => (gain, K.largest()),
            Self::ImageVelocity { gain, K_s, .. } => (gain, K_s.largest()),
            Self::Hybrid { gain, gains, .. } => (gain, gains.K_p.largest().max(gains.K_o.largest())),
            Self::PositionTorque { K_P, damping: Damping::Task(K_D), .. } => return K_P.rate_against(K_D),
            Self::PreconditionedTorque { K_Ps, damping: Damping::Task(K_D), .. } => {
                return K_Ps.K_P.rate_against(K_D);
            }
            Self::ImageTorque {
                K_Ps: FeatureMatrix::Scalar(k),
                damping: Damping::Task(FeatureMatrix::Scalar(d)),
                ..
            } => return k / d,
            Self::PositionTorque { .. } | Self::ImageTorque { .. } | Self::PreconditionedTorque { .. } => {
                return 0.0;
            }
        };
        match task {
            Task::Twist(task) => gain.at(task.error) * quickest,
            Task::Wrench(_) => 0.0,
        }
    }

    /// The law output for `task` and the state of the arm: rad/s or m/s, or N m or N. `None` where it is not finite.
    #[must_use]
    pub fn output<const N: usize>(&self, task: &Task, arm: &Arm<N>) -> Option<LawOutput<N>> {
        match (self, task) {
            (
                Self::PositionVelocity { gain, .. }
                | Self::ImageVelocity { gain, .. }
                | Self::Hybrid { gain, .. },
                Task::Twist(task),
            ) => joint_velocity(task, gain.at(task.error), &arm.J).map(LawOutput::Velocity),
            (Self::PositionTorque { damping, .. }, Task::Wrench(task)) => torque(task, damping, arm),
            (Self::ImageTorque { damping, .. }, Task::Wrench(task)) => torque(task, damping, arm),
            (Self::PreconditionedTorque { damping, .. }, Task::Wrench(task)) => torque(task, damping, arm),
            _ => None, // a task of another kind of law
        }
    }
}

fn torque<const N: usize, K>(task: &WrenchTask, damping: &Damping<K>, arm: &Arm<N>) -> Option<LawOutput<N>> {
    joint_torque(task, &damping.on_joints(), &arm.J, &arm.qd, &arm.gravity).map(LawOutput::Torque)
}
