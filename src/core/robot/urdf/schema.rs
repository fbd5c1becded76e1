//! The elements and attributes of links and joints in a URDF, and what is wrong with one in the words of the format.
//!
//! This is the only place that states which values an element has and must have; `document` reads what has passed this check.

use roxmltree::Node;

/// Major and minor version of the format.
pub(super) type Version = (u32, u32);
/// Without a version, or with one that cannot be read.
pub(super) const V1_0: Version = (1, 0);
/// Brings `quat_xyzw`.
pub(super) const V1_1: Version = (1, 1);
/// Limits may be missing, and sizes and limits are checked.
pub(super) const V1_2: Version = (1, 2);

/// The kind of an attribute's value.
#[derive(Clone, Copy)]
enum AttributeValue {
    /// So many numbers.
    Numbers(usize),
    /// So many numbers, which from version 1.2 on must be above zero and finite.
    Sizes(usize),
    /// A number, which from version 1.2 on must not be below zero.
    Bound,
    /// Any text.
    Text,
    /// One of these words.
    Word(&'static [&'static str]),
}

/// Whether an attribute must be there.
#[derive(Clone, Copy)]
enum Need {
    Always,
    /// In versions before this one.
    Before(Version),
    Never,
    /// Never, and before this version it is not looked at.
    NeverSince(Version),
}

/// How many elements of one name an element may contain.
#[derive(Clone, Copy, PartialEq)]
enum Count {
    One,
    AtMostOne,
    Any,
    /// One of all those marked so, and nothing beside it.
    Choice,
}

