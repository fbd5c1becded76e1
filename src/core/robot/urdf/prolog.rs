//! The prolog of an XML text: what may stand before its first element. It holds nothing that describes a robot.

use std::borrow::Cow;

/// The `text` with blanks, as many bytes and lines of them, for all that stands before its first element: the
/// declaration, which people also put behind an empty line, comments, and a document type. Entities that this one
/// defines are unknown then, so that none can grow without bounds.
pub(super) fn without_prolog(text: &str) -> Cow<'_, str> {
    let mut end = 0;
    while let Some(length) = text.get(end..).and_then(part_length) {
        end += length;
    }
    let (prolog, rest) = text.split_at(end);
    if prolog.is_empty() {
        return Cow::Borrowed(text);
    }
    let mut blank = String::with_capacity(text.len());
    for c in prolog.chars() {
        if c == '\n' {
            blank.push(c);
        } else {
            blank.extend(std::iter::repeat_n(' ', c.len_utf8()));
        }
    }
    Cow::Owned(blank + rest)
}

/// Bytes of the blanks, comment, declaration or document type at the beginning of `text`.
fn part_length(text: &str) -> Option<usize> {
    let blanks = text.len() - text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']).len();
    if blanks > 0 {
        return Some(blanks);
    }
    for (opening, closing) in [("<!--", "-->"), ("<?", "?>")] {
        if let Some(behind) = text.strip_prefix(opening) {
            return behind.find(closing).map(|at| opening.len() + at + closing.len());
        }
    }
    if text.starts_with("<!DOCTYPE") { document_type_length(text) } else { None }
}

fn document_type_length(text: &str) -> Option<usize> {
    let (mut quote, mut brackets) = (None, 0_usize);
    for (at, c) in text.char_indices() {
        match (quote, c) {
            (Some(open), c) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[') => brackets += 1,
            (None, ']') => brackets = brackets.saturating_sub(1),
            (None, '>') if brackets == 0 => return Some(at + 1),
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_lines_stay_where_they_are() {
        for prolog in [
            "",
            "\u{feff}",
            "\n <?xml version='1.0'?>\n",
            "<!-- ä -- > <robot> --><?xml-style a?>",
            "<!DOCTYPE robot SYSTEM \"a>b.dtd\">\n",
            "<!DOCTYPE r [\n<!ENTITY a '>]'>\n]>",
        ] {
            let text = format!("{prolog}<robot>\n<!-- a --></robot>");
            let blanked = without_prolog(&text);
            assert_eq!(blanked.len(), text.len());
            assert_eq!(blanked.matches('\n').count(), text.matches('\n').count());
            assert_eq!(blanked.trim_start(), "<robot>\n<!-- a --></robot>", "{prolog}");
        }
        for text in ["<!-- a", "<!DOCTYPE r [ '", "text", "<robot"] {
            assert_eq!(without_prolog(text), text);
        }
    }
}
