//! The joint velocity that is nearest to a requested one within the limits in space.
//!
//! Nearest by the twist of the camera (of the flange, where the camera stands): `|V|^2 = |v|^2 + l^2 |w|^2`, and for what that leaves open by the joints. So a camera before
//! a plane moves along it and does not turn, and an arm with a joint more than it needs gives way with its elbow. With `M = J^T W J + e 1` the
//! solution is found limit by limit (Hildreth 1957), each time by the least step that satisfies it:
//! `qd += M^-1 g_k max(-l_k, (-v_k - g_k . qd) / (g_k . M^-1 g_k))`, where `l_k >= 0` is what it has contributed so far. After a bounded number of
//! rounds the rest is scaled: at a standstill every limit is kept.

use super::parts::ArmPlaces;
use super::{SpaceLimit, Workspace};
use crate::linalg::Ldlt;
use crate::motion::braking::{Bounds, JointMotionState, braking_speed};
use crate::motion::motion_limits::MotionLimits;
use nalgebra::{SMatrix, SVector};

/// Most limits that are kept off at a time, the nearest. Chosen by hand: three parts of an arm before the three faces of a corner, and three pairs; what is left out is
/// still kept by the second stage, without a smooth way along it.
const MAX_ROWS: usize = 12;
/// Rounds over them. Chosen by hand: two limits at right angles need one or two, a corner some five; what is left after so many is scaled away.
const ROUNDS: u32 = 16;
/// A step that changes the camera's twist by less than this ends the rounds, m/s. Chosen by hand: far below what an arm resolves.
const SETTLED_M_S: f64 = 1e-7;
/// Distance at which a turn of the camera counts like the motion that it makes there, m. Chosen by hand: where targets mostly are.
const LEVER_M: f64 = 0.5;
/// Weight of joint velocities against the camera's twist, m^2. Derived: directions of a singular value below its root, 0.03, in which joints would move the camera hardly,
/// are used less and less, as by the damping at singular postures, which begins at 0.05 (`robot/inverse.rs`).
const JOINTS_M2: f64 = 1e-3;
/// Rate at which a part approaches a limit in the end, 1/s. Chosen by hand: the last millimetres take a tenth of a second each time they are divided by e; with several
/// times the rate the reference, which needs some 20 ms for a change of velocity, would come in fits.
const CLOSING_1_S: f64 = 10.0;
/// A limit is looked at from this distance on, m, and from so far away as a part moves in the longest braking time. Chosen by hand, above what one tick makes.
const NEAR_M: f64 = 0.02;
/// Speed at which a motion that has come into the margin of a limit is led out of it, m/s. Chosen by hand: a millimetre in a tenth of a second; nothing is pushed that is not asked to move.
const RETREAT_M_S: f64 = 0.01;
/// Speed towards a limit above what it allows that is left to the second stage, m/s. Chosen by hand: rounding of the rounds, and a micrometre a second.
const LEFT_M_S: f64 = 1e-6;
/// Share of a speed limit that motion commands may use. Chosen by hand: the reference follows a command with a lag, and where commands jump between the full speeds of joints, or a joint
/// stops at an end of its range while others go on, it is faster than they are; steps are held at the limit itself (`stop.rs`), which is not smooth.
const SPEED_SHARE: f64 = 0.87;
/// Motion commands below this square, (rad/s or m/s)^2, have no pace. Chosen by hand: 1e-6 rad/s.
const NO_MOTION: f64 = 1e-12;
/// Relative change of a command from which on a limit is said to act. Chosen by hand, far above rounding.
const ACTS: f64 = 1e-6;

/// Positions, velocities and accelerations of all joints of a reference, rad or m.
pub(in crate::motion) struct ReferenceJoints<'a, const N: usize> {
    pub(in crate::motion) q: &'a SVector<f64, N>,
    pub(in crate::motion) qd: &'a SVector<f64, N>,
    pub(in crate::motion) a: &'a SVector<f64, N>,
}

/// A limit as a bound on joint velocities: `g . qd >= -most`.
#[derive(Debug, Clone, Copy)]
struct Row<const N: usize> {
    k: usize,
    room: f64,
    g: SVector<f64, N>,
    /// `M^-1 g` and `g . M^-1 g`.
    h: SVector<f64, N>,
    square: f64,
    most: f64,
    /// What it has contributed.
    part: f64,
}

impl<const N: usize> Workspace<N> {
    /// The velocity nearest to `requested_qd` (rad/s or m/s) that is within the limits in space for a reference in `state`, and whether
    /// it is another one.
    pub(in crate::motion) fn bend(
        &mut self,
        state: &ReferenceJoints<'_, N>,
        requested_qd: &SVector<f64, N>,
        limits: &MotionLimits<N>,
    ) -> (SVector<f64, N>, bool) {
        (self.pace, self.held_by) = (1.0, None);
        let places = ArmPlaces::of(&self.robot, &self.settings, state.q);
        self.note(&places, state.qd);
        let requested = requested_qd.norm_squared();
        if !(requested > NO_MOTION && requested.is_finite()) {
            return (*requested_qd, false);
        }
        let mut qd = self.slowed(&places, *requested_qd);
        if !self.now.is_empty() {
            qd = self.kept_off(state, &places, limits, qd);
            qd = self.slowed(&places, qd);
        }
        self.pace = (qd.dot(requested_qd) / requested).clamp(0.0, 1.0);
        let acts = (qd - requested_qd).norm_squared() > ACTS * ACTS * requested;
        if !acts {
            self.held_by = None;
        }
        (qd, acts)
    }

