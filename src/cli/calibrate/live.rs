//! `vservo calibrate camera --live`: images from a running camera process, taken where a board is held still and shows something new.

use super::super::CalibrateCameraArguments;
use super::CalibrateError;
use super::answer::Examined;
use super::boards::{Boards, corners_of};
use crate::calibration::camera::{BoardView, calibrate_camera};
use crate::config::Config;
use crate::detect::chessboard::ChessboardFinder;
use crate::imaging::ImageView;
use crate::ipc::{Instance, Role, Services};
use crate::messages::CameraId;
use crate::process::{StopFlag, frame_shape};
use crate::rt::{now, tell};
use crate::target::Chessboard;
use crate::time::SpanNs;
use nalgebra::Point3;
use std::path::Path;
use std::time::Duration;

/// The longest silence of the camera, and the longest time without a new view of the board. Chosen by hand: people need a while to move a board.
const LONGEST_SILENCE: SpanNs = SpanNs(10_000_000_000);
const LONGEST_SEARCH: SpanNs = SpanNs(120_000_000_000);
/// A board is held still whose corners move by less than this from one frame to the next, px.
const STILL_PX: f64 = 0.5;
/// A view is new when the mean distance of its corners from those of every other view exceeds this share of the image's width. Chosen by hand:
/// smaller differences would add little information.
const NEW_SHARE: f64 = 0.06;
/// Fewest views for a calibration. Chosen by hand: two views of a plane determine four intrinsic parameters, and
/// distortion and an uncertainty need more.
const FEWEST: usize = 4;

/// Takes images until there are `--views`, a stop is asked for, or nothing comes any more; `run_file` is that of the camera process.
pub(super) fn watch(
    run_file: &Path,
    arguments: &CalibrateCameraArguments,
    board: &Chessboard,
) -> Result<Boards, CalibrateError> {
    let instance: Instance =
        arguments.instance.parse().map_err(|e| CalibrateError::usage(format!("--instance: {e}")))?;
    let id = CameraId::FIRST;
    if !instance.is_running(Role::Camera(id)) {
        let message = format!(
            "no camera process runs in instance {instance}: start vservo camera, or name its instance by --instance"
        );
        return Err(CalibrateError::with_code(5, message));
    }
    let input = |e: &dyn std::fmt::Display| CalibrateError::input(e.to_string());
    let config = Config::load(Some(run_file), &[]).map_err(|e| input(&e))?;
    let services = Services::join(&instance).map_err(|e| input(&e))?;
    let frames = services.frame_receiver(id, frame_shape(&config)).map_err(|e| input(&e))?;
    let stop = StopFlag::on_signals().map_err(|e| input(&e))?;
    let i = config.camera.model.intrinsics();
    let mut session = LiveCapture::new(arguments, board, (i.width_px, i.height_px));
    tell(format_args!(
        "vservo: hold the board still before the camera, near and far, tilted, in every corner of the image; Ctrl-C ends with what there is"
    ));
    let (mut heard, mut taken) = (now(), now());
    while !stop.is_requested() && session.boards.views.len() < usize::from(arguments.views) {
        if now() - heard > LONGEST_SILENCE {
            tell(format_args!("vservo: no frame for {} s: the camera is away", LONGEST_SILENCE.as_s()));
            break;
        }
        if now() - taken > LONGEST_SEARCH {
            tell(format_args!("vservo: no new image of the board for {} s", LONGEST_SEARCH.as_s()));
            break;
        }
        frames.wait(Duration::from_millis(50)).map_err(|e| input(&e))?;
        let Some(frame) = frames.receive().map_err(|e| input(&e))? else { continue };
        heard = now();
        let header = frame.header();
        let image = ImageView::new(frame.pixels(), header.width_px as usize, header.height_px as usize);
        if image.is_ok_and(|image| session.look(&image, header.frame_id)) {
            taken = now();
            tell(format_args!("vservo: {}", session.progress()));
        }
    }
    Ok(session.boards)
}

struct LiveCapture<'a> {
    arguments: &'a CalibrateCameraArguments,
    board: &'a Chessboard,
    finder: ChessboardFinder,
    boards: Boards,
    /// What the last frame showed.
    before: BoardView,
}

impl<'a> LiveCapture<'a> {
    fn new(arguments: &'a CalibrateCameraArguments, board: &'a Chessboard, size: (u32, u32)) -> Self {
        let (width, height) = (size.0 as usize, size.1 as usize);
        let finder = ChessboardFinder::new(board.columns(), board.rows(), width, height);
        Self { arguments, board, finder, boards: Boards::of(size), before: BoardView::new() }
    }

    /// Whether a frame is taken: the board is in it, still, and not where it was seen before.
    fn look(&mut self, image: &ImageView<'_>, frame_id: u64) -> bool {
        let view = corners_of(&mut self.finder, image, self.board).unwrap_or_default();
        let before = std::mem::replace(&mut self.before, view);
        let view = &self.before;
        let is_still = distance_px(&before, view).is_some_and(|px| px < STILL_PX);
        let new_px = NEW_SHARE * f64::from(self.boards.size.0);
        let known = self.boards.views.iter().any(|old| distance_px(old, view).is_some_and(|px| px < new_px));
        if is_still && !known {
            self.boards.names.push(format!("frame {frame_id}"));
            self.boards.views.push(view.clone());
            self.boards.misses.push(None);
            self.boards.response.add(image, view, self.board.columns() as u32);
        }
        is_still && !known
    }

    /// How far it is: the verdict of what there is, and the next view.
    fn progress(&self) -> String {
        let count = self.boards.views.len();
        let so_far = format!("{count} of {} images", self.arguments.views);
        if count < FEWEST {
            return so_far;
        }
        let settings = self.arguments.board.settings();
        let Ok(calibration) = calibrate_camera(&self.boards.views, self.boards.size, &settings) else {
            return format!(
                "{so_far}; they do not tell the camera yet: tilt the board, by 30 degrees and more"
            );
        };
        let points: Vec<Point3<f64>> = self.board.points().iter().map(|p| p.p_O).collect();
        let depth_m = self.arguments.board.distance_m;
        let Some(Examined { calibration, coverage, verdict, next, .. }) =
            Examined::new(calibration, &self.boards, &points, depth_m)
        else {
            return so_far;
        };
        let next = next.map_or(String::new(), |next| format!("; next: {}", next.describe(self.boards.size)));
        let (rms_px, covered) = (calibration.rms_px, 100.0 * coverage.share());
        format!("{so_far}, rms {rms_px:.3} px, corners in {covered:.0} % of the image: {verdict}{next}")
    }
}

/// The mean distance of the corners that both views show, px; `None` where they share none.
fn distance_px(a: &BoardView, b: &BoardView) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0);
    for p in a {
        if let Some(q) = b.iter().find(|q| q.id == p.id) {
            sum += (p.px - q.px).norm();
            count += 1;
        }
    }
    (count > 0).then(|| sum / f64::from(count))
}
