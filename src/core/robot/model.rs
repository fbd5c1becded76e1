//! The chain as the recursions use it: constants of every joint and link, limits, friction, gravity.

use nalgebra::{Matrix3, SVector, Vector3};

/// What a joint does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its axis between limits, rad.
    Revolute,
    /// Turns about its axis without end, rad.
    Continuous,
    /// Slides along its axis between limits, m.
    Prismatic,
}

/// The limits of one joint: rad, rad/s, N m for a turning joint; m, m/s, N for a sliding one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Least position; `f64::NEG_INFINITY` for a continuous joint.
    pub lower: f64,
    /// Greatest position; `f64::INFINITY` for a continuous joint.
    pub upper: f64,
    /// Greatest speed.
    pub velocity: f64,
    /// Greatest torque or force.
    pub effort: f64,
}

/// Time in which a motor alone takes its joint to its largest speed with its largest effort, s. Measured: for the joints of a Franka FR3, whose rotor inertias its maker states (0.606, 0.462
/// and 0.206 kg m^2, in the documentation of Drake's model of the arm) it is 15, 12 and 45 ms with the limits of a Panda; this is their geometric mean.
const RUN_UP_S: f64 = 0.02;

impl JointLimits {
    /// The rotor inertia that a joint with these limits is likely to have, as the joint feels it, kg m^2 or kg: an estimate, within a factor of about two and a half.
    #[must_use]
    pub fn likely_rotor(&self) -> f64 {
        RUN_UP_S * self.effort / self.velocity
    }
}

/// Joint friction `viscous qd + coulomb sign(qd)`, on the joint's side of the gear.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Friction {
    /// N m s/rad or N s/m.
    pub viscous: f64,
    /// N m or N.
    pub coulomb: f64,
}

impl Friction {
    /// The torque or force that opposes the speed `qd`, rad/s or m/s.
    #[must_use]
    pub fn torque(&self, qd: f64) -> f64 {
        self.viscous * qd + self.coulomb_part(qd, 0.0)
    }

    /// The Coulomb part of it; it changes sign over the speed `width`, and at least over that of the model.
    #[must_use]
    pub fn coulomb_part(&self, qd: f64, width: f64) -> f64 {
        if self.coulomb == 0.0 { 0.0 } else { self.coulomb * (qd / width.max(COULOMB_WIDTH)).tanh() }
    }
}

/// Speed (rad/s or m/s) over which Coulomb friction changes its sign: a jump would make an integrator chatter at rest.
const COULOMB_WIDTH: f64 = 1e-3;

/// Standard gravity of the textbook's examples and of the usual simulators, m/s^2.
pub(super) const STANDARD_GRAVITY: f64 = 9.81;

/// One joint and the link behind it. The link frame has its origin on the joint's axis and its z along it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Body {
    /// Whether the joint slides.
    pub(super) prismatic: bool,
    /// Orientation of this frame at q = 0 in the frame of the link before (in B for the first).
    pub(super) R: Matrix3<f64>,
    /// Its origin at q = 0, expressed in the frame of the link before.
    pub(super) p: Vector3<f64>,
    /// Mass, kg.
    pub(super) mass: f64,
    /// First moment `m c` about the frame's origin, kg m.
    pub(super) h: Vector3<f64>,
    /// Moments about the frame's origin, kg m^2.
    pub(super) I: Matrix3<f64>,
    /// `k_r I_m`: couples the rotor's spin with the turning of the links before, kg m^2.
    pub(super) rotor_coupling: f64,
    /// `k_r^2 I_m` plus armature: the rotor seen from its own joint, kg m^2 (kg for a sliding joint).
    pub(super) rotor_own: f64,
}

/// A serial arm of `N` joints. Built by [`super::RobotDescription::build`]; every method is pure and allocates nothing.
#[derive(Debug, Clone)]
pub struct Robot<const N: usize> {
    pub(super) name: String,
    pub(super) joint_names: [String; N],
    pub(super) bodies: [Body; N],
    pub(super) limits: [JointLimits; N],
    pub(super) friction: [Friction; N],
    /// Orientation and origin of each link's frame, as the robot file places it, in its body's frame.
    pub(super) links: [(Matrix3<f64>, Vector3<f64>); N],
    /// The flange in the last body's frame.
    pub(super) R_flange: Matrix3<f64>,
    pub(super) p_flange: Vector3<f64>,
    /// Gravity in B, m/s^2.
    pub(super) gravity_B: Vector3<f64>,
}

impl<const N: usize> Robot<N> {
    /// The robot's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The joints' names, from the base on.
    #[must_use]
    pub fn joint_names(&self) -> &[String; N] {
        &self.joint_names
    }

    /// Limits of every joint.
    #[must_use]
    pub fn limits(&self) -> &[JointLimits; N] {
        &self.limits
    }

    /// Whether joint `i`, counted from 0, moves along its axis and does not turn about it.
    #[must_use]
    pub fn is_prismatic(&self, i: usize) -> bool {
        self.bodies.get(i).is_some_and(|body| body.prismatic)
    }

