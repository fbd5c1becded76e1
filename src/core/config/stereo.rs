//! `[stereo]`: the first two of `[[cameras]]` measure one object as a pair, the first one as the left camera.
//!
//! | where | what |
//! |---|---|
//! | `cameras[0]`, `cameras[1]` | lenses, rates, sources, mounts |
//! | `stereo.right_in_left` | pose of the right camera in the left one, instead of its mount |
//! | `stereo.taught_file`, `[[stereo.points]]` | the taught view; without it, a simulated pair is taught at `servo.desired` |

use super::check::{Validation, pose};
use super::raw::{
    AreaKind, Clock, PoseFrom, RawConfig, RawMount, RawStereo, RawTaughtPoint, RawTaughtView, SetPointKind,
    Task,
};
use super::servo::uses_dimension;
use super::{Camera, Document, Problem};
use crate::geometry::Pose;
use crate::input::file;
use crate::robot::Mount;
use crate::stereo::StereoError;
use crate::target::Target;
use crate::time::SpanNs;
use crate::vision::{StereoRig, TaughtPoint, TaughtView};
use nalgebra::{Matrix3, Point3};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Ranges wider than any use, chosen, so that a slip is reported; `tests/cores/plausible_numbers.rs` tries their ends.
/// Ranges of numbers. Chosen by hand: outside of them a number has another unit.
const TOLERANCE_MS: RangeInclusive<f64> = 0.01..=100.0;
const PLACE_M: RangeInclusive<f64> = -100.0..=100.0;
const COVARIANCE_M2: RangeInclusive<f64> = -1.0..=1.0;

/// Two cameras that measure together.
#[derive(Debug, Clone)]
pub struct Stereo {
    /// Both cameras, with their nominal parameters.
    pub rig: StereoRig,
    /// Pose of the object's frame in the taught view, by convention.
    pub X_DO: Pose,
    /// Largest difference of the stamps of a pair.
    pub tolerance: SpanNs,
    /// The taught view; `None`: a simulated pair is taught in the desired pose.
    pub taught: Option<TaughtView>,
}

/// Taught points as a file for `stereo.taught_file`.
#[must_use]
pub fn taught_file(points: &[TaughtPoint]) -> String {
    let raw = |p: &TaughtPoint| {
        let C = &p.covariance;
        RawTaughtPoint {
            id: p.id,
            position_m: p.p_D.into(),
            covariance_m2: [C.m11, C.m12, C.m13, C.m22, C.m23, C.m33],
        }
    };
    toml::to_string(&RawTaughtView { points: points.iter().map(raw).collect() }).unwrap_or_default()
}

/// Loads the points of `stereo.taught_file` into the table, as if they had been written there. `absolute` makes a path of the run file absolute.
pub(super) fn resolve(
    raw: &mut RawConfig,
    document: &Document,
    absolute: impl Fn(&str, &Path) -> PathBuf,
    problems: &mut Vec<Problem>,
) {
    const KEY: &str = "stereo.taught_file";
    let Some(stereo) = &mut raw.stereo else { return };
    let Some(name) = stereo.taught_file.take() else { return };
    let mut wrong = |message: String| problems.push(document.problem(KEY, message));
    if !stereo.points.is_empty() {
        return wrong("[[stereo.points]] are given too: leave out one of them".into());
    }
    let path = absolute(KEY, &name);
    let place = path.display();
    match file::read(&path, file::MAX_TOML) {
        Err(e) => wrong(format!("{place} cannot be read: {e}")),
        Ok(text) => match toml::from_str::<RawTaughtView>(&text) {
            Err(e) => {
                wrong(format!("{place}: {}; [[points]] with id and position_m are expected", e.message()))
            }
            Ok(view) if view.points.is_empty() => wrong(format!("{place} has no [[points]]")),
            Ok(view) => stereo.points = view.points,
        },
    }
}

