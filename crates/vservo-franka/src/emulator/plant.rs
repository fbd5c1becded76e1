//! Motors and links behind the emulated controller.

use crate::limits::MAX_TORQUE;
use crate::wire::Load;
use crate::{CYCLE_S, JOINTS, Joints};

/// What stands behind the emulated controller: motors and links.
pub trait JointPlant: Send {
    /// Measured positions and velocities after a cycle under the robot's joint impedance and its reference, rad and rad/s.
    fn follow(&mut self, q_d: &Joints, qd_d: &Joints) -> (Joints, Joints);

    /// The same under torques without gravity, for which the robot makes up, N m.
    fn push(&mut self, tau: &Joints) -> (Joints, Joints);

    /// From now on the robot makes up for the weight of this load, too. Joints without links have none.
    fn carry(&mut self, _load: &Load) {}
}

/// Joints without links: each follows its reference as a critically damped second-order lag, and is a flywheel under torques.
#[derive(Debug, Clone, Copy)]
pub struct LaggingJoints {
    q: Joints,
    qd: Joints,
}

/// Poles of the lag, 1/s. Chosen by hand: behind a ramp the joints stay by 2/200 s less half a cycle, 9.5 ms; the maker tells none.
const POLES: f64 = 200.0;
/// Inertia of a joint for each N m of its largest torque, kg m2. Chosen by hand, as `arm` counts on: 0.87 kg m2 of the shoulder, 0.12 of the wrist.
const INERTIA: f64 = 0.01;
/// Viscous friction likewise, N m s/rad. Chosen by hand: joints without torque come to rest in some tenths of a second.
const FRICTION: f64 = 0.03;

impl LaggingJoints {
    /// At rest.
    #[must_use]
    pub fn at(q: Joints) -> Self {
        Self { q, qd: [0.0; JOINTS] }
    }
}

impl JointPlant for LaggingJoints {
    fn follow(&mut self, q_d: &Joints, _: &Joints) -> (Joints, Joints) {
        // Ten steps of semi-implicit Euler a cycle: 200/s are slow against them.
        let h = CYCLE_S / 10.0;
        for ((q, qd), q_d) in self.q.iter_mut().zip(&mut self.qd).zip(q_d) {
            for _ in 0..10 {
                *qd += (POLES * POLES * (q_d - *q) - 2.0 * POLES * *qd) * h;
                *q += *qd * h;
            }
            // Below the resolution of what is told it would creep for ever.
            if (q_d - *q).abs() < 1e-9 && qd.abs() < 1e-7 {
                (*q, *qd) = (*q_d, 0.0);
            }
        }
        (self.q, self.qd)
    }

    fn push(&mut self, tau: &Joints) -> (Joints, Joints) {
        for i in 0..JOINTS {
            let qdd = (tau[i] / MAX_TORQUE[i] - FRICTION * self.qd[i]) / INERTIA;
            self.qd[i] += qdd * CYCLE_S;
            self.q[i] += self.qd[i] * CYCLE_S;
        }
        (self.q, self.qd)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Behind a ramp the joints stay by the stated lag, 2/200 s less half of a cycle, for which each step of the ramp is early.
    #[test]
    fn joints_lag_by_what_is_stated() {
        let mut joints = LaggingJoints::at([0.0; JOINTS]);
        let mut q_d = [0.0; JOINTS];
        let mut q = [0.0; JOINTS];
        for _ in 0..1000 {
            q_d[2] += 0.5 * CYCLE_S;
            q = joints.follow(&q_d, &[0.0; JOINTS]).0;
        }
        let lag_s = (q_d[2] - q[2]) / 0.5;
        assert!((lag_s - 0.0095).abs() < 1e-4, "{lag_s} s");
    }
}
