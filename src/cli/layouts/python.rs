//! Layouts as a Python module of `ctypes` structures, which the `iceoryx2` package takes as payloads.

use super::{code_groups, plain, record_name, records, services, sizes};
use crate::messages::{FieldType, RecordField, RecordLayout};
use std::fmt::Write as _;

/// The module. It holds the places of the fields against those of this program when it is imported.
pub(super) fn module() -> String {
    let version = env!("CARGO_PKG_VERSION");
    let mut text = format!(
        "\"\"\"Records of vservo {version}. Made by `vservo layouts --lang python`.\"\"\"\nimport ctypes\nimport enum\n\n"
    );
    for (name, number) in sizes() {
        let _ = writeln!(text, "{} = {number}", name.to_uppercase());
    }
    text += "\n# Services, each in the name space of its instance.\n";
    for row in services() {
        let name = row.channel.to_string();
        let constant = name.replace("/0/", "/").replace('/', "_").to_uppercase();
        let _ = writeln!(text, "SERVICE_{constant} = \"{name}\"  # {}", row.records.join(", "));
    }
    for group in code_groups() {
        let kind = if group.name.ends_with("_flag") { "IntFlag" } else { "IntEnum" };
        let _ = write!(text, "\n\nclass {}(enum.{kind}):\n", class_name(group.name));
        for (name, code, about) in &group.codes {
            let about = if about.is_empty() { String::new() } else { format!("  # {about}") };
            let _ = writeln!(text, "    {name} = {code}{about}");
        }
    }
    records().into_iter().for_each(|layout| structure(&mut text, layout));
    text
}

/// `drive_flag` as `DriveFlag`.
fn class_name(group: &str) -> String {
    let capital = |word: &str| word[..1].to_uppercase() + &word[1..];
    group.split('_').map(capital).collect()
}

fn structure(text: &mut String, layout: &RecordLayout) {
    let name = record_name(layout);
    let _ = write!(
        text,
        "\n\nclass {name}(ctypes.Structure):\n    \"\"\"{}\"\"\"\n\n    _fields_ = [\n",
        plain(layout.about)
    );
    for field in layout.fields {
        let _ = writeln!(text, "        (\"{}\", {}),  # {}", field.name, type_of(field), plain(field.about));
    }
    let _ = write!(
        text,
        "    ]\n\n    @staticmethod\n    def type_name():\n        return \"{}\"\n\n\nassert ctypes.sizeof({name}) == {}\n",
        layout.type_name, layout.bytes
    );
    for field in layout.fields {
        let _ = writeln!(text, "assert {name}.{}.offset == {}", field.name, field.offset);
    }
}

fn type_of(field: &RecordField) -> String {
    let one = match field.kind {
        FieldType::U8 => "ctypes.c_uint8",
        FieldType::U32 => "ctypes.c_uint32",
        FieldType::U64 => "ctypes.c_uint64",
        FieldType::I64 => "ctypes.c_int64",
        FieldType::F64 => "ctypes.c_double",
        FieldType::Record(inner) => record_name(inner),
    };
    field.count.map_or_else(|| one.to_owned(), |count| format!("{one} * {count}"))
}
