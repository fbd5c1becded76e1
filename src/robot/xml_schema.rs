//! What links and joints of a URDF hold: to tell what is wrong with one in the words of the format.

use super::xml_tags::{Tag, tags};

/// What an attribute's value is.
#[derive(Clone, Copy)]
enum Value {
    /// So many numbers.
    Numbers(usize),
    /// Any text.
    Text,
    /// One of these words.
    Word(&'static [&'static str]),
}

/// An attribute: its name, its value, and whether it must be there.
type Attribute = (&'static str, Value, bool);

const ONE: Value = Value::Numbers(1);
const THREE: Value = Value::Numbers(3);
const JOINT_TYPES: Value =
    Value::Word(&["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"]);

/// Elements, their attributes, and the elements that they must hold.
const ELEMENTS: &[(&str, &[Attribute], &[&str])] = &[
    ("link", &[("name", Value::Text, true)], &[]),
    ("inertial", &[], &["mass", "inertia"]),
    ("mass", &[("value", ONE, true)], &[]),
    (
        "inertia",
        &[
            ("ixx", ONE, true),
            ("ixy", ONE, true),
            ("ixz", ONE, true),
            ("iyy", ONE, true),
            ("iyz", ONE, true),
            ("izz", ONE, true),
        ],
        &[],
    ),
    ("origin", &[("xyz", THREE, false), ("rpy", THREE, false), ("quat_xyzw", Value::Numbers(4), false)], &[]),
    ("visual", &[], &["geometry"]),
    ("collision", &[], &["geometry"]),
    ("box", &[("size", THREE, true)], &[]),
    ("cylinder", &[("radius", ONE, true), ("length", ONE, true)], &[]),
    ("capsule", &[("radius", ONE, true), ("length", ONE, true)], &[]),
    ("sphere", &[("radius", ONE, true)], &[]),
    ("mesh", &[("filename", Value::Text, true), ("scale", THREE, false)], &[]),
    ("color", &[("rgba", Value::Numbers(4), true)], &[]),
    ("texture", &[("filename", Value::Text, true)], &[]),
    ("joint", &[("name", Value::Text, true), ("type", JOINT_TYPES, true)], &["parent", "child"]),
    ("parent", &[("link", Value::Text, true)], &[]),
    ("child", &[("link", Value::Text, true)], &[]),
    ("axis", &[("xyz", THREE, true)], &[]),
    (
        "limit",
        &[("lower", ONE, false), ("upper", ONE, false), ("velocity", ONE, true), ("effort", ONE, false)],
        &[],
    ),
    ("dynamics", &[("damping", ONE, false), ("friction", ONE, false)], &[]),
    ("mimic", &[("joint", Value::Text, true), ("multiplier", ONE, false), ("offset", ONE, false)], &[]),
    ("calibration", &[("rising", ONE, false), ("falling", ONE, false)], &[]),
    ("safety_controller", &[("k_velocity", ONE, true), ("k_position", ONE, false)], &[]),
];

/// The first thing in the `text` of one link or joint that URDF does not allow: where, and what.
pub(super) fn fault(text: &str) -> Option<(usize, String)> {
    // Open elements, with the names of what they hold so far.
    let mut open: Vec<(Tag<'_>, Vec<&str>)> = Vec::new();
    for tag in tags(text).flatten().filter(|tag| !tag.is_no_element()) {
        if !tag.closes() {
            if let Some((_, held)) = open.last_mut() {
                held.push(tag.name());
            }
            if let Some(what) = wrong_attribute(&tag) {
                return Some((tag.start, what));
            }
            open.push((tag, Vec::new()));
        }
        if (tag.closes() || tag.is_empty_element())
            && let Some((opened, held)) = open.pop()
            && let Some(missing) = required(opened.name()).iter().find(|name| !held.contains(name))
        {
            return Some((opened.start, format!("`<{}>` holds no `<{missing}>`", opened.name())));
        }
    }
    None
}

fn required(element: &str) -> &'static [&'static str] {
    ELEMENTS.iter().find(|(name, ..)| *name == element).map_or(&[], |(_, _, required)| *required)
}

fn wrong_attribute(tag: &Tag<'_>) -> Option<String> {
    let element = tag.name();
    let (_, attributes, _) = ELEMENTS.iter().find(|(name, ..)| *name == element)?;
    attributes.iter().find_map(|(name, value, needed)| {
        let Some(given) = tag.attribute(name) else {
            return needed.then(|| format!("`<{element}>` has no `{name}`"));
        };
        let wanted = match value {
            Value::Text => return None,
            Value::Word(words) if words.contains(&given) => return None,
            Value::Word(words) => format!("one of {}", words.join(", ")),
            Value::Numbers(count) => {
                let numbers = given.split_whitespace().filter_map(|n| n.parse::<f64>().ok()).count();
                if numbers == *count && given.split_whitespace().count() == *count {
                    return None;
                }
                if *count == 1 { "a number".to_owned() } else { format!("{count} numbers") }
            }
        };
        Some(format!("`<{element}>`: `{name}` is `{given}`; it must be {wanted}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_links_and_joints_have_no_fault() {
        for text in [
            include_str!("../../config/robot/ur5.urdf"),
            include_str!("../../config/robot/panda.urdf"),
            include_str!("../../config/robot/xarm7.urdf"),
        ] {
            assert_eq!(fault(text), None);
        }
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
        ] {
            let (_, message) = fault(text).unwrap();
            assert!(message.starts_with(wanted), "{message}");
        }
    }
}
