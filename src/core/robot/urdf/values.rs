//! The numbers of a URDF as the model wants them: poses, inertias, limits and friction, each within its bounds.

use super::super::bounds::{self, all_within, within};
use super::super::error::Defect;
use super::super::inertia::Inertia;
use super::super::model::{Friction, JointKind, JointLimits};
use super::document::{Joint, JointType, Origin, UrdfLimit, UrdfLink};
use crate::geometry::Pose;
use crate::input::number;
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector3};
use std::ops::RangeInclusive;

pub(super) fn pose(origin: &Origin) -> Result<Pose, Defect> {
    let xyz = bounds::lengths("origin xyz", origin.xyz)?;
    let rpy = all_within("origin rpy", origin.rpy, &bounds::ANGLE_RAD)?;
    let rotation = match origin.quat_xyzw {
        None => UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z),
        Some(components) => {
            for (i, component) in components.into_iter().enumerate() {
                within(&format!("origin quat_xyzw[{i}]"), component, &bounds::DIRECTION)?;
            }
            // a quaternion of length zero is no rotation: it must be a mistake
            let q = Quaternion::from(components);
            within("length of origin quat_xyzw", q.norm(), &(1e-9..=2.0 * *bounds::DIRECTION.end()))?;
            UnitQuaternion::new_normalize(q)
        }
    };
    Ok(Pose::from_parts(Translation3::from(xyz), rotation))
}

/// The child link's frame in the parent link's, with the joint at `position`, rad or m.
pub(super) fn place_at(joint: &Joint, position: f64) -> Result<Pose, Defect> {
    let X = pose(&joint.origin)?;
    let motion = match &joint.kind {
        JointType::Revolute | JointType::Continuous => Pose::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&axis(joint)?, position),
        ),
        JointType::Prismatic => Pose::from_parts(
            Translation3::from(axis(joint)?.into_inner() * position),
            UnitQuaternion::identity(),
        ),
        JointType::Fixed => Pose::identity(),
        JointType::Other(kind) => return Err(Defect::JointType { kind: kind.clone() }),
    };
    Ok(X * motion)
}

/// The position of a joint beyond the tip that the user has not given, rad or m: zero, or the end of its range that is nearest to zero.
pub(super) fn rest_position(joint: &Joint) -> Result<f64, Defect> {
    let end = |side: fn(&UrdfLimit) -> Option<f64>| joint.limit.as_ref().and_then(side).unwrap_or(0.0);
    let (lower, upper) = (end(|limit| limit.lower), end(|limit| limit.upper));
    match joint.kind {
        JointType::Revolute | JointType::Prismatic if lower <= upper => {
            within("limit", 0.0_f64.clamp(lower, upper), &bounds::POSITION)
        }
        _ => Ok(0.0),
    }
}

pub(super) fn axis(joint: &Joint) -> Result<UnitVector3<f64>, Defect> {
    let direction = all_within("axis xyz", joint.axis, &bounds::DIRECTION)?;
    UnitVector3::try_new(direction, 1e-9).ok_or(Defect::ZeroAxis)
}

/// The inertia in the link's frame; none where there is no `<inertial>`, or one of zeros.
pub(super) fn inertia(link: &UrdfLink) -> Result<Inertia, Defect> {
    let Some(record) = &link.inertial else { return Ok(Inertia::ZERO) };
    let [ixx, ixy, ixz, iyy, iyz, izz] = record.moments;
    for (key, moment) in [("ixx", ixx), ("ixy", ixy), ("ixz", ixz), ("iyy", iyy), ("iyz", iyz), ("izz", izz)]
    {
        within(&format!("inertia {key}"), moment, &bounds::MOMENT_KG_M2)?;
    }
    let mass = bounds::mass("mass", record.mass)?;
    let about_com = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    if mass == 0.0 && about_com == Matrix3::zeros() {
        return Ok(Inertia::ZERO);
    }
    Ok(Inertia { mass, com: Vector3::zeros(), about_com }.in_frame(&pose(&record.origin)?))
}

pub(super) fn friction(joint: &Joint) -> Result<Friction, Defect> {
    Ok(Friction {
        viscous: within("dynamics damping", joint.dynamics.damping, &bounds::FRICTION)?,
        coulomb: within("dynamics friction", joint.dynamics.friction, &bounds::FRICTION)?,
    })
}

/// Whether a turning joint has position limits that no joint comes to, as some write it for one that turns without end.
pub(super) fn is_endless(joint: &Joint) -> bool {
    let beyond =
        |end: Option<f64>| end.is_some_and(|end| end.is_finite() && end.abs() > bounds::POSITION_RAD_OR_M);
    joint.kind == JointType::Revolute
        && joint
            .limit
            .is_some_and(|limit| beyond(limit.lower) && beyond(limit.upper) && limit.lower < limit.upper)
}

