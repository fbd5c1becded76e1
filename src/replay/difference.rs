//! The first field in which two records differ.

use crate::messages::{FieldType, FieldValue, MessageRecord, RecordLayout};
use crate::time::MonoNs;
use std::fmt;

/// Where what was replayed is not what was recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The topic of the record.
    pub topic: String,
    /// Which: the tick, or the frame.
    pub number: u64,
    /// The instant that it is about.
    pub stamp: MonoNs,
    /// The field, `q_r[1]`.
    pub field: String,
    /// Its value in the recording.
    pub recorded: String,
    /// Its value now.
    pub replayed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, number, stamp, field, recorded, replayed } = self;
        let what = if topic.ends_with("/measurement") { "frame" } else { "tick" };
        write!(f, "{topic}, {what} {number} at {} ns: {field} was {recorded}, and is {replayed}", stamp.0)
    }
}

/// The first field in whose bits two records differ: its name, and both values.
#[must_use]
pub fn difference<T: MessageRecord>(recorded: &T, replayed: &T) -> Option<(String, String, String)> {
    let (mut a, mut b) = (Vec::new(), Vec::new());
    recorded.put(&mut a);
    replayed.put(&mut b);
    within(T::LAYOUT, &a, &b)
}

fn within(layout: &RecordLayout, a: &[u8], b: &[u8]) -> Option<(String, String, String)> {
    for field in layout.fields {
        let bytes = field.kind.bytes();
        for i in 0..field.count.unwrap_or(1) {
            let begin = field.offset + i * bytes;
            let (a, b) = (a.get(begin..begin + bytes)?, b.get(begin..begin + bytes)?);
            if a == b {
                continue;
            }
            let name = field.count.map_or(field.name.to_owned(), |_| format!("{}[{i}]", field.name));
            return match field.kind {
                FieldType::Record(inner) => {
                    within(inner, a, b).map(|(field, a, b)| (format!("{name}.{field}"), a, b))
                }
                kind => Some((name, text(kind, a), text(kind, b))),
            };
        }
    }
    None
}

/// A number with all its digits.
fn text(kind: FieldType, mut bytes: &[u8]) -> String {
    let bytes = &mut bytes;
    match kind {
        FieldType::U8 => u8::take(bytes).map(|x| x.to_string()),
        FieldType::U32 => u32::take(bytes).map(|x| x.to_string()),
        FieldType::U64 => u64::take(bytes).map(|x| x.to_string()),
        FieldType::I64 => i64::take(bytes).map(|x| x.to_string()),
        FieldType::F64 => f64::take(bytes).map(|x| format!("{x:?}")),
        FieldType::Record(_) => None,
    }
    .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Measurement, TraceMsg};

    #[test]
    fn the_first_bit_that_differs_is_named_with_both_values() {
        let trace = TraceMsg { q_r: [0.1; 7], ..TraceMsg::default() };
        let mut other = trace;
        assert_eq!(difference(&trace, &other), None);
        other.q_r[3] = 0.1 + f64::EPSILON / 8.0;
        other.qd_r[0] = 1.0;
        let wanted = ("q_r[3]".into(), "0.1".into(), "0.10000000000000003".into());
        assert_eq!(difference(&trace, &other), Some(wanted));
        let nan = TraceMsg { feature_error_px: f64::NAN, ..trace };
        assert_eq!(difference(&nan, &nan), None, "the same bits");
        let zero = TraceMsg { feature_error_px: -0.0, ..trace };
        assert_eq!(difference(&trace, &zero), Some(("feature_error_px".into(), "0.0".into(), "-0.0".into())));
        let measurement = Measurement::default();
        let mut other = measurement;
        other.features[5].v_px = 2.5;
        assert_eq!(
            difference(&measurement, &other),
            Some(("features[5].v_px".into(), "0.0".into(), "2.5".into()))
        );
    }
}
