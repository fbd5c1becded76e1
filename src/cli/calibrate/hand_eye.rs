//! `vservo calibrate hand-eye`: images of a board and the robot's poses -> where the camera sits. With `--drive` the (simulated) arm
//! takes the images itself.

mod answer;
mod drive;
mod poses;

use super::super::detect::{calibration, image_file};
use super::super::pose_tool::numbers_of;
use super::super::{check_writable, json, shown, write_result};
use super::CalibrateError;
use super::boards::believable_square;
use super::stage::stage;
use crate::calibration::hand_eye::{
    BoardCorner, CameraMount, HandEyeReport, HandEyeSettings, HandEyeView, MAX_VIEWS, RobotSd,
    calibrate_hand_eye, fits_as_w_x_y_z,
};
use crate::camera_model::CameraModel;
use crate::control::outcome::Outcome;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::input::printable;
use crate::process::ProcessError;
use crate::rt::tell;
use crate::target::{Kind, Target};
use crate::vision::{Vision, VisionSettings};
use answer::{HandEyeAnswer, UnusedImage};
use clap::Args;
use nalgebra::{Translation3, UnitQuaternion};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Lens and board may be so far from their description: what they are worth is found out here, so that no corner is left out for it, px.
const MODEL_SD_PX: f64 = 2.0;
/// Smallest standard deviation of a corner, px. Chosen by hand: a smaller one would let a few corners dominate the weighted fit.
const MIN_SD_PX: f64 = 0.01;

/// Arguments of `vservo calibrate hand-eye`.
#[derive(Debug, Args)]
pub struct HandEyeArguments {
    /// PNG, PNM or JPEG files, each taken with the arm at rest in a pose of its own
    #[arg(required_unless_present = "drive", conflicts_with = "drive", value_name = "IMAGE")]
    pub images: Vec<PathBuf>,
    /// The robot's poses: one CSV table (image,x_m,y_m,z_m,qx,qy,qz,qw), or a file of ViSP (YAML) for each image, in their order
    #[arg(long, required_unless_present = "drive", conflicts_with = "drive", num_args = 1.., value_name = "FILE")]
    pub poses: Vec<PathBuf>,
    /// Calibration file of ROS (YAML)
    #[arg(long, required_unless_present = "drive", conflicts_with = "drive", value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// What is seen: chessboard:COLSxROWS:SQUARE_M (inner corners), or any other kind that `vservo detect` takes
    #[arg(long, required_unless_present = "drive", conflicts_with = "drive", value_name = "KIND")]
    pub target: Option<String>,
    /// Let the simulated arm of this run file (TOML; the embedded default where it is left out) visit views of its target by itself
    #[arg(long, value_name = "CONFIG", num_args = 0..=1)]
    pub drive: Option<Option<PathBuf>>,
    /// --drive: change one value of the run file; may be repeated
    #[arg(long, value_name = "key.path=value", requires = "drive")]
    pub set: Vec<String>,
    /// The camera is fixed beside the arm, and the board on the flange
    #[arg(long, conflicts_with = "drive")]
    pub eye_to_hand: bool,
    /// Standard deviation of the robot's positions along each axis, mm
    #[arg(long, value_name = "MM", default_value_t = 0.3)]
    pub robot_sd_mm: f64,
    /// Standard deviation of the robot's rotations about each axis, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.05)]
    pub robot_sd_deg: f64,
    /// Where the board rests, where that is known: in the base frame, or on the flange with --eye-to-hand, m, and how it is turned, deg. One view
    /// is enough then
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW", allow_hyphen_values = true)]
    pub board_pose: Option<String>,
    /// Find the time between the stamps of robot and camera too: the table states velocities
    #[arg(long)]
    pub time_offset: bool,
    /// Write the lines for the run file to this file
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Write a page with errors, corrections of the robot's poses and where the camera was
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

impl HandEyeArguments {
    fn settings(&self) -> Result<HandEyeSettings, CalibrateError> {
        let place = if self.eye_to_hand { CameraMount::EyeToHand } else { CameraMount::EyeInHand };
        let robot =
            RobotSd { rotation_rad: self.robot_sd_deg.to_radians(), translation_m: self.robot_sd_mm * 1e-3 };
        let X_WO = self.board_pose.as_deref().map(board_pose).transpose()?;
        Ok(HandEyeSettings { place, robot, time_offset: self.time_offset, X_WO })
    }

