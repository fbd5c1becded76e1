//! The last word on limits in space: whether any point of the arm that is checked is beyond a plane, or a part in another, as commanded and as measured, and how fast camera and flange are.
//!
//! It shares with the limits that it checks ([`Workspace`](crate::motion::Workspace)) what they are and the arm's kinematics, and no other arithmetic: it takes no
//! derivatives, its speeds are differences of places, and where two parts are nearest it finds by going from one to the other. The reference keeps the margin of the limits, so that this bound, at the planes
//! and surfaces themselves, does not act on an arm that follows.

use crate::control::safety::Fault;
use crate::motion::{ArmPlaces, Capsule, CheckedPoint, WorkspaceSettings, checked_pairs, checked_points};
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::{SVector, Vector3};

/// Ticks in a row beyond a plane that are a fault. Chosen by hand: single wrong samples of an encoder are none, and an arm at 1 m/s goes by 5 mm in that time.
const PATIENCE: u32 = 5;
/// Ticks in a row above a speed that are a fault. Chosen by hand, as for commands that had to be changed: 100 ms.
const FAST_PATIENCE: u32 = 100;
/// Factor of a speed limit above which a command is too fast. Chosen by hand: half of what the bound on the joints of the measured arm allows, and five times what the reference needs.
const TOO_FAST: f64 = 1.1;
/// How much farther beyond a plane than at its begin a motion may lead that begins beyond it, m. Chosen by hand: what an arm that begins to move wavers by.
const FARTHER_M: f64 = 2e-3;

/// How often it goes from the nearest point of one part to that of another. Chosen by hand: at right angles once is enough; lines that are nearly parallel it leaves too far apart by what the
/// way between two rounds is, so that it is never stricter than the limit.
const ROUNDS: u32 = 8;

/// The bound of one arm.
#[derive(Debug, Clone)]
pub struct SpaceBound<const N: usize> {
    robot: Robot<N>,
    settings: WorkspaceSettings,
    points: Vec<CheckedPoint>,
    pairs: Vec<(Capsule, Capsule)>,
    /// How far beyond the planes the arm may be, m: as far as where its motion began.
    allowed_m: f64,
    beyond: u32,
    fast: u32,
    /// Camera and flange as commanded last.
    last: Option<[Vector3<f64>; 2]>,
}

impl<const N: usize> SpaceBound<N> {
    /// The bound `settings` on the arm `robot`.
    #[must_use]
    pub fn new(robot: Robot<N>, settings: &WorkspaceSettings) -> Self {
        let (points, pairs) = (checked_points(&robot, settings), checked_pairs(&robot, settings));
        Self {
            robot,
            settings: settings.clone(),
            points,
            pairs,
            allowed_m: 0.0,
            beyond: 0,
            fast: 0,
            last: None,
        }
    }

    /// A motion begins at the measured `q`, rad or m. Whether nothing is beyond a plane there; otherwise it may lead back, and not farther out.
    pub fn begin(&mut self, q: &SVector<f64, N>) -> bool {
        let beyond_m = self.beyond_m(q);
        self.allowed_m = if beyond_m > 0.0 { beyond_m + FARTHER_M } else { 0.0 };
        (self.beyond, self.fast, self.last) = (0, 0, None);
        !(beyond_m > 0.0)
    }

    /// Takes in what was commanded and measured at a tick, rad or m. The fault of an arm that `moves` beyond a limit.
    pub fn watch(
        &mut self,
        commanded: &SVector<f64, N>,
        measured: &SVector<f64, N>,
        moves: bool,
    ) -> Option<Fault> {
        if !moves {
            (self.beyond, self.fast, self.last) = (0, 0, None);
            return None;
        }
        let is_beyond = self.beyond_m(commanded).max(self.beyond_m(measured)) > self.allowed_m;
        self.beyond = if is_beyond { self.beyond + 1 } else { 0 };
        let is_fast = self.is_fast(commanded);
        self.fast = if is_fast { self.fast + 1 } else { 0 };
        if self.beyond >= PATIENCE {
            Some(Fault::LeavesWorkspace)
        } else {
            (self.fast >= FAST_PATIENCE).then_some(Fault::TooFastInSpace)
        }
    }

    /// How far the farthest point is beyond a plane, or the deepest part in another, m; not positive where none is.
    fn beyond_m(&self, q: &SVector<f64, N>) -> f64 {
        if self.points.is_empty() && self.pairs.is_empty() {
            return 0.0;
        }
        let places = ArmPlaces::of(&self.robot, &self.settings, q);
        let mut farthest = f64::NEG_INFINITY;
        for point in &self.points {
            let p = point.at(&places);
            for side in &self.settings.sides {
                farthest = farthest.max(point.radius_m + side.offset_m - side.normal.dot(&p));
            }
        }
        for (a, b) in &self.pairs {
            farthest = farthest.max(a.radius_m + b.radius_m - apart_m(a.ends(&places), b.ends(&places)));
        }
        farthest
    }

