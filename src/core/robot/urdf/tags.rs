//! The tags of an XML text in their order, with their offsets, in one pass and without recursion. They are read before a text is parsed, and
//! where it cannot be parsed.

/// A tag between its brackets, and where it begins and ends in the text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tag<'a> {
    /// What stands between `<` and `>`.
    pub(super) inside: &'a str,
    /// Offset of the `<`.
    pub(super) start: usize,
    /// Offset behind the `>`.
    pub(super) end: usize,
}

impl<'a> Tag<'a> {
    /// The element's name; with the stroke of a closing tag.
    pub(super) fn name(&self) -> &'a str {
        let end = self.inside.char_indices().find(|(i, c)| c.is_whitespace() || (*c == '/' && *i > 0));
        self.inside.get(..end.map_or(self.inside.len(), |(i, _)| i)).unwrap_or("")
    }

    pub(super) fn closes(&self) -> bool {
        self.inside.starts_with('/')
    }

    /// Whether it is an element without content: `<link/>`.
    pub(super) fn is_empty_element(&self) -> bool {
        self.inside.ends_with('/')
    }

    /// Whether it is a comment, a declaration or an instruction.
    pub(super) fn is_no_element(&self) -> bool {
        self.inside.starts_with(['!', '?'])
    }
}

/// All tags, comments and declarations of `text`; the offset of a `<` that nothing closes ends them.
pub(super) fn tags(text: &str) -> impl Iterator<Item = Result<Tag<'_>, usize>> {
    let mut at = 0;
    let mut broken = false;
    std::iter::from_fn(move || {
        let start = at + text.get(at..).filter(|_| !broken)?.find('<')?;
        let rest = text.get(start..)?;
        let Some(length) = tag_length(rest) else {
            broken = true;
            return Some(Err(start));
        };
        at = start + length;
        Some(Ok(Tag { inside: rest.get(1..length - 1)?, start, end: at }))
    })
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

    #[test]
    fn tags_attributes_and_what_is_between() {
        let text = "<?xml version='1.0'?><a x = \"1 > 0\" y='2'>text<!-- <b> --><c/></a>";
        let found: Vec<_> = tags(text).map(Result::unwrap).collect();
        let names: Vec<_> = found.iter().map(Tag::name).collect();
        assert_eq!(names, ["?xml", "a", "!--", "c", "/a"]);
        assert_eq!(found[1].inside, "a x = \"1 > 0\" y='2'");
        assert!(found[3].is_empty_element() && found[4].closes() && found[2].is_no_element());
        assert_eq!(&text[found[3].start..found[3].end], "<c/>");
        assert_eq!(tags("<a><b c='>").last(), Some(Err(3)));
    }
}
