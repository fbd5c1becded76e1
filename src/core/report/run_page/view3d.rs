//! The cell in a true isometric view: all three axes of B are as long on paper.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

mod draw;

use super::errors::{camera_errors, cell_pose, frame_suffix};
use super::record::RunRecord;
use crate::report::isometric::Isometric;
use crate::report::numbers::significant;
use crate::report::page::{figure, heading};
use draw::draw;
use nalgebra::{Isometry3, Point3, Vector3};

/// The axis of B that is nearest to upwards.
fn upright(r: &RunRecord) -> Vector3<f64> {
    let up = -Vector3::from(r.gravity_B);
    let axes = [Vector3::z(), -Vector3::z(), Vector3::y(), -Vector3::y(), Vector3::x(), -Vector3::x()];
    axes.into_iter()
        .max_by(|a, b| a.dot(&up).total_cmp(&b.dot(&up)).then(std::cmp::Ordering::Greater))
        .unwrap_or(Vector3::z())
}

/// What is drawn, in B; without an arm in O.
struct CellDrawing {
    /// The way of the camera; of the target, where that is on the arm.
    path: Vec<Point3<f64>>,
    frames: Vec<(String, Isometry3<f64>)>,
    links: Vec<(bool, Vec<Point3<f64>>)>,
    plates: Vec<Vec<Point3<f64>>>,
}

fn cell(r: &RunRecord) -> CellDrawing {
    let mut cell = CellDrawing { path: path(r), frames: Vec::new(), links: Vec::new(), plates: Vec::new() };
    for (name, label) in [
        ("B", "B"),
        ("E_start", "E start"),
        ("E_end", "E end"),
        ("C_start", "C start"),
        ("C_end", "C end"),
        ("O_start", "O start"),
        ("O_end", "O end"),
        ("O", "O"),
        ("D", "D"),
    ] {
        if let Some(X) = cell_pose(r, name) {
            cell.frames.push((label.into(), X));
        }
    }
    let looked_for = r.targets_looked_for();
    for number in (1..=r.further_targets.len()).filter(|number| looked_for.contains(number)) {
        for (frame, when) in [("O", "_start"), ("O", "_end"), ("D", "")] {
            if let Some(X) = cell_pose(r, &format!("{frame}{number}{when}")) {
                cell.frames.push((format!("{frame} {}{}", r.target_name(number), when.replace('_', " ")), X));
            }
        }
    }
    if !r.has_arm {
        // The camera is where its own measurements put it.
        let posed: Vec<_> = (0..r.measurements.rows())
            .filter_map(|row| super::errors::pose(&r.measurements, "CO_", row))
            .collect();
        if let (Some(first), Some(last)) = (posed.first(), posed.last()) {
            cell.frames.extend([("C start".into(), first.inverse()), ("C end".into(), last.inverse())]);
        }
    }
    // What has not moved is one frame.
    let of_targets = (0..=r.further_targets.len()).map(|number| target_label(r, number));
    for label in of_targets.chain(["C".into(), "E".into()]) {
        let (start, end) = (format!("{label} start"), format!("{label} end"));
        let at = |name: &str| cell.frames.iter().position(|(n, _)| *n == name);
        if let Some((i, j)) = at(&start).zip(at(&end))
            && let (Some((_, a)), Some((_, b))) = (cell.frames.get(i), cell.frames.get(j))
            && (a.translation.vector - b.translation.vector).norm() < 1e-4
            && a.rotation.angle_to(&b.rotation) < 1e-3
        {
            cell.frames.remove(j);
            if let Some(frame) = cell.frames.get_mut(i) {
                frame.0 = label.clone();
            }
        }
    }
    let find = |name: &str| cell.frames.iter().find(|(n, _)| *n == name).map(|f| f.1);
    for when in ["start", "end"] {
        let joint = |k: usize| cell_pose(r, &format!("joint_{k}_{when}"));
        let joints: Vec<_> =
            (1..=r.joints.len()).filter_map(joint).map(|X| Point3::from(X.translation.vector)).collect();
        if !joints.is_empty() {
            let flange = cell_pose(r, &format!("E_{when}")).map(|X| Point3::from(X.translation.vector));
            cell.links.push((when == "end", joints.into_iter().chain(flange).collect()));
        }
    }
    let plates = std::iter::once(&r.plate_m).chain(r.further_targets.iter().map(|(_, plate_m)| plate_m));
    let mut drawn = Vec::new();
    for (number, [[x0, y0], [x1, y1]]) in plates.enumerate() {
        let corners =
            [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)].map(|(x, y)| Point3::new(*x, *y, 0.0));
        let label = target_label(r, number);
        let places = ["", " start", " end"].map(|when| find(&format!("{label}{when}")));
        drawn.extend(places.into_iter().flatten().map(|X| corners.iter().map(|p| X * p).collect()));
    }
    cell.plates = drawn;
    cell
}

/// The label of a target's frame.
fn target_label(r: &RunRecord, number: usize) -> String {
    if number == 0 { "O".into() } else { format!("O {}", r.target_name(number)) }
}

