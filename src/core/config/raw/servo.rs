//! `[servo]` and its tables.

use super::RawPose;
use crate::servo::{InteractionAt, OrientationError, UpdatePolicy};
use serde::de::{Error, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::path::PathBuf;

word! {
    /// The servo law.
    SchemeKind {
        /// A: position-based PD with gravity compensation, (10.74).
        PositionPd,
        /// B: position-based resolved velocity, (10.76).
        PositionResolvedVelocity,
        /// C: image-based PD with gravity compensation, (10.84).
        ImagePd,
        /// D: image-based resolved velocity, (10.89)-(10.91).
        ImageResolvedVelocity,
        /// Hybrid, (10.92)-(10.97).
        Hybrid,
        /// The open loop that visual servoing is compared with (Sect. 10.1.1): one look, one motion, and another look.
        LookAndMove,
    }
}

word! {
    /// Where the depth in the interaction matrix comes from.
    Depth {
        /// From the desired pose (the textbook's choice).
        Desired,
        /// From the pose that vision estimates.
        Estimated,
        /// The true one, from the object's place in a simulated scene.
        #[serde(alias = "true")]
        Known,
        /// From the pose in the first measurement, kept from then on.
        Initial,
        /// `servo.constant_depth_m`.
        Constant,
    }
}

word! {
    /// Where a position-based law has the pose of the target from.
    PoseFrom {
        /// From the measurement: by the target's own size.
        Measurement,
        /// From the homography between the desired image and the current one: up to a scale, without the target's size.
        Homography,
    }
}

word! {
    /// What a law compares of the area within the outline.
    AreaKind {
        /// Nothing.
        None,
        /// Centroid, area and orientation: four numbers.
        Area,
        /// Normalized moments to third order: six numbers.
        Moments,
        /// Centroid and second moments, as of an ellipse: five numbers.
        Ellipse,
    }
}

word! {
    /// The matrix K_Ps of scheme C.
    FeatureGain {
        /// k I (the textbook's choice): the stiffnesses of the camera's motions differ by the squared condition number of L_s.
        Scalar,
        /// As `feature_stiffness_nm` and `feature_damping_nms` have it: a list is its diagonal.
        Matrix,
        /// A constant matrix from L_s at the goal, where every motion of the camera has the stiffness of scheme A.
        Preconditioned,
    }
}

word! {
    /// On what a torque law damps.
    DampingOn {
        /// Errors of the task, as in (10.74), (10.84).
        Task,
        /// Joint velocities.
        Joints,
    }
}

word! {
    /// Where the goal comes from.
    SetPointKind {
        /// `[servo.desired]`.
        Pose,
        /// `servo.set_point.features`.
        Features,
        /// Taught from the first measurements.
        Taught,
    }
}

/// One number for all components, a list of one each, or a matrix row by row.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Gains {
    /// For all.
    One(f64),
    /// One each.
    Each(Vec<f64>),
    /// Rows.
    Matrix(Vec<Vec<f64>>),
}

impl<'de> Deserialize<'de> for Gains {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(GainsVisitor)
    }
}

/// Reports what was found instead of numbers, which a derived choice does not.
struct GainsVisitor;

impl<'de> Visitor<'de> for GainsVisitor {
    type Value = Gains;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a list of numbers, or a list of lists for a matrix")
    }

    fn visit_f64<E>(self, v: f64) -> Result<Gains, E> {
        Ok(Gains::One(v))
    }

    fn visit_i64<E>(self, v: i64) -> Result<Gains, E> {
        Ok(Gains::One(v as f64))
    }

    fn visit_u64<E>(self, v: u64) -> Result<Gains, E> {
        Ok(Gains::One(v as f64))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Gains, A::Error> {
        let (mut gains, mut rows) = (Vec::new(), Vec::new());
        while let Some(entry) = list.next_element()? {
            match entry {
                Gains::One(gain) if rows.is_empty() => gains.push(gain),
                Gains::Each(row) if gains.is_empty() => rows.push(row),
                _ => {
                    return Err(A::Error::invalid_type(
                        Unexpected::Other("numbers and lists in one list"),
                        &self,
                    ));
                }
            }
        }
        Ok(if rows.is_empty() { Gains::Each(gains) } else { Gains::Matrix(rows) })
    }
}

