//! Which files this program has read, so that it writes none of them: a result must not take the place of what it was made of.
//!
//! A file is known by its device, its number there and when it was made, whatever links and names lead to it.

use std::collections::BTreeSet;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Device, number of the file on it (which a later file may have again), and when it was made, where the file system knows: as
/// text, because it is compared and nothing else.
type FileId = (u64, u64, String);

static USED: Mutex<BTreeSet<FileId>> = Mutex::new(BTreeSet::new());

fn id(file: &Metadata) -> FileId {
    (file.dev(), file.ino(), format!("{:?}", file.created().ok()))
}

/// This file is read.
pub fn note(file: &Metadata) {
    USED.lock().unwrap_or_else(PoisonError::into_inner).insert(id(file));
}

/// The file at `path` is read, or those of the folder there; one that is not there is told by who opens it.
pub fn note_path(path: &Path) {
    let files = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
    for found in files.chain([path.to_path_buf()]).filter_map(|path| std::fs::metadata(path).ok()) {
        if found.is_file() {
            note(&found);
        }
    }
}

/// Whether this file was read.
#[must_use]
pub fn is_used(file: &Metadata) -> bool {
    USED.lock().unwrap_or_else(PoisonError::into_inner).contains(&id(file))
}
