//! Detects that the goal cannot be reached: the arm stands and a residual error stays, or it moves and the error does not fall.
//!
//! Where lens, mount or target differ from the configuration, or the arm has too few joints, a law comes to rest where the error has no
//! component that it can act upon. The goal is then out of reach, and waiting does not help.
//!
//! The numbers here were chosen by hand. The tests below give errors that must be reported and errors that must not. Half of `LONG` reports an arm
//! that has stood for 1.5 s only, and fails there.

use crate::messages::Measurement;
use crate::motion::{ActingLimits, Limit};
use crate::servo::{Law, OperationalSpace, SetPoint, View, determined_directions, felt_share};
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector2;

/// Time for which the arm must have stood and the error stayed.
const LONG: SpanNs = SpanNs(2_000_000_000);
/// Fewest measurements in that time.
const FEWEST: u32 = 5;
/// An error counts as constant while it changes by less than this share of it, or by less than this, px, which is noise.
const STEADY_SHARE: f64 = 0.05;
const STEADY_PX: f64 = 0.05;
/// A constant error of which the least is below this share of the largest is noise of the view, because a steady one has less of it. Derived: errors of 48 points that are noise
/// scatter by 0.07 of themselves, and a hundred of them lie within 2.5 times of that on both sides; fewer points scatter more.
pub const SCATTER_SHARE: f64 = 0.75;

/// The reason that ends a run whose goal cannot be reached.
pub const OUT_OF_REACH: &str = "the arm stands and the error stays: the goal cannot be reached with this lens, mount or number of \
                                       joints; compare [camera.lens], [camera.mount] and [target] with what is there, or teach the \
                                       goal (servo.set_point.kind = \"taught\")";

/// The reason that ends a run whose arm is at its end before it has come to the goal.
pub const AT_ITS_END: &str = "the arm stands and the error stays: a joint is at the end of its range, or the arm is stretched out, so that it cannot go on to the goal; \
                              the events name which. Choose another goal or another start, or bring target and arm nearer together (vservo check tells what is within reach)";

/// The reason that ends a run whose law has come to rest at a local minimum.
pub const LOCAL_MINIMUM: &str = "the arm stands at a local minimum of the feature error: K_s e_s is in the null space of L_s^T, no motion of \
                                 the camera makes the error fall from here, and the target is seen as it is, so that the goal lies \
                                 elsewhere; start nearer to it, or let a law go that compares poses (servo.scheme = \
                                 \"position_resolved_velocity\" or \"hybrid\")";

/// The reason that ends a run whose torques do not move the arm any more.
pub const TOO_WEAK: &str = "the arm stands and the error stays: what the law asks for is too little torque against friction and what the model does \
                            not know; raise the stiffness in [servo.pd]. Or the goal cannot be reached with this lens, mount or number of joints: \
                            compare [camera.lens], [camera.mount] and [target] with what is there";
/// The reason that ends a run whose arm cannot follow the tilt of the measured pose.
pub const TILT: &str = "the arm stands and the error stays: the law compares all of the pose, and this arm cannot tilt its camera, so that what is wrong with the \
                        measured tilt moves it aside, by the distance of the target times the angle; use servo.dimension = 4";

/// The reason that ends a run in which all that the law compares is where it should be, and the rest of the target is not.
pub const AMBIGUOUS_VIEW: &str = "the three points that the law compares are where they should be, and the rest of the target is not: three points look the \
                                  same from up to four poses of the camera, and this is another one than the goal; let the law compare a \
                                  fourth point (servo.points), or start nearer to the goal";

/// The reason that ends a run whose features fix no pose.
pub const TOO_FEW_FEATURES: &str = "the arm stands and the error stays: what servo.points, servo.segments and servo.area select tells of fewer directions than the arm has, so that many \
                                    poses look the same to the law, and it went to another one than the goal; let it compare more";

/// The reason that ends a run whose error is noise of the view.
pub const BELOW_SCATTER: &str = "the arm stands, and the error that stays is of the size of its scatter: goal.feature_error_px is below what the measurements scatter by; \
                                 raise it (vservo explain names what suits), or give the view less noise: light, focus, a target that is larger in the image";

