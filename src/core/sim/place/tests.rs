use super::{Look, PlaceError, PlaceRequest, Placement, place};
use crate::config::Draft;
use crate::control::outcome::Outcome;
use nalgebra::{Vector2, Vector3};
use std::path::Path;

const ANYTHING: PlaceRequest = PlaceRequest { look: None, object: None, distance_m: None };

fn draft(set: &[&str]) -> Draft {
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    Draft::parse("run.toml", "", Path::new("."), &set).unwrap()
}

fn placed(set: &[&str], request: &PlaceRequest) -> Placement {
    place(&draft(set), request).unwrap_or_else(|e| panic!("{set:?}: {e}"))
}

/// The middle of the target lies on the optical axis at the goal, all of it is in the image at both ends, and a run converges.
#[test]
fn arms_of_all_kinds_get_a_place() {
    for arm in ["scara", "ur5", "panda", "pan_tilt"] {
        let p = placed(&[&format!("robot.model={arm}")], &ANYTHING);
        assert_eq!(p.run.finish.outcome, Outcome::Converged, "{arm}");
        let (start, goal) = (p.preflight.start.as_ref().unwrap(), p.preflight.goal.as_ref().unwrap());
        assert!(goal.axis.unwrap().beside_m < 1e-5, "{arm}");
        assert!(goal.visibility.room_px > 100.0 && start.visibility.room_px > 20.0, "{arm}");
        let far = |(a, b): (&crate::scene::PointVisibility, &crate::scene::PointVisibility)| {
            (Vector2::from(a.px.unwrap()) - Vector2::from(b.px.unwrap())).norm()
        };
        let way_px: f64 = start.visibility.points.iter().zip(&goal.visibility.points).map(far).sum();
        assert!(way_px > 40.0, "{arm}: the start is a start: {way_px}");
        assert_eq!((p.preflight.faults(), p.preflight.doubts()), (vec![], vec![]));
    }
}

/// Of a body no camera sees more than half.
#[test]
fn a_body_is_placed_by_the_faces_that_are_seen() {
    let text = crate::config::ShippedFile::find("tag-cube").unwrap().text;
    let draft = Draft::parse("tag-cube.toml", text, Path::new("."), &[]).unwrap();
    let p = place(&draft, &ANYTHING).unwrap();
    assert_eq!(p.run.finish.outcome, Outcome::Converged);
    let goal = p.preflight.goal.unwrap().visibility;
    assert!(goal.room_px > 20.0 && goal.points.iter().any(|point| point.turned_away));
}

#[test]
fn the_same_question_has_the_same_answer() {
    let set = ["robot.model=ur5"];
    let (a, b) = (placed(&set, &ANYTHING), placed(&set, &ANYTHING));
    assert_eq!((a.q_start, a.run.state_hash), (b.q_start, b.run.state_hash));
}

#[test]
fn requests_are_kept() {
    let set = ["robot.model=ur5", "camera.mount.position_m=[0.0, 0.0, 0.05]"];
    let level = placed(&set, &PlaceRequest { look: Some(Look::Level), ..ANYTHING });
    let looks = Vector3::from(level.preflight.goal.unwrap().camera.unwrap().looks);
    assert!(looks.z.abs() < 1e-3, "{looks}");
    let far = placed(&set, &PlaceRequest { distance_m: Some(0.6), ..ANYTHING });
    assert_eq!(far.X_DO.translation.z, 0.6);
    let there = Vector3::new(0.5, 0.1, -0.05);
    let fixed = placed(&set, &PlaceRequest { object: Some((there, None)), ..ANYTHING });
    assert!((fixed.X_WO.translation.vector - there).norm() < 1e-6);
    assert!(fixed.preflight.goal.unwrap().camera.unwrap().looks[2] < -0.999, "seen from above");
}

#[test]
fn what_cannot_be_placed_is_told() {
    let error = |set: &[&str], request: &PlaceRequest| place(&draft(set), request).unwrap_err();
    let away = PlaceRequest { object: Some((Vector3::new(3.0, 0.0, 0.0), None)), ..ANYTHING };
    assert!(matches!(error(&["robot.model=ur5"], &away), PlaceError::Nowhere { .. }));
    let near = PlaceRequest { distance_m: Some(0.05), ..ANYTHING };
    assert!(matches!(error(&["robot.model=ur5"], &near), PlaceError::Distance { .. }));
    // A floor above the shoulder: no other view helps.
    let high = ["robot.model=ur5", "workspace.planes=[{name='floor',point_m=[0,0,2.0],normal=[0,0,1]}]"];
    let excluded = error(&high, &ANYTHING).to_string();
    assert!(
        excluded.starts_with("[workspace] keeps the arm from each of") && excluded.contains("floor"),
        "{excluded}"
    );
    let unknown = error(&["robot.model=r2d2"], &ANYTHING).to_string();
    assert!(unknown.contains("--set robot.model=r2d2: robot.model: robot `r2d2`"), "{unknown}");
    let wrong = error(&["robot.model=ur5", "servo.gain_1_s=-1"], &ANYTHING).to_string();
    assert!(wrong.contains("servo.gain_1_s: -1 is out of range"), "{wrong}");
}
