//! What is wrong with a robot's file: which file, which element, what, and what to do.

use super::model::JointKind;
use crate::input::number;

/// How a joint of a URDF is held at a position, for which URDF has no element of its own.
const HOLD: &str = "hold it: a robot file in TOML, with `[urdf]`, `file = \"ARM.urdf\"`, `tip = \"LINK\"` and \
                    `fixed_joints = { JOINT = 0.0 }`, as robot.model";

/// Why a robot could not be loaded.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The name is neither a shipped robot nor a `.toml` or `.urdf` file.
    #[error(
        "robot `{name}`: no such robot; name one of {shipped}, or give the path of a .toml or .urdf file (FILE.urdf#TIP)"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// The shipped names.
        shipped: String,
    },
    /// The file could not be read.
    #[error("{file}: cannot read: {source}; check the path and its permissions")]
    Read {
        /// The file.
        file: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The text is not well-formed TOML or XML, or has a key or element that does not belong there.
    #[error("{place}: {message}")]
    Syntax {
        /// The file, with line and column where they are known.
        place: String,
        /// Element or key, and reason.
        message: String,
    },
    /// One element of the file is wrong.
    #[error("{file}: {element}: {problem}")]
    Element {
        /// The file.
        file: String,
        /// The element, such as `joint "elbow"` or `link "forearm"`.
        element: String,
        /// What is wrong with it.
        problem: Defect,
    },
    /// `build::<N>` was called with another `N` than the file states.
    #[error("{file}: the arm has {found} joints, the program asked for {asked}; use dispatch_robot!")]
    WrongBuild {
        /// The file.
        file: String,
        /// Joints in the file.
        found: usize,
        /// The `N` of the call.
        asked: usize,
    },
}

