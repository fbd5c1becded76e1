//! The stop word as a file of the instance: made by control before its first tick, and opened by those that request a stop.

use super::{BYTES, StopWord};
use crate::ipc::InstanceError;
use crate::ipc::runtime_dir::RuntimeDir;
use rustix::fs::{FallocateFlags, OFlags, fallocate, fstat};
use std::path::Path;
use std::sync::atomic::Ordering;

const FILE: &str = "stop";

impl StopWord {
    /// A new one in `place`; what lay there before is replaced.
    pub(in crate::ipc) fn create(place: &RuntimeDir, folder: &Path) -> Result<Self, InstanceError> {
        let file = place.new_file(FILE)?;
        let fault = |cause| InstanceError::Place { path: folder.join(FILE), cause };
        // Reserved, not only made that long: a page that is missing when a tick looks at it would end the process.
        fallocate(&file, FallocateFlags::empty(), 0, BYTES as u64).map_err(fault)?;
        let word = Self::map(&file).map_err(fault)?;
        word.page().control_process.store(std::process::id(), Ordering::Relaxed);
        Ok(word)
    }

    /// That of a running control; `None` when there is none, or none yet.
    pub(in crate::ipc) fn open(place: &RuntimeDir, folder: &Path) -> Result<Option<Self>, InstanceError> {
        let Some(file) = place.open_file(FILE, OFlags::RDWR)? else { return Ok(None) };
        let fault = |cause| InstanceError::Place { path: folder.join(FILE), cause };
        // Control fills a file before it gives it this name; one that is shorter is none of ours.
        if fstat(&file).map_err(fault)?.st_size < BYTES as i64 {
            return Ok(None);
        }
        Self::map(&file).map(Some).map_err(fault)
    }
}
