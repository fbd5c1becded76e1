//! The types of values, by the names that the protocol gives them.

/// Type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataType {
    /// One byte, 0 or 1.
    Bool,
    /// One byte.
    Uint8,
    /// Four bytes.
    Uint32,
    /// Eight bytes.
    Uint64,
    /// Four bytes with a sign.
    Int32,
    /// Eight bytes with a point.
    Double,
    /// Three of these.
    Vector3D,
    /// Six of these.
    Vector6D,
    /// Six of four bytes with a sign.
    Vector6Int32,
    /// Six of four bytes.
    Vector6Uint32,
}

impl DataType {
    const ALL: [(Self, &'static str, usize); 10] = [
        (Self::Bool, "BOOL", 1),
        (Self::Uint8, "UINT8", 1),
        (Self::Uint32, "UINT32", 4),
        (Self::Uint64, "UINT64", 8),
        (Self::Int32, "INT32", 4),
        (Self::Double, "DOUBLE", 8),
        (Self::Vector3D, "VECTOR3D", 24),
        (Self::Vector6D, "VECTOR6D", 48),
        (Self::Vector6Int32, "VECTOR6INT32", 24),
        (Self::Vector6Uint32, "VECTOR6UINT32", 24),
    ];

    /// The type of a name.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, known, _)| *known == name).map(|(kind, ..)| *kind)
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(kind, ..)| *kind == self).map_or("", |(_, name, _)| name)
    }

    /// Its bytes.
    #[must_use]
    pub fn size(self) -> usize {
        Self::ALL.iter().find(|(kind, ..)| *kind == self).map_or(0, |(.., size)| *size)
    }
}
