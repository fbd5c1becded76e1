use super::pace::as_quick_as_held;
use super::*;
use crate::robot::Mount;
use crate::servo::{
    Damping, DepthSource, Gain, HybridGains, Interaction, InteractionAt, OperationalSpace, OrientationError,
    TwistWeights,
};
use crate::servo::{GoalPath, Law, ObjectDynamics};
use crate::sim::perfect_measurement;
use nalgebra::{Point3, Vector3, Vector4};
use proptest::prelude::*;

mod targets;

const MS: i64 = 1_000_000;

fn square() -> [Point3<f64>; 4] {
    [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
}

fn scara() -> Robot<4> {
    crate::robot::load("scara").unwrap().build::<4>().unwrap()
}

fn servo(update: UpdatePolicy) -> VisualServo<4> {
    let goal = Pose::new([-0.1, 0.1, 0.6].into(), [0.0, 0.0, -1.0].into());
    let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
    let interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };
    let law = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction };
    let mount = Mount::EyeInHand { X_EC: Pose::identity() };
    VisualServo::new(ServoSettings::new(law, update, mount), set_point)
}

fn q_at(ms: i64) -> Vector4<f64> {
    Vector4::new(0.0002 * ms as f64, 1.6, 0.5 + 0.0001 * ms as f64, -0.8)
}

/// What the camera sees at `ms` of an object at rest.
fn seen_at(ms: i64) -> Measurement {
    let X_BO = Pose::new([1.0, 1.0, 1.1].into(), [0.0, 0.0, 0.7].into());
    let X_CO = scara().forward(&q_at(ms)).inverse() * X_BO;
    perfect_measurement(&square(), &X_CO, MonoNs(ms * MS)).unwrap()
}

fn moved_to(servo: &mut VisualServo<4>, ms: std::ops::RangeInclusive<i64>) {
    for k in ms {
        servo.note_arm(MonoNs(k * MS), &q_at(k), &Vector4::new(0.2, 0.0, 0.1, 0.0));
    }
}

fn velocity(law_output: Option<LawOutput<4>>) -> Vector4<f64> {
    match law_output.unwrap() {
        LawOutput::Velocity(qd) => qd,
        LawOutput::Torque(_) => panic!("a velocity law"),
    }
}

#[test]
fn a_late_measurement_is_worth_a_fresh_one_under_predict() {
    let robot = scara();
    let (mut late, mut fresh) = (servo(UpdatePolicy::Predict), servo(UpdatePolicy::Predict));
    for s in [&mut late, &mut fresh] {
        moved_to(s, 0..=100);
    }
    assert_eq!(late.add_measurement(MonoNs(100 * MS), &seen_at(40), &robot), MeasurementVerdict::Used);
    assert_eq!(fresh.add_measurement(MonoNs(100 * MS), &seen_at(100), &robot), MeasurementVerdict::Used);
    let (a, b) = (
        velocity(late.law_output(&q_at(100), &Vector4::zeros(), &robot)),
        velocity(fresh.law_output(&q_at(100), &Vector4::zeros(), &robot)),
    );
    assert!((a - b).norm() < 1e-9, "{a} {b}");
    let mut held = servo(UpdatePolicy::Tick);
    moved_to(&mut held, 0..=100);
    held.add_measurement(MonoNs(100 * MS), &seen_at(40), &robot);
    assert!(
        (velocity(held.law_output(&q_at(100), &Vector4::zeros(), &robot)) - b).norm() > 1e-3,
        "without prediction the delay shows"
    );
}

#[test]
fn a_lead_looks_at_where_a_lagging_arm_will_come_to_rest() {
    let robot = scara();
    let (mut ahead, mut there) = (servo(UpdatePolicy::Predict), servo(UpdatePolicy::Predict));
    ahead.settings.lead = SpanNs(100 * MS);
    for s in [&mut ahead, &mut there] {
        moved_to(s, 0..=100);
        s.add_measurement(MonoNs(100 * MS), &seen_at(100), &robot);
    }
    let (q, qd) = (q_at(100), Vector4::new(0.2, 0.0, 0.1, 0.0));
    let (a, b) = (
        velocity(ahead.law_output(&q, &qd, &robot)),
        velocity(there.law_output(&(q + qd * 0.1), &qd, &robot)),
    );
    let without = velocity(there.law_output(&q, &qd, &robot));
    // The Jacobian alone is that of q.
    assert!((a - b).norm() < 0.2 * (without - b).norm(), "{a} {b} {without}");
}

