//! An external camera against scripted programs: each thing that one may do wrong, and what is made of it.

use super::*;
use crate::config::Config;
use crate::source::OddHeaders;
use crate::source::v4l2::{Probe, SourceCheck};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

const MS: i64 = 1_000_000;
/// 40 ms: the 25 Hz of the default camera.
const PERIOD: i64 = 40 * MS;
const PIXELS: usize = 640 * 480;

#[derive(Debug, Clone)]
struct ScriptedImage(ImageHeader, Vec<u8>);

impl ForeignImage for ScriptedImage {
    fn header(&self) -> ImageHeader {
        self.0
    }

    fn bytes(&self) -> &[u8] {
        &self.1
    }
}

/// What a program does, in the order of its arrivals.
#[derive(Debug)]
struct Script {
    now: i64,
    waiting: VecDeque<(i64, ScriptedImage)>,
    sender: bool,
}

#[derive(Debug, Clone)]
struct ScriptedLink(Rc<RefCell<Script>>);

impl ImageLink for ScriptedLink {
    type Image = ScriptedImage;

    fn wait(&mut self, longest: Duration) -> Result<(), SourceError> {
        let mut script = self.0.borrow_mut();
        let latest = script.now + longest.as_nanos() as i64;
        script.now = script.waiting.front().map_or(latest, |(at, _)| latest.min(*at)).max(script.now);
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<ScriptedImage>, SourceError> {
        let mut script = self.0.borrow_mut();
        let due = script.waiting.front().is_some_and(|(at, _)| *at <= script.now);
        Ok(due.then(|| script.waiting.pop_front()).flatten().map(|(_, image)| image))
    }

    fn has_sender(&mut self) -> bool {
        self.0.borrow().sender
    }

    fn now(&self) -> MonoNs {
        MonoNs(self.0.borrow().now)
    }
}

fn header(sequence: u64) -> ImageHeader {
    ImageHeader {
        sequence,
        format: u32::from_le_bytes(*b"GREY"),
        width_px: 640,
        height_px: 480,
        ..ImageHeader::default()
    }
}

struct ImageBench {
    script: Rc<RefCell<Script>>,
    camera: ExternalCamera<ScriptedLink>,
}

impl ImageBench {
    fn new(set: &[&str]) -> Self {
        let set: Vec<_> = set.iter().map(ToString::to_string).collect();
        let config = Config::load(None, &[vec!["camera.source=external".into()], set].concat()).unwrap();
        let script =
            Rc::new(RefCell::new(Script { now: 1_000 * MS, waiting: VecDeque::new(), sender: true }));
        let camera = ExternalCamera::new(ScriptedLink(script.clone()), &config.camera);
        Self { script, camera }
    }

    /// An image that arrives at `at`, exposed 10 ms before unless its header says otherwise.
    fn gives(&self, at: i64, mut header: ImageHeader, bytes: Vec<u8>) {
        if header.stamp == MonoNs::ZERO {
            header.stamp = MonoNs(at - 10 * MS);
        }
        self.script.borrow_mut().waiting.push_back((at, ScriptedImage(header, bytes)));
    }

    /// So many good images, one a period, from `at` on; numbered from `first`.
    fn gives_good(&self, at: i64, first: u64, count: u64) -> i64 {
        for k in 0..count {
            self.gives(at + k as i64 * PERIOD, header(first + k), vec![k as u8; PIXELS]);
        }
        at + count as i64 * PERIOD
    }

    /// Everything that comes until the script is empty, each with its first grey level.
    fn play(&mut self) -> Vec<(Captured, u8)> {
        let (mut seen, mut out) = (Vec::new(), vec![0; PIXELS]);
        while !self.script.borrow().waiting.is_empty() {
            if let Some(captured) = self.camera.wait(Duration::from_millis(50)).unwrap()
                && self.camera.fill(&mut out).unwrap() == Filled::Image
            {
                seen.push((captured, out[0]));
            }
        }
        seen
    }

