//! Errors over time: in the image, and of the camera before its goal, as vision measures them.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::record::RunRecord;
use crate::input::number;
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::csv_table::CsvTable;
use crate::report::numbers::{counted, significant};
use crate::report::page::{figure, heading};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::collections::BTreeMap;

/// A pose from columns with this prefix; `None` where a number is missing.
pub(super) fn pose(table: &CsvTable, prefix: &str, row: usize) -> Option<Isometry3<f64>> {
    let mut v = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
        .map(|part| table.number(&format!("{prefix}{part}"), row));
    let norm = v.iter().skip(3).map(|q| q * q).sum::<f64>().sqrt();
    if !v.iter().all(|x| x.is_finite()) || !(norm > 0.5) {
        return None;
    }
    v.iter_mut().skip(3).for_each(|q| *q /= norm);
    let [x, y, z, i, j, k, w] = v;
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Some(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

/// The frame of the cell with this name.
pub(super) fn cell_pose(r: &RunRecord, name: &str) -> Option<Isometry3<f64>> {
    let row = (0..r.poses.rows()).find(|row| r.poses.word("frame", *row) == name)?;
    pose(&r.poses, "", row)
}

/// What the frames of the target of this number end with.
pub(super) fn frame_suffix(target: usize) -> String {
    if target == 0 { String::new() } else { target.to_string() }
}

/// The target of this number in its desired camera.
fn X_DO(r: &RunRecord, target: usize) -> Option<Isometry3<f64>> {
    let n = frame_suffix(target);
    // A folder of an earlier version tells it by both poses alone.
    let by_both = || {
        let X_BO = cell_pose(r, &format!("O{n}_end")).or_else(|| cell_pose(r, &format!("O{n}")))?;
        Some(cell_pose(r, &format!("D{n}"))?.inv_mul(&X_BO))
    };
    cell_pose(r, &format!("O{n}_in_D")).or_else(by_both)
}

/// Of each measured pose its target, time, s, and the desired camera in the camera.
fn desired_cameras(r: &RunRecord) -> Vec<(usize, f64, Isometry3<f64>)> {
    let mut goals = BTreeMap::new();
    let mut at = |row: usize| {
        let target = r.target_at(row);
        let X_DO = (*goals.entry(target).or_insert_with(|| X_DO(r, target)))?;
        let X_CD = pose(&r.measurements, "CO_", row)? * X_DO.inverse();
        Some((target, r.measurements.number("exposure_s", row), X_CD))
    };
    let all = (0..r.measurements.rows()).filter_map(&mut at);
    all.filter(|(_, t, X)| {
        t.is_finite() && X.translation.vector.iter().chain(X.rotation.coords.iter()).all(|x| x.is_finite())
    })
    .collect()
}

/// Of each measured pose the target, time, s, and distance, mm, and angle, deg, of the camera from the goal of that target.
pub(super) fn camera_errors(r: &RunRecord) -> Vec<(usize, [f64; 3])> {
    let of = |(target, t, X_CD): (usize, f64, Isometry3<f64>)| {
        (target, [t, X_CD.translation.vector.norm() * 1e3, X_CD.rotation.angle().to_degrees()])
    };
    desired_cameras(r).into_iter().map(of).collect()
}

/// The target, time, s, and where its goal lies in the camera by each measured pose: x, y, z, mm, and the rotation vector, deg.
fn axis_errors(r: &RunRecord) -> Vec<(usize, f64, [f64; 6])> {
    let of = |(target, t, X_CD): (usize, f64, Isometry3<f64>)| {
        let (p, w) = (X_CD.translation.vector * 1e3, X_CD.rotation.scaled_axis().map(f64::to_degrees));
        (target, t, [p.x, p.y, p.z, w.x, w.y, w.z])
    };
    desired_cameras(r).into_iter().map(of).collect()
}

/// From when to when no target was found, s.
pub(super) fn blind_spans(r: &RunRecord) -> Vec<(f64, f64)> {
    let m = &r.measurements;
    let mut spans: Vec<(f64, f64)> = Vec::new();
    let mut since = None;
    for row in 0..m.rows() {
        let time_s = m.number("exposure_s", row);
        match (m.word("status", row) == "Found", since) {
            (false, None) => since = Some(time_s),
            (true, Some(from)) => {
                spans.push((from, time_s));
                since = None;
            }
            _ => {}
        }
    }
    let end = r.trace.numbers("time_s").last().copied().unwrap_or(f64::NAN);
    spans.extend(since.map(|from| (from, end.max(from))));
    spans
}

pub(super) fn blind(r: &RunRecord) -> Option<Series> {
    let spans = blind_spans(r);
    let edges = spans.iter().flat_map(|(from, to)| [(*from, 0.0), (*to, 0.0)]);
    (!spans.is_empty()).then(|| Series::new(Symbol::Band, 1, edges).label("target not found"))
}

/// A value at a time, s, of a target.
type OfTarget = (usize, f64, f64);

/// A curve in pieces: where measurements are missing nothing is known, and nothing drawn; each piece is of one target.
fn without_gaps(points: &[OfTarget]) -> impl Iterator<Item = &[OfTarget]> {
    let mut steps: Vec<f64> = points.windows(2).filter_map(|w| Some(w.last()?.1 - w.first()?.1)).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(f64::INFINITY);
    points.chunk_by(move |a, b| a.0 == b.0 && b.1 - a.1 <= 3.5 * usual)
}

/// The feature error of each measurement that was taken, with its target.
fn feature_errors(r: &RunRecord) -> Vec<OfTarget> {
    let m = &r.measurements;
    let at = |row: usize| (r.target_at(row), m.number("taken_s", row), m.number("error_px", row));
    (0..m.rows()).map(at).filter(|(_, t, px)| t.is_finite() && px.is_finite()).collect()
}

/// Most times of a target that the sentence names. Chosen by eye: the figure shows all of them.
const SPELLS_TOLD: usize = 6;

/// Which target was servoed on when, of a run with several; nothing of a run with one.
fn whose(r: &RunRecord) -> String {
    let spells = r.spells();
    if spells.len() < 2 {
        return String::new();
    }
    let told = spells.iter().take(SPELLS_TOLD);
    let told: Vec<_> =
        told.map(|s| format!("{} from {:.2} s", r.target_name(s.target), s.from_s.max(0.0))).collect();
    let rest = match spells.len().saturating_sub(SPELLS_TOLD) {
        0 => String::new(),
        more => format!(", and {}", counted(more as u64, "more change")),
    };
    let last = spells.last().map_or("", |s| r.target_name(s.target));
    format!("The goal was of {}{rest}. Since {last} is looked for: ", told.join(", of "))
}

fn says(r: &RunRecord, errors: &[[f64; 2]]) -> String {
    // What is told is the end of the run: that of the last target.
    let of_targets = feature_errors(r);
    let last = of_targets.last().map(|e| e.0);
    let of_last = of_targets.iter().rev().take_while(|e| Some(e.0) == last).count();
    let errors = errors.get(errors.len().saturating_sub(of_last)..).unwrap_or_default();
    let (Some(first), Some(last)) = (errors.first(), errors.last()) else {
        return "No measurement says anything about the goal.".into();
    };
    let px = |e: f64| format!("{} px", significant(e, 3));
    let goal = number(r.goal_error_px);
    let word = if last[1] < first[1] { "falls" } else { "goes" };
    let whose = whose(r);
    let the = if whose.is_empty() { "The" } else { "the" };
    let mut text = format!("{whose}{the} feature error {word} from {} to {}", px(first[1]), px(last[1]));
    let beyond = errors.iter().rposition(|e| !(e[1] <= r.goal_error_px));
    match beyond {
        None => text += &format!(" and is never above the goal of {goal} px"),
        Some(at) if at + 1 < errors.len() => {
            let since = errors.get(at + 1).map_or(0.0, |e| e[0]);
            text += &format!(" and stays below the goal of {goal} px from {since:.2} s on");
        }
        Some(_) => text += &format!(" and ends above the goal of {goal} px"),
    }
    if let Some((_, [_, mm, deg])) = camera_errors(r).last() {
        text += &format!(
            "; the camera was last seen {} mm and {} deg from its goal",
            significant(*mm, 2),
            significant(*deg, 2)
        );
    }
    text + "."
}

/// Colour of the line of the goal.
const GOAL_COLOUR: usize = 2;

/// The figure.
pub(super) fn errors_over_time(r: &RunRecord) -> String {
    const TITLE: &str = "Errors over time";
    let of_targets = feature_errors(r);
    let errors: Vec<[f64; 2]> = of_targets.iter().map(|(_, t, px)| [*t, *px]).collect();
    let camera = camera_errors(r);
    let several = r.targets_looked_for().len() > 1;
    if errors.is_empty() && camera.is_empty() {
        return heading(TITLE, &says(r, &errors));
    }
    let end = r.trace.numbers("time_s").last().copied().unwrap_or(1.0).max(1e-3);
    let mut panels = Vec::new();
    let mut add = |title: &str, unit: &str, points: Vec<OfTarget>, goal: Option<f64>| {
        if points.is_empty() {
            return;
        }
        let mut panel = Panel::new(title, "t, s", unit).x_range(0.0, end);
        for piece in without_gaps(&points) {
            let target = piece.first().map_or(0, |point| point.0);
            // The third colour is that of the goal.
            let (colour, label) = match several {
                false => (0, "as measured".to_owned()),
                true => (
                    if target < GOAL_COLOUR { target } else { target + 1 },
                    format!("of {}", r.target_name(target)),
                ),
            };
            panel.push(Series::line(colour, piece.iter().map(|(_, t, value)| (*t, *value))).label(label));
        }
        if let Some(goal) = goal {
            panel.push(Series::new(Symbol::Dashed, GOAL_COLOUR, [(0.0, goal), (end, goal)]).label("goal"));
        }
        let mut panel = panel.log_y_if_wide();
        blind(r).into_iter().for_each(|band| panel.push(band));
        panels.push(panel);
    };
    add("features", "root mean square, px", of_targets, Some(r.goal_error_px));
    add(
        "place of the camera",
        "distance from its goal, mm",
        camera.iter().map(|(target, e)| (*target, e[0], e[1])).collect(),
        None,
    );
    add(
        "orientation of the camera",
        "angle from its goal, deg",
        camera.iter().map(|(target, e)| (*target, e[0], e[2])).collect(),
        None,
    );
    let columns = panels.len();
    let note = "Logarithmic where the values span more than two decades. The floor of the last two is the noise of a single measured pose.";
    figure(TITLE, &says(r, &errors), note, |width| figure_svg(&panels, columns, width, TITLE))
}

/// The same by axis.
pub(super) fn errors_by_axis(r: &RunRecord) -> String {
    const TITLE: &str = "Errors by axis";
    let errors = axis_errors(r);
    let Some((_, _, last)) = errors.last() else { return String::new() };
    let end = r.trace.numbers("time_s").last().copied().unwrap_or(1.0).max(1e-3);
    let panel = |title: &str, unit: &str, first: usize| {
        let mut panel = Panel::new(title, "t, s", unit).x_range(0.0, end);
        for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
            let points: Vec<_> = errors
                .iter()
                .filter_map(|(target, t, e)| Some((*target, *t, e.get(first + i).copied()?)))
                .collect();
            for piece in without_gaps(&points) {
                panel.push(Series::line(i, piece.iter().map(|(_, t, value)| (*t, *value))).label(name));
            }
        }
        blind(r).into_iter().for_each(|band| panel.push(band));
        panel
    };
    let panels = [
        panel("place", "goal in the camera's frame, mm", 0),
        panel("orientation", "rotation vector to the goal, deg", 3),
    ];
    let worst = |first: usize, unit: &str| {
        let of = ["x", "y", "z"].into_iter().zip(last.iter().skip(first));
        let most = of.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        most.map_or(String::new(), |(axis, e)| format!("{} {unit} {axis}", significant(*e, 2)))
    };
    let says =
        format!("At the end the camera lacks most {} and {}.", worst(0, "mm along"), worst(3, "deg about"));
    let mut note = "Axes of the camera: x to the right, y down, z ahead. The curves say by what the camera must move and turn to be at its goal, as measured.".to_owned();
    if r.targets_looked_for().len() > 1 {
        note += " Each measurement is compared with the goal of its own target.";
    }
    figure(TITLE, &says, &note, |width| figure_svg(&panels, 2, width, TITLE))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(errors: &str) -> RunRecord {
        RunRecord {
            goal_error_px: 0.05,
            measurements: CsvTable::parse(&format!("exposure_s,taken_s,status,error_px\n{errors}")),
            trace: CsvTable::parse("time_s\n0\n1\n"),
            ..RunRecord::default()
        }
    }

    #[test]
    fn the_sentence_is_about_the_end_of_the_run() {
        let of = |text: &str| {
            let r = record(text);
            says(&r, &r.measurements.points("taken_s", "error_px"))
        };
        let falls =
            of("0,0.02,Found,160\n0.04,0.06,Found,0.03\n0.08,0.10,NoContrast,\n0.12,0.14,Found,0.04\n");
        assert_eq!(
            falls,
            "The feature error falls from 160 px to 0.0400 px and stays below the goal of 0.05 px from 0.06 s on."
        );
        assert!(
            of("0,0.02,Found,1\n0,0.06,Found,2\n")
                .contains("goes from 1.00 px to 2.00 px and ends above the goal")
        );
        assert!(of("").contains("No measurement"));
    }

    #[test]
    fn nothing_is_drawn_where_nothing_was_measured() {
        let points = [0.0, 0.04, 0.08, 0.12, 0.6, 0.64].map(|t| (0, t, 1.0));
        let pieces: Vec<usize> = without_gaps(&points).map(<[_]>::len).collect();
        assert_eq!(pieces, [4, 2]);
        let points = [(0, 0.0), (0, 0.04), (1, 0.08), (0, 0.12)].map(|(target, t)| (target, t, 1.0));
        let pieces: Vec<usize> = without_gaps(&points).map(<[_]>::len).collect();
        assert_eq!(pieces, [2, 1, 1], "no line joins the errors of two targets");
    }

    #[test]
    fn spans_without_target_end_with_the_next_one() {
        let r = record("0.0,,NoContrast,\n0.1,,Found,\n0.2,,NoMatch,\n0.3,,NoMatch,\n");
        assert_eq!(blind_spans(&r), [(0.0, 0.1), (0.2, 1.0)]);
    }

    #[test]
    fn the_camera_is_compared_with_its_goal() {
        let mut r = record("");
        r.measurements = CsvTable::parse(
            "exposure_s,CO_x_m,CO_y_m,CO_z_m,CO_qx,CO_qy,CO_qz,CO_qw\n0.5,0,0,0.7,0,0,0,1\n0.6,,,,,,,\n",
        );
        r.poses = CsvTable::parse("frame,x_m,y_m,z_m,qx,qy,qz,qw\nO_end,1,2,3,0,0,0,1\nD,1,2,2.4,0,0,0,1\n");
        // The goal lies 0.1 m nearer to the object, which is ahead: by z alone.
        let (_, _, by_axis) = axis_errors(&r)[0];
        assert!(
            by_axis.iter().zip([0.0, 0.0, 100.0, 0.0, 0.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6),
            "{by_axis:?}"
        );
        assert!(errors_by_axis(&r).contains("lacks most 100 mm along z"), "{}", errors_by_axis(&r));
        let errors = camera_errors(&r);
        assert_eq!(errors.len(), 1);
        let (target, [time_s, mm, deg]) = errors[0];
        assert!(target == 0 && (time_s - 0.5).abs() < 1e-12 && (mm - 100.0).abs() < 1e-9 && deg < 1e-9);
    }

    #[test]
    fn each_target_is_compared_with_its_own_goal_and_named() {
        let mut r = record("");
        r.further_targets = vec![("bin".into(), [[0.0; 2]; 2])];
        r.measurements = CsvTable::parse(
            "exposure_s,taken_s,status,error_px,target_number,CO_x_m,CO_y_m,CO_z_m,CO_qx,CO_qy,CO_qz,CO_qw\n\
             0.1,0.12,Found,9,0,0,0,0.7,0,0,0,1\n0.2,0.22,Found,1,0,0,0,0.61,0,0,0,1\n\
             0.5,0.52,Found,50,1,0.1,0,0.5,0,0,0,1\n0.6,0.62,Found,0.04,1,0,0.002,0.5,0,0,0,1\n",
        );
        r.poses = CsvTable::parse(
            "frame,x_m,y_m,z_m,qx,qy,qz,qw\nO_in_D,0,0,0.6,0,0,0,1\nO1_in_D,0,0,0.5,0,0,0,1\n",
        );
        let mm: Vec<_> =
            camera_errors(&r).iter().map(|(target, e)| (*target, (e[1] * 1e6).round() / 1e6)).collect();
        assert_eq!(mm, [(0, 100.0), (0, 10.0), (1, 100.0), (1, 2.0)]);
        let html = errors_over_time(&r);
        for part in [
            "The goal was of target from 0.10 s, of bin from 0.50 s. Since bin is looked for: the feature error falls from 50.0 px to 0.0400 px",
            "of target<",
            "of bin<",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
        assert!(!html.contains("as measured<"), "each line has the name of its target");
    }
}
