//! Does the target rest where lens, mount, stamps and sizes say?
//!
//! Each measurement gives a place of the target in B, p_BO = X_BC(exposure) p_CO. Of a target at rest in a cell that is as described these are one point.
//! Else they spread as the arm moves, and each error of the description in a way of its own, to first order:
//! ```text
//! stamps late by dt             (d p_BO / dt) dt        the camera was elsewhere
//! camera turned by r (in C)     R_BC (p_CO x r)
//! camera displaced by d (in C)  -R_BC d
//! sizes too large by s          R_BC p_CO s             target or focal length
//! object moves with v           v t
//! ```
//! The one of them that explains most of the spread, by least squares, is told with its size.

use super::{Cause, RunEvidence, RunFinding, intake, median, pace};
use crate::control::outcome::Outcome;
use crate::mission::contradicted_text;
use crate::mission::residual::OUT_OF_REACH;
use crate::report::csv_table::CsvTable;
use nalgebra::{DMatrix, DVector, Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Spread below which a cell is as described, m, root mean square. Chosen by hand: twenty times what the simulated camera's noise makes of it, and what
/// most arms are accurate to.
const SPREAD_M: f64 = 0.5e-3;
/// An error explains a spread of which it leaves less than this share. Measured: the true one leaves 0.10 at most in the simulated cells, a turn of the camera
/// leaves 0.36 of an object that moves on a circle before an arm that follows it, and with 60 measurements of a cell at rest none leaves less than 0.9.
const LEFT_SHARE: f64 = 0.3;
/// Largest angle by which a run goes on with a camera that is turned against its mount, rad. Chosen by hand: beyond a right angle the law goes away from its goal, and to
/// first order an angle is told to about this.
const TURN_RAD: f64 = 1.2;
/// Fewest places. Derived: three unknowns for each of two vectors need two; four times of that, so that noise is not fitted.
const FEWEST: usize = 8;
/// A spread that nothing explains is a motion where it changes from place to place by less than this share of it. Chosen by hand.
const SMOOTH_SHARE: f64 = 0.2;
/// And is more than this, m. Chosen by hand: a lens that is wrong in its distortion makes 3 mm of it.
const MOTION_M: f64 = 0.01;

/// One place of the target.
struct SeenPlace {
    time_s: f64,
    p_BO: Vector3<f64>,
    velocity: Vector3<f64>,
    R_BC: Matrix3<f64>,
    p_CO: Vector3<f64>,
}

pub(super) fn findings(evidence: &RunEvidence) -> Vec<RunFinding> {
    let mut found = Vec::from_iter(lens(evidence));
    // What was refused tells of stamps or images, and nothing of the cell.
    let used = intake::used(&evidence.measurements);
    found.extend(depth(evidence, &used));
    // Of a target on the flange the report does not have the flange's orientation.
    if evidence.config.camera.mount.is_on_arm() && evidence.config.closes_the_loop() {
        let places = places(evidence, &used);
        found.extend(at_rest(evidence, &places));
    } else if let Some(text) = contradicted_text(&evidence.summary.contradicted) {
        found.push(RunFinding {
            cause: evidence
                .summary
                .contradicted
                .first()
                .map_or(Cause::WrongMount, |number| cause_of(&number.key)),
            what: "lens, mount, stamps or target are not as described".into(),
            evidence: text,
            change: "the keys that are named there".into(),
        });
    }
    if evidence.summary.reason == OUT_OF_REACH && found.is_empty() && pace::below_scatter(evidence).is_none()
    {
        let px = evidence.summary.final_errors.feature_error_px.unwrap_or(f64::NAN);
        found.push(RunFinding {
            cause: Cause::WrongLens,
            what: "the arm stands where the law feels no error any more, and the image is not the goal's: lens, mount or target are not as described".into(),
            evidence: format!("{px:.3} px remain, and do not change"),
            change: "[camera.lens]: calibrate it (`vservo calibrate camera`); [camera.mount], [target]; or teach the goal (servo.set_point.kind = \"taught\")".into(),
        });
    }
    found
}

/// The cause that a wrong number of the description is.
fn cause_of(key: &str) -> Cause {
    match key {
        key if key.starts_with("camera.stamp") => Cause::WrongStamps,
        key if key.starts_with("camera.lens") => Cause::WrongLens,
        key if key.starts_with("camera.mount") => Cause::WrongMount,
        _ => Cause::WrongScale,
    }
}

/// Points that fit no pose of the target through this lens.
fn lens(evidence: &RunEvidence) -> Option<RunFinding> {
    let table = &evidence.measurements;
    let refused = (0..table.rows()).filter(|row| table.word("status", *row) == "Inconsistent").count();
    let model_error = evidence.summary.model_error.as_ref();
    let most = 2 * refused > table.rows();
    if model_error.is_none() && !most {
        return None;
    }
    let rms_px = median(table.numbers("reprojection_rms_px").iter().copied());
    let told = model_error.map_or(String::new(), |error| format!("; {}", error.to_text()));
    Some(RunFinding {
        cause: Cause::WrongLens,
        what: "the points of the target fit no pose of it: the lens, or the target, is not as described"
            .into(),
        evidence: format!(
            "{refused} of {} measurements were refused, points are off by {rms_px:.2} px{told}",
            table.rows()
        ),
        change: "[camera.lens]: calibrate it (`vservo calibrate camera`); [target]: measure it; for a small error vision.model_sd_px".into(),
    })
}

/// The depth that the law is told to take, beside the measured one.
fn depth(evidence: &RunEvidence, table: &CsvTable) -> Option<RunFinding> {
    // Chosen by hand: the gain is wrong by the same factor, which a loop bears up to a half.
    const BEARABLE: std::ops::RangeInclusive<f64> = 0.67..=1.5;
    let servo = &evidence.config.effective.servo;
    let word = toml::Value::try_from(servo.depth).ok()?;
    let measured_m = median(table.numbers("CO_z_m").iter().copied());
    let factor = servo.constant_depth_m / measured_m;
    if word.as_str() != Some("constant") || !factor.is_finite() || BEARABLE.contains(&factor) {
        return None;
    }
    Some(RunFinding {
        cause: Cause::WrongDepth,
        what: format!(
            "the law takes a depth that is {factor:.2} times the target's: it is as if the gain were wrong by that factor"
        ),
        evidence: format!(
            "servo.constant_depth_m is {}, the target was {measured_m:.3} m away",
            servo.constant_depth_m
        ),
        change: format!("servo.depth = \"estimated\", or servo.constant_depth_m = {measured_m:.2}"),
    })
}

/// The places of all measurements with a pose.
fn places(evidence: &RunEvidence, table: &CsvTable) -> Vec<SeenPlace> {
    let times = evidence.trace.numbers("time_s");
    let numbers = |names: [&str; 3], row| names.map(|name| table.number(name, row));
    let place = |row: usize| {
        let time_s = table.number("exposure_s", row);
        let p_CO = Vector3::from(numbers(["CO_x_m", "CO_y_m", "CO_z_m"], row));
        // The first tick after it and the one before.
        let after = times.partition_point(|t| *t < time_s);
        let (before, span) = (after.checked_sub(1)?, times.get(after)? - times.get(after - 1)?);
        let share = (time_s - times.get(before)?) / span;
        let (p0, q0) = camera(evidence, before)?;
        let (p1, q1) = camera(evidence, after)?;
        let q = q0.nlerp(&q1, share);
        let at = |p: Vector3<f64>, q: UnitQuaternion<f64>| p + q * p_CO;
        let p_BO = at(p0.lerp(&p1, share), q);
        let velocity = (at(p1, q1) - at(p0, q0)) / span;
        let finite = p_BO.iter().chain(&velocity).all(|x| x.is_finite());
        finite.then(|| SeenPlace { time_s, p_BO, velocity, R_BC: q.to_rotation_matrix().into_inner(), p_CO })
    };
    (0..table.rows()).filter_map(place).collect()
}

/// X_BC at a tick.
fn camera(evidence: &RunEvidence, row: usize) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
    let [x, y, z] = ["C_x_m", "C_y_m", "C_z_m"].map(|name| evidence.trace.number(name, row));
    let [i, j, k, w] = ["C_qx", "C_qy", "C_qz", "C_qw"].map(|name| evidence.trace.number(name, row));
    w.is_finite()
        .then(|| (Vector3::new(x, y, z), UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k))))
}

