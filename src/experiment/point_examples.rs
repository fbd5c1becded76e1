//! Example 10.2, the null space of a point's interaction matrix, and the note on Example 10.4, that three points leave up to four poses: two for
//! the example's own triple, four for a triangle about the optical axis.
//!
//! The numbers here are the textbook's, where it has any, and else chosen settings of the simulation.

use super::ExperimentError;
use super::cell::project;
use super::examples::{self, correspondences, example_pose, fail};
use super::findings::Findings;
use crate::features::point_rows;
use crate::geometry::Pose;
use crate::pose::{Correspondence, VirtualServoing, algorithmic_step, p3p};
use crate::servo::euler_zyx;
use nalgebra::{Vector2, Vector6};
use serde_json::json;
use std::f64::consts::TAU;

/// Steps of the integration from beside each solution, and how far beside it begins, m and rad.
const STEPS: usize = 250;
const BESIDE: f64 = 0.01;

/// A basis of the null space of L_s of a point, (10.27): along its visual ray and about it, as in the text, and the turns about x and y with the
/// translation that keeps the point where it is in the image.
fn null_space(s: &Vector2<f64>, z_m: f64) -> [(&'static str, Vector6<f64>); 4] {
    let (X, Y) = (s.x, s.y);
    [
        ("v1: along the visual ray", Vector6::new(X, Y, 1.0, 0.0, 0.0, 0.0)),
        ("v2: about the visual ray", Vector6::new(0.0, 0.0, 0.0, X, Y, 1.0)),
        ("v3: about x", Vector6::new(z_m * X * Y, z_m * (1.0 + Y * Y), 0.0, 1.0, 0.0, 0.0)),
        ("v4: about y", Vector6::new(-z_m * (1.0 + X * X), -z_m * X * Y, 0.0, 0.0, 1.0, 0.0)),
    ]
}

/// Example 10.2 for the point P3 of Example 10.1.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn example_10_2() -> Result<Findings, ExperimentError> {
    let fail = fail("example-10-2");
    let X_CO = example_pose();
    let s = project(&X_CO).ok_or_else(|| fail(&"a point lies behind the camera"))?;
    let (s, p_C) = (s[2], X_CO * super::cell::POINTS[2]);
    let L = point_rows(&s, p_C.z);
    let basis = null_space(&s, p_C.z);
    let mut out = Findings::default();
    out.metric("s", s.as_slice());
    out.metric("z_m", p_C.z);
    out.metric("L_s", L.row_iter().map(|row| row.iter().copied().collect::<Vec<_>>()).collect::<Vec<_>>());
    let singular = L.singular_values();
    out.metric("singular_values", singular.as_slice());
    let mut table = String::from("vector,v_x,v_y,v_z,w_x,w_y,w_z,L_s_v_x,L_s_v_y\n");
    let mut entries = Vec::new();
    for (name, v) in basis {
        let moved = L * v;
        let numbers = v.iter().chain(moved.iter()).map(|x| format!("{x:.12}")).collect::<Vec<_>>().join(",");
        table += &format!("{name},{numbers}\n");
        out.lines.push(format!(
            "{name:25} {:?}: the point moves by {:.1e}",
            v.map(round).as_slice(),
            moved.norm()
        ));
        entries.push(json!({ "name": name, "v": v.as_slice(), "L_s_v": moved.as_slice() }));
    }
    out.metric("null_space", entries);
    out.lines.push(format!(
        "L_s is 2 x 6 with singular values {:.4} and {:.4}: rank 2, and four motions that leave the point where it is in the image",
        singular[0], singular[1]
    ));
    out.table("null-space", table);
    Ok(out)
}

fn round(x: f64) -> f64 {
    (x * 1e4).round() * 1e-4
}

/// Distance of each corner of the regular triangle from the optical axis, m. Chosen by hand: as large as the square of Example 10.1.
const TRIANGLE_M: f64 = 0.1;

