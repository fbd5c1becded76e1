//! Limits in space: speeds of camera and flange, half spaces that no part of the arm may leave, and parts that are kept off each other.
//!
//! ```text
//! motion command ─► [`Workspace::bend`] ─► Reference: limits of the joints ─► [`Workspace::can_stop`] for each step ─► q_r
//!                   as fast as is allowed;         (a step from which the arm cannot brake inside is not taken,
//!                   along a plane, not into it      but the largest part of it from which it can)
//! ```
//! The first stage makes the motion smooth: the joint velocity nearest to what was requested with `g_k . qd >= -v_max(d_k)` for every limit `k` at the
//! distance `d_k` whose rates are `g_k`, where `v_max(d)` is the speed from which the arm can brake over the distance d. The second stage
//! is to keep the limit: the reference takes a step only if its braking, which can always be continued, stays inside, and as slow as is asked for, where it is looked at. All of it acts on the
//! reference, so that it acts on whatever moves the arm. The first stage leads the motion at a margin from planes and other parts, the second is to keep the reference
//! at half of it: joints that brake each as fast as it can leave the way along a plane a little. The arm itself needs the other half to follow.

mod bend;
mod parts;
mod segments;
mod settings;
mod stop;

pub(in crate::motion) use bend::ReferenceJoints;
pub use parts::{ArmPlaces, Capsule, CheckedPoint, checked_pairs, checked_points};
pub use settings::{HalfSpace, SpaceLimit, WorkspaceSettings};

use crate::robot::Robot;
use nalgebra::{SVector, Vector3};
use parts::reach;
use segments::nearest_shares;
use serde::Serialize;

/// The limits in space of one arm, beside its reference. It allocates when it is made, and not afterwards.
#[derive(Debug, Clone)]
pub struct Workspace<const N: usize> {
    robot: Robot<N>,
    settings: WorkspaceSettings,
    points: Vec<CheckedPoint>,
    pairs: Vec<(Capsule, Capsule)>,
    /// How far any part moves at most for each rad or m of each joint.
    reach: SVector<f64, N>,
    /// The distances at the reference of this tick, m: of each point from each side, then of each pair; less the margin.
    now: Vec<f64>,
    /// The least of them.
    least: f64,
    /// The speeds of this tick's reference, as [`WorkspaceSettings::speeds`].
    speeds_now: [f64; 3],
    pace: f64,
    held_by: Option<SpaceLimit>,
}

/// A part that is near a limit, or beyond it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Clearance {
    /// How far it is inside, m, the margin not counted; negative beyond the limit.
    pub room_m: f64,
    /// Which part of the arm.
    pub part: String,
    /// Which limit, or which other part.
    pub before: String,
}

impl Clearance {
    /// The same in words.
    #[must_use]
    pub fn describe(&self) -> String {
        let Self { room_m, part, before } = self;
        let beyond = if *room_m < 0.0 { "beyond" } else { "before" };
        format!("{part} is {:.4} m {beyond} {before}", room_m.abs())
    }
}

impl<const N: usize> Workspace<N> {
    /// The limits `settings` of the arm `robot`.
    #[must_use]
    pub fn new(robot: Robot<N>, settings: WorkspaceSettings) -> Self {
        let (points, pairs) = (checked_points(&robot, &settings), checked_pairs(&robot, &settings));
        let count = points.len() * settings.sides.len() + pairs.len();
        Self {
            reach: reach(&robot, &settings),
            robot,
            settings,
            points,
            pairs,
            now: vec![f64::INFINITY; count],
            least: f64::INFINITY,
            speeds_now: [0.0; 3],
            pace: 1.0,
            held_by: None,
        }
    }

    /// The settings that it was made from.
    #[must_use]
    pub fn settings(&self) -> &WorkspaceSettings {
        &self.settings
    }

    /// The part of the requested motion that was left at the last tick, 0 to 1: a motion along a path goes on by so much.
    #[must_use]
    pub fn pace(&self) -> f64 {
        self.pace
    }

    /// The limit that held the motion back at the last tick.
    #[must_use]
    pub fn held_by(&self) -> Option<SpaceLimit> {
        self.held_by
    }

    /// What of the arm in `q`, rad or m, is nearest to a limit; `None` where no place is limited.
    #[must_use]
    pub fn nearest(&self, q: &SVector<f64, N>) -> Option<Clearance> {
        let places = ArmPlaces::of(&self.robot, &self.settings, q);
        let rooms = (0..self.now.len()).map(|k| (self.distance(k, &places), k));
        let (room, k) = rooms.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (part, before) = self.words(k);
        Some(Clearance { room_m: room + self.settings.margin_m, part, before })
    }

    /// Whether nothing of the arm in `q`, rad or m, is nearer to a limit than the margin.
    #[must_use]
    pub fn keeps_margin(&self, q: &SVector<f64, N>) -> bool {
        let margin_m = self.settings.margin_m;
        self.nearest(q).is_none_or(|nearest| nearest.room_m >= margin_m)
    }

