//! The parts of an arm that limits in space are about: spheres before planes, capsules before each other.
//!
//! A link is the straight line from the origin of its frame to that of the next, with a radius: a capsule. A capsule is inside a half space when the
//! spheres at both of its ends are. Meshes of robot files are not read.

use super::settings::WorkspaceSettings;
use crate::messages::MAX_JOINTS;
use crate::robot::{Robot, Skeleton, joint_in_words};
use nalgebra::{SVector, Vector3};

/// Places on an arm, by number: the origins of its links' frames, and these, which follow them because an arm has at most `MAX_JOINTS`.
const FLANGE: usize = MAX_JOINTS;
const CAMERA: usize = MAX_JOINTS + 1;
const TOOL: usize = MAX_JOINTS + 2;
const BASE: usize = MAX_JOINTS + 3;
const PLACES: usize = MAX_JOINTS + 4;

/// A place that moves by less than this between two postures does not move, m. Chosen by hand: far above rounding, and below what matters before a plane.
const STANDS_M: f64 = 1e-6;
/// By how much joints are moved to see which places move, rad or m. Chosen by hand: a third of a turn, at which no place is where it was.
const STEP: f64 = 2.0;

/// A sphere on the arm that is kept inside the half spaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckedPoint {
    place: usize,
    /// Number of joints that move it, from the base on.
    pub joints: usize,
    /// Its radius, m.
    pub radius_m: f64,
}

/// A capsule of the arm: a link, the camera or the tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    from: usize,
    to: usize,
    pub(super) joints: usize,
    /// Its radius, m.
    pub radius_m: f64,
}

impl CheckedPoint {
    /// What it is, for people; of an arm whose joints have these `names`.
    #[must_use]
    pub fn name(&self, names: &[String]) -> String {
        name_of(self.place, names)
    }

    /// Where it is in B, m.
    #[must_use]
    pub fn at<const N: usize>(&self, places: &ArmPlaces<N>) -> Vector3<f64> {
        places.at(self.place)
    }
}

impl Capsule {
    /// The ends of its middle line in B, m.
    #[must_use]
    pub fn ends<const N: usize>(&self, places: &ArmPlaces<N>) -> [Vector3<f64>; 2] {
        [places.at(self.from), places.at(self.to)]
    }

    /// The rates along `n` of the point at the share `s` of its length; each end is moved by the joints before it, and in between is between.
    pub(super) fn rates_along<const N: usize>(
        &self,
        places: &ArmPlaces<N>,
        n: &Vector3<f64>,
        s: f64,
    ) -> SVector<f64, N> {
        let of = |place: usize| places.skeleton.rates_along(n, &places.at(place), joints_before::<N>(place));
        of(self.from) * (1.0 - s) + of(self.to) * s
    }

    pub(super) fn name(&self, names: &[String]) -> String {
        if self.to == BASE || self.from == BASE { "the base".into() } else { name_of(self.to, names) }
    }
}

/// Number of joints that may move a place: a joint that slides moves the origin of its own link.
fn joints_before<const N: usize>(place: usize) -> usize {
    match place {
        BASE => 0,
        _ => (place + 1).min(N),
    }
}

fn name_of(place: usize, names: &[String]) -> String {
    match place {
        FLANGE => "the flange".into(),
        CAMERA => "the camera".into(),
        TOOL => "the tool".into(),
        BASE => "the base".into(),
        joint => joint_in_words(names, joint),
    }
}

/// All places of an arm in one posture, in B, m.
#[derive(Debug, Clone, Copy)]
pub struct ArmPlaces<const N: usize> {
    pub(super) skeleton: Skeleton<N>,
    at: [Vector3<f64>; PLACES],
}

impl<const N: usize> ArmPlaces<N> {
    /// Those of `robot` in `q`, rad or m.
    #[must_use]
    pub fn of(robot: &Robot<N>, settings: &WorkspaceSettings, q: &SVector<f64, N>) -> Self {
        let skeleton = robot.skeleton(q);
        let mut at = [Vector3::zeros(); PLACES];
        for (i, at) in at.iter_mut().enumerate().take(N) {
            *at = skeleton.origin(i);
        }
        at[FLANGE] = skeleton.on_flange(&Vector3::zeros());
        at[CAMERA] = settings.camera.map_or(at[FLANGE], |(p_E, _)| skeleton.on_flange(&p_E));
        at[TOOL] = settings.tool.map_or(at[FLANGE], |(p_E, _)| skeleton.on_flange(&p_E));
        Self { skeleton, at }
    }

    fn at(&self, place: usize) -> Vector3<f64> {
        self.at.get(place).copied().unwrap_or_else(Vector3::zeros)
    }

    /// The camera's centre where it moves with the arm, else the flange.
    pub(super) fn tip(&self) -> Vector3<f64> {
        self.at(CAMERA)
    }

    pub(super) fn flange(&self) -> Vector3<f64> {
        self.at(FLANGE)
    }
}

