//! The arguments of `vservo calibrate camera` and `calibrate stereo`.
#![allow(rustdoc::broken_intra_doc_links)] // the words of commands have brackets

use crate::calibration::camera::CalibrationSettings;
use crate::camera_model::LensModel;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Which model of a lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum LensModelArgument {
    /// k1 k2 p1 p2 k3: usual lenses
    PlumbBob,
    /// k1 k2 p1 p2 k3 k4 k5 k6: wide lenses, where many corners reach the image's corners
    RationalPolynomial,
    /// k1 k2 k3 k4 of the angle (Kannala and Brandt, OpenCV's fisheye): up to 89 degrees from the axis
    Equidistant,
}

/// What happens to coefficients of the highest orders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OddCoefficients {
    /// Fixed at zero where the corners do not tell them from that
    Auto,
    /// Estimated, as long as the lens does not fold
    Free,
}

/// The board and the model: what calibrations of one camera and of two share.
#[derive(Debug, Args)]
pub struct BoardArguments {
    /// The board: chessboard:COLSxROWS:SQUARE_M (inner corners)
    #[arg(long, value_name = "KIND")]
    pub target: String,
    /// Model of the lens
    #[arg(long, value_enum, default_value = "plumb_bob")]
    pub model: LensModelArgument,
    /// k3 (plumb_bob), k4 and k3 (equidistant), k6, k3 and k5 (rational_polynomial)
    #[arg(long, value_enum, default_value = "auto", value_name = "WHICH")]
    pub high_orders: OddCoefficients,
    /// Pixels are square: fy = fx
    #[arg(long)]
    pub fix_aspect: bool,
    /// The principal point is the middle of the image
    #[arg(long)]
    pub fix_center: bool,
    /// The board may be bent: estimate a parabola along each of its sides
    #[arg(long)]
    pub warp: bool,
    /// Corners with errors beyond so many standard deviations are left out; inf keeps all
    #[arg(long, value_name = "SD", default_value_t = 5.0)]
    pub outlier_sd: f64,
    /// Depth at which uncertainties are stated, m; by default that of the boards
    #[arg(long, value_name = "M")]
    pub distance_m: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Write a page with errors, uncertainty, coverage and the next view
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

impl BoardArguments {
    /// As the calibration takes them.
    #[must_use]
    pub fn settings(&self) -> CalibrationSettings {
        let model = match self.model {
            LensModelArgument::PlumbBob => LensModel::PlumbBob,
            LensModelArgument::RationalPolynomial => LensModel::RationalPolynomial,
            LensModelArgument::Equidistant => LensModel::Equidistant,
        };
        let mut settings = CalibrationSettings::of(model);
        settings.freedom.fixed_aspect = self.fix_aspect;
        settings.freedom.fixed_center = self.fix_center;
        settings.drop_untold = self.high_orders == OddCoefficients::Auto;
        settings.warp = self.warp;
        settings.outlier_sd = self.outlier_sd;
        settings
    }
}

/// Arguments of `vservo calibrate camera`.
#[derive(Debug, Args)]
pub struct CalibrateCameraArguments {
    /// PNG, PNM or JPEG files of one size
    #[arg(required_unless_present = "live", conflicts_with = "live", value_name = "IMAGE")]
    pub images: Vec<PathBuf>,
    /// Take the images from a running camera process, where the board is held still and shows something new: its run file
    #[arg(long, value_name = "CONFIG")]
    pub live: Option<PathBuf>,
    /// Of --live: the instance
    #[arg(long, default_value = "default", value_name = "NAME", requires = "live")]
    pub instance: String,
    /// Of --live: how many images
    #[arg(long, default_value_t = 20, value_name = "COUNT", requires = "live", value_parser = clap::value_parser!(u16).range(4..=500))]
    pub views: u16,
    /// Board, model, what is told
    #[command(flatten)]
    pub board: BoardArguments,
    /// File to write: the calibration as ROS has it (camera_info, YAML)
    #[arg(long, value_name = "FILE.yaml")]
    pub out: PathBuf,
    /// Name of the camera in that file
    #[arg(long, default_value = "camera")]
    pub name: String,
}

/// Arguments of `vservo calibrate stereo`.
#[derive(Debug, Args)]
pub struct CalibrateStereoArguments {
    /// Images of the left camera, in the order of time: PNG, PNM or JPEG files of one size
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE")]
    pub left: Vec<PathBuf>,
    /// Images of the right camera, taken at the same instants, in the same order
    #[arg(long, required = true, num_args = 1.., value_name = "IMAGE")]
    pub right: Vec<PathBuf>,
    /// Board, model, what is told
    #[command(flatten)]
    pub board: BoardArguments,
    /// File to write: the pose between the cameras; beside it go the two calibrations as ROS has them (camera_info), whose names
    /// end in _left and _right
    #[arg(long, value_name = "FILE.yaml")]
    pub out: PathBuf,
}
