//! `target.kind = "points"` with dots: which dot is which on a body, from all around, among clutter and beside other bodies; and runs.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use nalgebra::{Translation3, UnitQuaternion, Vector2, Vector3};
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
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config/dot-cube.toml")
}

fn config(set: &[&str]) -> Config {
    Config::load(Some(&file()), &set.iter().map(ToString::to_string).collect::<Vec<_>>()).unwrap()
}

fn run(set: &[&str]) -> SystemRun {
    simulate_system(&config(set), &mut |_| ControlFlow::Continue(())).unwrap()
}

/// A view of the cube from above, tilted by up to `most_tilt`.
fn view(random: &mut Random, most_tilt: f64) -> Pose {
    let azimuth = random.between(-3.1, 3.1);
    let axis = nalgebra::Unit::new_normalize(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0));
    let rotation = UnitQuaternion::from_axis_angle(&axis, random.between(0.0, most_tilt))
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.between(-3.1, 3.1));
    let place = Translation3::new(
        random.between(-0.04, 0.04),
        random.between(-0.04, 0.04),
        random.between(0.28, 0.5),
    );
    Pose::from_parts(place, rotation)
}

/// What is found in rendered views: of those, how many had the target; every dot that is found is where it should be.
struct Views {
    found: usize,
    missed: Vec<TargetStatus>,
    dots: usize,
    /// Sum of squared errors over stated variances, and greatest error, px.
    chi2: f64,
    greatest_px: f64,
    poses: Vec<(f64, f64)>,
}

fn look(shown: &Config, wanted: &Config, poses: impl Iterator<Item = Pose>) -> Views {
    let mut renderer = assemble::renderer(shown).unwrap();
    let camera = wanted.camera.model;
    let i = camera.intrinsics();
    let (width, height) = (i.width_px as usize, i.height_px as usize);
    let mut pixels = vec![0; width * height];
    let (missed, poses_off) = (Vec::new(), Vec::new());
    let mut views = Views { found: 0, missed, dots: 0, chi2: 0.0, greatest_px: 0.0, poses: poses_off };
    for (frame_id, X_CO) in (0..).zip(poses) {
        renderer.render(&[X_CO], frame_id, &mut pixels);
        let mut vision = Vision::new(camera, wanted.target.clone(), wanted.vision);
        let header = FrameHeader { width_px: i.width_px, height_px: i.height_px, ..FrameHeader::default() };
        let frame = Frame { header, image: ImageView::new(&pixels, width, height).unwrap() };
        let m = vision.process(&frame, &Prior::default());
        if !m.found() {
            views.missed.push(m.target_status());
            continue;
        }
        views.found += 1;
        for f in m.features() {
            let i = f.id as usize;
            assert!(wanted.target.is_turned_to_camera(i, &X_CO), "{X_CO}: dot {i} is turned away");
            let truth = camera.project(&(X_CO * wanted.target.points()[i].p_O)).unwrap();
            let off = truth - Vector2::new(f.u_px, f.v_px);
            views.dots += 1;
            views.chi2 += off.norm_squared() / (2.0 * f.sd_px * f.sd_px);
            views.greatest_px = views.greatest_px.max(off.norm());
        }
        let off = X_CO.inv_mul(&m.pose().unwrap());
        views.poses.push((off.translation.vector.norm(), off.rotation.angle()));
    }
    views
}

#[test]
fn dots_are_told_apart_from_all_around() {
    let config = config(&[]);
    let mut random = Random::new(11);
    let views = look(&config, &config, (0..120).map(|_| view(&mut random, 1.0)));
    let chi2 = views.chi2 / views.dots as f64;
    assert!((0.8..1.25).contains(&chi2), "{chi2}");
    assert!(views.found >= 117, "{:?}", views.missed);
    assert!(views.dots > 6 * views.found && views.greatest_px < 0.5, "{} {}", views.dots, views.greatest_px);
    for (metres, rad) in &views.poses {
        assert!(*metres < 0.003 && *rad < 0.02, "{metres} m, {rad} rad");
    }
}

/// Objects on a mottled table: what is found is right, and most is found.
#[test]
fn dots_are_told_apart_among_other_things() {
    let plain = config(&[]);
    let set = ["scene.backdrop.clutter=60", "scene.backdrop.texture_levels=8"];
    let cluttered = config(&set);
    let mut random = Random::new(12);
    let views = look(&cluttered, &plain, (0..60).map(|_| view(&mut random, 0.9)));
    assert!(views.found >= 54 && views.greatest_px < 1.0, "{:?} {}", views.missed, views.greatest_px);
}