/// The reason that ends a run whose error is as small as the points scatter.
pub const WITHIN_NOISE: &str = "run.duration_s is over; what is left of the error is what the points scatter by from image to image, and their mean is not known well enough yet to say that it is within \
                                goal.feature_error_px: raise that (vservo explain names what suits), give the run more time (run.duration_s), or give the view less noise: a camera that does not shake, light, \
                                focus, a target that is larger in the image";

/// Whether a run ended for this reason with an arm that stood.
#[must_use]
pub fn stands(reason: &str) -> bool {
    [OUT_OF_REACH, AT_ITS_END, LOCAL_MINIMUM, TOO_WEAK, TILT, AMBIGUOUS_VIEW, TOO_FEW_FEATURES, BELOW_SCATTER]
        .contains(&reason)
}

/// Whether a run ended for this reason with an error that did not fall any more.
#[must_use]
pub fn falls_no_more(reason: &str) -> bool {
    stands(reason) || [NO_NEARER, NO_NEARER_BY_TORQUES, WITHIN_NOISE].contains(&reason)
}

/// The reason that ends a run whose arm moves and gets no nearer.
const NO_NEARER: &str = "the arm moves on and the error does not fall: lower servo.gain_1_s; see whether load, friction and delay of \
                             the arm are far from its model, its encoders coarser than motion.encoder_step_rad_or_m says, or the object \
                             moves (servo.object.moves)";

/// The same under torque laws, which have no gain of velocities.
const NO_NEARER_BY_TORQUES: &str = "the arm moves on and the error does not fall: lower the stiffness in [servo.pd], or raise the damping; see whether load, friction and delay of \
                                    the arm are far from its model, its encoders coarser than motion.encoder_step_rad_or_m says, or the object moves";

/// The reason that ends a run whose arm is on its way.
const ON_ITS_WAY: &str = "run.duration_s is over, and the error still falls: give the run more time (run.duration_s), or see what makes the arm slow: limits of [workspace] and [motion], \
                          a low gain (servo.gain_1_s; of torque laws the stiffness in [servo.pd], or much damping)";

/// The same where the law follows the object's own motion.
const BEHIND_OBJECT: &str = "the arm follows the object, and the error does not fall below goal.feature_error_px: what is left comes of motions of the object \
                                 that its estimate learns too late; set servo.object.acceleration_m_s2 and acceleration_rad_s2 to what the object does, \
                                 let images come sooner, or allow for the error (goal.feature_error_px). Of an object that rests: lower servo.gain_1_s, or see \
                                 whether load, friction and delay of the arm are far from its model";

/// The same where a limit of the arm's speed acts.
const TOO_SLOW_FOR_OBJECT: &str = "the arm follows the object, and the error does not fall below goal.feature_error_px: a limit of the arm's speed acts \
                                   (safety.held_by and safety.limited_ticks of the summary name it); raise workspace.camera_speed_m_s, camera_turn_rad_s or flange_speed_m_s where they hold it, \
                                   let the object be slower, or allow for the error (goal.feature_error_px)";

/// The share of ticks in which limits of speed act from which on they are what an arm is behind an object by. Chosen by hand: behind an object that goes to and fro, limits act in the faster part of each half swing alone.
const OFTEN: f64 = 0.3;
/// Over how many ticks that share is a mean. Chosen by hand: in a second the arms have caught up with an object that they can follow.
const OFTEN_TICKS: f64 = 1000.0;

/// Largest share of K_s e_s that motions of the camera still change at a local minimum, and largest share of the feature error
/// by which what is seen may differ from an image of the target. Chosen, with room on
/// both sides: a UR5 that creeps into such a minimum at a fifth of its gain is at 0.14 of the first, and at 1e-4 of the second; an arm of four
/// joints before a tilted target is told by the first, and a lens that bends by more than it should by the second (`a_local_minimum_is_told`).
const FELT_SHARE: f64 = 0.3;
const MISFIT_SHARE: f64 = 0.1;
/// Largest error that a wrong tilt of the measured pose explains, px. Derived: of dots that are found to 0.05 px a tilt is known to about a milliradian, which
/// moves the image of a lens of 800 px by 0.8 px at any distance; more has another reason.
const TILT_PX: f64 = 1.0;

