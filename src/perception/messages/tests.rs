//! Layouts, names and codes of the records.

use super::*;
use std::mem::{align_of, offset_of, size_of};

#[test]
fn layouts_are_fixed() {
    assert_eq!((size_of::<FrameHeader>(), align_of::<FrameHeader>()), (64, 8));
    assert_eq!(offset_of!(FrameHeader, flags), 60);
    assert_eq!((size_of::<ImageHeader>(), align_of::<ImageHeader>()), (48, 8));
    assert_eq!((offset_of!(ImageHeader, format), offset_of!(ImageHeader, stride_bytes)), (24, 36));
    assert_eq!(size_of::<FeaturePoint>(), 48);
    assert_eq!((size_of::<Measurement>(), align_of::<Measurement>()), (3520, 8));
    assert_eq!(offset_of!(Measurement, camera), 64);
    assert_eq!(offset_of!(Measurement, features), 88);
    assert_eq!(offset_of!(Measurement, pose), 3160);
    assert_eq!(offset_of!(Measurement, reprojection_rms_px), 3504);
    assert_eq!((size_of::<JointState>(), align_of::<JointState>()), (432, 8));
    assert_eq!(offset_of!(JointState, q), 40);
    assert_eq!(offset_of!(JointState, q_true), 320);
    assert_eq!((size_of::<Status>(), align_of::<Status>()), (288, 8));
    assert_eq!(offset_of!(Status, state), 240);
}

#[test]
#[allow(unsafe_code)]
fn type_names_carry_their_version() {
    use iceoryx2::prelude::ZeroCopySend;
    // SAFETY: the names are only read.
    for (name, wanted) in [
        (unsafe { FrameHeader::type_name() }, "vservo.FrameHeader.v2"),
        (unsafe { ImageHeader::type_name() }, "vservo.ImageHeader.v1"),
        (unsafe { Measurement::type_name() }, "vservo.Measurement.v4"),
        (unsafe { JointState::type_name() }, "vservo.JointState.v3"),
        (unsafe { Status::type_name() }, "vservo.Status.v8"),
    ] {
        assert_eq!(name, wanted);
    }
}

/// Where XCDR1 puts the fields of `layout` after `at` bytes, each held against where the compiler has put it in the record that begins at `begin`:
/// every number at the next multiple of its own size, at most 8.
fn assert_encoded_in_place(layout: &RecordLayout, begin: usize, mut at: usize) -> usize {
    for field in layout.fields {
        for entry in 0..field.count.unwrap_or(1) {
            let lies = begin + field.offset + entry * field.kind.bytes();
            at = match field.kind {
                FieldType::Record(inner) => assert_encoded_in_place(inner, lies, at),
                number => {
                    let encoded = at.next_multiple_of(number.bytes());
                    assert_eq!(encoded, lies, "{}.{}[{entry}]", layout.name, field.name);
                    encoded + number.bytes()
                }
            };
        }
    }
    assert_eq!(at, begin + layout.bytes, "{} has nothing behind its last field", layout.name);
    at
}

#[test]
fn records_lie_in_memory_as_xcdr1_encodes_them() {
    for layout in RECORD_LAYOUTS {
        assert_encoded_in_place(layout, 0, 0);
        assert!(layout.type_name.starts_with(&format!("vservo.{}", layout.name.trim_end_matches("Msg"))));
    }
}

#[test]
fn a_record_comes_back_from_its_bytes_to_the_bit() {
    let mut trace = TraceMsg { tick: u64::MAX, stamp: crate::time::MonoNs(-7), ..TraceMsg::default() };
    (trace.limits, trace.q_r) = (
        [1, 2, 3, 4, 5, 6, 7, 255, 0, 0, 0, 0, 0, 0, 8, 9],
        [-0.0, f64::MIN_POSITIVE, 1e300, -1.5, 0.1, 0.2, 0.3],
    );
    trace.feature_error_px = f64::from_bits(0x7ff8_0000_dead_beef);
    let mut bytes = Vec::new();
    trace.put(&mut bytes);
    assert_eq!(bytes.len(), TraceMsg::LAYOUT.bytes);
    let offset = offset_of!(TraceMsg, q_r);
    assert_eq!(bytes[offset + 8..offset + 16], f64::MIN_POSITIVE.to_le_bytes());
    let mut again = Vec::new();
    TraceMsg::of_bytes(&bytes).unwrap().put(&mut again);
    assert_eq!(bytes, again);
    assert!(TraceMsg::of_bytes(&bytes[1..]).is_none());
    bytes.push(0);
    assert!(TraceMsg::of_bytes(&bytes).is_none());
}

#[test]
fn codes_survive_the_message() {
    for code in 0..14 {
        let status = TargetStatus::from_code(code);
        assert!(status as u32 == code || (status == TargetStatus::NoMatch && code > 11));
        let state = ControlState::from_code(code);
        assert!(state as u32 == code || (state == ControlState::Fault && code > 11));
    }
}

#[test]
fn pose_survives_the_message() {
    let X_CO = crate::geometry::Pose::new([0.1, -0.2, 0.6].into(), [0.3, -1.0, 2.0].into());
    let mut m = Measurement::default();
    assert!(m.pose().is_none());
    m.set_pose(&X_CO);
    assert_eq!(m.pose(), Some(X_CO));
}
