//! A camera against scripted devices: what it does when they fail, lie, vanish and come back.

mod bench;

use super::node::*;
use super::*;
use crate::messages::CameraState;
use crate::source::{Captured, Filled, FreeRunningSource};
use crate::time::MonoNs;
use bench::*;
use proptest::prelude::*;
use rustix::io::Errno;
use std::time::Duration;

const SLICE: Duration = Duration::from_millis(50);

fn request(device: &str) -> CaptureRequest {
    CaptureRequest {
        settings: V4l2Settings::of_device(device, None),
        width: WIDTH,
        height: HEIGHT,
        region: None,
        rate_hz: 25.0,
        exposure: SpanNs(4 * MS),
    }
}

fn open_as(bench: &Bench, request: CaptureRequest) -> Result<V4l2Camera, V4l2Error> {
    V4l2Camera::open(Box::new(bench.clone()), request)
}

fn open(bench: &Bench) -> V4l2Camera {
    open_as(bench, request("/dev/video0")).unwrap()
}

/// Waits so many times; the frames that came, each with its grey level.
fn play(camera: &mut V4l2Camera, waits: usize) -> Vec<(Captured, u8)> {
    let mut seen = Vec::new();
    let mut out = [0; (WIDTH * HEIGHT) as usize];
    for _ in 0..waits {
        if let Some(captured) = camera.wait(SLICE).unwrap()
            && camera.fill(&mut out).unwrap() == Filled::Image
        {
            assert!(out.iter().all(|level| *level == out[0]), "a frame of one exposure");
            seen.push((captured, out[0]));
        }
    }
    seen
}

fn numbers(seen: &[(Captured, u8)]) -> Vec<u64> {
    seen.iter().map(|(captured, _)| captured.sequence).collect()
}

fn levels(seen: &[(Captured, u8)]) -> Vec<u8> {
    seen.iter().map(|(_, level)| *level).collect()
}

#[test]
fn frames_come_whole_in_order_and_with_one_pass_each() {
    let bench = Bench::new();
    let mut camera = open(&bench);
    assert_eq!(camera.health().state, CameraState::Starting);
    let seen = play(&mut camera, 100);
    assert_eq!(numbers(&seen), (0..100).collect::<Vec<_>>());
    assert_eq!(levels(&seen), (0..100).collect::<Vec<_>>());
    assert_eq!(camera.facts().unwrap().conversions, 100, "one conversion for a hundred frames each");
    // The device says 10 ms of exposure; a stamp is of the frame's end.
    let (first, _) = seen[0];
    assert_eq!((first.mid, first.span), (MonoNs(10_040 * MS - 5 * MS), SpanNs(10 * MS)));
    let health = camera.health();
    assert_eq!((health.state, health.corrupt, health.superseded), (CameraState::Streaming, 0, 0));
    assert!((health.rate_hz.unwrap() - 25.0).abs() < 0.01 && !health.rate_is_missed);
    drop(camera);
    assert_eq!(bench.0.borrow().open_nodes, 0);
}

#[test]
fn the_newest_frame_wins_and_the_older_ones_are_lost() {
    let bench = Bench::new();
    let mut camera = open(&bench);
    play(&mut camera, 2);
    bench.pass(130);
    let seen = play(&mut camera, 2);
    assert_eq!((numbers(&seen), levels(&seen)), (vec![4, 5], vec![4, 5]));
    assert_eq!(camera.health().superseded, 2);
    // A pause that is longer than the buffers last: what they hold is old, and right about it.
    bench.pass(2_000);
    let seen = play(&mut camera, 8);
    assert!(seen.iter().all(|(captured, level)| captured.sequence as u8 == *level));
    assert!(
        seen.iter().all(|(captured, _)| captured.mid.0 > 11_900 * MS),
        "nothing older than the pause: {seen:?}"
    );
    assert!(!camera.health().stamps_are_doubted);
}

#[test]
fn damaged_frames_are_never_given_and_leave_a_gap() {
    let script = [
        (3, Mishap::Damaged),
        (5, Mishap::Short),
        (7, Mishap::Dropped),
        (8, Mishap::Dropped),
        (10, Mishap::Interlaced),
    ];
    let bench = Bench::with(&script);
    let mut camera = open(&bench);
    let seen = play(&mut camera, 40);
    let wanted: Vec<u64> = (0..).filter(|n| ![3, 5, 7, 8, 10].contains(n)).take(seen.len()).collect();
    assert_eq!((numbers(&seen), camera.health().corrupt), (wanted, 3));
}

#[test]
fn counts_that_wrap_go_on() {
    let bench = Bench::new();
    bench.0.borrow_mut().first_sequence = u32::MAX - 4;
    let mut camera = open(&bench);
    assert_eq!(numbers(&play(&mut camera, 20)), (0..20).collect::<Vec<_>>());
}

