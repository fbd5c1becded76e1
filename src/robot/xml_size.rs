//! Whether a URDF is of a size that a robot may have. The parser behind it recurses into elements and walks through
//! attributes again and again: what is deep or wide beyond all robots must not reach it.

use super::xml_fault::XmlFault;
use super::xml_tags::tags;

/// Deepest nesting of elements; a URDF needs six, extensions of simulators a few more.
const DEEPEST: usize = 64;
/// Elements of all kinds; a humanoid has some thousand.
const MOST_ELEMENTS: usize = 50_000;
/// Links, and joints.
const MOST_PARTS: usize = 1000;
/// Longest tag, bytes.
const LONGEST_TAG: usize = 64 << 10;

/// The first thing in `text` that is too much. What else is wrong with it is for the parser to find.
pub(super) fn excess(text: &str) -> Option<XmlFault> {
    let at = |offset: usize, message: String| {
        let line = 1 + text.get(..offset).unwrap_or(text).matches('\n').count();
        Some(XmlFault { line, message })
    };
    let (mut depth, mut elements, mut links, mut joints) = (0_usize, 0, 0, 0);
    for tag in tags(text) {
        // A tag without end is a fault that `xml_fault` tells.
        let Ok(tag) = tag else { return None };
        if tag.is_no_element() {
            continue;
        }
        if tag.end - tag.start > LONGEST_TAG {
            return at(
                tag.start,
                format!("a tag is longer than {} KiB; is it a URDF robot?", LONGEST_TAG >> 10),
            );
        }
        if tag.closes() {
            depth = depth.saturating_sub(1);
            continue;
        }
        elements += 1;
        depth += 1;
        if depth > DEEPEST {
            return at(
                tag.start,
                format!("elements are nested more than {DEEPEST} deep; is it a URDF robot?"),
            );
        }
        if elements > MOST_ELEMENTS {
            return at(
                tag.start,
                format!("there are more than {MOST_ELEMENTS} elements; is it a URDF robot?"),
            );
        }
        if depth == 2 {
            let count = match tag.name() {
                "link" => &mut links,
                "joint" => &mut joints,
                _ => &mut 0,
            };
            *count += 1;
            if *count > MOST_PARTS {
                let name = tag.name();
                return at(
                    tag.start,
                    format!("there are more than {MOST_PARTS} {name}s; give the arm's own alone"),
                );
            }
        }
        if tag.is_empty_element() {
            depth -= 1;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_robots_have_passes() {
        for text in [include_str!("../../config/robot/panda.urdf"), "", "<", "</a></b>", "<!-- <a> -->"] {
            assert_eq!(excess(text), None);
        }
        let nested = |n: usize| excess(&format!("{}{}", "<a>\n".repeat(n), "</a>".repeat(n)));
        assert_eq!(nested(DEEPEST), None);
        assert_eq!(nested(DEEPEST + 1).unwrap().line, DEEPEST + 1);
        let wide = |n: usize| excess(&format!("<robot>{}</robot>", "<link/>\n".repeat(n)));
        assert_eq!(wide(MOST_PARTS), None);
        assert!(wide(MOST_PARTS + 1).unwrap().message.contains("more than 1000 links"));
    }
}
