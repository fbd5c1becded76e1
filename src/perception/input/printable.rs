//! Makes text from outside printable in one line of a terminal.

use std::fmt::Write;

/// Longest line, characters; of a longer one beginning and end are kept. Chosen by hand: the longest of our own, a list of keys, has
/// some five hundred.
const LONGEST: usize = 1000;
const END: usize = 300;

/// `text` in one line: control characters (line breaks, escape sequences) and marks that turn the writing direction are
/// written as escapes, and the middle of what is too long to be read is left out.
#[must_use]
pub fn printable(text: &str) -> String {
    let mut line = String::with_capacity(text.len().min(4 * LONGEST));
    let count = text.chars().count();
    if count <= LONGEST {
        text.chars().for_each(|c| push(&mut line, c));
    } else {
        text.chars().take(LONGEST - END).for_each(|c| push(&mut line, c));
        line.push_str(" ... ");
        text.chars().skip(count - END).for_each(|c| push(&mut line, c));
    }
    line
}

fn push(line: &mut String, c: char) {
    match c {
        '\n' => line.push_str("\\n"),
        '\r' => line.push_str("\\r"),
        '\t' => line.push_str("\\t"),
        c if is_hidden(c) => {
            let _ = write!(line, "\\u{{{:x}}}", u32::from(c)); // a String takes everything
        }
        c => line.push(c),
    }
}

fn is_hidden(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A number as people write it: without the hundreds of digits that a huge or tiny one has.
#[must_use]
pub fn number(value: f64) -> String {
    let size = value.abs();
    // Chosen by hand: outside of this range an exponent is shorter than the zeros.
    if size >= 1e12 || (size > 0.0 && size < 1e-6) { format!("{value:e}") } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn control_characters_become_visible_and_the_rest_stays() {
        assert_eq!(printable("Gelenk 1: größer als 3 µm"), "Gelenk 1: größer als 3 µm");
        assert_eq!(printable("a\u{1b}[31m\r\n\tb\u{9b}\u{202e}"), "a\\u{1b}[31m\\r\\n\\tb\\u{9b}\\u{202e}");
        assert_eq!(printable(&"x".repeat(LONGEST)), "x".repeat(LONGEST));
        let long = "a".repeat(LONGEST) + &"z".repeat(END);
        assert_eq!(printable(&long), "a".repeat(LONGEST - END) + " ... " + &"z".repeat(END));
    }

    #[test]
    fn numbers_are_short() {
        let written = [1e308, -1e-308, 0.0, -1.0, 1e9, 0.001, f64::NAN, f64::NEG_INFINITY].map(number);
        assert_eq!(written, ["1e308", "-1e-308", "0", "-1", "1000000000", "0.001", "NaN", "-inf"]);
    }

    proptest! {
        #[test]
        fn any_text_becomes_one_bounded_line(text in "(?s).{0,1500}") {
            let line = printable(&text);
            prop_assert!(!line.chars().any(is_hidden));
            prop_assert!(line.chars().count() <= 10 * LONGEST + 5);
        }
    }
}
