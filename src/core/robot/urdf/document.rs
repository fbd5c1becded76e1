//! The content of a URDF as it is written: links and joints with their numbers, not yet connected and not yet checked.
//!
//! ```text
//! text ─ prolog ─► size ─► roxmltree ─► schema ─► Document      syntax: what is not XML, in words
//! ```
//!
//! Only what the format defines is read; other elements and attributes, such as those of simulators, are ignored. As in the format, the
//! version in `<robot>` decides: `quat_xyzw` is read from version 1.1 on, and from 1.2 on a missing limit means that
//! there is no limit.

use super::prolog::without_prolog;
use super::schema::{self, V1_0, V1_1, V1_2, Version, child, parts};
use super::size::excess;
use super::syntax::{XmlFault, explain, label};
use roxmltree::Node;

/// The links and joints of a URDF, in the file's order.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct UrdfDocument {
    pub(super) links: Vec<UrdfLink>,
    pub(super) joints: Vec<Joint>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct UrdfLink {
    pub(super) name: String,
    pub(super) inertial: Option<Inertial>,
}

/// Mass and moments of a link, about the origin of a frame of its own.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inertial {
    pub(super) origin: Origin,
    /// kg.
    pub(super) mass: f64,
    /// ixx, ixy, ixz, iyy, iyz, izz, kg m^2.
    pub(super) moments: [f64; 6],
}

/// Where a frame stands in another one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Origin {
    /// m.
    pub(super) xyz: [f64; 3],
    /// Roll, pitch and yaw about fixed axes, rad.
    pub(super) rpy: [f64; 3],
    /// A quaternion of any length in place of the angles (version 1.1).
    pub(super) quat_xyzw: Option<[f64; 4]>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Joint {
    pub(super) name: String,
    pub(super) kind: JointType,
    pub(super) origin: Origin,
    /// The parent link.
    pub(super) parent: String,
    /// The child link.
    pub(super) child: String,
    /// Of any length, in the joint's frame.
    pub(super) axis: [f64; 3],
    pub(super) limit: Option<UrdfLimit>,
    pub(super) dynamics: Dynamics,
    /// Whose motion it copies, and how.
    pub(super) mimic: Option<Mimic>,
}

/// `position = multiplier * position of joint + offset`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mimic {
    pub(super) joint: String,
    pub(super) multiplier: f64,
    /// rad or m.
    pub(super) offset: f64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum JointType {
    Revolute,
    Continuous,
    Prismatic,
    Fixed,
    /// A type with several degrees of freedom.
    Other(String),
}

/// What `<limit>` states, rad or m, rad/s or m/s, N m or N. From version 1.2 on what is missing is infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UrdfLimit {
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) velocity: Option<f64>,
    pub(super) effort: Option<f64>,
}

/// Friction, zero where it is not given.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Dynamics {
    /// N m s/rad or N s/m.
    pub(super) damping: f64,
    /// N m or N.
    pub(super) friction: f64,
}

/// The axis of a joint that names none.
const DEFAULT_AXIS: [f64; 3] = [1.0, 0.0, 0.0];

/// Reads the URDF `text`.
///
/// # Errors
/// The first thing that is too large, not XML, or not as the format wants it, with its line.
pub(super) fn read(text: &str) -> Result<UrdfDocument, XmlFault> {
    let text = without_prolog(text);
    if let Some(fault) = excess(&text) {
        return Err(fault);
    }
    let xml = roxmltree::Document::parse(&text).map_err(|error| explain(&text, &error))?;
    let fault =
        |node: Node, message| XmlFault { line: xml.text_pos_at(node.range().start).row as usize, message };
    let root = xml.root_element();
    if root.tag_name().name() != "robot" {
        let message =
            format!("the root element is `<{}>`; a URDF has one, `<robot>`", root.tag_name().name());
        return Err(fault(root, message));
    }
    let version = root.attribute("version").and_then(version_of).unwrap_or(V1_0);
    let mut document = UrdfDocument::default();
    for part in parts(root) {
        let tell = |(node, reason): (Node, String)| fault(node, format!("{}: {reason}", label(part)));
        let unread = || tell((part, "it cannot be read".to_owned()));
        match part.tag_name().name() {
            "link" => {
                schema::check(part, version).map_err(tell)?;
                document.links.push(link(part, version).ok_or_else(unread)?);
            }
            "joint" => {
                schema::check(part, version).map_err(tell)?;
                document.joints.push(joint(part, version).ok_or_else(unread)?);
            }
            "material" => schema::check(part, version).map_err(tell)?,
            _ => {}
        }
    }
    Ok(document)
}

fn version_of(text: &str) -> Option<Version> {
    let (major, minor) = text.trim().split_once('.')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}

// After the schema's check these functions find what they need; where the schema lets something through by mistake they return `None`.

fn link(node: Node, version: Version) -> Option<UrdfLink> {
    let inertial = match child(node, "inertial") {
        Some(inertial_node) => Some(inertial(inertial_node, version)?),
        None => None,
    };
    Some(UrdfLink { name: node.attribute("name")?.to_owned(), inertial })
}