/// The way of the camera, or of what moves before it.
fn path(r: &RunRecord) -> Vec<Point3<f64>> {
    if !r.has_arm {
        let poses =
            (0..r.measurements.rows()).filter_map(|row| super::errors::pose(&r.measurements, "CO_", row));
        return poses.map(|X_CO| Point3::from(X_CO.inverse().translation.vector)).collect();
    }
    let frame = if r.eye_in_hand { "C" } else { "E" };
    let column = |axis: &str| r.trace.numbers(&format!("{frame}_{axis}_m"));
    let points =
        column("x").iter().zip(column("y")).zip(column("z")).map(|((x, y), z)| Point3::new(*x, *y, *z));
    points.filter(|p| p.coords.iter().all(|v| v.is_finite())).collect()
}

fn says(r: &RunRecord, path: &[Point3<f64>]) -> String {
    const STEP_M: f64 = 5e-4;
    let mut at = None::<Point3<f64>>;
    let mut length = 0.0;
    for p in path {
        let step = at.map_or(f64::INFINITY, |at| (p - at).norm());
        if step > STEP_M {
            length += if at.is_some() { step } else { 0.0 };
            at = Some(*p);
        }
    }
    let who = if r.eye_in_hand || !r.has_arm { "camera" } else { "flange with the target" };
    let straight = path.first().zip(path.last()).map_or(0.0, |(a, b)| (b - a).norm());
    if path.is_empty() {
        return "Nothing is known of where the camera was.".into();
    }
    if length < STEP_M {
        return format!("The {who} stands still.");
    }
    let mut text = format!("The {who} moves {} m", significant(length, 3));
    if straight > 10.0 * STEP_M {
        text += &format!(", {} times the straight line", significant(length / straight, 3));
    }
    // The goal at the end is that of the target that was looked for last.
    let last = r.spells().last().map_or(0, |spell| spell.target);
    let D = cell_pose(r, &format!("D{}", frame_suffix(last)));
    let name = if last == 0 { "D".to_owned() } else { format!("D {}", r.target_name(last)) };
    match (cell_pose(r, "C_end"), D, camera_errors(r).last()) {
        (Some(C), Some(D), _) => {
            let mm = (D.translation.vector - C.translation.vector).norm() * 1e3;
            let ends = if r.eye_in_hand { "ends" } else { "the camera ends" };
            text += &format!(", and {ends} {} mm from {name}", significant(mm, 2));
        }
        (_, _, Some((_, [_, mm, _]))) => {
            text += &format!(", and ends {} mm from {name} as measured", significant(*mm, 2))
        }
        _ => {}
    }
    text + "."
}

/// The figure.
pub(super) fn view3d(r: &RunRecord) -> String {
    const TITLE: &str = "The way of the camera in space";
    let cell = cell(r);
    if cell.path.is_empty() && cell.frames.len() < 2 {
        return heading(TITLE, &says(r, &cell.path));
    }
    let system = if r.has_arm { "B" } else { "O" };
    let view = best_view(r, &cell);
    let near = cell.about_the_way();
    let mut scenes = vec![SceneDrawing::new("the whole cell", cell)];
    scenes.extend(near.map(|near| SceneDrawing::new("about the way", near)));
    let lengths: Vec<String> = scenes.iter().map(|s| format!("{} m", significant(s.axis_m, 2))).collect();
    let of = if r.targets_looked_for().len() > 1 { ", of each target that was looked for" } else { "" };
    let note = format!(
        "True isometric views in {system}, upwards is up: equal lengths along x, y and z are equally long on paper. Axes of frames (x orange, \
         y green, z blue) are {} long. E flange, C camera, O target, D where the camera is to be{of}. Grey: the links of the arm, pale at the start.",
        lengths.join(" and ")
    );
    let path = scenes.first().map(|s| s.cell.path.clone()).unwrap_or_default();
    figure(TITLE, &says(r, &path), &note, |width| draw(&scenes, &view, width))
}

/// What is drawn in one place, and how long its axes are.
struct SceneDrawing {
    title: &'static str,
    cell: CellDrawing,
    axis_m: f64,
}

impl SceneDrawing {
    fn new(title: &'static str, cell: CellDrawing) -> Self {
        let origins = cell.frames.iter().map(|f| Point3::from(f.1.translation.vector));
        let all: Vec<Point3<f64>> = cell.points().copied().chain(origins).collect();
        let reach = |i: usize| {
            let values = || all.iter().map(|p| p[i]);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let size = 0.15 * reach(0).max(reach(1)).max(reach(2));
        let power = 10f64.powf(size.max(1e-4).log10().floor());
        let axis_m = [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|s| *s <= size).unwrap_or(power);
        Self { title, cell, axis_m }
    }

    /// Tips of a frame's axes.
    fn tips(&self, X: &Isometry3<f64>) -> [Point3<f64>; 3] {
        let origin = Point3::from(X.translation.vector);
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|a| origin + X.rotation * a * self.axis_m)
    }
}

