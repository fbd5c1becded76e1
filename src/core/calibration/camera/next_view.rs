//! The image that is missing: among many poses of the board, the one that would lower the worst uncertainty most.
//!
//! An image of the board at a pose adds the information `U - W' V^-1 W` of its corners on the parameters (its own pose being
//! unknown too), whatever its noise will be; the camera's covariance with it is known before it is taken. Candidates: the board in the
//! middle of the image and towards its edges and corners, near and far, tilted to all sides and turned; of those the ones that lie
//! wholly in the image, more than a margin from its border.
//!
//! The numbers here were chosen by hand. The candidates' range is that of the views that people take, and the uncertainty that each would
//! leave is computed, so that a finer grid would only move the proposal a little.

use super::uncertainty::{carried, grid, worst_sd};
use super::{CameraCalibration, ProjectionUncertainty};
use crate::calibration::bundle::{
    BoardObservation, BundlePoint, BundleProblem, BundleState, BundleSums, Optics, covariance_of,
};
use crate::geometry::Pose;
use crate::pose::Loss;
use nalgebra::{DMatrix, Matrix2, Matrix2xX, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// Free border of an image, px.
const MARGIN_PX: f64 = 6.0;
/// Widths of the board, in widths of the image.
const SIZES: [f64; 4] = [0.3, 0.45, 0.65, 0.9];
/// Places of its middle, in half widths of the image, in each direction.
const PLACES: [f64; 7] = [-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];
/// Tilts, rad, to eight sides.
const TILTS: [f64; 3] = [0.0, 0.5, 0.85];

/// A pose of the board to take an image of.
#[derive(Debug, Clone, PartialEq)]
pub struct NextView {
    /// Pose of the board in the camera.
    pub X_CO: Pose,
    /// Its corners in the image, px, in the order of the points given.
    pub corners_px: Vec<Vector2<f64>>,
    /// The worst uncertainty in the image now, px.
    pub worst_now_px: f64,
    /// The same with the image, px.
    pub worst_then_px: f64,
}

impl NextView {
    /// Whether its corners reach over most of the image in one direction.
    fn fills(&self, width: f64, height: f64) -> bool {
        let start = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let (low, high) = self.corners_px.iter().fold(start, |(low, high), px| (low.inf(px), high.sup(px)));
        (high.x - low.x) / width > 0.7 || (high.y - low.y) / height > 0.7
    }

    /// Where to hold the board, in words.
    #[must_use]
    pub fn describe(&self, (width, height): (u32, u32)) -> String {
        let count = self.corners_px.len().max(1) as f64;
        let middle = self.corners_px.iter().fold(Vector2::zeros(), |sum, px| sum + px / count);
        let third = |x: f64, side: u32, names: [&'static str; 3]| {
            let at = x / f64::from(side);
            if at < 0.42 {
                names[0]
            } else if at > 0.58 {
                names[2]
            } else {
                names[1]
            }
        };
        let place = match (
            third(middle.y, height, ["top", "", "bottom"]),
            third(middle.x, width, ["left", "", "right"]),
        ) {
            ("", "") if self.fills(f64::from(width), f64::from(height)) => {
                "so that it fills the image".to_string()
            }
            ("", "") => "in the middle of the image".to_string(),
            ("", side) | (side, "") => format!("towards the {side} of the image"),
            (row, side) => format!("towards the {row} {side} of the image"),
        };
        let normal = self.X_CO.rotation * Vector3::z();
        let tilt = normal.z.clamp(-1.0, 1.0).acos().to_degrees();
        let tilted = if tilt < 8.0 {
            "facing the camera".to_string()
        } else {
            // the side of the board that is farther away: depth grows along -n_x / n_z
            let away = -normal.xy();
            let side = if away.x.abs() > 2.0 * away.y.abs() {
                if away.x > 0.0 { "right side" } else { "left side" }
            } else if away.y.abs() > 2.0 * away.x.abs() {
                if away.y > 0.0 { "bottom" } else { "top" }
            } else {
                match (away.x > 0.0, away.y > 0.0) {
                    (true, true) => "bottom right",
                    (true, false) => "top right",
                    (false, true) => "bottom left",
                    (false, false) => "top left",
                }
            };
            format!("tilted by {tilt:.0} degrees, its {side} away from the camera")
        };
        format!(
            "hold the board {place}, {:.2} m away, {tilted}: the worst uncertainty falls from {:.2} to {:.2} px",
            self.X_CO.translation.z, self.worst_now_px, self.worst_then_px
        )
    }
}

/// The best pose for the next image of a board with these corners (in z_O = 0, m), by the uncertainty at `uncertainty`'s depth.
/// `None` when no candidate lies in the image or helps.
#[must_use]
pub fn next_view(
    board: &[Point3<f64>],
    calibration: &CameraCalibration,
    uncertainty: &ProjectionUncertainty,
) -> Option<NextView> {
    let camera = &calibration.camera;
    let (low, high) = board
        .iter()
        .fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), p| {
            (low.inf(&p.coords.xy()), high.sup(&p.coords.xy()))
        });
    let (middle, extent) = ((low + high) * 0.5, high - low);
    let information = covariance_of(&calibration.covariance)?;
    let i = camera.intrinsics();
    let size = (i.width_px, i.height_px);
    let maps: Vec<Matrix2xX<f64>> = grid(size, 1.0, (8, 6)).filter_map(|px| uncertainty.map(&px)).collect();
    let worst = |covariance: &DMatrix<f64>| {
        maps.iter().map(|M| worst_sd(&carried(M, covariance))).fold(0.0, f64::max)
    };
    let worst_now_px = worst(&calibration.covariance);
    let problem = |points: Vec<BundlePoint>| BundleProblem {
        freedom: vec![calibration.unknown],
        warp: false,
        views: vec![vec![BoardObservation { camera: 0, points }]],
    };
    let weight = 1.0 / calibration.noise_px.max(1e-9);
    let points: Vec<BundlePoint> = (board.iter())
        .map(|p| BundlePoint {
            r: p.coords - middle.push(0.0),
            lift: Vector2::zeros(),
            px: Vector2::zeros(),
            whitening: Matrix2::identity() * weight,
        })
        .collect();
    let (problem, optics) = (problem(points), Optics::from(camera));
    let mut best: Option<(f64, Pose)> = None;
    for X in candidates(calibration, extent) {
        let points = problem.views.iter().flatten().flat_map(|s| &s.points);
        let inside = |p: &BundlePoint| {
            camera.project(&(X * Point3::from(p.r))).is_some_and(|px| camera.contains(&px, MARGIN_PX))
        };
        if !points.clone().all(inside) {
            continue;
        }
        let state =
            BundleState { optics: vec![optics], X_j0: Vec::new(), warp_m: Vector2::zeros(), poses: vec![X] };
        let added = BundleSums::at(&problem, &state, Loss::Squares).and_then(|sums| sums.information());
        let Some(covariance) = added.and_then(|added| covariance_of(&(&information + added))) else {
            continue;
        };
        let then = worst(&covariance);
        if best.as_ref().is_none_or(|(least, _)| then < *least) {
            best = Some((then, X));
        }
    }
    let (worst_then_px, X) = best.filter(|(then, _)| *then < worst_now_px)?;
    let X_CO = X * Translation3::from(-middle.push(0.0));
    let corners_px = board.iter().filter_map(|p| camera.project(&(X_CO * p))).collect();
    Some(NextView { X_CO, corners_px, worst_now_px, worst_then_px })
}