/// The mount of the right camera, where `stereo.right_in_left` defines it; `left` is that of the left one.
pub(super) fn right_mount(
    raw: &RawConfig,
    written: &RawMount,
    left: &Mount,
    check: &mut Validation<'_>,
) -> Option<Mount> {
    let X = raw.stereo.as_ref()?.right_in_left.as_ref()?;
    if *written != RawMount::default() {
        check.wrong(
            "cameras[1].mount",
            "stereo.right_in_left says where this camera sits: leave out one of them",
        );
    }
    // its numbers are checked with the rest of `[stereo]`
    let X_LR = pose(X.position_m, X.rotation_rpy_rad);
    Some(left.with_pose(left.pose() * X_LR))
}

/// Pose of one camera in another; `None` where they are not on the same body: flange, link or base.
pub(super) fn between(left: &Mount, right: &Mount) -> Option<Pose> {
    let is_fixed = left.with_pose(*right.pose()) == *right;
    is_fixed.then(|| left.pose().inv_mul(right.pose()))
}

/// Checks all of `[stereo]`, and its requirements on other tables.
pub(super) fn stereo(
    raw: &RawConfig,
    (camera, further): (Option<&Camera>, &[Camera]),
    (target, X_DO): (Option<&Target>, &Pose),
    check: &mut Validation<'_>,
) -> Option<Stereo> {
    let s = raw.stereo.as_ref()?;
    let tolerance = check.span_ms("stereo.pair_tolerance_ms", s.pair_tolerance_ms, TOLERANCE_MS);
    if let Some(X) = &s.right_in_left {
        check.pose("stereo.right_in_left", X.position_m, X.rotation_rpy_rad);
    }
    of_the_run(raw, check);
    let points = points(s, check)?;
    let taught = if points.is_empty() {
        None
    } else {
        match TaughtView::new(&points, *X_DO) {
            Ok(view) => Some(view),
            Err(e) => {
                check.wrong("stereo.points", e.to_string());
                return None;
            }
        }
    };
    if let (Some(view), Some(target)) = (&taught, target) {
        let ids = target.points().len();
        for (id, _) in view.points_O().filter(|(id, _)| *id as usize >= ids) {
            let message = format!(
                "point {id} is none of the target's, which has the ids 0 to {}",
                ids.saturating_sub(1)
            );
            check.wrong("stereo.points", message);
        }
    }
    let given = raw.cameras.len();
    if given != 2 {
        let message = format!("needs two [[cameras]], the left one first; the run file has {}", given.max(1));
        check.wrong("stereo", message);
        return None;
    }
    let (left, [right]) = (camera?, further) else { return None };
    of_the_cameras(raw, left, right, tolerance, check);
    let Some(X_LR) = between(&left.mount, &right.mount) else {
        check.wrong(
            "cameras[1].mount.kind",
            "must be that of the left camera: the two are fixed to each other",
        );
        return None;
    };
    match StereoRig::new(left.model, right.model, X_LR) {
        Ok(rig) => {
            let rig = rig.with_model_sd_px(raw.vision.model_sd_px);
            in_view(&rig, (target?, X_DO), taught.as_ref(), check);
            Some(Stereo { rig, X_DO: *X_DO, tolerance, taught })
        }
        Err(StereoError::Degenerate) => {
            check.wrong(
                "cameras[1].mount",
                "both cameras sit in one place, which shows no depth: give the right one another place, or stereo.right_in_left",
            );
            None
        }
        Err(e) => {
            check.wrong("cameras[1].mount", e.to_string());
            None
        }
    }
}

/// Requirements of a pair of cameras on task and law.
fn of_the_run(raw: &RawConfig, check: &mut Validation<'_>) {
    if raw.run.task != Task::Servo {
        check.wrong("run.task", "must be `servo` with [stereo]: calibrate each camera's latency by itself");
    }
    if raw.servo.set_point.kind != SetPointKind::Pose {
        check.wrong(
            "servo.set_point.kind",
            "must be `pose` with [stereo], where the taught points are the goal: see stereo.taught_file",
        );
    }
    if raw.servo.dimension == 4 && uses_dimension(raw.servo.scheme) {
        check.wrong("servo.dimension", "must be 6 with [stereo]: 4 needs the target's own geometry");
    }
    if raw.servo.pose_from == PoseFrom::Homography {
        check.wrong("servo.pose_from", "must be `measurement` with [stereo]: two images tell the scale");
    }
    for (key, is_given) in [
        ("servo.points", !raw.servo.points.is_empty()),
        ("servo.segments", !raw.servo.segments.is_empty()),
        ("servo.area", raw.servo.area != AreaKind::None),
        ("servo.weights", !raw.servo.weights.is_empty()),
    ] {
        if is_given {
            check.wrong(key, "has no meaning with [stereo], where all taught points count: leave it out");
        }
    }
}

