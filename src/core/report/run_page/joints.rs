//! The joints: how near they come to their limits, and positions, velocities, torques over time.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::record::{JointSummary, RunRecord};
use crate::report::chart::{Panel, Series, Symbol, figure_svg};
use crate::report::numbers::significant;
use crate::report::page::figure;

/// What is drawn of each joint.
#[derive(Clone, Copy, PartialEq)]
enum Quantity {
    Position,
    Velocity,
    Torque,
}

impl Quantity {
    fn column(self) -> &'static str {
        match self {
            Self::Position => "q",
            Self::Velocity => "qd",
            Self::Torque => "tau",
        }
    }

    fn commanded(self) -> Option<&'static str> {
        match self {
            Self::Position => Some("q_r"),
            Self::Velocity => Some("qd_r"),
            Self::Torque => None,
        }
    }

    fn unit(self, joint: &JointSummary) -> &'static str {
        match (self, joint.slides) {
            (Self::Position, false) => "rad",
            (Self::Position, true) => "m",
            (Self::Velocity, false) => "rad/s",
            (Self::Velocity, true) => "m/s",
            (Self::Torque, false) => "N m",
            (Self::Torque, true) => "N",
        }
    }

    /// Least and greatest value; infinite where there is none.
    fn limits(self, joint: &JointSummary) -> (f64, f64) {
        match self {
            Self::Position => (joint.lower, joint.upper),
            Self::Velocity => (-joint.velocity, joint.velocity),
            Self::Torque => (-joint.effort, joint.effort),
        }
    }
}

/// A joint's curve.
struct Curve<'a> {
    joint: &'a JointSummary,
    number: usize,
    points: Vec<[f64; 2]>,
    commanded: Vec<[f64; 2]>,
}

impl Curve<'_> {
    fn ends(&self) -> (f64, f64) {
        let values = || self.points.iter().map(|p| p[1]);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    }

    /// The largest distance of measured from commanded.
    fn deviation(&self) -> f64 {
        let pairs = self.points.iter().zip(&self.commanded);
        pairs.map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f64::max)
    }
}

fn curves(r: &RunRecord, quantity: Quantity) -> Vec<Curve<'_>> {
    let column = |name: &str, number: usize| r.trace.points("time_s", &format!("{name}_{number}"));
    let joints = r.joints.iter().zip(1..);
    let all = joints.map(|(joint, number)| Curve {
        joint,
        number,
        points: column(quantity.column(), number),
        commanded: quantity.commanded().map(|name| column(name, number)).unwrap_or_default(),
    });
    all.filter(|curve| !curve.points.is_empty()).collect()
}

/// A joint in words: its number, and its name where that says more.
pub(super) fn called(joint: &JointSummary, number: usize) -> String {
    let plain =
        [format!("joint{number}"), format!("joint_{number}"), format!("joint {number}"), String::new()];
    if plain.contains(&joint.name) {
        format!("joint {number}")
    } else {
        format!("joint {number} ({})", joint.name)
    }
}

/// The figures of an arm that moves; of one that does not there are none.
pub(super) fn joints(r: &RunRecord) -> String {
    if !r.has_arm || r.trace.rows() == 0 {
        return String::new();
    }
    let mut html = limits_figure(r);
    for quantity in [Quantity::Position, Quantity::Velocity, Quantity::Torque] {
        html += &quantity_figure(r, quantity);
    }
    html
}

/// Share of a limit: 0 in the middle of the range, 1 at either end.
fn share((low, high): (f64, f64), value: f64) -> f64 {
    (value - 0.5 * (low + high)) / (0.5 * (high - low))
}

