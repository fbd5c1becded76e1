//! The scenes on paper.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::SceneDrawing;
use crate::report::chart::{Anchor, Area, Canvas, Width};
use crate::report::isometric::Isometric;
use nalgebra::{Point3, Vector3};

/// The scenes side by side, or one below the other.
pub(super) fn draw(scenes: &[SceneDrawing], view: &Isometric, width: Width) -> String {
    let mut canvas = Canvas::new(width, f64::INFINITY);
    let h = canvas.letters();
    let columns = if width == Width::Narrow { 1 } else { scenes.len().max(1) };
    let each = (width.units() - 2.0 * h * (columns as f64 - 1.0)) / columns as f64;
    let (mut y, mut bottom) = (0.0, 0.0);
    for (i, scene) in scenes.iter().enumerate() {
        let column = i % columns;
        if column == 0 {
            y = bottom;
        }
        let left = column as f64 * (each + 2.0 * h);
        bottom = f64::max(bottom, draw_scene(&mut canvas, scene, view, [left, y], each));
    }
    canvas.set_height(bottom);
    canvas.finish(&format!("chart {}", width.class()), "isometric views of the cell")
}

fn draw_scene(
    canvas: &mut Canvas,
    scene: &SceneDrawing,
    view: &Isometric,
    [left, top]: [f64; 2],
    width: f64,
) -> f64 {
    let h = canvas.letters();
    canvas.text("t tb", [left, top + 1.35 * h], Anchor::Start, scene.title);
    let cell = &scene.cell;
    let tips = cell
        .frames
        .iter()
        .flat_map(|(_, X)| scene.tips(X).into_iter().chain([Point3::from(X.translation.vector)]));
    let flat: Vec<[f64; 2]> = cell.points().copied().chain(tips).map(|p| view.flat(&p)).collect();
    let nothing = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let bounds: Area =
        flat.iter().fold(nothing, |b, p| [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])]);
    let margin = 3.0 * h;
    let (room_x, room_y) = (width - 2.0 * margin, 0.72 * width);
    let scale = (room_x / (bounds[2] - bounds[0]).max(1e-6)).min(room_y / (bounds[3] - bounds[1]).max(1e-6));
    let (x0, y0) = (left + 0.5 * (width - scale * (bounds[2] - bounds[0])), top + 1.5 * h + margin);
    let place = |p: &Point3<f64>| {
        let [x, y] = view.flat(p);
        [x0 + scale * (x - bounds[0]), y0 + scale * (bounds[3] - y)]
    };
    for (is_end, joints) in &cell.links {
        canvas.path(if *is_end { "link" } else { "link faded" }, joints.iter().map(place));
    }
    for plate in &cell.plates {
        canvas.path("plate", plate.iter().map(place));
    }
    canvas.path(
        "c3 line",
        cell.path.iter().map(place).fold(Vec::new(), |mut kept: Vec<[f64; 2]>, p| {
            if kept.last().is_none_or(|k| (k[0] - p[0]).abs().max((k[1] - p[1]).abs()) > 0.7) {
                kept.push(p);
            }
            kept
        }),
    );
    // What has its origin at the same place on paper has one label, which says whether it is the same place in space.
    let mut labels: Vec<([f64; 2], Vector3<f64>, String)> = Vec::new();
    for (name, X) in &cell.frames {
        let p = X.translation.vector;
        let origin = place(&Point3::from(p));
        for (tip, class) in scene.tips(X).iter().zip(["axis-x", "axis-y", "axis-z"]) {
            canvas.path(class, [origin, place(tip)]);
        }
        match labels.iter_mut().find(|(at, ..)| (at[0] - origin[0]).hypot(at[1] - origin[1]) < 7.0) {
            Some((_, q, label)) if (p - *q).norm() * scale < 10.0 => *label += &format!(" = {name}"),
            Some((.., label)) => *label += &format!(", {name} behind each other"),
            None => labels.push((origin, p, (*name).to_owned())),
        }
    }
    for (at, _, label) in &labels {
        canvas.label("t tb halo", *at, label);
    }
    y0 + scale * (bounds[3] - bounds[1]) + margin
}
