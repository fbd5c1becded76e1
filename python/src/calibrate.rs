//! Cameras from images of a board: lens, stereo pair, mount on the arm.

use crate::arrays::{grey, homogeneous, matrix};
use crate::camera::{Camera, lens_model};
use crate::goal::pose;
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vservo_cores::calibration::camera::{
    BoardPoint, BoardView, CalibrationSettings, CameraCalibration, calibrate_camera,
};
use vservo_cores::calibration::hand_eye::{
    BoardCorner, CameraMount, HandEyeReport, HandEyeSettings, HandEyeView, RobotSd, calibrate_hand_eye,
};
use vservo_cores::calibration::stereo::{StereoCalibration, calibrate_stereo};
use vservo_cores::detect::chessboard::ChessboardFinder;
use vservo_cores::nalgebra::Matrix2;
use vservo_cores::target::{Chessboard, Kind, KindError, Target};

/// Grey images, uint8, (height, width) each.
type Images<'py> = Vec<PyReadonlyArray2<'py, u8>>;

fn wrong(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

fn chessboard(word: &str) -> PyResult<Chessboard> {
    match word.parse::<Kind>().map_err(|e: KindError| wrong(e))?.target {
        Target::Chessboard(board) => Ok(board),
        _ => Err(wrong(format!("`{word}`: give chessboard:COLSxROWS:SQUARE_M"))),
    }
}

/// The corners in each image, empty where there is no board, why there is none, and the size of all.
#[allow(clippy::type_complexity)] // one use
fn boards(
    images: &Images<'_>,
    board: &Chessboard,
) -> PyResult<(Vec<BoardView>, Vec<Option<String>>, (u32, u32))> {
    let first = images.first().ok_or_else(|| wrong("no images"))?;
    let (height, width) = first.as_array().dim();
    let mut finder = ChessboardFinder::new(board.columns(), board.rows(), width, height);
    let (mut views, mut misses) = (Vec::new(), Vec::new());
    for image in images {
        let pixels = grey(image)?;
        let mut found = Vec::new();
        match finder.search_or_why(&pixels.view()?, &mut found) {
            Ok(()) => {
                let places = board.points();
                let corners =
                    found.iter().zip(finder.covariances_px2()).filter_map(|(corner, (id, [xx, xy, yy]))| {
                        let p_O = places.get(id as usize).filter(|_| id == corner.id)?.p_O;
                        Some(BoardPoint {
                            id,
                            p_O,
                            px: corner.px,
                            covariance_px2: Matrix2::new(xx, xy, xy, yy),
                        })
                    });
                views.push(corners.collect());
                misses.push(None);
            }
            Err(miss) => {
                views.push(Vec::new());
                misses.push(Some(miss.to_string()));
            }
        }
    }
    Ok((views, misses, (width as u32, height as u32)))
}

/// A camera from images of a board, and how good it is.
#[pyclass(frozen)]
pub struct Calibration {
    found: CameraCalibration,
    misses: Vec<Option<String>>,
}

#[pymethods]
impl Calibration {
    /// The camera.
    #[getter]
    fn camera(&self) -> Camera {
        Camera { model: self.found.camera }
    }

    /// Root mean square distance of corners from where they are predicted, px: OpenCV's figure.
    #[getter]
    fn rms_px(&self) -> f64 {
        self.found.rms_px
    }

    /// Noise of a coordinate of a corner, one standard deviation, px.
    #[getter]
    fn noise_px(&self) -> f64 {
        self.found.noise_px
    }

    /// Standard deviations of the estimated parameters by their names, in px, coefficients without unit.
    #[getter]
    fn deviations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let deviations = PyDict::new(py);
        self.found.deviations().try_for_each(|(name, sd)| deviations.set_item(name, sd))?;
        Ok(deviations)
    }

    /// Why each image took no part: a list of str, None for those that did.
    #[getter]
    fn unused(&self) -> Vec<Option<String>> {
        let why = self.found.views.iter().zip(&self.misses);
        why.map(|(view, miss)| miss.clone().or_else(|| view.unused.as_ref().map(ToString::to_string)))
            .collect()
    }

    /// X_CO, the board in the camera at each image: a list of (4, 4), None where there is none.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Vec<Option<Bound<'py, PyArray2<f64>>>>> {
        self.found.views.iter().map(|view| view.X_CO.map(|X| homogeneous(py, &X)).transpose()).collect()
    }

    fn __repr__(&self) -> String {
        format!(
            "Calibration({} of {} images, rms {:.3} px)",
            self.found.views_used(),
            self.misses.len(),
            self.found.rms_px
        )
    }
}

