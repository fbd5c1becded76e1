//! What the processes of an instance must have in common: each writes it into the file of its role's lock, behind its sign of life, where the
//! others read it.
//!
//! A process writes before it reads those of the others, so that of two which start at once one at least sees the other.

use super::{Instance, Role};
use rustix::io::{pread, pwrite};
use std::collections::BTreeMap;
use std::os::fd::AsFd;

/// Where it begins in the file: in the next cache line, since the sign of life before it, of 8 bytes, is written ten times a second.
const AT: u64 = 64;
/// Longer texts are ignored, so that a damaged length allocates little. Chosen by hand: four cameras need some 10 kB.
const MAX_BYTES: usize = 1 << 20;

/// Names with their values, as text.
pub type Agreement = BTreeMap<String, String>;

/// One name of which two processes have other values; `None` where it has none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Disagreement {
    /// The process that was there first.
    pub role: Role,
    /// The name.
    pub key: String,
    /// Its value there.
    pub there: Option<String>,
    /// Its value in this process.
    pub here: Option<String>,
}

/// Writes into the file of a lock. A file system that is full leaves it out: nothing is compared then.
pub(super) fn write(file: impl AsFd, agreement: &Agreement) {
    let text: String =
        agreement.iter().map(|(key, value)| format!("{key}\t{}\n", value.replace('\n', " "))).collect();
    let written = pwrite(&file, text.as_bytes(), AT + 8);
    if written == Ok(text.len()) {
        // Its length last: what has none yet is not read.
        let _ = pwrite(&file, &(text.len() as u64).to_le_bytes(), AT);
    }
}

/// Reads what [`write`] wrote; `None` before.
pub(super) fn read(file: impl AsFd) -> Option<Agreement> {
    let mut length = [0; 8];
    let complete = pread(&file, &mut length, AT) == Ok(8);
    let length = usize::try_from(u64::from_le_bytes(length))
        .ok()
        .filter(|n| complete && (1..=MAX_BYTES).contains(n))?;
    let mut text = vec![0; length];
    (pread(&file, &mut text, AT + 8) == Ok(length)).then_some(())?;
    let line = |line: &str| line.split_once('\t').map(|(key, value)| (key.to_owned(), value.to_owned()));
    Some(String::from_utf8(text).ok()?.lines().filter_map(line).collect())
}

impl Instance {
    /// Where the running processes of this instance, beside `own`, differ from `agreement`.
    #[must_use]
    pub fn disagreements(&self, own: Role, agreement: &Agreement) -> Vec<Disagreement> {
        let mut all = Vec::new();
        for role in Role::all().filter(|role| *role != own) {
            let Some(theirs) = self.agreement_of(role) else { continue };
            let keys = agreement.keys().chain(theirs.keys().filter(|key| !agreement.contains_key(*key)));
            all.extend(keys.filter(|key| agreement.get(*key) != theirs.get(*key)).map(|key| Disagreement {
                role,
                key: key.clone(),
                there: theirs.get(key).cloned(),
                here: agreement.get(key).cloned(),
            }));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agreement(pairs: &[(&str, &str)]) -> Agreement {
        pairs.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect()
    }

    #[test]
    fn what_differs_is_named_while_the_other_lives() {
        let place: Instance = format!("u-agree-{}", std::process::id()).parse().unwrap();
        let ours = agreement(&[
            ("camera.rate_hz", "25.0"),
            ("run.clock", "\"lockstep\""),
            ("target.kind", "\"tags\""),
        ]);
        let theirs = agreement(&[("camera.rate_hz", "50.0"), ("run.clock", "\"lockstep\""), ("stereo", "1")]);
        let lock = place.lock(Role::Control).unwrap();
        let heartbeat = lock.heartbeat().unwrap();
        assert_eq!(place.disagreements(Role::Control, &ours), []);
        assert_eq!(place.disagreements(Role::Supervisor, &ours), []); // nothing is said yet
        lock.state(&theirs);
        heartbeat.beat(); // leaves it alone
        let mut found = place.disagreements(Role::Supervisor, &ours);
        found.sort_by(|a, b| a.key.cmp(&b.key));
        let differs = |key: &str, there: Option<&str>, here: Option<&str>| Disagreement {
            role: Role::Control,
            key: key.into(),
            there: there.map(Into::into),
            here: here.map(Into::into),
        };
        assert_eq!(
            found,
            [
                differs("camera.rate_hz", Some("50.0"), Some("25.0")),
                differs("stereo", Some("1"), None),
                differs("target.kind", None, Some("\"tags\"")),
            ]
        );
        assert_eq!(place.disagreements(Role::Supervisor, &theirs), []);
        drop((lock, heartbeat));
        assert_eq!(place.disagreements(Role::Supervisor, &ours), []); // who is dead has no say
        let _next = place.lock(Role::Control).unwrap();
        assert_eq!(place.disagreements(Role::Supervisor, &ours), []); // nor through the one who takes its role next
        drop(_next);
        place.remove_leftovers(None);
    }
}
