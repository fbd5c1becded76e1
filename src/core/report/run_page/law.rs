//! What the law asked for beside what was commanded, and how near the arm came to a singular posture.
//!
//! The numbers here are layout, or keep divisions from zero; they were chosen by hand.

use super::joints::{called, capital};
use super::record::RunRecord;
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::numbers::significant;
use crate::report::page::figure;

/// Differences below this share of a joint's largest speed are thinner than a line.
const THIN: f64 = 0.015;

/// Velocities that the law requests, and those that limits, braking stage and smooth start leave of them. None for a law that commands torques, and without an arm.
pub(super) fn requested(r: &RunRecord) -> String {
    const TITLE: &str = "Requested and commanded velocities";
    let mut panels = Vec::new();
    let mut cut: Option<(f64, String)> = None;
    let mut told_apart = 0;
    for (joint, number) in r.joints.iter().zip(1..) {
        let points = |name: &str| r.trace.points("time_s", &format!("{name}_{number}"));
        let (asked, given) = (points("requested_qd"), points("qd_r"));
        let most = |points: &[[f64; 2]]| points.iter().map(|p| p[1].abs()).fold(0.0, f64::max);
        if asked.is_empty() || most(&asked) == 0.0 {
            continue;
        }
        let unit = if joint.slides { "m/s" } else { "rad/s" };
        let pairs = |points: &[[f64; 2]]| points.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>();
        let line = Series::line(0, pairs(&asked)).label("requested");
        let dashed = Series::new(Symbol::Dashed, 1, pairs(&given)).label("commanded");
        panels.push(Panel::new(capital(&called(joint, number)), "t, s", unit).with(line).with(dashed));
        let apart = most(&asked) - most(&given);
        if apart > THIN * most(&asked) {
            told_apart += 1;
        }
        let share = most(&asked) / most(&given).max(1e-12);
        if cut.as_ref().is_none_or(|(greatest, _)| share > *greatest) {
            cut = Some((share, called(joint, number)));
        }
    }
    let (Some((share, who)), true) = (cut, r.has_arm) else { return String::new() };
    let says = if told_apart == 0 {
        "The arm was commanded as fast as the law requested: no limit cut its largest velocities.".to_owned()
    } else {
        format!(
            "{} is cut most: the law requests up to {} times the speed that it is commanded; limits or the braking stage act on {told_apart} of {} joints.",
            capital(&who),
            significant(share, 2),
            panels.len()
        )
    };
    let note = "Requested: the output of the law before limits, braking and jerk; commanded: the reference that the joints follow.";
    let columns = if panels.len() == 4 { 2 } else { panels.len().min(3) };
    figure(TITLE, &says, note, |width| figure_svg(&panels, columns, width, TITLE))
}

/// The distance from singular postures over time.
pub(super) fn singularity(r: &RunRecord) -> String {
    const TITLE: &str = "Distance from singular postures";
    let points = r.trace.points("time_s", "min_singular_value");
    let least = points.iter().min_by(|a, b| a[1].total_cmp(&b[1]));
    let (Some([at_s, least]), true) = (least, r.has_arm) else { return String::new() };
    let most = points.iter().map(|p| p[1]).fold(0.0, f64::max);
    let says = if *least < 1e-6 {
        format!(
            "The arm is in a singular posture at {at_s:.2} s: a motion of the camera exists that no motion of the joints gives."
        )
    } else {
        format!(
            "Least at {at_s:.2} s, {}: the motion of the camera that is hardest there takes {} rad/s or m/s of the joints for each m/s or rad/s.",
            significant(*least, 2),
            significant(1.0 / least, 2)
        )
    };
    let panel = Panel::new("Least singular value of the camera's Jacobian", "t, s", "m and rad mixed")
        .with(Series::line(0, points.iter().map(|p| (p[0], p[1]))))
        .y_range(0.0, 1.05 * most.max(1e-3));
    let note = "How the joints move the camera against the object, by the measured positions. Near 0 the joints must be fast for a slow camera.";
    figure(TITLE, &says, note, |width| figure_svg(std::slice::from_ref(&panel), 1, width, TITLE))
}

#[cfg(test)]
mod tests {
    use super::super::record::JointSummary;
    use super::*;
    use crate::report::csv_table::CsvTable;

    fn record() -> RunRecord {
        let mut text =
            String::from("time_s,qd_r_1,qd_r_2,requested_qd_1,requested_qd_2,min_singular_value\n");
        for k in 0..50 {
            let t = f64::from(k) * 0.01;
            text += &format!("{t},0.5,0.1,2,0.1,{}\n", 0.2 + (t - 0.3).abs());
        }
        RunRecord {
            has_arm: true,
            joints: vec![
                JointSummary { name: "shoulder".into(), ..JointSummary::default() },
                JointSummary::default(),
            ],
            trace: CsvTable::parse(&text),
            ..RunRecord::default()
        }
    }

    #[test]
    fn what_the_law_asks_stands_beside_what_it_gets() {
        let html = requested(&record());
        assert!(html.contains("Joint 1 (shoulder) is cut most: the law requests up to 4.0 times"), "{html}");
        assert!(html.contains("act on 1 of 2 joints"), "{html}");
        let torques =
            RunRecord { trace: CsvTable::parse("time_s,qd_r_1,requested_qd_1\n0,1,0\n"), ..record() };
        assert_eq!(requested(&torques), "");
        assert_eq!(requested(&RunRecord { has_arm: false, ..record() }), "");
    }

    #[test]
    fn the_nearest_singular_posture_is_told() {
        let html = singularity(&record());
        assert!(
            html.contains("Least at 0.30 s, 0.20: the motion") && html.contains("takes 5.0 rad/s"),
            "{html}"
        );
        assert_eq!(singularity(&RunRecord { trace: CsvTable::default(), ..record() }), "");
    }
}
