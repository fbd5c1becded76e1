//! Suggestions for misspelt words.

/// A candidate is suggested when at most this many letters, and one of this many, must be changed. Chosen by hand: more changes
/// would suggest unrelated short words.
const MAX_LETTERS: usize = 3;
const LETTERS_FOR_ONE: usize = 3;

/// The candidate that is most like `word`, if one is like it.
#[must_use]
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let allowed = (word.chars().count() / LETTERS_FOR_ONE).clamp(1, MAX_LETTERS);
    let lower = word.to_lowercase();
    candidates
        .into_iter()
        .map(|candidate| (strsim::osa_distance(&lower, candidate), candidate))
        .filter(|(distance, _)| *distance <= allowed)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_of_a_finger_are_understood_and_other_words_are_not() {
        let words = ["run", "serve", "detect", "calibrate", "experiment"];
        for (word, meant) in [
            ("rum", Some("run")),
            ("Run", Some("run")),
            ("rnu", Some("run")),
            ("detct", Some("detect")),
            ("calbirate", Some("calibrate")),
            ("experimnets", Some("experiment")),
            ("ur5", None),
            ("", None),
            ("something", None),
        ] {
            assert_eq!(nearest(word, words), meant, "{word}");
        }
    }
}
