//! Images of a board: files -> corners, each image with its name and, where there is no board, why.

use super::super::BoardArguments;
use super::super::detect::image_file;
use super::CalibrateError;
use crate::calibration::ResponseEvidence;
use crate::calibration::camera::{BoardPoint, BoardView};
use crate::detect::Detection;
use crate::detect::chessboard::ChessboardFinder;
use crate::imaging::ImageView;
use crate::input::printable;
use crate::rt::Stderr;
use crate::target::{Chessboard, Kind, Target};
use nalgebra::Matrix2;
use std::io::{IsTerminal, Write, stderr};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Most images of a camera. Chosen by hand: more take long and add little information, since the uncertainty falls with the square root.
const MAX_IMAGES: usize = 500;

/// Squares of boards that people hold before cameras, m: those of a microscope's slide to those of a wall. What lies beyond is a length
/// in another unit, by which every length of the result would be wrong.
const SQUARES_M: RangeInclusive<f64> = 1e-3..=1.0;

/// What the images of one camera show.
pub(super) struct Boards {
    /// Columns and rows of all of them.
    pub(super) size: (u32, u32),
    pub(super) names: Vec<String>,
    /// Corners; empty where there is no board.
    pub(super) views: Vec<BoardView>,
    /// Why there is none.
    pub(super) misses: Vec<Option<String>>,
    /// What their edges tell of the camera's response.
    pub(super) response: ResponseEvidence,
}

/// The board that is meant, and a depth that can be.
pub(super) fn board(arguments: &BoardArguments) -> Result<Chessboard, CalibrateError> {
    let word = &arguments.target;
    if let Some(depth_m) = arguments.distance_m.filter(|depth_m| !(1e-3..=1e6).contains(depth_m)) {
        return Err(CalibrateError::usage(format!(
            "--distance-m: {depth_m} m; give a depth from 0.001 to 1000000 m"
        )));
    }
    // The side of a square is judged below, in words of its own.
    let kind = Kind::of_any_size(word).map_err(|e| CalibrateError::usage(format!("--target: {e}")))?;
    match kind.target {
        Target::Chessboard(board) => {
            believable_square(&board)?;
            Ok(board)
        }
        _ => Err(CalibrateError::usage(format!(
            "--target: `{word}` has no corners to calibrate with: give chessboard:COLSxROWS:SQUARE_M"
        ))),
    }
}

/// Refuses squares of a size that no board has.
pub(super) fn believable_square(board: &Chessboard) -> Result<(), CalibrateError> {
    let side_m = board.square_m();
    if SQUARES_M.contains(&side_m) {
        return Ok(());
    }
    let meant_m = [side_m * 1e-3, side_m * 1e3, side_m * 1e-6].into_iter().find(|m| SQUARES_M.contains(m));
    let meant = meant_m.map_or_else(String::new, |m| {
        // whole micrometres divided, so that 25 reads 0.025
        let um = (m * 1e6).round();
        let (mm, m) = (um / 1e3, um / 1e6);
        format!(" (did you mean {mm} mm? that is chessboard:{}x{}:{m})", board.columns(), board.rows())
    });
    Err(CalibrateError::usage(format!(
        "--target: squares of {side_m} m: the side of a square is given in metres, from {} to {} m{meant}",
        SQUARES_M.start(),
        SQUARES_M.end()
    )))
}

impl Boards {
    /// No images yet, of this size.
    pub(super) fn of(size: (u32, u32)) -> Self {
        let (names, views, misses) = (Vec::new(), Vec::new(), Vec::new());
        Self { size, names, views, misses, response: ResponseEvidence::default() }
    }

    /// Reads the images and looks for the board in each.
    pub(super) fn find(paths: &[PathBuf], board: &Chessboard) -> Result<Self, CalibrateError> {
        if paths.len() > MAX_IMAGES {
            let message = format!("{} images, at most {MAX_IMAGES} are taken: choose", paths.len());
            return Err(CalibrateError::usage(message));
        }
        let mut boards = Self::of((0, 0));
        let mut finder: Option<ChessboardFinder> = None;
        let on_terminal = stderr().is_terminal();
        for (i, path) in paths.iter().enumerate() {
            let name = path.display().to_string();
            if on_terminal {
                let line = format!("\r\x1b[K{}/{} {}", i + 1, paths.len(), printable(&name));
                let _ = Stderr.write_all(line.as_bytes());
            }
            let image = image_file::load(path)
                .map_err(|reason| CalibrateError::input(format!("{name}: {reason}")))?;
            let size = image.dimensions();
            if i == 0 {
                boards.size = size;
            }
            let (width, height) = (size.0 as usize, size.1 as usize);
            let finder = finder
                .get_or_insert_with(|| ChessboardFinder::new(board.columns(), board.rows(), width, height));
            let (view, miss) = if size != boards.size {
                let (w, h) = boards.size;
                (Vec::new(), Some(format!("the image is {width}x{height} px, the first one {w}x{h}")))
            } else {
                match corners(finder, &image, board, &mut boards.response) {
                    Ok(view) => (view, None),
                    Err(why) => (Vec::new(), Some(why)),
                }
            };
            boards.names.push(name);
            boards.views.push(view);
            boards.misses.push(miss);
        }
        if on_terminal {
            let _ = Stderr.write_all(b"\r\x1b[K");
        }
        Ok(boards)
    }
}

fn corners(
    finder: &mut ChessboardFinder,
    image: &image::GrayImage,
    board: &Chessboard,
    response: &mut ResponseEvidence,
) -> Result<BoardView, String> {
    let (width, height) = image.dimensions();
    let view = ImageView::new(image.as_raw(), width as usize, height as usize)
        .map_err(|_| "the image has no pixels".to_string())?;
    let corners = corners_of(finder, &view, board)?;
    response.add(&view, &corners, board.columns() as u32);
    Ok(corners)
}

/// The corners of the board in an image; or why there are none.
pub(super) fn corners_of(
    finder: &mut ChessboardFinder,
    view: &ImageView<'_>,
    board: &Chessboard,
) -> Result<BoardView, String> {
    let mut found: Vec<Detection> = Vec::new();
    finder.search_or_why(view, &mut found).map_err(|miss| miss.to_string())?;
    let point = |(found, (id, [xx, xy, yy])): (&Detection, (u32, [f64; 3]))| {
        let p = board.points().get(id as usize).filter(|_| id == found.id)?;
        Some(BoardPoint { id, p_O: p.p_O, px: found.px, covariance_px2: Matrix2::new(xx, xy, xy, yy) })
    };
    Ok(found.iter().zip(finder.covariances_px2()).filter_map(point).collect())
}
