//! `vservo view [CONFIG] --out FILE.png|FILE.svg`: what the camera sees at the start and at the goal, side by side.
//!
//! ```text
//! Preflight ─► poses of the object ─► renderer ─► grey images ─┐
//!        └─► marks, axes, the features' way, words ────────────┴─► Sheet ─► png | svg
//! ```
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

mod cell;
mod sheet;

use super::{ViewArguments, check_writable, shown, write_result};
use crate::camera_model::CameraModel;
use crate::config::assemble::{AssembleError, renderer};
use crate::config::{Config, Draft, FIRST_TARGET, ProgramGoal, Source, TargetGoal};
use crate::geometry::Pose;
use crate::input::printable;
use crate::process::ProcessError;
use crate::rt::tell;
use crate::scene::{PointVisibility, Renderer, SceneLook, SensorModel, Visibility};
use crate::sim::preflight::{Preflight, Reach, Viewpoint};
use crate::target::Target;
use image::GrayImage;
use nalgebra::{Point3, Vector2, Vector3};
use sheet::{Colour, ImagePanel, ImageSheet};

/// What the colours mean.
const LEGEND: &str = "  drawn: green: points; orange: their ways when the camera goes straight to the goal; magenta ring: where the optical \
                      axis goes; blue cross: middle of the image; x, y, z: the object's frame, z away from the camera; red: what is \
                      outside";
/// The same of the cell.
const LEGEND_OF_CELL: &str = "  the cell, isometric: black: the arm at the start, orange: at the goal, with the spheres that are kept inside of planes and boxes; red: \
                              planes and boxes of [workspace]; green: the target";
/// Of more points than these the numbers stay out of the image.
const NUMBERED: usize = 16;
/// How far from the border of the image what is outside is told, px.
const INSIDE_PX: f64 = 14.0;
/// The name of a target stands so far below its lowest point, px.
const NAME_BELOW_PX: f64 = 8.0;

/// # Errors
/// When the run file is wrong.
pub(super) fn view(arguments: &ViewArguments) -> Result<u8, ProcessError> {
    let extension = arguments.out.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let write = match extension.to_ascii_lowercase().as_str() {
        "png" => ImageSheet::png,
        "svg" => ImageSheet::svg,
        _ => {
            tell(format_args!("vservo: --out: the name must end in .png or .svg"));
            return Ok(2);
        }
    };
    // a run file whose target is out of the image is refused by all others: here is where one sees it
    let draft = Draft::load(arguments.config.as_deref(), &arguments.set)?;
    let config = draft.validate_whatever_is_seen()?;
    let preflight = Preflight::of(&config)?.with_names(&config)?;
    check_writable(&arguments.out)?;
    let sheet = draw(&config, &preflight)?;
    let Some(bytes) = write(&sheet) else {
        tell(format_args!("vservo: --out: the image cannot be encoded"));
        return Ok(1);
    };
    let code = write_result(&arguments.out, bytes, 0);
    if code != 0 {
        return Ok(code);
    }
    let mut text = format!("{}: written\n", printable(&arguments.out.display().to_string()));
    for line in preflight.lines() {
        text += &(printable(&line) + "\n");
    }
    Ok(shown(&text, 0))
}

fn draw(config: &Config, preflight: &Preflight) -> Result<ImageSheet, ProcessError> {
    let mut panels = Vec::new();
    if let (Some(view), Some(scene)) = (&preflight.start, &config.scene) {
        let image = rendered(renderer(config)?, &view.X_CO);
        let mut panel = ImagePanel::new("START", image);
        way(&mut panel, config, preflight, &scene.camera);
        annotate(&mut panel, view, &scene.target, &scene.camera);
        name_targets(&mut panel, config, FIRST_TARGET, &view.X_CO, &scene.camera);
        panels.push(panel);
    }
    if let Some(view) = &preflight.goal {
        panels.push(goal(FIRST_TARGET, config, view, &preflight.reach)?);
    }
    for ahead in &preflight.targets {
        let of = TargetGoal { goal: ProgramGoal::Present, target: Some(ahead.name.clone()) };
        if let (Some(view), Some(led)) = (&ahead.goal, config.with_goal(&of)) {
            panels.push(goal(&ahead.name, &led, view, &ahead.reach)?);
        }
    }
    let i = config.camera.model.intrinsics();
    let cell = cell::cell(config, preflight, [i.width_px, i.height_px])?;
    let limited = cell.is_some();
    panels.extend(cell);
    let mut lines = preflight.lines();
    lines.push(LEGEND.into());
    if limited {
        lines.push(LEGEND_OF_CELL.into());
    }
    Ok(ImageSheet { panels, lines })
}

