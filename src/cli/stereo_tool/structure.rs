//! What two views tell of the scene beside the displacement: where its points are, by triangulation (10.47), (10.48).

use super::motion_answer::{MotionAnswer, SceneStructure, StructurePoint};
use crate::geometry::Pose;
use crate::stereo::{Conjugates, Triangulator};
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Gives each displacement of `answer` the points in camera 1; `base_line_m`: the length of the base line, where it is known. A camera that turned alone has no structure.
pub(super) fn add_structure(
    answer: &mut MotionAnswer,
    ids: &[u64],
    pairs: &[Conjugates],
    base_line_m: Option<f64>,
) {
    let unit = |own| if base_line_m.is_some() { "m" } else { own };
    for solution in &mut answer.solutions {
        let [x, y, z, w] = solution.rotation_xyzw;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let way = Vector3::from(solution.direction) * base_line_m.unwrap_or(1.0);
        let X_12 = Pose::from_parts(Translation3::from(way), turn);
        let agrees = |id: &u64| solution.inliers.as_ref().is_none_or(|inliers| inliers.contains(id));
        let points = ids.iter().zip(pairs).filter(|(id, _)| agrees(id));
        solution.structure = of(&X_12, points, unit("base_line"));
    }
    for reading in answer.plane.iter_mut().flat_map(|plane| &mut plane.readings) {
        let R = Matrix3::from_row_slice(reading.rotation.as_flattened());
        let p = Vector3::from(reading.position_over_distance);
        let way = base_line_m.map_or(p, |length| p * (length / p.norm()));
        let X_12 = Pose::from_parts(Translation3::from(way), UnitQuaternion::from_matrix(&R));
        if reading.normal_2.is_some() {
            reading.structure = of(&X_12, ids.iter().zip(pairs), unit("plane_distance"));
        }
    }
}

/// The points of `pairs` for a displacement whose length has the unit `unit`; `None` where there is no base line, or no pair.
fn of<'a>(
    X_12: &Pose,
    pairs: impl Iterator<Item = (&'a u64, &'a Conjugates)>,
    unit: &'static str,
) -> Option<SceneStructure> {
    let both = Triangulator::new(X_12).ok()?;
    let point = |(id, pair): (&u64, &Conjugates)| match both.point(pair) {
        Ok(found) => {
            let p_2 = X_12.inverse() * found.p_1;
            StructurePoint {
                id: *id,
                position: Some(found.p_1.coords.into()),
                depth_2: Some(p_2.z),
                reason: None,
            }
        }
        Err(e) => StructurePoint { id: *id, position: None, depth_2: None, reason: Some(e.to_string()) },
    };
    let points: Vec<_> = pairs.map(point).collect();
    let in_front = points.iter().filter(|p| p.position.is_some()).count();
    (!points.is_empty()).then_some(SceneStructure { unit, in_front, points })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn points_come_back_and_what_is_behind_is_told() {
        let X_12 = Pose::new(Vector3::new(0.2, -0.05, 0.02), Vector3::new(0.02, -0.1, 0.05));
        let places = [Point3::new(0.1, -0.1, 1.0), Point3::new(-0.2, 0.1, 1.4), Point3::new(0.0, 0.2, 0.8)];
        let seen = |p: &Point3<f64>| p.xy().coords / p.z;
        let mut pairs: Vec<_> =
            places.iter().map(|p| Conjugates { s_1: seen(p), s_2: seen(&(X_12.inverse() * p)) }).collect();
        pairs.push(Conjugates { s_1: pairs[0].s_2, s_2: pairs[0].s_1 });
        let ids = [3, 5, 7, 9];
        let found = of(&X_12, ids.iter().zip(&pairs), "m").unwrap();
        for (point, place) in found.points.iter().zip(&places) {
            assert!((Point3::from(point.position.unwrap()) - place).norm() < 1e-12);
            assert!((point.depth_2.unwrap() - (X_12.inverse() * place).z).abs() < 1e-12);
        }
        assert_eq!((found.in_front, found.points[3].id, found.points[3].position), (3, 9, None));
        assert!(found.points[3].reason.as_ref().unwrap().contains("behind"), "{:?}", found.points[3].reason);
        assert!(of(&Pose::identity(), ids.iter().zip(&pairs), "m").is_none());
    }
}
