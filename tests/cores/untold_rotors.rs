//! Rotor inertia that the robot file does not tell, up to three times the inertia of each joint, in this process and with vision, alone and with what else arms
//! have that their models do not. The draws are not those that the estimator's constants were chosen on. More of them by
//! `VSERVO_CAMPAIGN=1 cargo test --test cores untold_rotors:: -- --nocapture`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::rendered::Random;
use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::simulate_system;

/// Run files with drives that obey torques, and the payload that their arms are made for, kg.
const ARMS: [(&str, f64); 5] =
    [("ur5", 5.0), ("panda", 3.0), ("xarm7", 3.5), ("scara-b", 2.0), ("default", 2.0)];

/// How many of `draws` runs of each arm converge, with the settings that `also` draws beside rotors.
fn converged(draws: u32, seed: u64, also: impl Fn(&mut Random, f64) -> Vec<String>) -> (u32, u32) {
    let (mut good, mut all) = (0, 0);
    for (k, (file, rated_kg)) in ARMS.iter().enumerate() {
        let mut random = Random(seed + k as u64);
        for draw in 0..draws {
            let share = [0.1, 0.5, 1.0, 3.0][draw as usize % 4] * random.within(0.8, 1.0);
            let mut set = also(&mut random, *rated_kg);
            set.push(format!("drive.simulated.untold_rotor_share={share:.3}"));
            set.push(format!("run.seed={}", (random.within(0.0, 1e6)) as u32));
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
            let config = Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"));
            let run = simulate_system(&config, &mut |_| ControlFlow::Continue(())).unwrap();
            all += 1;
            good += u32::from(run.finish.outcome == Outcome::Converged);
            if run.finish.outcome != Outcome::Converged {
                println!("{file} {}: {}", run.finish.reason, set.join(" "));
            }
        }
    }
    println!("{good} of {all}");
    (good, all)
}

fn draws() -> u32 {
    if std::env::var_os("VSERVO_CAMPAIGN").is_some() { 40 } else { 4 }
}

#[test]
fn rotors_that_no_file_tells_are_found() {
    let (good, all) = converged(draws(), 900, |_, _| Vec::new());
    // A SCARA with 2.7 times its inertia is stopped as touched.
    assert!(f64::from(good) >= 0.95 * f64::from(all), "{good} of {all}");
}

#[test]
fn rotors_are_found_with_payloads_and_other_friction() {
    let (good, all) = converged(draws(), 950, |random, rated_kg| {
        let com_m = [-0.05, -0.05, 0.02].map(|low| random.within(low, low + 0.1));
        vec![
            format!("drive.simulated.payload_kg={:.3}", random.within(0.0, rated_kg)),
            format!("drive.simulated.payload_com_m={com_m:.3?}"),
            format!("scene.arm.friction_scale={:.3}", random.within(0.0, 2.0)),
        ]
    });
    // Of 100 other draws 95 came home.
    assert!(f64::from(good) >= 0.95 * f64::from(all), "{good} of {all}");
}

#[test]
fn rotors_are_found_behind_late_commands() {
    let (good, all) = converged(draws(), 990, |random, _| {
        vec![format!("drive.simulated.command_delay_ticks={}", random.within(1.0, 6.0) as u32)]
    });
    assert!(f64::from(good) >= 0.95 * f64::from(all), "{good} of {all}");
}