#[test]
fn a_stream_error_is_answered_by_beginning_anew() {
    let bench = Bench::with(&[(5, Mishap::StreamError)]);
    let mut camera = open(&bench);
    let seen = play(&mut camera, 5);
    assert_eq!(seen.len(), 5);
    play(&mut camera, 1);
    assert_eq!(camera.health().state, CameraState::Recovering);
    let after = play(&mut camera, 10);
    assert_eq!(numbers(&after)[..2], [5, 6], "the count goes on");
    let health = camera.health();
    assert_eq!((health.state, health.restarted, health.reopened), (CameraState::Streaming, 1, 0));
}

#[test]
fn a_stream_that_fails_again_and_again_is_opened_anew() {
    let script: Vec<_> = (5..9).map(|k| (k, Mishap::StreamError)).collect();
    let bench = Bench::with(&script);
    let mut camera = open(&bench);
    let seen = play(&mut camera, 80);
    let health = camera.health();
    assert_eq!((health.state, health.restarted, health.reopened), (CameraState::Streaming, 3, 1));
    assert!(seen.len() > 30 && bench.0.borrow().open_nodes == 1);
}

#[test]
fn an_unplugged_camera_is_known_again_wherever_it_comes_back() {
    let bench = Bench::with(&[(5, Mishap::Unplugged(75))]); // three seconds
    let mut settings = request("/dev/video0");
    settings.settings.controls.insert("gain".into(), crate::config::ControlValue::Number(7));
    let mut camera = open_as(&bench, settings).unwrap();
    assert_eq!(play(&mut camera, 6).len(), 5);
    assert_eq!(camera.health().state, CameraState::Gone);
    assert!(camera.facts().is_none() && bench.0.borrow().open_nodes == 0);
    {
        // Its number goes to another one of its kind, elsewhere on the bus.
        let mut world = bench.0.borrow_mut();
        world.cameras[0].path = "/dev/video7".into();
        world.cameras.insert(0, FakeCamera::new(0, "Fake Camera", "usb-2"));
        world.set_controls.clear();
    }
    assert!(play(&mut camera, 40).is_empty(), "the other one is not it");
    let seen = play(&mut camera, 60);
    assert!(seen.len() > 10, "{}", seen.len());
    let health = camera.health();
    assert_eq!((health.state, health.reopened), (CameraState::Streaming, 1));
    assert_eq!(camera.facts().unwrap().path.to_str(), Some("/dev/video7"));
    assert_eq!(bench.0.borrow().set_controls, [(0x0098_0913, 7)], "all settings are made anew");
    assert_eq!(numbers(&seen)[0], 5, "what was lost meanwhile nobody knows");
}

#[test]
fn a_unique_serial_number_finds_a_camera_at_any_port() {
    let bench = Bench::with(&[(5, Mishap::Unplugged(1_000_000))]);
    bench.0.borrow_mut().cameras[0].serial = Some("0001".into());
    let mut camera = open(&bench);
    play(&mut camera, 10);
    let elsewhere = |bus: &str, number| FakeCamera {
        serial: Some("0001".into()),
        ..FakeCamera::new(number, "Fake Camera", bus)
    };
    bench.0.borrow_mut().cameras.extend([elsewhere("usb-8", 8), elsewhere("usb-9", 9)]);
    assert!(play(&mut camera, 40).is_empty(), "of two alike neither is known to be it");
    bench.0.borrow_mut().cameras.pop();
    assert!(play(&mut camera, 60).len() > 10);
    assert_eq!(camera.facts().unwrap().info.bus_info, "usb-8");
}

#[test]
fn a_stalled_camera_is_told_waited_for_and_begun_anew() {
    let bench = Bench::with(&[(5, Mishap::Silence(1_000_000))]);
    let mut camera = open(&bench);
    assert_eq!(play(&mut camera, 5).len(), 5);
    play(&mut camera, 8);
    assert_eq!(camera.health().state, CameraState::Streaming, "0.4 s are no stall");
    play(&mut camera, 10);
    let stalled = camera.health();
    assert_eq!((stalled.state, stalled.restarted), (CameraState::Stalled, 0));
    let seen = play(&mut camera, 120);
    let health = camera.health();
    assert_eq!((health.state, health.restarted), (CameraState::Streaming, 1), "after five seconds");
    assert_eq!(numbers(&seen)[..2], [5, 6]);
}

#[test]
fn a_short_silence_passes_by_itself() {
    let bench = Bench::with(&[(5, Mishap::Silence(50))]);
    let mut camera = open(&bench);
    let seen = play(&mut camera, 100);
    assert_eq!((camera.health().restarted, camera.health().state), (0, CameraState::Streaming));
    assert!(seen.len() > 40 && numbers(&seen)[5] == 6, "the driver counted the one that it swallowed");
}

