//! What is wrong with a text that is not XML: the parser's reasons in words, with the element that they concern.

use super::tags::{Tag, tags};
use roxmltree::{Error, Node, TextPos};

/// A fault in a URDF: the line it is on, counted from one, and what is wrong.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct XmlFault {
    pub(super) line: usize,
    pub(super) message: String,
}

impl XmlFault {
    /// The fault on the line of the byte `offset` of `text`.
    pub(super) fn at(text: &str, offset: usize, message: String) -> Self {
        Self { line: 1 + text.get(..offset).unwrap_or(text).matches('\n').count(), message }
    }
}

/// `link "forearm"`, or the tag alone when it has no name.
pub(super) fn label(node: Node) -> String {
    let tag = node.tag_name().name();
    node.attribute("name").map_or_else(|| format!("`<{tag}>`"), |name| format!("{tag} \"{name}\""))
}

/// Tells why the parser refused `text` with `error`.
pub(super) fn explain(text: &str, error: &Error) -> XmlFault {
    let offset = offset_of(text, error.pos());
    let here = |message: String| XmlFault::at(text, offset, message);
    match error {
        Error::UnexpectedCloseTag(_, found, _) => {
            let open = open_elements(text.get(..offset).unwrap_or(text)).pop();
            let open = open.map_or_else(|| "the element".to_owned(), label_of_tag);
            here(format!("`</{found}>` stands where {open} should be closed"))
        }
        Error::UnclosedRootNode | Error::UnexpectedEndOfStream => match open_elements(text).pop() {
            Some(open) => XmlFault::at(text, open.start, format!("{} is never closed", label_of_tag(open))),
            None => XmlFault::at(text, text.len(), "the text ends within a tag".to_owned()),
        },
        Error::NoRootNode => here("there is no `<robot>` in it".to_owned()),
        Error::UnknownToken(_) => here(out_of_place(text, offset)),
        Error::DuplicatedAttribute(name, _) => {
            here(format!("{}: `{name}` is given twice", tag_at(text, offset)))
        }
        Error::UnknownNamespace(prefix, _) => here(format!(
            "{}: nothing tells what `{prefix}:` is; declare it in `<robot>`: xmlns:{prefix}=\"...\"",
            tag_at(text, offset)
        )),
        Error::UnknownEntityReference(name, _) => {
            here(format!("`&{name};` is not known here; write out what it stands for"))
        }
        Error::MalformedEntityReference(_) => here("`&` stands alone; write `&amp;`".to_owned()),
        Error::NonXmlChar(c, _) => {
            here(format!("the character U+{:04X} has no place in it; take it out", u32::from(*c)))
        }
        Error::InvalidComment(_) => here("a comment holds `--`, which may only end it".to_owned()),
        Error::InvalidCharacterData(_) => here("`]]>` stands in text; write `]]&gt;`".to_owned()),
        Error::UnexpectedDeclaration(_) => {
            here("`<?xml ...?>` stands within it; it may only be at the beginning".to_owned())
        }
        Error::DtdDetected => {
            here("`<!DOCTYPE` opens a document type that cannot be read; take it out".to_owned())
        }
        _ => {
            let start = tag_start(text, offset);
            let message =
                format!("{} is not a tag; attributes are written as name=\"value\"", tag_at(text, offset));
            XmlFault::at(text, start, message)
        }
    }
}

/// What stands at `offset`, where nothing of the kind may stand.
fn out_of_place(text: &str, offset: usize) -> String {
    let (before, rest) = text.split_at_checked(offset).unwrap_or((text, ""));
    let is_behind = tags(before).flatten().any(|tag| !tag.is_no_element());
    match tags(rest).next() {
        Some(Ok(tag)) if tag.start == 0 && tag.closes() => format!("`<{}>` closes nothing", tag.name()),
        Some(Ok(tag)) if tag.start == 0 && is_behind && !tag.is_no_element() => {
            format!("`<{}>` is a second root element; a URDF has one, `<robot>`", tag.name())
        }
        Some(_) if rest.starts_with('<') => format!("{} is not a tag", tag_at(text, offset)),
        _ if is_behind => "there is text behind the root element; take it out".to_owned(),
        Some(_) => "there is text before `<robot>`; take it out".to_owned(),
        None => "there is no `<robot>` in it".to_owned(),
    }
}

/// The elements that are open at the end of a `text` whose tags match so far.
fn open_elements(text: &str) -> Vec<Tag<'_>> {
    let mut open = Vec::new();
    for tag in tags(text).flatten().filter(|tag| !tag.is_no_element()) {
        if tag.closes() {
            open.pop();
        } else if !tag.is_empty_element() {
            open.push(tag);
        }
    }
    open
}

/// What [`label`] says of the element that `tag` opens.
fn label_of_tag(tag: Tag<'_>) -> String {
    // Alone it has no namespaces: with prefixes it may not parse.
    roxmltree::Document::parse(&format!("<{}/>", tag.inside))
        .map_or_else(|_| format!("`<{}>`", tag.name()), |xml| label(xml.root_element()))
}

