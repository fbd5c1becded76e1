//! Everything that vivid can do wrong on demand: what a run sees of it, and that it goes on.

use crate::capture::{CHECKERS, Capture, CaptureRequest, Taken, assert_checkers, config};
use crate::guest::Vivid;
use vservo::messages::CameraState;
use vservo::time::SpanNs;

const SECOND: SpanNs = SpanNs(1_000_000_000);

fn checkers() -> Vivid {
    let vivid = Vivid::webcam();
    vivid.set(CHECKERS);
    vivid
}

/// Asserts that frames come and are whole, `count` of them.
fn assert_streams(capture: &mut Capture, count: usize) -> Taken {
    let mut taken = Taken::default();
    for _ in 0..count {
        let captured = capture.next();
        assert_checkers(&capture.grey, capture.width);
        taken.note(&captured);
    }
    taken.assert_stamps_grow();
    taken
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn dropped_buffers_are_counted() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    capture.next();
    vivid.set("percentage_of_dropped_buffers=30");
    let taken = capture.run(SpanNs(8 * SECOND.0), |_, _| {});
    taken.assert_stamps_grow();
    // What came and what did not are all that there were, by the time that passed.
    let (first, last) = (taken.frames[0], taken.frames[taken.frames.len() - 1]);
    let exposed = (last.0 - first.0).as_s() * CaptureRequest::VGA.rate_hz;
    let counted = taken.frames.len() as f64 - 1.0 + taken.gaps() as f64;
    assert!((exposed - counted).abs() < 1.5, "{exposed} exposed, {counted} counted");
    assert!((20..120).contains(&taken.gaps()), "{} lost of {exposed}", taken.gaps());
    vivid.set("percentage_of_dropped_buffers=0");
    capture.next();
    assert_eq!(assert_streams(&mut capture, 25).gaps(), 0);
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_stall_passes() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    assert_streams(&mut capture, 3);
    vivid.set("percentage_of_dropped_buffers=100");
    capture.within(SpanNs(SECOND.0 / 4));
    assert_eq!(capture.within(SpanNs(2 * SECOND.0)), None);
    assert_eq!(capture.health().state, CameraState::Stalled);
    vivid.set("percentage_of_dropped_buffers=0");
    assert_streams(&mut capture, 10);
    assert_eq!(capture.health().state, CameraState::Streaming);
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_buffer_with_the_error_flag_is_not_shown() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    let before = assert_streams(&mut capture, 5);
    vivid.set("inject_v4l2_buf_flag_error=1");
    let after = assert_streams(&mut capture, 10);
    let all = Taken { frames: [before.frames, after.frames].concat(), lost: after.lost };
    // Once: as a gap of the count, or beside it.
    assert_eq!(all.gaps() + all.lost - before.lost, 1, "{all:?}");
    assert_eq!(capture.health().corrupt, 1);
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_stream_error_is_started_over() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    assert_streams(&mut capture, 5);
    for _ in 0..3 {
        vivid.set("inject_fatal_streaming_error=1");
        assert_streams(&mut capture, 10);
    }
    let health = capture.health();
    assert_eq!((health.restarted, health.reopened, health.state), (3, 0, CameraState::Streaming));
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_device_that_disconnects_is_opened_again() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    assert_streams(&mut capture, 5);
    vivid.set("disconnect=1");
    assert_streams(&mut capture, 25);
    assert_eq!((capture.health().reopened, capture.health().state), (1, CameraState::Streaming));
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn requests_that_fail_while_it_streams_are_survived() {
    let vivid = checkers();
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    assert_streams(&mut capture, 5);
    vivid.set("inject_vidioc_qbuf_error=1");
    assert_streams(&mut capture, 25);
    // What only a new stream asks for fails there: after a stream error, and after a device that vanished.
    for request in ["inject_vidioc_streamon_error", "inject_vidioc_reqbufs_error", "inject_vidioc_qbuf_error"]
    {
        for cause in ["inject_fatal_streaming_error", "disconnect"] {
            vivid.set(&format!("{request}=1"));
            vivid.set(&format!("{cause}=1"));
            assert_streams(&mut capture, 10);
        }
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn requests_that_fail_at_the_start_are_told() {
    let vivid = checkers();
    let config = config(&vivid.capture(), CaptureRequest::VGA, "");
    for request in ["streamon", "reqbufs", "qbuf"] {
        vivid.set(&format!("inject_vidioc_{request}_error=1"));
        match Capture::with(&config) {
            Err(error) => assert!(error.to_string().contains("video"), "{request}: {error}"),
            // Tried again: then it works.
            Ok(mut capture) => drop(assert_streams(&mut capture, 3)),
        }
        assert_streams(&mut Capture::with(&config).unwrap(), 3);
    }
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn a_sequence_number_that_wraps_is_no_loss() {
    let vivid = checkers();
    vivid.set("wrap_sequence_number=1");
    let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
    // The driver begins 128 frames before the wrap.
    let taken = assert_streams(&mut capture, 160);
    assert_eq!((taken.gaps(), taken.lost), (0, 0));
}

/// Time stamps of vivid that begin shortly before 32 or 64 bits are full are of no clock of this machine.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn stamps_that_wrap_are_not_believed() {
    let vivid = checkers();
    for bits in [1, 2] {
        vivid.set(&format!("wrap_timestamp={bits}"));
        let mut capture = Capture::open(&vivid.capture(), CaptureRequest::VGA);
        for _ in 0..5 {
            capture.next();
        }
        let mut taken = Taken::default();
        for _ in 0..25 {
            let captured = capture.next();
            let lag = vservo::rt::now() - captured.mid;
            assert!(lag.0 >= 0 && lag < SECOND, "wrap {bits}: {lag:?}");
            taken.note(&captured);
        }
        taken.assert_stamps_grow();
        assert_eq!(taken.gaps(), 0);
        assert!(capture.health().stamps_are_doubted);
    }
}
