//! Why the program of an external drive has ended, why the guardian has stopped the arm, and why the supervisor ends a run: texts that they leave in the instance's
//! directory, for the summary of the run and its recording.

use super::Instance;
use super::runtime_dir::RuntimeDir;
use rustix::fs::OFlags;
use std::fs::File;
use std::io::{Read, Write};

/// The files' names.
const OF_DRIVE: &str = "drive.txt";
const OF_GUARDIAN: &str = "guardian.txt";
const OF_SUPERVISOR: &str = "supervisor.txt";
/// The most that is read of one, bytes. Chosen by hand: some sentences.
const MOST: u64 = 2000;

impl Instance {
    /// Leaves the reason of a drive's end. What cannot be left stands on stderr all the same.
    pub fn leave_words_of_drive(&self, words: &str) {
        self.leave_words(OF_DRIVE, words);
    }

    /// The reason that a drive has left, in one line.
    #[must_use]
    pub fn words_of_drive(&self) -> Option<String> {
        self.words(OF_DRIVE)
    }

    /// Leaves the reason of the guardian's stop. What cannot be left stands on stderr all the same.
    pub fn leave_words_of_guardian(&self, words: &str) {
        self.leave_words(OF_GUARDIAN, words);
    }

    /// The reason that the guardian has left, in one line.
    #[must_use]
    pub fn words_of_guardian(&self) -> Option<String> {
        self.words(OF_GUARDIAN)
    }

    /// Leaves the reason for which the supervisor ends the run before its time: a process that died or hangs.
    pub fn leave_words_of_supervisor(&self, words: &str) {
        self.leave_words(OF_SUPERVISOR, words);
    }

    /// The reason that the supervisor has left, in one line.
    #[must_use]
    pub fn words_of_supervisor(&self) -> Option<String> {
        self.words(OF_SUPERVISOR)
    }

    fn leave_words(&self, name: &str, words: &str) {
        if let Ok(Some(place)) = RuntimeDir::open(&self.directory_name())
            && let Ok(file) = place.new_file(name)
        {
            let _ = File::from(file).write_all(words.as_bytes());
        }
    }

    fn words(&self, name: &str) -> Option<String> {
        let place = RuntimeDir::open(&self.directory_name()).ok()??;
        let file = place.open_file(name, OFlags::RDONLY).ok()??;
        let mut bytes = Vec::new();
        File::from(file).take(MOST).read_to_end(&mut bytes).ok()?;
        let words = String::from_utf8_lossy(&bytes).split_whitespace().collect::<Vec<_>>().join(" ");
        (!words.is_empty()).then_some(words)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_left_and_found_in_one_line() {
        let instance: Instance = format!("words-{}", std::process::id()).parse().unwrap();
        assert_eq!(instance.words_of_drive(), None);
        instance.leave_words_of_drive("nowhere");
        assert_eq!(instance.words_of_drive(), None, "there is no directory yet");
        instance.check_place().unwrap();
        instance.leave_words_of_drive("protective stop:\n  its \u{1b}cause\n");
        assert_eq!(instance.words_of_drive().as_deref(), Some("protective stop: its \u{1b}cause"));
        assert_eq!(instance.words_of_guardian(), None);
        instance.leave_words_of_drive(" \n");
        assert_eq!(instance.words_of_drive(), None);
        instance.remove_leftovers(None);
        assert!(!instance.directory().exists());
    }
}
