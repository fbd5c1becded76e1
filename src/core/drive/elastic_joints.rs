//! Joints that give way: a spring and a damper between each motor and its link. The motors carry rotors, friction and encoders, the links are the arm.
//!
//! ```text
//! J th'' + F(th') = tau - s        B(q) q'' + C q' + g = s        s = K (th - q) + D (th' - q')
//! ```
//! Stiffness is given by the wind-up, the angle or way by which the spring yields to the largest effort. Friction is implicit, as in [`super::friction`]; here each joint has
//! its own equation.

use super::HardFriction;
use crate::robot::{Friction, Robot};
use nalgebra::SVector;

/// Damping ratio of the link on its spring. Chosen by hand: gears and bearings leave some hundredths.
const DAMPING_RATIO: f64 = 0.05;
/// Largest share of a radian by which the fastest oscillation goes on in a step. Chosen by hand: Runge-Kutta of fourth order is stable up to 2.8 and loses 1e-5 of
/// the amplitude a radian at 0.5.
const STEP_RAD: f64 = 0.5;
/// Most steps for which a step is divided. Chosen by hand: beyond, a simulation would be slower than real time.
const MOST_STEPS: f64 = 100.0;
/// Halvings of the interval that contains a speed, and rounds of the sag at the start. Chosen by hand: 2^-60 is below the last digit, and a round shrinks the
/// error of the sag by a hundred times and more.
const HALVINGS: usize = 60;
const ROUNDS: usize = 20;

/// The motors behind elastic joints.
#[derive(Debug, Clone)]
pub(super) struct ElasticJoints<const N: usize> {
    stiffness: SVector<f64, N>,
    damping: SVector<f64, N>,
    rotor: SVector<f64, N>,
    /// Positions and velocities of the motors, on the joints' side of their gears.
    pub(super) theta: SVector<f64, N>,
    pub(super) theta_d: SVector<f64, N>,
    /// Into how many a step of 1 ms is divided.
    steps: f64,
}

impl<const N: usize> ElasticJoints<N> {
    /// Motors at `q` for the arm `robot`, whose joints yield by `wind_up` (rad or m) to their largest efforts; the arm without rotors, and where its links hang.
    pub(super) fn new(
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        wind_up: f64,
    ) -> (Self, Robot<N>, SVector<f64, N>) {
        let told = robot.armature();
        let rotor =
            SVector::from_fn(|i, _| if told[i] > 0.0 { told[i] } else { robot.limits()[i].likely_rotor() });
        let links = robot.clone().with_armature(&-told);
        let stiffness = SVector::from_fn(|i, _| robot.limits()[i].effort / wind_up);
        let B = links.mass_matrix(q);
        let damping = SVector::from_fn(|i, _| 2.0 * DAMPING_RATIO * (stiffness[i] * B[(i, i)]).sqrt());
        let free = crate::linalg::Ldlt::of(&B).map(|factors| factors.inverse());
        let fastest = (0..N).map(|i| {
            let per_inertia = 1.0 / rotor[i] + free.as_ref().map_or(0.0, |inverse| inverse[i][i]);
            (stiffness[i] * per_inertia).sqrt()
        });
        let steps = (fastest.fold(0.0, f64::max) * 1e-3 / STEP_RAD).ceil().clamp(1.0, MOST_STEPS);
        let mut hangs = *q;
        for _ in 0..ROUNDS {
            hangs = q - links.gravity(&hangs).component_div(&stiffness);
        }
        let joints = Self { stiffness, damping, rotor, theta: *q, theta_d: SVector::zeros(), steps };
        (joints, links, hangs)
    }

    /// Moves motors and links on by `h` seconds, under the torques of the motors, those on the links from outside, and the friction of `robot`, where it acts.
    pub(super) fn integrate(
        &mut self,
        robot: &Robot<N>,
        (q, qd): (&mut SVector<f64, N>, &mut SVector<f64, N>),
        torques: (&SVector<f64, N>, &SVector<f64, N>),
        friction: Option<Option<HardFriction>>,
        h: f64,
    ) {
        let steps = (self.steps * h * 1e3).ceil().max(1.0);
        for _ in 0..steps as usize {
            self.step(robot, (q, qd), torques, friction, h / steps);
        }
    }

