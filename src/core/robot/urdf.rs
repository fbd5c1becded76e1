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
use self::values::{axis, friction, inertia, is_endless, limits, place_at, rest_position};
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
    let tree = Tree::new(&robot, selection, &description.file).map_err(fail)?;
    let mut notes = Vec::new();
    let (joints, X_LE) = tree.chain(&mut |note| notes.push(note)).map_err(fail)?;
    description.joints = joints;
    description.notes = notes;
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
    joints: &'a [Joint],
    held: &'a BTreeMap<String, f64>,
    /// The file, for messages.
    file: &'a str,
    base: &'a str,
    tip: &'a str,
}

impl<'a> Tree<'a> {
    fn new(
        robot: &'a UrdfDocument,
        selection: &'a ChainSelection,
        file: &'a str,
    ) -> Result<Self, ElementDefect> {
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
        let (joints, held) = (robot.joints.as_slice(), &selection.held);
        let mut tree = Self { links, joint_to, joints_from, joints, held, file, base: "", tip: "" };
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

    /// The position at which a joint is held, rad or m: as the user says, or as a mimic of one that is; `None` for one that moves.
    fn held_position(&self, joint: &Joint) -> Option<f64> {
        self.mimicked(joint, &|source| self.held.get(&source.name).copied())
    }

    /// The position of a joint by that of the joint whose motion it copies in the end, which `of` knows. Mimics that copy each other have none.
    fn mimicked(&self, joint: &Joint, of: &dyn Fn(&Joint) -> Option<f64>) -> Option<f64> {
        let (mut joint, mut multiplier, mut offset) = (joint, 1.0, 0.0);
        for _ in 0..=self.joints.len() {
            if let Some(position) = of(joint) {
                return Some(multiplier * position + offset);
            }
            let mimic = joint.mimic.as_ref()?;
            offset += multiplier * mimic.offset;
            multiplier *= mimic.multiplier;
            joint = self.joints.iter().find(|other| other.name == mimic.joint)?;
        }
        None
    }

    /// Where a joint behind the tip stands that the user has not given: nearest to zero, and a mimic as the joint that it copies.
    fn rest(&self, joint: &Joint, path: &[&Joint]) -> Result<Pose, Defect> {
        let of = |source: &Joint| {
            let moves = path.iter().any(|other| std::ptr::eq(*other, source)) || source.mimic.is_some();
            let held = self.held.get(&source.name).copied();
            held.or_else(|| if moves { None } else { rest_position(source).ok() })
        };
        let position = self.mimicked(joint, &of);
        let joint_of =
            |joint: &Joint| joint.mimic.as_ref().map_or(String::new(), |mimic| mimic.joint.clone());
        let position = position.ok_or_else(|| Defect::Mimic { joint: joint_of(joint) });
        place_at(joint, if joint.mimic.is_some() { position? } else { rest_position(joint)? })
    }

    /// What a joint does, `None` for one that is fixed or held.
    fn kind(&self, joint: &Joint) -> Result<Option<JointKind>, Defect> {
        if self.held_position(joint).is_some() {
            return Ok(None);
        }
        let kind = match &joint.kind {
            JointType::Fixed => return Ok(None),
            JointType::Revolute if is_endless(joint) => JointKind::Continuous,
            JointType::Revolute => JointKind::Revolute,
            JointType::Continuous => JointKind::Continuous,
            JointType::Prismatic => JointKind::Prismatic,
            JointType::Other(kind) => return Err(Defect::JointType { kind: kind.clone() }),
        };
        match &joint.mimic {
            Some(mimic) => Err(Defect::Mimic { joint: mimic.joint.clone() }),
            None => Ok(Some(kind)),
        }
    }

    /// The child link's frame in the parent link's, at position zero, or where the joint is held.
    fn place(&self, joint: &Joint) -> Result<Pose, Defect> {
        place_at(joint, self.held_position(joint).unwrap_or(0.0))
    }

    /// The moving joints from base to tip, and the tip in the last moving link's frame.
    fn chain(&self, note: &mut dyn FnMut(String)) -> Result<(Vec<JointDescription>, Pose), ElementDefect> {
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
        self.refuse_joints_beside(&path)?;

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
                limits: limits(joint, kind, note).map_err(fault)?,
                friction: friction(joint).map_err(fault)?,
                motor: None,
                armature: 0.0,
                inertia,
                idealised: false,
            });
        }
        Ok((joints, X_before))
    }

    /// Refuses joints that move beside the chain, all at once, with the table that holds them: their links have no definite place.
    fn refuse_joints_beside(&self, path: &[&Joint]) -> Result<(), ElementDefect> {
        // The links that the arm moves, from its first moving joint on; what hangs on the tip is held.
        let first = path.iter().position(|joint| !matches!(self.kind(joint), Ok(None)));
        let moving = path.get(first.unwrap_or(path.len())..).unwrap_or_default();
        let (mut beside, mut branch) = (Vec::new(), None);
        for (i, joint) in moving.iter().enumerate().filter(|(_, joint)| joint.child != self.tip) {
            let mut waiting = vec![joint.child.as_str()];
            while let Some(link) = waiting.pop() {
                for next in self.joints_from.get(link).into_iter().flatten() {
                    if path.iter().any(|other| std::ptr::eq(*other, *next)) {
                        continue;
                    }
                    // What mimics a joint beside the chain is held with it.
                    let mimics_beside = next
                        .mimic
                        .as_ref()
                        .is_some_and(|mimic| !path.iter().any(|other| other.name == mimic.joint));
                    if matches!(self.kind(next), Ok(Some(_))) {
                        beside.push(next.name.as_str());
                        branch = Some(i);
                    } else if self.kind(next).is_err() && !mimics_beside {
                        continue;
                    }
                    waiting.push(&next.child);
                }
            }
        }
        let Some(branch) = branch else { return Ok(()) };
        let held: Vec<_> = beside.iter().map(|name| format!("\"{name}\" = 0.0")).collect();
        let file = self.file.rsplit('/').next().unwrap_or(self.file);
        let toml = format!(
            "urdf = {{ file = \"{file}\", base = \"{}\", tip = \"{}\", fixed_joints = {{ {} }} }}",
            self.base,
            self.tip,
            held.join(", ")
        );
        let is_free = |joint: &&&Joint| matches!(self.kind(joint), Ok(Some(_)));
        let beyond = moving.iter().skip(branch + 1).filter(is_free).count();
        let behind =
            moving.get(branch).filter(|_| (2..=7).contains(&beyond)).map(|joint| joint.child.clone());
        let element = match beside[..] {
            [one] => joint_element(one),
            _ => format!("{} joints", beside.len()),
        };
        Err((element, Defect::MovesBesideChain { several: beside.len() > 1, toml, behind }))
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
                _ if behind_tip => self.rest(joint, path),
                // Joints that move beside the chain have been refused.
                Ok(Some(_)) => continue,
                Err(problem) => Err(problem),
            };
            let X = X * place.map_err(fault)?;
            let child = joint.child.as_str();
            sum = sum.plus(&self.weld_from(child, &X, path, behind_tip || child == self.tip)?);
        }
        Ok(sum)
    }
}
