//! Where the textbook's statements need a second look: its errors, each one checked in numbers.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers beside the tests
#![allow(non_snake_case)] // X, Y, H, T as in the text

use nalgebra::{Matrix6, Vector3, Vector6};
use vservo::experiment::{
    Cell, FeatureSource, Metrics, POINTS, ROTATIONS_DEG, SCHEMES, Scheme, SchemeController, Teaching,
    Trajectory, TrajectoryEnd, TrajectoryRow, calibrations, project, pure_rotation, retreat_of,
    run_miscalibrated, segment_selection, set_point, simulate,
};
use vservo::geometry::{Pose, integrate_body_twist};
use vservo::robot::CameraJacobian;
use vservo::servo::{
    Arm, Damping, DepthSource, Gain, HybridGains, Interaction, InteractionAt, J_o, Law, LawOutput,
    OperationalSpace, OrientationError, SetPoint, View,
};

#[test]
fn retreat_grows_with_the_rotation() {
    let peak = |degrees: f64, depth| retreat_of(&pure_rotation(degrees.to_radians(), depth).unwrap());
    let mut last = (1.0, 1.0);
    for degrees in ROTATIONS_DEG {
        let (desired, known) = (peak(degrees, DepthSource::Desired), peak(degrees, DepthSource::Known));
        assert!(desired > last.0 && known > last.1);
        let theory = 1.0 / (0.5 * degrees.to_radians()).cos();
        let tolerance = if degrees < 175.0 { 0.01 } else { 0.1 }; // the step is no longer small against the passage
        assert!((known / theory - 1.0).abs() < tolerance, "{degrees}: {known} {theory}");
        assert!(desired < known);
        last = (desired, known);
    }
}

#[test]
fn scheme_c_is_close_to_its_limit() {
    let cell = Cell::textbook().unwrap();
    let run = |gain: f64, depth| {
        let interaction = Interaction { at: InteractionAt::Current, depth };
        let law = Law::ImageTorque {
            K_Ps: (300.0 * gain).into(),
            damping: Damping::Task((330.0 * gain).into()),
            interaction,
        };
        let goal = set_point(&cell.X_DO, Scheme::C.selection()).unwrap();
        let mut controller = SchemeController::new(&cell, law, goal, None).knowing_depth();
        simulate(&cell, "C", &mut FeatureSource::Ideal, 40.0, |frame| controller.control(frame))
    };
    let away = |run: &Trajectory| (run.rows.last().unwrap().x_c - cell.goal().unwrap().x_c).norm();
    let ends_elsewhere = |run: &Trajectory| run.end != TrajectoryEnd::Finished || away(run) > 1.0;
    let printed = run(1.0, DepthSource::Desired);
    assert!(away(&printed) < 1e-6 && !ends_elsewhere(&run(1.1, DepthSource::Desired)));
    assert!(ends_elsewhere(&run(1.15, DepthSource::Desired)), "a seventh more is too much");
    let highest = |run: &Trajectory| run.rows.iter().map(|row| row.x_c.z).fold(f64::INFINITY, f64::min);
    let known = run(1.0, DepthSource::Known);
    let (printed, known) = (highest(&printed), highest(&known));
    // 0.4 m is the goal; the start is at 0.5 m.
    assert!(
        (printed - 0.127).abs() < 0.001 && known < 0.5 - 2.0,
        "the true depth is worse: {printed} {known}"
    );
}

#[test]
fn the_text_has_no_gains_for_the_segment() {
    let cell = Cell::textbook().unwrap();
    let law = Law::ImageTorque {
        K_Ps: 300.0.into(),
        damping: Damping::Task(330.0.into()),
        interaction: Interaction::TEXTBOOK,
    };
    let goal = set_point(&cell.X_DO, segment_selection().unwrap()).unwrap();
    let mut controller = SchemeController::new(&cell, law, goal, None);
    let run = simulate(&cell, "C", &mut FeatureSource::Ideal, 8.0, |frame| controller.control(frame));
    assert!(
        matches!(run.end, TrajectoryEnd::Stopped { .. }),
        "scheme C's gains on the segment are unstable at 25 Hz"
    );
}

