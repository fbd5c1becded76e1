//! A recording as tables: one CSV file a service, a row a record, a column a number. Columns are named as the fields, with the unit at the end; what is not known (NaN) is
//! an empty cell. Numbers are written so that they come back to the bit. Pixels are in no table.

use super::viewers::layout_of;
use crate::config::Config;
use crate::messages::{FieldType, RecordField, RecordLayout};
use crate::record::{RecordedMessage, RecordingError, RecordingReader};
use crate::robot::JointKind;
use std::collections::BTreeMap;
use std::io::{self, Read, Write};

/// A table that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportedTable {
    /// The name of its file.
    pub file: String,
    /// Its rows without the header.
    pub rows: u64,
}

/// One column: where its number lies in the record.
#[derive(Debug, Clone, PartialEq)]
struct RecordColumn {
    name: String,
    offset: usize,
    kind: FieldType,
}

struct OpenTable<W> {
    sink: W,
    columns: Vec<RecordColumn>,
    written: ExportedTable,
}

/// Writes the tables of what `reader` has; `open` makes the file of a name.
///
/// # Errors
/// When the recording cannot be read, has records of another version, or a file cannot be written.
pub fn write_tables<R: Read, W: Write>(
    mut reader: RecordingReader<R>,
    config: &Config,
    mut open: impl FnMut(&str) -> io::Result<W>,
) -> Result<Vec<ExportedTable>, RecordingError> {
    let mut tables: BTreeMap<String, OpenTable<W>> = BTreeMap::new();
    let mut line = String::new();
    while let Some(message) = reader.next_message()? {
        let Some(layout) = message.type_name().map(|name| known_layout(&message, name)).transpose()? else {
            continue;
        };
        let table = match tables.entry(message.topic().to_owned()) {
            std::collections::btree_map::Entry::Occupied(table) => table.into_mut(),
            std::collections::btree_map::Entry::Vacant(place) => {
                let file = format!("{}.csv", message.topic().trim_start_matches('/').replace('/', "_"));
                let mut sink = open(&file)?;
                let columns = columns(layout, config);
                let names: Vec<_> = columns.iter().map(|column| column.name.as_str()).collect();
                writeln!(sink, "{}", names.join(","))?;
                place.insert(OpenTable { sink, columns, written: ExportedTable { file, rows: 0 } })
            }
        };
        let Some(record) = message.record_bytes(layout.bytes) else {
            let topic = message.topic().to_owned();
            return Err(RecordingError::Message { topic, expected: layout.type_name });
        };
        line.clear();
        for (i, column) in table.columns.iter().enumerate() {
            if i > 0 {
                line.push(',');
            }
            line.push_str(&cell(column, record));
        }
        line.push('\n');
        table.sink.write_all(line.as_bytes())?;
        table.written.rows += 1;
    }
    let close = |mut table: OpenTable<W>| table.sink.flush().map(|()| table.written);
    Ok(tables.into_values().map(close).collect::<io::Result<_>>()?)
}

