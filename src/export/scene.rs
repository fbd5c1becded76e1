//! The cell for the 3D panel of a viewer, `foxglove_msgs/SceneUpdate`: arm, camera, target and goal, each in a frame of `/tf`, so that what moves moves by
//! its frame and one message is enough for a run.

use super::cdr::CdrOutput;
use super::derived_message::{
    AnnotationColour, BASE, DerivedMessage, FLANGE, camera_frame, target_and_goal, target_frame,
};
use crate::config::Config;
use crate::geometry::Pose;
use crate::time::MonoNs;
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

/// Diameter of a link, m. Chosen by hand: slimmer than most arms' links, so that they hide little.
const LINK_M: f64 = 0.05;
/// Depth of the pyramid that is a camera, m. Chosen by hand: as long as a camera with its lens is, or twice.
const CAMERA_M: f64 = 0.1;
/// Width of its lines, px. Chosen by hand, as in images.
const LINE_PX: f64 = 2.0;
/// Diameter of a point of the target, as share of the largest distance between two. Chosen by hand: the points of a chessboard remain apart.
const POINT_SHARE: f64 = 0.03;
/// Colours of arm and camera; what is seen and where it is to be have those of the annotations. Chosen by hand, to be seen on light and dark.
const ARM: AnnotationColour = [0.55, 0.6, 0.68, 1.0];
const CAMERA: AnnotationColour = [0.2, 0.75, 0.45, 1.0];

/// A part of the cell: a frame, the part's name, and what it is made of there.
#[derive(Debug, Default)]
struct SceneEntity {
    frame: String,
    id: String,
    /// From where to where a link reaches.
    links: Vec<[Point3<f64>; 2]>,
    points: Vec<(Point3<f64>, f64, AnnotationColour)>,
    /// Ends of lines, two by two.
    lines: Vec<Point3<f64>>,
}

/// The message for the whole run.
pub(super) fn scene(config: &Config, stamp: MonoNs, [seen, wanted]: [AnnotationColour; 2]) -> DerivedMessage {
    let mut entities = arm(config);
    for camera in config.cameras() {
        let i = camera.model.intrinsics();
        let corner = |u: f64, v: f64| {
            let s = camera.model.normalized_of(&Vector2::new(u, v));
            Point3::new(s.x * CAMERA_M, s.y * CAMERA_M, CAMERA_M)
        };
        // the image ends half a pixel beyond the middle of its last ones
        let (right, below) = (f64::from(i.width_px) - 0.5, f64::from(i.height_px) - 0.5);
        let corners = [corner(-0.5, -0.5), corner(right, -0.5), corner(right, below), corner(-0.5, below)];
        let sides = corners.iter().zip(corners.iter().cycle().skip(1));
        let lines = sides.flat_map(|(a, b)| [*a, *b, Point3::origin(), *a]).collect();
        let frame = camera_frame(camera.id);
        entities.push(SceneEntity { id: frame.clone(), frame, lines, ..SceneEntity::default() });
    }
    let mut marks = Vec::new();
    for cell in std::iter::once(config).chain(config.second_view.as_ref().map(|second| &*second.cell)) {
        let (target, goal) = target_and_goal(cell);
        let points: Vec<Point3<f64>> = cell.target.points().iter().map(|point| point.p_O).collect();
        let apart = |a: &Point3<f64>| points.iter().map(|b| (b - a).norm()).fold(0.0, f64::max);
        let size_m = POINT_SHARE * points.first().map_or(0.0, apart);
        marks.push((target, seen, size_m, points.clone()));
        for further in &cell.further_targets {
            let points = further.target.points().iter().map(|point| point.p_O).collect();
            marks.push((target_frame(&further.name), seen, size_m, points));
        }
        if cell.set_point.X_DO().is_some() && !cell.goal.is_taught {
            marks.push((goal, wanted, size_m, points));
        }
    }
    for (frame, colour, size_m, points) in marks {
        let points = points.iter().map(|point| (*point, size_m, colour)).collect();
        entities.push(SceneEntity { id: frame.clone(), frame, points, ..SceneEntity::default() });
    }
    let mut out = CdrOutput::new();
    out.length(0); // nothing is deleted
    out.length(entities.len());
    entities.iter().for_each(|entity| entity.put(stamp, &mut out));
    let (topic, definition) = ("/scene".into(), "foxglove_msgs/SceneUpdate");
    DerivedMessage { topic, definition, stamp, data: out.bytes() }
}

/// The links as straight lines from joint to joint, each in the frame before that joint's motion.
fn arm(config: &Config) -> Vec<SceneEntity> {
    let robot = &config.robot;
    let frames = std::iter::once(BASE).chain(robot.joints.iter().map(|joint| joint.link.as_str()));
    let next = robot.joints.iter().map(|joint| joint.X_PL(0.0)).chain(std::iter::once(robot.X_LE));
    let links = frames.zip(next).filter(|(_, next)| next.translation.vector.norm() > 0.0);
    let link = |(frame, next): (&str, Pose)| SceneEntity {
        frame: frame.into(),
        id: format!("{frame} link"),
        links: vec![[Point3::origin(), next.translation.vector.into()]],
        ..SceneEntity::default()
    };
    let mut entities: Vec<_> = links.map(link).collect();
    let points = vec![(Point3::origin(), LINK_M, ARM)];
    entities.push(SceneEntity { frame: FLANGE.into(), id: FLANGE.into(), points, ..SceneEntity::default() });
    entities
}

impl SceneEntity {
    fn put(&self, stamp: MonoNs, out: &mut CdrOutput) {
        out.time(stamp);
        out.text(&self.frame);
        out.text(&self.id);
        out.time(MonoNs::ZERO); // for ever
        out.u8(1); // it moves with its frame
        (0..3).for_each(|_| out.length(0)); // metadata, arrows, cubes
        out.length(self.points.len());
        for (at, size_m, colour) in &self.points {
            put_pose(out, at, &UnitQuaternion::identity());
            out.f64s([*size_m; 3]);
            out.f64s(*colour);
        }
        out.length(self.links.len());
        for [from, to] in &self.links {
            let way = to - from;
            // opposite to the axis any half turn will do
            let turn = UnitQuaternion::rotation_between(&Vector3::z(), &way)
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
            put_pose(out, &nalgebra::center(from, to), &turn);
            out.f64s([LINK_M, LINK_M, way.norm()]);
            out.f64s([1.0, 1.0]); // as wide at both ends
            out.f64s(ARM);
        }
        out.length(usize::from(!self.lines.is_empty()));
        if !self.lines.is_empty() {
            const LINE_LIST: u8 = 2; // as the definition has it
            out.u8(LINE_LIST);
            put_pose(out, &Point3::origin(), &UnitQuaternion::identity());
            out.f64(LINE_PX);
            out.u8(1); // of pixels
            out.length(self.lines.len());
            out.f64s(self.lines.iter().flat_map(|point| [point.x, point.y, point.z]));
            out.f64s(CAMERA);
            (0..2).for_each(|_| out.length(0)); // colours by point, indices
        }
        (0..3).for_each(|_| out.length(0)); // triangles, texts, models
    }
}

fn put_pose(out: &mut CdrOutput, at: &Point3<f64>, turn: &UnitQuaternion<f64>) {
    out.f64s([at.x, at.y, at.z]);
    out.f64s(turn.coords.iter().copied());
}