/// An element, its attributes, and the elements that are checked within it.
type Element = (&'static str, &'static [Attribute], &'static [(&'static str, Count)]);
/// An attribute: its name, its value, and whether it must be there.
type Attribute = (&'static str, AttributeValue, Need);

use AttributeValue::{Bound, Numbers, Sizes, Text, Word};
use Count::{Any, AtMostOne, Choice, One};
use Need::{Always, Before, Never, NeverSince};

/// Scalars and vectors of space, as the format has them.
const ONE: AttributeValue = Numbers(1);
const THREE: AttributeValue = Numbers(3);
const JOINT_TYPES: AttributeValue =
    Word(&["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"]);

const ELEMENTS: &[Element] = &[
    ("link", &[("name", Text, Always)], &[("inertial", AtMostOne), ("visual", Any), ("collision", Any)]),
    ("inertial", &[], &[("origin", AtMostOne), ("mass", One), ("inertia", One)]),
    ("mass", &[("value", ONE, Always)], &[]),
    (
        "inertia",
        &[
            ("ixx", ONE, Always),
            ("ixy", ONE, Always),
            ("ixz", ONE, Always),
            ("iyy", ONE, Always),
            ("iyz", ONE, Always),
            ("izz", ONE, Always),
        ],
        &[],
    ),
    (
        "origin",
        &[("xyz", THREE, Never), ("rpy", THREE, Never), ("quat_xyzw", Numbers(4), NeverSince(V1_1))],
        &[],
    ),
    ("visual", &[], &[("origin", AtMostOne), ("geometry", One), ("material", AtMostOne)]),
    ("collision", &[], &[("origin", AtMostOne), ("geometry", One)]),
    (
        "geometry",
        &[],
        &[("box", Choice), ("cylinder", Choice), ("capsule", Choice), ("sphere", Choice), ("mesh", Choice)],
    ),
    ("box", &[("size", Sizes(3), Always)], &[]),
    ("cylinder", &[("radius", Sizes(1), Always), ("length", Sizes(1), Always)], &[]),
    ("capsule", &[("radius", Sizes(1), Always), ("length", Sizes(1), Always)], &[]),
    ("sphere", &[("radius", Sizes(1), Always)], &[]),
    ("mesh", &[("filename", Text, Always), ("scale", THREE, Never)], &[]),
    ("material", &[("name", Text, Always)], &[("color", AtMostOne), ("texture", AtMostOne)]),
    ("color", &[("rgba", Numbers(4), Always)], &[]),
    ("texture", &[("filename", Text, Never)], &[]),
    (
        "joint",
        &[("name", Text, Always), ("type", JOINT_TYPES, Always)],
        &[
            ("origin", AtMostOne),
            ("parent", One),
            ("child", One),
            ("axis", AtMostOne),
            ("limit", AtMostOne),
            ("dynamics", AtMostOne),
            ("mimic", AtMostOne),
            ("calibration", AtMostOne),
            ("safety_controller", AtMostOne),
        ],
    ),
    ("parent", &[("link", Text, Always)], &[]),
    ("child", &[("link", Text, Always)], &[]),
    ("axis", &[("xyz", THREE, Always)], &[]),
    (
        "limit",
        &[
            ("lower", ONE, Never),
            ("upper", ONE, Never),
            ("velocity", Bound, Before(V1_2)),
            ("effort", Bound, Never),
            ("acceleration", Bound, NeverSince(V1_2)),
            ("deceleration", Bound, NeverSince(V1_2)),
            ("jerk", Bound, NeverSince(V1_2)),
        ],
        &[],
    ),
    ("dynamics", &[("damping", ONE, Never), ("friction", ONE, Never)], &[]),
    ("mimic", &[("joint", Text, Always), ("multiplier", ONE, Never), ("offset", ONE, Never)], &[]),
    ("calibration", &[("rising", ONE, Never), ("falling", ONE, Never)], &[]),
    (
        "safety_controller",
        &[
            ("k_velocity", ONE, Always),
            ("k_position", ONE, Never),
            ("soft_lower_limit", ONE, Never),
            ("soft_upper_limit", ONE, Never),
        ],
        &[],
    ),
];

/// An element that is not as URDF wants it, and what is wrong with it.
pub(super) type SchemaViolation<'a, 'input> = (Node<'a, 'input>, String);

/// Checks `node` and the elements within it, in the file's order.
///
/// # Errors
/// The first thing that URDF does not allow.
pub(super) fn check<'a, 'input>(
    node: Node<'a, 'input>,
    version: Version,
) -> Result<(), SchemaViolation<'a, 'input>> {
    let name = node.tag_name().name();
    let Some((_, attributes, holds)) = ELEMENTS.iter().find(|(known, ..)| *known == name) else {
        return Ok(());
    };
    if let Some(what) = attributes.iter().find_map(|attribute| wrong(node, attribute, version)) {
        return Err((node, what));
    }
    if let Some(what) = contradiction(node, version) {
        return Err((node, what));
    }
    let mut seen: Vec<&str> = Vec::new();
    for part in parts(node) {
        let inner = part.tag_name().name();
        let count = holds.iter().find(|(known, _)| *known == inner).map(|(_, count)| *count);
        if matches!(count, Some(One | AtMostOne)) && seen.contains(&inner) {
            return Err((part, format!("`<{name}>` holds `<{inner}>` twice")));
        }
        if choices(holds).next().is_some() && (count.is_none() || !seen.is_empty()) {
            return Err((
                part,
                format!("`<{name}>` holds {}, not `<{inner}>`", one_of(holds, !seen.is_empty())),
            ));
        }
        if count.is_some() {
            seen.push(inner);
            check(part, version)?;
        }
    }
    if let Some((missing, _)) = holds.iter().find(|(inner, count)| *count == One && !seen.contains(inner)) {
        return Err((node, format!("`<{name}>` holds no `<{missing}>`")));
    }
    if choices(holds).next().is_some() && seen.is_empty() {
        return Err((node, format!("`<{name}>` is empty; it holds {}", one_of(holds, false))));
    }
    Ok(())
}

fn choices(holds: &'static [(&str, Count)]) -> impl Iterator<Item = &'static str> {
    holds.iter().filter(|(_, count)| *count == Choice).map(|(name, _)| *name)
}

fn one_of(holds: &'static [(&str, Count)], already: bool) -> String {
    let names = choices(holds).collect::<Vec<_>>().join(", ");
    format!("one of {names}{}", if already { " alone" } else { "" })
}

/// What is wrong with one attribute of an element.
fn wrong(node: Node, &(name, value, need): &Attribute, version: Version) -> Option<String> {
    let element = node.tag_name().name();
    if matches!(need, NeverSince(first) if version < first) {
        return None;
    }
    let Some(given) = node.attribute(name) else {
        let needed = match need {
            Always => true,
            Before(first) => version < first,
            Never | NeverSince(_) => false,
        };
        return needed.then(|| format!("`<{element}>` has no `{name}`"));
    };
    let numbers_as = |count: usize, allowed: fn(&f64) -> bool| {
        numbers(given).is_some_and(|numbers| numbers.len() == count && numbers.iter().all(allowed))
    };
    let strict = version >= V1_2;
    let (right, wanted) = match value {
        Text => return None,
        Word(words) => (words.contains(&given), format!("one of {}", words.join(", "))),
        Sizes(count) if strict => {
            (numbers_as(count, |x| *x > 0.0 && x.is_finite()), several(count) + " above zero")
        }
        Bound if strict => (numbers_as(1, |x| *x >= 0.0), several(1) + " not below zero"),
        Numbers(count) | Sizes(count) => (numbers_as(count, |_| true), several(count)),
        Bound => (numbers_as(1, |_| true), several(1)),
    };
    (!right).then(|| format!("`<{element}>`: `{name}` is `{given}`; it must be {wanted}"))
}

fn several(count: usize) -> String {
    if count == 1 { "a number".to_owned() } else { format!("{count} numbers") }
}

/// An inconsistency between the attributes of an element, each of which is valid by itself.
fn contradiction(node: Node, version: Version) -> Option<String> {
    match node.tag_name().name() {
        "origin" if version >= V1_1 && node.has_attribute("rpy") && node.has_attribute("quat_xyzw") => {
            Some("`<origin>` has both `rpy` and `quat_xyzw`; give one of them".to_owned())
        }
        "limit" if version >= V1_2 => {
            let (lower, upper) = (node.attribute("lower")?, node.attribute("upper")?);
            let reversed = !(numbers(lower)? <= numbers(upper)?);
            reversed.then(|| format!("`<limit>`: `lower` is `{lower}`, `upper` is `{upper}`, below it"))
        }
        _ => None,
    }
}

/// The numbers of a value with blanks between them; `None` where something is not a number.
pub(super) fn numbers(value: &str) -> Option<Vec<f64>> {
    value.split_whitespace().map(|word| word.parse().ok()).collect()
}

/// The elements that `node` holds of its own format; those of others have namespaces of their own.
pub(super) fn parts<'a, 'input>(node: Node<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> {
    let namespace = node.tag_name().namespace();
    node.children().filter(move |part| part.is_element() && part.tag_name().namespace() == namespace)
}

/// The first element of that name in `node`.
pub(super) fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    parts(node).find(|part| part.tag_name().name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with the only element of `text`.
    fn fault(text: &str, version: Version) -> Option<String> {
        let xml = roxmltree::Document::parse(text).unwrap();
        check(xml.root_element(), version).err().map(|(_, message)| message)
    }

    #[test]
    fn faults_are_told_in_the_words_of_the_format() {
        for (text, wanted) in [
            ("<mass value='heavy'/>", "`<mass>`: `value` is `heavy`; it must be a number"),
            ("<axis xyz='0 0'/>", "`<axis>`: `xyz` is `0 0`; it must be 3 numbers"),
            ("<axis xyz='0 0 1 x'/>", "`<axis>`: `xyz` is `0 0 1 x`; it must be 3 numbers"),
            ("<limit effort='1'/>", "`<limit>` has no `velocity`"),
            ("<inertial><mass value='1'/></inertial>", "`<inertial>` holds no `<inertia>`"),
            ("<joint name='a' type='fixed'/>", "`<joint>` holds no `<parent>`"),
            ("<joint name='a' type='hinge'/>", "`<joint>`: `type` is `hinge`; it must be one of revolute, "),
            ("<geometry/>", "`<geometry>` is empty; it holds one of box, "),
            (
                "<geometry><ball/></geometry>",
                "`<geometry>` holds one of box, cylinder, capsule, sphere, mesh, not `<ball>`",
            ),
            ("<inertial><mass value='1'/><mass value='1'/></inertial>", "`<inertial>` holds `<mass>` twice"),
        ] {
            let message = fault(text, (1, 0)).unwrap();
            assert!(message.starts_with(wanted), "{message}");
        }
        let two = "<geometry><mesh filename='a'/><mesh filename='b'/></geometry>";
        assert!(fault(two, (1, 0)).unwrap().contains("mesh alone, not `<mesh>`"));
    }

    #[test]
    fn versions_differ() {
        for (text, before, since, version) in [
            ("<limit/>", Some("`<limit>` has no `velocity`"), None, V1_2),
            (
                "<limit velocity='-1'/>",
                None,
                Some("`velocity` is `-1`; it must be a number not below zero"),
                V1_2,
            ),
            ("<limit velocity='1' jerk='x'/>", None, Some("`jerk` is `x`"), V1_2),
            ("<limit velocity='1' lower='1' upper='0'/>", None, Some("`upper` is `0`, below it"), V1_2),
            ("<limit velocity='1' lower='1' upper='nan'/>", None, Some("`upper` is `nan`, below it"), V1_2),
            ("<sphere radius='0'/>", None, Some("it must be a number above zero"), V1_2),
            ("<box size='1 inf 1'/>", None, Some("it must be 3 numbers above zero"), V1_2),
            ("<origin quat_xyzw='x'/>", None, Some("it must be 4 numbers"), V1_1),
            ("<origin rpy='0 0 0' quat_xyzw='0 0 0 1'/>", None, Some("give one of them"), V1_1),
        ] {
            for (wanted, version) in [(before, (version.0, version.1 - 1)), (since, version), (since, (2, 0))]
            {
                let found = fault(text, version);
                assert_eq!(found.is_some(), wanted.is_some(), "{text}: {found:?}");
                assert!(found.unwrap_or_default().contains(wanted.unwrap_or_default()), "{text}");
            }
        }
    }
}