/// The view of the first target of `config` at its goal.
fn goal(name: &str, config: &Config, view: &Viewpoint, reach: &Reach) -> Result<ImagePanel, ProcessError> {
    let several = !config.further_targets.is_empty();
    let title = if several { format!("GOAL OF {}", printable(name)) } else { "GOAL".into() };
    let mut panel = ImagePanel::new(title, rendered(believed(config)?, &view.X_CO));
    annotate(&mut panel, view, &config.target, &config.camera.model);
    name_targets(&mut panel, config, name, &view.X_CO, &config.camera.model);
    if matches!(reach, Reach::Beyond { .. }) {
        panel.label(Vector2::new(8.0, 28.0), "OUT OF REACH", Colour::Outside);
    }
    Ok(panel)
}

/// The names of several targets, and the further ones where they are in the view in which the first one, `name`, is at `X_CO`.
fn name_targets(panel: &mut ImagePanel, config: &Config, name: &str, X_CO: &Pose, camera: &CameraModel) {
    let Some(scene) = &config.scene else { return };
    if let (Some(place), false) =
        (camera.project(&(X_CO * Point3::origin())), config.further_targets.is_empty())
    {
        panel.free_label(place + Vector2::new(8.0, NAME_BELOW_PX), &printable(name), Colour::Point);
    }
    for (further, (target, X_OT)) in config.further_targets.iter().zip(scene.further_in_first()) {
        let X_CT = X_CO * X_OT;
        let visibility = Visibility::of(target, camera, &X_CT);
        let name = printable(&further.name);
        let i = camera.intrinsics();
        let size = Vector2::new(f64::from(i.width_px), f64::from(i.height_px));
        let whole = visibility.points.iter().filter(|point| point.whole && visibility.front);
        let seen: Vec<_> = whole.filter_map(|point| point.px).collect();
        for [u, v] in &seen {
            panel.cross(Vector2::new(*u, *v), 4.0, Colour::Point);
        }
        let Some(lowest) = seen.iter().copied().reduce(|a, b| if b[1] > a[1] { b } else { a }) else {
            let middle = camera.project(&(X_CT * Point3::origin()));
            let place = middle.map_or(Vector2::zeros(), |px| px.inf(&size)).sup(&Vector2::repeat(8.0));
            let room = size - Vector2::new(12.0 * (name.chars().count() as f64 + 18.0), 22.0);
            panel.free_label(place.inf(&room), &format!("{name}: OUT OF THE IMAGE"), Colour::Outside);
            continue;
        };
        axes(panel, &X_CT, target, camera);
        panel.free_label(Vector2::from(lowest) + Vector2::new(8.0, NAME_BELOW_PX), &name, Colour::Point);
    }
}

/// What renders the goal: camera and target as they are believed to be.
fn believed(config: &Config) -> Result<Renderer, ProcessError> {
    let (look, sensor) = match &config.camera.source {
        Source::Synthetic { look, sensor, .. } => (*look, *sensor),
        _ => (SceneLook::default(), SensorModel::default()),
    };
    let renderer = Renderer::new(config.camera.model, config.target.clone(), look, sensor)
        .map_err(AssembleError::from)?;
    Ok(match &config.scene {
        Some(scene) => {
            let renderer = renderer.with_backdrop(scene.backdrop).map_err(AssembleError::from)?;
            renderer.with_bystanders(&scene.bystanders).with_further_targets(scene.further_in_first())
        }
        None => renderer,
    })
}

fn rendered(mut renderer: Renderer, X_CO: &Pose) -> GrayImage {
    let i = renderer.camera().intrinsics();
    let mut image = GrayImage::new(i.width_px, i.height_px);
    renderer.render(&[*X_CO], 0, &mut image);
    image
}

