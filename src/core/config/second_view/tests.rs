use crate::config::Config;
use crate::messages::CameraId;
use crate::robot::Mount;

fn told(set: &[&str]) -> Result<Config, String> {
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    let text = include_str!("../../../../config/ur5-two-cameras.toml");
    Config::parse("cell.toml", text, std::path::Path::new("."), &set).map_err(|error| error.to_string())
}

#[test]
fn the_second_view_is_a_cell_of_its_own() {
    let set = [
        "cameras[1].lens.fx_px=700",
        "cameras[1].synthetic.frame_loss=0.2",
        "run.seed=5",
        "scene.target.scale=1.1",
    ];
    let config = told(&set).unwrap();
    let second = config.second_view.clone().unwrap();
    assert_eq!(
        (second.cell.camera.id, second.cell.camera.name.as_str(), second.weight),
        (CameraId(1), "beside", 1.0)
    );
    assert_eq!(second.cell.camera.schedule, config.further_cameras[0].schedule, "losses of its own");
    assert!(matches!(second.cell.servo.mount, Mount::EyeToHand { .. }));
    assert_eq!(second.cell.set_point.X_DO().unwrap().translation.z, 0.823_515_1);
    let scene = second.cell.scene.as_ref().unwrap();
    assert_eq!(scene.target, second.cell.target, "what is untrue of the first target is true of this one");
    assert_eq!(config.clone().seen_by(CameraId(1)).unwrap().camera.model.intrinsics().fx_px, 700.0);
    assert_eq!(config.clone().seen_by(CameraId(0)).unwrap().target, config.target);
    let again =
        Config::parse("again.toml", &config.to_toml().unwrap(), std::path::Path::new("."), &[]).unwrap();
    assert_eq!(again.effective, config.effective, "the effective file reads back");
    let agreed = second.cell.agreement();
    assert_eq!(agreed, config.agreement());
    assert!(
        agreed.contains_key("second_view.desired.position_m") && agreed.contains_key("cameras[1].lens.fx_px")
    );
}

#[test]
fn what_two_cameras_do_not_control_is_refused() {
    for (set, why) in [
        (
            "servo.scheme=image_pd",
            "servo.scheme: position_pd and image_pd command torques, and do not go with [second_view]",
        ),
        ("servo.scheme=position_pd", "and do not go with [second_view]"),
        ("servo.scheme=look_and_move", "servo.scheme: look_and_move goes by one camera"),
        ("servo.set_point.kind=taught", "servo.set_point.kind: must be `pose` with [second_view]"),
        ("servo.object.moves=true", "servo.object.moves: does not go with [second_view]"),
        ("run.task=calibrate_latency", "run.task: must be `servo` with [second_view]"),
        ("stereo.pair_tolerance_ms=2", "cameras[1].mount.kind: must be that of the left camera"),
        ("drive.kind=none", "second_view: needs an arm that moves"),
        ("second_view.weight=0", "second_view.weight: 0 is out of range"),
        ("second_view.wait=1", "second_view.wait: unknown field"),
        ("second_view.target.side_m=0", "second_view.target.side_m: 0 is out of range"),
        ("second_view.object.on=base", "second_view.object.on: eye_in_hand needs a target on the `base`"),
        ("second_view.desired.position_m=[0,0,-1]", "second_view.desired"),
        (
            "second_view.desired.position_m=[2,0,1]",
            "second_view.desired: point 1 would lie outside the image",
        ),
        (
            "cameras[1].rate_hz=600",
            "cameras[1].rate_hz: is 600 Hz: with [second_view] a camera has 500 Hz at most",
        ),
        ("cameras[1].latency_ms=190", "safety.measurement_timeout_ms"),
        ("cameras[1].lens.fx_px=0", "cameras[1].lens.fx_px: 0 is out of range"),
    ] {
        let error = told(&[set]).expect_err(set);
        assert!(error.contains(why), "{set}: {error}");
    }
    let pair = [
        "stereo.pair_tolerance_ms=2",
        "cameras[1].mount.kind=eye_in_hand",
        "cameras[1].mount.position_m=[0.06,0,0.05]",
        "cameras[1].mount.rotation_rpy_rad=[0,0,0]",
    ];
    let error = told(&pair).unwrap_err();
    assert!(error.contains("stereo: makes one view of two cameras"), "{error}");
    let one = "[second_view]\nweight = 2.0\n";
    let error = Config::parse("cell.toml", one, std::path::Path::new("."), &[]).unwrap_err().to_string();
    assert!(
        error.contains("cell.toml:1:2: second_view: needs two [[cameras]]; the run file has 1"),
        "{error}"
    );
}

/// One of the two targets in view is enough to begin with, and that the other is not is told.
#[test]
fn one_target_in_view_at_the_start_is_enough() {
    let first = "scene.object.position_m=[0.9,0.15,-0.1]";
    let second = "cameras[1].mount.position_m=[1.5,-0.8,0.5]";
    for set in [first, second] {
        let config = told(&[set]).unwrap();
        let about = config.warnings.iter().filter(|warning| warning.message.contains("at the start"));
        assert_eq!(about.count(), 1, "{set}: {:?}", config.warnings);
    }
    let error = told(&[first, second]).unwrap_err();
    assert!(
        error.contains("robot.q_start_rad_or_m: neither camera has its target in view at the start"),
        "{error}"
    );
    assert!(told(&[]).unwrap().warnings.is_empty());
}
