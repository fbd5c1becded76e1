//! Arms that are not as the controller thinks, drawn at random: friction, masses, load, encoders, late commands, starts, alone
//! and all together, in every run file. The short campaign runs with all tests; the long one by
//!
//! ```text
//! cargo test --release --test cores arm_unlike_model -- --ignored --nocapture
//! VSERVO_CAMPAIGN_DRAWS=40 VSERVO_CAMPAIGN_FILES=panda,xarm7 ...
//! ```

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests; numbers for people

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::control::trace::Event;
use vservo::messages::MAX_JOINTS;
use vservo::motion::Limit;
use vservo::sim::{Moment, simulate_system};

/// Every run file whose arm is simulated, and the load that its arm is made for, kg.
const RUN_FILES: [(&str, f64); 14] = [
    ("default", 2.0),
    ("dot-grid", 5.0),
    ("pan_tilt", 0.0),
    ("panda", 3.0),
    ("scara-a", 2.0),
    ("scara-b", 2.0),
    ("scara-c", 2.0),
    ("scara-d", 2.0),
    ("scara-eye-to-hand", 2.0),
    ("scara-hybrid", 2.0),
    ("ur5", 5.0),
    ("ur5-b", 5.0),
    ("ur5-hybrid", 5.0),
    ("xarm7", 3.5),
];

/// What an arm is drawn to differ in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Unlike {
    Friction,
    Masses,
    Load,
    Encoders,
    Delay,
    Start,
    Everything,
}

impl Unlike {
    const ALL: [Self; 7] = [
        Self::Friction,
        Self::Masses,
        Self::Load,
        Self::Encoders,
        Self::Delay,
        Self::Start,
        Self::Everything,
    ];
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn load(file: &str, set: &[String]) -> Result<Config, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    Config::load(Some(&path), set).map_err(|e| e.to_string())
}

/// The settings of one arm; one whose target is out of sight at its start is drawn anew.
fn draw(file: &str, rated_kg: f64, unlike: Unlike, random: &mut Random) -> Vec<String> {
    let is = |what| unlike == what || unlike == Unlike::Everything;
    let q_start = load(file, &[]).unwrap().start.q;
    loop {
        let mut set = Vec::new();
        if is(Unlike::Friction) {
            set.push(format!("scene.arm.friction_scale={:.3}", random.within(0.7, 1.3)));
        }
        if is(Unlike::Masses) {
            set.push(format!("scene.arm.mass_scale={:.3}", random.within(0.8, 1.2)));
        }
        if is(Unlike::Load) {
            set.push(format!("drive.simulated.payload_kg={:.3}", random.within(0.0, rated_kg)));
            let com_m = [-0.03, -0.03, 0.02].map(|low| random.within(low, low + 0.06));
            set.push(format!("drive.simulated.payload_com_m={com_m:.3?}"));
        }
        if is(Unlike::Encoders) {
            let step = 10f64.powf(random.within(-6.0, -3.3));
            set.push(format!("drive.simulated.encoder_step_rad_or_m=[{step:.7}]"));
            let noise_sd = random.within(-0.3, 0.3).max(0.0) * step;
            set.push(format!("drive.simulated.encoder_noise_sd_rad_or_m=[{noise_sd:.7}]"));
        }
        if is(Unlike::Delay) {
            set.push(format!("drive.simulated.command_delay_ticks={}", 1 + random.next() % 5));
        }
        if is(Unlike::Start) {
            let q: Vec<_> = q_start.iter().map(|q| q + random.within(-0.04, 0.04)).collect();
            set.push(format!("robot.q_start_rad_or_m={q:.4?}"));
        }
        set.push(format!("run.seed={}", random.next() % 1_000_000));
        if load(file, &set).is_ok() {
            return set;
        }
    }
}

/// What became of a run.
enum End {
    Converged,
    /// Nobody could have: a joint stood at its effort limit for long, or the plate's edge was out of sight at the start.
    Impossible,
    Failed(String),
}

/// A joint that pushes with all its effort for so many ticks on end is too weak.
const TOO_WEAK: u32 = 60;

fn end_of_run(file: &str, set: &[String]) -> End {
    let config = load(file, set).unwrap();
    let (mut at_limit, mut last, mut too_weak) = ([0; MAX_JOINTS], [0.0; MAX_JOINTS], false);
    let mut fastest = 0.0;
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            let cut = trace.limits.joints(Limit::Effort);
            for (i, (count, tau)) in at_limit.iter_mut().zip(trace.command.tau).enumerate() {
                // One that swings from limit to limit is not weak but badly controlled.
                *count = if cut >> i & 1 == 1 && tau == last[i] { *count + 1 } else { 0 };
                too_weak |= *count >= TOO_WEAK;
            }
            last = trace.command.tau;
            fastest = trace.joint_state.qd_true.iter().fold(0.0f64, |most, qd| most.max(qd.abs()));
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let (outcome, reason) = (run.finish.outcome, run.finish.reason);
    // However it ended, and whatever the arm can bear.
    let ends_moving = fastest > 0.02;
    match outcome {
        _ if ends_moving => End::Failed(format!("{} ({reason}), moving at {fastest:.3}", outcome.as_str())),
        Outcome::Converged => End::Converged,
        _ if too_weak || reason.contains("never seen") => End::Impossible,
        _ => {
            let error_px = run.errors.feature_error_px.unwrap_or(f64::NAN);
            End::Failed(format!("{} ({reason}), {error_px:.3} px", outcome.as_str()))
        }
    }
}

