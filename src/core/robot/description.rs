//! A serial arm as a file describes it: any number of joints, link frames as the file places them.

use super::error::{Defect, RobotError};
use super::inertia::Inertia;
use super::model::{Friction, JointKind, JointLimits};
use crate::geometry::Pose;
use nalgebra::{UnitVector3, Vector3};

/// A motor in the textbook's sense: it sits on the link before its joint, at the joint frame's origin, and spins
/// about the joint's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motor {
    /// Mass, kg; added to the link before.
    pub mass: f64,
    /// Rotor inertia about its axis, kg m^2; at rest part of the link before.
    pub inertia: f64,
    /// Rotor angle over joint position (rad/rad or rad/m).
    pub gear_ratio: f64,
}

/// Length of an arm from its first joint to its flange from which on it is told, m. Chosen by hand: industrial arms reach to 5 m, those of space stations to 18, and one of which
/// a file has the millimetres is a hundred long or more; a crane's is told in vain.
const LONG_M: f64 = 30.0;

/// One joint and the link behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct JointDescription {
    /// The joint's name.
    pub name: String,
    /// The name of the link behind it.
    pub link: String,
    /// What the joint does.
    pub kind: JointKind,
    /// The joint's frame at q = 0 in the frame of the link before (in B for the first).
    pub X_PJ: Pose,
    /// The axis in the joint's frame.
    pub axis: UnitVector3<f64>,
    /// The link's frame in the joint's moving frame.
    pub X_JL: Pose,
    /// Limits of position, velocity and effort.
    pub limits: JointLimits,
    /// Joint friction.
    pub friction: Friction,
    /// The textbook motor, if there is one.
    pub motor: Option<Motor>,
    /// Inertia on the diagonal of B(q) alone, as simulators call it, kg m^2 or kg.
    pub armature: f64,
    /// The link's inertia in its frame, without motors.
    pub inertia: Inertia,
    /// A textbook idealisation (a point mass, or inertia without mass): not checked link by link.
    pub idealised: bool,
}

/// A serial arm as a file describes it. [`Self::build`] makes the [`super::Robot`] with which everything is computed.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotDescription {
    /// The robot's name.
    pub name: String,
    /// The file it came from, for messages.
    pub file: String,
    /// Gravity in B, m/s^2.
    pub gravity_B: Vector3<f64>,
    /// From the base to the tip.
    pub joints: Vec<JointDescription>,
    /// The flange in the last link's frame.
    pub X_LE: Pose,
    /// What of the file was taken otherwise than it is written, a sentence each.
    pub notes: Vec<String>,
}

impl JointDescription {
    /// The frame of the link behind the joint at position `q`, rad or m, in that of the link before (in B for the first).
    #[must_use]
    pub fn X_PL(&self, q: f64) -> Pose {
        let along = self.axis.into_inner() * q;
        let motion = match self.kind {
            JointKind::Prismatic => Pose::new(along, Vector3::zeros()),
            JointKind::Revolute | JointKind::Continuous => Pose::new(Vector3::zeros(), along),
        };
        self.X_PJ * motion * self.X_JL
    }
}

impl RobotDescription {
    /// The number of moving joints.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// The names of the moving joints, from the base on.
    #[must_use]
    pub fn joint_names(&self) -> Vec<String> {
        self.joints.iter().map(|joint| joint.name.clone()).collect()
    }