table! {
    /// The servo law and its goal.
    RawServo {
        /// Law.
        scheme: SchemeKind = SchemeKind::ImageResolvedVelocity,
        /// When it is computed.
        update: UpdatePolicy = UpdatePolicy::Predict,
        /// Gain of the resolved-velocity laws, 1/s: a number, a list or a matrix. B and hybrid take four (x, y, z, rotation) or six, D one for
        /// each number that it compares.
        gain_1_s: Gains = Gains::One(15.0),
        /// Gain to which a higher one falls within about a pixel of the goal, where encoder steps and noise would move the arm, 1/s.
        gain_at_goal_1_s: f64 = 2.0,
        /// `[servo.adaptive_gain]`: factor on the gain that grows as the error shrinks.
        adaptive_gain: Option<RawAdaptive> = None,
        /// `[servo.pd]`: gains of the torque laws.
        pd: RawPd = RawPd::default(),
        /// 6, or 4 for a camera whose axis stays normal to the target (SCARA): x, y, z and rotation.
        dimension: u32 = 6,
        /// Where A and B have the pose from.
        pose_from: PoseFrom = PoseFrom::Measurement,
        /// Depth in the interaction matrix.
        depth: Depth = Depth::Estimated,
        /// That depth, m, where it is constant.
        constant_depth_m: f64 = 0.6,
        /// Features of the interaction matrix.
        interaction: InteractionAt = InteractionAt::Mean,
        /// Orientation error of A, B and hybrid.
        orientation_error: OrientationError = OrientationError::EulerZyx,
        /// Points of the target that the law compares, from 1; all when neither points nor segments nor an area are named.
        points: Vec<usize> = Vec::new(),
        /// Line segments between two points that it compares.
        segments: Vec<[usize; 2]> = Vec::new(),
        /// What it compares of the area within `outline`, in place of points and segments or beside them.
        area: AreaKind = AreaKind::None,
        /// Points of the target along the outline of that area, from 1; all in their order when empty.
        outline: Vec<usize> = Vec::new(),
        /// Weights of the squared errors, one for each point, then for each segment, then for the area; all 1 when empty.
        weights: Vec<f64> = Vec::new(),
        /// Smooth start: rate at which the first velocity is faded in, 1/s; 0 applies it at once.
        smooth_start_1_s: f64 = 0.0,
        /// Speed of the camera in its first motion, until the image was seen to move as it should, or a decimetre is over, m/s; 0 for no bound.
        first_motion_m_s: f64 = 0.04,
        /// Lag of the drive, by which the arm follows its commands later, ms; left out: what an external drive tells, and none otherwise. `predict` predicts the view that far ahead.
        lead_ms: Option<f64> = None,
        /// Gain of the motion away from joint limits where the task leaves joints free, 1/s; 0 for none.
        limit_avoidance_1_s: f64 = 0.0,
        /// Whether the arm returns to the posture of the last complete view when the target is lost.
        return_to_last_seen: bool = true,
        /// For how long at most an arm that does not see the target from there looks around, s; 0: it does not.
        search_s: f64 = 10.0,
        /// `[servo.visibility]`: keeps the target in the image.
        visibility: RawVisibility = RawVisibility::default(),
        /// `[servo.object]`: estimate the target's own motion, predict views by it and follow it.
        object: RawObject = RawObject::default(),
        /// `[servo.path]`: the desired pose over time.
        path: RawPath = RawPath::default(),
        /// `[servo.set_point]`
        set_point: RawSetPoint = RawSetPoint::default(),
        /// `X_DO`: the target in the desired camera frame.
        desired: RawPose =
            RawPose {
                position_m: [-0.1, 0.1, 0.6],
                rotation_rpy_rad: [0.0, 0.0, -std::f64::consts::FRAC_PI_3],
                ..RawPose::default()
            },
    }
}