/// Converged runs and runs of each kind.
type Shares = BTreeMap<(&'static str, Unlike), (u32, u32)>;

/// Runs `draws` arms of each kind in each of `files`.
fn campaign(files: &[(&'static str, f64)], kinds: &[Unlike], draws: u64, seed: u64) -> Shares {
    let jobs: Vec<_> = files
        .iter()
        .enumerate()
        .flat_map(|(f, (file, rated_kg))| {
            kinds.iter().flat_map(move |unlike| {
                (0..draws).map(move |k| {
                    (*file, *rated_kg, *unlike, seed + 1000 * f as u64 + 100 * *unlike as u64 + 100_000 * k)
                })
            })
        })
        .collect();
    let (next, shares) = (AtomicUsize::new(0), Mutex::new(Shares::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some((file, rated_kg, unlike, seed)) =
                    jobs.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let random = &mut Random(*seed);
                    let (set, failed) = loop {
                        let set = draw(file, *rated_kg, *unlike, random);
                        match end_of_run(file, &set) {
                            End::Converged => break (set, None),
                            End::Failed(how) => break (set, Some(how)),
                            End::Impossible => {}
                        }
                    };
                    if let Some(how) = &failed {
                        println!("{file} {unlike:?}: {how}: {}", set.join(" "));
                    }
                    let mut shares = shares.lock().unwrap();
                    let (converged, all) = shares.entry((file, *unlike)).or_default();
                    *converged += u32::from(failed.is_none());
                    *all += 1;
                }
            });
        }
    });
    shares.into_inner().unwrap()
}

/// Prints a table, and gives the share that converged.
fn tell(shares: &Shares) -> f64 {
    let (mut converged, mut all) = (0, 0);
    for ((file, unlike), (good, of)) in shares {
        println!("{file:20} {unlike:12?} {good:3} of {of}", unlike = format!("{unlike:?}"));
        converged += good;
        all += of;
    }
    println!("{converged} of {all}");
    f64::from(converged) / f64::from(all)
}

/// At least 99 % converge without a fault.
#[test]
#[ignore = "takes many minutes"]
fn long_campaign() {
    let draws = std::env::var("VSERVO_CAMPAIGN_DRAWS").ok().and_then(|n| n.parse().ok()).unwrap_or(10);
    let chosen = std::env::var("VSERVO_CAMPAIGN_FILES").ok();
    let is_chosen = |file: &str| chosen.as_ref().is_none_or(|list| list.split(',').any(|name| name == file));
    let files: Vec<_> = RUN_FILES.into_iter().filter(|(file, _)| is_chosen(file)).collect();
    let share = tell(&campaign(&files, &Unlike::ALL, draws, 1));
    assert!(share >= 0.99, "{share}");
}

/// Two arms with everything in every run file, the hardest kind, to the default goal. Most converge, 599 of 672 with two other seeds (598 before references that jitter were told from others); 28 scatter about that by 6 %. The others
/// have coarse encoders, a load and late commands together, or wrists with much friction, and swing by 0.1 to 3 px.
#[test]
fn short_campaign() {
    let share = tell(&campaign(&RUN_FILES, &[Unlike::Everything], 2, 7));
    assert!(share >= 0.75, "{share}");
}

/// An arm with a load, coarse encoders and late commands moves about its goal until it is calmed, which is told once a stage.
#[test]
fn an_arm_that_swings_is_calmed_and_comes_home() {
    let set = [
        "scene.arm.friction_scale=0.945",
        "scene.arm.mass_scale=1.132",
        "drive.simulated.payload_kg=1.352",
        "drive.simulated.payload_com_m=[0.009, 0.018, 0.023]",
        "drive.simulated.encoder_step_rad_or_m=[0.0003237]",
        "drive.simulated.command_delay_ticks=4",
        "robot.q_start_rad_or_m=[0.4380, -1.7158, 1.4321, -1.2782, -1.7964, 0.9637]",
        "run.seed=98828",
    ]
    .map(String::from);
    let mut calmed = 0;
    let run = simulate_system(&load("ur5", &set).unwrap(), &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            calmed += trace.events.iter().filter(|event| *event == Event::GainReduced).count();
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{}", run.finish.reason);
    assert!((1..=2).contains(&calmed), "{calmed}");
}