fn known_layout(message: &RecordedMessage<'_>, name: &str) -> Result<&'static RecordLayout, RecordingError> {
    layout_of(name).ok_or_else(|| RecordingError::Version {
        topic: message.topic().into(),
        found: name.into(),
        expected: "other versions of it",
    })
}

fn cell(column: &RecordColumn, record: &[u8]) -> String {
    let bytes = record.get(column.offset..).unwrap_or_default();
    match column.kind {
        FieldType::U8 => bytes.first().map_or(String::new(), u8::to_string),
        FieldType::U32 => bytes.first_chunk().map_or(String::new(), |b| u32::from_le_bytes(*b).to_string()),
        FieldType::U64 => bytes.first_chunk().map_or(String::new(), |b| u64::from_le_bytes(*b).to_string()),
        FieldType::I64 => bytes.first_chunk().map_or(String::new(), |b| i64::from_le_bytes(*b).to_string()),
        FieldType::F64 => {
            let value = bytes.first_chunk().map_or(f64::NAN, |b| f64::from_le_bytes(*b));
            if value.is_nan() { String::new() } else { format!("{value:?}") }
        }
        // its fields have columns of their own
        FieldType::Record(_) => String::new(),
    }
}

fn columns(layout: &RecordLayout, config: &Config) -> Vec<RecordColumn> {
    let mut all = Vec::new();
    for field in layout.fields {
        let count = field.count.unwrap_or(1).min(entries_in_use(field, config));
        for i in 0..count {
            let offset = field.offset + i * field.kind.bytes();
            let number = if field.count.is_some() { format!("_{}", i + 1) } else { String::new() };
            if let FieldType::Record(inner) = field.kind {
                let inner = columns(inner, config).into_iter().map(|column| RecordColumn {
                    name: format!("{}{number}_{}", field.name, column.name),
                    offset: offset + column.offset,
                    ..column
                });
                all.extend(inner);
                continue;
            }
            let unit = unit_of(field, i, config);
            let unit = if unit.is_empty() { String::new() } else { format!("_{unit}") };
            all.push(RecordColumn {
                name: format!("{}{number}{unit}", field.name),
                offset,
                kind: field.kind,
            });
        }
    }
    all
}

/// Entries of an array that this run can have: one a joint, one a point of its target.
fn entries_in_use(field: &RecordField, config: &Config) -> usize {
    if joint_quantity(field.name).is_some() {
        config.robot.joint_count()
    } else if field.name == "text" {
        0 // bytes: words have no place in a table of numbers
    } else if field.name == "features" {
        config.target.points().len()
    } else {
        usize::MAX
    }
}

/// What a field with an entry a joint is, by the units of a turning and of a sliding joint.
fn joint_quantity(name: &str) -> Option<[&'static str; 2]> {
    match name {
        "q" | "q_r" | "q_true" => Some(["rad", "m"]),
        "qd" | "qd_r" | "qd_true" | "requested_qd" => Some(["rad_s", "m_s"]),
        "tau" | "external_torque" | "external_torque_sd" | "measured_torque" => Some(["n_m", "n"]),
        _ => None,
    }
}

/// The unit of entry `i`; empty where the field's name ends with it, or where there is none.
fn unit_of(field: &RecordField, i: usize, config: &Config) -> &'static str {
    if let Some([turning, sliding]) = joint_quantity(field.name) {
        let slides = config.robot.joints.get(i).is_some_and(|joint| joint.kind == JointKind::Prismatic);
        return if slides { sliding } else { turning };
    }
    match (field.name, field.kind) {
        (_, FieldType::I64) => "ns",
        // position, and unit quaternion x y z w
        ("pose", _) if i < 3 => "m",
        // row by row, positions before rotations
        ("pose_covariance", _) => match (i / 6 < 3, i % 6 < 3) {
            (true, true) => "m2",
            (false, false) => "rad2",
            _ => "m_rad",
        },
        ("V_C", _) if i < 3 => "m_s",
        ("V_C", _) => "rad_s",
        // of a joint that turns or slides
        ("contact_torque", _) => "n_m_or_n",
        ("contact_force", _) => "n",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{JointState, Measurement, MessageRecord, Status, TraceMsg};

    /// Numbers without a unit: normalized image coordinates, quaternions, shares, and numbers of requests, whose form says what they are.
    const WITHOUT: [&str; 6] = ["x", "y", "pose", "stability", "values", "V_C"];
    const UNITS: [&str; 13] =
        ["ns", "us", "s", "hz", "px", "m", "rad", "rad_s", "m_s", "n_m", "n", "m2", "rad2"];

    #[test]
    fn every_column_of_a_measured_number_names_its_unit() {
        let config = Config::load(None, &[]).unwrap();
        for name in [
            "CameraHealth.v1",
            "DriveCommand.v3",
            "DriveState.v3",
            "DriveText.v1",
            "FrameHeader.v2",
            "Request.v3",
        ] {
            assert!(layout_of(&format!("vservo.{name}")).is_some(), "{name}");
        }
        let layouts = [JointState::LAYOUT, Measurement::LAYOUT, Status::LAYOUT, TraceMsg::LAYOUT];
        for layout in layouts {
            for column in columns(layout, &config) {
                let base = column.name.split('_').find(|word| WITHOUT.contains(word));
                let has_unit = UNITS.iter().any(|unit| column.name.ends_with(&format!("_{unit}")))
                    || column.name.ends_with("m_rad");
                let is_measured = matches!(column.kind, FieldType::F64 | FieldType::I64);
                assert!(
                    !is_measured || has_unit || base.is_some() || column.name.starts_with("V_C"),
                    "{}",
                    column.name
                );
            }
        }
        // The default arm is a SCARA: its third joint slides.
        let names: Vec<_> = columns(JointState::LAYOUT, &config).into_iter().map(|c| c.name).collect();
        for name in ["stamp_ns", "q_1_rad", "q_3_m", "qd_3_m_s", "tau_3_n", "tau_4_n_m"] {
            assert!(names.iter().any(|n| n == name), "{name}: {names:?}");
        }
        assert!(!names.iter().any(|name| name.starts_with("q_5")));
        let names: Vec<_> = columns(Measurement::LAYOUT, &config).into_iter().map(|c| c.name).collect();
        for name in [
            "features_4_u_px",
            "pose_1_m",
            "pose_covariance_1_m2",
            "pose_covariance_4_m_rad",
            "pose_covariance_36_rad2",
        ] {
            assert!(names.iter().any(|n| n == name), "{name}: {names:?}");
        }
    }

    #[test]
    fn cells_come_back_to_the_bit() {
        let column = |kind| RecordColumn { name: String::new(), offset: 0, kind };
        for value in [0.1, -0.0, 1e300, f64::MIN_POSITIVE, f64::INFINITY] {
            let text = cell(&column(FieldType::F64), &value.to_le_bytes());
            assert_eq!(text.parse::<f64>().unwrap().to_bits(), value.to_bits());
        }
        assert_eq!(cell(&column(FieldType::F64), &f64::NAN.to_le_bytes()), "");
        assert_eq!(cell(&column(FieldType::I64), &(-5_i64).to_le_bytes()), "-5");
    }
}