/// A regular triangle parallel to the image plane, centred on the optical axis, and its object's pose.
///
/// From the distance `sqrt(3)` times its circumradius R all three corners are 2 R from the camera, under angles with the cosine 5/8 between
/// them. With two corners there, the third one's distance d has `d^2 - 2 (5/8) 2 R d + R^2 = 0`: it is 2 R or R / 2, at each of the corners.
/// Fischler and Bolles (1981) give this triangle as the one that shows that four poses occur.
fn four_pose_triangle() -> ([Correspondence; 3], Pose) {
    let X_CO = Pose::translation(0.0, 0.0, TRIANGLE_M * 3.0_f64.sqrt());
    let corner = |i: u8| {
        let (y, x) = (f64::from(i) * TAU / 3.0).sin_cos();
        let r = Vector2::new(x, y) * TRIANGLE_M;
        Correspondence { r, s: r / X_CO.translation.z }
    };
    ([corner(0), corner(1), corner(2)], X_CO)
}

/// Every pose that shows `three` points where they are, with where the integration ends from beside it; `truth` is the pose sought. The metric and the
/// table are called `name`, with a `-` between the words of the table's.
fn every_pose(
    out: &mut Findings,
    (name, words): (&str, &str),
    three: &[Correspondence; 3],
    truth: &Pose,
) -> Result<(), ExperimentError> {
    let fail = fail("example-10-4");
    let found = p3p(three).map_err(|e| fail(&e))?;
    let (mut entries, mut table) =
        (Vec::new(), String::from("solution,x_m,y_m,z_m,phi_z_rad,phi_y_rad,phi_x_rad\n"));
    for (i, X_CO) in found.as_slice().iter().enumerate() {
        let (p, phi) = (X_CO.translation.vector, euler_zyx(&X_CO.rotation.to_rotation_matrix()));
        let x = Vector6::new(p.x, p.y, p.z, phi.x, phi.y, phi.z);
        let mut estimate = x.add_scalar(BESIDE);
        let VirtualServoing { gain_1_s, dt_s, .. } = VirtualServoing::default();
        for _ in 0..STEPS {
            estimate = algorithmic_step(&estimate, three, gain_1_s, dt_s).map_err(|e| fail(&e))?.x;
        }
        let stays = (estimate - x).norm();
        let off = X_CO.inv_mul(truth);
        let is_sought = off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6;
        let numbers = x.iter().map(|x| format!("{x:.10}")).collect::<Vec<_>>().join(",");
        table += &format!("{},{numbers}\n", i + 1);
        out.lines.push(format!(
            "{words}, solution {}: x = {:?}{}; from beside it the integration ends {stays:.1e} from it",
            i + 1,
            x.map(round).as_slice(),
            if is_sought { ", the one sought" } else { "" }
        ));
        entries.push(json!({ "x": x.as_slice(), "is_sought": is_sought, "distance_from_beside": stays }));
    }
    out.metric(name, entries);
    out.table(&name.replace('_', "-"), table);
    Ok(())
}

/// Example 10.4, and the note on it: of three points alone, every pose from which they look so is one to which the integration may converge.
/// The example's own first three points leave two poses, a regular triangle about the optical axis four, which is the most.
///
/// # Errors
/// [`ExperimentError::Computation`].
pub(super) fn example_10_4() -> Result<Findings, ExperimentError> {
    let fail = fail("example-10-4");
    let (mut out, truth) = (examples::example_10_4()?, example_pose());
    let s = project(&truth).ok_or_else(|| fail(&"a point lies behind the camera"))?;
    let [a, b, c, _] = correspondences(&s);
    every_pose(&mut out, ("three_points", "P1, P2, P3 alone"), &[a, b, c], &truth)?;
    let (triangle, X_CO) = four_pose_triangle();
    out.metric("triangle_s", triangle.map(|p| [p.s.x, p.s.y]));
    out.metric("triangle_m", triangle.map(|p| [p.r.x, p.r.y]));
    every_pose(&mut out, ("triangle", "regular triangle about the optical axis"), &triangle, &X_CO)?;
    Ok(out)
}
