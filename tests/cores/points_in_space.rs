//! `target.kind = "points"`: tags on the faces of a body. What is seen of it, its pose against rendered truth, and runs.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use nalgebra::{UnitQuaternion, Vector3};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use vservo::config::Config;
use vservo::config::assemble;
use vservo::control::outcome::Outcome;
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::prelude::*;
use vservo::sim::{SystemRun, simulate_system};

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config/tag-cube.toml")
}

fn config(set: &[&str]) -> Config {
    Config::load(Some(&file()), &set.iter().map(ToString::to_string).collect::<Vec<_>>()).unwrap()
}

fn run(set: &[&str]) -> SystemRun {
    simulate_system(&config(set), &mut |_| ControlFlow::Continue(())).unwrap()
}

/// The faces of the shipped cube, outward: their tags' places in the list are those of these.
const OUTWARD: [[f64; 3]; 5] =
    [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];

/// From all around: corners are seen of faces that look at the camera and of no others, where they should be, and the pose is right.
#[test]
fn faces_are_seen_from_their_side_and_give_the_pose() {
    let config = config(&[]);
    let mut renderer = assemble::renderer(&config).unwrap();
    let camera = config.camera.model;
    let i = camera.intrinsics();
    let (width, height) = (i.width_px as usize, i.height_px as usize);
    let mut pixels = vec![0; width * height];
    let mut random = Random::new(5);
    let (mut corners, mut most_faces, mut with_one, mut refused) = (0, 0, 0, 0);
    for frame_id in 0..80 {
        let tilt = random.between(0.0, 1.1);
        let azimuth = random.between(-3.1, 3.1);
        let axis = nalgebra::Unit::new_normalize(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0));
        let rotation = UnitQuaternion::from_axis_angle(&axis, tilt)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.between(-3.1, 3.1));
        let place =
            Vector3::new(random.between(-0.04, 0.04), random.between(-0.04, 0.04), random.between(0.3, 0.5));
        let X_CO = Pose::from_parts(place.into(), rotation);
        renderer.render(&[X_CO], frame_id, &mut pixels);
        let mut vision = Vision::new(camera, config.target.clone(), config.vision);
        let header = FrameHeader { width_px: i.width_px, height_px: i.height_px, ..FrameHeader::default() };
        let frame = Frame { header, image: ImageView::new(&pixels, width, height).unwrap() };
        let m = vision.process(&frame, &Prior::default());
        // Corners of faces seen edge-on may be off by more than is allowed for; then the view is refused, and not believed.
        if m.target_status() == TargetStatus::Inconsistent {
            refused += 1;
            continue;
        }
        assert!(m.found(), "{X_CO}: {:?}", m.target_status());
        let mut faces = std::collections::BTreeSet::new();
        for f in m.features() {
            let face = f.id as usize / 4;
            let normal = Vector3::from(OUTWARD[face]);
            // towards the camera, from the face's middle
            let outward = X_CO.rotation * normal;
            let middle = (X_CO * nalgebra::Point3::from(normal * 0.03)).coords;
            assert!(outward.dot(&middle) < 0.0, "{X_CO}: a corner of face {face}, which is turned away");
            let point = config.target.points()[f.id as usize].p_O;
            let truth = camera.project(&(X_CO * point)).unwrap();
            let off = (truth - nalgebra::Vector2::new(f.u_px, f.v_px)).norm();
            assert!(off < 0.5, "{X_CO}: point {} is off by {off} px", f.id);
            faces.insert(face);
            corners += 1;
        }
        most_faces = most_faces.max(faces.len());
        with_one += usize::from(faces.len() == 1);
        let off = X_CO.inv_mul(&m.pose().unwrap());
        let angle = off.rotation.angle();
        // Of one small face the tilt is known to some hundredths, of several to thousandths.
        let largest = if faces.len() == 1 { 0.15 } else { 0.02 };
        assert!(off.translation.vector.norm() < 0.005 && angle < largest, "{X_CO}: {faces:?} {angle}");
    }
    assert!(refused <= 4, "{refused} of 80 views");
    assert!(corners > 80 * 4 && most_faces == 3 && with_one > 3, "{corners} {most_faces} {with_one}");
}

#[test]
fn the_cube_converges_with_every_law_for_points_in_space() {
    let first = run(&[]);
    assert_eq!(first.finish.outcome, Outcome::Converged, "{first:?}");
    assert!(first.errors.position_error_m.unwrap() < 1e-3, "{first:?}");
    assert_eq!(run(&[]), first, "to the last bit");
    for set in [
        ["servo.scheme=position_resolved_velocity"].as_slice(),
        &["servo.scheme=look_and_move"],
        &["vision.pose=iterative"],
        &["servo.set_point.kind=taught"],
    ] {
        let run = run(set);
        assert_eq!(run.finish.outcome, Outcome::Converged, "{set:?}: {run:?}");
        assert_eq!(run.target_lost, 0, "{set:?}");
    }
}

/// What goes by one plane says that it cannot.
#[test]
fn what_needs_a_plane_is_refused() {
    for (set, key) in [
        ("servo.scheme=hybrid", "servo.scheme"),
        ("servo.area=area", "servo.area"),
        ("vision.pose=analytical", "vision.pose"),
        ("run.task=calibrate_hand_eye", "target.kind"),
        ("run.task=calibrate_latency", "target.kind"),
    ] {
        let error = Config::load(Some(&file()), &[set.to_owned()]).unwrap_err().to_string();
        assert!(error.contains(&format!("{key}: ")) && error.contains("plane"), "{set}: {error}");
    }
    let four = ["servo.scheme=position_resolved_velocity".to_owned(), "servo.dimension=4".to_owned()];
    let error = Config::load(Some(&file()), &four).unwrap_err().to_string();
    assert!(error.contains("servo.dimension: is 4") && error.contains("plane"), "{error}");
    let twice = ["target.points.tags=[{id=3}, {id=3, position_m=[0.1, 0.0, 0.0]}]".to_owned()];
    let error = Config::load(Some(&file()), &twice).unwrap_err().to_string();
    assert!(error.contains("tag 3 is there twice"), "{error}");
}
