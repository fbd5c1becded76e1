//! Look-and-move, the open loop of Sect. 10.1.1 that visual servoing is compared with: one look at the target, one motion of the joints
//! by what was seen, and at rest another look.
//!
//! ```text
//! at rest: X_CO of one measurement ─► X_WO = X_WC(q) X_CO ─► X_WD = X_WO X_DO^-1 ─► posture, by inverse kinematics ─► waypoint
//!    ▲                                                                                                                 │
//!    └──────────────────── control moves the arm there without looking, and rests ◄────────────────────────────────────┘
//! ```
//! No error on the way is corrected, so that a motion ends beside the goal by as much as lens, mount and arm differ from their
//! description; the next look sees that, and goes on from there.

use super::{BelievedCell, Goal};
use crate::control::outcome::{Finish, Outcome};
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::messages::{ControlState, Measurement, TargetStatus};
use crate::servo::{PostureSearch, SetPoint};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector2};

/// Postures from which the inverse kinematics is started, that of the arm first, one a tick. As many as `check` tries
/// (`sim/preflight/reach.rs`), chosen by hand: if one start in ten finds a posture, 60 fail together in 0.2 % of the cases.
const STARTS: u32 = 60;
/// Share of the present error that a posture of an arm with fewer than six joints may keep, which can rarely show just what one view wants:
/// noise of the pose alone must not look like a goal out of reach. Chosen by hand; each look still takes nine tenths of the error away.
const KEPT_SHARE: f64 = 0.1;

const NO_POSTURE: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "no posture of this arm has the camera where the one look at the target wants it: the inverse kinematics found none within the \
             joints' ranges; move the target or servo.desired, and see `vservo check`",
};
const NOT_THERE: &str = "run.duration_s is over: each motion of look_and_move ended beside the goal, as far as lens, mount, target and arm are \
                         from their description, or as the target has moved meanwhile; correct these, or use a servo.scheme that looks while \
                         the arm moves";
const NOT_SEEN: &str = "run.duration_s is over: the target was not in view where the last motion of look_and_move ended; compare \
                        [camera.lens], [camera.mount] and [target] with what is there";
const NO_FRAMES: &str = "run.duration_s is over: no frames came any more, so that look_and_move could not look again; see to the camera and to vision";
const NO_CONTRAST: &str = "run.duration_s is over: the frames had no contrast when look_and_move was to look again; see to light, lens cap and exposure";
/// Age of the last exposure from which on no frames come, where `safety.measurement_timeout_ms`, which is more than a period and the latency of the camera, is not longer. Chosen by hand: a frame
/// or some that are lost just before the end are no silence.
const SILENT: SpanNs = SpanNs(1_000_000_000);

/// Looks and moves.
#[derive(Debug)]
pub struct LookAndMove<const N: usize> {
    cell: BelievedCell<N>,
    phase: Phase<N>,
    /// Motions that were ordered.
    motions: u32,
    /// Whether it has moved since it was started last: control serves once there is a motion, be it none.
    has_moved: bool,
}

#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // one in a run
enum Phase<const N: usize> {
    /// The arm rests, since when, or is about to; views from before are not used.
    Looking(Option<MonoNs>),
    /// A posture is sought.
    Planning(WaypointSearch<N>),
    /// The arm is on its way, or rests after it.
    Moving,
    /// There is no posture for what was seen.
    NoPosture,
}

/// The search for a posture, one start a tick.
#[derive(Debug)]
struct WaypointSearch<const N: usize> {
    /// Where the arm is.
    q: SVector<f64, N>,
    set_point: SetPoint,
    X_WO: Pose,
    X_WD: Pose,
    /// Largest feature error of a posture, px.
    within_px: f64,
    started: u32,
    random: Random,
}

impl<const N: usize> WaypointSearch<N> {
    /// The next start: the posture that shows the goal; that there is none after the last start; `None` as long as it goes on.
    fn next(&mut self, cell: &BelievedCell<N>) -> Option<Result<SVector<f64, N>, ()>> {
        let search = PostureSearch { robot: &cell.robot, mount: &cell.mount };
        let i = cell.camera.intrinsics();
        let f_px = Vector2::new(i.fx_px, i.fy_px);
        let from = if self.started == 0 { self.q } else { search.anywhere(&mut self.random) };
        self.started += 1;
        let found = search.postures_from(&from, (&self.X_WO, &self.X_WD), &self.set_point).find(|q| {
            let X_CO = search.X_WC(q).inv_mul(&self.X_WO);
            self.set_point.error_rms_px_at(&X_CO, &f_px) <= self.within_px
        });
        found.map(Ok).or_else(|| (self.started >= STARTS).then_some(Err(())))
    }
}