#[test]
fn frame_holds_and_tick_follows_the_arm() {
    let robot = scara();
    for (update, holds) in [(UpdatePolicy::Frame, true), (UpdatePolicy::Tick, false)] {
        let mut s = servo(update);
        moved_to(&mut s, 0..=10);
        s.add_measurement(MonoNs(10 * MS), &seen_at(10), &robot);
        let first = velocity(s.law_output(&q_at(10), &Vector4::zeros(), &robot));
        let later = velocity(s.law_output(&q_at(400), &Vector4::zeros(), &robot));
        assert_eq!(first == later, holds);
    }
}

#[test]
fn restore_gain_returns_to_full_gain() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Tick);
    let Law::ImageVelocity { gain, .. } = &mut s.settings.law else { panic!("this law") };
    *gain = Gain::Constant(4.0); // slow ones are not slowed down
    moved_to(&mut s, 0..=10);
    s.add_measurement(MonoNs(10 * MS), &seen_at(10), &robot);
    let speed = |s: &mut VisualServo<4>| velocity(s.law_output(&q_at(400), &Vector4::zeros(), &robot)).norm();
    let full = speed(&mut s);
    while s.reduce_gain() {}
    assert!(speed(&mut s) < 0.7 * full, "{} of {full}", speed(&mut s));
    s.restore_gain();
    assert_eq!(speed(&mut s), full);
}

#[test]
fn stamps_decide_what_is_used() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 1000..=1100);
    let now = MonoNs(1100 * MS);
    assert!(s.law_output(&q_at(1100), &Vector4::zeros(), &robot).is_none());
    assert_eq!(s.add_measurement(now, &seen_at(1160), &robot), MeasurementVerdict::RefusedFromFuture);
    assert_eq!(s.add_measurement(now, &seen_at(1080), &robot), MeasurementVerdict::Used);
    assert_eq!(s.add_measurement(now, &seen_at(1080), &robot), MeasurementVerdict::NotNewer, "repeated");
    assert_eq!(s.add_measurement(now, &seen_at(1040), &robot), MeasurementVerdict::NotNewer, "overtaken");
    assert_eq!(s.add_measurement(now, &seen_at(1120), &robot), MeasurementVerdict::UsedFromFuture);
    let lost = Measurement { exposure: MonoNs(1130 * MS), ..Measurement::default() };
    assert_eq!(s.add_measurement(now, &lost, &robot), MeasurementVerdict::NoTarget);
    // whatever else a refused measurement carries
    let refused = Measurement { status: TargetStatus::Inconsistent as u32, ..seen_at(1130) };
    assert_eq!(s.add_measurement(now, &refused, &robot), MeasurementVerdict::Inconsistent);
}

#[test]
fn a_frame_from_before_the_first_tick_shows_the_arm_at_rest() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 1000..=1001);
    assert_eq!(s.add_measurement(MonoNs(1001 * MS), &seen_at(970), &robot), MeasurementVerdict::Used);
    let mut restarted = servo(UpdatePolicy::Predict);
    moved_to(&mut restarted, 1000..=1001);
    restarted.add_measurement(MonoNs(1001 * MS), &seen_at(1000), &robot);
    restarted.note_arm(MonoNs(5 * MS), &q_at(5), &Vector4::zeros());
    assert_eq!(
        restarted.add_measurement(MonoNs(2000 * MS), &seen_at(1001), &robot),
        MeasurementVerdict::Used
    );
}