/// The spheres of `robot` that are kept inside the half spaces: those that some joint moves.
#[must_use]
pub fn checked_points<const N: usize>(robot: &Robot<N>, settings: &WorkspaceSettings) -> Vec<CheckedPoint> {
    if settings.sides.is_empty() {
        return Vec::new();
    }
    let radius = |i: usize| settings.link_radius_m.get(i).copied();
    let mut points = Vec::new();
    if !settings.link_radius_m.is_empty() {
        for i in 0..N {
            // An origin is the end of one link and the begin of the next.
            let own = radius(i).unwrap_or(0.0).max(i.checked_sub(1).and_then(radius).unwrap_or(0.0));
            points.push(CheckedPoint { place: i, joints: i + 1, radius_m: own });
        }
    }
    let flange = settings.link_radius_m.last().copied().unwrap_or(0.0);
    points.push(CheckedPoint { place: FLANGE, joints: N, radius_m: flange });
    if let Some((_, radius_m)) = settings.camera {
        points.push(CheckedPoint { place: CAMERA, joints: N, radius_m });
    }
    if let Some((_, radius_m)) = settings.tool {
        points.push(CheckedPoint { place: TOOL, joints: N, radius_m });
    }
    points.retain(|point| moves(robot, settings, point.place));
    points
}

/// Whether some joint moves the place.
fn moves<const N: usize>(robot: &Robot<N>, settings: &WorkspaceSettings, place: usize) -> bool {
    let at = |q: &SVector<f64, N>| ArmPlaces::of(robot, settings, q).at(place);
    let before = at(&SVector::zeros());
    (0..N).any(|i| {
        let mut q = SVector::zeros();
        q[i] = STEP;
        (at(&q) - before).norm() > STANDS_M
    })
}

/// The pairs of capsules that may meet: those that so much of the arm lies between that they need not overlap.
#[must_use]
pub fn checked_pairs<const N: usize>(
    robot: &Robot<N>,
    settings: &WorkspaceSettings,
) -> Vec<(Capsule, Capsule)> {
    if !settings.self_collision {
        return Vec::new();
    }
    let radius = |i: usize| settings.link_radius_m.get(i).copied().unwrap_or(0.0);
    let mut capsules = vec![Capsule { from: BASE, to: 0, joints: 0, radius_m: radius(0) }];
    for i in 0..N {
        let to = if i + 1 < N { i + 1 } else { FLANGE };
        capsules.push(Capsule { from: i, to, joints: i + 1, radius_m: radius(i) });
    }
    let on_flange = |to: usize, radius_m: f64| Capsule { from: FLANGE, to, joints: N, radius_m };
    capsules.extend(settings.camera.map(|(_, radius_m)| on_flange(CAMERA, radius_m)));
    capsules.extend(settings.tool.map(|(_, radius_m)| on_flange(TOOL, radius_m)));
    let long = lengths(robot, settings);
    let between = |a: &Capsule, b: &Capsule| -> f64 {
        // What lies between the end of one and the begin of the other, along the arm.
        (a.joints..b.joints.saturating_sub(1)).filter_map(|i| long.get(i)).sum::<f64>()
            + if b.from == FLANGE { long.get(N - 1).copied().unwrap_or(0.0) } else { 0.0 }
    };
    let mut pairs = Vec::new();
    for (k, a) in capsules.iter().enumerate() {
        for b in capsules.iter().skip(k + 1).filter(|b| b.joints > a.joints) {
            if between(a, b) > a.radius_m + b.radius_m + settings.margin_m {
                pairs.push((*a, *b));
            }
        }
    }
    pairs
}

/// The greatest distance from the origin of each link's frame to the next one, and of the last to the flange, m.
fn lengths<const N: usize>(robot: &Robot<N>, settings: &WorkspaceSettings) -> [f64; N] {
    let end = |x: f64| if x.is_finite() { x } else { 0.0 };
    // A joint that turns changes none of them, and one that slides has its greatest at an end of its range.
    let postures = [
        SVector::from_fn(|i, _| end(robot.limits()[i].lower)),
        SVector::from_fn(|i, _| end(robot.limits()[i].upper)),
    ];
    let mut longest = [0.0_f64; N];
    for q in &postures {
        let places = ArmPlaces::of(robot, settings, q);
        for (i, long) in longest.iter_mut().enumerate() {
            let next = places.at(if i + 1 < N { i + 1 } else { FLANGE });
            *long = long.max((next - places.at(i)).norm());
        }
    }
    longest
}

/// How far any part of the arm moves at most for each rad or m of each joint, m/rad or 1.
pub(super) fn reach<const N: usize>(robot: &Robot<N>, settings: &WorkspaceSettings) -> SVector<f64, N> {
    let long = lengths(robot, settings);
    let tip = |part: Option<(Vector3<f64>, f64)>| part.map_or(0.0, |(p_E, _)| p_E.norm());
    let tip = tip(settings.camera).max(tip(settings.tool));
    SVector::from_fn(|i, _| if robot.is_prismatic(i) { 1.0 } else { long.iter().skip(i).sum::<f64>() + tip })
}
