//! The image plane: the points of the target on their way to where they are to be.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::record::RunRecord;
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::numbers::{counted, significant};
use crate::report::page::{figure, heading};

/// The way of a point, and where it is to end.
struct PointPath {
    id: usize,
    path: Vec<[f64; 2]>,
    goal: Option<[f64; 2]>,
}

impl PointPath {
    /// Length of the way, px: steps that are no longer than noise are none.
    fn length(&self) -> f64 {
        const NOISE_PX: f64 = 0.5;
        let mut at = None;
        let mut length = 0.0;
        for p in &self.path {
            let step = at.map_or(f64::INFINITY, |at| distance(p, at));
            if step > NOISE_PX {
                length += if at.is_some() { step } else { 0.0 };
                at = Some(p);
            }
        }
        length
    }

    fn straight(&self) -> f64 {
        self.path.first().zip(self.path.last()).map_or(0.0, |(a, b)| distance(a, b))
    }

    /// From where it is last seen to its goal, px.
    fn left(&self) -> Option<f64> {
        Some(distance(self.path.last()?, &self.goal?))
    }
}

fn distance(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The ways of the points of the target of this number.
fn ways(r: &RunRecord, target: usize) -> Vec<PointPath> {
    let rows: Vec<usize> = (0..r.measurements.rows()).filter(|row| r.target_at(*row) == target).collect();
    let ids =
        r.measurements.names().iter().filter_map(|n| n.strip_prefix("u_")?.strip_suffix("_px")?.parse().ok());
    let ways = ids.map(|id: usize| {
        let (u, v) =
            (r.measurements.numbers(&format!("u_{id}_px")), r.measurements.numbers(&format!("v_{id}_px")));
        let at = |row: &usize| Some([*u.get(*row)?, *v.get(*row)?]);
        let path = rows.iter().filter_map(at).filter(|p| p.iter().all(|x| x.is_finite())).collect();
        let is_goal =
            |row: &usize| r.goal.number("point", *row) == id as f64 && r.goal_target_at(*row) == target;
        let row = (0..r.goal.rows()).find(is_goal);
        let goal = row.map(|row| [r.goal.number("u_px", row), r.goal.number("v_px", row)]);
        PointPath { id, path, goal: goal.filter(|g| g.iter().all(|x| x.is_finite())) }
    });
    ways.filter(|way| !way.path.is_empty()).collect()
}

fn says(r: &RunRecord, ways: &[PointPath]) -> String {
    let seen = ways.len();
    let mut text = match ways.iter().filter_map(PointPath::left).reduce(f64::max) {
        Some(most) if seen == 1 => format!("The point ends {} px from its goal", significant(most, 2)),
        Some(most) => format!("The {seen} points end within {} px of their goals", significant(most, 2)),
        None => format!("{} seen; nothing is known of where they are to be", counted(seen as u64, "point")),
    };
    let longest = ways.iter().max_by(|a, b| a.length().total_cmp(&b.length()));
    if let Some(way) = longest.filter(|way| way.length() > 1.0 && r.has_arm) {
        text +=
            &format!("; the longest way, that of point {}, is {} px", way.id, significant(way.length(), 3));
        if way.straight() > 5.0 {
            text += &format!(", {} times the straight line", significant(way.length() / way.straight(), 3));
        }
    }
    text + "."
}

fn border([width, height]: [f64; 2]) -> Series {
    let (x0, y0, x1, y1) = (-0.5, -0.5, width - 0.5, height - 0.5);
    let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
    Series::line(6, corners).label("border of the image")
}

fn pair(p: &[f64; 2]) -> (f64, f64) {
    (p[0], p[1])
}

/// The figure.
pub(super) fn image_plane(r: &RunRecord) -> String {
    const TITLE: &str = "Image plane: the points on the way to their goals";
    let targets = r.targets_looked_for();
    let mut of_targets: Vec<_> = targets.iter().map(|target| (*target, ways(r, *target))).collect();
    of_targets.retain(|(_, ways)| !ways.is_empty());
    if of_targets.is_empty() {
        return heading(TITLE, "No point of the target was ever found, so there is no way to draw.");
    }
    let several = targets.len() > 1;
    let mut panels = Vec::new();
    let mut told = Vec::new();
    for (target, ways) in &of_targets {
        let name = r.target_name(*target);
        let of = if several { format!(", {name}") } else { String::new() };
        panels.extend(paths(r, ways, &of));
        told.push(if several { format!("Of {name}: {}", says(r, ways)) } else { says(r, ways) });
    }
    let few = of_targets.iter().all(|(_, ways)| ways.len() <= FEW);
    let colours = if few { "" } else { " Colours repeat after seven points." };
    let note = format!(
        "Crosses in the image: where a point was first seen; circles: where it is to be. Crosses about the goal: where it was seen last.{colours}"
    );
    figure(TITLE, &told.join(" "), &note, |width| figure_svg(&panels, 2, width, TITLE))
}

/// With so many points each has a colour of its own, and a name.
const FEW: usize = 7;

/// The ways in the image, and about the points' goals; `of` follows the titles.
fn paths(r: &RunRecord, ways: &[PointPath], of: &str) -> Vec<Panel> {
    let mut image = Panel::new(format!("whole image{of}"), "u, px", "v, px, down")
        .equal_scales()
        .y_down()
        .with(border(r.image_px));
    let few = ways.len() <= FEW;
    for (i, way) in ways.iter().enumerate() {
        let line = Series::line(i, way.path.iter().map(pair));
        image.push(if few { line.label(format!("point {}", way.id)) } else { line });
        image.push(Series::new(Symbol::Cross, i, way.path.first().map(pair)));
        image.push(Series::new(Symbol::Circle, i, way.goal.as_ref().map(pair)));
    }
    let mut panels = vec![image];
    let ends: Vec<f64> = ways.iter().filter_map(PointPath::left).collect();
    if let Some(most) = ends.iter().copied().reduce(f64::max) {
        // Wide enough for the ends and for the goal, and no wider than the ways themselves.
        let reach = (2.5 * most).max(6.0 * r.goal_error_px).max(0.2);
        let mut rest = Panel::new(
            format!("the end, about each point's goal{of}"),
            "u less its goal, px",
            "v less its goal, px, down",
        )
        .equal_scales()
        .y_down()
        .x_range(-reach, reach)
        .y_range(-reach, reach);
        let circle = (0..=48).map(|k| f64::from(k) / 48.0 * std::f64::consts::TAU);
        let error = r.goal_error_px;
        rest.push(
            Series::new(Symbol::Dashed, 6, circle.map(|a| (error * a.cos(), error * a.sin())))
                .label("goal.feature_error_px"),
        );
        for (i, way) in ways.iter().enumerate() {
            if let Some(goal) = way.goal {
                rest.push(Series::line(i, way.path.iter().map(|p| (p[0] - goal[0], p[1] - goal[1]))));
                let end = way.path.last().map(|p| (p[0] - goal[0], p[1] - goal[1]));
                rest.push(Series::new(Symbol::Cross, i, end));
            }
        }
        panels.push(rest);
    }
    panels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::csv_table::CsvTable;

    #[test]
    fn the_sentence_says_how_near_and_how_straight() {
        let r = RunRecord {
            has_arm: true,
            image_px: [640.0, 480.0],
            goal_error_px: 0.05,
            measurements: CsvTable::parse("u_1_px,v_1_px\n0,0\n100,0\n100,100.04\n100.01,100.04\n,\n"),
            goal: CsvTable::parse("point,u_px,v_px\n1,100,100\n"),
            ..RunRecord::default()
        };
        let says = says(&r, &ways(&r, 0));
        assert_eq!(
            says,
            "The point ends 0.041 px from its goal; the longest way, that of point 1, is 200 px, 1.41 times the straight line."
        );
        let html = image_plane(&r);
        assert!(html.contains("about each point") && html.contains("border of the image"));
        let of_two = RunRecord {
            further_targets: vec![("bin".into(), [[0.0; 2]; 2])],
            measurements: CsvTable::parse("target_number,u_1_px,v_1_px\n0,0,0\n0,100,0\n1,50,50\n1,60,50\n"),
            goal: CsvTable::parse("point,u_px,v_px,target_number\n1,100,3,0\n1,60,57,1\n"),
            ..r
        };
        let html = image_plane(&of_two);
        for part in [
            "Of target: The point ends 3.0 px from its goal",
            "Of bin: The point ends 7.0 px from its goal",
            "whole image, target<",
            "whole image, bin<",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
        let blind = image_plane(&RunRecord::default());
        assert!(blind.contains("No point of the target") && !blind.contains("<svg"));
    }
}