#[test]
fn poses_that_no_object_before_a_camera_has_are_refused() {
    let robot = scara();
    let good = seen_at(10);
    let pose = |change: &dyn Fn(&mut [f64; 7])| {
        let mut m = good;
        change(&mut m.pose);
        m
    };
    let mut wild = good;
    wild.pose_covariance[7] = f64::NAN;
    let mut negative = good;
    negative.pose_covariance[7] = -1e-6;
    for (what, m) in [
        ("not finite", pose(&|p| p[1] = f64::NAN)),
        ("infinite", pose(&|p| p[0] = f64::INFINITY)),
        ("no rotation", pose(&|p| p[3..].fill(0.0))),
        ("longer than a rotation", pose(&|p| p[3..].iter_mut().for_each(|x| *x *= 1.001))),
        ("behind the camera", pose(&|p| p[2] = -p[2])),
        ("two kilometres away", pose(&|p| p[2] = 2e3)),
        ("two kilometres aside", pose(&|p| p[0] = 2e3)),
        ("covariance that is not finite", wild),
        ("negative variance", negative),
    ] {
        let mut s = servo(UpdatePolicy::Predict);
        moved_to(&mut s, 0..=20);
        let verdict = s.add_measurement(MonoNs(20 * MS), &m, &robot);
        assert_eq!(verdict, MeasurementVerdict::ImpossiblePose, "{what}");
        assert!(!verdict.is_used() && s.law_output(&q_at(20), &Vector4::zeros(), &robot).is_none(), "{what}");
        // Without the flag there is no pose that could be wrong.
        let unposed = Measurement { flags: 0, ..m };
        assert_eq!(s.add_measurement(MonoNs(20 * MS), &unposed, &robot), MeasurementVerdict::Used, "{what}");
    }
}

#[test]
fn an_image_that_stays_while_the_camera_moves_is_not_newer() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 0..=400);
    let now = MonoNs(400 * MS);
    let seen_at = |ms: i64| {
        let mut seen = seen_at(ms);
        seen.features.iter_mut().for_each(|feature| feature.sd_px = 0.05);
        seen
    };
    assert!(s.add_measurement(now, &seen_at(40), &robot).is_used());
    // By 10 ms the arm has moved by 2 mrad, by 160 ms by 32 mrad.
    let again = |ms: i64| Measurement { exposure: MonoNs(ms * MS), ..seen_at(40) };
    assert_eq!(s.add_measurement(now, &again(200), &robot), MeasurementVerdict::NotNewer);
    assert_eq!(s.add_measurement(now, &again(240), &robot), MeasurementVerdict::NotNewer, "and stays so");
    assert!(s.add_measurement(now, &again(42), &robot).is_used(), "hardly a pixel");
    assert!(s.add_measurement(now, &seen_at(280), &robot).is_used(), "a new image");
    // Noise of a hundredth of a pixel makes another image of it.
    let mut other = Measurement { exposure: MonoNs(320 * MS), ..seen_at(280) };
    for (k, feature) in (0..).zip(&mut other.features) {
        feature.x += 1.25e-5 * f64::from(k % 2 * 2 - 1);
    }
    assert!(s.add_measurement(now, &other, &robot).is_used());
}

/// Of a camera that repeats one image each step is too small to be seen; all together are not.
#[test]
fn an_image_that_stays_while_the_camera_creeps_is_not_newer() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 0..=400);
    let mut seen = seen_at(40);
    seen.features.iter_mut().for_each(|feature| feature.sd_px = 0.05);
    let mut verdicts = Vec::new();
    for k in 0..80 {
        seen.exposure = MonoNs((40 + 2 * k) * MS);
        verdicts.push(s.add_measurement(MonoNs(400 * MS), &seen, &robot));
    }
    // By 2 ms the arm has moved by 0.4 mrad; 2 px are 2.5 mrad.
    let used = verdicts.iter().take_while(|verdict| verdict.is_used()).count();
    assert!((2..=20).contains(&used), "{used}");
    assert!(verdicts[used..].iter().all(|verdict| *verdict == MeasurementVerdict::NotNewer), "{verdicts:?}");
}

