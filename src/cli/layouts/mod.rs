//! `vservo layouts`: what programs in other languages need in order to take part, as text that they include: the records with their fields' places, the
//! numbers that have names, and the services. All of it comes from the definitions that this program itself is built from.

mod c;
mod json;
mod python;

use crate::control::lifecycle::{Refusal, Request};
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::ipc::{Channel, STOP_WORD_OFFSETS};
use crate::messages::{
    CameraId, CameraState, CommandForm, ControlState, FieldType, MAX_CAMERAS, MAX_FEATURES, MAX_JOINTS,
    NamedCode, RECORD_LAYOUTS, RecordLayout, RobotState, TargetStatus, answer_flag, drive_flag, frame_flag,
    health_flag, joint_flag, measurement_flag, status_flag, text_kind, trace_flag,
};
use std::fmt::Debug;

/// Codes that are looked at when the values of an enumeration are listed; every protocol here has fewer. Checked by a test.
const CODES_TRIED: u32 = 64;

/// In which language layouts are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LayoutLanguage {
    /// A header for C11, C++11 and later.
    C,
    /// A module of `ctypes` structures.
    Python,
    /// JSON, for generators of other languages.
    Json,
}

/// All layouts as text.
pub(super) fn layouts(language: LayoutLanguage) -> String {
    match language {
        LayoutLanguage::C => c::header(),
        LayoutLanguage::Python => python::module(),
        LayoutLanguage::Json => json::document(),
    }
}

/// The records that travel, each behind those that it contains.
fn records() -> Vec<&'static RecordLayout> {
    let mut all: Vec<&'static RecordLayout> = Vec::new();
    for layout in RECORD_LAYOUTS {
        for field in layout.fields {
            if let FieldType::Record(inner) = field.kind
                && !all.contains(&inner)
            {
                all.push(inner);
            }
        }
        all.push(layout);
    }
    all
}

/// A record's name in the languages of others: that of its versioned type.
fn record_name(layout: &RecordLayout) -> &'static str {
    layout.name.strip_suffix("Msg").unwrap_or(layout.name)
}

/// Documentation as one line without the marks of Rust's.
fn plain(about: &str) -> String {
    let about = without_links(about.trim());
    let without: String = about.chars().filter(|c| !matches!(c, '[' | ']' | '`')).collect();
    without
        .replace("super::", "")
        .replace("Self::", "")
        .replace("::", ".")
        .replace("*/", "* /")
        .replace('"', "'")
}

/// The text without the targets of its links.
fn without_links(about: &str) -> String {
    let mut parts = about.split("](");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.split_once(')').map_or(part, |(_, rest)| rest))
}

/// Numbers with names, by the field or kind that they are of.
struct CodeGroup {
    name: &'static str,
    codes: Vec<(String, u32, String)>,
}

fn flags(name: &'static str, codes: &[NamedCode]) -> CodeGroup {
    let codes = codes.iter().map(|c| (c.name.to_owned(), c.code, plain(c.about))).collect();
    CodeGroup { name, codes }
}

/// An enumeration, whose values are those that come back from their own code.
fn values<T: Debug>(
    name: &'static str,
    from_code: impl Fn(u32) -> Option<T>,
    code: impl Fn(&T) -> u32,
) -> CodeGroup {
    let known = |n: u32| from_code(n).filter(|value| code(value) == n);
    let codes =
        (0..CODES_TRIED).filter_map(|n| Some((constant_name(&format!("{:?}", known(n)?)), n, String::new())));
    CodeGroup { name, codes: codes.collect() }
}

/// `Drive(OutOfStep)` and `CameraTurned90` as `DRIVE_OUT_OF_STEP` and `CAMERA_TURNED_90`.
fn constant_name(variant: &str) -> String {
    let mut name = String::new();
    let mut before = '_';
    for c in variant.chars().filter(|c| c.is_ascii_alphanumeric()) {
        let begins = c.is_ascii_uppercase() || (c.is_ascii_digit() && !before.is_ascii_digit());
        if begins && !name.is_empty() {
            name.push('_');
        }
        name.push(c.to_ascii_uppercase());
        before = c;
    }
    name
}