#[test]
fn an_estimated_depth_scales_the_hybrid_error_equation() {
    let r = 1.2;
    let X_DO = Pose::new([-0.05, 0.02, 0.6].into(), [0.1, -0.2, 0.4].into());
    let X_CO = Pose::new([0.03, -0.04, 0.5].into(), [-0.2, 0.15, -0.3].into());
    // The same desired image of a larger square farther away: all depths r times as large.
    let larger = Pose::from_parts((X_DO.translation.vector * r).into(), X_DO.rotation);
    let goal = SetPoint::from_pose(&larger, &POINTS.map(|p| p * r)).unwrap();
    let (K_p, K_o) = (Vector3::new(1.0, 1.5, 0.7), Vector3::repeat(2.0));
    let law = Law::Hybrid {
        gains: HybridGains { K_p: K_p.into(), K_o: K_o.into() },
        gain: Gain::Constant(1.0),
        orientation: OrientationError::EulerZyx,
        space: OperationalSpace::Six,
        depth: DepthSource::Desired,
    };
    let view = View::new(project(&X_CO).unwrap().into_iter(), None).unwrap();
    let arm = Arm {
        J: CameraJacobian::of_moving_camera(Matrix6::identity()),
        qd: Vector6::zeros(),
        gravity: Vector6::zeros(),
    };
    let Some(LawOutput::Velocity(V)) = law.task(&goal, &view).ok().and_then(|task| law.output(&task, &arm))
    else {
        panic!("no velocity");
    };
    let (p_D, s_D) = (X_DO * POINTS[0], project(&X_DO).unwrap()[0]);
    let e_p = |t: f64| {
        let X = integrate_body_twist(&Pose::identity(), &V, t).inverse() * X_CO;
        let (p, s) = (X * POINTS[0], project(&X).unwrap()[0]);
        Vector3::new(s_D.x - s.x, s_D.y - s.y, -(p.z / p_D.z).ln())
    };
    let h = 1e-5;
    let rate = (e_p(h) - e_p(-h)) / (2.0 * h);
    let w = V.fixed_rows::<3>(3);
    let s = project(&X_CO).unwrap()[0];
    let right = rate + K_p.component_mul(&e_p(0.0)) * r;
    let expected = -(J_o(&s) * w) * (1.0 - r);
    assert!(expected.norm() > 0.01 && (right - expected).norm() < 1e-6, "{right} {expected}");
}

#[test]
fn taught_set_points_remove_the_error_of_calibration() {
    let cell = Cell::textbook().unwrap();
    let goal = cell.goal().unwrap();
    for (name, wrong) in calibrations().unwrap().into_iter().filter(|(name, _)| *name != "exact") {
        let error = |scheme, teaching| {
            let run = run_miscalibrated(&cell, scheme, &wrong, teaching).unwrap();
            Metrics::of(&run, &goal).unwrap().final_errors
        };
        // The image is right at f' z' = f z and, beside the axis, at f x = z times the shift in px: z = 0.6 m, f = 800 px.
        let by_hand_m = match name {
            "focal +10 %" => 0.6 * (1.0 - 1.0 / 1.1),
            "focal -10 %" => 0.6 * (1.0 / 0.9 - 1.0),
            _ => 0.6 * 20.0 / 800.0,
        };
        for scheme in SCHEMES {
            let computed = error(scheme, Teaching::Computed);
            assert!((computed.position_m - by_hand_m).abs() < 1e-6, "{name} {}: {computed:?}", scheme.name());
            if scheme == Scheme::C && name == "focal -10 %" {
                continue; // it diverges: the next test
            }
            let taught = error(scheme, Teaching::Taught);
            assert!(
                taught.position_m < 1e-6 && taught.orientation_rad < 1e-6,
                "{name} {}: {taught:?}",
                scheme.name()
            );
        }
    }
}

/// The exception to the statement above. After ten seconds it looks as if the camera had arrived, but its sampled loop is
/// unstable: features are 1/0.9 of the true ones, and in the rows of L_s for z and rotation this enters squared.
#[test]
fn scheme_c_taught_at_a_short_focal_length_diverges() {
    let cell = Cell::textbook().unwrap();
    let goal = cell.goal().unwrap();
    let away = |row: &TrajectoryRow| (row.x_c - goal.x_c).xyz().norm();
    let (_, wrong) = calibrations().unwrap().into_iter().find(|(name, _)| *name == "focal -10 %").unwrap();
    let run = run_miscalibrated(&cell, Scheme::C, &wrong, Teaching::Taught).unwrap();
    assert!(away(&run.rows[10_000]) < 1e-3, "{} m after 10 s", away(&run.rows[10_000]));
    let greatest = |from: usize, to: usize| run.rows[from..to].iter().map(away).fold(0.0, f64::max);
    assert!(greatest(10_000, 12_000) > 0.5, "{} m between 10 s and 12 s", greatest(10_000, 12_000));
    let TrajectoryEnd::Stopped { time_s, reason } = &run.end else { panic!("it goes on for ever") };
    // which limit it meets first is a matter of the last bits
    let lost = reason.contains("diverges") || reason.contains("in front of the camera");
    assert!((20.0..23.0).contains(time_s) && lost, "{time_s} s: {reason}");
    // The law with gains of nine tenths, on the same wrong features: so it is the gain.
    let seen = project(&cell.X_DO).unwrap().map(|s| wrong.believed(&s));
    let taught = SetPoint::from_features(&seen, &POINTS, cell.X_DO.translation.z).unwrap();
    let taught = taught.with_selection(Scheme::C.selection()).unwrap();
    let (K_Ps, damping) = (270.0.into(), Damping::Task(297.0.into()));
    let law = Law::ImageTorque { K_Ps, damping, interaction: Interaction::TEXTBOOK };
    let mut controller = SchemeController::new(&cell, law, taught, None);
    let run = simulate(&cell, "C", &mut FeatureSource::Miscalibrated(wrong), 30.0, |frame| {
        controller.control(frame)
    });
    let last = away(run.rows.last().unwrap());
    assert!(run.end == TrajectoryEnd::Finished && last < 1e-6, "{:?}, {last} m", run.end);
}
