//! Where the camera sits on the arm, or beside it: extrinsic parameters (10.62), (10.63) without knowing where the board is.
//!
//! ```text
//!            arm                camera                           W          M            C looks at O, which rests in W
//!   W ── X_WM(q_i) ──► M ── X_MC = ? ──► C      eye in hand:     B, base    E, flange    board on the table
//!   └───── X_WO = ? ──► O ◄── X_CO,i ────┘      eye to hand:     E, flange  B, base      board on the flange
//! ```
//! Every view closes the loop `X_WM,i X_MC X_CO,i = X_WO` with the same two unknown poses. Between two views that is `A X = X B`
//! with the motion of M, `A = X_WM,j^-1 X_WM,i`, and that of the camera, `B = X_CO,j X_CO,i^-1`; for an eye beside the arm the
//! arm's poses come in inverted, and nothing else differs.
//!
//! ```text
//! corners ─► board poses ─► rotation axes: enough? ─► two closed forms ─► joint refinement ─► leave-one-out ─► verdict
//!            board_pose     observability             separate,           joint               leave_one_out    report
//!                                                     dual_quaternion
//! ```
//! Where the board's pose `X_WO` is known, every view tells the camera's pose by itself, (10.62), (10.63): `known_board` has their mean, from which
//! the joint refinement starts with the board held.
//!
//! SI units and radians inside; image errors in px.

mod board_pose;
mod calibrate;
mod dual_quaternion;
mod error;
mod extrinsics;
mod joint;
mod known_board;
mod leave_one_out;
mod observability;
mod poses_file;
mod quaternion_order;
mod report;
mod rows;
mod scatter;
mod separate;
mod settled;
mod tour;
mod verdict;
mod visp_pose;

pub use calibrate::{HandEyeSettings, calibrate_hand_eye};
pub use dual_quaternion::dual_quaternion_solution;
pub use error::HandEyeError;
pub use extrinsics::{camera_in_base, camera_in_effector};
pub use joint::{JointFit, JointSettings, RobotSd, refine_jointly};
pub use known_board::{BoardAsSeen, cameras_by_known_board};
pub use leave_one_out::{HeldOut, HeldOutView, leave_one_out};
pub use observability::{RotationSpread, rotation_spread};
pub use poses_file::{ArmPose, PosesFileError, read_poses};
pub use quaternion_order::fits_as_w_x_y_z;
pub use report::{AtDistance, HandEyeReport, ViewResidual};
pub use scatter::{ClosedFormCamera, LoopScatter, loop_scatter};
pub use separate::separate_solution;
pub use settled::{corner_speed_px_s, flange_speed_px_s, is_settled};
pub use tour::{TourCell, TourError, TourPlanner};
pub use visp_pose::read_visp_pose;

use crate::geometry::{Pose, Twist};
use nalgebra::{Point3, Vector2};

/// Most views of a calibration: leave-one-out fits all of them once for each, so that its time grows with the square. Chosen by
/// hand: far more than a tour has, and errors fall with the root alone.
pub const MAX_VIEWS: usize = 200;
/// Fewest views, because two motions about different axes are needed (Tsai and Lenz 1989); of a board whose pose is known one is enough.
pub const MIN_VIEWS: usize = 3;

/// Where the camera is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraMount {
    /// On the flange, M = E; the board rests in the base frame, W = B.
    EyeInHand,
    /// Beside the arm, M = B; the board is on the flange, W = E.
    EyeToHand,
}

impl CameraMount {
    /// Pose of the frame M that bears the camera in the frame W that bears the board, for a flange at `X_BE`.
    #[must_use]
    pub fn X_WM(self, X_BE: &Pose) -> Pose {
        match self {
            Self::EyeInHand => *X_BE,
            Self::EyeToHand => X_BE.inverse(),
        }
    }

    /// The other place.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::EyeInHand => Self::EyeToHand,
            Self::EyeToHand => Self::EyeInHand,
        }
    }

    /// The camera's pose in the notation of this place: `X_EC` or `X_BC`.
    #[must_use]
    pub fn camera_name(self) -> &'static str {
        match self {
            Self::EyeInHand => "X_EC",
            Self::EyeToHand => "X_BC",
        }
    }

    /// The board's: `X_BO` or `X_EO`.
    #[must_use]
    pub fn board_name(self) -> &'static str {
        match self {
            Self::EyeInHand => "X_BO",
            Self::EyeToHand => "X_EO",
        }
    }

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::EyeInHand => "in the hand",
            Self::EyeToHand => "beside the arm",
        }
    }

    /// What bears the camera, in words.
    #[must_use]
    pub fn bearer(self) -> &'static str {
        match self {
            Self::EyeInHand => "flange",
            Self::EyeToHand => "base",
        }
    }
}

/// A point of the board and where it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardCorner {
    /// Position on the board, m.
    pub p_O: Point3<f64>,
    /// Where it is seen, through the lens, px.
    pub px: Vector2<f64>,
    /// Standard deviation of each coordinate of `px`, px.
    pub sd_px: f64,
}

/// One image of the board, and where the arm was.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEyeView {
    /// What people call it: the file of the image.
    pub name: String,
    /// The flange in the base, as the robot says, at the stamp of the image.
    pub X_BE: Pose,
    /// Twist of the flange relative to the base, expressed in E, m/s and rad/s, where it is known.
    pub V_BE_E: Option<Twist>,
    /// What is seen of the board.
    pub corners: Vec<BoardCorner>,
}

impl HandEyeView {
    /// Refuses numbers that are none.
    fn check(&self) -> Result<(), HandEyeError> {
        let bad = |what| HandEyeError::NotFinite { view: self.name.clone(), what };
        let X = &self.X_BE;
        if !X.translation.vector.iter().chain(X.rotation.coords.iter()).all(|x| x.is_finite()) {
            return Err(bad("the robot's pose"));
        }
        if !self.V_BE_E.iter().flat_map(|V| V.iter()).all(|x| x.is_finite()) {
            return Err(bad("the robot's velocity"));
        }
        for corner in &self.corners {
            if !corner.px.iter().chain(corner.p_O.coords.iter()).all(|x| x.is_finite()) {
                return Err(bad("a corner"));
            }
            if !(corner.sd_px > 0.0 && corner.sd_px.is_finite()) {
                return Err(HandEyeError::Setting { what: "the deviation of a corner" });
            }
        }
        Ok(())
    }
}

/// One turn of the loop without its unknowns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopSample {
    /// The frame that bears the camera, in that which bears the board.
    pub X_WM: Pose,
    /// The board in the camera.
    pub X_CO: Pose,
}

/// The motions `(A, B)` of M and of the camera between any two views; from the later one's frame to the earlier one's.
fn motions(samples: &[LoopSample]) -> impl Iterator<Item = (Pose, Pose)> {
    samples.iter().enumerate().flat_map(move |(i, first)| {
        samples
            .iter()
            .skip(i + 1)
            .map(move |second| (second.X_WM.inv_mul(&first.X_WM), second.X_CO * first.X_CO.inverse()))
    })
}

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
