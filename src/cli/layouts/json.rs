//! Layouts as JSON, for generators of other languages.

use super::{Pattern, code_groups, plain, record_name, records, services, sizes};
use crate::messages::{FieldType, RecordField, RecordLayout};
use serde_json::{Map, Value, json};

/// The document.
pub(super) fn document() -> String {
    let sizes: Map<String, Value> =
        sizes().into_iter().map(|(name, n)| (name.to_owned(), n.into())).collect();
    let codes: Map<String, Value> = code_groups()
        .into_iter()
        .map(|group| {
            let codes = group.codes.into_iter().map(|(name, code, about)| named(&name, code, &about));
            (group.name.to_owned(), codes.collect())
        })
        .collect();
    let services: Vec<_> = services()
        .into_iter()
        .map(|row| json!({ "name": row.channel.to_string(), "pattern": pattern(row.pattern), "records": row.records }))
        .collect();
    let document = json!({
        "vservo": env!("CARGO_PKG_VERSION"),
        "byte_order": "little",
        "sizes": sizes,
        "services": services,
        "codes": codes,
        "records": records().into_iter().map(record).collect::<Vec<_>>(),
    });
    serde_json::to_string_pretty(&document).unwrap_or_default() + "\n"
}

fn named(name: &str, code: u32, about: &str) -> Value {
    if about.is_empty() {
        json!({ "name": name, "code": code })
    } else {
        json!({ "name": name, "code": code, "about": about })
    }
}

fn pattern(pattern: Pattern) -> &'static str {
    match pattern {
        Pattern::PublishSubscribe => "publish_subscribe",
        Pattern::ImagesWithHeader => "publish_subscribe of bytes, with the record as user header",
        Pattern::RequestResponse => "request_response",
    }
}

fn record(layout: &'static RecordLayout) -> Value {
    json!({
        "name": record_name(layout),
        "type_name": layout.type_name,
        "about": plain(layout.about),
        "bytes": layout.bytes,
        "fields": layout.fields.iter().map(field).collect::<Vec<_>>(),
    })
}

fn field(field: &RecordField) -> Value {
    let kind = match field.kind {
        FieldType::U8 => "u8",
        FieldType::U32 => "u32",
        FieldType::U64 => "u64",
        FieldType::I64 => "i64",
        FieldType::F64 => "f64",
        FieldType::Record(inner) => record_name(inner),
    };
    json!({ "name": field.name, "type": kind, "count": field.count, "offset": field.offset, "about": plain(field.about) })
}