    /// The number of joints from the base to the link that is called `name`, or that stands behind the joint of that name; from 1.
    #[must_use]
    pub fn joints_to_link(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|joint| joint.link == name || joint.name == name).map(|i| i + 1)
    }

    /// The same arm with `mass` times the masses and inertias of its links, and `friction` times the friction of its joints;
    /// motors stay as they are.
    #[must_use]
    pub fn scaled(mut self, mass: f64, friction: f64) -> Self {
        for joint in &mut self.joints {
            joint.inertia.mass *= mass;
            joint.inertia.about_com *= mass;
            joint.friction.viscous *= friction;
            joint.friction.coulomb *= friction;
        }
        self
    }

    /// The same arm with `tool` on its flange, a body in the flange's frame.
    #[must_use]
    pub fn carrying(mut self, tool: &Inertia) -> Self {
        if let Some(last) = self.joints.last_mut() {
            last.inertia = last.inertia.plus(&tool.in_frame(&self.X_LE));
        }
        self
    }

    /// Notes an arm that is so long that its lengths must be in another unit.
    pub(super) fn note_length(&mut self) {
        let parts = self.joints.iter().flat_map(|joint| [&joint.X_PJ, &joint.X_JL]).skip(1);
        let length_m: f64 = parts.chain([&self.X_LE]).map(|X| X.translation.vector.norm()).sum();
        if length_m > LONG_M {
            self.notes.push(format!(
                "{}: the arm is {length_m:.0} m long from its first joint to the flange: lengths are in m, is the file written in millimetres?",
                self.file
            ));
        }
    }

    /// An error that names this file and `element`.
    pub(super) fn error(&self, element: String, problem: Defect) -> RobotError {
        RobotError::Element { file: self.file.clone(), element, problem }
    }

    /// Everything that can be checked before the arm is built.
    ///
    /// # Errors
    /// [`RobotError::Element`] for the first element that is wrong.
    pub fn check(&self) -> Result<(), RobotError> {
        let count = self.joints.len();
        if !(2..=7).contains(&count) {
            let element = format!("robot \"{}\"", self.name);
            return Err(self.error(element, Defect::JointCount { found: count }));
        }
        let finite = |X: &Pose| X.to_homogeneous().iter().all(|x| x.is_finite());
        if !finite(&self.X_LE) || !self.gravity_B.iter().all(|x| x.is_finite()) {
            return Err(self.error(format!("robot \"{}\"", self.name), Defect::NotFinite));
        }
        for (i, joint) in self.joints.iter().enumerate() {
            let fail = |problem| self.error(format!("joint \"{}\"", joint.name), problem);
            if self.joints[..i].iter().any(|other| other.name == joint.name) {
                return Err(fail(Defect::DuplicateName));
            }
            if !finite(&joint.X_PJ) || !finite(&joint.X_JL) {
                return Err(fail(Defect::NotFinite));
            }
            check_joint(joint).map_err(fail)?;
            if !joint.idealised {
                joint.inertia.check().map_err(|p| self.error(format!("link \"{}\"", joint.link), p))?;
            }
        }
        Ok(())
    }
}

fn check_joint(joint: &JointDescription) -> Result<(), Defect> {
    let JointLimits { lower, upper, velocity, effort } = joint.limits;
    match joint.kind {
        JointKind::Continuous if lower.is_finite() || upper.is_finite() => {
            return Err(Defect::LimitsOnContinuous);
        }
        JointKind::Continuous => {}
        kind if !lower.is_finite() || !upper.is_finite() => return Err(Defect::LimitsMissing { kind }),
        _ if lower >= upper => return Err(Defect::LimitsReversed { lower, upper }),
        _ => {}
    }
    for (what, value) in [("velocity", velocity), ("effort", effort)] {
        if value.is_nan() || value <= 0.0 {
            return Err(Defect::LimitNotPositive { what, value });
        }
    }
    let motor = joint.motor.unwrap_or(Motor { mass: 0.0, inertia: 0.0, gear_ratio: 0.0 });
    for (what, value) in [
        ("viscous friction", joint.friction.viscous),
        ("Coulomb friction", joint.friction.coulomb),
        ("armature", joint.armature),
        ("motor mass", motor.mass),
        ("motor inertia", motor.inertia),
    ] {
        if !value.is_finite() {
            return Err(Defect::NotFinite);
        }
        if value < 0.0 {
            return Err(Defect::Negative { what, value });
        }
    }
    // The sign of a gear ratio is free: some gears turn backwards.
    if motor.gear_ratio.is_finite() { Ok(()) } else { Err(Defect::NotFinite) }
}