/// Whether the end of a joint's range, or a singular posture, keeps the arm from what the law asks for.
pub(super) fn is_at_its_end(limits: &ActingLimits) -> bool {
    limits.joints(Limit::Position) | limits.joints(Limit::Singularity) != 0
}

/// Why an error of `error_px` stays before an arm of so many `joints` that stands; `seen` is the last measurement.
///
/// It is a local minimum where the law asks for nothing, and what is seen is an image of the target from some other pose than the goal's: from
/// there the goal's image can be had. Where lens or target are not as they are believed, an arm with enough joints comes to rest in the null space of
/// L_s^T, too, but then no pose gives what is seen, by as much as the error.
pub(super) fn why_it_stays(
    law: &Law,
    set_point: &SetPoint,
    seen: Option<&Measurement>,
    (error_px, joints): (f64, usize),
) -> &'static str {
    let is_local_minimum = |m: &Measurement| {
        let felt = felt_share(law, set_point, &View::of(m, set_point)?)?;
        Some(felt <= FELT_SHARE && m.reprojection_rms_px <= MISFIT_SHARE * error_px)
    };
    match seen.and_then(is_local_minimum) {
        Some(true) => LOCAL_MINIMUM,
        _ if may_be_tilt(law, joints, error_px) => TILT,
        _ if law.is_torque() => TOO_WEAK,
        _ => OUT_OF_REACH,
    }
}

/// Whether the law follows a tilt of the measured pose that an arm of so many `joints` cannot, and the error is as small as that makes it.
fn may_be_tilt(law: &Law, joints: usize, error_px: f64) -> bool {
    let compares_tilt = matches!(
        law,
        Law::PositionTorque { space: OperationalSpace::Six | OperationalSpace::Homography, .. }
    );
    compares_tilt && joints < 6 && error_px < TILT_PX
}

/// Whether the law compares three points and the view `m` has these within `met_px` of where they should be, px, with the focal lengths `f_px`: from
/// up to four poses they look so.
pub(super) fn is_another_pose(
    set_point: &SetPoint,
    m: &Measurement,
    f_px: &Vector2<f64>,
    met_px: f64,
) -> bool {
    set_point.selection().points().count() == 3
        && View::of(m, set_point).is_some_and(|view| set_point.compared_error_rms_px(&view, f_px) <= met_px)
}

/// Whether the features that an image-based law compares leave open some motion of a camera that so many `joints` move: it may then stand anywhere along that, also
/// where the guard of the image's border or friction holds it before they are met.
pub(super) fn leaves_pose_open(law: &Law, set_point: &SetPoint, joints: usize) -> bool {
    let compares_features =
        matches!(law, Law::ImageVelocity { .. } | Law::ImageTorque { .. } | Law::PreconditionedTorque { .. });
    compares_features && determined_directions(set_point).is_some_and(|told| told < joints.min(6))
}

/// The mean error over this time is compared with that of the time before; if it falls by less than this share, the arm is no nearer.
const SPELL: SpanNs = SpanNs(2_000_000_000);
const NEARER_SHARE: f64 = 0.2;

/// An error that falls by this share and more from one spell to the next still falls. Chosen by hand: errors that swing about a value end spells of 2 s with less between them.
const FALLING_SHARE: f64 = 0.05;
/// As many times the goal's tolerance an error is beyond what noise of the view lets it swing by. Chosen by hand.
const FAR: f64 = 20.0;

/// So many times the noise of the points is an error at the most that is noise. Derived: the mean of a spell is that of the noise within some hundredths, and noise that is learnt from four
/// points has a standard deviation of a quarter; the rest is what the arm trembles after the noise.
const IN_NOISE: f64 = 2.0;
/// Share of each measurement in the mean of the noise. Chosen by hand: four seconds of measurements.
const NOISE_SHARE: f64 = 0.01;

/// So many measurements in a row without an error are a target that is lost, and fewer some that were refused. Chosen by hand: at 25 Hz the arm then holds (`safety.measurement_timeout_ms`).
const LOST: u32 = 5;

