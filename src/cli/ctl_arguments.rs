//! The arguments of `vservo ctl`.

use crate::client::WaitFor;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::str::FromStr;

/// Arguments of `vservo ctl`.
#[derive(Debug, Args)]
pub struct CtlArguments {
    /// What to do
    #[command(subcommand)]
    pub what: CtlCommand,
    /// Which run, and how it answers
    #[command(flatten)]
    pub common: CtlCommon,
}

/// Which run is asked, and how it answers.
#[derive(Debug, Args)]
pub struct CtlCommon {
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default", global = true)]
    pub instance: String,
    /// Print the answer as JSON
    #[arg(long, global = true)]
    pub json: bool,
    /// How long to wait for the answer, s (5 where it is left out); of `wait`, how long at most (30)
    #[arg(long, value_name = "S", global = true)]
    pub timeout_s: Option<f64>,
}

/// Requests to control.
#[derive(Debug, Subcommand)]
pub enum CtlCommand {
    /// Say how it stands
    Status,
    /// Go for the goal
    Start,
    /// Stand until the next start
    Hold,
    /// Make what the camera sees the goal; the arm comes to rest, and stands
    Teach {
        /// Wait until it is taught, and write it to this file with the arm's posture, for `goal`, `goto` and servo.set_point.file
        #[arg(long, value_name = "FILE.toml")]
        save: Option<PathBuf>,
    },
    /// Set another goal, now: one that the run file names, of a file of `vservo teach`, or the pose of the target in the camera at the goal
    Goal {
        /// Name in `[goals]` of the run file, or a file of `vservo teach` or `vservo ctl teach --save`
        #[arg(
            value_name = "NAME|FILE",
            required_unless_present_any = ["position_m", "target"],
            conflicts_with = "position_m"
        )]
        file: Option<PathBuf>,
        /// Position of the target in the camera, m
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
        position_m: Option<FixedNumbers<3>>,
        /// Its roll, pitch, yaw, deg
        #[arg(
            long,
            value_name = "R,P,Y",
            allow_hyphen_values = true,
            requires = "position_m",
            conflicts_with = "rotation_xyzw"
        )]
        rotation_rpy_deg: Option<FixedNumbers<3>>,
        /// Its rotation as a unit quaternion
        #[arg(long, value_name = "X,Y,Z,W", allow_hyphen_values = true, requires = "position_m")]
        rotation_xyzw: Option<FixedNumbers<4>>,
        /// Of which target it is: a name in `[targets]` of the run file, or `target`; alone: the last goal of that one
        #[arg(long, value_name = "NAME")]
        target: Option<String>,
    },
    /// Look for another target from now on, with its last goal; before the first one that is servo.desired
    Target {
        /// Name in `[targets]` of the run file; `target` is that of `[target]`
        name: String,
    },
    /// Move the arm to a posture along a limited path, and hold it
    Goto {
        /// Name in `[postures]` of the run file, or a file of `vservo ctl teach --save`: the posture in which the goal was taught
        #[arg(value_name = "NAME|FILE", required_unless_present = "q", conflicts_with = "q")]
        file: Option<PathBuf>,
        /// Joint positions, rad or m
        #[arg(long, value_name = "Q1,Q2,...", allow_hyphen_values = true)]
        q: Option<NumberList>,
    },
    /// Move the arm by a little from where it is, and hold it: joints, or the camera in its own frame
    Jog {
        /// Displacements of the joints, rad or m
        #[arg(
            long,
            value_name = "DQ1,DQ2,...",
            allow_hyphen_values = true,
            required_unless_present_any = ["position_m", "rotation_rpy_deg"],
            conflicts_with_all = ["position_m", "rotation_rpy_deg"]
        )]
        q: Option<NumberList>,
        /// Displacement of the camera, m
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
        position_m: Option<FixedNumbers<3>>,
        /// Rotation of the camera: roll, pitch, yaw, deg
        #[arg(long, value_name = "R,P,Y", allow_hyphen_values = true)]
        rotation_rpy_deg: Option<FixedNumbers<3>>,
    },
    /// Move the arm by a velocity for a time, and hold it then: joints, or the camera in its own frame. Programs send one after another (docs/library.md)
    Velocity {
        /// Velocities of the joints, rad/s or m/s
        #[arg(
            long,
            value_name = "QD1,QD2,...",
            allow_hyphen_values = true,
            required_unless_present = "camera",
            conflicts_with = "camera"
        )]
        q: Option<NumberList>,
        /// Twist of the camera: along x, y, z, m/s, and about x, y, z, rad/s
        #[arg(long, value_name = "VX,VY,VZ,WX,WY,WZ", allow_hyphen_values = true)]
        camera: Option<FixedNumbers<6>>,
        /// For how long, s: 0.01 to 1
        #[arg(long, value_name = "S", default_value_t = 0.5)]
        hold_s: f64,
    },
    /// Change a value in the running loop
    Set {
        /// Which
        what: SettingArgument,
        /// Its value, within the bounds that the run file has for it
        #[arg(allow_hyphen_values = true)]
        value: f64,
    },
    /// Forget the fault
    Reset,
    /// Stand, and be idle
    Stop {
        /// As by a fault: nothing starts before `reset`
        #[arg(long)]
        latched: bool,
    },
    /// Stop, and end the run
    Shutdown,
    /// Do the steps of a program (TOML), as `vservo do`
    Run {
        /// Program; `--timeout-s` is that of each answer: steps have their own
        program: PathBuf,
    },
    /// Wait until the goal is reached and held, the view is lost, there is a fault, or control is in a state: exit code 0; 5 when the time
    /// is over, or when it ends otherwise, with what is there instead
    Wait {
        /// converged, holding, fault, or state=NAME
        what: WaitFor,
    },
}

/// What may be set in a running loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SettingArgument {
    /// Gain of the law, 1/s (servo.gain_1_s)
    Gain,
    /// Feature error at which the goal counts as reached, px (goal.feature_error_px)
    Tolerance,
    /// Time for which the goal must be held, s (goal.hold_s)
    Hold,
}

/// FixedNumbers of an option, separated by commas.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberList(pub Vec<f64>);

impl FromStr for NumberList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |word: &str| word.trim().parse().map_err(|_| format!("`{}` is no number", word.trim()));
        text.split(',').map(number).collect::<Result<_, _>>().map(Self)
    }
}

/// So many numbers of an option, separated by commas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedNumbers<const M: usize>(pub [f64; M]);

impl<const M: usize> FromStr for FixedNumbers<M> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let NumberList(list) = text.parse()?;
        let found = list.len();
        list.try_into()
            .map(Self)
            .map_err(|_| format!("has {found} numbers, {M} are needed, separated by commas"))
    }
}