fn limits_figure(r: &RunRecord) -> String {
    const TITLE: &str = "Joints within their limits";
    let mut panels = Vec::new();
    let mut says = Vec::new();
    for (quantity, title, word) in [
        (Quantity::Position, "positions", "goes nearest to an end of its range"),
        (Quantity::Velocity, "velocities", "is the fastest"),
        (Quantity::Torque, "torques and forces", "has the largest effort"),
    ] {
        let mut panel = Panel::new(title, "t, s", "share of the limit, %");
        let (mut nearest, mut unlimited) = (None::<(f64, String)>, 0);
        let mut shares: Vec<Vec<f64>> = Vec::new();
        for curve in curves(r, quantity) {
            let limits = quantity.limits(curve.joint);
            if !(limits.1 - limits.0).is_finite() || !(limits.1 > limits.0) {
                unlimited += 1;
                continue;
            }
            let values: Vec<f64> = curve.points.iter().map(|p| 100.0 * share(limits, p[1])).collect();
            let most = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            if nearest.as_ref().is_none_or(|(least, _)| most > *least) {
                nearest = Some((most, called(curve.joint, curve.number)));
            }
            let line = curve.points.iter().zip(&values).map(|(p, v)| (p[0], *v));
            panel.push(Series::line(curve.number - 1, line).label(format!("joint {}", curve.number)));
            shares.push(values);
        }
        let Some((most, who)) = nearest else {
            says.push(format!("no joint has a limit of {title}"));
            continue;
        };
        let end = r.trace.numbers("time_s").last().copied().unwrap_or(1.0);
        for limit in [-100.0, 100.0] {
            panel.push(Series::new(Symbol::Limit, 0, [(0.0, limit), (end, limit)]).label("limit"));
        }
        panels.push(panel.y_range(-f64::max(110.0, 1.05 * most), f64::max(110.0, 1.05 * most)));
        if quantity == Quantity::Torque && most < 1e-6 {
            says.push("no torques are commanded: the drive closes its own loop".into());
        } else {
            says.push(format!("{who} {word}: {} % of its limit", significant(most, 2)));
        }
        if unlimited > 0 {
            says.push(format!("{unlimited} of the joints turn without end"));
        }
        let hidden = hidden(&shares);
        if hidden > 0 {
            says.push(format!("{hidden} of the curves of {title} lie under others"));
        }
    }
    let note = "0 % is the middle of a joint's range, or no speed, or no effort; what each joint does by itself follows below.";
    let sentence = format!("{}.", capital(&says.join("; ")));
    let acted = acted(r);
    figure(TITLE, &format!("{sentence} {acted}"), note, |width| figure_svg(&panels, 3, width, TITLE))
}

/// How many curves cannot be seen, because another one lies over them all the time: within a hundredth of the axis.
fn hidden(shares: &[Vec<f64>]) -> usize {
    let covers =
        |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1.0);
    let is_hidden = |(i, own): (usize, &Vec<f64>)| shares.iter().skip(i + 1).any(|later| covers(own, later));
    shares.iter().enumerate().filter(|curve| is_hidden(*curve)).count()
}

/// Which limits acted, as words.
fn acted(r: &RunRecord) -> String {
    let rows = r.trace.rows().max(1) as f64;
    let limits = r.trace.names().iter().filter_map(|name| Some((name, name.strip_prefix("limit_")?)));
    let told = limits.filter_map(|(name, word)| {
        let count = r.trace.numbers(name).iter().filter(|mask| **mask > 0.0).count();
        (count > 0).then(|| format!("{word} in {} %", significant(100.0 * count as f64 / rows, 2)))
    });
    let told: Vec<String> = told.collect();
    if told.is_empty() {
        "No limit held a joint back.".into()
    } else {
        format!("Limits that held joints back, of the ticks: {}.", told.join(", "))
    }
}

pub(super) fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|c| c.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

fn quantity_figure(r: &RunRecord, quantity: Quantity) -> String {
    let curves = curves(r, quantity);
    let title = match quantity {
        Quantity::Position => "Joint positions",
        Quantity::Velocity => "Joint velocities",
        Quantity::Torque => "Joint torques and forces",
    };
    if quantity == Quantity::Torque && curves.iter().all(|c| c.ends() == (0.0, 0.0)) {
        return String::new();
    }
    let panels: Vec<Panel> = curves.iter().map(|curve| panel(quantity, curve)).collect();
    let columns = match panels.len() {
        0..=3 => panels.len(),
        4 => 2,
        5 | 6 => 3,
        _ => 4,
    };
    figure(title, &says(quantity, &curves), "", |width| figure_svg(&panels, columns, width, title))
}

fn panel(quantity: Quantity, curve: &Curve<'_>) -> Panel {
    let unit = quantity.unit(curve.joint);
    let (low, high) = quantity.limits(curve.joint);
    let limits = match (low.is_finite() && high.is_finite(), quantity) {
        (false, _) => ", no limits".to_owned(),
        (true, Quantity::Position) => {
            format!(", limits {} ... {}", significant(low, 3), significant(high, 3))
        }
        (true, _) => format!(", limits ±{}", significant(high, 3)),
    };
    let mut panel =
        Panel::new(capital(&called(curve.joint, curve.number)), "t, s", format!("{unit}{limits}"));
    let pairs = |points: &[[f64; 2]]| points.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>();
    panel.push(Series::line(0, pairs(&curve.points)).label(if quantity == Quantity::Torque {
        "commanded"
    } else {
        "measured"
    }));
    if !curve.commanded.is_empty() {
        panel.push(Series::new(Symbol::Dashed, 1, pairs(&curve.commanded)).label("commanded"));
    }
    // A limit is drawn where it is near enough not to flatten the curve.
    let (least, most) = curve.ends();
    let room = 0.6 * (most - least).max(1e-9);
    let end = curve.points.last().map_or(1.0, |p| p[0]);
    for limit in [low, high] {
        if limit > least - room && limit < most + room {
            panel.push(Series::new(Symbol::Limit, 0, [(0.0, limit), (end, limit)]));
        }
    }
    // What hardly moves is not blown up to what its encoder or arithmetic leaves.
    let min_span = match quantity {
        Quantity::Position => 1e-3,
        Quantity::Velocity => 1e-2,
        Quantity::Torque => 1e-1,
    };
    if most - least < min_span {
        let middle = 0.5 * (most + least);
        panel = panel.y_range(middle - 0.5 * min_span, middle + 0.5 * min_span);
    }
    panel
}