/// Ways of the points from the start to the goal, on the camera's straight way.
fn way(panel: &mut ImagePanel, config: &Config, preflight: &Preflight, camera: &CameraModel) {
    let Some(way) = &preflight.way else { return };
    for point in config.target.features() {
        let places = way.X_CO.iter().map(|X_CO| camera.project(&(X_CO * point.p_O)));
        let places: Vec<_> = places.collect();
        for pair in places.windows(2) {
            if let [Some(from), Some(to)] = pair {
                panel.line(*from, *to, Colour::Way);
            }
        }
        if let Some(Some(end)) = places.last() {
            panel.ring(*end, 4.0, Colour::Way);
        }
    }
}

/// Numbers, axes, the middle of the image, where the optical axis goes, and what is outside.
fn annotate(panel: &mut ImagePanel, view: &Viewpoint, target: &Target, camera: &CameraModel) {
    let i = camera.intrinsics();
    let size = Vector2::new(f64::from(i.width_px), f64::from(i.height_px));
    let middle = size * 0.5 - Vector2::repeat(0.5);
    panel.cross(middle, 9.0, Colour::Middle);
    axes(panel, &view.X_CO, target, camera);
    if view.axis.is_some() {
        let foot = Vector2::new(i.cx_px, i.cy_px);
        panel.ring(foot, 7.0, Colour::Axis);
        panel.cross(foot, 3.0, Colour::Axis);
    }
    for point in view.visibility.points.iter().filter(|point| !point.turned_away) {
        mark(panel, point, view.visibility.points.len(), &size, &middle);
    }
    if !view.visibility.front {
        panel.label(Vector2::new(8.0, 8.0), "BACK OF THE TARGET", Colour::Outside);
    }
}

fn mark(
    panel: &mut ImagePanel,
    point: &PointVisibility,
    count: usize,
    size: &Vector2<f64>,
    middle: &Vector2<f64>,
) {
    let Some([u, v]) = point.px else {
        if count <= NUMBERED {
            let row = 30.0 + 18.0 * point.point as f64;
            panel.label(
                Vector2::new(8.0, row),
                &format!("{} NOT BEFORE THE LENS", point.point),
                Colour::Outside,
            );
        }
        return;
    };
    let px = Vector2::new(u, v);
    if point.whole {
        panel.cross(px, 4.0, Colour::Point);
        if count <= NUMBERED {
            panel.label(px + Vector2::new(6.0, -18.0), &point.point.to_string(), Colour::Point);
        }
        return;
    }
    // at the border, towards where it is
    let at = px.sup(&Vector2::repeat(INSIDE_PX)).inf(&(size - Vector2::repeat(INSIDE_PX)));
    let back = (middle - at).try_normalize(1e-9).unwrap_or_else(Vector2::x) * 24.0;
    panel.line(at + back, at, Colour::Outside);
    panel.ring(at, 6.0, Colour::Outside);
    let o = &point.outside;
    let farthest_px = o.left_px.max(o.right_px).max(o.above_px).max(o.below_px);
    let text = if farthest_px > 0.0 {
        format!("{}: {farthest_px:.0} PX OUT", point.point)
    } else {
        format!("{}: AT THE BORDER", point.point)
    };
    let room = Vector2::new(12.0 * text.len() as f64 + 4.0, 18.0);
    let place = (at + back).inf(&(size - room)).sup(&Vector2::repeat(2.0));
    panel.free_label(place, &text, Colour::Outside);
}

/// The axes of the object's frame, from its origin.
fn axes(panel: &mut ImagePanel, X_CO: &Pose, target: &Target, camera: &CameraModel) {
    let plate = target.plate();
    let length_m = 0.3 * (plate.high_m - plate.low_m).amin();
    let project = |p: Point3<f64>| camera.project(&(X_CO * p));
    let axes =
        [(Vector3::x(), "X", Colour::X), (Vector3::y(), "Y", Colour::Y), (Vector3::z(), "Z", Colour::Z)];
    for (axis, name, colour) in axes {
        let ends = (project(Point3::origin()), project(Point3::from(axis * length_m)));
        if let (Some(from), Some(to)) = ends {
            panel.line(from, to, colour);
            panel.line(from + Vector2::new(0.0, 1.0), to + Vector2::new(0.0, 1.0), colour);
            // an axis that points at the camera has no room for its name
            if (to - from).norm() > 12.0 {
                panel.label(to + Vector2::new(3.0, 3.0), name, colour);
            }
        }
    }
}