    fn check(&self) -> Result<(), CalibrateError> {
        if self.images.len() > MAX_VIEWS {
            let count = self.images.len();
            return Err(CalibrateError::with_code(
                2,
                format!("{count} images are given, at most {MAX_VIEWS} are taken"),
            ));
        }
        for (name, value) in [("--robot-sd-mm", self.robot_sd_mm), ("--robot-sd-deg", self.robot_sd_deg)] {
            if !(1e-6..=100.0).contains(&value) {
                return Err(CalibrateError::with_code(
                    2,
                    format!("{name} {value}: must be from 0.000001 to 100"),
                ));
            }
        }
        Ok(())
    }
}

pub(in super::super) fn hand_eye(arguments: &HandEyeArguments) -> Result<u8, ProcessError> {
    for path in [&arguments.out, &arguments.report].into_iter().flatten() {
        check_writable(path)?;
    }
    let answer = match &arguments.drive {
        Some(config) => {
            arguments.check().map_or_else(|r| Ok(Err(r)), |()| drive::driven(arguments, config.as_deref()))?
        }
        None => answer(arguments),
    };
    let answer = match answer {
        Ok(answer) => answer,
        Err(refusal) => return Ok(refusal.tell()),
    };
    let text = if arguments.json { json(&answer) } else { answer.text() };
    let told = if answer.is_contradicted() { Outcome::NotConverged.exit_code() } else { 0 };
    let mut exit_code = shown(&text, told);
    if let Some(path) = &arguments.out {
        exit_code = write_result(path, answer.to_toml(), exit_code);
    }
    if let Some(path) = &arguments.report {
        exit_code = write_result(path, answer.page(), exit_code);
    }
    Ok(exit_code)
}

fn answer(arguments: &HandEyeArguments) -> Result<HandEyeAnswer, CalibrateError> {
    arguments.check()?;
    let settings = arguments.settings()?;
    let (Some(word), Some(file)) = (&arguments.target, &arguments.camera) else {
        return Err(CalibrateError::with_code(2, "--target and --camera are needed"));
    };
    let kind: Kind = word.parse().map_err(|e| CalibrateError::with_code(2, format!("--target: {e}")))?;
    let target = one_look(kind)?;
    let camera = calibration(file).map_err(|e| CalibrateError::with_code(3, format!("--camera: {e}")))?;
    let poses =
        poses::of_images(&arguments.images, &arguments.poses).map_err(|e| CalibrateError::with_code(3, e))?;
    let mut finder = BoardFinder::new(camera, target);
    let (mut views, mut unused) = (Vec::new(), Vec::new());
    for (at, (path, arm)) in arguments.images.iter().zip(poses).enumerate() {
        let name = printable(&path.display().to_string());
        match stage("boards", || finder.corners(path))? {
            Ok(corners) => views.push(HandEyeView { name, X_BE: arm.X_BE, V_BE_E: arm.V_BE_E, corners }),
            Err(reason) => {
                tell(format_args!("vservo: {name}: left out: {reason}"));
                unused.push(UnusedImage { at, name, reason });
            }
        }
    }
    let report = stage("fit", || calibrate_hand_eye(&views, &camera, &settings));
    let fits =
        |report: &Result<HandEyeReport, _>| report.as_ref().is_ok_and(|report| !report.is_contradicted());
    let (place, remedy) = match settings.place {
        CameraMount::EyeInHand => (
            CameraMount::EyeToHand,
            "add --eye-to-hand; or, if it is in the hand, the poses are those of the base in the flange: invert them",
        ),
        CameraMount::EyeToHand => (CameraMount::EyeInHand, "leave --eye-to-hand out"),
    };
    // One view of a board whose pose is known fits whatever is said of it.
    let tells = views.len() > 1;
    if tells
        && !fits(&report)
        && fits(&calibrate_hand_eye(&views, &camera, &HandEyeSettings { place, ..settings }))
    {
        let message =
            format!("the poses belong to the images where the camera is {}: {remedy}", place.words());
        return Err(CalibrateError::with_code(Outcome::NotConverged.exit_code(), message));
    }
    if tells && fits_as_w_x_y_z(&views, &camera, &settings, &report) {
        return Err(CalibrateError::with_code(
            Outcome::NotConverged.exit_code(),
            "--poses: the poses do not belong to the images as they are written, but do where the four numbers of each rotation are \
             w x y z: write them in the order x y z w, in the columns qx,qy,qz,qw",
        ));
    }
    let report =
        report.map_err(|e| CalibrateError::with_code(Outcome::NotConverged.exit_code(), e.to_string()))?;
    Ok(HandEyeAnswer::new(report, &views, unused))
}

/// The pose of `--board-pose`.
fn board_pose(text: &str) -> Result<Pose, CalibrateError> {
    let refused = |what: &str| {
        CalibrateError::usage(format!(
            "--board-pose {text}: {what}: X,Y,Z in m, and how it is turned, ROLL,PITCH,YAW in deg"
        ))
    };
    let [x, y, z, angles @ ..] = numbers_of::<6>(text).ok_or_else(|| refused("is no list of six numbers"))?;
    // The ranges of the run file's keys, which must take what is found with these numbers.
    if [x, y, z].iter().any(|m| !(m.abs() <= 100.0)) || angles.iter().any(|a| !(a.abs() <= 361.0)) {
        return Err(refused("is out of range, allowed are 100 m and 361 deg"));
    }
    let [roll, pitch, yaw] = angles.map(f64::to_radians);
    Ok(Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

/// The target, if its points can be identified in a single image.
fn one_look(kind: Kind) -> Result<Target, CalibrateError> {
    let refuse = |what: &str| Err(CalibrateError::with_code(2, format!("--target: {what}")));
    if kind.any_tag {
        return refuse("name one tag by its id");
    }
    if kind.target.symmetry().turns > 1 {
        return refuse(
            "looks the same when it is turned, so that its points cannot be told apart from image to image: take a board with \
             an even number of inner corners one way and an odd number the other, such as 9x6",
        );
    }
    if kind.target.points().len() < 4 {
        return refuse("has fewer than four points");
    }
    if let Target::Chessboard(board) = &kind.target {
        believable_square(board)?;
    }
    Ok(kind.target)
}

/// Finds the board in images of one camera.
struct BoardFinder {
    camera: CameraModel,
    vision: Vision,
    places: BTreeMap<u32, nalgebra::Point3<f64>>,
}

impl BoardFinder {
    fn new(camera: CameraModel, target: Target) -> Self {
        let places = target.points().iter().map(|point| (point.id, point.p_O)).collect();
        let settings = VisionSettings { model_sd_px: MODEL_SD_PX, track: false, ..VisionSettings::default() };
        Self { camera, vision: Vision::new(camera, target, settings), places }
    }

    /// What is seen of the board in an image file; the reason where nothing is.
    fn corners(&mut self, path: &Path) -> Result<Result<Vec<BoardCorner>, String>, CalibrateError> {
        let named = |what: String| CalibrateError::with_code(3, format!("{}: {what}", path.display()));
        let image = image_file::load(path).map_err(named)?;
        let (width, height) = image.dimensions();
        let i = self.camera.intrinsics();
        if (i.width_px, i.height_px) != (width, height) {
            let (w, h) = (i.width_px, i.height_px);
            return Err(named(format!("is {width}x{height} px, the camera of --camera {w}x{h}")));
        }
        let view = ImageView::new(image.as_raw(), width as usize, height as usize)
            .map_err(|e| named(e.to_string()))?;
        let still = match self.vision.process_image(&view) {
            Ok(still) => still,
            Err(status) => return Ok(Err(status.as_str().into())),
        };
        let corners: Vec<_> = still
            .found
            .iter()
            .zip(still.px)
            .filter_map(|(found, px)| {
                let sd_px = found.sd_px.max(MIN_SD_PX);
                Some(BoardCorner { p_O: *self.places.get(&found.id)?, px: *px, sd_px })
            })
            .collect();
        Ok(if corners.len() < 4 { Err("fewer than four points are seen".into()) } else { Ok(corners) })
    }
}