#[test]
fn the_way_back_leads_to_where_the_whole_target_was_seen() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 0..=100);
    s.add_measurement(MonoNs(100 * MS), &seen_at(40), &robot);
    assert!(s.way_back(&q_at(100), false).is_none(), "not asked for");
    s.settings.returns = true;
    let (qd, convergence) = s.way_back(&q_at(100), false).unwrap();
    assert!((q_at(100) + qd / convergence.rate_1_s - q_at(40)).norm() < 1e-9, "{qd}");
    assert!(s.way_back(&q_at(40), false).is_none(), "there already");
    // A part of the target is not the whole of it.
    let mut partial = seen_at(80);
    partial.feature_count = 3;
    assert!(s.add_measurement(MonoNs(100 * MS), &partial, &robot).is_used());
    assert_eq!(s.way_back(&q_at(100), false).unwrap().0, qd);
    let mut blind = servo(UpdatePolicy::Predict);
    blind.settings.returns = true;
    assert!(blind.way_back(&q_at(0), false).is_none(), "nothing was seen");
}

/// Every law, with everything on that looks at a measurement.
fn every_law() -> Vec<VisualServo<4>> {
    let gain = Gain::Constant(1.0);
    let (orientation, K) = (OrientationError::AngleAxis, crate::servo::PoseGains::repeat(1.0));
    let mut all = Vec::new();
    for space in [OperationalSpace::Four, OperationalSpace::Six] {
        let gains = HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(1.0).into() };
        all.push(Law::PositionVelocity { K, gain, orientation, space, weights: TwistWeights::Unit });
        all.push(Law::PositionTorque { K_P: K, damping: Damping::Task(K), orientation, space });
        all.push(Law::Hybrid { gains, gain, orientation, space, depth: DepthSource::Desired });
    }
    for (at, depth) in [
        (InteractionAt::Current, DepthSource::Estimated),
        (InteractionAt::Mean, DepthSource::Estimated),
        (InteractionAt::Desired, DepthSource::Desired),
    ] {
        let interaction = Interaction { at, depth };
        all.push(Law::ImageVelocity { K_s: 1.0.into(), gain, interaction });
        all.push(Law::ImageTorque { K_Ps: 1.0.into(), damping: Damping::Task(1.0.into()), interaction });
    }
    let of = |(i, law)| {
        let mut settings = servo(UpdatePolicy::Predict).settings().clone();
        settings.law = law;
        settings.update = [UpdatePolicy::Predict, UpdatePolicy::Tick, UpdatePolicy::Frame][i % 3];
        settings.limit_avoidance_1_s = Some(1.0);
        settings.object = (i % 2 == 0).then_some(ObjectDynamics {
            acceleration_m_s2: 0.3,
            acceleration_rad_s2: 0.3,
            largest_sd_m: 0.05,
        });
        VisualServo::new(settings, servo(UpdatePolicy::Predict).set_point().clone())
    };
    all.into_iter().enumerate().map(of).collect()
}

/// Any bits, and those at the ends of what numbers mean.
fn bits() -> impl Strategy<Value = u64> {
    prop_oneof![
        any::<u64>(),
        any::<f64>().prop_map(f64::to_bits),
        prop::sample::select(vec![
            0,
            1,
            u64::MAX,
            i64::MAX as u64,
            i64::MIN as u64,
            f64::NAN.to_bits(),
            f64::INFINITY.to_bits(),
            f64::NEG_INFINITY.to_bits(),
            f64::MAX.to_bits(),
            f64::MIN_POSITIVE.to_bits(),
            1e300f64.to_bits(),
            (-1.0f64).to_bits(),
        ]),
    ]
}

/// Puts `bits` into field `which` of a measurement.
fn spoil(m: &mut Measurement, which: usize, at: usize, bits: u64) {
    let number = f64::from_bits(bits);
    let feature = at % m.features.len().min(5);
    match which {
        0 => m.frame_id = bits,
        1 => m.exposure = MonoNs(bits as i64),
        2 => m.frame_sent = MonoNs(bits as i64),
        3 => m.vision_start = MonoNs(bits as i64),
        4 => m.vision_end = MonoNs(bits as i64),
        5 => (m.frames_received, m.frames_dropped, m.target_lost) = (bits, bits, bits),
        6 => m.camera = bits as u32,
        7 => m.status = bits as u32,
        8 => m.flags = bits as u32,
        9 => m.feature_count = bits as u32,
        10 => m.features[feature].id = bits,
        11 => (m.features[feature].u_px, m.features[feature].v_px) = (number, number),
        12 => m.features[feature].x = number,
        13 => m.features[feature].y = number,
        14 => m.features[feature].sd_px = number,
        15 | 16 => m.pose[at % 7] = number,
        17 => m.pose_covariance[at % 36] = number,
        18 => m.pose_covariance = [number; 36],
        _ => m.reprojection_rms_px = number,
    }
}