/// Another body, and this one mirrored, are not taken for it.
#[test]
fn another_body_is_not_taken_for_this_one() {
    let wanted = config(&[]);
    let text = std::fs::read_to_string(file()).unwrap();
    let mirrored: Vec<String> = text
        .lines()
        .map(|line| match line.strip_prefix("dots_m = ") {
            Some(list) => {
                let list: Vec<[f64; 2]> = toml::from_str::<toml::Table>(&format!("a = {list}")).unwrap()["a"]
                    .clone()
                    .try_into()
                    .unwrap();
                format!("dots_m = {:?}", list.iter().map(|[x, y]| [*y, *x]).collect::<Vec<_>>())
            }
            None => line.to_owned(),
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.toml");
    std::fs::write(&path, mirrored.join("\n")).unwrap();
    let other = Config::load(Some(&path), &[]).unwrap();
    let mut renderer = assemble::renderer(&other).unwrap();
    let camera = wanted.camera.model;
    let i = camera.intrinsics();
    let (width, height) = (i.width_px as usize, i.height_px as usize);
    let mut pixels = vec![0; width * height];
    let mut random = Random::new(13);
    let mut taken = 0;
    for frame_id in 0..80 {
        renderer.render(&[view(&mut random, 1.0)], frame_id, &mut pixels);
        let mut vision = Vision::new(camera, wanted.target.clone(), wanted.vision);
        let header = FrameHeader { width_px: i.width_px, height_px: i.height_px, ..FrameHeader::default() };
        let frame = Frame { header, image: ImageView::new(&pixels, width, height).unwrap() };
        taken += usize::from(vision.process(&frame, &Prior::default()).found());
    }
    assert!(taken == 0, "{taken} of 80");
}

/// Two sides with the same dots: where only one of them is seen, nothing tells which it is.
#[test]
fn a_side_that_another_one_equals_is_ambiguous() {
    let side = "dots_m=[[0.011,-0.015],[-0.002,0.02],[-0.019,-0.02],[-0.017,0.013],[0.001,0.004]]";
    let faces = format!(
        "target.points.faces=[{{position_m=[0.03,0,0],rotation_rpy_deg=[0,-90,0],{side}}}, \
         {{position_m=[-0.03,0,0],rotation_rpy_deg=[0,90,0],{side}}}, {{position_m=[0,0,-0.03],dots_m=[[0.01,0.005]]}}]"
    );
    let body = config(&[&faces]);
    let (X_OF, _) = body.target.dot(0).unwrap();
    let straight = |z| Pose::translation(0.0, 0.0, z) * X_OF.inverse();
    let views = look(&body, &body, [0.3, 0.35, 0.45].map(straight).into_iter());
    assert_eq!((views.found, views.missed.as_slice()), (0, [TargetStatus::Ambiguous; 3].as_slice()));
    // The dot of the top beside them tells which side it is.
    let turn = UnitQuaternion::from_euler_angles(0.0, -0.7, 0.0);
    let aslant = |z| Pose::from_parts(Translation3::new(0.0, 0.0, z), turn) * X_OF.inverse();
    let views = look(&body, &body, [0.3, 0.35, 0.45].map(aslant).into_iter());
    assert!(views.found == 3 && views.dots == 18, "{} {} {:?}", views.found, views.dots, views.missed);
}

#[test]
fn the_dot_cube_converges_with_every_law_for_points_in_space() {
    let first = run(&[]);
    assert_eq!(first.finish.outcome, Outcome::Converged, "{first:?}");
    assert!(first.errors.position_error_m.unwrap() < 1e-3, "{first:?}");
    assert_eq!(run(&[]), first, "to the last bit");
    for set in [
        ["servo.scheme=position_resolved_velocity"].as_slice(),
        &["servo.scheme=look_and_move"],
        &["vision.pose=iterative"],
        &["servo.set_point.kind=taught"],
        &["target.light_on_dark=true"],
    ] {
        let run = run(set);
        assert_eq!(run.finish.outcome, Outcome::Converged, "{set:?}: {run:?}");
        assert_eq!(run.target_lost, 0, "{set:?}");
    }
}

#[test]
fn bodies_without_a_pose_of_their_own_are_refused() {
    let refused = |set: &str| Config::load(Some(&file()), &[set.to_owned()]).unwrap_err().to_string();
    let square = "[[0.02,0.02],[-0.02,0.02],[-0.02,-0.02],[0.02,-0.02],[0.0,0.0]]";
    let error = refused(&format!("target.points.faces=[{{dots_m={square}}}]"));
    assert!(error.contains("a turn of the body"), "{error}");
    let error = refused("target.points.faces=[{dots_m=[[0.0,0.0],[0.02,0.0]]}]");
    assert!(error.contains("2 dots on the faces; give 5 to 24"), "{error}");
    let error = refused("target.radius_m=0.02");
    assert!(error.contains("reaches beyond its face"), "{error}");
    let error = refused("target.points.tags=[{id=3}]");
    assert!(error.contains("target.points: has both"), "{error}");
    let error = refused("servo.scheme=hybrid");
    assert!(error.contains("servo.scheme: ") && error.contains("plane"), "{error}");
}