/// calibrate(images, board, model="plumb_bob") -> Calibration
///
/// The lens of the camera that took `images` (grey, uint8, all (height, width)) of a board such as "chessboard:9x6:0.025", whose squares
/// are in m. `model`: "plumb_bob", "rational_polynomial" or "equidistant" (fisheye). What `vservo calibrate camera` does.
#[pyfunction]
#[pyo3(signature = (images, board, model = "plumb_bob"))]
pub fn calibrate(py: Python<'_>, images: Images<'_>, board: &str, model: &str) -> PyResult<Calibration> {
    let (views, misses, size) = boards(&images, &chessboard(board)?)?;
    let settings = CalibrationSettings::of(lens_model(model)?);
    let found = py.detach(|| calibrate_camera(&views, size, &settings)).map_err(wrong)?;
    Ok(Calibration { found, misses })
}

/// A stereo pair, and how good it is.
#[pyclass(frozen)]
pub struct Pair {
    found: StereoCalibration,
    misses: [Vec<Option<String>>; 2],
}

#[pymethods]
impl Pair {
    /// The left camera.
    #[getter]
    fn left(&self) -> Calibration {
        Calibration { found: self.found.left.clone(), misses: self.misses[0].clone() }
    }

    /// The right camera.
    #[getter]
    fn right(&self) -> Calibration {
        Calibration { found: self.found.right.clone(), misses: self.misses[1].clone() }
    }

    /// X_LR, the right camera in the left one (4, 4), m.
    #[getter]
    fn X_LR<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        homogeneous(py, &self.found.X_LR)
    }

    /// Its covariance (6, 6): of the position and of the rotation about it, both in the left camera's frame, m and rad.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, 6, self.found.covariance.as_slice())
    }

    /// Root mean square distance of corners from where they are predicted, px.
    #[getter]
    fn rms_px(&self) -> f64 {
        self.found.rms_px
    }

    fn __repr__(&self) -> String {
        let baseline_mm = self.found.X_LR.translation.vector.norm() * 1e3;
        format!("Pair(base line {baseline_mm:.2} mm, rms {:.3} px)", self.found.rms_px)
    }
}

/// stereo(left, right, board, model="plumb_bob") -> Pair
///
/// Both lenses of a stereo pair and the pose between the cameras, from as many images of each, taken at the same instants; the other
/// arguments are those of `calibrate`. The board must have an even number of corners one way and an odd number the other.
#[pyfunction]
#[pyo3(signature = (left, right, board, model = "plumb_bob"))]
pub fn stereo(
    py: Python<'_>,
    left: Images<'_>,
    right: Images<'_>,
    board: &str,
    model: &str,
) -> PyResult<Pair> {
    let kind = chessboard(board)?;
    if kind.symmetry().turns > 1 {
        return Err(wrong(format!(
            "`{board}` looks the same when it is turned: take an even number of corners one way and an odd number the other"
        )));
    }
    let (left_views, left_misses, left_size) = boards(&left, &kind)?;
    let (right_views, right_misses, right_size) = boards(&right, &kind)?;
    let settings = CalibrationSettings::of(lens_model(model)?);
    let found = py.detach(|| calibrate_stereo(&left_views, &right_views, (left_size, right_size), &settings));
    Ok(Pair { found: found.map_err(wrong)?, misses: [left_misses, right_misses] })
}

/// Where a camera sits on an arm or beside it, and how good that is.
#[pyclass(frozen)]
pub struct HandEye {
    found: HandEyeReport,
}

