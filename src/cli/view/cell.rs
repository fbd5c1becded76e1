//! The cell from aside, where limits in space are set: the arm at the start and at the goal with the spheres that are kept inside, the target, and the planes and
//! boxes. An isometric view of B; upwards is against gravity.
//!
//! The numbers here are layout, and were chosen by eye.

use super::sheet::{Colour, ImagePanel};
use crate::config::Config;
use crate::input::printable;
use crate::motion::{ArmPlaces, HalfSpace, WorkspaceSettings, checked_points};
use crate::process::ProcessError;
use crate::report::isometric::Isometric;
use crate::robot::Robot;
use crate::sim::preflight::{Preflight, Reach};
use crate::target::Target;
use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Point3, SVector, Vector2, Vector3};

/// Background, as paper.
const PAPER: Luma<u8> = Luma([250]);
/// Share of the panel that what is fitted into it takes.
const FILLED: f64 = 0.8;
/// How much farther than the arm's own size walls are drawn.
const WALLS: f64 = 0.6;

/// A normal along an axis of B, and how far away a wall along one is drawn, in units of the other walls' reach.
const ALONG: f64 = 0.9999;
const NEAR: f64 = 4.0;

/// Lines, spheres and words in B.
#[derive(Default)]
struct CellLines {
    lines: Vec<([Point3<f64>; 2], Colour)>,
    spheres: Vec<(Point3<f64>, f64, Colour)>,
    words: Vec<(Point3<f64>, String, Colour)>,
}

/// The panel; `None` where no place is limited.
pub(super) fn cell(
    config: &Config,
    preflight: &Preflight,
    size: [u32; 2],
) -> Result<Option<ImagePanel>, ProcessError> {
    let Some(space) =
        config.workspace.as_ref().filter(|space| !space.sides.is_empty() || space.self_collision)
    else {
        return Ok(None);
    };
    let cell = crate::dispatch_robot!(config.robot, |robot| cell_of(&robot, config, space, preflight))?;
    Ok(Some(cell.panel(&up(config), size)))
}

/// The axis of B that is nearest to upwards.
fn up(config: &Config) -> Vector3<f64> {
    let up = -config.robot.gravity_B;
    let i = up.iamax();
    let mut axis = Vector3::zeros();
    axis[i] = if up[i] < 0.0 { -1.0 } else { 1.0 };
    if up.norm() > 0.0 { axis } else { Vector3::z() }
}

fn cell_of<const N: usize>(
    robot: &Robot<N>,
    config: &Config,
    space: &WorkspaceSettings,
    preflight: &Preflight,
) -> CellLines {
    let mut cell = CellLines::default();
    let posture = |q: &[f64]| SVector::<f64, N>::from_fn(|i, _| q.get(i).copied().unwrap_or(0.0));
    if let Reach::Within(goal) | Reach::Beyond { nearest: goal, .. } = &preflight.reach {
        cell.arm(robot, space, &posture(&goal.q), Colour::Way, "GOAL");
    }
    let start = posture(&config.start.q);
    cell.arm(robot, space, &start, Colour::Words, "START");
    if let Some(view) = &preflight.start {
        cell.plate(&config.target, &(config.camera.mount.X_WC(robot, &start) * view.X_CO));
    }
    let (low, high) = cell.bounds();
    let walls = Vector3::repeat(WALLS * (high - low).max());
    let (mut least, mut most) = (low - walls, high + walls);
    // Walls along the axes of B that are not far away are seen whole.
    for side in &space.sides {
        let i = side.normal.iamax();
        let at = side.offset_m * side.normal[i];
        if side.normal[i].abs() > ALONG && (low[i] - NEAR * walls[i]..high[i] + NEAR * walls[i]).contains(&at)
        {
            (least[i], most[i]) = (least[i].min(at), most[i].max(at));
        }
    }
    cell.walls(&space.sides, least, most);
    cell
}

impl CellLines {
    fn line(&mut self, from: Point3<f64>, to: Point3<f64>, colour: Colour) {
        self.lines.push(([from, to], colour));
    }

    /// The joints and the flange, one after the other, and the spheres that are kept inside.
    fn arm<const N: usize>(
        &mut self,
        robot: &Robot<N>,
        space: &WorkspaceSettings,
        q: &SVector<f64, N>,
        colour: Colour,
        name: &str,
    ) {
        let (skeleton, places) = (robot.skeleton(q), ArmPlaces::of(robot, space, q));
        let joints = (0..N).map(|i| skeleton.origin(i)).chain([skeleton.on_flange(&Vector3::zeros())]);
        let chain: Vec<_> = [Point3::origin()].into_iter().chain(joints.map(Point3::from)).collect();
        chain.windows(2).for_each(|pair| self.line(pair[0], pair[1], colour));
        for point in checked_points(robot, space) {
            self.spheres.push((Point3::from(point.at(&places)), point.radius_m, colour));
        }
        if let Some(end) = chain.last() {
            self.words.push((*end, name.to_owned(), colour));
        }
    }

