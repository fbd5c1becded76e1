//! What acts on a simulated arm from outside: a wall in its way, a push, and a joint that jams.
//!
//! ```text
//! wall: f = max(0, k d - c d') n   where the flange's origin is the depth d behind the plane     tau_ext = J_v(q)^T f
//! push: f = what the file says, on the flange's origin, for a while
//! jam:  from a moment on the joint's inertia is a million times what is usual, and it stands
//! ```

use crate::robot::Robot;
use nalgebra::{SVector, Unit, Vector3};

/// Inertia of a joint that is jammed, kg m^2 or kg. Derived: 1000 N m move it by 0.5 mrad in a second.
const JAMMED: f64 = 1e6;

/// A half space that the flange's origin cannot enter: a spring and a damper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// A point of its surface in B, m.
    pub point_B: Vector3<f64>,
    /// The direction out of it, in B.
    pub normal_B: Unit<Vector3<f64>>,
    /// N/m.
    pub stiffness: f64,
    /// N s/m.
    pub damping: f64,
}

/// A force on the flange's origin for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// In B, N.
    pub force_B: Vector3<f64>,
    /// From when, and until when, in seconds of the drive.
    pub during_s: (f64, f64),
}

/// A joint that does not turn any more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jam {
    /// Which one, from 0.
    pub joint: usize,
    /// From when, in seconds of the drive.
    pub from_s: f64,
}

/// All of these.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surroundings {
    /// A wall.
    pub wall: Option<Wall>,
    /// A push.
    pub push: Option<Push>,
    /// A jam.
    pub jam: Option<Jam>,
}

impl Surroundings {
    /// The force on the flange's origin in B at the time `t_s`, N.
    fn force<const N: usize>(
        &self,
        robot: &Robot<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        t_s: f64,
    ) -> Vector3<f64> {
        let pushed = self.push.filter(|push| (push.during_s.0..push.during_s.1).contains(&t_s));
        let mut force = pushed.map_or(Vector3::zeros(), |push| push.force_B);
        if let Some(wall) = self.wall {
            let depth = (wall.point_B - robot.forward(q).translation.vector).dot(&wall.normal_B);
            if depth > 0.0 {
                let speed = -(robot.jacobian(q).fixed_rows::<3>(0) * qd).dot(&wall.normal_B);
                force += *wall.normal_B * (wall.stiffness * depth + wall.damping * speed).max(0.0);
            }
        }
        force
    }

    /// The torques that this force causes in the joints, N m or N.
    pub(super) fn torque<const N: usize>(
        &self,
        robot: &Robot<N>,
        state: (&SVector<f64, N>, &SVector<f64, N>),
        t_s: f64,
    ) -> SVector<f64, N> {
        if self.wall.is_none() && self.push.is_none() {
            return SVector::zeros();
        }
        let force = self.force(robot, state, t_s);
        robot.jacobian(state.0).fixed_rows::<3>(0).tr_mul(&force)
    }

    /// Jams the joint of `robot` whose time has come, which then stands; once.
    pub(super) fn jam<const N: usize>(&mut self, robot: &mut Robot<N>, qd: &mut SVector<f64, N>, t_s: f64) {
        if let Some(jam) = self.jam.take_if(|jam| t_s >= jam.from_s && jam.joint < N) {
            robot.add_armature(jam.joint, JAMMED);
            qd[jam.joint] = 0.0;
        }
    }
}
