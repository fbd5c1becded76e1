//! Arms that differ from their models in everything at once, drawn at random: payloads of 0 to 100 % of the rated one with their centre off the axis, rotors that no file tells
//! of 0 to 300 % of the joints' inertia, 0 to twice the friction of the file (smooth, hard with static friction, hard with a wide Stribeck curve), encoder steps to 1e-3 that
//! are told and to 1e-4 that are not, commands up to 5 ms late, drives that obey torques, velocities and positions. UR5 and Panda, whose files tell no Coulomb friction, have files that do
//! (up to 3 % of each effort). Some draws with all tests; more by
//!
//! ```text
//! VSERVO_CAMPAIGN_DRAWS=100 cargo test --release --test cores everything_at_once:: -- --nocapture
//! VSERVO_CAMPAIGN_SEED=7 VSERVO_CAMPAIGN_MODES=torque VSERVO_CAMPAIGN_FILES=ur5,xarm7 VSERVO_CAMPAIGN_SET='servo.gain_1_s=1.0;...' ...
//! ```
//! which prints a line for each draw, with the settings that repeat it, and a table.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::rendered::Random;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::messages::MAX_JOINTS;
use vservo::motion::Limit;
use vservo::sim::{Moment, simulate_system};

/// Run files, and the payload that their arms are made for, kg.
const ARMS: [(&str, f64); 4] = [("ur5", 5.0), ("panda", 3.0), ("xarm7", 3.5), ("scara-b", 2.0)];
const MODES: [&str; 3] = ["torque", "velocity", "position"];
/// The limit of acceleration of all run files, rad/s^2 or m/s^2.
const LIMIT: f64 = 10.0;
/// A joint that stands at its effort limit for so many ticks on end is too weak for what it carries.
const TOO_WEAK: u32 = 60;

/// A copy of a shipped URDF whose joints have `share` of their efforts as Coulomb friction.
fn with_friction(folder: &Path, robot: &str, share: f64) -> PathBuf {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robot");
    let text = std::fs::read_to_string(shipped.join(format!("{robot}.urdf"))).unwrap();
    let value = |part: &str, key: &str| -> Option<f64> {
        part.split_once(&format!("{key}=\""))?.1.split_once('"')?.0.parse().ok()
    };
    let mut parts = text.split("<joint ");
    let mut all = parts.next().unwrap().to_owned();
    for part in parts {
        let coulomb = value(part, "effort").unwrap_or(0.0) * share;
        all += "<joint ";
        all += &part.replace("friction=\"0.0\"", &format!("friction=\"{coulomb:.4}\""));
    }
    let name = format!("{robot}-{:.0}.urdf", 1e5 * share);
    std::fs::write(folder.join(&name), all).unwrap();
    let model = std::fs::read_to_string(shipped.join(format!("{robot}.toml"))).unwrap();
    let path = folder.join(format!("{robot}-{:.0}.toml", 1e5 * share));
    std::fs::write(&path, model.replace(&format!("{robot}.urdf"), &name)).unwrap();
    path
}

/// One arm.
struct Draw {
    file: &'static str,
    mode: &'static str,
    /// Of the friction.
    kind: &'static str,
    set: Vec<String>,
}

fn load(file: &str, set: &[String]) -> Result<Config, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    Config::load(Some(&path), set).map_err(|e| e.to_string())
}