fn code_groups() -> Vec<CodeGroup> {
    vec![
        flags("answer_flag", answer_flag::ALL),
        flags("drive_flag", drive_flag::ALL),
        flags("frame_flag", frame_flag::ALL),
        flags("health_flag", health_flag::ALL),
        flags("joint_flag", joint_flag::ALL),
        flags("measurement_flag", measurement_flag::ALL),
        flags("status_flag", status_flag::ALL),
        flags("stop_word_offset", &STOP_WORD_OFFSETS),
        flags("text_kind", text_kind::ALL),
        flags("trace_flag", trace_flag::ALL),
        values("camera_state", |n| Some(CameraState::from_code(n)), |v| *v as u32),
        values("command_form", CommandForm::from_code, |v| *v as u32),
        values("control_state", |n| Some(ControlState::from_code(n)), |v| *v as u32),
        values("fault", Fault::from_code, |v| v.code()),
        values("outcome", Outcome::from_code, |v| v.code()),
        values("refusal", Refusal::from_code, |v| *v as u32),
        values("request_kind", Request::from_code, |v| *v as u32),
        values("robot_state", |n| Some(RobotState::from_code(n)), |v| *v as u32),
        values("target_status", |n| Some(TargetStatus::from_code(n)), |v| *v as u32),
    ]
}

/// Numbers on which layouts stand.
fn sizes() -> [(&'static str, usize); 3] {
    [("max_joints", MAX_JOINTS), ("max_features", MAX_FEATURES), ("max_cameras", MAX_CAMERAS)]
}

/// How a service carries its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pattern {
    /// Each record to all who listen.
    PublishSubscribe,
    /// The same, with the pixels of an image whose header the record is.
    ImagesWithHeader,
    /// A request and its answer.
    RequestResponse,
}

/// A service: its name, for the first camera where it is of one, and the records that it carries.
struct ServiceRow {
    channel: Channel,
    pattern: Pattern,
    records: Vec<&'static str>,
}

fn services() -> Vec<ServiceRow> {
    use Pattern::{ImagesWithHeader, PublishSubscribe, RequestResponse};
    let id = CameraId::FIRST;
    [
        (Channel::Frame(id), ImagesWithHeader, vec!["FrameHeader"]),
        (Channel::Image(id), ImagesWithHeader, vec!["ImageHeader"]),
        (Channel::Health(id), PublishSubscribe, vec!["CameraHealth"]),
        (Channel::Measurement(id), PublishSubscribe, vec!["Measurement"]),
        (Channel::JointState, PublishSubscribe, vec!["JointState"]),
        (Channel::Trace, PublishSubscribe, vec!["Trace"]),
        (Channel::Status, PublishSubscribe, vec!["Status"]),
        (Channel::Request, PublishSubscribe, vec!["Request"]),
        (Channel::Command, RequestResponse, vec!["ControlCommand", "ControlAnswer"]),
        (Channel::DriveCommand, PublishSubscribe, vec!["DriveCommand"]),
        (Channel::DriveState, PublishSubscribe, vec!["DriveState"]),
        (Channel::DriveText, PublishSubscribe, vec!["DriveText"]),
    ]
    .into_iter()
    .map(|(channel, pattern, records)| ServiceRow { channel, pattern, records })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_others_are_those_of_their_versioned_types() {
        for layout in records() {
            let versioned = format!("vservo.{}.v", record_name(layout));
            assert!(layout.type_name.starts_with(&versioned), "{} {versioned}", layout.type_name);
        }
        for row in services() {
            for name in &row.records {
                assert!(records().iter().any(|layout| record_name(layout) == *name), "{name}");
            }
        }
    }

    #[test]
    fn every_value_of_an_enumeration_is_listed() {
        let groups = code_groups();
        let count = |name: &str| groups.iter().find(|group| group.name == name).unwrap().codes.len();
        assert_eq!(
            (count("control_state"), count("robot_state")),
            (ControlState::ALL.len(), RobotState::ALL.len())
        );
        assert_eq!((count("request_kind"), count("refusal")), (Request::ALL.len(), Refusal::ALL.len()));
        assert_eq!(
            (count("command_form"), count("target_status"), count("camera_state")),
            (CommandForm::ALL.len(), 12, 6)
        );
        for group in &groups {
            for (name, code, _) in &group.codes {
                assert_eq!(
                    group.codes.iter().filter(|(other, ..)| other == name).count(),
                    1,
                    "{} {name}",
                    group.name
                );
                let is_listed = ["_flag", "_offset"].iter().any(|of| group.name.ends_with(of));
                assert!(*code < CODES_TRIED - 1 || is_listed, "{} {name}", group.name);
            }
        }
        assert_eq!(constant_name("Drive(OutOfStep)"), "DRIVE_OUT_OF_STEP");
        assert_eq!(plain("a [`Flag`](super::Flag::X) of [`Self::flags`]"), "a Flag of flags");
        assert_eq!(constant_name("CameraTurned90"), "CAMERA_TURNED_90");
    }
}