/// The byte that `position` is at.
fn offset_of(text: &str, position: TextPos) -> usize {
    let row = usize::try_from(position.row).unwrap_or(1).max(1);
    let column = usize::try_from(position.col).unwrap_or(1).max(1);
    let start: usize = text.split_inclusive('\n').take(row - 1).map(str::len).sum();
    let line = text.get(start..).unwrap_or("");
    start + line.char_indices().nth(column - 1).map_or(line.len(), |(at, _)| at)
}

/// Where the tag begins that is around or at `offset`.
fn tag_start(text: &str, offset: usize) -> usize {
    if text.get(offset..).is_some_and(|rest| rest.starts_with('<')) && !in_a_tag(text, offset) {
        return offset;
    }
    text.get(..offset).and_then(|before| before.rfind('<')).unwrap_or(offset)
}

/// Whether the last tag before `offset` has no end there.
fn in_a_tag(text: &str, offset: usize) -> bool {
    let before = text.get(..offset).unwrap_or("");
    before.rfind('<').is_some_and(|start| tags(before.get(start..).unwrap_or("")).any(|tag| tag.is_err()))
}

/// The beginning of that tag, on one line.
fn tag_at(text: &str, offset: usize) -> String {
    /// As much of a tag as one wants to read in a message, so that it stays a line.
    const SHOWN: usize = 60;
    let rest = text.get(tag_start(text, offset)..).unwrap_or("");
    let line = rest.lines().next().unwrap_or("");
    let tag: String = line.split_inclusive('>').next().unwrap_or("").chars().take(SHOWN).collect();
    format!("`{tag}`")
}

#[cfg(test)]
mod tests {
    use super::super::document::read;
    use super::*;
    use proptest::prelude::*;

    const UR5: &str = include_str!("../../../../config/robot/ur5.urdf");

    #[test]
    fn what_is_not_xml() {
        for (text, line, part) in [
            ("<robot name='r'>\n<link name=\"a\">\n</robot>", 3, "link \"a\" should be closed"),
            ("<robot name='r'>\n<link name=\"a\"/>", 1, "robot \"r\" is never closed"),
            ("<robot name='r'>\n<a:link name=\"a\">", 2, "nothing tells what `a:` is"),
            ("<robot>\n</robot>\n</link>", 3, "`</link>` closes nothing"),
            ("<robot>\n<link name=\"a\n</robot>", 2, "has no end"),
            ("<html/>", 1, "`<html>`"),
            ("<robot/>\n<robot/>", 2, "a URDF has one"),
            ("<robot/>\nhello", 2, "text behind the root"),
            ("\nhello <robot/>", 2, "text before `<robot>`"),
            ("nothing", 1, "no `<robot>`"),
            ("<robot>\n< link/>\n</robot>", 2, "`< link/>` is not a tag"),
            ("<robot>\n<link name=a/>\n</robot>", 2, "`<link name=a/>` is not a tag"),
            ("<robot>\n<link name='a'\nb='<'/>\n</robot>", 2, "`<link name='a'` is not a tag"),
            (
                "<robot>\n<link name='a' name='a'/></robot>",
                2,
                "`<link name='a' name='a'/>`: `name` is given twice",
            ),
            ("<robot>\n<a>&lol;</a></robot>", 2, "`&lol;` is not known"),
            ("<!DOCTYPE a [\n<!ENTITY lol 'l'>]><robot>\n<a>&lol;</a></robot>", 3, "`&lol;` is not known"),
            ("<!DOCTYPE a [ '\n<robot/>", 1, "has no end"),
            ("<robot>\n<a b='a & b'/></robot>", 2, "write `&amp;`"),
            ("<robot>\n\u{1}</robot>", 2, "U+0001"),
            ("<robot>\n<!-- a -- b --></robot>", 2, "`--`"),
            (
                "<robot><!-- </link> --><?x <y> ?>\n<link name='a'><inertial/></link></robot>",
                2,
                "link \"a\": ",
            ),
        ] {
            let XmlFault { line: found, message } = read(text).unwrap_err();
            assert!(message.contains(part), "{message}");
            assert_eq!(found, line, "{message}");
        }
    }

    #[test]
    fn prologs_are_passed_over() {
        for prolog in [
            "\n<?xml version='1.0'?>",
            "<?xml encoding='x'?>",
            "<!DOCTYPE robot>",
            "<!-- a --><?xml version='1.0'?>",
        ] {
            assert_eq!(read(&format!("{prolog}{UR5}")), read(UR5), "{prolog}");
        }
        assert!(!read(UR5).unwrap().links.is_empty());
    }

    fn answers(text: &str) -> Result<(), TestCaseError> {
        if let Err(fault) = read(text) {
            prop_assert!((1..=1 + text.matches('\n').count()).contains(&fault.line), "{fault:?}");
            prop_assert!(!fault.message.is_empty());
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn any_text_gives_an_answer(
            text in "[<>/!?&;:a-c\"'= \n\u{e4}-]{0,60}",
            (at, cut) in (0..UR5.len(), 0_usize..40),
        ) {
            answers(&text)?;
            answers(&format!("<robot>\n{text}</robot>"))?;
            answers(&UR5[..at])?;
            let end = (at + cut).min(UR5.len());
            answers(&format!("{}{text}{}", &UR5[..at], &UR5[end..]))?;
        }
    }
}