/// An arm, drawn anew where its target is out of view at its start.
fn draw(
    (file, rated_kg): (&'static str, f64),
    mode: &'static str,
    random: &mut Random,
    folder: &Path,
    common_keys: &[String],
) -> Draw {
    let q_start = load(file, &[]).unwrap().start.q;
    loop {
        let mut set = vec![format!("drive.mode={mode}")];
        if ["ur5", "panda"].contains(&file) {
            let share = random.within(0.0, 0.03);
            set.push(format!("robot.model={}", with_friction(folder, file, share).display()));
        }
        let (kg, rotors) = (random.within(0.0, rated_kg), random.within(0.0, 3.0));
        let com_m = [-0.05, -0.05, 0.02].map(|low| random.within(low, low + 0.1));
        set.push(format!("drive.simulated.payload_kg={kg:.3}"));
        set.push(format!("drive.simulated.payload_com_m={com_m:.3?}"));
        set.push(format!("drive.simulated.untold_rotor_share={rotors:.3}"));
        set.push(format!("scene.arm.friction_scale={:.3}", random.within(0.0, 2.0)));
        let kind = ["smooth", "static", "stribeck"][random.within(0.0, 3.0) as usize];
        if kind != "smooth" {
            let (ratio, speed) = if kind == "static" {
                (random.within(1.0, 1.5), 0.01)
            } else {
                (1.4, random.within(0.05, 0.3))
            };
            set.push("drive.simulated.hard_friction=true".into());
            set.push(format!("drive.simulated.static_friction_ratio={ratio:.2}"));
            set.push(format!("drive.simulated.stribeck_speed_rad_s_or_m_s={speed:.3}"));
        }
        if random.within(0.0, 1.0) < 0.5 {
            let step = 10f64.powf(random.within(-6.0, -3.0));
            set.push(format!("drive.simulated.encoder_step_rad_or_m=[{step:.7}]"));
        } else {
            let step = 10f64.powf(random.within(-6.0, -4.0));
            set.push(format!("drive.simulated.encoder_step_rad_or_m=[{step:.7}]"));
            set.push("motion.encoder_step_rad_or_m=[0.0]".into());
        }
        set.push(format!("drive.simulated.command_delay_ticks={}", random.within(0.0, 6.0) as u32));
        let q: Vec<_> = q_start.iter().map(|q| q + random.within(-0.04, 0.04)).collect();
        set.push(format!("robot.q_start_rad_or_m={q:.4?}"));
        set.push(format!("run.seed={}", random.within(0.0, 1e6) as u32));
        set.extend_from_slice(common_keys);
        if load(file, &set).is_ok() {
            return Draw { file, mode, kind, set };
        }
    }
}

/// What became of a run.
struct End {
    outcome: Outcome,
    reason: &'static str,
    /// Whether it ended at its goal, by truth, to 0.05 mm or 0.1 px.
    is_there: bool,
    /// Largest acceleration of a joint in the mean of a tick over the limit, all the way and after the first half second.
    hardest: f64,
    hardest_later: f64,
    error_mm: f64,
    error_px: f64,
    seconds: f64,
    /// Whether nobody could have: a joint stood at its effort limit for long, or the target is out of view at the start.
    impossible: bool,
}

fn end_of_run(draw: &Draw) -> End {
    let config = load(draw.file, &draw.set).unwrap();
    let (mut at_limit, mut last, mut too_weak) = ([0; MAX_JOINTS], [0.0; MAX_JOINTS], false);
    let (mut before, mut hardest, mut hardest_later, mut ticks) =
        (None::<[f64; MAX_JOINTS]>, 0.0_f64, 0.0_f64, 0);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let cut = trace.limits.joints(Limit::Effort);
            for (i, (count, tau)) in at_limit.iter_mut().zip(trace.command.tau).enumerate() {
                // One that swings from limit to limit is not weak but badly controlled.
                *count = if cut >> i & 1 == 1 && tau == last[i] { *count + 1 } else { 0 };
                too_weak |= *count >= TOO_WEAK;
            }
            last = trace.command.tau;
            let qd = trace.joint_state.qd_true;
            let pairs = qd.iter().zip(before.unwrap_or(qd));
            let now = pairs.map(|(qd, before)| (qd - before).abs() / 1e-3).fold(0.0, f64::max);
            hardest = hardest.max(now);
            ticks += 1;
            if ticks > 500 {
                hardest_later = hardest_later.max(now);
            }
            before = Some(qd);
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let error_mm = 1e3 * run.errors.position_error_m.unwrap_or(f64::NAN);
    let error_px = run.errors.feature_error_px.unwrap_or(f64::NAN);
    End {
        outcome: run.finish.outcome,
        reason: run.finish.reason,
        is_there: error_mm < 0.05 || error_px < 0.1,
        hardest: hardest / LIMIT,
        hardest_later: hardest_later / LIMIT,
        error_mm,
        error_px,
        seconds: f64::from(ticks) * 1e-3,
        impossible: too_weak || run.finish.reason.contains("never seen"),
    }
}

/// Runs of an arm and mode: how many there were, converged, and kept the acceleration within 10 % of its limit; faults.
#[derive(Debug, Default, Clone, Copy)]
struct Counts {
    all: u32,
    converged: u32,
    gently: u32,
    faults: u32,
}

/// Keys that all runs of a campaign have, which have to be ones that its files take.
fn common_keys(cases: &[((&'static str, f64), &'static str)]) -> Vec<String> {
    let set: Vec<String> =
        variable("VSERVO_CAMPAIGN_SET").iter().flat_map(|keys| keys.split(';').map(str::to_owned)).collect();
    for ((file, _), _) in cases {
        load(file, &set).unwrap();
    }
    set
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok()
}

/// `draws` runs, by turns of each arm in each mode.
fn campaign(draws: usize, seed: u64) -> Counts {
    let is_among = |list: &Option<String>, name: &str| {
        list.as_ref().is_none_or(|list| list.split(',').any(|one| one == name))
    };
    let (files, modes) = (variable("VSERVO_CAMPAIGN_FILES"), variable("VSERVO_CAMPAIGN_MODES"));
    let cases: Vec<_> = MODES
        .into_iter()
        .filter(|mode| is_among(&modes, mode))
        .flat_map(|mode| ARMS.into_iter().filter(|arm| is_among(&files, arm.0)).map(move |arm| (arm, mode)))
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let keys = common_keys(&cases);
    let (next, table) = (AtomicUsize::new(0), Mutex::new(BTreeMap::<(String, &str), Counts>::new()));
    let work = || {
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            if k >= draws {
                return;
            }
            let (arm, mode) = cases[k % cases.len()];
            let mut random = Random(seed.wrapping_mul(1_000_003) + k as u64);
            random.within(0.0, 1.0);
            let own = folder.path().join(k.to_string());
            std::fs::create_dir_all(&own).unwrap();
            let (drawn, end) = loop {
                let drawn = draw(arm, mode, &mut random, &own, &keys);
                let end = end_of_run(&drawn);
                if !end.impossible || end.outcome == Outcome::Converged {
                    break (drawn, end);
                }
                println!("{k:4} impossible: {} ({})", drawn.set.join(" "), end.reason);
            };
            let converged = end.outcome == Outcome::Converged && end.is_there;
            let what = if converged { "good" } else { end.outcome.as_str() };
            println!(
                "{k:4} {:8} {mode:8} {:8} {what:10} {:6.2} s {:8.4} mm {:7.3} px  acc x {:7.2} later x {:7.2} | {} | {}",
                drawn.file,
                drawn.kind,
                end.seconds,
                end.error_mm,
                end.error_px,
                end.hardest,
                end.hardest_later,
                end.reason,
                drawn.set.join(" ")
            );
            let one = Counts {
                all: 1,
                converged: u32::from(converged),
                gently: u32::from(converged && end.hardest <= 1.1),
                faults: u32::from(end.outcome == Outcome::Fault),
            };
            let mut table = table.lock().unwrap();
            for key in [drawn.file, drawn.kind, "all"] {
                let counts = table.entry((key.to_owned(), drawn.mode)).or_default();
                counts.all += one.all;
                counts.converged += one.converged;
                counts.gently += one.gently;
                counts.faults += one.faults;
            }
        }
    };
    std::thread::scope(|scope| (0..2).for_each(|_| _ = scope.spawn(work)));
    let table = table.into_inner().unwrap();
    let mut sum = Counts::default();
    for ((key, mode), counts) in &table {
        println!("{key:10} {mode:8} {counts:?}");
        if key == "all" {
            sum.all += counts.all;
            sum.converged += counts.converged;
            sum.gently += counts.gently;
            sum.faults += counts.faults;
        }
    }
    println!("{sum:?}");
    sum
}

#[test]
fn arms_unlike_their_models_in_everything() {
    let number = |name| variable(name).and_then(|n| n.parse::<u64>().ok());
    let draws = number("VSERVO_CAMPAIGN_DRAWS").unwrap_or(12) as usize;
    let counts = campaign(draws, number("VSERVO_CAMPAIGN_SEED").unwrap_or(1));
    // Of more draws three in four, and half of them before (docs/drives.md).
    assert!(f64::from(counts.converged) >= 0.5 * f64::from(counts.all), "{counts:?}");
}

/// Draws that hunted about their goals for 30 s, by 0.1 to 0.3 px, while each joint waited for its reference to free it: they come home as soon as friction is compensated by the sign of their errors.
#[test]
fn joints_that_stick_near_their_goals_come_home() {
    let common = ["drive.mode=torque", "drive.simulated.hard_friction=true"];
    let draws = [
        (
            "ur5",
            0.018_43,
            "drive.simulated.payload_kg=1.648 drive.simulated.payload_com_m=[-0.029,0.013,0.029] drive.simulated.untold_rotor_share=0.456 \
             scene.arm.friction_scale=1.256 drive.simulated.static_friction_ratio=1.10 drive.simulated.stribeck_speed_rad_s_or_m_s=0.010 drive.simulated.encoder_step_rad_or_m=[0.000026] \
             motion.encoder_step_rad_or_m=[0.0] drive.simulated.command_delay_ticks=1 \
             robot.q_start_rad_or_m=[0.4615,-1.7424,1.4329,-1.2570,-1.8031,1.0001] run.seed=848565",
        ),
        (
            "panda",
            0.022_86,
            "drive.simulated.payload_kg=1.297 drive.simulated.payload_com_m=[0.022,-0.025,0.060] drive.simulated.untold_rotor_share=2.451 \
             scene.arm.friction_scale=1.058 drive.simulated.static_friction_ratio=1.40 drive.simulated.stribeck_speed_rad_s_or_m_s=0.186 \
             drive.simulated.encoder_step_rad_or_m=[0.000034] drive.simulated.command_delay_ticks=2 \
             robot.q_start_rad_or_m=[-0.1453,-0.4857,-0.1240,-2.1447,0.1086,1.7889,0.2399] run.seed=603863",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (file, share, keys) in draws {
        let mut set: Vec<_> = common.into_iter().chain(keys.split_whitespace()).map(str::to_owned).collect();
        set.push(format!("robot.model={}", with_friction(folder.path(), file, share).display()));
        let end = end_of_run(&Draw { file, mode: "torque", kind: "static", set });
        let End { outcome, seconds, .. } = &end;
        assert!(
            *outcome == Outcome::Converged && end.is_there && *seconds < 12.0,
            "{file}: {outcome:?} after {seconds} s"
        );
    }
}
