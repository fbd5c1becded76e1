//! Features that an image-based law compares: `servo.points`, `servo.segments`, `servo.area` and their weights.

use super::check::Validation;
use super::raw::{AreaKind, PoseFrom, RawServo, SchemeKind};
use crate::servo::{FeatureKind, Law, OutlineFeature, Selection, SetPoint, determined_directions};
use std::fmt::Debug;

/// Weights of features. Chosen by hand, wider than any use.
const WEIGHT: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

/// The selection for a target of so many `points`; `None` where it cannot be made.
pub(super) fn selection(s: &RawServo, points: usize, check: &mut Validation<'_>) -> Option<Selection> {
    let mut kinds: Vec<FeatureKind> = Vec::new();
    named_once("servo.points", &s.points, check);
    let between = |[i, j]: &[usize; 2]| [*i.min(j), *i.max(j)];
    named_once("servo.segments", &s.segments.iter().map(between).collect::<Vec<_>>(), check);
    let mut index = |key: &str, i: usize| {
        if !(1..=points).contains(&i) {
            check.wrong(key, format!("names point {i}; the target has the points 1 to {points}"));
        }
        i.wrapping_sub(1)
    };
    kinds.extend(s.points.iter().map(|i| FeatureKind::Point(index("servo.points", *i))));
    kinds.extend(
        s.segments
            .iter()
            .map(|[i, j]| FeatureKind::Segment(index("servo.segments", *i), index("servo.segments", *j))),
    );
    let outline: Vec<usize> = s.outline.iter().map(|i| index("servo.outline", *i)).collect();
    kinds.extend(area_feature(s.area).map(FeatureKind::Outline));
    if kinds.is_empty() {
        kinds.extend((0..points).map(FeatureKind::Point));
    }
    if !s.weights.is_empty() && s.weights.len() != kinds.len() {
        let message = format!("has {} entries, the law compares {} features", s.weights.len(), kinds.len());
        check.wrong("servo.weights", message);
        return None;
    }
    for (i, weight) in s.weights.iter().enumerate() {
        check.range(&format!("servo.weights[{i}]"), *weight, WEIGHT);
    }
    if s.weights.iter().any(|weight| !WEIGHT.contains(weight)) {
        return None;
    }
    let weights = s.weights.iter().copied().chain(std::iter::repeat(1.0));
    let selection = Selection::new(kinds.into_iter().zip(weights));
    let Some(selection) = selection else {
        check.wrong("servo.segments", "too many features, or a segment from a point to itself");
        return None;
    };
    let with_area = if !selection.needs_outline() {
        Some(selection)
    } else if outline.is_empty() {
        selection.with_outline(0..points)
    } else {
        selection.with_outline(outline)
    };
    let Some(selection) = with_area else {
        check.wrong("servo.outline", "an area needs three points of the target or more, none of them twice");
        return None;
    };
    let used = selection.points().count();
    if s.scheme == SchemeKind::Hybrid && s.dimension == 6 && used < 4 {
        check.wrong("servo.points", format!("hybrid with servo.dimension = 6 needs 4 points, not {used}"));
    }
    if s.pose_from == PoseFrom::Homography {
        let key = "servo.pose_from";
        if !matches!(s.scheme, SchemeKind::PositionPd | SchemeKind::PositionResolvedVelocity) {
            check.wrong(
                key,
                "is `homography`, for position_pd and position_resolved_velocity; hybrid goes by a homography anyway",
            );
        } else if s.dimension != 6 {
            check.wrong(
                key,
                format!("is `homography`, which gives six numbers: servo.dimension is {}", s.dimension),
            );
        } else if used < 4 {
            check.wrong(key, format!("is `homography`, which needs 4 points, not {used}"));
        }
    }
    Some(selection)
}

/// Reports a feature that is named more than once: it tells no more than once, and counts as a further point where points are counted.
fn named_once<F: PartialEq + Debug>(key: &str, features: &[F], check: &mut Validation<'_>) {
    for (i, feature) in features.iter().enumerate() {
        if features.iter().take(i).any(|before| before == feature) {
            let message = format!(
                "names {feature:?} more than once, which tells nothing more of the pose: leave it out there, or give it a weight in servo.weights"
            );
            check.wrong(&format!("{key}[{i}]"), message);
        }
    }
}

fn area_feature(area: AreaKind) -> Option<OutlineFeature> {
    match area {
        AreaKind::None => None,
        AreaKind::Area => Some(OutlineFeature::Area),
        AreaKind::Moments => Some(OutlineFeature::Moments),
        AreaKind::Ellipse => Some(OutlineFeature::Ellipse),
    }
}

/// Warns of weights without effect: where the arm can reduce every error of the law to zero, no compromise depends on them.
fn useless_weights(law: &Law, selection: &Selection, directions: usize, check: &mut Validation<'_>) {
    let weights = || selection.features().iter().map(|(_, weight)| *weight);
    let alike = weights().all(|weight| weights().next() == Some(weight));
    let numbers = selection.numbers();
    if matches!(law, Law::ImageVelocity { .. }) && !alike && numbers <= directions {
        let message = format!(
            "change nothing: the law compares {numbers} numbers and the arm moves in {directions} directions, so that every error is met; give \
             servo.gain_1_s a list of {numbers} for errors that fall at different rates"
        );
        check.doubtful("servo.weights", message);
    }
}

/// Warns where the features do not determine the pose at the goal: the arm would stop, or drift, with a remaining error.
pub(super) fn doubtful_features(law: &Law, set_point: &SetPoint, joints: usize, check: &mut Validation<'_>) {
    if !matches!(law, Law::ImageVelocity { .. } | Law::ImageTorque { .. } | Law::PreconditionedTorque { .. })
    {
        return;
    }
    useless_weights(law, set_point.selection(), joints.min(6), check);
    let key = if set_point.selection().needs_outline() { "servo.area" } else { "servo.points" };
    let Some(told) = determined_directions(set_point) else {
        let none = "at the goal this area has no longest axis, so no orientation: name other points of it in servo.outline, three that \
                    are no regular figure";
        return check.doubtful(key, none);
    };
    let needed = joints.min(6);
    if set_point.selection().points().count() == 3 && needed == 6 {
        let message = "three points look the same from up to four poses of the camera: the arm may come to rest in another one than the goal, with \
                       all three where they should be; let the law compare a fourth point, or start near the goal";
        check.doubtful("servo.points", message);
    }
    if told < needed {
        let message = format!(
            "these features tell of {told} directions at the goal, the arm has {needed}: it may stop elsewhere; let the law compare more"
        );
        check.doubtful(key, message);
    }
}