/// Poses of the board's middle.
fn candidates(calibration: &CameraCalibration, extent: Vector2<f64>) -> impl Iterator<Item = Pose> {
    let camera = calibration.camera;
    let i = *camera.intrinsics();
    let half = Vector2::new(f64::from(i.width_px), f64::from(i.height_px)) * 0.5;
    let places = PLACES.into_iter().flat_map(|x| PLACES.into_iter().map(move |y| Vector2::new(x, y)));
    places.flat_map(move |place| {
        let px = half + half.component_mul(&place) - Vector2::repeat(0.5);
        let ray = camera.normalized_of(&px);
        SIZES.into_iter().flat_map(move |size| {
            // the lens changes sizes, but who looks for a place to hold a board does not mind
            let depth_m = (extent.x * i.fx_px).max(extent.y * i.fy_px) / (size * f64::from(i.width_px));
            TILTS.into_iter().flat_map(move |tilt| {
                let sides = if tilt == 0.0 { 1 } else { 8 };
                (0..sides).flat_map(move |side| {
                    let turn = f64::from(side) * std::f64::consts::FRAC_PI_4;
                    let axis = Vector3::new(turn.cos(), turn.sin(), 0.0) * tilt;
                    [0.0, std::f64::consts::FRAC_PI_2].map(|about| {
                        let rotation = UnitQuaternion::from_scaled_axis(axis)
                            * UnitQuaternion::from_scaled_axis(Vector3::z() * about);
                        Pose::from_parts(Translation3::from(ray.push(1.0) * depth_m), rotation)
                    })
                })
            })
        })
    })
}
