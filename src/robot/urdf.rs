//! Serial chains out of URDF files: the path from a base link to a tip link, everything else welded on.
//!
//! Links behind fixed joints, on the path or beside it, become part of the moving link that carries them, with mass
//! and inertia. Visual and collision elements, and the meshes they name, are not looked at.

use super::bounds::{self, all_within, within};
use super::description::{JointDescription, RobotDescription};
use super::error::{Defect, RobotError};
use super::inertia::Inertia;
use super::model::{Friction, JointKind, JointLimits};
use super::xml_fault::{XmlFault, lacks, locate};
use super::xml_size::excess;
use crate::geometry::Pose;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, UnitVector3, Vector3};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::RangeInclusive;
use urdf_rs::{Joint, JointLimit, JointType, Link};

/// Which part of a URDF is the arm.
#[derive(Debug, Default)]
pub(super) struct Selection {
    /// The base link; the tree's root when not named.
    pub(super) base: Option<String>,
    /// The tip link; the only leaf when not named.
    pub(super) tip: Option<String>,
    /// Joints held at a position (rad or m), as if they were of type fixed.
    pub(super) held: BTreeMap<String, f64>,
}

/// Appends the chain in the URDF `text` to `description`, and sets its flange.
pub(super) fn read(
    text: &str,
    selection: &Selection,
    description: &mut RobotDescription,
) -> Result<(), RobotError> {
    let syntax = |XmlFault { line, message }, file: &str| RobotError::Syntax {
        place: format!("{file}:{line}"),
        message,
    };
    if let Some(fault) = excess(text) {
        return Err(syntax(fault, &description.file));
    }
    let robot = urdf_rs::read_from_string(text)
        .map_err(|error| syntax(locate(text, &error.to_string()), &description.file))?;
    if robot.links.is_empty() {
        let message = "there is no <link> in it; is it a URDF robot?".to_owned();
        return Err(RobotError::Syntax { place: description.file.clone(), message });
    }
    let fail = |(element, problem): Fault| description.error(element, problem);
    let tree = Tree::new(&robot, selection).map_err(fail)?;
    let (joints, X_LE) = tree.chain().map_err(fail)?;
    for joint in &joints {
        missing_limit(text, joint).map_err(|problem| fail((joint_element(&joint.name), problem)))?;
    }
    description.joints = joints;
    description.X_LE = X_LE;
    Ok(())
}

/// An element and what is wrong with it.
type Fault = (String, Defect);

fn link_element(name: &str) -> String {
    format!("link \"{name}\"")
}

fn joint_element(name: &str) -> String {
    format!("joint \"{name}\"")
}

struct Tree<'a> {
    links: HashMap<&'a str, &'a Link>,
    /// The joint that leads to a link.
    joint_to: HashMap<&'a str, &'a Joint>,
    /// The joints that leave a link, in the file's order.
    joints_from: HashMap<&'a str, Vec<&'a Joint>>,
    held: &'a BTreeMap<String, f64>,
    base: &'a str,
    tip: &'a str,
}

impl<'a> Tree<'a> {
    fn new(robot: &'a urdf_rs::Robot, selection: &'a Selection) -> Result<Self, Fault> {
        let mut links = HashMap::new();
        for link in &robot.links {
            if links.insert(link.name.as_str(), link).is_some() {
                return Err((link_element(&link.name), Defect::DuplicateName));
            }
        }
        let mut names = HashMap::new();
        let (mut joint_to, mut joints_from) = (HashMap::new(), HashMap::<_, Vec<_>>::new());
        for joint in &robot.joints {
            let fault = |problem| Err((joint_element(&joint.name), problem));
            if names.insert(joint.name.as_str(), ()).is_some() {
                return fault(Defect::DuplicateName);
            }
            let (parent, child) = (joint.parent.link.as_str(), joint.child.link.as_str());
            for link in [parent, child] {
                if !links.contains_key(link) {
                    return fault(Defect::NoSuchLink { link: link.to_owned() });
                }
            }
            if joint_to.insert(child, joint).is_some() {
                return fault(Defect::Loop { link: child.to_owned() });
            }
            joints_from.entry(parent).or_default().push(joint);
        }
        for name in selection.held.keys() {
            if !names.contains_key(name.as_str()) {
                let known = robot.joints.iter().map(|j| j.name.as_str()).collect::<Vec<_>>().join(", ");
                let problem = Defect::NoSuchJoint { joint: name.clone(), known };
                return Err(("fixed_joints".to_owned(), problem));
            }
        }
        let mut tree = Self { links, joint_to, joints_from, held: &selection.held, base: "", tip: "" };
        if let Some(link) = tree.in_a_loop(robot) {
            return Err((link_element(&link.name), Defect::Loop { link: link.name.clone() }));
        }
        tree.base = match &selection.base {
            Some(name) => tree.existing("base", name)?,
            None => tree.only_root(robot)?,
        };
        tree.tip = match &selection.tip {
            Some(name) => tree.existing("tip", name)?,
            None => tree.only_leaf(robot)?,
        };
        Ok(tree)
    }

