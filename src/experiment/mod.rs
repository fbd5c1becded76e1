//! The textbook's examples, problems and comparison, and studies that go beyond them: `vservo experiment NAME --out DIR`.
//!
//! ```text
//! cell, source ──► simulate (25 Hz law, 1 ms arm) ──► Trajectory ──► CSV, Metrics, figures ──► Findings ──► files
//!                   ▲ servo::Law, the same as in the running loop
//! system (the whole run in one process) ──► errors against truth ─────────────────────────────┘
//! ```
//! The simulations are pure; [`Findings::write`] is the one place that touches files. Nothing here repeats an equation:
//! laws come from `servo`, estimators from `pose`, the arm from `robot`.

mod calibration;
mod cell;
mod comparison;
mod convergence;
mod error;
mod examples;
mod feature_source;
mod findings;
mod gain_delay;
mod image_figures;
mod look_and_move;
mod metrics;
mod moving_target;
mod plot;
mod point_examples;
mod retreat;
mod schemes;
mod simulate;
mod stability;
mod system_gain;
mod trajectory;

pub use calibration::{Teaching, calibrations, run_miscalibrated};
pub use cell::{Cell, POINTS, desired_object, pose_of, project};
pub use comparison::run_scheme;
pub use convergence::{ConvergenceRun, LAW_VARIANTS, LawVariant, StartOutcome, run_from, runs_of, start};
pub use error::ExperimentError;
pub use feature_source::{FeatureSource, Miscalibration, RenderedFeatures};
pub use findings::{Figure, Findings, StepFigure, embedded_image};
pub use gain_delay::{DELAYS_MS, DelayedLoop, Disturbance, Finding, errors_to_bear, study};
pub use metrics::{CellGoal, Metrics, RemainingErrors, SettlingTimes, path_deviation, settling_time};
pub use plot::{Drawing, Panel, Series, Symbol, figure};
pub use retreat::{ROTATIONS_DEG, pure_rotation, retreat_of};
pub use schemes::{Estimator, PoseFeature, SCHEMES, Scheme, SchemeController, segment_selection, set_point};
pub use simulate::{LawInput, SPAN_S, STEP_S, STEPS_PER_FRAME, simulate, simulate_at};
pub use stability::{StabilityFinding, WrongKnowledge, stability_of};
pub use trajectory::{HEADER, Trajectory, TrajectoryEnd, TrajectoryRow};

use std::path::{Path, PathBuf};

/// Which camera an experiment uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CameraKind {
    /// Projected points, as in the text.
    #[default]
    Ideal,
    /// Pixels, through renderer and detection.
    Rendered,
}

/// What the command line leaves open.
#[derive(Clone, Copy)]
pub struct Options<'a> {
    /// The camera.
    pub camera: CameraKind,
    /// Number of random starts of `convergence`.
    pub count: usize,
    /// Told what is being done.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