fn columns(place: &SeenPlace, cause: CellError) -> DMatrix<f64> {
    let three = |m: Matrix3<f64>| DMatrix::from_fn(3, 3, |i, j| m[(i, j)]);
    let one = |v: Vector3<f64>| DMatrix::from_fn(3, 1, |i, _| v[i]);
    match cause {
        CellError::Stamps => one(place.velocity),
        CellError::Turn => three(place.R_BC * place.p_CO.cross_matrix()),
        CellError::Displacement => three(-place.R_BC),
        CellError::Scale => one(place.R_BC * place.p_CO),
        CellError::Motion => three(Matrix3::identity() * place.time_s),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CellError {
    Stamps,
    Turn,
    Displacement,
    Scale,
    Motion,
}

const KINDS: [CellError; 5] =
    [CellError::Stamps, CellError::Turn, CellError::Displacement, CellError::Scale, CellError::Motion];

/// Whether a run can have gone on with an error of this size.
fn is_bearable(kind: CellError, size: &[f64]) -> bool {
    kind != CellError::Turn || size.iter().map(|x| x * x).sum::<f64>().sqrt() < TURN_RAD
}

/// What is left of the spread, m, and the size of the error, which explains most of it.
fn fit(places: &[SeenPlace], mean: &Vector3<f64>, kind: Option<CellError>) -> Option<(f64, Vec<f64>)> {
    let unknowns = kind.map_or(0, |kind| places.first().map_or(0, |place| columns(place, kind).ncols()));
    let n = 3 + unknowns;
    let (mut normal, mut right, mut square) = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
    for place in places {
        let mut rows = DMatrix::zeros(3, n);
        rows.view_mut((0, 0), (3, 3)).fill_with_identity();
        if let Some(kind) = kind {
            rows.view_mut((0, 3), (3, unknowns)).copy_from(&columns(place, kind));
        }
        let b = place.p_BO - mean;
        let b = DVector::from_column_slice(b.as_slice());
        normal += rows.transpose() * &rows;
        right += rows.transpose() * &b;
        square += b.norm_squared();
    }
    // Directions that the motion does not show are left at zero.
    let svd = normal.svd(true, true);
    let smallest = 1e-9 * svd.singular_values.max(); // derived: squares of columns, of which a 3e-5th is rounding and noise
    let x = svd.solve(&right, smallest).ok()?;
    let left = ((square - x.dot(&right)).max(0.0) / places.len() as f64).sqrt();
    Some((left, x.iter().skip(3).copied().collect()))
}

fn at_rest(evidence: &RunEvidence, places: &[SeenPlace]) -> Option<RunFinding> {
    if places.len() < FEWEST {
        return None;
    }
    let mean = places.iter().map(|place| place.p_BO).sum::<Vector3<f64>>() / places.len() as f64;
    let (spread, _) = fit(places, &mean, None)?;
    let follows = evidence.config.effective.servo.object.moves || evidence.config.servo.path.is_some();
    if spread < SPREAD_M || follows {
        return None;
    }
    let fits = KINDS.iter().filter_map(|kind| Some((*kind, fit(places, &mean, Some(*kind))?)));
    let explains =
        |(kind, (left, size)): &(_, (f64, Vec<f64>))| *left < LEFT_SHARE * spread && is_bearable(*kind, size);
    let best = fits.filter(explains).min_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b));
    let mm = 1e3;
    let Some((kind, (left, size))) = best else { return moves_otherwise(evidence, places, spread) };
    let told = format!(
        "the places at which the target was seen spread by {:.2} mm as the arm moves, and by {:.2} mm with that taken off",
        spread * mm,
        left * mm
    );
    let list = |scale: f64, digits: usize| {
        let parts: Vec<_> = size.iter().map(|x| format!("{:.digits$}", x * scale + 0.0)).collect();
        parts.join(", ")
    };
    let first = size.first().copied().unwrap_or(f64::NAN);
    let (cause, what, change) = match kind {
        CellError::Stamps => {
            let ms = first * 1e3;
            let now = evidence.config.effective.camera.stamp_offset_ms;
            (
                Cause::WrongStamps,
                format!(
                    "the exposure stamps are {} by {:.1} ms",
                    if ms > 0.0 { "late" } else { "early" },
                    ms.abs()
                ),
                format!(
                    "camera.stamp_offset_ms = {:.1}; `vservo calibrate latency` measures it, camera.latency_ms",
                    now - ms
                ),
            )
        }
        CellError::Turn => (
            Cause::WrongMount,
            format!(
                "the camera is turned against its mount by ({}) deg about its axes",
                list(1f64.to_degrees(), 1)
            ),
            "camera.mount.rotation_rpy_rad: `vservo calibrate hand-eye`".into(),
        ),
        CellError::Displacement => (
            Cause::WrongMount,
            format!("the camera is displaced against its mount by ({}) mm along its axes", list(mm, 1)),
            "camera.mount.position_m: `vservo calibrate hand-eye`".into(),
        ),
        CellError::Scale => (
            Cause::WrongScale,
            format!(
                "distances are measured {:.1} % too {}: the target has another size, or the lens another focal length",
                first.abs() * 100.0,
                if first > 0.0 { "long" } else { "short" }
            ),
            "[target]: measure its size; [camera.lens] fx_px, fy_px: `vservo calibrate camera`".into(),
        ),
        CellError::Motion => (
            Cause::ObjectMoves,
            format!("the object moves by ({}) mm/s in B", list(mm, 0)),
            follow_it(evidence, ""),
        ),
    };
    Some(RunFinding { cause, what, evidence: told, change })
}