    fn existing(&self, key: &str, name: &'a str) -> Result<&'a str, Fault> {
        match self.links.get(name) {
            Some(link) => Ok(&link.name),
            None => Err((key.to_owned(), Defect::NoSuchLink { link: name.to_owned() })),
        }
    }

    /// A link that no root leads to: with one parent each, it can only be in a loop, or behind one.
    fn in_a_loop(&self, robot: &'a urdf_rs::Robot) -> Option<&'a Link> {
        let names = robot.links.iter().map(|link| link.name.as_str());
        let mut waiting: Vec<&str> = names.filter(|name| !self.joint_to.contains_key(name)).collect();
        let mut reached: HashSet<&str> = waiting.iter().copied().collect();
        while let Some(link) = waiting.pop() {
            let children = self.joints_from.get(link).into_iter().flatten().map(|j| j.child.link.as_str());
            waiting.extend(children.filter(|child| reached.insert(child)));
        }
        robot.links.iter().find(|link| !reached.contains(link.name.as_str()))
    }

    /// The joints from `link` towards the root; endless in a loop.
    fn path_to(&self, link: &'a str) -> impl Iterator<Item = &'a Joint> {
        let limit = self.joint_to.len() + 1;
        std::iter::successors(self.joint_to.get(link).copied(), |joint| {
            self.joint_to.get(joint.parent.link.as_str()).copied()
        })
        .take(limit)
    }

    fn only_root(&self, robot: &'a urdf_rs::Robot) -> Result<&'a str, Fault> {
        let roots: Vec<_> = robot
            .links
            .iter()
            .map(|l| l.name.as_str())
            .filter(|name| !self.joint_to.contains_key(name))
            .collect();
        match roots[..] {
            [root] => Ok(root),
            _ => Err(("robot".to_owned(), Defect::Roots { found: roots.len(), links: roots.join(", ") })),
        }
    }

    fn only_leaf(&self, robot: &'a urdf_rs::Robot) -> Result<&'a str, Fault> {
        let leaves: Vec<_> = robot
            .links
            .iter()
            .map(|link| link.name.as_str())
            .filter(|&name| !self.joints_from.contains_key(name))
            .filter(|&name| name == self.base || self.path_to(name).any(|j| j.parent.link == self.base))
            .collect();
        match leaves[..] {
            [leaf] => Ok(leaf),
            _ => Err(("tip".to_owned(), Defect::UnnamedBranch { tips: leaves.join(", ") })),
        }
    }

    /// What a joint does, `None` for one that is fixed or held.
    fn kind(&self, joint: &Joint) -> Result<Option<JointKind>, Defect> {
        if self.held.contains_key(&joint.name) {
            return Ok(None);
        }
        let kind = match joint.joint_type {
            JointType::Fixed => return Ok(None),
            JointType::Revolute => JointKind::Revolute,
            JointType::Continuous => JointKind::Continuous,
            JointType::Prismatic => JointKind::Prismatic,
            ref other => return Err(Defect::JointType { kind: format!("{other:?}").to_lowercase() }),
        };
        if joint.mimic.is_some() { Err(Defect::Mimic) } else { Ok(Some(kind)) }
    }

    /// The child link's frame in the parent link's, at position zero, or where the joint is held.
    fn place(&self, joint: &Joint) -> Result<Pose, Defect> {
        match self.held.get(&joint.name) {
            Some(&position) => Self::place_at(joint, position),
            None => pose(&joint.origin),
        }
    }

    /// That frame with the joint at `position`, rad or m.
    fn place_at(joint: &Joint, position: f64) -> Result<Pose, Defect> {
        let X = pose(&joint.origin)?;
        let motion = match joint.joint_type {
            JointType::Revolute | JointType::Continuous => Pose::from_parts(
                Translation3::identity(),
                UnitQuaternion::from_axis_angle(&axis(joint)?, position),
            ),
            JointType::Prismatic => Pose::from_parts(
                Translation3::from(axis(joint)?.into_inner() * position),
                UnitQuaternion::identity(),
            ),
            JointType::Fixed => Pose::identity(),
            ref other => return Err(Defect::JointType { kind: format!("{other:?}").to_lowercase() }),
        };
        Ok(X * motion)
    }

    /// The moving joints from base to tip, and the tip in the last moving link's frame.
    fn chain(&self) -> Result<(Vec<JointDescription>, Pose), Fault> {
        let mut path: Vec<&Joint> = Vec::new();
        if self.tip != self.base {
            for joint in self.path_to(self.tip) {
                path.push(joint);
                if joint.parent.link == self.base {
                    break;
                }
            }
        }
        if path.last().is_some_and(|joint| joint.parent.link != self.base) || path.is_empty() {
            let problem = Defect::NotAChain { base: self.base.to_owned(), tip: self.tip.to_owned() };
            return Err(("tip".to_owned(), problem));
        }
        path.reverse();

        // What hangs on the base, welded to it or moving beside the arm, has no part in the arm's motion.
        let mut joints = Vec::new();
        let mut X_before = Pose::identity();
        for joint in &path {
            let fault = |problem| (joint_element(&joint.name), problem);
            let X = X_before * self.place(joint).map_err(fault)?;
            let Some(kind) = self.kind(joint).map_err(fault)? else {
                X_before = X;
                continue;
            };
            X_before = Pose::identity();
            let link = joint.child.link.as_str();
            let inertia = self.weld(link, &Pose::identity(), &path)?;
            if inertia == Inertia::ZERO {
                return Err((link_element(link), Defect::MissingInertia));
            }
            joints.push(JointDescription {
                name: joint.name.clone(),
                link: link.to_owned(),
                kind,
                X_PJ: X,
                axis: axis(joint).map_err(fault)?,
                X_JL: Pose::identity(),
                limits: limits(&joint.limit, kind).map_err(fault)?,
                friction: friction(joint).map_err(fault)?,
                motor: None,
                armature: 0.0,
                inertia,
                idealised: false,
            });
        }
        Ok((joints, X_before))
    }

    /// The inertia of `link` and of all that is fixed to it, in the frame in which `link` lies at `X`. What hangs on the
    /// tip, a gripper, counts as fixed: its joints are held.
    fn weld(&self, link: &str, X: &Pose, path: &[&Joint]) -> Result<Inertia, Fault> {
        self.weld_from(link, X, path, link == self.tip)
    }

    fn weld_from(&self, link: &str, X: &Pose, path: &[&Joint], behind_tip: bool) -> Result<Inertia, Fault> {
        let mut sum = Inertia::ZERO;
        if let Some(link) = self.links.get(link) {
            let own = inertia(link).and_then(|own| own.check_part().map(|()| own));
            sum = own.map_err(|problem| (link_element(&link.name), problem))?.in_frame(X);
        }
        for joint in self.joints_from.get(link).into_iter().flatten() {
            let fault = |problem| (joint_element(&joint.name), problem);
            let place = match self.kind(joint) {
                Ok(None) => self.place(joint),
                _ if behind_tip => held_at_rest(joint),
                Ok(Some(_)) if path.iter().any(|other| std::ptr::eq(*other, *joint)) => continue,
                Ok(Some(_)) => Err(Defect::MovesBesideChain),
                Err(problem) => Err(problem),
            };
            let X = X * place.map_err(fault)?;
            let child = joint.child.link.as_str();
            sum = sum.plus(&self.weld_from(child, &X, path, behind_tip || child == self.tip)?);
        }
        Ok(sum)
    }
}

/// The place of a joint behind the tip that nobody named: at zero, or at the end of its range that is nearest to it.
fn held_at_rest(joint: &Joint) -> Result<Pose, Defect> {
    let JointLimit { lower, upper, .. } = joint.limit;
    match joint.joint_type {
        JointType::Revolute | JointType::Prismatic if lower <= upper => {
            Tree::place_at(joint, within("limit", 0.0_f64.clamp(lower, upper), &bounds::POSITION)?)
        }
        _ => pose(&joint.origin),
    }
}

fn pose(origin: &urdf_rs::Pose) -> Result<Pose, Defect> {
    let xyz = all_within("origin xyz", origin.xyz.0, &bounds::LENGTH_M)?;
    let rpy = all_within("origin rpy", origin.rpy.0, &bounds::ANGLE_RAD)?;
    Ok(Pose::from_parts(Translation3::from(xyz), UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z)))
}

fn axis(joint: &Joint) -> Result<UnitVector3<f64>, Defect> {
    let direction = all_within("axis xyz", joint.axis.xyz.0, &bounds::DIRECTION)?;
    UnitVector3::try_new(direction, 1e-9).ok_or(Defect::ZeroAxis)
}

/// The inertia in the link's frame; a link without `<inertial>` reads as all zeros.
fn inertia(link: &Link) -> Result<Inertia, Defect> {
    let record = &link.inertial;
    let urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = record.inertia;
    for (key, moment) in [("ixx", ixx), ("ixy", ixy), ("ixz", ixz), ("iyy", iyy), ("iyz", iyz), ("izz", izz)]
    {
        within(&format!("inertia {key}"), moment, &bounds::MOMENT_KG_M2)?;
    }
    let mass = bounds::mass("mass", record.mass.value)?;
    let about_com = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    if mass == 0.0 && about_com == Matrix3::zeros() {
        return Ok(Inertia::ZERO);
    }
    Ok(Inertia { mass, com: Vector3::zeros(), about_com }.in_frame(&pose(&record.origin)?))
}

fn friction(joint: &Joint) -> Result<Friction, Defect> {
    let Some(dynamics) = &joint.dynamics else { return Ok(Friction::default()) };
    Ok(Friction {
        viscous: within("dynamics damping", dynamics.damping, &bounds::FRICTION)?,
        coulomb: within("dynamics friction", dynamics.friction, &bounds::FRICTION)?,
    })
}

fn limits(limit: &JointLimit, kind: JointKind) -> Result<JointLimits, Defect> {
    // A joint without <limit> reads as all zeros.
    let missing = *limit == JointLimit::default();
    let endless = missing || kind == JointKind::Continuous;
    let position = |key, value: f64, end: f64| {
        // From version 1.2 on an attribute that is missing is infinite.
        if endless || value == end { Ok(end) } else { within(key, value, &bounds::POSITION) }
    };
    // Where there is no limit, the greatest that any joint has.
    let greatest = |key, value: f64, allowed: &RangeInclusive<f64>| match value {
        _ if missing => Ok(*allowed.end()),
        f64::INFINITY => Ok(*allowed.end()),
        0.0 => Ok(0.0), // missing, or wrong: told apart behind
        value => within(key, value, allowed),
    };
    Ok(JointLimits {
        lower: position("limit lower", limit.lower, f64::NEG_INFINITY)?,
        upper: position("limit upper", limit.upper, f64::INFINITY)?,
        velocity: greatest("limit velocity", limit.velocity, &bounds::VELOCITY)?,
        effort: greatest("limit effort", limit.effort, &bounds::EFFORT)?,
    })
}

/// Attributes of `<limit>` that are missing read as zero: an effort of zero and a range without width may come from there.
fn missing_limit(text: &str, joint: &JointDescription) -> Result<(), Defect> {
    let JointLimits { lower, upper, effort, .. } = joint.limits;
    let suspects: &[&str] = match () {
        () if effort == 0.0 => &["effort"],
        () if lower >= upper => &["lower", "upper"],
        () => &[],
    };
    let element = joint_element(&joint.name);
    match suspects.iter().find(|attribute| lacks(text, &element, "limit", attribute)) {
        Some(attribute) => Err(Defect::MissingLimit { attribute }),
        None => Ok(()),
    }
}