/// Requirements of a pair on each of its cameras.
fn of_the_cameras(
    raw: &RawConfig,
    left: &Camera,
    right: &Camera,
    tolerance: SpanNs,
    check: &mut Validation<'_>,
) {
    if left.rate_hz != right.rate_hz {
        let message = format!(
            "is {} Hz, that of the left camera {} Hz: frames of one instant need one rate",
            right.rate_hz, left.rate_hz
        );
        check.wrong("cameras[1].rate_hz", message);
        return;
    }
    let half_ms = 0.5e3 / left.rate_hz;
    if tolerance.as_s() * 1e3 > half_ms {
        let message = format!(
            "{:?} ms is more than half a frame period ({half_ms:.3} ms): a frame could have two mates; lower it",
            raw.stereo.as_ref().map_or(0.0, |s| s.pair_tolerance_ms)
        );
        check.wrong("stereo.pair_tolerance_ms", message);
    }
    let latest = right.latency.0.saturating_add(right.schedule.jitter().0);
    if raw.run.clock == Clock::Lockstep && latest > left.latency.0 {
        check.wrong(
            "cameras[1].latency_ms",
            "in lockstep a pair is used when the left frame is due: the right camera's latency and jitter together must not be \
             longer than the left one's latency; raise cameras[0].latency_ms",
        );
    }
}

fn points(s: &RawStereo, check: &mut Validation<'_>) -> Option<Vec<TaughtPoint>> {
    let before = check.count_problems();
    let mut points = Vec::new();
    for (i, point) in s.points.iter().enumerate() {
        for (key, values, allowed) in [
            ("position_m", point.position_m.as_slice(), PLACE_M),
            ("covariance_m2", point.covariance_m2.as_slice(), COVARIANCE_M2),
        ] {
            for (k, value) in values.iter().enumerate() {
                check.range(&format!("stereo.points[{i}].{key}[{k}]"), *value, allowed.clone());
            }
        }
        let [xx, xy, xz, yy, yz, zz] = point.covariance_m2;
        points.push(TaughtPoint {
            id: point.id,
            p_D: Point3::from(point.position_m),
            covariance: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        });
    }
    (check.count_problems() == before).then_some(points)
}

/// Whether the goal is in the image of both cameras. The left camera's view of the described target is checked elsewhere.
fn in_view(
    rig: &StereoRig,
    (target, X_DO): (&Target, &Pose),
    taught: Option<&TaughtView>,
    check: &mut Validation<'_>,
) {
    let hidden = |p_D: &Point3<f64>| {
        let seen = rig.project(p_D);
        seen.is_none_or(|[l, r]| !rig.left().contains(&l, 0.0) || !rig.right().contains(&r, 0.0))
    };
    match taught {
        Some(view) => {
            if let Some((id, _)) = view.points_O().find(|(_, p_O)| hidden(&(X_DO * p_O))) {
                let message = format!(
                    "point {id} lies outside of an image: were these the cameras that it was taught with?"
                );
                check.wrong("stereo.points", message);
            }
        }
        None => {
            let all = target.points();
            let seen = all.iter().filter(|point| !hidden(&(X_DO * point.p_O))).count();
            if seen < target.min_to_find() {
                let message = format!(
                    "only {seen} of the target's {} points would be in both images in the desired pose: move it away, or the \
                     cameras together",
                    all.len()
                );
                check.wrong("servo.desired", message);
            }
        }
    }
}
