//! The cell of Sect. 10.9: SCARA arm, camera in its hand, square of four points, start and goal.
//!
//! Base z, camera z and object z point down; angles are right-handed about down.
//!
//! The numbers here are the textbook's, where it has any, and else chosen settings of the simulation.

use super::ExperimentError;
use super::metrics::CellGoal;
use crate::geometry::Pose;
use crate::robot::{self, Robot};
use nalgebra::{Point3, Vector2, Vector4};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, FRAC_PI_4};

/// P1 ... P4 of Fig. 10.6 in the object frame, m.
pub const POINTS: [Point3<f64>; 4] = [
    Point3::new(0.0, 0.0, 0.0),
    Point3::new(0.1, 0.0, 0.0),
    Point3::new(0.1, 0.1, 0.0),
    Point3::new(0.0, 0.1, 0.0),
];

/// The pose with the position and the angle about z of (10.33).
#[must_use]
pub fn pose_of(x: &Vector4<f64>) -> Pose {
    Pose::new(x.xyz(), [0.0, 0.0, x.w].into())
}

/// x_d,o of Sect. 10.9: m, m, m, rad.
#[must_use]
pub fn desired_object() -> Vector4<f64> {
    Vector4::new(-0.1, 0.1, 0.6, -FRAC_PI_3)
}

/// The projections of [`POINTS`] for the object at `X_CO`, normalized; `None` when one is not in front.
#[must_use]
pub fn project(X_CO: &Pose) -> Option<[Vector2<f64>; 4]> {
    let p_C = POINTS.map(|p| X_CO * p);
    p_C.iter().all(|p| p.z > 0.0).then(|| p_C.map(|p| p.coords.xy() / p.z))
}

/// Arm, object, start and goal.
#[derive(Debug, Clone)]
pub struct Cell {
    /// The SCARA of Fig. 2.36 with the data of Example 7.2 and Sect. 10.9.
    pub arm: Robot<4>,
    /// The object in the base.
    pub X_BO: Pose,
    /// The object in the desired camera frame.
    pub X_DO: Pose,
    /// Joint positions at the start, rad and m.
    pub q_start: Vector4<f64>,
}

impl Cell {
    /// The operating conditions of Sect. 10.9.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`] when the shipped arm cannot be loaded.
    pub fn textbook() -> Result<Self, ExperimentError> {
        let cell = |e: robot::RobotError| ExperimentError::Cell { cause: e.to_string() };
        let arm = robot::load("scara").map_err(cell)?.build::<4>().map_err(cell)?;
        Ok(Self {
            arm,
            X_BO: pose_of(&Vector4::new(1.0, 1.0, 1.0, FRAC_PI_4)),
            X_DO: pose_of(&desired_object()),
            q_start: Vector4::new(0.0, FRAC_PI_2, 0.5, -FRAC_PI_4),
        })
    }

    /// x_c = [x y z alpha] for the joint positions `q`; alpha counts whole turns.
    #[must_use]
    pub fn camera(&self, q: &Vector4<f64>) -> Vector4<f64> {
        let p = self.arm.forward(q).translation.vector;
        Vector4::new(p.x, p.y, p.z, q[0] + q[1] + q[3])
    }

    /// The joint positions that bring the camera to `x_c`, on the elbow branch of the start.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`] out of the arm's reach.
    pub fn joints(&self, x_c: &Vector4<f64>) -> Result<Vector4<f64>, ExperimentError> {
        let c2 = 0.5 * (x_c.x * x_c.x + x_c.y * x_c.y) - 1.0; // both links are 1 m long
        if !(c2.abs() < 1.0) {
            return Err(ExperimentError::Cell { cause: "the pose is out of the arm's reach".into() });
        }
        let q2 = c2.acos().copysign(self.q_start[1]);
        let q1 = x_c.y.atan2(x_c.x) - 0.5 * q2;
        Ok(Vector4::new(q1, q2, x_c.z, x_c.w - q1 - q2))
    }

    /// The object in the camera.
    #[must_use]
    pub fn X_CO(&self, q: &Vector4<f64>) -> Pose {
        self.arm.forward(q).inverse() * self.X_BO
    }

    /// Where the run should end, with the desired angle on the turn nearest to the start's.
    ///
    /// # Errors
    /// [`ExperimentError::Cell`] when the desired pose does not show all points.
    pub fn goal(&self) -> Result<CellGoal, ExperimentError> {
        let X_BD = self.X_BO * self.X_DO.inverse();
        let start = self.camera(&self.q_start).w;
        let turn = X_BD.rotation.euler_angles().2 - start;
        let alpha = start + crate::features::wrap_rad(turn);
        let p = X_BD.translation.vector;
        let s = project(&self.X_DO).ok_or_else(|| ExperimentError::Cell {
            cause: "a point lies behind the desired camera".into(),
        })?;
        Ok(CellGoal { x_c: Vector4::new(p.x, p.y, p.z, alpha), s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_and_goal_of_the_comparison() {
        let cell = Cell::textbook().unwrap();
        let start = cell.camera(&cell.q_start);
        assert!((start - Vector4::new(1.0, 1.0, 0.5, FRAC_PI_4)).norm() < 1e-12, "{start}");
        let seen = cell.X_CO(&cell.q_start);
        assert!((seen.translation.vector - Vector4::new(0.0, 0.0, 0.5, 0.0).xyz()).norm() < 1e-12);
        assert!(seen.rotation.angle() < 1e-12);
        let goal = cell.goal().unwrap();
        let given = Vector4::new(1.070_710_7, 1.122_474_5, 0.4, 7.0 * std::f64::consts::PI / 12.0);
        assert!((goal.x_c - given).norm() < 1e-7, "{}", goal.x_c);
        let q = cell.joints(&goal.x_c).unwrap();
        assert!((cell.camera(&q) - goal.x_c).norm() < 1e-12 && q[1] > 0.0);
        assert!(cell.joints(&Vector4::new(2.0, 1.0, 0.0, 0.0)).is_err());
        let flat: Vec<f64> = goal.s.iter().flat_map(|s| [s.x, s.y]).collect();
        // (10.78) and s'' of Example 10.5, as printed.
        let printed = [-0.1667, 0.1667, -0.0833, 0.0223, 0.0610, 0.1057, -0.0223, 0.2500];
        assert!(flat.iter().zip(printed).all(|(a, b)| (a - b).abs() < 5e-5), "{flat:?}");
    }
}
