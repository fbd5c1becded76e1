//! The page: one file that loads nothing else, in the style of the pages of reports.

use crate::report::page::document;
use std::sync::LazyLock;

/// What this page has beside the style of all pages.
const STYLE: &str = include_str!("page.css");
const BODY: &str = include_str!("page.html");
const SCRIPT: &str = concat!("<script>", include_str!("page.js"), "</script>\n");

/// The whole page.
pub(super) static PAGE: LazyLock<String> =
    LazyLock::new(|| document("vservo watch", STYLE, &[BODY.to_owned(), SCRIPT.to_owned()]));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_loads_nothing_of_others() {
        for word in
            ["http://", "https://", "<link rel=\"stylesheet", "@import", "src=\"//", "innerHTML", "eval("]
        {
            assert!(!PAGE.replace("http://www.w3.org/2000/svg", "").contains(word), "{word}");
        }
        assert!(PAGE.contains("EventSource") && PAGE.contains("prefers-color-scheme"));
    }

    /// Every place that the script fills is there, once.
    #[test]
    fn the_script_finds_what_it_fills() {
        for part in SCRIPT.split("at('").skip(1) {
            let id = part.split('\'').next().unwrap();
            assert_eq!(BODY.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
        }
    }
}