    /// Whether camera or flange went faster than they may since the command before.
    fn is_fast(&mut self, commanded: &SVector<f64, N>) -> bool {
        let s = &self.settings;
        let limits = [s.camera_speed_m_s, s.flange_speed_m_s];
        if limits.iter().all(|limit| limit.is_infinite()) {
            return false;
        }
        let skeleton = self.robot.skeleton(commanded);
        let on_flange = |p_E: Vector3<f64>| skeleton.on_flange(&p_E);
        let now = [s.camera.map_or_else(Vector3::zeros, |(p_E, _)| p_E), Vector3::zeros()].map(on_flange);
        let last = self.last.replace(now);
        last.is_some_and(|last| {
            let ways = now.iter().zip(&last).zip(limits);
            ways.into_iter().any(|((now, last), limit)| (now - last).norm() > TOO_FAST * limit * TICK.as_s())
        })
    }
}

/// How far two lines with these ends are apart, m; never less than they are.
fn apart_m(a: [Vector3<f64>; 2], b: [Vector3<f64>; 2]) -> f64 {
    let mut apart_m = f64::INFINITY;
    for start in b {
        let mut on_b = start;
        for _ in 0..ROUNDS {
            on_b = nearest_on(b, &nearest_on(a, &on_b));
        }
        apart_m = apart_m.min((nearest_on(a, &on_b) - on_b).norm());
    }
    apart_m
}

