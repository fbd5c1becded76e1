//! `vservo calibrate load` in this process: loads off the axis, on several arms, with friction and rotors that no file tells, are found within what is told
//! of their uncertainty. More of them by `VSERVO_CAMPAIGN=1 cargo test --test cores load_calibration:: -- --nocapture`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::rendered::Random;
use std::ops::ControlFlow;
use std::path::Path;
use vservo::calibration::load::{LoadError, LoadEstimate, LoadRecording, fit_load};
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::{Moment, simulate_system};

/// Run files with drives that obey torques, and the largest load that is tried, kg.
const ARMS: [(&str, f64); 3] = [("ur5", 4.0), ("panda", 2.5), ("xarm7", 3.0)];

fn load(file: &str, set: &[String]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    let own = [
        "run.task=calibrate_load",
        "run.duration_s=600",
        "camera.rate_hz=2",
        "safety.measurement_timeout_ms=5000",
    ];
    let all: Vec<String> = own.iter().map(|s| (*s).to_owned()).chain(set.iter().cloned()).collect();
    Config::load(Some(&path), &all).unwrap_or_else(|e| panic!("{file}: {e}"))
}

/// What a run finds, and how long it takes, s.
fn found(config: &Config) -> (Result<LoadEstimate, LoadError>, f64) {
    vservo::dispatch_robot!(config.robot, |robot| {
        let mut recording = LoadRecording::default();
        let run = simulate_system(config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                recording.note(&trace.joint_state, trace.measured_torque.as_ref());
            }
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(run.finish.outcome, Outcome::Finished, "{}", run.finish.reason);
        let ticks = recording.len();
        (fit_load(&robot, &config.tool, &recording), ticks as f64 * 1e-3)
    })
    .unwrap()
}

/// A load by chance: its mass, kg, and centre, m, as settings.
fn drawn(random: &mut Random, most_kg: f64) -> (f64, [f64; 3], [f64; 6], Vec<String>) {
    let kg = random.within(0.2 * most_kg, most_kg);
    let com = [-0.06, -0.06, 0.02].map(|low| random.within(low, low + 0.12));
    let r2 = [0; 3].map(|_| random.within(0.03, 0.08).powi(2) * kg);
    let inertia = [r2[1] + r2[2], r2[0] + r2[2], r2[0] + r2[1], 0.0, 0.0, 0.0];
    let set = vec![
        format!("drive.simulated.payload_kg={kg:?}"),
        format!("drive.simulated.payload_com_m={com:?}"),
        format!("drive.simulated.payload_inertia_kg_m2={inertia:?}"),
        format!("run.seed={}", random.within(0.0, 1e6) as u32),
    ];
    (kg, com, inertia, set)
}

fn draws() -> u32 {
    if std::env::var_os("VSERVO_CAMPAIGN").is_some() { 8 } else { 2 }
}

/// Draws loads on each arm, with what `also` sets; the largest error of the mass as a share, and of mass and centre in standard deviations.
fn campaign(name: &str, seed: u64, also: &dyn Fn(&mut Random) -> Vec<String>) -> (f64, f64, f64) {
    let (mut share, mut mass_sds, mut com_sds) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (k, (file, most_kg)) in ARMS.iter().enumerate() {
        let mut random = Random(seed + k as u64);
        for _ in 0..draws() {
            let (kg, com, inertia, mut set) = drawn(&mut random, *most_kg);
            set.extend(also(&mut random));
            let (found, s) = found(&load(file, &set));
            let found = found.unwrap_or_else(|e| panic!("{file} {set:?}: {e}"));
            let off = (found.load.mass - kg).abs();
            let coms: Vec<f64> = (0..3).map(|i| (found.load.com[i] - com[i]) / found.com_sd_m[i]).collect();
            let of_com = found.load.about_com;
            let moments = [of_com.m11, of_com.m22, of_com.m33, of_com.m12, of_com.m13, of_com.m23];
            println!(
                "{name} {file} {s:.0} s: {kg:.3} kg found {:.3} +- {:.4}; com sds {coms:.1?} of {:.2?} mm; inertia {:.1?} of {:.1?} +- {:.1?} g m2 {}; residuals {:.2?} %",
                found.load.mass,
                found.mass_sd_kg,
                found.com_sd_m.map(|x| x * 1e3),
                moments.map(|x| x * 1e3),
                inertia.map(|x| x * 1e3),
                found.inertia_sd_kg_m2.map(|x| x * 1e3),
                found.has_inertia,
                found.residual_shares.iter().map(|x| x * 1e2).collect::<Vec<_>>(),
            );
            share = share.max(off / kg);
            mass_sds = mass_sds.max(off / found.mass_sd_kg);
            com_sds = coms.iter().fold(com_sds, |most, x| most.max(x.abs()));
        }
    }
    println!("{name}: mass {:.2} %, {mass_sds:.2} sds; centre {com_sds:.2} sds", share * 1e2);
    (share, mass_sds, com_sds)
}

#[test]
fn loads_off_the_axis_are_found_within_their_uncertainty() {
    let (share, mass_sds, com_sds) = campaign("exact", 10, &|_| Vec::new());
    assert!(share < 0.05 && mass_sds < 3.0 && com_sds < 3.0);
}

#[test]
fn loads_are_found_with_stick_slip_and_untold_rotors() {
    let (share, mass_sds, com_sds) = campaign("rough", 50, &|random| {
        vec![
            "drive.simulated.hard_friction=true".into(),
            format!("drive.simulated.friction_spread={:.3}", random.within(0.0, 0.5)),
            format!("drive.simulated.untold_rotor_share={:.3}", random.within(0.0, 1.0)),
        ]
    });
    assert!(share < 0.05 && mass_sds < 3.0 && com_sds < 3.0);
}

#[test]
fn loads_are_found_with_late_commands_and_coarse_encoders() {
    let (share, mass_sds, com_sds) = campaign("late", 90, &|random| {
        vec![
            format!("drive.simulated.command_delay_ticks={}", random.within(0.0, 3.0) as u32),
            "drive.simulated.encoder_step_rad_or_m=[2e-5]".into(),
            "motion.encoder_step_rad_or_m=[2e-5]".into(),
            "drive.simulated.torque_ripple_share=0.002".into(),
        ]
    });
    assert!(share < 0.05 && mass_sds < 3.0 && com_sds < 3.0);
}
