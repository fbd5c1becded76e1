#![allow(clippy::unwrap_used)]
use super::*;
use crate::config::{Config, assemble};
use crate::mission::LockstepRun;
use crate::scene::MAX_SIGHT_ANGLE_RAD;
use crate::time::MonoNs;

/// The words of refusals stand in `control/lifecycle.rs`, which knows nothing of the mission's bounds.
#[test]
fn refusals_tell_the_bounds_that_hold() {
    let range = |range: &RangeInclusive<f64>| format!("{} to {}", range.start(), range.end());
    let of_velocity = [
        format!("the time for which it holds ({} s)", range(&VELOCITY_HOLD_S)),
        format!("a velocity at most {VELOCITY} rad/s or m/s"),
    ];
    let of_set = [
        format!("a gain {} 1/s", range(&GAIN_1_S)),
        format!("a tolerance {} px", range(&TOLERANCE_PX)),
        format!("a hold {} s", range(&HOLD_S)),
    ];
    let of_goal =
        [format!("a position within {} m", POSITION_M.end()), format!("a feature within {}", FEATURES.end())];
    let of_jog = [
        format!("a joint by {JOG_RAD} rad or {JOG_M} m at most"),
        format!("the camera by {JOG_M} m and {JOG_RAD} rad"),
    ];
    let of_angle = [format!("more than {:.0} degrees", MAX_SIGHT_ANGLE_RAD.to_degrees())];
    let of_size = [format!("smaller than {SMALLEST_PX} px")];
    for (refusal, request, parts) in [
        (Refusal::WrongNumbers, Request::Velocity, &of_velocity[..]),
        (Refusal::WrongNumbers, Request::Set, &of_set),
        (Refusal::WrongNumbers, Request::Goal, &of_goal),
        (Refusal::TooFar, Request::Jog, &of_jog),
        (Refusal::TooSmall, Request::Goal, &of_size),
        (Refusal::EdgeOn, Request::Goal, &of_angle),
    ] {
        let told = refusal.describe_for(request);
        for part in parts {
            assert!(told.contains(part), "{part}: {told}");
        }
    }
    assert_eq!(POSITION_M.start(), &-POSITION_M.end());
    assert_eq!(FEATURES.start(), &-FEATURES.end());
}

/// A served run of the default cell, whose arm may not go beyond x = 1.5 m.
fn served() -> LockstepRun<4> {
    let set = ["run.serve=true", "workspace.planes=[{name='wall',point_m=[1.5,0,0],normal=[-1,0,0]}]"];
    let config = Config::load(None, &set.map(ToOwned::to_owned)).unwrap();
    let mut run = assemble::control_loop::<4>(&config, config.robot.build().unwrap()).unwrap();
    run.tick(0, MonoNs::ZERO, None);
    run
}

/// The goal of a target in front of the camera, turned about its x axis.
fn turned_deg(deg: f64) -> ControlCommand {
    let q = UnitQuaternion::from_euler_angles(deg.to_radians(), 0.0, 0.0).coords;
    let numbers = [0.0, 0.0, 0.5, q.x, q.y, q.z, q.w];
    ControlCommand::with_numbers(0, CommandForm::Pose, &numbers).unwrap()
}

#[test]
fn a_goal_that_shows_the_target_edge_on_is_refused() {
    let mut run = served();
    for (deg, verdict) in [
        (0.0, Ok(())),
        (80.0, Ok(())),
        (-80.0, Ok(())),
        (89.0, Err(Refusal::EdgeOn)),
        (-89.5, Err(Refusal::EdgeOn)),
        (91.0, Err(Refusal::FromBehind)),
        (180.0, Err(Refusal::FromBehind)),
    ] {
        let goal = turned_deg(deg);
        assert_eq!(run.mission.examine(&goal), verdict, "{deg} deg");
        assert_eq!(run.mission.plan(1, Request::Goal, &goal).map(drop), verdict, "{deg} deg");
    }
}

#[test]
fn what_is_examined_is_what_would_be_refused() {
    let run = served();
    let joints =
        |q: &[f64]| run.mission.examine(&ControlCommand::with_numbers(0, CommandForm::Joints, q).unwrap());
    let (left, right) = ([-1.2, 0.0, 0.4, 0.0], [1.2, 0.0, 0.4, 0.0]);
    assert_eq!((joints(&left), joints(&right)), (Ok(()), Ok(())));
    let way = [left, right].concat();
    assert_eq!(joints(&way), Err(Refusal::OutOfWorkspace), "the way between both leads through the wall");
    assert_eq!(joints(&[0.0, 0.0, 0.4, 0.0]), Err(Refusal::OutOfWorkspace));
    assert_eq!(joints(&[0.0, 1.57, 40.0, 0.0]), Err(Refusal::OutOfRange));
    for wrong in [&[0.0, 1.57][..], &way[1..], &[f64::NAN, 0.0, 0.4, 0.0]] {
        assert_eq!(joints(wrong), Err(Refusal::WrongNumbers), "{wrong:?}");
    }
    assert_eq!(run.mission.examine(&ControlCommand::default()), Ok(()), "nothing to examine");
    let beside = ControlCommand::with_numbers(0, CommandForm::Pose, &[2.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(run.mission.examine(&beside.unwrap()), Err(Refusal::OutOfView));
    let nowhere = ControlCommand { target: 9, ..turned_deg(0.0) };
    assert_eq!(run.mission.examine(&nowhere), Err(Refusal::UnknownTarget));
}
