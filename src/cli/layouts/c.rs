//! Layouts as a header for C and C++.

use super::{code_groups, plain, record_name, records, services, sizes};
use crate::messages::{FieldType, RecordLayout};
use std::fmt::Write as _;

/// The header. What the compiler makes of each structure is held against the places of the fields while it is compiled.
pub(super) fn header() -> String {
    let version = env!("CARGO_PKG_VERSION");
    let mut text = format!(
        "/* Records of vservo {version}. Made by `vservo layouts --lang c`. */\n#ifndef VSERVO_LAYOUTS_H\n#define VSERVO_LAYOUTS_H\n\n\
         #include <stddef.h>\n#include <stdint.h>\n\n#ifdef __cplusplus\n#define VSERVO_ASSERT(what) static_assert(what, #what)\n\
         /* The name by which iceoryx2 tells types of payloads apart. */\n\
         #define VSERVO_TYPE_NAME(name) static constexpr const char *IOX2_TYPE_NAME = name;\n#else\n\
         #define VSERVO_ASSERT(what) _Static_assert(what, #what)\n#define VSERVO_TYPE_NAME(name)\n#endif\n\n"
    );
    for (name, number) in sizes() {
        let _ = writeln!(text, "#define VSERVO_{} {number}", name.to_uppercase());
    }
    text += "\n/* Services, each in the name space of its instance. */\n";
    for row in services() {
        let name = row.channel.to_string();
        let constant = name.replace("/0/", "/").replace('/', "_").to_uppercase();
        let _ =
            writeln!(text, "#define VSERVO_SERVICE_{constant} \"{name}\" /* {} */", row.records.join(", "));
    }
    for group in code_groups() {
        let _ = writeln!(text, "\nenum {{ /* {} */", group.name.replace('_', " "));
        for (name, code, about) in &group.codes {
            let about = if about.is_empty() { String::new() } else { format!(" /* {about} */") };
            let _ = writeln!(text, "    VSERVO_{}_{name} = {code},{about}", group.name.to_uppercase());
        }
        text += "};\n";
    }
    records().into_iter().for_each(|layout| structure(&mut text, layout));
    text + "\n#endif\n"
}

fn structure(text: &mut String, layout: &RecordLayout) {
    let name = format!("vservo_{}", record_name(layout));
    let versioned = format!("{}_TYPE", constant(record_name(layout)));
    let _ = write!(
        text,
        "\n#define {versioned} \"{}\"\n/* {} */\ntypedef struct {name} {{\n",
        layout.type_name,
        plain(layout.about)
    );
    let _ = writeln!(text, "    VSERVO_TYPE_NAME({versioned})");
    for field in layout.fields {
        let many = field.count.map_or(String::new(), |count| format!("[{count}]"));
        let _ =
            writeln!(text, "    {} {}{many}; /* {} */", type_of(field.kind), field.name, plain(field.about));
    }
    let _ = writeln!(text, "}} {name};\nVSERVO_ASSERT(sizeof({name}) == {});", layout.bytes);
    for field in layout.fields {
        let _ = writeln!(text, "VSERVO_ASSERT(offsetof({name}, {}) == {});", field.name, field.offset);
    }
}

/// `DriveState` as `VSERVO_DRIVE_STATE`.
fn constant(name: &str) -> String {
    format!("VSERVO_{}", super::constant_name(name))
}

fn type_of(kind: FieldType) -> String {
    match kind {
        FieldType::U8 => "uint8_t".into(),
        FieldType::U32 => "uint32_t".into(),
        FieldType::U64 => "uint64_t".into(),
        FieldType::I64 => "int64_t".into(),
        FieldType::F64 => "double".into(),
        FieldType::Record(inner) => format!("vservo_{}", record_name(inner)),
    }
}