#[test]
fn requests_that_fail_once_do_no_harm() {
    let bench = Bench::new();
    let mut camera = open(&bench);
    play(&mut camera, 5);
    bench.0.borrow_mut().failing_queue = 1;
    let seen = play(&mut camera, 20);
    assert!(seen.len() > 10 && camera.health().restarted == 1, "{:?}", camera.health());
    let mut at_the_start = Bench::new();
    for fail in
        [(|w| w.failing_allocate = 1) as fn(&mut World), |w| w.failing_queue = 2, |w| w.failing_start = 3]
    {
        at_the_start = Bench::new();
        fail(&mut at_the_start.0.borrow_mut());
        assert_eq!(play(&mut open(&at_the_start), 5).len(), 5);
    }
    at_the_start.0.borrow_mut().failing_start = 100;
    let error = open_as(&at_the_start, request("/dev/video0")).unwrap_err();
    assert!(error.is_internal() && error.to_string().contains("the driver refuses to stream"), "{error}");
    assert_eq!(at_the_start.0.borrow().open_nodes, 0);
}

#[test]
fn a_busy_device_and_a_full_bus_are_told_at_once() {
    for (error, words) in [(Errno::BUSY, "another program"), (Errno::NOSPC, "no bandwidth left")] {
        let bench = Bench::new();
        (bench.0.borrow_mut().error, bench.0.borrow_mut().failing_start) = (error, 1);
        let told = open_as(&bench, request("/dev/video0")).unwrap_err();
        assert!(told.to_string().contains(words) && !told.is_internal(), "{told}");
    }
}

#[test]
fn what_cannot_be_opened_is_told_with_what_there_is() {
    let bench = Bench::new();
    {
        let mut world = bench.0.borrow_mut();
        let metadata = NodeInfo { kind: NodeKind::Metadata, ..world.cameras[0].info.clone() };
        let mut second = FakeCamera::new(1, "Fake Camera", "usb-1");
        second.info = metadata;
        let locked = FakeCamera { closed: Some(Errno::ACCESS), ..FakeCamera::new(3, "Locked", "usb-3") };
        let other = FakeCamera::new(2, "Fake Camera", "usb-2");
        world.cameras.extend([second, other, locked]);
    }
    let told = |device: &str| open_as(&bench, request(device)).unwrap_err().to_string();
    let absent = told("/dev/video9");
    assert!(
        absent.contains("there is no `/dev/video9`") && absent.contains("/dev/video0 (Fake Camera, usb-1)"),
        "{absent}"
    );
    assert!(told("Unheard Of").contains("/dev/video2 (Fake Camera, usb-2)"));
    let several = told("fake");
    assert!(several.contains("several cameras: /dev/video0") && several.contains("usb-2"), "{several}");
    let metadata = told("/dev/video1");
    assert!(
        metadata.contains("metadata node") && metadata.contains("images are at /dev/video0"),
        "{metadata}"
    );
    let locked = told("/dev/video3");
    assert!(locked.contains("permission denied"), "{locked}");
    for device in ["usb-2", "/dev/video2"] {
        assert_eq!(
            open_as(&bench, request(device)).unwrap().facts().unwrap().path.to_str(),
            Some("/dev/video2")
        );
    }
    let substituted = Bench::new();
    substituted.0.borrow_mut().substitutes = Some((32, 32));
    let error = open_as(&substituted, request("/dev/video0")).unwrap_err().to_string();
    assert!(
        error.contains("GREY 16x16 became GREY 32x32") && error.contains("it offers GREY in 8x8 to 16x16"),
        "{error}"
    );
}

#[test]
fn the_exposure_is_set_by_hand_and_read_while_it_is_automatic() {
    let bench = Bench::new();
    let mut by_hand = request("/dev/video0");
    by_hand.settings.set_exposure = true;
    let camera = open_as(&bench, by_hand.clone()).unwrap();
    assert_eq!(bench.0.borrow().set_controls, [(0x009a_0901, 1), (0x009a_0902, 40)], "mode, then time");
    assert!(!camera.facts().unwrap().exposure_is_automatic);
    by_hand.exposure = SpanNs(600 * MS);
    let error = open_as(&bench, by_hand).unwrap_err().to_string();
    assert!(error.contains("allowed is 0 to 500"), "{error}");

    let bench = Bench::new();
    let mut camera = open(&bench);
    assert!(camera.facts().unwrap().exposure_is_automatic);
    bench.0.borrow_mut().exposure_units = 300;
    let seen = play(&mut camera, 20);
    assert_eq!((seen[0].0.span, seen[19].0.span), (SpanNs(10 * MS), SpanNs(30 * MS)));
    bench.0.borrow_mut().exposure_units = 100_000;
    assert_eq!(
        play(&mut camera, 20)[19].0.span,
        PERIOD,
        "no exposure is longer than the time between frames"
    );
}