/// One experiment.
#[derive(Clone, Copy)]
pub struct Experiment {
    /// As on the command line.
    pub name: &'static str,
    /// What it shows, in a sentence.
    pub about: &'static str,
    /// Whether it can use rendered images.
    pub renders: bool,
    run: fn(&Options<'_>) -> Result<Findings, ExperimentError>,
}

/// Every experiment, in the order of the textbook.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "figures-10-2",
        about: "Figs. 10.1 to 10.4 from a rendered scene: histogram, binary image, contours by Roberts and Sobel, principal axes.",
        renders: false,
        run: |_| image_figures::figures(),
    },
    Experiment {
        name: "example-10-1",
        about: "Pose of a planar square from the homography of its four points.",
        renders: false,
        run: |_| examples::example_10_1(),
    },
    Experiment {
        name: "example-10-2",
        about: "The null space of a point's interaction matrix: four motions of the camera that leave the point where it is.",
        renders: false,
        run: |_| point_examples::example_10_2(),
    },
    Experiment {
        name: "example-10-4",
        about: "Pose of the square by integration with the pseudo-inverse of the interaction matrix; three points leave two poses, or four.",
        renders: false,
        run: |_| point_examples::example_10_4(),
    },
    Experiment {
        name: "example-10-5",
        about: "Planar homography between two views, and the two displacements of the camera that it leaves.",
        renders: false,
        run: |_| examples::example_10_5(),
    },
    Experiment {
        name: "example-10-6",
        about: "Hybrid visual servoing on the task of Sect. 10.9: by a homography of the form of Example 10.5, and by any.",
        renders: true,
        run: comparison::example_10_6,
    },
    Experiment {
        name: "comparison",
        about: "Schemes A, B, C, D and hybrid on the task of Sect. 10.9, in one set.",
        renders: true,
        run: comparison::comparison,
    },
    Experiment {
        name: "look-and-move",
        about: "One look and one motion (Sect. 10.1.1) beside schemes B and D, with a mount and a joint that are not as described.",
        renders: false,
        run: look_and_move::look_and_move,
    },
    Experiment {
        name: "problem-10-4",
        about: "Pose of the object from the two points P1 and P2, four coordinates.",
        renders: false,
        run: |_| examples::problem_10_4(),
    },
    Experiment {
        name: "problem-10-5",
        about: "The same from the parameters of the line segment P1 P2.",
        renders: false,
        run: |_| examples::problem_10_5(),
    },
    Experiment {
        name: "problem-10-8",
        about: "Scheme A with the pose estimated from the line segment P1 P2.",
        renders: true,
        run: |options| comparison::segment_problem(options, Scheme::A),
    },
    Experiment {
        name: "problem-10-9",
        about: "Scheme B with the pose estimated from the line segment P1 P2.",
        renders: true,
        run: |options| comparison::segment_problem(options, Scheme::B),
    },
    Experiment {
        name: "problem-10-10",
        about: "Scheme C on the parameters of the line segment P1 P2, with gains of its own.",
        renders: true,
        run: |options| comparison::segment_problem(options, Scheme::C),
    },
    Experiment {
        name: "problem-10-11",
        about: "Scheme D on the parameters of the line segment P1 P2.",
        renders: true,
        run: |options| comparison::segment_problem(options, Scheme::D),
    },
    Experiment {
        name: "retreat",
        about: "The camera's retreat under scheme D for rotations about the optical axis, with z_d and with the true depth.",
        renders: false,
        run: retreat::retreat,
    },
    Experiment {
        name: "calibration-sensitivity",
        about: "What errors of focal length and principal point cost each scheme, set-point computed or taught.",
        renders: false,
        run: calibration::sensitivity,
    },
    Experiment {
        name: "stability",
        about: "The stability condition of scheme D against errors of depth, lens and mount, and whether errors then die out.",
        renders: false,
        run: stability::stability,
    },
    Experiment {
        name: "gain-delay",
        about: "Largest stable gain and best settling of schemes B and D against the delay, held and predicted.",
        renders: false,
        run: gain_delay::gain_delay,
    },
    Experiment {
        name: "gain-system",
        about: "Settling against the gain in the whole system, with rendered images and the arm's limits: frame, tick, predict.",
        renders: true,
        run: system_gain::system_gain,
    },
    Experiment {
        name: "moving-target",
        about: "Steady feature error behind a conveyor and a pendulum, with feed-forward of the estimated motion and without.",
        renders: true,
        run: moving_target::moving_target,
    },
    Experiment {
        name: "convergence",
        about: "Random starts in six degrees of freedom: the share that each scheme brings home, and why the others fail.",
        renders: false,
        run: convergence::convergence,
    },
];

/// The experiment of this name.
///
/// # Errors
/// [`ExperimentError::Unknown`] with the names that there are.
pub fn find(name: &str) -> Result<&'static Experiment, ExperimentError> {
    EXPERIMENTS.iter().find(|e| e.name == name).ok_or_else(|| ExperimentError::Unknown {
        name: name.into(),
        names: EXPERIMENTS.iter().map(|e| e.name).collect::<Vec<_>>().join(", "),
    })
}

