//! Where a URDF that does not parse is wrong: the parser behind it names neither line nor element.
//!
//! Tags are matched by hand, which finds text that is not well-formed. If they match, links and joints are parsed one
//! by one until one fails.

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
            return XmlFault { line: line_of(open.start), message: format!("{}: {error}", open.label) };
        }
    }
    XmlFault { line: 1, message: format!("not a URDF robot: {refusal}") }
}

/// The children of the root element with the offset behind each, or the offset and reason of the first wrong tag.
fn elements(text: &str) -> Result<Vec<(Open<'_>, usize)>, (usize, String)> {
    let mut stack: Vec<Open> = Vec::new();
    let mut children = Vec::new();
    let mut roots = 0;
    let mut at = 0;
    while let Some(offset) = text.get(at..).and_then(|rest| rest.find('<')) {
        let start = at + offset;
        let rest = text.get(start..).unwrap_or("");
        let Some(length) = tag_length(rest) else {
            return Err((start, "`<` opens a tag that has no end".to_owned()));
        };
        at = start + length;
        let Some(tag) = rest.get(1..length - 1) else { continue };
        if tag.starts_with(['!', '?']) {
            continue;
        }
        if let Some(name) = tag.strip_prefix('/') {
            let name = name.trim();
            match stack.pop() {
                Some(open) if open.tag == name => {
                    if stack.len() == 1 {
                        children.push((open, at));
                    }
                }
                Some(open) => {
                    return Err((start, format!("`</{name}>` stands where {} should be closed", open.label)));
                }
                None => return Err((start, format!("`</{name}>` closes nothing"))),
            }
            continue;
        }
        let name = tag.split(|c: char| c.is_whitespace() || c == '/').next().unwrap_or("");
        if name.is_empty() || tag.contains('<') {
            return Err((start, format!("`<{}` is not a tag", tag.lines().next().unwrap_or(""))));
        }
        if stack.is_empty() {
            roots += 1;
            if name != "robot" || roots > 1 {
                return Err((start, format!("the root element is `<{name}>`; a URDF has one, `<robot>`")));
            }
        }
        let open = Open { tag: name, label: label(name, tag), start };
        if !tag.ends_with('/') {
            stack.push(open);
        } else if stack.len() == 1 {
            children.push((open, at));
        }
    }
    match stack.pop() {
        Some(open) => Err((open.start, format!("{} is never closed", open.label))),
        None if roots == 0 => Err((0, "there is no `<robot>` in it".to_owned())),
        None => Ok(children),
    }
}

/// `link "forearm"`, or the tag alone when it has no name.
fn label(name: &str, tag: &str) -> String {
    let quoted = tag.split_once("name=").and_then(|(_, rest)| {
        let quote = rest.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        rest.get(1..)?.split(quote).next()
    });
    quoted.map_or_else(|| format!("`<{name}>`"), |value| format!("{name} \"{value}\""))
}

/// The length of the tag, comment or declaration at the beginning of `rest`, with its brackets.
fn tag_length(rest: &str) -> Option<usize> {
    for (opening, closing) in [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")] {
        if rest.starts_with(opening) {
            return rest.find(closing).map(|end| end + closing.len());
        }
    }
    let mut quote = None;
    for (index, c) in rest.char_indices().skip(1) {
        match (quote, c) {
            (None, '>') => return Some(index + 1),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if c == open => quote = None,
            _ => {}
        }
    }
    None
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