    fn plate(&mut self, target: &Target, X_BO: &Isometry3<f64>) {
        let (low, high) = (target.plate().low_m, target.plate().high_m);
        let corners = [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)];
        let corners = corners.map(|(x, y)| X_BO * Point3::new(x, y, 0.0));
        (0..4).for_each(|i| self.line(corners[i], corners[(i + 1) % 4], Colour::Y));
        self.words.push((corners[0], "TARGET".into(), Colour::Y));
    }

    /// Ends of what is drawn.
    fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let points = self.lines.iter().flat_map(|(ends, _)| ends).map(|p| p.coords);
        points.fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(low, high), p| {
            (low.inf(&p), high.sup(&p))
        })
    }

    /// The part of each wall between `low` and `high` that no other wall cuts off: a box is seen as one.
    fn walls(&mut self, sides: &[HalfSpace], low: Vector3<f64>, high: Vector3<f64>) {
        let mut all = sides.to_vec();
        for i in 0..3 {
            let axis = Vector3::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
            all.push(HalfSpace { name: String::new(), normal: axis, offset_m: low[i] });
            all.push(HalfSpace { name: String::new(), normal: -axis, offset_m: -high[i] });
        }
        let mut named: Vec<&str> = Vec::new();
        for (k, side) in sides.iter().enumerate() {
            let face = all
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != k)
                .fold(large_face(side, (high - low).norm()), |face, (_, other)| cut(&face, other));
            for (i, corner) in face.iter().enumerate() {
                self.line(*corner, face[(i + 1) % face.len()], Colour::Outside);
            }
            if let Some(first) = face.first()
                && !named.contains(&side.name.as_str())
            {
                self.words.push((*first, printable(&side.name), Colour::Outside));
                named.push(&side.name);
            }
        }
    }

    fn panel(&self, up: &Vector3<f64>, [width, height]: [u32; 2]) -> ImagePanel {
        let view = Isometric::new(up, 0);
        let flat = |p: &Point3<f64>| {
            let [x, y] = view.flat(p);
            Vector2::new(x, -y)
        };
        let ends = self.lines.iter().flat_map(|(ends, _)| ends).map(flat);
        let (low, high) = ends
            .fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), p| {
                (low.inf(&p), high.sup(&p))
            });
        let room = Vector2::new(f64::from(width), f64::from(height));
        let scale = FILLED * room.component_div(&(high - low).map(|x| x.max(1e-6))).min();
        let place = |p: &Point3<f64>| (flat(p) - (low + high) * 0.5) * scale + room * 0.5;
        let mut panel = ImagePanel::new("CELL", GrayImage::from_pixel(width, height, PAPER));
        for (ends, colour) in &self.lines {
            panel.line(place(&ends[0]), place(&ends[1]), *colour);
        }
        // In a true isometric view lengths are foreshortened by the root of 2/3, and a sphere is seen with its own radius.
        for (center, radius_m, colour) in &self.spheres {
            panel.ring(place(center), radius_m * scale, *colour);
        }
        for (at, words, colour) in &self.words {
            panel.free_label(place(at) + Vector2::new(6.0, 4.0), words, *colour);
        }
        panel
    }
}

/// A square of the plane of `side` about the foot of B's origin, as large as everything.
fn large_face(side: &HalfSpace, size_m: f64) -> Vec<Point3<f64>> {
    let foot = side.normal * side.offset_m;
    let other = if side.normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let a = side.normal.cross(&other).normalize();
    let b = side.normal.cross(&a);
    let reach = size_m + foot.norm();
    [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
        .map(|(u, v)| Point3::from(foot + (a * u + b * v) * reach))
        .to_vec()
}

/// The part of a convex face that is inside of `side` (Sutherland and Hodgman).
fn cut(face: &[Point3<f64>], side: &HalfSpace) -> Vec<Point3<f64>> {
    let mut kept = Vec::new();
    for (i, p) in face.iter().enumerate() {
        let q = face[(i + 1) % face.len()];
        let (a, b) = (side.depth_m(&p.coords), side.depth_m(&q.coords));
        // Faces of one plane do not cut each other.
        const SAME_M: f64 = 1e-9;
        if a >= -SAME_M {
            kept.push(*p);
        }
        if (a > SAME_M && b < -SAME_M) || (a < -SAME_M && b > SAME_M) {
            kept.push(p + (q - p) * (a / (a - b)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(set: &[&str]) -> CellLines {
        let set: Vec<String> = set.iter().map(ToString::to_string).collect();
        let config = Config::load(Some(std::path::Path::new("ur5")), &set).unwrap();
        let preflight = Preflight::of(&config).unwrap();
        let space = config.workspace.clone().unwrap();
        crate::dispatch_robot!(config.robot, |robot| cell_of(&robot, &config, &space, &preflight)).unwrap()
    }

    #[test]
    fn a_box_has_twelve_edges_and_a_plane_four() {
        let box_ = "workspace.boxes=[{ name = 'cell', min_m = [-0.9, -0.9, -0.1], max_m = [0.9, 0.9, 1.2] }]";
        let walls = |cell: &CellLines| -> Vec<[Point3<f64>; 2]> {
            cell.lines
                .iter()
                .filter(|(_, colour)| *colour == Colour::Outside)
                .map(|(ends, _)| *ends)
                .collect()
        };
        let edges = walls(&lines(&[box_]));
        // each edge is one of two faces
        assert_eq!(edges.len(), 24);
        for p in edges.iter().flatten() {
            let corner = [p.x.abs() - 0.9, p.y.abs() - 0.9, (p.z - 0.55).abs() - 0.65];
            assert!(corner.iter().all(|x| x.abs() < 1e-9), "{p}");
        }
        let plane = lines(&[
            "workspace.planes=[{ name = 'table', point_m = [0.0, 0.0, -0.05], normal = [0.0, 0.0, 1.0] }]",
        ]);
        assert!(
            walls(&plane).len() == 4 && walls(&plane).iter().flatten().all(|p| (p.z + 0.05).abs() < 1e-9)
        );
        assert!(plane.words.iter().any(|(_, words, _)| words == "table"));
    }
}