impl<const N: usize> LookAndMove<N> {
    /// In `cell`, by whose description motions are planned.
    #[must_use]
    pub fn new(cell: BelievedCell<N>) -> Self {
        Self { cell, phase: Phase::Looking(None), motions: 0, has_moved: false }
    }

    /// Notes the state of control and whether the arm rests, at each tick. An arm that was held or stopped forgets its motion, and looks
    /// again when it is started.
    pub(super) fn note_arm(&mut self, now: MonoNs, state: ControlState, at_rest: bool) {
        let goes_on = matches!(state, ControlState::Waiting | ControlState::Servoing);
        match &mut self.phase {
            _ if !goes_on => (self.phase, self.has_moved) = (Phase::Looking(None), false),
            Phase::Looking(since) if at_rest => {
                since.get_or_insert(now);
            }
            Phase::Looking(since) => *since = None,
            Phase::Planning(_) | Phase::Moving | Phase::NoPosture => {}
        }
    }

    /// Control has moved the arm and let it rest.
    pub(super) fn arrived(&mut self) {
        if matches!(self.phase, Phase::Moving) {
            self.phase = Phase::Looking(None);
        }
    }

    /// The goal is another one: what was sought for the old one is so no more, and that there was no posture for it says nothing of this one. A motion that is
    /// under way ends first.
    pub(super) fn forget_search(&mut self) {
        if matches!(self.phase, Phase::Planning(_) | Phase::NoPosture) {
            self.phase = Phase::Looking(None);
        }
    }

    /// Takes in a usable measurement with its feature error, px, of an arm in `q`, rad or m. At the goal there is nothing to do, once the arm
    /// has moved.
    pub(super) fn look(&mut self, m: &Measurement, error_px: f64, q: &SVector<f64, N>, goal: &Goal) {
        let Phase::Looking(Some(since)) = self.phase else { return };
        let is_there = self.has_moved && error_px <= goal.tolerance_px;
        let (Some(X_CO), Some(X_DO)) = (m.pose(), goal.set_point.X_DO()) else { return };
        if m.exposure < since || is_there || !error_px.is_finite() {
            return;
        }
        let search = PostureSearch { robot: &self.cell.robot, mount: &self.cell.mount };
        let X_WO = search.X_WC(q) * X_CO;
        let kept = if N < 6 { KEPT_SHARE } else { 0.0 };
        self.phase = Phase::Planning(WaypointSearch {
            q: *q,
            set_point: goal.set_point.clone(),
            X_WO,
            X_WD: X_WO * X_DO.inverse(),
            within_px: (kept * error_px).max(goal.tolerance_px),
            started: 0,
            random: Random::new(u64::from(self.motions)),
        });
    }

    /// Goes on with the search for a posture, if there is one; the posture where the arm is to go.
    pub(super) fn next_waypoint(&mut self) -> Option<SVector<f64, N>> {
        let Phase::Planning(search) = &mut self.phase else { return None };
        let found = search.next(&self.cell)?;
        self.phase = if found.is_ok() { Phase::Moving } else { Phase::NoPosture };
        self.motions = self.motions.saturating_add(1);
        self.has_moved = true;
        found.ok()
    }

    /// The end where there is no posture.
    pub(super) fn refused(&self) -> Option<Finish> {
        matches!(self.phase, Phase::NoPosture).then_some(NO_POSTURE)
    }

