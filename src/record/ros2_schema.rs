//! Definitions of the records in the form of ROS 2 (`ros2msg`: the file NAME.msg, and those of the records in it), from their layouts.

use crate::messages::{FieldType, RecordLayout};
use std::fmt::Write;

/// Between the definitions of two records: 80 times `=`, as rosbag2 has it.
const RULE: &str = "================================================================================";

/// `vservo/msg/NAME` of a record `vservo.NAME.vN`.
#[must_use]
pub fn ros2_name(layout: &RecordLayout) -> String {
    format!("vservo/msg/{}", base_name(layout))
}

fn base_name(layout: &RecordLayout) -> &'static str {
    layout.type_name.split('.').nth(1).unwrap_or(layout.name)
}

/// The definition: a comment and a line for each field, then the same of each record among the fields. Names are in lower case, because ROS
/// takes no others.
#[must_use]
pub fn ros2_schema(layout: &RecordLayout) -> String {
    let mut text = format!("# {}:{}\n", layout.type_name, plain(layout.about));
    let mut inner: Vec<&RecordLayout> = Vec::new();
    for field in layout.fields {
        let kind = match field.kind {
            FieldType::U8 => "uint8".into(),
            FieldType::U32 => "uint32".into(),
            FieldType::U64 => "uint64".into(),
            FieldType::I64 => "int64".into(),
            FieldType::F64 => "float64".into(),
            FieldType::Record(record) => {
                inner.push(record);
                format!("vservo/{}", base_name(record))
            }
        };
        let count = field.count.map(|n| format!("[{n}]")).unwrap_or_default();
        // a String takes everything
        let _ = writeln!(text, "#{}\n{kind}{count} {}", plain(field.about), field.name.to_lowercase());
    }
    for record in inner {
        let _ = write!(text, "{RULE}\nMSG: vservo/{}\n{}", base_name(record), ros2_schema(record));
    }
    text
}

/// The text of a documentation without the marks of its links.
fn plain(about: &str) -> String {
    about.replace(['[', ']', '`'], "").replace("super::", "").replace("crate::", "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{ControlCommand, JointState, Measurement, MessageRecord};

    #[test]
    fn a_definition_names_every_field_in_its_order() {
        let text = ros2_schema(ControlCommand::LAYOUT);
        let begin = "# vservo.ControlCommand.v3: A request to control.\n\
             # Code of a control::lifecycle::Request; 0 asks for the answer alone, and every other code is refused.";
        let next = "\nuint32 request\n# Which arm: 0; a request for any other is refused.\nuint32 arm\n";
        assert!(text.starts_with(begin) && text.ends_with("\nfloat64[128] values\n"), "{text}");
        assert_eq!(text.lines().nth(2), Some("uint32 request"));
        assert!(text.contains(next), "{text}");
        assert_eq!(ros2_name(JointState::LAYOUT), "vservo/msg/JointState");
        let text = ros2_schema(Measurement::LAYOUT);
        let lines: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(lines.len(), Measurement::LAYOUT.fields.len() + 2 + 6);
        assert!(lines.contains(&"vservo/FeaturePoint[64] features") && lines.contains(&"float64 u_px"));
    }
}