impl Experiment {
    /// Computes everything.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn run(&self, options: &Options<'_>) -> Result<Findings, ExperimentError> {
        if options.camera == CameraKind::Rendered && !self.renders {
            let with: Vec<_> = EXPERIMENTS.iter().filter(|e| e.renders).map(|e| e.name).collect();
            return Err(ExperimentError::IdealOnly { experiment: self.name, with: with.join(", ") });
        }
        (self.run)(options)
    }
}

/// What was written, and what people want to know of it.
#[derive(Debug)]
pub struct Report {
    /// The experiment.
    pub name: &'static str,
    /// Its results in a few lines.
    pub lines: Vec<String>,
    /// Its files; or why they could not be written, which does not take the results away.
    pub files: Result<Vec<PathBuf>, ExperimentError>,
}

/// Runs the experiment `name` into `out`, or `all` of them into folders of their own under it, with an index page.
///
/// `all` leaves experiments that know only projected points on those, whatever `options.camera` says, and ends with the
/// first whose files cannot be written.
///
/// # Errors
/// [`ExperimentError`].
pub fn run(name: &str, out: &Path, options: &Options<'_>) -> Result<Vec<Report>, ExperimentError> {
    if name != "all" {
        let experiment = find(name)?;
        findings::make_folder(out)?; // before the work, not after it
        (options.progress)(&format!("{name}: {}", experiment.about));
        let findings = experiment.run(options)?;
        let files = findings.write(out, experiment.name, experiment.about);
        return Ok(vec![Report { name: experiment.name, lines: findings.lines, files }]);
    }
    findings::make_folder(out)?;
    (options.progress)(&forewarning(options, out));
    let (mut done, mut reports) = (Vec::new(), Vec::new());
    for (i, experiment) in EXPERIMENTS.iter().enumerate() {
        (options.progress)(&format!(
            "{}/{} {}: {}",
            i + 1,
            EXPERIMENTS.len(),
            experiment.name,
            experiment.about
        ));
        let camera = if experiment.renders { options.camera } else { CameraKind::Ideal };
        let findings = experiment.run(&Options { camera, ..*options })?;
        let files = findings.write(&out.join(experiment.name), experiment.name, experiment.about);
        let failed = files.is_err();
        reports.push(Report { name: experiment.name, lines: findings.lines.clone(), files });
        if failed {
            return Ok(reports);
        }
        done.push((experiment.name, experiment.about, findings));
    }
    let index = out.join(findings::PAGE);
    let written = findings::write_file(&index, findings::index_page(&done));
    reports.push(Report { name: "all", lines: Vec::new(), files: written.map(|()| vec![index]) });
    Ok(reports)
}

/// Work of all experiments but `convergence`, and of each of its starts, seconds of one core; their files, MB. As measured, to be announced before the start.
const CORE_S: f64 = 29.0;
const CORE_S_A_START: f64 = 0.0062;
const FILES_MB: f64 = 36.0;

/// How long all experiments take, and how large they become.
fn forewarning(options: &Options<'_>, out: &Path) -> String {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let seconds = (CORE_S + CORE_S_A_START * options.count as f64) / cores as f64;
    // Chosen by hand: minutes are easier to read from here on.
    let time = if seconds < 90.0 { format!("{seconds:.0} s") } else { format!("{:.0} min", seconds / 60.0) };
    let longer = if options.camera == CameraKind::Rendered { ", longer with rendered images" } else { "" };
    format!(
        "all: {} experiments, about {time} on {cores} core(s){longer}; {FILES_MB:.0} MB in {}; `convergence` runs {} starts (--count)",
        EXPERIMENTS.len(),
        out.display(),
        options.count,
    )
}

/// All experiments in lines, for people.
#[must_use]
pub fn list() -> String {
    let longest = EXPERIMENTS.iter().map(|e| e.name.len()).max().unwrap_or(0);
    EXPERIMENTS.iter().map(|e| format!("{:longest$}  {}\n", e.name, e.about)).collect()
}