/// The limits of a joint that moves; without `<limit>`, or with one of zeros as exporters write it for joints that turn
/// without end, the greatest that any joint has. Limits beyond those are none; `note` is told.
pub(super) fn limits(
    joint: &Joint,
    kind: JointKind,
    note: &mut dyn FnMut(String),
) -> Result<JointLimits, Defect> {
    let zero = |value: Option<f64>| value.unwrap_or(0.0) == 0.0;
    let stated = joint
        .limit
        .filter(|limit| ![limit.lower, limit.upper, limit.velocity, limit.effort].into_iter().all(zero));
    let Some(limit) = stated else {
        return Ok(JointLimits {
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            velocity: *bounds::VELOCITY.end(),
            effort: *bounds::EFFORT.end(),
        });
    };
    let beyond = |key: &str, value: f64, greatest: f64| {
        let (value, end) = (number(value), number(greatest));
        format!("joint \"{}\": {key} {value} is taken as no limit: more than {end} has no joint", joint.name)
    };
    let mut position = |key, value: Option<f64>, end: f64| match value.unwrap_or(0.0) {
        _ if kind == JointKind::Continuous => Ok(end),
        value if value == end => Ok(end),
        value
            if value.is_finite()
                && value.abs() > bounds::POSITION_RAD_OR_M
                && value.signum() == end.signum() =>
        {
            note(beyond(key, value, bounds::POSITION_RAD_OR_M));
            Ok(value.signum() * bounds::POSITION_RAD_OR_M)
        }
        value => within(key, value, &bounds::POSITION),
    };
    let needed = |attribute, value: Option<f64>| value.ok_or(Defect::MissingLimit { attribute });
    let lower = position("limit lower", limit.lower, f64::NEG_INFINITY)?;
    let upper = position("limit upper", limit.upper, f64::INFINITY)?;
    if kind == JointKind::Continuous && is_endless(joint) {
        note(format!(
            "joint \"{}\": position limits of {} are taken as none: it turns without end",
            joint.name,
            number(limit.upper.unwrap_or(0.0))
        ));
    }
    let mut greatest = |key, value: f64, allowed: &RangeInclusive<f64>| match value {
        f64::INFINITY => Ok(*allowed.end()),
        0.0 => Ok(0.0), // refused where all limits are checked
        value if value.is_finite() && value > *allowed.end() => {
            note(beyond(key, value, *allowed.end()));
            Ok(*allowed.end())
        }
        value => within(key, value, allowed),
    };
    let velocity = greatest("limit velocity", needed("velocity", limit.velocity)?, &bounds::VELOCITY)?;
    let effort = greatest("limit effort", needed("effort", limit.effort)?, &bounds::EFFORT)?;
    if lower >= upper {
        // One end may be missing and is zero; here that would leave no range.
        needed("lower", limit.lower)?;
        needed("upper", limit.upper)?;
    }
    Ok(JointLimits { lower, upper, velocity, effort })
}

#[cfg(test)]
mod tests {
    use super::super::document::read;
    use super::*;

    fn of(version: &str, kind: &str, inner: &str) -> Joint {
        let text = format!(
            "<robot version='{version}'><joint name='j' type='{kind}'><parent link='a'/><child link='b'/>{inner}\
             </joint></robot>"
        );
        read(&text).unwrap().joints.remove(0)
    }

    #[test]
    fn quaternions_turn_as_angles_do() {
        let turned = |inner: &str| pose(&of("1.1", "fixed", inner).origin);
        // Half a right angle of yaw, of length two; near the pole of pitch.
        for (quat, rpy) in [
            ("0 0 0.7653668647301796 1.8477590650225735", "0 0 0.7853981633974483"),
            ("0.1 0.7 -0.1 0.7", "0.2837941092083279 1.5707963267948966 0"),
        ] {
            let by_quaternion = turned(&format!("<origin xyz='1 2 3' quat_xyzw='{quat}'/>")).unwrap();
            let by_angles = turned(&format!("<origin xyz='1 2 3' rpy='{rpy}'/>")).unwrap();
            assert!(by_quaternion.rotation.angle_to(&by_angles.rotation) < 1e-7, "{quat}");
            assert_eq!(by_quaternion.translation, by_angles.translation);
        }
        for quat in ["nan 0 0 1", "0 0 inf 1", "0 1e9 0 1", "0 0 0 0", "0 1e-12 0 0"] {
            let problem = turned(&format!("<origin quat_xyzw='{quat}'/>")).unwrap_err();
            assert!(
                matches!(problem, Defect::OutOfRange { ref what, .. } if what.contains("quat_xyzw")),
                "{problem}"
            );
        }
    }

    #[test]
    fn limits_by_version() {
        let of = |version, inner: &str| {
            limits(&of(version, "revolute", inner), JointKind::Revolute, &mut |note| panic!("{note}"))
        };
        let some = of("1.0", "<limit upper='1' velocity='2' effort='3'/>").unwrap();
        assert_eq!((some.lower, some.upper, some.velocity, some.effort), (0.0, 1.0, 2.0, 3.0));
        let greatest = of("1.0", "").unwrap();
        assert_eq!((greatest.velocity, greatest.effort), (*bounds::VELOCITY.end(), *bounds::EFFORT.end()));
        assert_eq!(of("1.2", "<limit/>").unwrap(), greatest);
        // As exporters write it for joints that turn without end.
        assert_eq!(of("1.0", "<limit velocity='0' effort='0'/>").unwrap(), greatest);
        for (inner, attribute) in [
            ("<limit lower='0' velocity='2' effort='3'/>", "upper"),
            ("<limit upper='-1' velocity='2' effort='3'/>", "lower"),
            ("<limit lower='0' upper='1' velocity='2'/>", "effort"),
        ] {
            assert_eq!(of("1.0", inner).unwrap_err(), Defect::MissingLimit { attribute });
        }
    }
}
