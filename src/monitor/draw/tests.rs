//! What is on the screen, cell by cell.

use super::*;
use crate::messages::{DriveStateMsg, RobotState, TraceMsg, trace_flag};
use crate::monitor::CellFacts;
use crate::time::SpanNs;

fn joint(name: &str) -> JointSummary {
    JointSummary { name: name.into(), slides: false, lower: -2.0, upper: 2.0, velocity: 2.0, effort: 100.0 }
}

/// A run of six joints with everything that is shown.
fn watched() -> RunView {
    let facts = CellFacts {
        instance: "cell-1".into(),
        joints: (1..=6).map(|i| joint(&format!("joint{i}"))).collect(),
        image_px: [640.0, 480.0],
        targets: vec!["target".into()],
        goal_error_px: 0.05,
        hold_s: 0.5,
        rate_hz: 25.0,
        serves: true,
        has_keys: true,
        ..CellFacts::default()
    };
    let mut view = RunView::new(facts);
    let status = Status {
        time_s: 1.5,
        state: 1,
        feature_error_px: 12.3456,
        position_error_m: 0.0123,
        at_goal_s: f64::NAN,
        vision_us: 3200.0,
        frames: 37,
        ..Status::default()
    };
    view.status(&status, MonoNs(0));
    for k in 0..200_i64 {
        let mut trace = TraceMsg {
            sequence: k as u64,
            stamp: MonoNs(k * 1_000_000),
            commanded: MonoNs(k * 1_000_000 + if k == 7 { 1_500_000 } else { 60_000 }),
            state: 1,
            flags: if k % 40 == 0 { trace_flag::MEASUREMENT } else { 0 },
            feature_error_px: 100.0 / (k + 1) as f64,
            ..TraceMsg::default()
        };
        (trace.q[0], trace.q[1], trace.qd[1], trace.tau[1]) = (2.0, -2.0, 1.0, -25.0);
        trace.limits[Limit::Velocity as usize] = 0b10;
        view.tick(&trace);
    }
    let mut m =
        Measurement { status: 0, feature_count: 4, reprojection_rms_px: 0.07, ..Measurement::default() };
    for (i, at) in [[0.0, 0.0], [639.0, 0.0], [639.0, 479.0], [320.0, 240.0]].into_iter().enumerate() {
        (m.features[i].id, m.features[i].u_px, m.features[i].v_px) = (i as u64, at[0], at[1]);
    }
    view.measurement(&m, MonoNs(0));
    view.goal([(0, [100.0, 240.0]), (1, [5000.0, -3.0])]);
    view.say("start: accepted");
    view
}

#[test]
fn a_screen_of_80_by_24_shows_everything() {
    let lines = draw(&watched(), MonoNs(0), false, (80, 24)).lines();
    let text = lines.join("\n");
    assert_eq!(lines.len(), 24);
    assert!(lines.iter().all(|line| line.chars().count() <= 80), "{text}");
    assert!(lines[0].contains("cell-1") && lines[0].ends_with("1.5 s"), "{text}");
    assert_eq!(lines[1], "SERVOING  moves to the goal, which is 0.05 px for 0.5 s");
    assert!(lines[2].starts_with("feature error 12.346 px   camera 12.30 mm"), "{text}");
    for i in 1..=6 {
        assert!(text.contains(&format!("joint{i}")), "{text}");
    }
    let second = lines.iter().find(|line| line.contains("joint2")).unwrap();
    assert!(second.contains("[#--") && second.contains("-114.59 deg  50 %  25 % !"), "{text}");
    assert!(lines.iter().any(|line| line.contains("joint1") && line.contains("-#]")), "{text}");
    assert!(text.contains("p50 61") && text.contains("max 1500") && text.contains("vision 3.2"), "{text}");
    assert!(text.contains("37 frames"), "{text}");
    assert!(lines[23].starts_with("s start") && lines[23].ends_with("start: accepted"), "{text}");
    let asked = draw(&watched(), MonoNs(0), true, (80, 24)).lines();
    assert!(asked[23].starts_with("Stop the arm?"));
}

/// The image in the plane: its corners are the corners of what is drawn, and its middle the middle.
#[test]
fn points_are_drawn_where_the_image_has_them() {
    let lines = draw(&watched(), MonoNs(0), false, (80, 24)).lines();
    let plus: Vec<(usize, usize)> = lines[4..]
        .iter()
        .enumerate()
        .flat_map(|(row, line)| {
            line.chars().take(32).enumerate().filter(|(_, c)| *c == '+').map(move |(column, _)| (row, column))
        })
        .collect();
    let [a, b, middle, c] = plus[..] else { panic!("{plus:?}: {lines:#?}") };
    assert_eq!((a, b.0, c.1), ((0, 0), 0, b.1));
    assert_eq!(middle, (c.0 / 2, b.1 / 2));
    // 640 to 480 px: dots are square, cells two by four of them.
    let ratio = (2 * (b.1 + 1)) as f64 / (4 * (c.0 + 1)) as f64;
    assert!((ratio - 640.0 / 480.0).abs() < 0.1, "{ratio}");
    let goals: usize =
        lines[4..16].iter().map(|line| line.chars().take(31).filter(|c| *c == 'o').count()).sum();
    assert_eq!(goals, 1, "the goal outside the image is not drawn");
}

#[test]
fn any_size_and_any_lack_is_drawn() {
    for size in [(0, 0), (1, 1), (20, 5), (40, 12), (80, 24), (200, 60), (300, 8)] {
        for view in [
            watched(),
            RunView::default(),
            RunView::new(CellFacts { image_px: [640.0, 480.0], ..CellFacts::default() }),
        ] {
            let screen = draw(&view, MonoNs(0), false, size);
            assert_eq!((screen.columns(), screen.rows()), size);
        }
    }
    let large = draw(&watched(), MonoNs(0), false, (160, 50)).lines().join("\n");
    assert!(large.contains("joint6"));
}

#[test]
fn the_robot_and_restarts_are_told_where_there_are_some() {
    let mut view = watched();
    let text = draw(&view, MonoNs(0), false, (80, 24)).lines().join("\n");
    assert!(!text.contains("robot  ") && !text.contains("started anew"), "{text}");
    let robot = RobotState::EmergencyStop as u32;
    view.drive_state(&DriveStateMsg { robot_state: robot, robot_code: 706, ..DriveStateMsg::default() });
    view.tick(&TraceMsg { sequence: 200, flags: robot << trace_flag::ROBOT_STATE, ..TraceMsg::default() });
    view.status(&Status { vision_restarts: 2, time_s: 3.0, ..Status::default() }, MonoNs(0));
    let lines = draw(&view, MonoNs(0), false, (80, 24)).lines();
    let told = "robot  emergency stop (code 706)   started anew: camera 0, vision 2 times";
    assert!(lines.iter().any(|line| line == told), "{lines:#?}");
    assert!(
        lines.iter().any(|line| line.ends_with("s  vision was started anew, 2 times by now")),
        "{lines:#?}"
    );
}

#[test]
fn silence_is_told() {
    let later = MonoNs(0) + SpanNs(2_000_000_000);
    let text = draw(&watched(), later, false, (80, 24)).lines().join("\n");
    assert!(
        text.contains("nothing came from control for 2.0 s") && text.contains("no measurement for 2.0 s"),
        "{text}"
    );
}
