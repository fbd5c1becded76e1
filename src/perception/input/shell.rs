//! Words as a shell takes them.

/// `word` as one word of a POSIX shell's command line.
#[must_use]
pub fn shell_word(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_the_word_back() {
        let words =
            ["plain", "a b", "it's", "", "$HOME `id` \\", "q=[0.0, 1]", "\"x\"", "*", "~", "a\nb", "--set"];
        for word in words {
            let line = format!("printf %s {}", shell_word(word));
            let output = std::process::Command::new("sh").args(["-c", &line]).output().unwrap();
            assert_eq!(String::from_utf8(output.stdout).unwrap(), word, "{line}");
        }
        assert_eq!(shell_word("servo.gain_1_s=3"), "servo.gain_1_s=3");
    }
}