fn inertial(node: Node, version: Version) -> Option<Inertial> {
    let record = child(node, "inertia")?;
    let mut moments = [0.0; 6];
    for (moment, key) in moments.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
        *moment = number(record, key)?;
    }
    Some(Inertial { origin: origin(node, version), mass: number(child(node, "mass")?, "value")?, moments })
}

fn joint(node: Node, version: Version) -> Option<Joint> {
    let link_of = |name| Some(child(node, name)?.attribute("link")?.to_owned());
    Some(Joint {
        name: node.attribute("name")?.to_owned(),
        kind: match node.attribute("type")? {
            "revolute" => JointType::Revolute,
            "continuous" => JointType::Continuous,
            "prismatic" => JointType::Prismatic,
            "fixed" => JointType::Fixed,
            other => JointType::Other(other.to_owned()),
        },
        origin: origin(node, version),
        parent: link_of("parent")?,
        child: link_of("child")?,
        axis: match child(node, "axis") {
            Some(axis) => numbers(axis, "xyz")?,
            None => DEFAULT_AXIS,
        },
        limit: child(node, "limit").map(|limit| limit_of(limit, version)),
        dynamics: child(node, "dynamics").map_or_else(Dynamics::default, |dynamics| Dynamics {
            damping: number(dynamics, "damping").unwrap_or(0.0),
            friction: number(dynamics, "friction").unwrap_or(0.0),
        }),
        mimic: match child(node, "mimic") {
            Some(mimic) => Some(Mimic {
                joint: mimic.attribute("joint")?.to_owned(),
                multiplier: number(mimic, "multiplier").unwrap_or(1.0),
                offset: number(mimic, "offset").unwrap_or(0.0),
            }),
            None => None,
        },
    })
}

/// The `<origin>` that `node` holds; without one the frames agree.
fn origin(node: Node, version: Version) -> Origin {
    child(node, "origin").map_or_else(Origin::default, |origin| Origin {
        xyz: numbers(origin, "xyz").unwrap_or_default(),
        rpy: numbers(origin, "rpy").unwrap_or_default(),
        quat_xyzw: if version >= V1_1 { numbers(origin, "quat_xyzw") } else { None },
    })
}

fn limit_of(node: Node, version: Version) -> UrdfLimit {
    let given = |key, end| number(node, key).or(if version >= V1_2 { Some(end) } else { None });
    UrdfLimit {
        lower: given("lower", f64::NEG_INFINITY),
        upper: given("upper", f64::INFINITY),
        velocity: given("velocity", f64::INFINITY),
        effort: given("effort", f64::INFINITY),
    }
}

fn number(node: Node, attribute: &str) -> Option<f64> {
    numbers::<1>(node, attribute).map(|[number]| number)
}

fn numbers<const N: usize>(node: Node, attribute: &str) -> Option<[f64; N]> {
    schema::numbers(node.attribute(attribute)?)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(version: &str, joint: &str) -> Joint {
        let text = format!(
            "<robot {version}><link name='a'/><j:joint xmlns:j='j'/><transmission><joint name='j'/></transmission>\
             <joint name='j' type='planar'><parent link='a'/><child link='b'/>{joint}</joint></robot>"
        );
        let document = read(&text).unwrap();
        assert_eq!((document.links.len(), document.joints.len()), (1, 1));
        document.joints[0].clone()
    }

    #[test]
    fn what_is_missing() {
        let joint = of("", "");
        assert_eq!((joint.axis, joint.origin), ([1.0, 0.0, 0.0], Origin::default()));
        assert_eq!((joint.limit, joint.dynamics, joint.mimic), (None, Dynamics::default(), None));
        assert_eq!((joint.kind, joint.parent.as_str()), (JointType::Other("planar".to_owned()), "a"));
        let joint = of("", "<axis xyz=' 0\n1\t2e-1 '/><dynamics friction='2'/><mimic joint='j' offset='3'/>");
        let mimic = Mimic { joint: "j".to_owned(), multiplier: 1.0, offset: 3.0 };
        assert_eq!((joint.axis, joint.dynamics.friction, joint.mimic), ([0.0, 1.0, 0.2], 2.0, Some(mimic)));
    }

    #[test]
    fn versions() {
        let rest = "<limit lower='-2' velocity='3'/><origin quat_xyzw='1 2 3 4'/>";
        let infinite = UrdfLimit {
            lower: Some(-2.0),
            upper: Some(f64::INFINITY),
            velocity: Some(3.0),
            effort: Some(f64::INFINITY),
        };
        let missing = UrdfLimit { upper: None, effort: None, ..infinite };
        for (version, limit, quat) in [
            ("", missing, None),
            ("version='1'", missing, None),
            ("version='1.0'", missing, None),
            ("version='1.1'", missing, Some([1.0, 2.0, 3.0, 4.0])),
            ("version=' 1.2 '", infinite, Some([1.0, 2.0, 3.0, 4.0])),
            ("version='2.0'", infinite, Some([1.0, 2.0, 3.0, 4.0])),
        ] {
            let joint = of(version, rest);
            assert_eq!((joint.limit, joint.origin.quat_xyzw), (Some(limit), quat), "{version}");
        }
    }
}