/// What can be wrong with one element of a robot's file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Defect {
    /// A number is NaN or infinite.
    #[error("a number is not finite; every length, mass and moment must be")]
    NotFinite,
    /// A number outside of the range that real arms have.
    #[error("{what}: {} is out of range, allowed is {} to {}", number(*value), number(*low), number(*high))]
    OutOfRange {
        /// Its key, or element and attribute.
        what: String,
        /// The value that was read.
        value: f64,
        /// The least that is allowed.
        low: f64,
        /// The greatest that is allowed.
        high: f64,
    },
    /// A length that no arm has.
    #[error(
        "{what}: {} is out of range, allowed is -{most} to {most} m; lengths are in m: is the file written in millimetres?",
        number(*value)
    )]
    Length {
        /// Its key, or element and attribute.
        what: String,
        /// The value that was read.
        value: f64,
        /// The greatest that is allowed, m, either way.
        most: f64,
    },
    /// An attribute of `<limit>` is needed that is not there (URDF).
    #[error("`<limit>` has no `{attribute}`; give lower, upper, velocity and effort")]
    MissingLimit {
        /// The attribute.
        attribute: &'static str,
    },
    /// A moving link without `<inertial>` (URDF).
    #[error("the link moves but has no <inertial>, or an empty one; give its mass and inertia")]
    MissingInertia,
    /// Zero or negative mass.
    #[error("mass {mass_kg} kg; a moving link needs a positive mass")]
    Mass {
        /// The mass that was read.
        mass_kg: f64,
    },
    /// The inertia has a principal moment that is not positive.
    #[error(
        "inertia is not positive definite (least principal moment {min_kg_m2:e} kg m^2); check signs and units"
    )]
    NotPositiveDefinite {
        /// The least principal moment.
        min_kg_m2: f64,
    },
    /// A principal moment exceeds the sum of the other two: no body has such moments.
    #[error(
        "principal moments {moments_kg_m2:?} kg m^2 violate the triangle inequality; is the inertia about the centre of mass?"
    )]
    Triangle {
        /// The principal moments in increasing order.
        moments_kg_m2: [f64; 3],
    },
    /// B(q) is not positive definite: some joint moves nothing.
    #[error("the inertia matrix B(q) is not positive definite: some joint moves neither mass nor inertia")]
    MassMatrix,
    /// The lower limit is above the upper one, or equal to it.
    #[error("limits are reversed or empty: lower {lower}, upper {upper}")]
    LimitsReversed {
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
    /// A revolute or prismatic joint without position limits.
    #[error("a {kind} joint needs position limits{}", if *kind == JointKind::Revolute { "; use type continuous for one that turns without end" } else { "" })]
    LimitsMissing {
        /// The joint's type.
        kind: JointKind,
    },
    /// Position limits on a continuous joint.
    #[error("a continuous joint has no position limits; use type revolute, or take them away")]
    LimitsOnContinuous,
    /// The velocity or effort limit is zero, negative or not a number.
    #[error("the {what} limit is {value}; it must be positive")]
    LimitNotPositive {
        /// `velocity` or `effort`.
        what: &'static str,
        /// The value that was read.
        value: f64,
    },
    /// A key in units that do not fit the joint's type.
    #[error("`{key}` does not belong to a {kind} joint; write `{instead}`")]
    WrongUnit {
        /// The key that was found.
        key: &'static str,
        /// The joint's type.
        kind: JointKind,
        /// The key to use.
        instead: &'static str,
    },
    /// A required key is not there.
    #[error("`{key}` is missing")]
    MissingKey {
        /// The key.
        key: &'static str,
    },
    /// A coefficient that must not be negative is.
    #[error("`{what}` is {value}; it must not be negative")]
    Negative {
        /// What it is.
        what: &'static str,
        /// The value that was read.
        value: f64,
    },
    /// The joint axis has no direction.
    #[error("the axis is zero; give a direction")]
    ZeroAxis,
    /// Two elements have one name.
    #[error("the name is used twice; names must be unique")]
    DuplicateName,
    /// The number of moving joints is outside 2 to 7.
    #[error("{found} moving joints from base to tip; 2 to 7 are supported (is the tip named rightly?)")]
    JointCount {
        /// How many there are.
        found: usize,
    },
    /// A joint names a link that does not exist.
    #[error("names the link `{link}`, which does not exist")]
    NoSuchLink {
        /// The name.
        link: String,
    },
    /// A setting names a joint that does not exist.
    #[error("names the joint `{joint}`, which does not exist; the file has {known}")]
    NoSuchJoint {
        /// The name.
        joint: String,
        /// The joints that exist.
        known: String,
    },
    /// A link has two parents or is its own ancestor.
    #[error("closes a loop: link `{link}` is reached twice; only trees of links are supported")]
    Loop {
        /// The link.
        link: String,
    },
    /// No link is without a parent, or several are.
    #[error("{found} root links ({links}); a robot has one; name the base link")]
    Roots {
        /// How many there are.
        found: usize,
        /// Their names.
        links: String,
    },
    /// Several links end the tree and none was named.
    #[error("the tree branches; name the tip, one of {tips}: FILE.urdf#TIP, or tip = in a TOML file")]
    UnnamedBranch {
        /// The candidates.
        tips: String,
    },
    /// The tip is not a descendant of the base.
    #[error("tip `{tip}` is not reached from base `{base}`")]
    NotAChain {
        /// The base link.
        base: String,
        /// The tip link.
        tip: String,
    },
    /// Joints beside the chain move: their links have no definite place.
    #[error(
        "{} beside the chain from base to tip; make them type fixed, or hold them: a robot file in TOML beside the URDF, as robot.model, with the lines \
         `name = \"my_arm\"` and `{toml}`{}",
        if *several { "move" } else { "moves" },
        behind.as_ref().map_or(String::new(), |link| format!("; or begin the arm behind them, with base = \"{link}\""))
    )]
    MovesBesideChain {
        /// Whether there are several.
        several: bool,
        /// The table that holds them.
        toml: String,
        /// The link from which on no joint is beside the chain, where that leaves an arm.
        behind: Option<String>,
    },
    /// A joint of the chain that copies the motion of one that moves, or that is not there.
    #[error("is a mimic of joint `{joint}`, which moves or is not there; make it type fixed, or {HOLD}")]
    Mimic {
        /// Whose motion.
        joint: String,
    },
    /// A joint type with several degrees of freedom.
    #[error("joint type `{kind}` is not supported; use revolute, continuous, prismatic or fixed")]
    JointType {
        /// The type.
        kind: String,
    },
    /// The file gives both `[dh]` and `[urdf]`, or none of them.
    #[error("give exactly one of [dh] and [urdf]")]
    OneSource,
}

impl std::fmt::Display for JointKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Revolute => "revolute",
            Self::Continuous => "continuous",
            Self::Prismatic => "prismatic",
        })
    }
}