#[pymethods]
impl HandEye {
    /// The camera in the flange, X_EC, or in the base, X_BC (4, 4), m.
    #[getter]
    fn X<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        homogeneous(py, &self.found.X_MC())
    }

    /// Its covariance (6, 6), m and rad.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, 6, self.found.fit.covariance_X_MC.as_slice())
    }

    /// The board where it rests: in the base, X_BO, or on the flange, X_EO (4, 4), m.
    #[getter]
    fn board<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        homogeneous(py, &self.found.fit.X_WO)
    }

    /// Root mean square distance of corners from where they are with the robot's poses, px.
    #[getter]
    fn rms_px(&self) -> f64 {
        self.found.rms_px
    }

    /// Standard deviations of the robot's poses as the images tell them [m, rad] (2,); as stated where nothing contradicts that.
    #[getter]
    fn robot_sd<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &[self.found.robot_seen.translation_m, self.found.robot_seen.rotation_rad])
    }

    /// Whether images and robot contradict each other: then the result is not to be used.
    #[getter]
    fn contradicted(&self) -> bool {
        self.found.is_contradicted()
    }

    /// All of it in words.
    #[getter]
    fn verdict(&self) -> &str {
        &self.found.verdict
    }

    /// The lines of a run file that mount the camera so.
    fn to_toml(&self) -> String {
        self.found.to_toml()
    }

    fn __repr__(&self) -> String {
        format!("HandEye(rms {:.3} px)", self.found.rms_px)
    }
}

/// hand_eye(images, poses, camera, board, eye_to_hand=False, robot_sd_m=0.0003, robot_sd_rad=0.00087) -> HandEye
///
/// Where `camera` sits, from images (grey, uint8) of a board and as many poses X_BE of the flange in the base, (4, 4) each, m, each taken with
/// the arm at rest. `eye_to_hand`: the camera is beside the arm, and the board on the flange. `robot_sd_m` and `robot_sd_rad` are
/// the standard deviations of the robot's poses. Images without the board are left out.
#[pyfunction]
#[pyo3(signature = (images, poses, camera, board, eye_to_hand = false, robot_sd_m = 3e-4, robot_sd_rad = 0.05_f64.to_radians()))]
#[allow(clippy::too_many_arguments)] // they are those of Python
pub fn hand_eye(
    py: Python<'_>,
    images: Images<'_>,
    poses: Vec<Vec<Vec<f64>>>,
    camera: &Camera,
    board: &str,
    eye_to_hand: bool,
    robot_sd_m: f64,
    robot_sd_rad: f64,
) -> PyResult<HandEye> {
    if images.len() != poses.len() {
        return Err(wrong(format!(
            "there are {} images and {} poses: as many are needed",
            images.len(),
            poses.len()
        )));
    }
    let (found, _, (width, height)) = boards(&images, &chessboard(board)?)?;
    let i = camera.model.intrinsics();
    if (i.width_px, i.height_px) != (width, height) {
        return Err(wrong(format!(
            "the images are {width}x{height} px, the camera {}x{}",
            i.width_px, i.height_px
        )));
    }
    let mut views = Vec::new();
    for (at, (corners, X_BE)) in
        found.iter().zip(&poses).enumerate().filter(|(_, (corners, _))| !corners.is_empty())
    {
        let corner = |c: &BoardPoint| BoardCorner {
            p_O: c.p_O,
            px: c.px,
            sd_px: (0.5 * c.covariance_px2.trace()).sqrt().max(LEAST_SD_PX),
        };
        views.push(HandEyeView {
            name: format!("image {at}"),
            X_BE: pose(&format!("poses[{at}]"), X_BE)?,
            V_BE_E: None,
            corners: corners.iter().map(corner).collect(),
        });
    }
    let place = if eye_to_hand { CameraMount::EyeToHand } else { CameraMount::EyeInHand };
    let robot = RobotSd { rotation_rad: robot_sd_rad, translation_m: robot_sd_m };
    let settings = HandEyeSettings { place, robot, time_offset: false, X_WO: None };
    let found = py.detach(|| calibrate_hand_eye(&views, &camera.model, &settings)).map_err(wrong)?;
    Ok(HandEye { found })
}

/// Smallest standard deviation of a corner, px, as in `vservo calibrate hand-eye`: a smaller one would let a few corners decide the fit.
const LEAST_SD_PX: f64 = 0.01;
