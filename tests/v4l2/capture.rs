//! The library's camera source on a device of the guest, and what its frames must be.

use crate::usb_camera::JPEGS;
use crate::usb_camera::test_image::{self, Marks};
use std::path::Path;
use std::time::Duration;
use vservo::config::Config;
use vservo::rt;
use vservo::source::{self, AnySource, Captured, Filled, FreeRunningSource, SourceError, SourceHealth};
use vservo::time::{MonoNs, SpanNs};

/// Longest wait for a frame that must come, guest time: longer than any pause between attempts to reopen a camera.
const PATIENCE: SpanNs = SpanNs(20_000_000_000);

/// What is asked of a device.
#[derive(Debug, Clone, Copy)]
pub struct CaptureRequest<'a> {
    pub format: &'a str,
    pub size: (usize, usize),
    pub rate_hz: f64,
}

impl CaptureRequest<'_> {
    /// A VGA camera at 25 Hz.
    pub const VGA: CaptureRequest<'static> =
        CaptureRequest { format: "GREY", size: (640, 480), rate_hz: 25.0 };
}

/// The text of a run file with this camera; `extra` are more keys of `[camera.v4l2]`.
pub fn run_file(device: &str, request: CaptureRequest<'_>, extra: &str) -> String {
    let CaptureRequest { format, size: (width, height), rate_hz } = request;
    // As much of the world as the default camera shows.
    let f_px = 800.0 * (width as f64 / 640.0).min(height as f64 / 480.0);
    format!(
        "[camera]\nsource = \"v4l2\"\nwidth_px = {width}\nheight_px = {height}\nrate_hz = {rate_hz:?}\n\
         lens = {{ fx_px = {f_px:?}, fy_px = {f_px:?} }}\n[camera.v4l2]\ndevice = \"{device}\"\nformat = \"{format}\"\n{extra}\n"
    )
}

/// A configuration with this camera.
pub fn config(device: &Path, request: CaptureRequest<'_>, extra: &str) -> Config {
    let text = run_file(device.to_str().unwrap(), request, extra);
    Config::parse("cell.toml", &text, Path::new("."), &[]).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// A source and the frame that it gave last.
pub struct Capture {
    source: Box<dyn FreeRunningSource>,
    pub grey: Vec<u8>,
    pub width: usize,
}

impl Capture {
    pub fn open(device: &Path, request: CaptureRequest<'_>) -> Self {
        Self::with(&config(device, request, "")).unwrap()
    }

    pub fn with(config: &Config) -> Result<Self, SourceError> {
        let AnySource::FreeRunning(source) = source::open(config)? else { panic!("a free-running source") };
        let i = config.camera.model.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        Ok(Self { source, grey: vec![0; width * height], width })
    }

    /// The next frame, if one comes within `longest`; its pixels are in `grey`.
    pub fn within(&mut self, longest: SpanNs) -> Option<Captured> {
        let end = rt::now() + longest;
        while rt::now() < end {
            if let Some(captured) = self.source.wait(Duration::from_millis(50)).unwrap()
                && self.source.fill(&mut self.grey).unwrap() == Filled::Image
            {
                return Some(captured);
            }
        }
        None
    }

    /// The next frame, which must come.
    pub fn next(&mut self) -> Captured {
        self.within(PATIENCE).expect("a frame")
    }

    /// The next frame of the emulated USB camera and what is written in it.
    pub fn next_marked(&mut self) -> (Captured, Marks) {
        let captured = self.next();
        (captured, test_image::read(&self.grey, self.width).expect("a whole image"))
    }

    /// How the camera stands.
    pub fn health(&self) -> SourceHealth {
        self.source.health()
    }

    /// Takes frames for so long.
    pub fn run(&mut self, span: SpanNs, mut look: impl FnMut(&Captured, &[u8])) -> Taken {
        let mut taken = Taken::default();
        let end = rt::now() + span;
        while rt::now() < end {
            let captured = self.next();
            look(&captured, &self.grey);
            taken.note(&captured);
        }
        taken
    }
}

/// A series of frames.
#[derive(Debug, Default)]
pub struct Taken {
    pub frames: Vec<(MonoNs, u64)>,
    /// What the source says it lost beside gaps.
    pub lost: u64,
}

impl Taken {
    pub fn note(&mut self, captured: &Captured) {
        self.frames.push((captured.mid, captured.sequence));
        self.lost = captured.lost;
    }

    /// Frames that the source's count leaves out.
    pub fn gaps(&self) -> u64 {
        self.frames.windows(2).map(|w| w[1].1 - w[0].1 - 1).sum()
    }

    /// Asserts that stamps grow, and lie no further from the arrival than frames stay on their way.
    pub fn assert_stamps_grow(&self) {
        assert!(self.frames.windows(2).all(|w| w[1].0 > w[0].0 && w[1].1 > w[0].1), "{:?}", self.frames);
    }

    /// Asserts that nothing is missing, in `span` at `rate_hz`.
    pub fn assert_whole(&self, span: SpanNs, rate_hz: f64) {
        self.assert_stamps_grow();
        assert_eq!((self.gaps(), self.lost), (0, 0));
        let expected = span.as_s() * rate_hz;
        let count = self.frames.len() as f64;
        assert!((count - expected).abs() <= 2.0, "{count} frames where {expected} were due");
        let (first, last) = (self.frames[0], self.frames[self.frames.len() - 1]);
        let obtained_hz = (last.1 - first.1) as f64 / (last.0 - first.0).as_s();
        assert!((obtained_hz / rate_hz - 1.0).abs() < 0.01, "{obtained_hz} Hz instead of {rate_hz}");
    }
}

/// Asserts that a frame is the emulated camera's image to the last pixel; to a few levels where it was a JPEG.
pub fn assert_image(grey: &[u8], (width, height): (usize, usize), is_jpeg: bool) -> Marks {
    let marks = test_image::read(grey, width).expect("a whole image");
    let drawn = test_image::draw(marks, width, height);
    if is_jpeg {
        let sum: u64 = grey.iter().zip(&drawn).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        assert!(sum < 2 * grey.len() as u64, "{} levels off", sum as f64 / grey.len() as f64);
    } else {
        assert_eq!(test_image::difference(grey, &drawn), 0, "{marks:?}");
    }
    marks
}

/// The number that follows in a camera's images.
pub fn number_after(number: u16, is_jpeg: bool) -> u16 {
    if is_jpeg { (number + 1) % JPEGS as u16 } else { number.wrapping_add(1) }
}

/// Asserts that a frame is vivid's checkers of 16 px (its pattern 10), whatever its two levels.
pub fn assert_checkers(grey: &[u8], width: usize) {
    let (low, high) = (grey.iter().min().unwrap(), grey.iter().max().unwrap());
    assert!(*low <= 16 && *high >= 234, "levels {low} to {high}");
    for (y, row) in grey.chunks(width).enumerate() {
        for (x, level) in row.iter().enumerate() {
            let odd = (x / 16 + y / 16) % 2 == 1;
            let odd_of_first = grey[0] == *high;
            assert_eq!(*level == *high, odd != odd_of_first, "column {x}, row {y}: {level}");
            assert!(level == low || level == high, "column {x}, row {y}: {level}");
        }
    }
}

/// Controls that make vivid show those checkers and nothing else.
pub const CHECKERS: &str = "osd_text_mode=2,test_pattern=10";
