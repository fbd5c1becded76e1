//! Layouts, names and codes of the records.

use super::*;
use std::mem::{align_of, offset_of, size_of};

#[test]
fn layouts_are_fixed() {
    assert_eq!((size_of::<FrameHeader>(), align_of::<FrameHeader>()), (64, 8));
    assert_eq!(offset_of!(FrameHeader, flags), 60);
    assert_eq!(size_of::<FeaturePoint>(), 48);
    assert_eq!((size_of::<Measurement>(), align_of::<Measurement>()), (3504, 8));
    assert_eq!(offset_of!(Measurement, camera), 64);
    assert_eq!(offset_of!(Measurement, features), 80);
    assert_eq!(offset_of!(Measurement, pose), 3152);
    assert_eq!(offset_of!(Measurement, reprojection_rms_px), 3496);
    assert_eq!((size_of::<JointState>(), align_of::<JointState>()), (432, 8));
    assert_eq!(offset_of!(JointState, q), 40);
    assert_eq!(offset_of!(JointState, q_true), 320);
    assert_eq!((size_of::<Status>(), align_of::<Status>()), (232, 8));
    assert_eq!(offset_of!(Status, state), 200);
}

#[test]
#[allow(unsafe_code)]
fn type_names_carry_their_version() {
    use iceoryx2::prelude::ZeroCopySend;
    // SAFETY: the names are only read.
    for (name, wanted) in [
        (unsafe { FrameHeader::type_name() }, "vservo.FrameHeader.v2"),
        (unsafe { Measurement::type_name() }, "vservo.Measurement.v2"),
        (unsafe { JointState::type_name() }, "vservo.JointState.v2"),
        (unsafe { Status::type_name() }, "vservo.Status.v4"),
    ] {
        assert_eq!(name, wanted);
    }
}

#[test]
fn codes_survive_the_message() {
    for code in 0..12 {
        let status = TargetStatus::from_code(code);
        assert!(status as u32 == code || (status == TargetStatus::NoMatch && code > 8));
        let state = ControlState::from_code(code);
        assert!(state as u32 == code || (state == ControlState::Fault && code > 9));
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