#[test]
fn a_driver_that_says_no_clock_is_dated_by_arrival() {
    let bench = Bench::new();
    bench.0.borrow_mut().clock = StampClock::Unknown;
    let mut camera = open(&bench);
    let seen = play(&mut camera, 3);
    assert_eq!(seen[0].0.mid, MonoNs(10_040 * MS - 5 * MS));
    assert!(camera.health().stamps_are_doubted);
    assert_eq!(camera.facts().unwrap().stamp_doubt, Some(StampDoubt::UnknownClock));
}

const REGION: SensorArea = SensorArea { left: 2, top: 4, width: 10, height: 8 };

/// The first frame of a camera with [`REGION`], whose device cuts in such steps, if it does.
fn cut(bench: &Bench, cuts: Option<u32>) -> Result<Vec<u8>, V4l2Error> {
    (bench.0.borrow_mut().cuts, bench.0.borrow_mut().numbered) = (cuts, true);
    let mut camera = open_as(bench, CaptureRequest { region: Some(REGION), ..request("/dev/video0") })?;
    camera.wait(SLICE).unwrap().unwrap();
    let mut out = vec![0; (REGION.width * REGION.height) as usize];
    assert_eq!(camera.fill(&mut out).unwrap(), Filled::Image);
    Ok(out)
}

#[test]
fn a_region_is_cropped_by_device_or_conversion() {
    let bench = Bench::new();
    let here = cut(&bench, None).unwrap();
    let wanted: Vec<u8> = (4..12).flat_map(|row| (2..12).map(move |column| row * 16 + column)).collect();
    assert_eq!(here, wanted);
    let there = cut(&bench, Some(2)).unwrap();
    assert_eq!((there, bench.0.borrow().area), ((0..80).collect(), REGION), "rows of its own");
    let error = cut(&bench, Some(4)).unwrap_err().to_string();
    assert!(error.contains("10x8 at column 0, row 4 instead of 10x8 at column 2, row 4"), "{error}");
    // What one run cut is not left to the next.
    drop(open(&bench));
    assert_eq!(bench.0.borrow().area, WHOLE);
}

fn mishap() -> impl Strategy<Value = Mishap> {
    prop_oneof![
        Just(Mishap::Dropped),
        Just(Mishap::Damaged),
        Just(Mishap::Short),
        Just(Mishap::Interlaced),
        Just(Mishap::StreamError),
        (1..100_u32).prop_map(Mishap::Unplugged),
        (1..300_u32).prop_map(Mishap::Silence),
        (-5_000..5_000_i64).prop_map(Mishap::Stamped),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    /// Whatever happens: numbers only grow, no frame is dated later than it came, each is of its own exposure, no buffer is given twice
    /// (the bench fails), and when nothing more happens frames come again.
    #[test]
    fn any_mishaps_are_survived(
        script in proptest::collection::btree_map(0..60_u64, mishap(), 0..20),
        failing in (0..3_u32, 0..3_u32, 0..3_u32),
        pauses in proptest::collection::vec(0..400_i64, 0..20),
    ) {
        let bench = Bench::new();
        bench.0.borrow_mut().script = script;
        let mut camera = open(&bench);
        {
            let mut world = bench.0.borrow_mut();
            (world.failing_queue, world.failing_start, world.failing_allocate) = failing;
        }
        let mut pauses = pauses.into_iter();
        let (mut last, mut frames) = (None, 0);
        let mut out = [0; (WIDTH * HEIGHT) as usize];
        while bench.0.borrow().exposed < 61 || frames == 0 {
            let Some(captured) = camera.wait(SLICE).unwrap() else { continue };
            prop_assert!(captured.mid <= bench.0.borrow().now);
            prop_assert!(last.is_none_or(|last| captured.sequence > last));
            last = Some(captured.sequence);
            if let Some(ms) = pauses.next() {
                bench.pass(ms);
            }
            if camera.fill(&mut out).unwrap() == Filled::Image {
                prop_assert!(out.iter().all(|level| *level == out[0]));
                frames += 1;
            }
        }
        let after: usize = (0..400).map(|_| play(&mut camera, 1).len()).sum();
        prop_assert!(after > 20 && camera.health().state == CameraState::Streaming, "{after}: {:?}", camera.health());
        prop_assert!(bench.0.borrow().open_nodes == 1);
        drop(camera);
        prop_assert!(bench.0.borrow().open_nodes == 0);
    }
}
