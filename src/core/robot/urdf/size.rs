//! Checks that a URDF is not larger than a robot's description can be. The parser compares the attributes of a tag with one another, and
//! each element with the namespaces around it, so that a text far deeper or wider than any robot must not reach it.

use super::syntax::XmlFault;
use super::tags::tags;

/// Deepest nesting of elements; a URDF needs six, extensions of simulators a few more. These bounds are chosen, each ten times and more what
/// a robot needs, so that a hostile file ends in a message and not in the memory or the time of the parser (`tests/processes/hostile_files.rs`).
const DEEPEST: usize = 64;
const MAX_ELEMENTS: usize = 50_000; // of all kinds; a humanoid has some thousand
const MAX_PARTS: usize = 1000; // links, and joints
const LONGEST_TAG: usize = 8 << 10; // bytes
const MAX_NAMESPACES: usize = 1000; // that are declared
const MAX_SIGNS: usize = 400_000; // each of `<` and `=`, for which the parser sets memory aside before it looks

/// The first part of `text` that exceeds a bound, or the first tag without end. The parser finds all other
/// faults.
pub(super) fn excess(text: &str) -> Option<XmlFault> {
    let at = |offset: usize, message: String| Some(XmlFault::at(text, offset, message));
    let (mut depth, mut elements, mut links, mut joints) = (0_usize, 0, 0, 0);
    for tag in tags(text) {
        let tag = match tag {
            Ok(tag) => tag,
            Err(start) => return at(start, "`<` opens a tag that has no end".to_owned()),
        };
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
        if elements > MAX_ELEMENTS {
            return at(
                tag.start,
                format!("there are more than {MAX_ELEMENTS} elements; is it a URDF robot?"),
            );
        }
        if depth == 2 {
            let count = match tag.name() {
                "link" => &mut links,
                "joint" => &mut joints,
                _ => &mut 0,
            };
            *count += 1;
            if *count > MAX_PARTS {
                let name = tag.name();
                return at(
                    tag.start,
                    format!("there are more than {MAX_PARTS} {name}s; give the arm's own alone"),
                );
            }
        }
        if tag.is_empty_element() {
            depth -= 1;
        }
    }
    let (what, most) = match () {
        () if text.matches("xmlns").count() > MAX_NAMESPACES => ("namespaces", MAX_NAMESPACES),
        () if text.matches('<').count() > MAX_SIGNS => ("signs `<`", MAX_SIGNS),
        () if text.matches('=').count() > MAX_SIGNS => ("signs `=`", MAX_SIGNS),
        () => return None,
    };
    at(0, format!("there are more than {most} {what}; is it a URDF robot?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_robots_have_passes() {
        for text in [include_str!("../../../../config/robot/panda.urdf"), "", "</a></b>", "<!-- <a> -->"] {
            assert_eq!(excess(text), None);
        }
        let nested = |n: usize| excess(&format!("{}{}", "<a>\n".repeat(n), "</a>".repeat(n)));
        assert_eq!(nested(DEEPEST), None);
        assert_eq!(nested(DEEPEST + 1).unwrap().line, DEEPEST + 1);
        let wide = |n: usize| excess(&format!("<robot>{}</robot>", "<link/>\n".repeat(n)));
        assert_eq!(wide(MAX_PARTS), None);
        assert!(wide(MAX_PARTS + 1).unwrap().message.contains("more than 1000 links"));
        assert_eq!(excess("<a>\n<b c='").unwrap().line, 2);
        let spaces = |n: usize| excess(&"<a xmlns:a='b'/>".repeat(n));
        assert_eq!(spaces(MAX_NAMESPACES), None);
        assert!(spaces(MAX_NAMESPACES + 1).unwrap().message.contains("1000 namespaces"));
        let comment = |sign: &str, n: usize| excess(&format!("<!--{}-->", sign.repeat(n)));
        assert_eq!(comment("=", MAX_SIGNS), None);
        assert!(comment("=", MAX_SIGNS + 1).unwrap().message.contains("signs `=`"));
        assert!(comment("<", MAX_SIGNS + 1).unwrap().message.contains("signs `<`"));
    }
}
