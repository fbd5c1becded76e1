//! The arguments of the commands that are tools of their own: `process`, `pose`, `stereo`.

use super::completion;
use clap::{Args, Subcommand, ValueEnum};
use clap_complete::engine::ArgValueCompleter;
use std::path::PathBuf;

/// Arguments of `vservo process`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: vservo process scene.png --steps \"gaussian:1.0 | threshold:otsu | regions | moments | axes\" --out steps/"
)]
pub struct ProcessArguments {
    /// PNG, PNM or JPEG file
    #[arg(required_unless_present = "list", value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// Steps from left to right, separated by |, each a name with its parameters (--list tells all)
    #[arg(long, value_name = "STEPS", required_unless_present = "list", add = ArgValueCompleter::new(completion::steps))]
    pub steps: Option<String>,
    /// Tell which steps there are, and what each takes and gives
    #[arg(long)]
    pub list: bool,
    /// Write the picture and the table of each step into this folder, and a page with all; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the numbers of all steps as JSON
    #[arg(long)]
    pub json: bool,
    /// Print the table of the last step that has one as CSV
    #[arg(long, conflicts_with = "json")]
    pub csv: bool,
}

/// Arguments of `vservo pose`.
#[derive(Debug, Args)]
#[command(
    after_help = "Columns: id,x_m,y_m,z_m with u_px,v_px (and sd_px) in pixels, or with X,Y (and sd) normalized.\n\
                  Example: vservo pose square.csv --method planar --sd 0.0005 --json"
)]
pub struct PoseArguments {
    /// CSV file of points: where they are on the object, and where they are seen
    #[arg(value_name = "POINTS.csv")]
    pub points: PathBuf,
    /// How the pose is found
    #[arg(long, value_enum)]
    pub method: PoseMethod,
    /// Calibration file of ROS (YAML), for points in pixels
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Standard deviation of each coordinate where the file states none: px, or normalized as the points are
    #[arg(long, value_name = "SD")]
    pub sd: Option<f64>,
    /// virtual_servoing: where it starts, m and the angles of Rz Ry Rx, rad; left out: in front of the points, not turned
    #[arg(long, value_name = "x,y,z,phi_z,phi_y,phi_x", allow_hyphen_values = true)]
    pub start: Option<String>,
    /// virtual_servoing: object and image plane are parallel, so that position and the angle about z are unknown alone (m = 4)
    #[arg(long)]
    pub parallel: bool,
    /// virtual_servoing: most steps
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub max_steps: u32,
    /// Pose of a camera beside the arm: tells the object in the base, (10.14)
    #[arg(long, value_name = "x,y,z,qx,qy,qz,qw", allow_hyphen_values = true)]
    pub camera_in_base: Option<String>,
    /// Pose of a camera on the arm: tells the object in the end-effector, (10.15)
    #[arg(long, value_name = "x,y,z,qx,qy,qz,qw", allow_hyphen_values = true)]
    pub camera_in_effector: Option<String>,
    /// Pose of the object, where it is known: tells the camera in the base, (10.62)
    #[arg(long, value_name = "x,y,z,qx,qy,qz,qw", allow_hyphen_values = true)]
    pub object_in_base: Option<String>,
    /// Pose of the end-effector beside that: tells the camera in the end-effector, (10.63)
    #[arg(long, value_name = "x,y,z,qx,qy,qz,qw", allow_hyphen_values = true, requires = "object_in_base")]
    pub effector_in_base: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Ways to a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum PoseMethod {
    /// Four or more points of the plane z = 0, by their homography: both solutions
    Planar,
    /// Six or more points in space, by the direct linear transformation
    Dlt,
    /// Three points: up to four solutions
    P3p,
    /// Three or more points: the global minimum and others that come close
    Pnp,
    /// Three or more points, by the motion of a virtual camera
    VirtualServoing,
}

impl PoseMethod {
    /// As on the command line.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Planar => "planar",
            Self::Dlt => "dlt",
            Self::P3p => "p3p",
            Self::Pnp => "pnp",
            Self::VirtualServoing => "virtual_servoing",
        }
    }
}

/// What `vservo stereo` does.
#[derive(Debug, Subcommand)]
pub enum StereoCommand {
    /// Search the conjugates of points of the left image along their epipolar lines in the right one
    Match(StereoMatchArguments),
    /// Turn both images, in thought, until their planes are parallel and conjugates lie in one row
    Rectify(StereoRectifyArguments),
    /// Positions of points from where both cameras see them
    Triangulate(StereoTriangulateArguments),
    /// Displacement of a camera from two images of points, or of a plane
    Motion(StereoMotionArguments),
}

