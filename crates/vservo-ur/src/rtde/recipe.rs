//! What a stream of data consists of: names that were asked for, types that were answered, and the place of each.

use super::types::DataType;
use super::wire::{Reader, WireError};
use crate::Joints;

/// The answer to a set-up: the recipe's number, and a type for each variable, or why there is none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SetupReply {
    /// Number of the recipe; 0 of one that was refused.
    pub id: u8,
    /// The words of the answer, one a variable.
    pub words: Vec<String>,
}

impl SetupReply {
    /// Reads the payload of an answer.
    ///
    /// # Errors
    /// When it is none.
    pub fn read(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        let id = reader.u8("recipe")?;
        let words = String::from_utf8_lossy(reader.rest());
        let words = words.split(',').map(|word| word.trim().to_owned()).filter(|word| !word.is_empty());
        Ok(Self { id, words: words.collect() })
    }

    /// The variables of `names` that have the answer `word`.
    #[must_use]
    pub fn named(&self, word: &str, names: &[String]) -> Vec<String> {
        let pairs = names.iter().zip(&self.words);
        pairs.filter(|(_, answer)| answer.as_str() == word).map(|(name, _)| name.clone()).collect()
    }
}

/// Names, types and places of the values of a data package.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    id: u8,
    fields: Vec<(String, DataType, usize)>,
    size: usize,
}

impl Recipe {
    /// The recipe of an answer.
    ///
    /// # Errors
    /// When the answer tells types that are none, or not one a variable.
    pub fn new(names: &[String], reply: &SetupReply) -> Result<Self, WireError> {
        if names.len() != reply.words.len() {
            return Err(WireError::Count { asked: names.len(), got: reply.words.len() });
        }
        let (mut fields, mut size) = (Vec::with_capacity(names.len()), 1);
        for (name, word) in names.iter().zip(&reply.words) {
            let kind = DataType::of(word)
                .ok_or_else(|| WireError::ValueType { variable: name.clone(), name: word.clone() })?;
            fields.push((name.clone(), kind, size));
            size += kind.size();
        }
        Ok(Self { id: reply.id, fields, size })
    }

    /// Its number.
    #[must_use]
    pub fn id(&self) -> u8 {
        self.id
    }

    /// Bytes of a payload, its number included.
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }

    /// Whether a payload is one of this recipe.
    #[must_use]
    pub fn fits(&self, payload: &[u8]) -> bool {
        payload.len() == self.size && payload.first() == Some(&self.id)
    }

    /// The names with their types, in order.
    pub fn fields(&self) -> impl Iterator<Item = (&str, DataType)> {
        self.fields.iter().map(|(name, kind, _)| (name.as_str(), *kind))
    }

    /// The place of a variable of this type, for [`double`](Self::double) and its like.
    #[must_use]
    pub fn place(&self, name: &str, kind: DataType) -> Option<usize> {
        self.fields.iter().find(|(own, type_, _)| own == name && *type_ == kind).map(|(.., at)| *at)
    }

    /// A double at a place; NaN where the payload has none.
    #[must_use]
    pub fn double(payload: &[u8], place: usize) -> f64 {
        payload.get(place..).and_then(|rest| Reader::new(rest).f64("").ok()).unwrap_or(f64::NAN)
    }

    /// Six doubles at a place; NaN where the payload has none.
    #[must_use]
    pub fn joints(payload: &[u8], place: usize) -> Joints {
        payload.get(place..).and_then(|rest| Reader::new(rest).joints("").ok()).unwrap_or([f64::NAN; 6])
    }

    /// A number of four bytes at a place; -1 where the payload has none.
    #[must_use]
    pub fn int(payload: &[u8], place: usize) -> i32 {
        payload.get(place..).and_then(|rest| Reader::new(rest).i32("").ok()).unwrap_or(-1)
    }
}