proptest! {
    /// Shared memory may hold anything: a measurement is refused, or what is asked for is finite.
    #[test]
    fn any_measurement_gives_a_finite_output_without_panic(
        spoilt in prop::collection::vec((0usize..20, 0usize..36, bits()), 1..4),
        clock in prop::sample::select(vec![i64::MIN, -5, 0, 1_000_000_000, i64::MAX - 400 * MS]),
    ) {
        let robot = scara();
        let at = |ms: i64| MonoNs(clock.saturating_add(ms * MS));
        for mut s in every_law() {
            for k in 0..=100 {
                s.note_arm(at(k), &q_at(k), &Vector4::new(0.2, 0.0, 0.1, 0.0));
            }
            let shifted = |ms: i64| Measurement { exposure: at(ms), ..seen_at(ms) };
            let mut bad = shifted(60);
            for (which, place, bits) in &spoilt {
                spoil(&mut bad, *which, *place, *bits);
            }
            for m in [shifted(40), bad, shifted(80), bad] {
                s.add_measurement(at(100), &m, &robot);
                if let Some(law_output) = s.law_output(&q_at(100), &Vector4::new(0.2, 0.0, 0.1, 0.0), &robot) {
                    prop_assert!(law_output.is_finite(), "{:?}: {law_output:?}", s.settings().law);
                }
                prop_assert!(s.confidence(at(100)) <= 1.0);
            }
        }
    }
}

/// What `predict` asks for falls with the rate of the held law that it keeps up with, and never asks for less at a higher gain.
#[test]
fn low_gains_settle_as_held_ones_and_high_ones_as_set() {
    for lambda_T in [0.0, 0.01, 0.05, 0.1, 0.2] {
        let x = as_quick_as_held(lambda_T);
        assert!((x - (x * lambda_T).exp()).abs() < 1e-2, "{lambda_T}: {x}");
    }
    let rates: Vec<f64> = (0..100).map(|i| 0.01 * f64::from(i)).map(|r| r * as_quick_as_held(r)).collect();
    assert!(rates.is_sorted() && (as_quick_as_held(0.4) - 1.0).abs() < 1e-12);
}

/// The path begins with the first law output, again where that is asked for, and ends where another goal is set; an arm that looks ahead follows the
/// goal of then.
#[test]
fn a_path_begins_with_the_law_and_ends_with_another_goal() {
    let (robot, still) = (scara(), Vector4::zeros());
    let mut s = servo(UpdatePolicy::Predict);
    let first = *s.set_point().X_DO().unwrap();
    let last = Pose::new([-0.05, 0.1, 0.7].into(), [0.0, 0.0, -0.8].into());
    let path = GoalPath::new(&[(0.0, first), (1.0, last)], true).unwrap();
    s.settings.path = Some(path.clone());
    s.settings.lead = SpanNs(50 * MS);
    moved_to(&mut s, 0..=100);
    s.add_measurement(MonoNs(100 * MS), &seen_at(100), &robot);
    assert_eq!((s.path_began(), *s.set_point().X_DO().unwrap()), (None, first));
    for (ms, t_s) in [(100, 0.05), (400, 0.35), (1100, 1.05)] {
        moved_to(&mut s, ms..=ms);
        velocity(s.law_output(&q_at(100), &still, &robot));
        assert_eq!(s.path_began(), Some(MonoNs(100 * MS)));
        assert_eq!(*s.set_point().X_DO().unwrap(), path.at(t_s).X_DO, "{ms}");
    }
    s.restart_path();
    velocity(s.law_output(&q_at(100), &still, &robot));
    assert_eq!(s.path_began(), Some(MonoNs(1100 * MS)));
    let other = s.set_point().clone();
    s.set_goal(other.clone());
    moved_to(&mut s, 2000..=2000);
    velocity(s.law_output(&q_at(100), &still, &robot));
    assert_eq!((s.path_began(), s.set_point()), (None, &other));
}