    fn wait_s(&mut self, seconds: u64) {
        for _ in 0..seconds * 20 {
            assert_eq!(self.camera.wait(Duration::from_millis(50)).unwrap(), None);
        }
    }
}

const START: i64 = 1_100 * MS;

#[test]
fn good_images_come_whole_dated_and_numbered() {
    let mut bench = ImageBench::new(&[]);
    bench.gives_good(START, 7, 5);
    let seen = bench.play();
    assert_eq!(seen.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert_eq!(seen.iter().map(|(c, _)| c.sequence).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert_eq!(seen[2].0.mid, MonoNs(START + 2 * PERIOD - 10 * MS));
    assert_eq!(seen[0].0.span, SpanNs(4 * MS), "camera.exposure_ms where the program says none");
    assert_eq!(bench.camera.health().state, CameraState::Streaming);
}

#[test]
fn a_wrong_first_image_is_an_error_that_says_the_remedy() {
    for (change, said) in [
        (
            ImageHeader { width_px: 1280, height_px: 720, ..header(0) },
            "1280x720 px, the run file says 640x480",
        ),
        (ImageHeader { format: u32::from_le_bytes(*b"H264"), ..header(0) }, "pixel format `H264`"),
        (ImageHeader { format: u32::MAX, ..header(0) }, "send one of GREY"),
        (ImageHeader { stride_bytes: 639, ..header(0) }, "639 bytes apart, 640 px need 640"),
        (ImageHeader { stride_bytes: u32::MAX, ..header(0) }, "their format and size need"),
        (
            ImageHeader { format: u32::from_le_bytes(*b"BGR3"), ..header(0) },
            "307200 bytes, their format and size need 921600",
        ),
        (ImageHeader { width_px: u32::MAX, height_px: u32::MAX, ..header(0) }, "camera.width_px"),
    ] {
        let mut bench = ImageBench::new(&[]);
        bench.gives(START, change, vec![0; PIXELS]);
        let error = loop {
            match bench.camera.wait(Duration::from_millis(50)) {
                Ok(found) => assert_eq!(found, None),
                Err(error) => break error.to_string(),
            }
        };
        assert!(error.contains(said), "{error}");
    }
}

#[test]
fn a_wrong_image_later_is_lost_and_counted() {
    let mut bench = ImageBench::new(&[]);
    let next = bench.gives_good(START, 0, 2);
    bench.gives(next, ImageHeader { width_px: 320, ..header(2) }, vec![0; PIXELS]);
    bench.gives(next + PERIOD, header(3), vec![0; PIXELS - 1]);
    bench.gives_good(next + 2 * PERIOD, 4, 1);
    let numbers: Vec<_> = bench.play().iter().map(|(c, _)| c.sequence).collect();
    assert_eq!(numbers, [0, 1, 4], "a gap is what the loop counts as lost");
    assert_eq!(bench.camera.health().corrupt, 2);
}

#[test]
fn gaps_wraps_and_new_beginnings_of_the_count() {
    let mut bench = ImageBench::new(&[]);
    for (k, raw) in [u64::from(u32::MAX) - 1, u64::from(u32::MAX), 1 << 32, (1 << 32) + 3, 5, 5, u64::MAX, 0]
        .into_iter()
        .enumerate()
    {
        bench.gives(START + k as i64 * PERIOD, header(raw), vec![0; PIXELS]);
    }
    let numbers: Vec<_> = bench.play().iter().map(|(c, _)| c.sequence).collect();
    assert_eq!(
        numbers,
        [0, 1, 2, 5, 7, 8, 9, 10],
        "three on: two lost; a count that jumps, stands or begins anew goes on"
    );
}

#[test]
fn of_several_that_wait_the_newest_counts() {
    let mut bench = ImageBench::new(&[]);
    for k in 0..3 {
        bench.gives(
            START,
            ImageHeader { stamp: MonoNs(START - (30 - k * 10) * MS), ..header(k as u64) },
            vec![k as u8; PIXELS],
        );
    }
    let seen = bench.play();
    assert_eq!((seen.len(), seen[0].1, bench.camera.health().superseded), (1, 2, 2));
}

#[test]
fn stamps_a_little_ahead_are_clamped_and_counted() {
    let mut bench = ImageBench::new(&[]);
    bench.gives(START, ImageHeader { stamp: MonoNs(START + 5 * MS), ..header(0) }, vec![0; PIXELS]);
    let seen = bench.play();
    assert_eq!(seen[0].0.mid, MonoNs(START), "no image is of the future");
    assert_eq!(bench.camera.health().stamps_clamped, 1);
}

/// Single impossible stamps lose their image; a clock that is another one is not believed any more.
#[test]
fn impossible_stamps_lose_images_then_arrivals_count() {
    for stamp in [|at: i64, _: i64| at + 3_600_000 * MS, |_: i64, first: i64| first] {
        let mut bench = ImageBench::new(&[]);
        let first = START - 10 * MS;
        let next = bench.gives_good(START, 0, 1);
        for k in 0..8 {
            let at = next + k * PERIOD;
            bench.gives(
                at,
                ImageHeader { stamp: MonoNs(stamp(at, first)), ..header(1 + k as u64) },
                vec![0; PIXELS],
            );
        }
        let seen = bench.play();
        let health = bench.camera.health();
        assert_eq!((health.undated, health.stamps_are_doubted), (4, true));
        assert_eq!(seen.len(), 5, "the first, and four by their arrival");
        assert_eq!(seen[4].0.mid, MonoNs(next + 7 * PERIOD));
    }
}

#[test]
fn images_without_stamps_are_dated_by_their_arrival() {
    let mut bench = ImageBench::new(&[]);
    let image = ScriptedImage(header(0), vec![0; PIXELS]);
    bench.script.borrow_mut().waiting.push_back((START, image));
    assert_eq!(bench.play()[0].0.mid, MonoNs(START));
    assert!(bench.camera.health().stamps_are_doubted);
}

#[test]
fn silence_and_death_are_told_apart_and_end_with_images() {
    let mut bench = ImageBench::new(&[]);
    bench.wait_s(2);
    assert_eq!(bench.camera.health().state, CameraState::Starting, "a program may take its time to begin");
    let now = bench.script.borrow().now;
    bench.gives_good(now + PERIOD, 0, 3);
    bench.play();
    bench.wait_s(2);
    assert_eq!(bench.camera.health().state, CameraState::Stalled);
    bench.script.borrow_mut().sender = false;
    bench.wait_s(1);
    assert_eq!(bench.camera.health().state, CameraState::Gone);
    let now = bench.script.borrow().now;
    bench.gives_good(now + PERIOD, 0, 2);
    let numbers: Vec<_> = bench.play().iter().map(|(c, _)| c.sequence).collect();
    assert_eq!(numbers, [3, 4], "another program begins its own count");
    assert_eq!((bench.camera.health().state, bench.camera.health().restarted), (CameraState::Streaming, 1));
}

#[test]
fn a_program_that_never_comes_is_away_after_three_seconds() {
    let mut bench = ImageBench::new(&[]);
    bench.script.borrow_mut().sender = false;
    bench.wait_s(4);
    assert_eq!(bench.camera.health().state, CameraState::Gone);
}

#[test]
fn another_rate_is_measured_and_told() {
    for (rate, off) in
        [("camera.rate_hz=25", false), ("camera.rate_hz=30", true), ("camera.rate_hz=15", true)]
    {
        let mut bench = ImageBench::new(&[rate, "safety.measurement_timeout_ms=400"]);
        bench.gives_good(START, 0, 60);
        bench.play();
        let health = bench.camera.health();
        assert!((health.rate_hz.unwrap() - 25.0).abs() < 0.1);
        assert_eq!(health.rate_is_missed, off, "{rate}");
    }
}

/// A region of colour images, whose lines have padding: the pixel of row 7, column 5 becomes the first.
#[test]
fn the_region_is_cut_out_of_whole_images() {
    let region = "camera.roi={x_px=5,y_px=7,width_px=600,height_px=460}";
    let mut bench = ImageBench::new(&[region]);
    let stride = 640 * 3 + 8;
    let mut bytes = vec![0; stride * 480];
    bytes[7 * stride + 15..7 * stride + 18].copy_from_slice(&[10, 100, 200]);
    let bgr = ImageHeader { format: u32::from_le_bytes(*b"BGR3"), stride_bytes: stride as u32, ..header(0) };
    bench.gives(START, bgr, bytes);
    while bench.camera.wait(Duration::from_millis(50)).unwrap().is_none() {}
    let mut out = vec![0; 600 * 460];
    assert_eq!(bench.camera.fill(&mut out).unwrap(), Filled::Image);
    let wanted: f64 = 0.114 * 10.0 + 0.587 * 100.0 + 0.299 * 200.0;
    assert!((f64::from(out[0]) - wanted).abs() <= 1.0, "{} for {wanted}", out[0]);
    assert!(out[1..].iter().all(|level| *level == 0));
}

/// Everything that comes until the script is empty, and `silence_s` more, as a check of the camera measures it.
fn checked(bench: &mut ImageBench, silence_s: f64) -> SourceCheck {
    let script = bench.script.clone();
    let mut now = || MonoNs(script.borrow().now);
    let mut probe = Probe::new(25.0, PIXELS, now());
    while !script.borrow().waiting.is_empty() {
        let _ = probe.take(&mut bench.camera, &mut now).unwrap();
    }
    let end = now() + SpanNs::from_s(silence_s);
    while now() < end {
        assert!(probe.take(&mut bench.camera, &mut now).unwrap().is_none());
    }
    probe.check(&bench.camera.health(), now()).unwrap()
}

#[test]
fn frames_that_do_not_come_at_the_end_are_lost_in_a_check() {
    let whole = |bench: &mut ImageBench| bench.gives_good(START, 0, 30);
    let mut good = ImageBench::new(&[]);
    whole(&mut good);
    let check = checked(&mut good, 0.04);
    assert_eq!((check.frames, check.lost, check.silent, check.away), (30, 0, 0, None));
    for (sender, away) in [(true, "stalled"), (false, "unplugged")] {
        let mut bench = ImageBench::new(&[]);
        whole(&mut bench);
        bench.script.borrow_mut().sender = sender;
        let check = checked(&mut bench, 4.0);
        assert_eq!((check.frames, check.away), (30, Some(away)));
        assert!((check.lost as i64 - 100).abs() <= 1 && check.lost == check.silent, "{check:?}");
        assert!((check.duration_s - (29.0 * 0.04 + 4.0)).abs() < 0.1, "{check:?}");
    }
    // Such as are of another size, and nothing else.
    let mut bench = ImageBench::new(&[]);
    let next = whole(&mut bench);
    for k in 0..50 {
        bench.gives(
            next + k * PERIOD,
            ImageHeader { width_px: 320, ..header(30 + k as u64) },
            vec![0; PIXELS],
        );
    }
    let check = checked(&mut bench, 0.0);
    assert_eq!((check.frames, check.corrupt, check.away), (30, 50, Some("stalled")));
    assert!((50..=51).contains(&check.lost), "{check:?}");
}

#[test]
fn headers_that_no_camera_can_mean_are_counted() {
    let odd_of = |change: fn(ImageHeader) -> ImageHeader| {
        let mut bench = ImageBench::new(&[]);
        for k in 0..10 {
            bench.gives(START + k * PERIOD, change(header(k as u64)), vec![0; PIXELS]);
        }
        assert_eq!(bench.play().len(), 10, "they are used");
        bench.camera.health().odd_headers
    };
    assert_eq!(odd_of(|h| ImageHeader { exposure_span_ns: PERIOD as u64, ..h }), OddHeaders::default());
    assert_eq!(
        odd_of(|h| ImageHeader { sequence: 5, ..h }),
        OddHeaders { sequence: 9, ..OddHeaders::default() }
    );
    let exposure = OddHeaders { exposure: 10, ..OddHeaders::default() };
    assert_eq!(odd_of(|h| ImageHeader { exposure_span_ns: u64::MAX, ..h }), exposure);
    assert_eq!(odd_of(|h| ImageHeader { exposure_span_ns: 2 * PERIOD as u64, ..h }), exposure);
    let reserved = OddHeaders { reserved: 10, ..OddHeaders::default() };
    assert_eq!(odd_of(|h| ImageHeader { flags: 7, ..h }), reserved);
    assert_eq!(odd_of(|h| ImageHeader { reserved: 9, ..h }), reserved);
}