fn says(quantity: Quantity, curves: &[Curve<'_>]) -> String {
    let by_span = |c: &&Curve<'_>| c.ends().1 - c.ends().0;
    let Some(widest) = curves.iter().max_by(|a, b| by_span(a).total_cmp(&by_span(b))) else {
        return "There is no record.".into();
    };
    let who = |c: &Curve<'_>| called(c.joint, c.number);
    let unit = |c: &Curve<'_>| quantity.unit(c.joint);
    let span = significant(by_span(&widest), 3);
    let mut text = match quantity {
        Quantity::Position => format!("{} moves farthest, over {span} {}", who(widest), unit(widest)),
        Quantity::Velocity => {
            let fast = widest.ends().0.abs().max(widest.ends().1);
            format!("{} is the fastest, at {} {}", who(widest), significant(fast, 3), unit(widest))
        }
        Quantity::Torque => format!("The effort of {} changes most, by {span} {}", who(widest), unit(widest)),
    };
    // Thinner than the line: of the height of its panel.
    let far = curves
        .iter()
        .filter(|c| !c.commanded.is_empty() && c.deviation() > 0.015 * by_span(c).max(1e-9))
        .count();
    if quantity.commanded().is_some() {
        let largest = curves.iter().max_by(|a, b| a.deviation().total_cmp(&b.deviation()));
        if let Some(c) = largest {
            let most = format!("at most {} {} ({})", significant(c.deviation(), 2), unit(c), who(c));
            text += &if far == 0 {
                format!("; measured and commanded lie on each other, {most} apart")
            } else {
                format!(
                    "; measured and commanded are {most} apart, and can be told apart in {far} of {} joints",
                    curves.len()
                )
            };
        }
    }
    format!("{}.", capital(&text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::csv_table::CsvTable;

    fn record() -> RunRecord {
        let joint = |name: &str, upper: f64| JointSummary {
            name: name.into(),
            lower: -upper,
            upper,
            velocity: 2.0,
            effort: 10.0,
            ..JointSummary::default()
        };
        let mut text = String::from(
            "time_s,limit_jerk,limit_view,q_1,q_2,qd_1,qd_2,tau_1,tau_2,q_r_1,q_r_2,qd_r_1,qd_r_2\n",
        );
        for k in 0..100 {
            let t = f64::from(k) * 0.01;
            text += &format!("{t},{},0,{t},0.5,1,0,5,-7,{t},0.25,1,0\n", u8::from(k < 10));
        }
        RunRecord {
            has_arm: true,
            joints: vec![joint("shoulder", 2.0), joint("joint_2", f64::INFINITY)],
            trace: CsvTable::parse(&text),
            ..RunRecord::default()
        }
    }

    #[test]
    fn sentences_name_the_joint_that_matters() {
        let html = joints(&record());
        for part in [
            "Joint 1 (shoulder) goes nearest to an end of its range: 50 % of its limit; 1 of the joints turn without end",
            "joint 1 (shoulder) is the fastest: 50 % of its limit",
            "joint 2 has the largest effort: 70 % of its limit",
            "jerk in 10 %.",
            "Joint 1 (shoulder) moves farthest, over 0.990 rad",
            "measured and commanded are at most 0.25 rad (joint 2) apart, and can be told apart in 1 of 2 joints",
        ] {
            assert!(html.contains(part), "{part} in {}", html.split("<svg").next().unwrap());
        }
        assert_eq!(joints(&RunRecord { has_arm: false, ..record() }), "");
    }

    #[test]
    fn a_curve_under_another_is_told() {
        assert_eq!(hidden(&[vec![0.0, 1.0], vec![0.5, 1.5], vec![50.0, 50.0]]), 1);
        assert_eq!(hidden(&[vec![0.0, 1.0], vec![0.5, 2.5]]), 0);
    }
}
