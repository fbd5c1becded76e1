//! Torque laws whose torques are held between frames: damping that is held too long drives the arm.

use crate::config::Camera;
use crate::config::check::Validation;
use crate::robot::{Mount, Robot, RobotDescription};
use crate::servo::{Damping, Law, PoseGains, ServoSettings, UpdatePolicy};
use nalgebra::{DMatrix, SVector};

/// Product of the rate at which damping alone slows the arm down and of the time for which a torque is held, from which on the arm swings.
/// Derived: a velocity v becomes (1 - rate T) v in that time, and grows from 2 on; stiffness makes it worse, the joints' own friction better.
const HELD_DAMPING: f64 = 2.0;

/// Warns of damping that is too strong for torques that are held between frames, by the arm's inertia at the start `q`.
pub(super) fn doubtful_held_damping(
    servo: &ServoSettings,
    (robot, q): (&RobotDescription, &[f64]),
    camera: &Camera,
    check: &mut Validation<'_>,
) {
    if servo.update != UpdatePolicy::Frame || !servo.law.is_torque() {
        return;
    }
    let rate = crate::dispatch_robot!(robot, |arm| damping_rate_1_s(&arm, &servo.law, &camera.mount, q));
    let limit_1_s = HELD_DAMPING * camera.rate_hz;
    if let Ok(Some(rate_1_s)) = rate
        && rate_1_s > limit_1_s
    {
        let message = format!(
            "torques that are held for a frame of {:.0} ms let the arm swing: the damping (servo.pd) slows its lightest motion down at {rate_1_s:.0} 1/s at the \
             start, and held for so long it may at most do so at {limit_1_s:.0}; take servo.update = \"predict\", or gains that are {:.0} times lower",
            1e3 / camera.rate_hz,
            (2.0 * rate_1_s / limit_1_s).ceil()
        );
        check.doubtful("servo.update", message);
    }
}

/// The largest rate at which the damping of a torque law alone slows the arm down at `q`: the largest eigenvalue of B^-1 J^T K_D J, with the camera's Jacobian J. `None`
/// where the damping acts in the image.
fn damping_rate_1_s<const N: usize>(robot: &Robot<N>, law: &Law, mount: &Mount, q: &[f64]) -> Option<f64> {
    let q = SVector::<f64, N>::from_iterator(q.iter().copied().chain(std::iter::repeat(0.0)).take(N));
    let task = |K_D: &PoseGains| {
        let J = mount.camera(robot, &q).1;
        J.matrix().transpose() * K_D.matrix() * J.matrix()
    };
    let joints = |K_D: &[f64]| {
        let diagonal = SVector::from_fn(|i, _| K_D.get(i).copied().unwrap_or(0.0));
        nalgebra::SMatrix::from_diagonal(&diagonal)
    };
    let damping = match law {
        Law::PositionTorque { damping: Damping::Task(K_D), .. }
        | Law::PreconditionedTorque { damping: Damping::Task(K_D), .. } => task(K_D),
        Law::PositionTorque { damping: Damping::Joints(K_D), .. }
        | Law::PreconditionedTorque { damping: Damping::Joints(K_D), .. }
        | Law::ImageTorque { damping: Damping::Joints(K_D), .. } => joints(K_D),
        _ => return None,
    };
    let B = robot.mass_matrix(&q);
    let square = |A: &nalgebra::SMatrix<f64, N, N>| DMatrix::from_fn(N, N, |i, j| A[(i, j)]);
    let L = square(&B).cholesky()?.l();
    // L^-1 D L^-T has the eigenvalues of B^-1 D.
    let half = L.solve_lower_triangular(&square(&damping))?;
    let rates = L.solve_lower_triangular(&half.transpose())?;
    Some(rates.symmetric_eigenvalues().max()).filter(|rate| rate.is_finite())
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    /// Shipped gains are for predicted views; the text's are held between frames.
    #[test]
    fn damping_that_is_held_too_long_is_told() {
        let warnings = |file: &str, set: &[&str]| -> Vec<String> {
            let set: Vec<String> = set.iter().map(|s| (*s).into()).collect();
            let config = Config::load(Some(std::path::Path::new(file)), &set).unwrap();
            config
                .warnings
                .iter()
                .map(ToString::to_string)
                .filter(|w| w.contains("let the arm swing"))
                .collect()
        };
        for file in ["scara-a", "scara-c"] {
            assert_eq!(warnings(file, &[]).len(), 0, "{file}");
            assert_eq!(warnings(file, &["servo.update=frame"]).len(), 1, "{file}");
            assert_eq!(warnings(&format!("textbook/{file}"), &[]).len(), 0, "{file}");
        }
        // The rate is that of the inertia: 2 T is the limit, whatever the rate of the camera.
        let slow = [
            "servo.update=frame",
            "servo.pd.position_damping_ns_m=[300, 300, 30]",
            "servo.pd.orientation_damping_nms_rad=1",
        ];
        assert_eq!(warnings("scara-a", &slow).len(), 0);
    }
}
