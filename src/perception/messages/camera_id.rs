//! Which camera of a cell.

use std::fmt;

/// A camera's number: its place in the run file's list, from 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraId(pub u8);

impl CameraId {
    /// The only camera of most cells.
    pub const FIRST: Self = Self(0);
}

impl fmt::Display for CameraId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl From<CameraId> for u32 {
    fn from(id: CameraId) -> Self {
        id.0.into()
    }
}