impl CellDrawing {
    /// All points of its lines.
    fn points(&self) -> impl Iterator<Item = &Point3<f64>> {
        let lines = self.links.iter().map(|l| &l.1).chain(&self.plates);
        self.path.iter().chain(lines.flatten())
    }

    /// The way and the frames at it; `None` where it is not small before the rest, or is none.
    fn about_the_way(&self) -> Option<Self> {
        let first = self.path.first()?;
        let reach = self.path.iter().map(|p| (p - first).norm()).fold(0.0, f64::max);
        let whole = self.points().map(|p| (p - first).norm()).fold(0.0, f64::max);
        let is_near = |X: &Isometry3<f64>| {
            self.path.iter().any(|p| (p.coords - X.translation.vector).norm() < 0.6 * reach)
        };
        (reach > 1e-3 && reach < 0.5 * whole).then(|| Self {
            path: self.path.clone(),
            frames: self.frames.iter().filter(|f| is_near(&f.1)).cloned().collect(),
            links: Vec::new(),
            plates: Vec::new(),
        })
    }
}

/// The quarter from which fewest frames lie behind each other, and of those the one that sees the way at its longest.
fn best_view(r: &RunRecord, cell: &CellDrawing) -> Isometric {
    let up = upright(r);
    let origins: Vec<Point3<f64>> =
        cell.frames.iter().map(|f| Point3::from(f.1.translation.vector)).collect();
    let size = cell.points().chain(&origins).map(|p| (p - Point3::origin()).norm()).fold(0.0, f64::max);
    let behind = |view: &Isometric| {
        let pairs =
            origins.iter().enumerate().flat_map(|(i, a)| origins.iter().skip(i + 1).map(move |b| (a, b)));
        let apart = |a: &Point3<f64>, b: &Point3<f64>| {
            let ([x, y], [u, v]) = (view.flat(a), view.flat(b));
            (x - u).hypot(y - v)
        };
        pairs.filter(|(a, b)| (*a - *b).norm() > 0.1 * size && apart(a, b) < 0.05 * size).count()
    };
    let span = |view: &Isometric| {
        let flat: Vec<[f64; 2]> = cell.path.iter().map(|p| view.flat(p)).collect();
        let reach = |i: usize| {
            let values = || flat.iter().filter_map(|p| p.get(i).copied());
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let diagonal = reach(0).hypot(reach(1));
        if diagonal.is_finite() { diagonal } else { 0.0 }
    };
    let better = |b: &Isometric, a: &Isometric| {
        behind(b) < behind(a) || (behind(b) == behind(a) && span(b) > 1.05 * span(a))
    };
    let views = (0..4).map(|quarter| Isometric::new(&up, quarter));
    let best = views.reduce(|a, b| if better(&b, &a) { b } else { a });
    best.unwrap_or(Isometric::new(&up, 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::csv_table::CsvTable;

    #[test]
    fn equal_lengths_are_equal_and_up_is_up() {
        for up in [Vector3::z(), -Vector3::z(), Vector3::x(), -Vector3::y()] {
            for quarter in 0..4 {
                let view = Isometric::new(&up, quarter);
                for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                    let [u, v] = view.flat(&Point3::from(axis));
                    assert!((u.hypot(v) - (2.0_f64 / 3.0).sqrt()).abs() < 1e-12);
                }
                let [u, v] = view.flat(&Point3::from(up));
                assert!(u.abs() < 1e-12 && v > 0.8);
                // no mirror image: the eye, rightwards and upwards are a right-handed system
                let eye = view.right.cross(&view.up);
                assert!(eye.dot(&up) > 0.5);
            }
        }
    }

    #[test]
    fn frames_at_one_place_share_a_label() {
        let poses = "frame,x_m,y_m,z_m,qx,qy,qz,qw\nB,0,0,0,0,0,0,1\nE_start,1,0,0,0,0,0,1\nE_end,1,1,0,0,0,0,1\nC_start,1,0,0,0,0,0,1\n\
                     C_end,1,1,0,0,0,0,1\nO_start,2,2,0,0,0,0,1\nO_end,2,2,0,0,0,0,1\nD,1,1.001,0,0,0,0,1\n";
        let r = RunRecord {
            has_arm: true,
            eye_in_hand: true,
            gravity_B: [0.0, 0.0, -9.81],
            poses: CsvTable::parse(poses),
            trace: CsvTable::parse("C_x_m,C_y_m,C_z_m\n1,0,0\n1,0.5,0\n1,1,0\n"),
            ..RunRecord::default()
        };
        let html = view3d(&r);
        for part in [
            ">B<",
            ">E start = C start<",
            ">E end = C end = D<",
            ">O<",
            "1.00 m, 1.00 times",
            "ends 1.0 mm from D",
        ] {
            assert!(html.contains(part), "{part}");
        }
        assert!(view3d(&RunRecord::default()).contains("Nothing is known"));
    }
}