pose_table! {
    /// A pose on the path of the goal: `X_DO` at a time.
    RawPathPose {
        /// Time since the arm began to follow, s.
        t_s: f64 = 0.0,
        /// Position, m.
        position_m: [f64; 3] = [0.0; 3],
        /// Roll, pitch, yaw, rad.
        rotation_rpy_rad: [f64; 3] = [0.0; 3],
    }
}

table! {
    /// The desired pose over time.
    RawPath {
        /// Whether the arm is moved along with the goal.
        feed_forward: bool = true,
        /// `[[servo.path.poses]]`: after `servo.desired` at 0 s; without one the goal rests.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        poses: Vec<RawPathPose> = Vec::new(),
    }
}

table! {
    /// Keeps the target in the image: features near its border slow and bend the motion.
    RawVisibility {
        /// Whether it does.
        guard: bool = true,
        /// Distance from the border that the target's marks keep, px; less where the goal itself is nearer.
        margin_px: f64 = 10.0,
        /// Share of the distance to that margin that a feature may cover in a second, 1/s.
        rate_1_s: f64 = 5.0,
    }
}

table! {
    /// The target's own motion.
    RawObject {
        /// Whether it may move; for a target at rest the measurements are less noisy without.
        moves: bool = false,
        /// How quickly it may change its velocity: standard deviation of the acceleration, m/s^2.
        acceleration_m_s2: f64 = 0.3,
        /// The same for its angular velocity, rad/s^2.
        acceleration_rad_s2: f64 = 0.3,
        /// Standard deviation of its estimated place at which the arm holds, m; it slows down from half of that on.
        max_uncertainty_m: f64 = 0.05,
    }
}

table! {
    /// Factor on the gain: `(zero - infinity) exp(-slope x / (zero - infinity)) + infinity` for the error norm x.
    RawAdaptive {
        /// At zero error.
        at_zero: f64 = 1.0,
        /// For large errors.
        at_infinity: f64 = 0.25,
        /// Descent at zero error.
        slope: f64 = 5.0,
    }
}

table! {
    /// Gains of the torque laws A and C; those of Sect. 10.9.
    RawPd {
        /// A: K_P of the position, N/m; one number, three, or a matrix.
        position_stiffness_n_m: Gains = Gains::Each(vec![500.0, 500.0, 10.0]),
        /// A: K_P of the orientation, N m/rad.
        orientation_stiffness_nm_rad: Gains = Gains::One(10.0),
        /// A: K_D of the position, N s/m.
        position_damping_ns_m: Gains = Gains::Each(vec![500.0, 500.0, 10.0]),
        /// A: K_D of the orientation, N m s/rad.
        orientation_damping_nms_rad: Gains = Gains::One(10.0),
        /// C: whether K_Ps is a number, a matrix, or made so that the stiffnesses and dampings of A hold at the goal.
        feature_gain: FeatureGain = FeatureGain::Preconditioned,
        /// C: K_Ps per squared feature unit (normalized), N m.
        feature_stiffness_nm: Gains = Gains::One(300.0),
        /// C: K_Ds, N m s.
        feature_damping_nms: Gains = Gains::One(330.0),
        /// Damping on the task or on the joints.
        damping: DampingOn = DampingOn::Task,
        /// K_D on the joints, one for all or one each.
        joint_damping_nms_rad_or_ns_m: Gains = Gains::One(50.0),
    }
}

table! {
    /// Origin of the goal.
    RawSetPoint {
        /// Kind.
        kind: SetPointKind = SetPointKind::Pose,
        /// Desired features of all points, normalized coordinates.
        features: Vec<[f64; 2]> = Vec::new(),
        /// File of `vservo teach` with those features, for kind = "features", which it makes the kind.
        file: Option<PathBuf> = None,
        /// Measurements that teach it.
        measurements: u32 = 10,
    }
}
