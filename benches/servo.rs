//! The servo laws: from a view and a goal to what the joints shall do, six joints. Goal of the design: 0.3 us for 4 points,
//! 1.0 us for 16, camera twist.

#![allow(non_snake_case, clippy::unwrap_used)] // a bench that cannot be set up should say so at once

use divan::{Bencher, black_box};
use nalgebra::{Matrix6, Point3, Vector2, Vector3, Vector6};
use vservo::geometry::Pose;
use vservo::robot::CameraJacobian;
use vservo::servo::{
    Arm, Damping, DepthSource, Gain, HybridGains, Interaction, InteractionAt, Law, OperationalSpace,
    OrientationError, PoseGains, SetPoint, TwistWeights, View, image_task,
};

fn main() {
    divan::main();
}

fn scene(count: usize) -> (SetPoint, View) {
    let side = (count as f64).sqrt().round() as usize;
    let at = |i: usize| 0.1 * i as f64 / (side - 1) as f64;
    let points: Vec<_> = (0..count).map(|i| Point3::new(at(i % side), at(i / side), 0.0)).collect();
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.2, -0.3, 0.3].into());
    let near = Pose::new([0.02, -0.01, 0.05].into(), [0.1, -0.1, 0.2].into()) * goal;
    let s: Vec<_> = points.iter().map(|p| near * p).map(|p| Vector2::new(p.x / p.z, p.y / p.z)).collect();
    (SetPoint::from_pose(&goal, &points).unwrap(), View::new(s.into_iter(), Some(near)).unwrap())
}

const CURRENT: Interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };
const SPACE: OperationalSpace = OperationalSpace::Six;
const EULER: OrientationError = OrientationError::EulerZyx;

fn law(bencher: Bencher, count: usize, law: Law) {
    let (set_point, view) = scene(count);
    let J = Matrix6::identity() + Matrix6::from_fn(|i, j| 0.1 * (i as f64 - 2.0 * j as f64).sin());
    let (qd, gravity) = (Vector6::repeat(0.1), Vector6::repeat(5.0));
    let arm = Arm { J: CameraJacobian::of_moving_camera(J), qd, gravity };
    bencher.bench_local(|| {
        let task = law.task(black_box(&set_point), black_box(&view)).ok()?;
        law.output(&task, black_box(&arm))
    });
}

/// (10.91) alone.
#[divan::bench(args = [4, 16])]
fn camera_twist(bencher: Bencher, count: usize) {
    let (set_point, view) = scene(count);
    bencher.bench_local(|| image_task(black_box(&set_point), black_box(&view), CURRENT)?.twist(1.0));
}

#[divan::bench(args = [4, 16])]
fn d_image_velocity(bencher: Bencher, count: usize) {
    law(
        bencher,
        count,
        Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction: CURRENT },
    );
}

#[divan::bench(args = [4, 16])]
fn d_mean_interaction(bencher: Bencher, count: usize) {
    let interaction = Interaction { at: InteractionAt::Mean, ..CURRENT };
    law(bencher, count, Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction });
}

#[divan::bench(args = [4, 16])]
fn c_image_torque(bencher: Bencher, count: usize) {
    law(
        bencher,
        count,
        Law::ImageTorque { K_Ps: 300.0.into(), damping: Damping::Task(330.0.into()), interaction: CURRENT },
    );
}

#[divan::bench]
fn a_position_torque(bencher: Bencher) {
    let K = PoseGains::repeat(100.0);
    let damping = Damping::Task(K);
    law(bencher, 4, Law::PositionTorque { K_P: K, damping, orientation: EULER, space: SPACE });
}

#[divan::bench]
fn b_position_velocity(bencher: Bencher) {
    let K = PoseGains::repeat(1.0);
    law(
        bencher,
        4,
        Law::PositionVelocity {
            K,
            gain: Gain::Constant(1.0),
            orientation: EULER,
            space: SPACE,
            weights: TwistWeights::Unit,
        },
    );
}

#[divan::bench(args = [4, 16])]
fn hybrid(bencher: Bencher, count: usize) {
    let gains = HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(1.0).into() };
    let gain = Gain::Constant(1.0);
    law(
        bencher,
        count,
        Law::Hybrid { gains, gain, orientation: EULER, space: SPACE, depth: DepthSource::Desired },
    );
}