/// Watches the feature error of an arm at rest. It takes the arm's state at every tick, and the feature error of every measurement that
/// has one.
#[derive(Debug, Clone, Copy, Default)]
pub struct ResidualWatch {
    /// When the present constant error began, and its value then, px.
    since: Option<(MonoNs, f64)>,
    /// The least and the largest value since then, px.
    range_px: (f64, f64),
    now: MonoNs,
    measurements: u32,
    /// The mean error of the last two complete spells, the older one first, px.
    means: [Option<f64>; 2],
    /// The present spell: its begin, the sum of its errors, px, and their number.
    spell: Option<(MonoNs, f64, u32)>,
    /// What vision states that points scatter by, px, a mean over measurements.
    noise_px: f64,
    /// Measurements in a row without an error.
    missed: u32,
    /// The share of the last ticks in which a limit of speed acted.
    slowed: f64,
}

impl ResidualWatch {
    /// Notes at each tick whether a limit of the arm's speed acts, of a joint or in space.
    pub fn note_speed(&mut self, is_limited: bool) {
        self.slowed += (f64::from(u8::from(is_limited)) - self.slowed) / OFTEN_TICKS;
    }

    /// Notes whether the arm is at rest at the tick `now`.
    pub fn note_arm(&mut self, now: MonoNs, at_rest: bool) {
        self.now = now;
        if !at_rest {
            self.since = None;
        }
    }

    /// Notes a measurement at `now` whose feature error is `error_px`, NaN where it has none, and whose points scatter by `noise_px`, root mean square over both coordinates together.
    pub fn note_error(&mut self, now: MonoNs, error_px: f64, noise_px: f64) {
        self.now = now;
        if noise_px.is_finite() {
            let share = if self.noise_px > 0.0 { NOISE_SHARE } else { 1.0 };
            self.noise_px += share * (noise_px - self.noise_px);
        }
        self.note_spell(now, error_px);
        match self.since {
            Some((_, first)) if (error_px - first).abs() <= (STEADY_SHARE * first).max(STEADY_PX) => {
                self.measurements = self.measurements.saturating_add(1);
                let (low, high) = self.range_px;
                self.range_px = (error_px.min(low), error_px.max(high));
            }
            _ => {
                self.range_px = (error_px, error_px);
                self.since = error_px.is_finite().then_some((now, error_px));
                self.measurements = 1;
            }
        }
    }

    /// The spells restart when the target is lost, because the arm then approaches the goal anew.
    fn note_spell(&mut self, now: MonoNs, error_px: f64) {
        if error_px.is_nan() {
            self.missed = self.missed.saturating_add(1);
            if self.missed >= LOST {
                (self.means, self.spell) = ([None; 2], None);
            }
            return;
        }
        self.missed = 0;
        let (since, sum, count) = self.spell.get_or_insert((now, 0.0, 0));
        (*sum, *count) = (*sum + error_px, *count + 1);
        if now - *since >= SPELL && *count >= FEWEST {
            self.means = [self.means[1], Some(*sum / f64::from(*count))];
            self.spell = None;
        }
    }

    /// Restarts after a change of goal or gain: earlier errors no longer count.
    pub fn begin_anew(&mut self) {
        *self = Self { now: self.now, ..Self::default() };
    }

    /// Whether the error is more than `goal_px` and does not fall.
    pub fn is_no_nearer(&self, goal_px: f64) -> bool {
        matches!(self.means, [Some(before), Some(after)] if after > goal_px && after > (1.0 - NEARER_SHARE) * before)
    }

