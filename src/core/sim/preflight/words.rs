//! The preflight in words.

use super::{CameraPath, Posture, Preflight, Reach, Viewpoint};
use crate::scene::{Overhang, PointVisibility, Visibility};
use crate::servo::{Margins, Stability};

/// With more points than these only those that are cut off are listed one by one. Chosen by hand: two tags' corners.
const TOLD_POINTS: usize = 8;

/// A line each; the first words say what it is about.
pub(super) fn lines(preflight: &Preflight) -> Vec<String> {
    let mut lines = Vec::new();
    match &preflight.start {
        Some(view) => viewpoint("start", view, &mut lines),
        None => lines
            .push("  start: no [scene] says where the object is: it is known when the camera sees it".into()),
    }
    if let Some(view) = &preflight.goal {
        viewpoint("goal", view, &mut lines);
    }
    lines.push(format!("  reach: {}", reach(&preflight.reach)));
    if let Some(way) = &preflight.way {
        lines.push(format!("  way:   {}", straight_way(way)));
    }
    lines.extend(preflight.bound.iter().map(|bound| format!("  bound: {}", bound.line())));
    lines.extend(preflight.path.iter().map(|path| format!("  path:  {}", path.line())));
    lines.extend(preflight.space.iter().map(|space| format!("  space: {}", space.line())));
    lines.extend(preflight.targets.iter().flat_map(|target| target.lines()));
    lines.extend(preflight.goals.iter().map(|goal| format!("  goals: {}", goal.line())));
    lines.extend(preflight.depth.iter().map(|depth| format!("  depth: {depth}")));
    if let Some([condition, slowest]) = preflight.stability.as_ref().map(stability) {
        lines.extend([format!("  law:   {condition}"), format!("         {slowest}")]);
    }
    lines.extend(preflight.rotors.iter().map(|rotors| format!("  rotor: {rotors}")));
    lines.extend(preflight.notes.iter().map(|note| format!("  note:  {note}")));
    lines
}

fn viewpoint(what: &str, view: &Viewpoint, lines: &mut Vec<String>) {
    let mut line = format!("  {:7}", format!("{what}:"));
    if let Some(camera) = &view.camera {
        let [x, y, z] = camera.position_m;
        let [a, b, c] = camera.looks.map(|d| (d * 1e3).round() / 1e3 + 0.0);
        line += &format!("the camera is at ({x:.3}, {y:.3}, {z:.3}) m in the base frame and looks ");
        if let Some(angle) = camera.from_down_rad {
            line += &format!("{}, ", direction(angle.to_degrees()));
        }
        line += &format!("along ({a:.3}, {b:.3}, {c:.3}); ");
    }
    match &view.axis {
        Some(axis) => {
            line += &format!(
                "{} axis meets the target's plane {:.3} m ahead, {:.0} mm from the target's middle",
                if view.camera.is_some() { "its" } else { "the camera's" },
                axis.ahead_m,
                axis.beside_m * 1e3
            );
        }
        None => line += "the optical axis does not meet the target's plane",
    }
    lines.push(line);
    lines.push(format!("         {}", points(&view.visibility)));
    lines.push(format!("         {}", visibility(&view.visibility)));
}

/// A direction in words.
fn direction(from_down_deg: f64) -> String {
    match from_down_deg {
        d if d < 1.0 => "straight down".into(),
        // chosen by hand: what is within 5 degrees of level looks level
        d if d < 85.0 => format!("down, {d:.0} deg from the plumb line"),
        // the same above the horizon, so that the words are alike
        d if d <= 95.0 => "level".into(),
        // chosen by hand: one degree from the plumb line is none to the eye, as below
        d if d > 179.0 => "straight up".into(),
        d => format!("up, {:.0} deg from the plumb line", 180.0 - d),
    }
}

pub(super) fn points(visibility: &Visibility) -> String {
    let place = |px: Option<[f64; 2]>| px.map_or("unseen".into(), |[u, v]| format!("({u:.1}, {v:.1})"));
    let turned = visibility.points.iter().filter(|point| !point.turned_away);
    let told = turned.filter(|point| visibility.points.len() <= TOLD_POINTS || !point.whole);
    let told: Vec<_> =
        told.take(TOLD_POINTS).map(|point| format!("{} {}", point.point, place(point.px))).collect();
    match (visibility.points.len() <= TOLD_POINTS, told.is_empty()) {
        (true, _) => format!("points, px: {}", told.join("  ")),
        (false, true) => format!("{} points", visibility.points.len()),
        (false, false) => format!("{} points; not whole, px: {}", visibility.points.len(), told.join("  ")),
    }
}

pub(super) fn visibility(visibility: &Visibility) -> String {
    let turned = visibility.points.iter().filter(|point| !point.turned_away).count();
    let marks = if !visibility.front {
        "the back of the target is seen".into()
    } else if visibility.is_edge_on() {
        format!(
            "the target is seen edge-on, {:.1} deg off its normal",
            visibility.sight_angle_rad.to_degrees()
        )
    } else if visibility.whole == turned {
        let which = if turned == visibility.points.len() {
            "points"
        } else {
            "points on faces that look at the camera"
        };
        format!("all of the target's {which} are in the image, {:.0} px from its border", visibility.room_px)
    } else if let Some(too_large) = visibility.too_large_in_words() {
        return format!("{} of {turned} points are whole: {too_large}", visibility.whole);
    } else {
        let cut =
            visibility.points.iter().filter(|point| !point.whole && !point.turned_away).take(TOLD_POINTS);
        let cut: Vec<_> = cut.map(PointVisibility::fault).collect();
        format!("{} of {turned} points are whole: {}", visibility.whole, cut.join(", "))
    };
    let plate = match &visibility.plate_outside {
        None => "; a part of the plate is not before the lens".into(),
        Some(outside) if outside.is_none() => "; so is all of the plate".into(),
        Some(outside) => format!("; the plate is cut: {}", Overhang::describe(outside)),
    };
    marks + &plate
}

