use super::*;
use crate::servo::{DepthSource, Gain, Interaction, InteractionAt};
use crate::sim::perfect_measurement;
use nalgebra::{Point3, Vector4};

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
    let law = Law::ImageVelocity { gain: Gain::Constant(1.0), interaction };
    let mount = Mount::EyeInHand { X_EC: Pose::identity() };
    VisualServo::new(ServoSettings::new(law, set_point, update, mount))
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

fn velocity(wish: Option<Wish<4>>) -> Vector4<f64> {
    match wish.unwrap() {
        Wish::Velocity(qd) => qd,
        Wish::Torque(_) => panic!("a velocity law"),
    }
}

#[test]
fn a_late_measurement_is_worth_a_fresh_one_under_predict() {
    let robot = scara();
    let (mut late, mut fresh) = (servo(UpdatePolicy::Predict), servo(UpdatePolicy::Predict));
    for s in [&mut late, &mut fresh] {
        moved_to(s, 0..=100);
    }
    assert_eq!(late.take(MonoNs(100 * MS), &seen_at(40), &robot), Intake::Used);
    assert_eq!(fresh.take(MonoNs(100 * MS), &seen_at(100), &robot), Intake::Used);
    let (a, b) = (
        velocity(late.wish(&q_at(100), &Vector4::zeros(), &robot)),
        velocity(fresh.wish(&q_at(100), &Vector4::zeros(), &robot)),
    );
    assert!((a - b).norm() < 1e-9, "{a} {b}");
    let mut held = servo(UpdatePolicy::Tick);
    moved_to(&mut held, 0..=100);
    held.take(MonoNs(100 * MS), &seen_at(40), &robot);
    assert!(
        (velocity(held.wish(&q_at(100), &Vector4::zeros(), &robot)) - b).norm() > 1e-3,
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
        s.take(MonoNs(100 * MS), &seen_at(100), &robot);
    }
    let (q, qd) = (q_at(100), Vector4::new(0.2, 0.0, 0.1, 0.0));
    let (a, b) = (velocity(ahead.wish(&q, &qd, &robot)), velocity(there.wish(&(q + qd * 0.1), &qd, &robot)));
    let without = velocity(there.wish(&q, &qd, &robot));
    // The Jacobian alone is that of q.
    assert!((a - b).norm() < 0.2 * (without - b).norm(), "{a} {b} {without}");
}

#[test]
fn frame_holds_and_tick_follows_the_arm() {
    let robot = scara();
    for (update, holds) in [(UpdatePolicy::Frame, true), (UpdatePolicy::Tick, false)] {
        let mut s = servo(update);
        moved_to(&mut s, 0..=10);
        s.take(MonoNs(10 * MS), &seen_at(10), &robot);
        let first = velocity(s.wish(&q_at(10), &Vector4::zeros(), &robot));
        let later = velocity(s.wish(&q_at(400), &Vector4::zeros(), &robot));
        assert_eq!(first == later, holds);
    }
}

#[test]
fn stamps_decide_what_is_used() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 1000..=1100);
    let now = MonoNs(1100 * MS);
    assert!(s.wish(&q_at(1100), &Vector4::zeros(), &robot).is_none());
    assert_eq!(s.take(now, &seen_at(1160), &robot), Intake::RefusedFromFuture);
    assert_eq!(s.take(now, &seen_at(1080), &robot), Intake::Used);
    assert_eq!(s.take(now, &seen_at(1080), &robot), Intake::NotNewer, "repeated");
    assert_eq!(s.take(now, &seen_at(1040), &robot), Intake::NotNewer, "overtaken");
    assert_eq!(s.take(now, &seen_at(1120), &robot), Intake::UsedFromFuture);
    let lost = Measurement { exposure: MonoNs(1130 * MS), ..Measurement::default() };
    assert_eq!(s.take(now, &lost, &robot), Intake::NoTarget);
    // whatever else a refused measurement carries
    let refused = Measurement { status: TargetStatus::Inconsistent as u32, ..seen_at(1130) };
    assert_eq!(s.take(now, &refused, &robot), Intake::Inconsistent);
}

#[test]
fn a_frame_from_before_the_first_tick_shows_the_arm_at_rest() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 1000..=1001);
    assert_eq!(s.take(MonoNs(1001 * MS), &seen_at(970), &robot), Intake::Used);
    let mut restarted = servo(UpdatePolicy::Predict);
    moved_to(&mut restarted, 1000..=1001);
    restarted.take(MonoNs(1001 * MS), &seen_at(1000), &robot);
    restarted.note_arm(MonoNs(5 * MS), &q_at(5), &Vector4::zeros());
    assert_eq!(restarted.take(MonoNs(2000 * MS), &seen_at(1001), &robot), Intake::Used);
}