    /// Whether nothing of the arm in `q` is within the margin of a limit, or farther beyond it than in `from`; both rad or m.
    #[must_use]
    pub fn admits(&self, q: &SVector<f64, N>, from: &SVector<f64, N>) -> bool {
        let (there, here) =
            (ArmPlaces::of(&self.robot, &self.settings, q), ArmPlaces::of(&self.robot, &self.settings, from));
        (0..self.now.len()).all(|k| {
            let room = self.distance(k, &there);
            room >= 0.0 || room >= self.distance(k, &here) - Self::ROUNDING
        })
    }

    /// Whether the straight way of the joints from `from` to `to`, rad or m, is free. Seen at so many places that the arm moves by less than the margin between two,
    /// but at no more than a thousand.
    #[must_use]
    pub fn is_free(&self, from: &SVector<f64, N>, to: &SVector<f64, N>) -> bool {
        let way_m = (to - from).abs().dot(&self.reach);
        // Chosen by hand: a way of several metres beside a margin of a centimetre.
        const MOST: f64 = 1000.0;
        let steps = (way_m / self.settings.margin_m).ceil().clamp(1.0, MOST);
        let places = (1..=steps as u32).map(|k| from + (to - from) * (f64::from(k) / steps));
        places.into_iter().all(|q| self.admits(&q, from))
    }

    fn sides(&self) -> usize {
        self.settings.sides.len()
    }

    /// The limit of the distance `k`.
    fn limit(&self, k: usize) -> SpaceLimit {
        if k < self.points.len() * self.sides() {
            SpaceLimit::Side((k % self.sides()) as u8)
        } else {
            SpaceLimit::SelfCollision
        }
    }

    fn words(&self, k: usize) -> (String, String) {
        let names = self.robot.joint_names();
        if let (Some(point), SpaceLimit::Side(side)) =
            (self.points.get(k / self.sides().max(1)), self.limit(k))
        {
            let name = self.settings.sides.get(usize::from(side)).map_or("", |side| side.name.as_str());
            return (point.name(names), format!("\"{name}\" of [workspace]"));
        }
        let pair = self.pairs.get(k - self.points.len() * self.sides());
        pair.map_or_else(Default::default, |(a, b)| (b.name(names), a.name(names)))
    }

    /// The distance `k` less the margin, m.
    fn distance(&self, k: usize, places: &ArmPlaces<N>) -> f64 {
        let sides = self.sides();
        let first_pair = self.points.len() * sides;
        if k < first_pair {
            let (point, side) = (&self.points[k / sides], &self.settings.sides[k % sides]);
            return side.depth_m(&point.at(places)) - point.radius_m - self.settings.margin_m;
        }
        self.pairs.get(k - first_pair).map_or(f64::INFINITY, |(a, b)| {
            let (a_ends, b_ends) = (a.ends(places), b.ends(places));
            let [s, t] = nearest_shares(&a_ends, &b_ends);
            let apart = b_ends[0].lerp(&b_ends[1], t) - a_ends[0].lerp(&a_ends[1], s);
            apart.norm() - a.radius_m - b.radius_m - self.settings.margin_m
        })
    }

    /// The rates of the distance `k` by each joint, m/rad or 1.
    fn rates(&self, k: usize, places: &ArmPlaces<N>) -> SVector<f64, N> {
        let sides = self.sides();
        let first_pair = self.points.len() * sides;
        if k < first_pair {
            let (point, side) = (&self.points[k / sides], &self.settings.sides[k % sides]);
            return places.skeleton.rates_along(&side.normal, &point.at(places), point.joints);
        }
        self.pairs.get(k - first_pair).map_or_else(SVector::zeros, |(a, b)| {
            let (a_ends, b_ends) = (a.ends(places), b.ends(places));
            let [s, t] = nearest_shares(&a_ends, &b_ends);
            let apart = b_ends[0].lerp(&b_ends[1], t) - a_ends[0].lerp(&a_ends[1], s);
            let n = apart.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::z);
            // By the envelope theorem the shares at which they are nearest count as constant.
            b.rates_along(places, &n, t) - a.rates_along(places, &n, s)
        })
    }

    /// How fast camera and flange are where the joints go by `qd`, rad/s or m/s; as [`WorkspaceSettings::speeds`].
    fn speeds(&self, places: &ArmPlaces<N>, qd: &SVector<f64, N>) -> [f64; 3] {
        let V = places.skeleton.jacobian_at(&places.tip()) * qd;
        let (v, w) = (V.fixed_rows::<3>(0).into_owned(), V.fixed_rows::<3>(3).into_owned());
        [v.norm(), w.norm(), (v + w.cross(&(places.flange() - places.tip()))).norm()]
    }

    /// Takes in the distances and speeds of the reference of this tick, whose joints go by `qd`, rad/s or m/s.
    fn note(&mut self, places: &ArmPlaces<N>, qd: &SVector<f64, N>) {
        self.speeds_now = self.speeds(places, qd);
        self.least = f64::INFINITY;
        for k in 0..self.now.len() {
            let room = self.distance(k, places);
            self.now[k] = room;
            self.least = self.least.min(room);
        }
    }
}

#[cfg(test)]
mod tests;