/// What lets a run follow an object.
fn follow_it(evidence: &RunEvidence, which: &str) -> String {
    let without = match evidence.config.second_view {
        Some(_) => " in a run with one camera alone (with [second_view] both targets rest)",
        None => "",
    };
    format!("servo.object.moves = true{without}{which}")
}

/// A spread that no error of the description explains, but that is smooth: the object moves as it likes.
fn moves_otherwise(evidence: &RunEvidence, places: &[SeenPlace], spread: f64) -> Option<RunFinding> {
    let steps = places.windows(2).map(|pair| match pair {
        [a, b] => (b.p_BO - a.p_BO).norm(),
        _ => f64::NAN,
    });
    let step = median(steps);
    if spread < MOTION_M || step > SMOOTH_SHARE * spread || evidence.summary.outcome == Outcome::Fault {
        return None;
    }
    Some(RunFinding {
        cause: Cause::ObjectMoves,
        what: "the object moves by itself".into(),
        evidence: format!(
            "the places at which it was seen spread by {:.1} mm, smoothly, and no error of lens, mount or stamps explains it",
            spread * 1e3
        ),
        change: follow_it(evidence, ", for an object that moves steadily"),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{evidence, failed};
    use super::*;
    use std::f64::consts::TAU;

    /// What a run leaves whose object moves in B by 5 cm to and fro along x, every other second, before a camera that follows it late.
    fn follows_a_circle(verdict: &str) -> RunEvidence {
        let object = |t: f64| Vector3::new(0.05 * (TAU * 0.5 * t).sin(), 0.0, 0.5);
        let camera = |t: f64| object(t - 0.2) - Vector3::z() * 0.5;
        let mut trace = "time_s,C_x_m,C_y_m,C_z_m,C_qx,C_qy,C_qz,C_qw\n".to_owned();
        for k in 0..800 {
            let t = 0.01 * f64::from(k);
            let c = camera(t);
            trace += &format!("{t},{},{},{},0,0,0,1\n", c.x, c.y, c.z);
        }
        let mut table = "exposure_s,taken_s,status,verdict,CO_x_m,CO_y_m,CO_z_m\n".to_owned();
        for k in 0..200 {
            let t = 0.04 * f64::from(k) + 0.005;
            let p = object(t) - camera(t);
            table += &format!("{t},{},Found,{verdict},{},{},{}\n", t + 0.02, p.x, p.y, p.z);
        }
        failed(evidence("ur5", &trace, &table), "run.duration_s is over before the goal was reached")
    }

    #[test]
    fn an_object_to_and_fro_is_no_camera_that_is_turned() {
        let found = findings(&follows_a_circle("used"));
        assert_eq!(found.iter().map(|f| f.cause).collect::<Vec<_>>(), [Cause::ObjectMoves], "{found:?}");
        assert!(is_bearable(CellError::Turn, &[0.0, 0.0, 1.1]));
        assert!(!is_bearable(CellError::Turn, &[0.361, 0.187, -2.271]));
    }

    #[test]
    fn measurements_that_were_refused_tell_nothing_of_the_cell() {
        assert_eq!(findings(&follows_a_circle("refused_from_future")), []);
    }
}
