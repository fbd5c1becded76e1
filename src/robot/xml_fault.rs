//! Where a URDF that does not parse is wrong: the parser behind it names neither line nor element.
//!
//! Tags are matched by hand, which finds text that is not well-formed. If they match, links and joints are parsed one
//! by one until one fails.

use super::xml_schema;
use super::xml_tags::{Tag, tags};

/// A fault in a URDF: the line it is on, counted from one, and what is wrong.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct XmlFault {
    pub(super) line: usize,
    pub(super) message: String,
}

/// An element that has been opened: its tag with the `name` attribute, for messages, and where it starts.
struct Open<'a> {
    tag: &'a str,
    label: String,
    start: usize,
}

/// Finds the fault in a `text` that the parser refused with the reason `refusal`.
pub(super) fn locate(text: &str, refusal: &str) -> XmlFault {
    let line_of = |at: usize| 1 + text.get(..at).unwrap_or(text).matches('\n').count();
    let parts = match elements(text) {
        Ok(parts) => parts,
        Err((at, message)) => return XmlFault { line: line_of(at), message },
    };
    for (open, end) in parts {
        let Some(element) = text.get(open.start..end) else { continue };
        if let Err(error) = urdf_rs::read_from_string(&format!("<robot name=\"part\">{element}</robot>")) {
            // The element's own line, or that of the tag in it which is wrong.
            let (at, reason) =
                xml_schema::fault(element).unwrap_or_else(|| (0, in_words(&error.to_string())));
            return XmlFault { line: line_of(open.start + at), message: format!("{}: {reason}", open.label) };
        }
    }
    XmlFault { line: 1, message: format!("not a URDF robot: {}", in_words(refusal)) }
}

/// Whether the element `label` of a `text` that parses, such as `joint "elbow"`, holds the element `inner` without
/// `attribute`, for attributes that the parser takes as zero where they are missing.
pub(super) fn lacks(text: &str, label: &str, inner: &str, attribute: &str) -> bool {
    let parts = elements(text).unwrap_or_default();
    let part = parts.iter().find(|(open, _)| open.label == label);
    let Some(element) = part.and_then(|(open, end)| text.get(open.start..*end)) else { return false };
    tags(element).flatten().any(|tag| tag.name() == inner && tag.attribute(attribute).is_none())
}

/// The parser's refusal without its inner words.
fn in_words(refusal: &str) -> String {
    let refusal = refusal.strip_prefix("custom: ").unwrap_or(refusal).trim_matches('\'').trim();
    let quoted = |prefix: &str| refusal.strip_prefix(prefix)?.strip_suffix('`');
    if let Some(field) = quoted("missing field `") {
        return format!("`{field}` is missing");
    }
    if let Some(field) = quoted("duplicate field `") {
        return format!("`{field}` is given twice");
    }
    if refusal.is_empty() || FOREIGN.iter().any(|word| refusal.contains(word)) {
        return "its elements or attributes are not those of a URDF".to_owned();
    }
    refusal.to_owned()
}

/// Words of the parsers that say nothing to people who write URDFs.
const FOREIGN: [&str; 8] = [
    "Expected token",
    "XmlEvent",
    "Syntax",
    "Parse",
    "unsupported operation",
    "invalid",
    "float",
    "expected",
];

/// The children of the root element with the offset behind each, or the offset and reason of the first wrong tag.
fn elements(text: &str) -> Result<Vec<(Open<'_>, usize)>, (usize, String)> {
    let mut stack: Vec<Open> = Vec::new();
    let mut children = Vec::new();
    let mut roots = 0;
    for tag in tags(text) {
        let tag = tag.map_err(|start| (start, "`<` opens a tag that has no end".to_owned()))?;
        let (start, name) = (tag.start, tag.name());
        if tag.is_no_element() {
            continue;
        }
        if let Some(name) = name.strip_prefix('/') {
            match stack.pop() {
                Some(open) if open.tag == name => {
                    if stack.len() == 1 {
                        children.push((open, tag.end));
                    }
                }
                Some(open) => {
                    return Err((start, format!("`</{name}>` stands where {} should be closed", open.label)));
                }
                None => return Err((start, format!("`</{name}>` closes nothing"))),
            }
            continue;
        }
        if name.is_empty() || tag.inside.contains('<') {
            return Err((start, format!("`<{}` is not a tag", tag.inside.lines().next().unwrap_or(""))));
        }
        if stack.is_empty() {
            roots += 1;
            if name != "robot" || roots > 1 {
                return Err((start, format!("the root element is `<{name}>`; a URDF has one, `<robot>`")));
            }
        }
        let open = Open { tag: name, label: label(&tag), start };
        if !tag.is_empty_element() {
            stack.push(open);
        } else if stack.len() == 1 {
            children.push((open, tag.end));
        }
    }
    match stack.pop() {
        Some(open) => Err((open.start, format!("{} is never closed", open.label))),
        None if roots == 0 => Err((0, "there is no `<robot>` in it".to_owned())),
        None => Ok(children),
    }
}

/// `link "forearm"`, or the tag alone when it has no name.
fn label(tag: &Tag<'_>) -> String {
    let name = tag.name();
    tag.attribute("name").map_or_else(|| format!("`<{name}>`"), |value| format!("{name} \"{value}\""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(text: &str) -> (usize, String) {
        let XmlFault { line, message } = locate(text, "refused");
        (line, message)
    }

    #[test]
    fn tags_that_do_not_match() {
        let message = |text: &str, line: usize, part: &str| {
            let (found, message) = at(text);
            assert_eq!(found, line, "{message}");
            assert!(message.contains(part), "{message}");
        };
        message("<robot name='r'>\n<link name=\"a\">\n</robot>", 3, "link \"a\" should be closed");
        message("<robot name='r'>\n<link name=\"a\"/>", 1, "robot \"r\" is never closed");
        message("<robot>\n</robot>\n</link>", 3, "closes nothing");
        message("<robot>\n<link name=\"a\n</robot>", 2, "has no end");
        message("<html/>", 1, "`<html>`");
        message("<robot/>\n<robot/>", 2, "a URDF has one");
        message("nothing", 1, "no `<robot>`");
        message("<robot>\n< link/>\n</robot>", 2, "not a tag");
        message(
            "<robot><!-- </link> --><?x <y> ?>\n<link name='a'><inertial/></link></robot>",
            2,
            "link \"a\"",
        );
    }

    proptest! {
        #[test]
        fn any_text_gives_an_answer(text in "[<>/!?a-c\"'= \n-]{0,60}", cut in 0usize..2000) {
            let _ = at(&text);
            let ur5 = include_str!("../../config/robot/ur5.urdf");
            prop_assert!(at(&ur5[..cut]).0 <= 1 + ur5.lines().count());
        }
    }
}