/// Arguments of `vservo stereo match`.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: vservo stereo match left.png right.png --pair pair.yaml --nearest-m 0.3 --farthest-m 2 --overlay lines.png"
)]
pub struct StereoMatchArguments {
    /// Image of camera 1
    #[arg(value_name = "LEFT")]
    pub left: PathBuf,
    /// Image of camera 2
    #[arg(value_name = "RIGHT")]
    pub right: PathBuf,
    /// Both cameras, as `vservo calibrate stereo` writes them
    #[arg(long, value_name = "PAIR.yaml")]
    pub pair: PathBuf,
    /// Points of the left image, px; left out: its corners
    #[arg(long, value_name = "u,v;u,v;...")]
    pub points: Option<String>,
    /// Most corners that are searched for
    #[arg(long, value_name = "N", default_value_t = 50, conflicts_with = "points")]
    pub corners: usize,
    /// Least depth, m
    #[arg(long, value_name = "M", default_value_t = 0.1)]
    pub nearest_m: f64,
    /// Greatest depth, m
    #[arg(long, value_name = "M", default_value_t = f64::INFINITY)]
    pub farthest_m: f64,
    /// Write both images with points and epipolar lines
    #[arg(long, value_name = "OUT.png")]
    pub overlay: Option<PathBuf>,
    /// Print JSON in place of CSV
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `vservo stereo rectify`.
#[derive(Debug, Args)]
#[command(after_help = "Example: vservo stereo rectify left.png right.png --pair pair.yaml --out rectified/")]
pub struct StereoRectifyArguments {
    /// Image of camera 1
    #[arg(value_name = "LEFT")]
    pub left: PathBuf,
    /// Image of camera 2
    #[arg(value_name = "RIGHT")]
    pub right: PathBuf,
    /// Both cameras, as `vservo calibrate stereo` writes them
    #[arg(long, value_name = "PAIR.yaml")]
    pub pair: PathBuf,
    /// Folder for left.png, right.png, and rows.png with both; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `vservo stereo triangulate`.
#[derive(Debug, Args)]
#[command(after_help = "Columns: id,u1_px,v1_px,u2_px,v2_px in pixels, or id,X1,Y1,X2,Y2 normalized.\n\
                  Example: vservo stereo triangulate matches.csv --pair pair.yaml --sd 0.1")]
pub struct StereoTriangulateArguments {
    /// CSV file of conjugate points
    #[arg(value_name = "PAIRS.csv")]
    pub pairs: PathBuf,
    /// Both cameras, as `vservo calibrate stereo` writes them
    #[arg(long, value_name = "PAIR.yaml")]
    pub pair: PathBuf,
    /// How a position is found
    #[arg(long, value_enum, default_value = "optimal")]
    pub method: TriangulationMethod,
    /// Standard deviation of each coordinate, px or normalized as the points are; with it the positions' covariances are computed
    #[arg(long, value_name = "SD")]
    pub sd: Option<f64>,
    /// Print JSON in place of CSV
    #[arg(long)]
    pub json: bool,
}

/// Ways to a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum TriangulationMethod {
    /// Least error in both images
    Optimal,
    /// Linear, (10.47)-(10.50)
    Linear,
    /// In the rectified images, (10.51)-(10.53)
    Parallel,
}

/// Arguments of `vservo stereo motion`.
#[derive(Debug, Args)]
#[command(after_help = "Columns: id,u1_px,v1_px,u2_px,v2_px in pixels, or id,X1,Y1,X2,Y2 normalized.\n\
                  Examples: vservo stereo motion matches.csv --camera camera.yaml --method consensus --sd 0.2 --json\n\
                  vservo stereo motion run.mcap --at 0.2,1.5")]
pub struct StereoMotionArguments {
    /// CSV file of conjugate points; or the recording of a run with one moving camera, with --at
    #[arg(value_name = "PAIRS.csv|RUN.mcap", required_unless_present = "homography")]
    pub pairs: Option<PathBuf>,
    /// How the displacement is found; left out: consensus, and of a recording plane where the points of its target are in one
    #[arg(long, value_enum)]
    pub method: Option<MotionMethod>,
    /// Of a recording: the two instants, s after its first joint state; the measurements that are nearest count
    #[arg(long, value_name = "T1,T2", conflicts_with = "homography")]
    pub at: Option<String>,
    /// Length of the base line, where it is known: the structure is in m
    #[arg(long, value_name = "M", conflicts_with = "homography")]
    pub baseline_m: Option<f64>,
    /// Calibration file of ROS (YAML) of camera 1, and of camera 2 where that has none of its own
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Calibration file of camera 2
    #[arg(long, value_name = "FILE", requires = "camera")]
    pub camera_2: Option<PathBuf>,
    /// Standard deviation of each coordinate, px or normalized as the points are; with it covariances are computed
    #[arg(long, value_name = "SD")]
    pub sd: Option<f64>,
    /// plane: a homography in place of pairs, nine numbers by rows, (10.58)
    #[arg(long, value_name = "h11,h12,...", conflicts_with = "pairs", allow_hyphen_values = true)]
    pub homography: Option<String>,
    /// plane: pairs of camera 2 and a third view in the columns 2 and 1: tells which reading is true
    #[arg(long, value_name = "PAIRS.csv")]
    pub third: Option<PathBuf>,
    /// plane: the plane's normal in camera 2, roughly: tells which reading is true
    #[arg(long, value_name = "x,y,z", allow_hyphen_values = true)]
    pub normal: Option<String>,
    /// plane: the way of the camera in frame 1, roughly: tells which reading is true
    #[arg(long, value_name = "x,y,z", conflicts_with = "normal", allow_hyphen_values = true)]
    pub direction: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Ways to a displacement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum MotionMethod {
    /// The first five pairs: up to ten solutions; with further pairs each of least error over all, and ranked by all
    FivePoint,
    /// Eight pairs or more, linear, then of least error; in px without a camera the fundamental matrix
    EightPoint,
    /// Six pairs or more; some may be outliers
    Consensus,
    /// Four pairs or more of one plane: both readings
    Plane,
}

impl MotionMethod {
    /// As on the command line.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::FivePoint => "five_point",
            Self::EightPoint => "eight_point",
            Self::Consensus => "consensus",
            Self::Plane => "plane",
        }
    }
}
