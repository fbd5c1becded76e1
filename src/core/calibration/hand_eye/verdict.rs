//! The verdict on a hand-eye calibration in words: its accuracy, what contradicts it, and what would improve it.

use super::report::HandEyeReport;
use std::fmt::Write;

/// Rotation about the second axis below which the camera's position is called uncertain, degrees. Chosen by hand: the error of the position along
/// the first axis grows with the inverse of this angle.
const WEAK_DEG: f64 = 12.0;
/// A view is reported when it fits this many times worse than the median one, with itself left out. Chosen by hand, for a wording: by noise alone
/// the worst of a dozen views is not twice as bad.
const STANDS_OUT: f64 = 3.0;
/// Lens and board as their files say leave corners within this, px.
const LENS_PX: f64 = 0.15;
/// Number of views below which more are recommended. Chosen by hand, for a wording.
const FEW: usize = 8;

/// One sentence a line; the first is the sum of all.
pub(super) fn verdict(report: &HandEyeReport) -> String {
    let mut text = String::new();
    let at = &report.distance;
    let used = report.views.iter().filter(|view| view.used).count();
    let _ = writeln!(
        text,
        "{used} of {} views: the camera sits to {:.2} mm and {:.3} deg (one standard deviation); an object {:.2} m away is thus known to \
         {:.2} mm.",
        report.views.len(),
        at.camera_m * 1e3,
        at.rotation_rad.to_degrees(),
        at.distance_m,
        at.position_m * 1e3,
    );
    if let Some(held) = &report.held_out {
        let _ = writeln!(
            text,
            "A view that the calibration has not seen is predicted to {:.2} mm and {:.3} deg, {:.1} px in the image.",
            held.position_m * 1e3,
            held.rotation_rad.to_degrees(),
            held.rms_px
        );
    } else if report.known_board {
        let _ = writeln!(
            text,
            "One view: nothing checks the pose that the board is said to have, and what that is off by, the camera's is off by too; take more views."
        );
    } else {
        let _ = writeln!(text, "Nothing tells how well new views are predicted: take more views, 10 to 20.");
    }
    known_board(report, &mut text);
    if report.held_out.is_some() && used < FEW {
        let _ = writeln!(text, "Few views: its own uncertainty is uncertain; take 10 to 20.");
    }
    let stated = &report.robot_stated;
    let seen = report.board_as_seen.map_or(report.robot_seen, |board| board.robot_seen);
    if report.is_robot_contradicted() {
        let _ = writeln!(
            text,
            "Images and robot contradict each other: the robot's poses would have to be off by {:.2} mm and {:.3} deg along an axis, \
             where {:.2} mm and {:.3} deg are stated. Check that each pose belongs to its image and is that of the flange, the camera's \
             calibration, the size of the squares, {}and that the board and the camera were firmly fixed; of a robot that is no better, state so \
             (--robot-sd-mm, --robot-sd-deg).",
            seen.translation_m * 1e3,
            seen.rotation_rad.to_degrees(),
            stated.translation_m * 1e3,
            stated.rotation_rad.to_degrees(),
            if report.known_board { "the board's pose, " } else { "" }
        );
    }
    if report.model_sd_px > LENS_PX {
        let _ = writeln!(
            text,
            "Corners lie {:.2} px from where lens and board have them: the lens is not as its file says, or the board is not flat.",
            report.model_sd_px
        );
    }
    let weak = |across_rad: f64| !report.known_board && across_rad.to_degrees() < WEAK_DEG;
    if let Some(spread) = report.spread.as_ref().filter(|spread| weak(spread.across_rad)) {
        let (a, across_deg) = (spread.axis, spread.across_rad.to_degrees());
        let _ = writeln!(
            text,
            "The views turn by only {across_deg:.1} deg about axes other than ({:.2}, {:.2}, {:.2}) of the {}: along it the camera's \
             position is unsure; tilt the flange more.",
            a.x,
            a.y,
            a.z,
            report.place.bearer()
        );
    }
    for view in report.views.iter().filter(|view| !view.used) {
        let _ =
            writeln!(text, "{} was left out: {}.", view.name, view.reason.as_deref().unwrap_or("no reason"));
    }
    outlier(report, &mut text);
    if let Some(sd_s) = report.fit.offset_sd_s {
        let _ = writeln!(
            text,
            "{:.2} ms have to be added to the camera's stamps ({:.2} ms, one standard deviation): camera.stamp_offset_ms.",
            report.fit.offset_s * 1e3,
            sd_s * 1e3
        );
    }
    text.truncate(text.trim_end().len());
    text
}

/// What is said of a board whose pose was known.
fn known_board(report: &HandEyeReport, text: &mut String) {
    if !report.known_board {
        return;
    }
    let Some(board) = &report.board_as_seen else {
        if report.views.iter().filter(|view| view.used).count() > 1 {
            let _ = writeln!(
                text,
                "The board is held at the pose that it is said to have; the views turn too little to tell that pose by themselves."
            );
        }
        return;
    };
    let (mm, deg) = (board.position_m * 1e3, board.rotation_rad.to_degrees());
    let _ = if board.is_contradicted() {
        writeln!(
            text,
            "The views contradict the board's pose: by themselves they have it {mm:.2} mm and {deg:.3} deg from where it is said to be, {:.1} \
             times what they leave open. Measure it again, or leave --board-pose out.",
            board.times_sd()
        )
    } else {
        writeln!(
            text,
            "By themselves the views have the board {mm:.2} mm and {deg:.3} deg from where it is said to be, which is within what they leave open."
        )
    };
}

/// The view that stands out most when it is left out.
fn outlier(report: &HandEyeReport, text: &mut String) {
    let Some(held) = &report.held_out else { return };
    let mut sizes: Vec<f64> = held.views.iter().flatten().map(|view| view.rms_px).collect();
    sizes.sort_by(f64::total_cmp);
    let Some(middle) = sizes.get(sizes.len() / 2).copied() else { return };
    let used = report.views.iter().filter(|view| view.used);
    let worst = used.zip(&held.views).filter_map(|(view, held)| Some((&view.name, held.as_ref()?.rms_px)));
    let worst = worst.max_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((name, rms_px)) = worst.filter(|(_, rms_px)| *rms_px > STANDS_OUT * middle && *rms_px > 1.0) {
        let _ = writeln!(
            text,
            "{name} stands out: the others predict its corners to {rms_px:.1} px, {middle:.1} px is usual; look at it, or leave it out."
        );
    }
}