    /// Why the time of the run was too short, once the arm has moved, by the age and the status of the `last` measurement. One that is older than `timeout` is out of date.
    pub(super) fn when_late(
        &self,
        last: Option<(SpanNs, TargetStatus)>,
        timeout: SpanNs,
    ) -> Option<&'static str> {
        (self.motions > 0).then_some(match last {
            Some((age, _)) if age > SILENT.max(timeout) => NO_FRAMES,
            Some((_, TargetStatus::NoContrast)) => NO_CONTRAST,
            Some((_, TargetStatus::Found)) => NOT_THERE,
            _ => NOT_SEEN,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::motion::MotionLimits;
    use crate::time::SpanNs;

    const MS: i64 = 1_000_000;

    /// What a camera on the flange of a SCARA sees of a target that lies `off_m` from where it should.
    fn measurement(at_ms: i64, X_DO: &Pose, off_m: f64) -> Measurement {
        let mut m = Measurement { exposure: MonoNs(at_ms * MS), ..Measurement::default() };
        m.set_pose(&(Pose::translation(off_m, 0.0, 0.0) * X_DO));
        m
    }

    fn task() -> (LookAndMove<4>, SVector<f64, 4>, Goal) {
        let config = Config::load(None, &[]).unwrap();
        let robot = config.robot.build::<4>().unwrap();
        let limits = MotionLimits::of(&robot, SVector::repeat(10.0), SVector::repeat(500.0));
        let points = config.target.points().iter().map(|point| point.p_O).collect();
        let (mount, camera) = (config.camera.mount, config.camera.model);
        let set_point = config.set_point.clone();
        let goal = Goal { id: 0, set_point, tolerance_px: 0.05, hold: SpanNs(0) };
        let q = SVector::from_column_slice(&config.start.q);
        (LookAndMove::new(BelievedCell { robot, limits, mount, camera, points }), q, goal)
    }

    /// Only views of an arm that rests count, and those of before are forgotten with the motion that was planned from them.
    #[test]
    fn each_motion_has_a_look_of_its_own_from_rest() {
        let (mut task, q, goal) = task();
        let X_DO = *goal.set_point.X_DO().unwrap();
        let seen = |task: &mut LookAndMove<4>, at_ms| {
            task.look(&measurement(at_ms, &X_DO, 0.02), 30.0, &q, &goal);
            task.next_waypoint()
        };
        assert_eq!(seen(&mut task, 0), None, "nobody knows yet that the arm rests");
        task.note_arm(MonoNs(100 * MS), ControlState::Waiting, true);
        assert_eq!(seen(&mut task, 80), None, "a view from before");
        let first = seen(&mut task, 120).unwrap();
        let search = PostureSearch { robot: &task.cell.robot, mount: &task.cell.mount };
        let moved = search.X_WC(&q).inv_mul(&search.X_WC(&first)).translation.vector;
        assert!((moved - nalgebra::Vector3::new(0.02, 0.0, 0.0)).norm() < 1e-6, "{moved}");
        task.note_arm(MonoNs(121 * MS), ControlState::Servoing, true);
        assert_eq!(seen(&mut task, 160), None, "it has not moved yet");
        task.arrived();
        task.note_arm(MonoNs(300 * MS), ControlState::Servoing, true);
        task.look(&measurement(310, &X_DO, 0.0), 0.04, &q, &goal);
        assert_eq!(task.next_waypoint(), None, "it is there");
        assert!(seen(&mut task, 320).is_some());
        task.note_arm(MonoNs(400 * MS), ControlState::Held, true);
        task.note_arm(MonoNs(500 * MS), ControlState::Waiting, true);
        assert_eq!(seen(&mut task, 480), None, "held meanwhile: an old view");
        assert!(seen(&mut task, 520).is_some());
        task.arrived();
        task.note_arm(MonoNs(600 * MS), ControlState::Held, true);
        task.note_arm(MonoNs(700 * MS), ControlState::Waiting, true);
        task.look(&measurement(720, &X_DO, 0.0), 0.04, &q, &goal);
        assert!(task.next_waypoint().is_some(), "started anew at the goal: control serves by a motion alone");
    }

    /// Where the camera ends, by matrices and the maker's Denavit-Hartenberg parameters of a UR5 (universal-robots.com, DH parameters), which nothing here shares.
    #[test]
    fn a_motion_ends_where_matrices_say_to_1e_8() {
        use nalgebra::Matrix4;
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/ur5.toml");
        let config = Config::load(Some(&path), &[]).unwrap();
        let robot = config.robot.build::<6>().unwrap();
        let limits = MotionLimits::of(&robot, SVector::repeat(10.0), SVector::repeat(500.0));
        let points = config.target.points().iter().map(|point| point.p_O).collect();
        let cell =
            BelievedCell { robot, limits, mount: config.camera.mount, camera: config.camera.model, points };
        let set_point = config.set_point.clone();
        let X_DO = *set_point.X_DO().unwrap();
        let goal = Goal { id: 0, set_point, tolerance_px: 0.05, hold: SpanNs(0) };
        let (quarter, none) = (std::f64::consts::FRAC_PI_2, 0.0);
        let links = [
            (0.089159, none, quarter),
            (none, -0.425, none),
            (none, -0.39225, none),
            (0.10915, none, quarter),
            (0.09465, none, -quarter),
            (0.0823, none, none),
        ];
        // The camera stands 0.05 m before the flange, and looks along its z.
        let camera = |q: &SVector<f64, 6>| -> Matrix4<f64> {
            let turn = links.iter().zip(q).fold(Matrix4::<f64>::identity(), |X, ((d, a, alpha), q)| {
                let ((s, c), (t, k)) = (q.sin_cos(), alpha.sin_cos());
                #[rustfmt::skip]
                let A = Matrix4::new(
                    c, -s * k, s * t, a * c,
                    s, c * k, -c * t, a * s,
                    0.0, t, k, *d,
                    0.0, 0.0, 0.0, 1.0,
                );
                X * A
            });
            turn * Matrix4::new_translation(&nalgebra::Vector3::new(0.0, 0.0, 0.05))
        };
        let q = SVector::from_column_slice(&config.start.q);
        let mut random = Random::new(3);
        for _ in 0..12 {
            let mut task = LookAndMove::new(cell.clone());
            let mut off = |most: f64| nalgebra::Vector3::from_fn(|_, _| random.between(-most, most));
            let X_CO = Pose::new(off(0.05), off(0.2)) * X_DO;
            let mut seen = Measurement { exposure: MonoNs(120 * MS), ..Measurement::default() };
            seen.set_pose(&X_CO);
            task.note_arm(MonoNs(100 * MS), ControlState::Waiting, true);
            task.look(&seen, 30.0, &q, &goal);
            let waypoint = (0..STARTS).find_map(|_| task.next_waypoint()).unwrap();
            let wanted: Matrix4<f64> =
                camera(&q) * X_CO.to_homogeneous() * X_DO.to_homogeneous().try_inverse().unwrap();
            let off: f64 = (camera(&waypoint) - wanted).abs().max();
            assert!(off < 1e-8, "{off}");
        }
    }

    /// What it waits for when its time is over: frames, light, the target, or a better description.
    #[test]
    fn what_it_could_not_look_at_is_told() {
        let (mut task, q, goal) = task();
        let X_DO = *goal.set_point.X_DO().unwrap();
        let old = SpanNs(1500 * MS);
        let fresh = SpanNs(40 * MS);
        let timeout = SpanNs(200 * MS);
        assert_eq!(task.when_late(Some((old, TargetStatus::Found)), timeout), None, "it has not moved");
        task.note_arm(MonoNs(0), ControlState::Waiting, true);
        task.look(&measurement(120, &X_DO, 0.02), 30.0, &q, &goal);
        assert!(task.next_waypoint().is_some());
        for (last, told) in [
            (Some((old, TargetStatus::Found)), NO_FRAMES),
            (Some((fresh, TargetStatus::NoContrast)), NO_CONTRAST),
            (Some((fresh, TargetStatus::TooFewRegions)), NOT_SEEN),
            (Some((fresh, TargetStatus::Found)), NOT_THERE),
        ] {
            assert_eq!(task.when_late(last, timeout), Some(told), "{last:?}");
        }
        // A camera of one frame in four seconds.
        assert_eq!(task.when_late(Some((old, TargetStatus::Found)), SpanNs(9000 * MS)), Some(NOT_THERE));
    }

    #[test]
    fn what_no_posture_shows_is_told_after_the_last_start() {
        let (mut task, q, goal) = task();
        let X_DO = *goal.set_point.X_DO().unwrap();
        task.note_arm(MonoNs(0), ControlState::Waiting, true);
        task.look(&measurement(1, &X_DO, 3.0), 400.0, &q, &goal);
        for _ in 0..STARTS {
            assert_eq!(task.refused(), None);
            assert_eq!(task.next_waypoint(), None);
        }
        assert_eq!(task.refused(), Some(NO_POSTURE));
        // Another goal, of a served run: a view that it can show is gone for.
        task.forget_search();
        assert_eq!(task.refused(), None);
        task.note_arm(MonoNs(100 * MS), ControlState::Servoing, true);
        task.look(&measurement(120, &X_DO, 0.02), 30.0, &q, &goal);
        assert!(task.next_waypoint().is_some());
        task.forget_search();
        task.look(&measurement(140, &X_DO, 0.02), 30.0, &q, &goal);
        assert_eq!(task.next_waypoint(), None, "a motion that is under way ends first");
    }
}
