//! Several targets: what was seen of one is never used for another, and each has its own way back and its own known place.

use super::*;
use nalgebra::Vector2;

/// Nothing that was seen of one target is used for the goal of another, neither before nor after the change.
#[test]
fn another_target_is_waited_for() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 0..=50);
    assert_eq!(s.add_measurement(MonoNs(50 * MS), &seen_at(20), &robot), MeasurementVerdict::Used);
    assert!(s.law_output(&q_at(50), &Vector4::zeros(), &robot).is_some());
    let other = s.set_point().clone().with_target(1);
    s.set_goal(other);
    assert!(s.law_output(&q_at(50), &Vector4::zeros(), &robot).is_none());
    assert!(s.way_back(&q_at(50), false).is_none());
    let of_old = seen_at(40);
    assert_eq!(s.add_measurement(MonoNs(50 * MS), &of_old, &robot), MeasurementVerdict::OtherTarget);
    assert!(s.law_output(&q_at(50), &Vector4::zeros(), &robot).is_none());
    // Also of an exposure before that of the last measurement of the old one.
    let of_new = Measurement { target_number: 1, ..seen_at(10) };
    assert_eq!(s.add_measurement(MonoNs(50 * MS), &of_new, &robot), MeasurementVerdict::Used);
    assert!(s.law_output(&q_at(50), &Vector4::zeros(), &robot).is_some());
}

/// The place where the target was last seen goes where it is to be shown, with the arm near the posture from which it was seen, and further where that moves.
#[test]
fn the_place_is_shown_where_it_is_wanted() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    moved_to(&mut s, 0..=100);
    let nowhere = s.look_around(&robot, &q_at(100), (&Vector2::zeros(), &Vector2::zeros()));
    assert!(nowhere.is_none(), "it was never seen");
    assert!(s.add_measurement(MonoNs(100 * MS), &seen_at(100), &robot).is_used());
    let place = Pose::new([1.0, 1.0, 1.1].into(), [0.0, 0.0, 0.7].into()) * Point3::new(0.05, 0.05, 0.0);
    let mut q = q_at(100);
    let (mut s_d, rate) = (Vector2::new(0.1, -0.2), Vector2::new(-0.05, 0.02));
    for k in 0..6000 {
        let moves = k >= 3000;
        let rate = if moves { rate } else { Vector2::zeros() };
        let (qd, off) = s.look_around(&robot, &q, (&s_d, &rate)).unwrap();
        let p_C = robot.forward(&q).inverse() * place;
        assert!((off - (s_d - p_C.coords.xy() / p_C.z).norm()).abs() < 1e-9);
        assert!(k % 3000 < 2500 || off < 3e-3, "{k}: {off}");
        q += qd * 1e-3;
        s_d += rate * 1e-3;
    }
    // This camera looks down, and is turned rather than moved: shoulder, elbow and lift hardly take part.
    let moved = q - q_at(100);
    assert!(moved.fixed_rows::<3>(0).amax() < 0.1 && moved.amax() < 1.5, "{moved}");
}

/// An arm that looks for a target again goes back to where it saw that one, once it is known to be out of view.
#[test]
fn each_target_has_a_way_back_of_its_own() {
    let robot = scara();
    let mut s = servo(UpdatePolicy::Predict);
    s.settings.returns = true;
    moved_to(&mut s, 0..=100);
    let end =
        |s: &VisualServo<4>| s.way_back(&q_at(100), false).map(|(qd, way)| q_at(100) + qd / way.rate_1_s);
    let near = |q: Option<Vector4<f64>>, ms: i64| q.is_some_and(|q| (q - q_at(ms)).norm() < 1e-9);
    let (first, second) = (s.set_point().clone(), s.set_point().clone().with_target(1));
    let blind = |target_number| Measurement { target_number, ..Measurement::default() };
    assert!(s.add_measurement(MonoNs(100 * MS), &seen_at(20), &robot).is_used());
    s.set_goal(second.clone());
    assert!(s.looks_for_another() && !s.knows_no_place());
    for misses in 1..=3 {
        // What is seen of the first target, or not, says nothing about the second one.
        s.add_measurement(MonoNs(100 * MS), &blind(0), &robot);
        s.add_measurement(MonoNs(100 * MS), &blind(1), &robot);
        assert_eq!(s.knows_no_place(), misses == 3, "{misses}");
        assert!(end(&s).is_none(), "it was never seen");
    }
    let of_second = Measurement { target_number: 1, ..seen_at(60) };
    assert!(s.add_measurement(MonoNs(100 * MS), &of_second, &robot).is_used());
    assert!(near(end(&s), 60) && !s.looks_for_another());
    for (goal, number, ms) in [(first, 0, 20), (second, 1, 60)] {
        s.set_goal(goal);
        for _ in 0..2 {
            s.add_measurement(MonoNs(100 * MS), &blind(number), &robot);
            assert!(end(&s).is_none(), "not known yet whether it is in view");
        }
        s.add_measurement(MonoNs(100 * MS), &blind(number), &robot);
        assert!(near(end(&s), ms) && !s.knows_no_place(), "{number}");
    }
    s.settings.returns = false;
    assert!(end(&s).is_none());
}

/// A goal of a further target, with depths that are known, is what it is for a law that has that target alone.
#[test]
fn known_depths_are_those_of_the_goals_target() {
    let robot = scara();
    let X_BO = Pose::new([1.0, 1.0, 1.1].into(), [0.0, 0.0, 0.7].into());
    let elsewhere = Pose::new([1.3, 0.7, 0.8].into(), [0.0, 0.0, 0.2].into());
    let first_output = |X_WO: Vec<Pose>, target_number: u32| {
        let mut s = servo(UpdatePolicy::Predict);
        let Law::ImageVelocity { interaction, .. } = &mut s.settings.law else { panic!("another law") };
        interaction.depth = DepthSource::Known;
        s.settings.X_WO = X_WO;
        moved_to(&mut s, 0..=50);
        if target_number > 0 {
            let goal = s.set_point().clone().with_target(target_number);
            s.set_goal(goal);
        }
        let m = Measurement { target_number, ..seen_at(20) };
        s.add_measurement(MonoNs(50 * MS), &m, &robot)
            .is_used()
            .then(|| velocity(s.law_output(&q_at(50), &Vector4::zeros(), &robot)))
    };
    let alone = first_output(vec![X_BO], 0).unwrap();
    assert_eq!(first_output(vec![elsewhere, X_BO], 1), Some(alone));
    assert_ne!(first_output(vec![X_BO, elsewhere], 1), Some(alone));
    // A place that nobody knows is not that of another target: the law then goes without.
    let without = first_output(Vec::new(), 0);
    assert_ne!(without, Some(alone));
    assert_eq!(first_output(vec![X_BO], 1), without);
}