fn list(q: &[f64]) -> String {
    let q: Vec<_> = q.iter().map(|q| format!("{:.4}", q + 0.0)).collect();
    format!("[{}]", q.join(", "))
}

fn ends(limits: &[(String, &'static str)]) -> String {
    let ends: Vec<_> = limits.iter().map(|(joint, end)| format!("`{joint}` at its {end} end")).collect();
    ends.join(", ")
}

pub(super) fn reach(reach: &Reach) -> String {
    match reach {
        Reach::Unasked { why } => format!("not looked at: {why}"),
        Reach::Within(Posture { q, nearest_limit, .. }) => {
            let room = nearest_limit.as_ref().map_or_else(String::new, |(joint, room)| {
                format!("; nearest to an end of its range is `{joint}`, {room:.2} from it")
            });
            format!("the arm reaches the goal with q = {}{room}", list(q))
        }
        Reach::Beyond { .. } => format!("the arm does not reach the goal: {}", nearest(reach)),
    }
}

/// How near the arm comes to a goal that it does not reach.
pub(super) fn nearest(reach: &Reach) -> String {
    let Reach::Beyond { nearest, off_m, off_rad, at_limits } = reach else { return String::new() };
    let held = if at_limits.is_empty() && nearest.q.len() < 6 {
        format!(" as far as {} joints can", nearest.q.len())
    } else if at_limits.is_empty() {
        " with the arm stretched out".into()
    } else {
        format!(" with {}", ends(at_limits))
    };
    let px = match nearest.error_px {
        px if px.is_nan() => "the target behind it".to_owned(),
        px => format!("{px:.1} px"),
    };
    format!(
        "the nearest pose of the camera is {:.1} mm and {:.2} deg off ({px}),{held}, q = {}",
        off_m * 1e3,
        off_rad.to_degrees(),
        list(&nearest.q)
    )
}

/// The message of a goal that cannot be reached; `None` for others.
pub(super) fn out_of_reach(ahead: &Preflight) -> Option<String> {
    let help = if ahead.goal_key == "servo.desired" {
        "change servo.desired or scene.object, or let `vservo place` propose both"
    } else {
        "teach the goal anew where this arm gets to (`vservo teach`), or change scene.object"
    };
    matches!(ahead.reach, Reach::Beyond { .. })
        .then(|| format!("the arm cannot bring the camera there: {}; {help}", nearest(&ahead.reach)))
}

/// How far from instability the law is: the condition of the text, and how the slowest error falls.
fn stability(stability: &Stability) -> [String; 2] {
    let of = |share: &dyn Fn(&Margins) -> f64| {
        let goal = stability
            .goal
            .as_ref()
            .map_or_else(String::new, |goal| format!(", {:.3} at the goal", share(goal)));
        format!("{:.3} at the start{goal}", share(&stability.start))
    };
    [
        format!(
            "L_s times the inverse of its estimate, (10.91), has the smallest eigenvalue {}; with the joints {} (symmetric part; above 0 every \
             error falls all the time, 1: the estimate is right)",
            of(&|m| m.camera.definite),
            of(&|m| m.joints.definite)
        ),
        format!(
            "the slowest error falls at this share of the gain: {}; with the joints {} (0 or less: unstable)",
            of(&|m| m.camera.slowest),
            of(&|m| m.joints.slowest)
        ),
    ]
}

/// The message of a law that is unstable at its goal.
pub(super) fn unstable(found: &Stability) -> String {
    let slowest = found.goal.map_or(f64::NAN, |goal| goal.joints.slowest);
    format!(
        "with what the law believes of depth, lens, mount and target its goal is unstable: the slowest error falls at {slowest:.3} times the gain; \
         compare servo.depth, [camera.lens], [camera.mount] and [target] with the scene"
    )
}

fn straight_way(way: &CameraPath) -> String {
    let [start, goal, least] = way.dexterity;
    let doubts = doubts(way);
    if doubts.is_empty() {
        format!(
            "straight to the goal no joint meets an end of its range; least singular value {least:.3} ({start:.3} at the start, {goal:.3} at \
             the goal)"
        )
    } else {
        doubts.join("; ")
    }
}

/// What speaks against the straight way.
pub(super) fn doubts(way: &CameraPath) -> Vec<String> {
    let [start, goal, least] = way.dexterity;
    let percent = |share: f64| share * 100.0;
    let mut doubts = Vec::new();
    if let Some(share) = way.leaves_at {
        doubts.push(format!(
            "the arm cannot follow the straight way to the goal farther than to {:.0} %{}: another start posture may lead there",
            percent(share),
            if way.limits.is_empty() { String::new() } else { format!(", {}", ends(&way.limits)) }
        ));
    } else if !way.limits.is_empty() {
        doubts.push(format!("on the straight way to the goal the arm has {}", ends(&way.limits)));
    }
    if way.singular {
        doubts.push(format!(
            "the straight way to the goal passes near a singular posture at {:.0} %: least singular value {least:.3} ({start:.3} at the \
             start, {goal:.3} at the goal)",
            percent(way.nearest_at)
        ));
    }
    doubts
}