    /// All joints slowed down by the same factor, so that camera and flange are no faster than they may be.
    fn slowed(&mut self, places: &ArmPlaces<N>, qd: SVector<f64, N>) -> SVector<f64, N> {
        let speeds = self.speeds(places, &qd);
        let limits = [SpaceLimit::CameraSpeed, SpaceLimit::CameraTurn, SpaceLimit::FlangeSpeed];
        let mut share = 1.0_f64;
        for ((limit, speed), most) in limits.into_iter().zip(speeds).zip(self.settings.speeds()) {
            if speed * share > SPEED_SHARE * most {
                share = SPEED_SHARE * most / speed;
                // What bends the way says more than what slows it down.
                if !self.held_by.is_some_and(SpaceLimit::is_of_places) {
                    self.held_by = Some(limit);
                }
            }
        }
        qd * share
    }

    /// `qd` bent so that no part approaches a limit faster than the arm can brake before it.
    fn kept_off(
        &mut self,
        state: &ReferenceJoints<'_, N>,
        places: &ArmPlaces<N>,
        limits: &MotionLimits<N>,
        mut qd: SVector<f64, N>,
    ) -> SVector<f64, N> {
        let braking_s = limits.longest_braking_s();
        let fastest = qd.abs().sup(&state.qd.abs()).dot(&self.reach);
        if self.least > NEAR_M + braking_s * fastest {
            return qd;
        }
        let mut rows = [const { None::<Row<N>> }; MAX_ROWS];
        let mut metric = None;
        for k in 0..self.now.len() {
            let room = self.now[k];
            if room > NEAR_M + braking_s * fastest {
                continue;
            }
            let g = self.rates(k, places);
            let reachable = qd.abs().sup(&state.qd.abs()).dot(&g.abs());
            if room > NEAR_M + braking_s * reachable {
                continue;
            }
            // An empty place, or that of the farthest row.
            let far = |row: &Option<Row<N>>| row.as_ref().map_or(f64::INFINITY, |row| row.room);
            let place = rows.iter_mut().max_by(|a, b| far(a).total_cmp(&far(b)));
            let Some(place) = place.filter(|place| far(place) > room) else { continue };
            let factors =
                metric.get_or_insert_with(|| metric_of(&places.skeleton.jacobian_at(&places.tip())));
            let Some(factors) = factors else { return SVector::zeros() };
            let h = SVector::from(factors.solve(&g.into()));
            *place = row(k, (room, self.settings.margin_m), (g, h), state, limits);
        }
        let mut is_bent = false;
        for _ in 0..ROUNDS {
            let mut change = 0.0_f64;
            for row in rows.iter_mut().flatten() {
                let step = ((-row.most - row.g.dot(&qd)) / row.square).max(-row.part);
                if step != 0.0 {
                    qd += row.h * step;
                    row.part += step;
                    change = change.max(step.abs() * row.square.sqrt());
                    is_bent = true;
                }
            }
            if change < SETTLED_M_S {
                break;
            }
        }
        if !is_bent {
            return qd;
        }
        let mut share = 1.0_f64;
        for row in rows.iter().flatten() {
            let speed = -row.g.dot(&qd);
            let most = row.most.max(0.0);
            if speed * share > most + LEFT_M_S {
                share = most / speed;
            }
        }
        let strongest = rows.iter().flatten().filter(|row| row.part > 0.0).max_by(|a, b| {
            let weight = |row: &Row<N>| row.part * row.square.sqrt();
            weight(a).total_cmp(&weight(b))
        });
        self.held_by = strongest.map(|row| self.limit(row.k)).or(self.held_by);
        qd * share
    }
}

/// The factors of `M`; `None` where it is not finite.
fn metric_of<const N: usize>(J: &SMatrix<f64, 6, N>) -> Option<Ldlt<N>> {
    let mut weighed = *J;
    for mut column in weighed.column_iter_mut() {
        column.fixed_rows_mut::<3>(3).scale_mut(LEVER_M * LEVER_M);
    }
    Ldlt::new(&(J.transpose() * weighed).data.0, &[JOINTS_M2; N])
}

/// The limit `k` at the distance `room`, the margin `margin_m` before what must not be passed; `None` where no joint moves anything towards it.
fn row<const N: usize>(
    k: usize,
    (room, margin_m): (f64, f64),
    (g, h): (SVector<f64, N>, SVector<f64, N>),
    state: &ReferenceJoints<'_, N>,
    limits: &MotionLimits<N>,
) -> Option<Row<N>> {
    let square = g.dot(&h);
    if !(square > f64::MIN_POSITIVE && square.is_finite()) {
        return None;
    }
    // What the joints can do along M^-1 g, all together.
    let (mut acceleration, mut jerk) = (f64::INFINITY, f64::INFINITY);
    for i in (0..N).filter(|i| h[*i] != 0.0) {
        acceleration = acceleration.min(square * limits.acceleration[i] / h[i].abs());
        jerk = jerk.min(square * limits.jerk[i] / h[i].abs());
    }
    let now = JointMotionState { q: room.max(0.0), v: -g.dot(state.qd), a: -g.dot(state.a) };
    let bounds = Bounds { lower: 0.0, upper: 0.0, velocity: 0.0, acceleration, jerk };
    // What stands beyond the limit itself is not pushed: a motion along a path would be held off it, and wait for ever.
    let closing = if room < -margin_m { 0.0 } else { (CLOSING_1_S * room).max(-RETREAT_M_S) };
    let most = if room > 0.0 { braking_speed(now, &bounds).min(closing) } else { closing };
    Some(Row { k, room, g, h, square, most, part: 0.0 })
}