    /// The first joint whose position is outside its limits, or is not a number.
    #[must_use]
    pub fn outside_limits(&self, q: &SVector<f64, N>) -> Option<usize> {
        self.limits.iter().zip(q.iter()).position(|(limit, &q)| !(q >= limit.lower && q <= limit.upper))
    }

    /// The same arm with another gravity vector `g_B` (m/s^2, expressed in B).
    #[must_use]
    pub fn with_gravity(mut self, g_B: Vector3<f64>) -> Self {
        self.gravity_B = g_B;
        self
    }

    /// The same arm carrying a point of `mass` kg at `com_E` (m, in the flange's frame): a load, or a model error.
    ///
    /// A negative mass takes a load off; the caller keeps the sum positive.
    #[must_use]
    pub fn with_payload(mut self, mass: f64, com_E: &Vector3<f64>) -> Self {
        self.carry(mass, com_E);
        self
    }

    /// Replaces what this arm carries: it is then `bare`, an arm with the same joints, with a point of `mass` kg at `com_E` (m).
    pub(crate) fn set_payload(&mut self, bare: &Self, mass: f64, com_E: &Vector3<f64>) {
        self.bodies = bare.bodies;
        self.carry(mass, com_E);
    }

    pub(super) fn carry(&mut self, mass: f64, com_E: &Vector3<f64>) {
        let c = self.R_flange * com_E + self.p_flange;
        if let Some(last) = self.bodies.last_mut() {
            last.mass += mass;
            last.h += c * mass;
            last.I += (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * mass;
        }
    }

    /// The derivatives of this arm by a payload that is zero: by its mass (kg), and by its first moment about the flange along the axes of E
    /// (kg m). Their inverse dynamics are the torques of a payload for each unit of these numbers.
    pub(crate) fn payload_derivatives(&self) -> [Self; 4] {
        let massless = |body: &Body| Body {
            mass: 0.0,
            h: Vector3::zeros(),
            I: Matrix3::zeros(),
            rotor_coupling: 0.0,
            rotor_own: 0.0,
            ..*body
        };
        let p = self.p_flange;
        std::array::from_fn(|k| {
            let mut arm = self.clone();
            arm.bodies = self.bodies.map(|body| massless(&body));
            if let Some(last) = arm.bodies.last_mut() {
                if k == 0 {
                    (last.mass, last.h) = (1.0, p);
                    last.I = Matrix3::identity() * p.norm_squared() - p * p.transpose();
                } else {
                    let h = self.R_flange.column(k - 1).into_owned();
                    last.h = h;
                    last.I = Matrix3::identity() * (2.0 * p.dot(&h)) - p * h.transpose() - h * p.transpose();
                }
            }
            arm
        })
    }

    /// Adds `armature` (kg m^2 or kg) to the inertia of the joint `i`, counted from 0, as [`Self::with_armature`] does.
    pub(crate) fn add_armature(&mut self, i: usize, armature: f64) {
        if let Some(body) = self.bodies.get_mut(i) {
            body.rotor_own += armature;
        }
    }

    /// The same arm with `armature` (kg m^2 or kg) more on each entry of the diagonal of B(q): the inertia of rotors as their joints feel it.
    #[must_use]
    pub fn with_armature(mut self, armature: &SVector<f64, N>) -> Self {
        self.bodies.iter_mut().zip(armature.iter()).for_each(|(body, more)| body.rotor_own += more);
        self
    }

    /// The inertia of each rotor as its own joint feels it, kg m^2 or kg.
    #[must_use]
    pub fn armature(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| self.bodies[i].rotor_own)
    }

    /// Gravity, m/s^2 in B.
    #[must_use]
    pub fn gravity_vector(&self) -> Vector3<f64> {
        self.gravity_B
    }

    /// Replaces gravity, m/s^2 in B.
    pub(crate) fn set_gravity(&mut self, g_B: Vector3<f64>) {
        self.gravity_B = g_B;
    }

    /// The same arm with other joint friction.
    #[must_use]
    pub fn with_friction(mut self, friction: [Friction; N]) -> Self {
        self.friction = friction;
        self
    }

    /// The friction coefficients of every joint.
    #[must_use]
    pub fn friction(&self) -> &[Friction; N] {
        &self.friction
    }

    /// Derivative of [`Self::friction_torque`] by the velocity of its own joint, N m s/rad or N s/m.
    #[must_use]
    pub fn friction_slope(&self, qd: &SVector<f64, N>) -> SVector<f64, N> {
        SVector::from_fn(|i, _| {
            let Friction { viscous, coulomb } = self.friction[i];
            let share = (qd[i] / COULOMB_WIDTH).tanh();
            viscous + coulomb * (1.0 - share * share) / COULOMB_WIDTH
        })
    }

    /// Friction torque (N m or N) that opposes `qd`: `viscous qd + coulomb tanh(qd / 1e-3)`.
    #[must_use]
    pub fn friction_torque(&self, qd: &SVector<f64, N>) -> SVector<f64, N> {
        let mut tau = SVector::<f64, N>::zeros();
        for ((tau, friction), &qd) in tau.iter_mut().zip(&self.friction).zip(qd.iter()) {
            *tau = friction.torque(qd);
        }
        tau
    }
}
