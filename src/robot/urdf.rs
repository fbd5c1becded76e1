//! Serial chains from URDF files: the path from a base link to a tip link; everything else is fixed to it.
//!
//! Links behind fixed joints, on the path or beside it, become part of the moving link that carries them, with mass
//! and inertia. Visual and collision elements, and the meshes that they name, are ignored.

mod document;
mod prolog;
mod schema;
mod size;
mod syntax;
mod tags;
mod values;

use self::document::{Joint, JointType, UrdfDocument, UrdfLink};
use self::syntax::XmlFault;
use self::values::{axis, friction, held_at_rest, inertia, limits, place_at, pose};
use super::description::{JointDescription, RobotDescription};
use super::error::{Defect, RobotError};
use super::inertia::Inertia;
use super::model::JointKind;
use crate::geometry::Pose;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Which part of a URDF is the arm.
#[derive(Debug, Default)]
pub(super) struct ChainSelection {
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
    selection: &ChainSelection,
    description: &mut RobotDescription,
) -> Result<(), RobotError> {
    let robot = document::read(text).map_err(|XmlFault { line, message }| RobotError::Syntax {
        place: format!("{}:{line}", description.file),
        message,
    })?;
    if robot.links.is_empty() {
        let message = "there is no <link> in it; is it a URDF robot?".to_owned();
        return Err(RobotError::Syntax { place: description.file.clone(), message });
    }
    let fail = |(element, problem): ElementDefect| description.error(element, problem);
    let tree = Tree::new(&robot, selection).map_err(fail)?;
    let (joints, X_LE) = tree.chain().map_err(fail)?;
    description.joints = joints;
    description.X_LE = X_LE;
    Ok(())
}

/// An element and what is wrong with it.
type ElementDefect = (String, Defect);

fn link_element(name: &str) -> String {
    format!("link \"{name}\"")
}

fn joint_element(name: &str) -> String {
    format!("joint \"{name}\"")
}

struct Tree<'a> {
    links: HashMap<&'a str, &'a UrdfLink>,
    /// The joint that leads to a link.
    joint_to: HashMap<&'a str, &'a Joint>,
    /// The joints that leave a link, in the file's order.
    joints_from: HashMap<&'a str, Vec<&'a Joint>>,
    held: &'a BTreeMap<String, f64>,
    base: &'a str,
    tip: &'a str,
}

impl<'a> Tree<'a> {
    fn new(robot: &'a UrdfDocument, selection: &'a ChainSelection) -> Result<Self, ElementDefect> {
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
            let (parent, child) = (joint.parent.as_str(), joint.child.as_str());
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

    fn existing(&self, key: &str, name: &'a str) -> Result<&'a str, ElementDefect> {
        match self.links.get(name) {
            Some(link) => Ok(&link.name),
            None => Err((key.to_owned(), Defect::NoSuchLink { link: name.to_owned() })),
        }
    }

    /// A link that no root leads to: with one parent each, it can only be in a loop, or behind one.
    fn in_a_loop(&self, robot: &'a UrdfDocument) -> Option<&'a UrdfLink> {
        let names = robot.links.iter().map(|link| link.name.as_str());
        let mut waiting: Vec<&str> = names.filter(|name| !self.joint_to.contains_key(name)).collect();
        let mut reached: HashSet<&str> = waiting.iter().copied().collect();
        while let Some(link) = waiting.pop() {
            let children = self.joints_from.get(link).into_iter().flatten().map(|j| j.child.as_str());
            waiting.extend(children.filter(|child| reached.insert(child)));
        }
        robot.links.iter().find(|link| !reached.contains(link.name.as_str()))
    }

    /// The joints from `link` towards the root; endless in a loop.
    fn path_to(&self, link: &'a str) -> impl Iterator<Item = &'a Joint> {
        let limit = self.joint_to.len() + 1;
        std::iter::successors(self.joint_to.get(link).copied(), |joint| {
            self.joint_to.get(joint.parent.as_str()).copied()
        })
        .take(limit)
    }

    fn only_root(&self, robot: &'a UrdfDocument) -> Result<&'a str, ElementDefect> {
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

    fn only_leaf(&self, robot: &'a UrdfDocument) -> Result<&'a str, ElementDefect> {
        let leaves: Vec<_> = robot
            .links
            .iter()
            .map(|link| link.name.as_str())
            .filter(|&name| !self.joints_from.contains_key(name))
            .filter(|&name| name == self.base || self.path_to(name).any(|j| j.parent == self.base))
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
        let kind = match &joint.kind {
            JointType::Fixed => return Ok(None),
            JointType::Revolute => JointKind::Revolute,
            JointType::Continuous => JointKind::Continuous,
            JointType::Prismatic => JointKind::Prismatic,
            JointType::Other(kind) => return Err(Defect::JointType { kind: kind.clone() }),
        };
        if joint.mimics { Err(Defect::Mimic) } else { Ok(Some(kind)) }
    }

    /// The child link's frame in the parent link's, at position zero, or where the joint is held.
    fn place(&self, joint: &Joint) -> Result<Pose, Defect> {
        match self.held.get(&joint.name) {
            Some(&position) => place_at(joint, position),
            None => pose(&joint.origin),
        }
    }

    /// The moving joints from base to tip, and the tip in the last moving link's frame.
    fn chain(&self) -> Result<(Vec<JointDescription>, Pose), ElementDefect> {
        let mut path: Vec<&Joint> = Vec::new();
        if self.tip != self.base {
            for joint in self.path_to(self.tip) {
                path.push(joint);
                if joint.parent == self.base {
                    break;
                }
            }
        }
        if path.last().is_some_and(|joint| joint.parent != self.base) || path.is_empty() {
            let problem = Defect::NotAChain { base: self.base.to_owned(), tip: self.tip.to_owned() };
            return Err(("tip".to_owned(), problem));
        }
        path.reverse();

        // Links on the base that are fixed to it, or that move beside the arm, do not take part in the arm's motion.
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
            let link = joint.child.as_str();
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
                limits: limits(joint, kind).map_err(fault)?,
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
    fn weld(&self, link: &str, X: &Pose, path: &[&Joint]) -> Result<Inertia, ElementDefect> {
        self.weld_from(link, X, path, link == self.tip)
    }

    fn weld_from(
        &self,
        link: &str,
        X: &Pose,
        path: &[&Joint],
        behind_tip: bool,
    ) -> Result<Inertia, ElementDefect> {
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
            let child = joint.child.as_str();
            sum = sum.plus(&self.weld_from(child, &X, path, behind_tip || child == self.tip)?);
        }
        Ok(sum)
    }
}