    fn step(
        &mut self,
        robot: &Robot<N>,
        (q, qd): (&mut SVector<f64, N>, &mut SVector<f64, N>),
        (tau, outside): (&SVector<f64, N>, &SVector<f64, N>),
        friction: Option<Option<HardFriction>>,
        h: f64,
    ) {
        let v = self.theta_d;
        let rubs =
            SVector::from_fn(|i, _| friction.map_or(0.0, |hard| rubbed(hard, &robot.friction()[i], v[i])));
        // Positions of motors and links, then their velocities.
        type JointStates<const N: usize> = [SVector<f64, N>; 4];
        let rate = |x: &JointStates<N>| -> JointStates<N> {
            let spring =
                self.stiffness.component_mul(&(x[0] - x[1])) + self.damping.component_mul(&(x[2] - x[3]));
            let motors = (tau - rubs - spring).component_div(&self.rotor);
            [x[2], x[3], motors, robot.forward_dynamics(&x[1], &x[3], &(spring + outside))]
        };
        let plus = |x: &JointStates<N>, k: &JointStates<N>, h: f64| -> JointStates<N> {
            std::array::from_fn(|i| x[i] + k[i] * h)
        };
        let x: JointStates<N> = [self.theta, *q, v, *qd];
        let k1 = rate(&x);
        let k2 = rate(&plus(&x, &k1, h / 2.0));
        let k3 = rate(&plus(&x, &k2, h / 2.0));
        let k4 = rate(&plus(&x, &k3, h));
        let end: JointStates<N> =
            std::array::from_fn(|i| x[i] + (k1[i] + (k2[i] + k3[i]) * 2.0 + k4[i]) * (h / 6.0));
        let [theta, links, smooth, links_d] = end;
        (*q, *qd) = (links, links_d);
        self.theta_d = match friction {
            None => smooth,
            Some(hard) => SVector::from_fn(|i, _| {
                let momentum = self.rotor[i] * smooth[i] + h * rubs[i];
                after(hard, &robot.friction()[i], v[i], momentum, self.rotor[i], h)
            }),
        };
        let before = self.theta;
        self.theta = theta + (self.theta_d - smooth) * (h / 2.0);
        if friction.is_some_and(|hard| hard.is_some()) {
            // What is held does not creep, not even by the last digits.
            (0..N)
                .filter(|i| v[*i] == 0.0 && self.theta_d[*i] == 0.0)
                .for_each(|i| self.theta[i] = before[i]);
        }
    }
}

/// Friction at the speed `v`, of a joint that moves.
fn rubbed(hard: Option<HardFriction>, friction: &Friction, v: f64) -> f64 {
    match hard {
        None => friction.torque(v),
        Some(_) if v == 0.0 => 0.0,
        Some(hard) => friction.viscous * v + friction.coulomb * hard.level(v) * v.signum(),
    }
}

/// The speed at the end of a step of `h` seconds that begins with `v`, of a rotor that would have `momentum` without friction: `J v' + h F(v') = momentum`.
fn after(hard: Option<HardFriction>, friction: &Friction, v: f64, momentum: f64, rotor: f64, h: f64) -> f64 {
    if let Some(hard) = hard {
        let hold = h * friction.coulomb * hard.level(v);
        return (momentum.abs() - hold).max(0.0).copysign(momentum) / (rotor + h * friction.viscous);
    }
    // Friction opposes, so that the speed lies between none and that without friction.
    let (mut low, mut high) = (0.0, momentum.abs() / rotor);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        *(if rotor * middle + h * friction.torque(middle) < momentum.abs() { &mut low } else { &mut high }) =
            middle;
    }
    (0.5 * (low + high)).copysign(momentum)
}