/// The point of the line with these ends that is nearest to `p`.
fn nearest_on([from, to]: [Vector3<f64>; 2], p: &Vector3<f64>) -> Vector3<f64> {
    let along = to - from;
    let share = (p - from).dot(&along) / along.norm_squared();
    if share.is_finite() { from + along * share.clamp(0.0, 1.0) } else { from }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use crate::motion::HalfSpace;
    use crate::robot::load;
    use nalgebra::Vector4;

    fn bound(flange_speed_m_s: f64) -> (SpaceBound<4>, Vector4<f64>, Vector3<f64>) {
        let robot = load("scara").unwrap().build::<4>().unwrap();
        let q = Vector4::new(0.0, 1.5, 0.5, 0.0);
        let flange = robot.forward(&q).translation.vector;
        let side = HalfSpace { name: "wall".into(), normal: Vector3::y(), offset_m: flange.y - 0.01 };
        let settings = WorkspaceSettings {
            camera_speed_m_s: f64::INFINITY,
            camera_turn_rad_s: f64::INFINITY,
            flange_speed_m_s,
            margin_m: 0.005,
            sides: vec![side],
            link_radius_m: Vec::new(),
            camera: None,
            tool: None,
            self_collision: false,
        };
        (SpaceBound::new(robot, &settings), q, flange)
    }

    /// The first joint turned so that the flange goes by about `by_m` along -y.
    fn moved(q: &Vector4<f64>, flange: &Vector3<f64>, by_m: f64) -> Vector4<f64> {
        let mut q = *q;
        q[0] -= by_m / flange.x;
        q
    }

    #[test]
    fn an_arm_beyond_a_plane_is_a_fault_and_a_spike_is_none() {
        let (mut bound, q, flange) = bound(f64::INFINITY);
        assert!(bound.begin(&q));
        let beyond = moved(&q, &flange, 0.03);
        for k in 0..40 {
            // Four wrong samples in a row, and one that is right.
            let measured = if k % 5 < 4 { beyond } else { q };
            assert_eq!(bound.watch(&q, &measured, true), None);
        }
        let until = |bound: &mut SpaceBound<4>, command: &Vector4<f64>, measured: &Vector4<f64>| {
            (1..100).find(|_| bound.watch(command, measured, true).is_some())
        };
        assert!(bound.begin(&q));
        assert_eq!(until(&mut bound, &q, &beyond), Some(5), "as measured");
        assert!(bound.begin(&q));
        assert_eq!(until(&mut bound, &beyond, &q), Some(5), "as commanded");
        assert!((0..100).all(|_| bound.watch(&beyond, &beyond, false).is_none()), "an arm that stands");
    }

    #[test]
    fn a_motion_that_begins_beyond_a_plane_may_lead_back() {
        let (mut bound, q, flange) = bound(f64::INFINITY);
        let at = |by_m| moved(&q, &flange, by_m);
        assert!(!bound.begin(&at(0.05)));
        for k in 0..200 {
            let q = at(0.05 - 5e-4 * f64::from(k));
            assert_eq!(bound.watch(&q, &q, true), None);
        }
        assert!(!bound.begin(&at(0.05)));
        // As it begins to move it may waver, by 2 mm.
        let wavers = at(0.051);
        assert!((0..50).all(|_| bound.watch(&wavers, &wavers, true).is_none()));
        let farther = at(0.06);
        assert!((0..5).any(|_| bound.watch(&farther, &farther, true) == Some(Fault::LeavesWorkspace)));
    }

    #[test]
    fn where_nothing_is_limited_nothing_is_beyond() {
        let (bound, q, _) = bound(f64::INFINITY);
        let settings = WorkspaceSettings { sides: Vec::new(), ..bound.settings };
        let mut bound = SpaceBound::new(bound.robot, &settings);
        assert!(bound.begin(&q));
        assert!((0..50).all(|_| bound.watch(&q, &q, true).is_none()));
    }

    #[test]
    fn a_flange_that_is_commanded_too_fast_is_a_fault() {
        for (times, is_fault) in [(1.02, false), (1.3, true)] {
            let (mut bound, q, flange) = bound(0.1);
            assert!(bound.begin(&q));
            let first = (0..300).find(|k| {
                let q = moved(&q, &flange, -1e-4 * times * f64::from(*k) * flange.x / flange.xy().norm());
                bound.watch(&q, &q, true) == Some(Fault::TooFastInSpace)
            });
            // The first command has none before it.
            assert_eq!(first, is_fault.then_some(FAST_PATIENCE as i32), "{times}");
        }
    }

    /// A UR5 that folds: it is a fault from where the surfaces of two of its parts meet, found from many points of their axes.
    #[test]
    fn parts_that_meet_are_a_fault_and_parts_apart_are_none() {
        let robot = load("ur5").unwrap().build::<6>().unwrap();
        let settings = WorkspaceSettings {
            margin_m: 0.01,
            sides: Vec::new(),
            link_radius_m: vec![0.05, 0.06, 0.04, 0.05, 0.04, 0.03],
            self_collision: true,
            ..bound(f64::INFINITY).0.settings
        };
        let pairs = checked_pairs(&robot, &settings);
        assert!(pairs.len() > 3);
        let deepest = |q: &SVector<f64, 6>| {
            let places = ArmPlaces::of(&robot, &settings, q);
            let along =
                |[from, to]: [Vector3<f64>; 2]| (0..=60).map(move |k| from.lerp(&to, f64::from(k) / 60.0));
            let between = |(a, b): &(Capsule, Capsule)| {
                let apart = along(a.ends(&places))
                    .flat_map(|p| along(b.ends(&places)).map(move |r| (p - r).norm()))
                    .fold(f64::INFINITY, f64::min);
                a.radius_m + b.radius_m - apart
            };
            pairs.iter().map(between).fold(f64::NEG_INFINITY, f64::max)
        };
        let (mut met, mut free) = (0, 0);
        for k in 0..120 {
            // The elbow closes.
            let q = SVector::from([0.3, -1.2, 1.5 + 0.0135 * f64::from(k), -0.4, 1.2, 0.2]);
            let deep = deepest(&q);
            let mut bound = SpaceBound::new(robot.clone(), &settings);
            assert!(bound.begin(&SVector::from([0.0, -1.2, 0.8, -1.0, -1.5, 0.0])), "free where it begins");
            let fault = (0..PATIENCE).find_map(|_| bound.watch(&q, &q, true));
            if deep > 5e-3 {
                assert_eq!(fault, Some(Fault::LeavesWorkspace), "{deep}");
                met += 1;
            } else if deep < -1e-3 {
                assert_eq!(fault, None, "{deep}");
                free += 1;
            }
        }
        assert!(met > 10 && free > 10, "{met} {free}");
    }

    /// Against all places of both lines.
    #[test]
    fn lines_are_as_far_apart_as_their_nearest_points() {
        let mut random = Random::new(3);
        for _ in 0..300 {
            let mut point = || Vector3::from_fn(|_, _| random.between(-0.5, 0.5));
            let (a, b) = ([point(), point()], [point(), point()]);
            let shares = || (0..=200).map(|k| f64::from(k) / 200.0);
            let apart = |s: f64, t: f64| (a[0].lerp(&a[1], s) - b[0].lerp(&b[1], t)).norm();
            let least = shares()
                .flat_map(|s| shares().map(move |t| (s, t)))
                .map(|(s, t)| apart(s, t))
                .fold(f64::INFINITY, f64::min);
            let found = apart_m(a, b);
            assert!(found > least - 0.01 && found < least + 0.01, "{found} {least}");
        }
    }
}