    /// Why the error is more than `goal_px` and does not fall as it should, of a `law` that may follow a moving object, and an arm of so many `joints`; `None` where it falls.
    pub(super) fn why_no_nearer(
        &self,
        goal_px: f64,
        follows: bool,
        (law, joints): (&Law, usize),
    ) -> Option<&'static str> {
        // Means of noise differ by more than an error that falls.
        let is_noise = |px| px > goal_px && px < IN_NOISE * self.noise_px;
        if !follows && self.means[1].is_some_and(is_noise) {
            return Some(WITHIN_NOISE);
        }
        let falls = matches!(self.means, [Some(before), Some(after)] if after > FAR * goal_px && after < (1.0 - FALLING_SHARE) * before);
        let why = match (follows, law.is_torque()) {
            _ if falls => ON_ITS_WAY,
            (true, _) if self.slowed > OFTEN => TOO_SLOW_FOR_OBJECT,
            (true, _) => BEHIND_OBJECT,
            // The measured tilt changes a little with each frame, and the arm creeps after it.
            _ if self.means[1].is_some_and(|px| may_be_tilt(law, joints, px)) => TILT,
            (_, true) => NO_NEARER_BY_TORQUES,
            _ => NO_NEARER,
        };
        self.is_no_nearer(goal_px).then_some(why)
    }

    /// Whether the constant error is of the size of its scatter.
    pub(super) fn scatters(&self) -> bool {
        let (low, high) = self.range_px;
        low < SCATTER_SHARE * high
    }

    /// The constant error, px, of an arm that has stood for 2 s; `None` while the arm or the error moves, or the error is within `goal_px`.
    pub fn constant_px(&self, goal_px: f64) -> Option<f64> {
        let (since, error_px) = self.since?;
        let long = self.now - since >= LONG && self.measurements >= FEWEST;
        (long && error_px > goal_px).then_some(error_px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Errors at 25 Hz for three seconds, of an arm that moves as long as `moves` says.
    fn watched(error_px: impl Fn(i64) -> f64, moves: impl Fn(i64) -> bool) -> Option<f64> {
        let mut watch = ResidualWatch::default();
        for k in 0..3000 {
            watch.note_arm(MonoNs(k * MS), !moves(k));
            if k % 40 == 0 {
                watch.note_error(MonoNs(k * MS), error_px(k), 0.0);
            }
        }
        watch.constant_px(0.05)
    }

    #[test]
    fn an_error_that_does_not_fall_is_told_from_one_that_does() {
        let no_nearer = |error_px: &dyn Fn(f64) -> f64| {
            let mut watch = ResidualWatch::default();
            for k in 0..150 {
                watch.note_error(MonoNs(k * 40 * MS), error_px(0.04 * k as f64), 0.0);
            }
            watch.is_no_nearer(0.05)
        };
        assert!(no_nearer(&|t| 2.0 + 1.5 * (7.0 * t).sin()), "it swings");
        assert!(no_nearer(&|t| 2.0 + t), "it goes away");
        assert!(!no_nearer(&|t| 100.0 * (-0.5 * t).exp()), "it falls");
        assert!(!no_nearer(&|_| 0.03), "this is the goal");
        assert!(!no_nearer(&|t| if t > 3.0 { f64::NAN } else { 2.0 }), "it is lost");
    }

    /// An arm that is slow and on its way is told from one that gets no nearer, and a law of torques has no gain to lower.
    #[test]
    fn why_it_is_no_nearer_is_told() {
        let [velocities, torques] = ["scara-d", "scara-c"].map(|name| {
            let path =
                std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{name}.toml"));
            crate::config::Config::load(Some(&path), &[]).unwrap().servo.law
        });
        let seen = |error_px: &dyn Fn(f64) -> f64, follows, law, slowed_ticks: usize| {
            let mut watch = ResidualWatch::default();
            (0..slowed_ticks).for_each(|_| watch.note_speed(true));
            for k in 0..150 {
                watch.note_error(MonoNs(k * 40 * MS), error_px(0.04 * k as f64), 0.0);
            }
            watch.why_no_nearer(0.1, follows, (law, 4))
        };
        let why = |error_px: &dyn Fn(f64) -> f64, follows, law| seen(error_px, follows, law, 100);
        let slow = |t: f64| 124.0 - 5.0 * t;
        let swings = |t: f64| 2.0 + 1.5 * (7.0 * t).sin();
        assert_eq!(why(&slow, false, &velocities), Some(ON_ITS_WAY));
        assert_eq!(why(&swings, false, &velocities), Some(NO_NEARER));
        assert_eq!(why(&swings, false, &torques), Some(NO_NEARER_BY_TORQUES));
        assert_eq!(why(&swings, true, &velocities), Some(BEHIND_OBJECT));
        assert_eq!(why(&slow, true, &velocities), Some(ON_ITS_WAY));
        assert_eq!(seen(&swings, true, &velocities, 1000), Some(TOO_SLOW_FOR_OBJECT));
        assert!(!TOO_SLOW_FOR_OBJECT.contains("  "), "{TOO_SLOW_FOR_OBJECT}");
        assert_eq!(why(&|t| 124.0 * (-t).exp(), false, &velocities), None);
        // Scheme A with all six numbers of the pose, before four joints.
        let set = ["servo.scheme=position_pd".to_owned()];
        let of_six = crate::config::Config::load(None, &set).unwrap().servo.law;
        assert_eq!(why(&|t| 0.147 + 0.02 * (7.0 * t).sin(), false, &of_six), Some(TILT));
        assert_eq!(why(&swings, false, &of_six), Some(NO_NEARER_BY_TORQUES));
    }

    /// An error that is as large as the noise is no fault of the gain; one beyond it is.
    #[test]
    fn an_error_within_the_noise_of_points_is_told() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scara-d.toml");
        let law = crate::config::Config::load(Some(&path), &[]).unwrap().servo.law;
        let why = |noise_px| {
            let mut watch = ResidualWatch::default();
            for k in 0..300 {
                watch.note_error(MonoNs(k * 40 * MS), 1.0 + 0.5 * f64::sin(7.0 * k as f64), noise_px);
            }
            watch.why_no_nearer(0.1, false, (&law, 4))
        };
        assert_eq!(why(1.0), Some(WITHIN_NOISE));
        assert_eq!(why(0.1), Some(NO_NEARER));
        assert!(!WITHIN_NOISE.contains("  ") && falls_no_more(WITHIN_NOISE) && !stands(WITHIN_NOISE));
    }

    #[test]
    fn a_steady_error_is_told_from_one_that_is_noise() {
        let scatters = |error_px: &dyn Fn(i64) -> f64| {
            let mut watch = ResidualWatch::default();
            for k in 0..75 {
                watch.note_error(MonoNs(k * 40 * MS), error_px(k), 0.0);
            }
            assert!(watch.constant_px(1e-4).is_some());
            watch.scatters()
        };
        assert!(scatters(&|k| 0.002 + 1e-3 * ((7 * k) % 5) as f64), "noise");
        assert!(!scatters(&|k| 0.04 + 1e-3 * ((7 * k) % 5) as f64), "an error with noise");
        assert!(!scatters(&|_| 3.0));
        assert!(
            stands(BELOW_SCATTER)
                && falls_no_more(NO_NEARER)
                && !stands(NO_NEARER)
                && !falls_no_more(ON_ITS_WAY)
        );
    }

    #[test]
    fn an_arm_that_stands_before_an_error_is_told() {
        let noisy = |k: i64| 3.0 + if k % 80 == 0 { 0.1 } else { 0.0 };
        assert_eq!(watched(noisy, |_| false), Some(3.1));
        assert!(watched(|_| 3.0, |k| k < 500).is_some(), "it has come to rest in time");
    }

    #[test]
    fn whatever_is_on_its_way_or_at_the_goal_is_not() {
        assert_eq!(watched(|_| 3.0, |k| k < 1500), None, "not at rest for long");
        assert_eq!(watched(|_| 3.0, |k| k == 2000), None, "it moved");
        assert_eq!(watched(|k| 3.0 * (-1e-3 * k as f64).exp(), |_| false), None, "the error falls");
        assert_eq!(watched(|_| 0.04, |_| false), None, "this is the goal");
        assert_eq!(watched(|k| if k > 2000 { f64::NAN } else { 3.0 }, |_| false), None, "the target is lost");
        let mut rare = ResidualWatch::default();
        rare.note_error(MonoNs(0), 3.0, 0.0);
        rare.note_arm(MonoNs(5000 * MS), true);
        assert_eq!(rare.constant_px(0.05), None, "one measurement tells nothing");
        assert_eq!(ResidualWatch::default().constant_px(0.05), None);
    }
}
