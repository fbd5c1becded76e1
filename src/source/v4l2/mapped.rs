//! Memory of a driver in this process.

#![allow(unsafe_code)]

use rustix::fd::OwnedFd;
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// A mapped buffer.
#[derive(Debug)]
pub(super) struct Mapped {
    start: *mut u8,
    length: usize,
}

impl Mapped {
    pub(super) fn new(fd: &OwnedFd, length: usize, offset: u64) -> Result<Self, Errno> {
        // SAFETY: a new mapping at an address of the kernel's choice; nothing of ours lies there.
        let start =
            unsafe { mmap(std::ptr::null_mut(), length, ProtFlags::READ, MapFlags::SHARED, fd, offset) }?;
        Ok(Self { start: start.cast(), length })
    }

    pub(super) fn bytes(&self) -> &[u8] {
        // SAFETY: mapped for reading as long as `self` lives. The driver writes to a buffer only while it has it, and what
        // it has is not read: see `Device::payload`.
        unsafe { std::slice::from_raw_parts(self.start, self.length) }
    }
}

impl Drop for Mapped {
    fn drop(&mut self) {
        // SAFETY: our own mapping, which nobody borrows any more.
        let _ = unsafe { munmap(self.start.cast(), self.length) };
    }
}
