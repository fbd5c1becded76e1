//! A torque law hands over to the joint controller when it may not go on: the arm brakes from the motion of that moment.

#![allow(non_snake_case, clippy::unwrap_used)] // helpers of tests are tests

use crate::common::seen;
use nalgebra::SVector;
use std::path::Path;
use vservo::config::Config;
use vservo::config::assemble;
use vservo::mission::LockstepRun;
use vservo::robot::Robot;
use vservo::time::MonoNs;

const MS: i64 = 1_000_000;
const LOST_AT: i64 = 600;

/// Joint speed when the measurements stop, largest until the law has to give up and the arm has braked (200 ms after the last
/// measurement), largest after that, and at the end.
fn run<const N: usize>(config: &Config, robot: &Robot<N>, mut control: LockstepRun<N>) -> [f64; 4] {
    let (mut at_loss, mut until, mut after, mut last) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    for k in 0..2500_i64 {
        let joint = control.sense(k as u64, MonoNs(k * MS));
        let q = SVector::<f64, N>::from_fn(|i, _| joint.q[i]);
        last = SVector::<f64, N>::from_fn(|i, _| joint.qd[i]).amax();
        if k == LOST_AT {
            at_loss = last;
        }
        if k > LOST_AT + 250 {
            after = after.max(last);
        } else if k > LOST_AT {
            until = until.max(last);
        }
        let m = (k % 40 == 0 && k < LOST_AT).then(|| seen(config, robot, &q, k));
        let finish = control.act(MonoNs(k * MS), m.as_ref()).finish;
        assert!(finish.is_none(), "{k} {finish:?}");
    }
    [at_loss, until, after, last]
}

#[test]
fn without_measurements_the_arm_brakes_and_holds() {
    for file in ["textbook/scara-a.toml", "textbook/scara-c.toml"] {
        for update in ["frame", "tick", "predict"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
            let config = Config::load(Some(&path), &[format!("servo.update={update}")]).unwrap();
            let [at_loss, until, after, last] = vservo::dispatch_robot!(config.robot, |robot| {
                let copy = robot.clone();
                run(&config, &copy, assemble::control_loop(&config, robot).unwrap())
            })
            .unwrap();
            assert!(at_loss > 0.5, "{file} {update}: the arm moved at {at_loss}");
            assert!(until < 1.01 * at_loss, "{file} {update}: {at_loss} -> {until}");
            assert!(after < 0.02 * at_loss, "{file} {update}: {at_loss} -> {after}, 0.0085 is obtained");
            assert!(last < 1e-9, "{file} {update}: at rest, not {last}");
        }
    }
}
