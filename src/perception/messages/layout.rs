//! Layouts of the records: what each field is called, where it lies and what it holds, taken from the one definition of the record. What other
//! programs read records by is generated from these tables, and the bytes of a recording are written and read along them.
//!
//! Fields of a record lie one behind the other without a gap, so that its memory, its bytes here and what XCDR1 (OMG DDS-XTypes 1.3, 7.4.1)
//! makes of it on a little-endian machine are the same. A test holds every record to that.

use crate::time::MonoNs;

/// What a field holds, or each entry of a field that is an array.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FieldType {
    /// 8 bits without sign.
    U8,
    /// 32 bits without sign.
    U32,
    /// 64 bits without sign.
    U64,
    /// 64 bits with sign.
    I64,
    /// Floating point of double precision.
    F64,
    /// Another record.
    Record(&'static RecordLayout),
}

impl FieldType {
    /// Bytes of one.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
            Self::Record(layout) => layout.bytes,
        }
    }
}

/// One field of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordField {
    /// Its name.
    pub name: &'static str,
    /// What it means, with its unit, as the documentation of the field says it.
    pub about: &'static str,
    /// Where it begins in the record, bytes.
    pub offset: usize,
    /// What it holds.
    pub kind: FieldType,
    /// Entries of an array; `None` where it is none.
    pub count: Option<usize>,
}

/// All fields of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordLayout {
    /// The versioned name by which programs of any language bind: `vservo.NAME.vN`.
    pub type_name: &'static str,
    /// Its name in this crate.
    pub name: &'static str,
    /// What it is, as its documentation says it.
    pub about: &'static str,
    /// Its length, bytes.
    pub bytes: usize,
    /// Its fields, in their order in memory.
    pub fields: &'static [RecordField],
}

/// A number of the protocol that has a name: a bit of a field of flags, or a kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NamedCode {
    /// Its name.
    pub name: &'static str,
    /// What it means.
    pub about: &'static str,
    /// The number.
    pub code: u32,
}

/// A value that a field of a record can hold, as little-endian bytes.
pub trait FieldValue: Copy {
    /// What it is.
    const KIND: FieldType;
    /// Entries, of an array.
    const COUNT: Option<usize> = None;
    /// Appends its bytes.
    fn put(&self, bytes: &mut Vec<u8>);
    /// Takes it from the front of `bytes`; `None` where there are too few.
    fn take(bytes: &mut &[u8]) -> Option<Self>;
}

/// A record that travels between processes.
pub trait MessageRecord: FieldValue {
    /// Its fields.
    const LAYOUT: &'static RecordLayout;

    /// The record whose bytes these are; `None` where they are too few or too many.
    #[must_use]
    fn of_bytes(mut bytes: &[u8]) -> Option<Self> {
        Self::take(&mut bytes).filter(|_| bytes.is_empty())
    }
}

macro_rules! number {
    ($Type:ty, $Kind:ident) => {
        impl FieldValue for $Type {
            const KIND: FieldType = FieldType::$Kind;

            fn put(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            fn take(bytes: &mut &[u8]) -> Option<Self> {
                let (first, rest) = bytes.split_first_chunk()?;
                *bytes = rest;
                Some(Self::from_le_bytes(*first))
            }
        }
    };
}

number!(u8, U8);
number!(u32, U32);
number!(u64, U64);
number!(i64, I64);
number!(f64, F64);

impl FieldValue for MonoNs {
    const KIND: FieldType = FieldType::I64;

    fn put(&self, bytes: &mut Vec<u8>) {
        self.0.put(bytes);
    }

    fn take(bytes: &mut &[u8]) -> Option<Self> {
        i64::take(bytes).map(Self)
    }
}

impl<T: FieldValue + Default, const N: usize> FieldValue for [T; N] {
    const KIND: FieldType = T::KIND;
    const COUNT: Option<usize> = Some(N);

    fn put(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|entry| entry.put(bytes));
    }

    fn take(bytes: &mut &[u8]) -> Option<Self> {
        let mut all = [T::default(); N];
        for entry in &mut all {
            *entry = T::take(bytes)?;
        }
        Some(all)
    }
}

/// Defines a record under its versioned type name, with its layout.
macro_rules! record {
    (
        $type_name:literal,
        $(#[doc = $about:literal])+
        #[derive($($derived:ident),+)]
        pub struct $Name:ident {
            $($(#[doc = $what:literal])+ pub $field:ident: $Type:ty,)+
        }
    ) => {
        $(#[doc = $about])+
        #[repr(C)]
        #[derive($($derived),+)]
        #[cfg_attr(feature = "transport", derive(ZeroCopySend), type_name($type_name))]
        pub struct $Name {
            $($(#[doc = $what])+ pub $field: $Type,)+
        }

        impl $crate::messages::FieldValue for $Name {
            const KIND: $crate::messages::FieldType =
                $crate::messages::FieldType::Record(<Self as $crate::messages::MessageRecord>::LAYOUT);

            fn put(&self, bytes: &mut Vec<u8>) {
                $($crate::messages::FieldValue::put(&self.$field, bytes);)+
            }

            fn take(bytes: &mut &[u8]) -> Option<Self> {
                Some(Self { $($field: $crate::messages::FieldValue::take(bytes)?),+ })
            }
        }

        impl $crate::messages::MessageRecord for $Name {
            const LAYOUT: &'static $crate::messages::RecordLayout = &$crate::messages::RecordLayout {
                type_name: $type_name,
                name: stringify!($Name),
                about: concat!($($about),+),
                bytes: std::mem::size_of::<Self>(),
                fields: &[$($crate::messages::RecordField {
                    name: stringify!($field),
                    about: concat!($($what),+),
                    offset: std::mem::offset_of!(Self, $field),
                    kind: <$Type as $crate::messages::FieldValue>::KIND,
                    count: <$Type as $crate::messages::FieldValue>::COUNT,
                }),+],
            };
        }
    };
}

/// Defines the named numbers of a field, and the list of them.
macro_rules! named_codes {
    (
        $(#[doc = $about:literal])+
        pub mod $name:ident {
            $($(#[doc = $what:literal])+ pub const $NAME:ident: u32 = $code:expr;)+
        }
    ) => {
        $(#[doc = $about])+
        pub mod $name {
            $($(#[doc = $what])+ pub const $NAME: u32 = $code;)+

            /// All of them, in their order.
            pub const ALL: &[$crate::messages::NamedCode] = &[
                $($crate::messages::NamedCode { name: stringify!($NAME), about: concat!($($what),+), code: $code }),+
            ];
        }
    };
}

pub(super) use named_codes;
pub(super) use record;
