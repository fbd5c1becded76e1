//! Where frames come from: keys, bounds and facts of every kind of source in one place.
//!
//! Two properties are independent of each other. A *simulated* source has a [`super::Scene`], whose truth gives the errors of measurements;
//! a source that *closes the loop* shows the motion of the arm, so that a goal can be reached:
//!
//! ```text
//!                   simulated    closes the loop    timing
//! synthetic            yes             yes          scheduled
//! v4l2 (a real one)     no             yes          free-running
//! external (a program)  no             yes          free-running
//! replay                no              no          scheduled
//! ```

use super::check::Validation;
use super::place::RawMount;
use super::v4l2::{self, RawV4l2, V4l2Settings};
use crate::camera_model::{LensModel, Response};
use crate::input::used;
use crate::scene::{SceneLook, SensorModel};
use crate::time::SpanNs;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

word! {
    /// Where frames come from.
    SourceKind {
        /// Rendered from the arm's pose.
        Synthetic,
        /// Read from image files.
        Replay,
        /// A camera of the kernel's video interface.
        V4l2,
        /// Another program, which gives images through `camera/N/image`.
        External,
    }
}

impl SourceKind {
    /// Who triggers its exposures.
    #[must_use]
    pub fn timing(self) -> Timing {
        match self {
            Self::Synthetic | Self::Replay => Timing::Scheduled,
            Self::V4l2 | Self::External => Timing::FreeRunning,
        }
    }

    /// Whether its images are of a simulated scene, so that the truth is known.
    #[must_use]
    pub fn is_simulated(self) -> bool {
        match self {
            Self::Synthetic => true,
            Self::Replay | Self::V4l2 | Self::External => false,
        }
    }

    /// Whether its images show what the arm does; without that the loop is open, and the arm does not move.
    #[must_use]
    pub fn closes_the_loop(self) -> bool {
        match self {
            Self::Synthetic | Self::V4l2 | Self::External => true,
            Self::Replay => false,
        }
    }
}

/// Who triggers the exposures of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Timing {
    /// Its caller, which requests each frame.
    Scheduled,
    /// The source itself, which reports the time.
    FreeRunning,
}

table! {
    /// The camera, its rate and its optics.
    RawCamera {
        /// What people call it.
        name: Option<String> = None,
        /// Producer of frames.
        source: SourceKind = SourceKind::Synthetic,
        /// Columns of the whole image, px.
        width_px: u32 = 640,
        /// Rows of the whole image, px.
        height_px: u32 = 480,
        /// Frames per second.
        rate_hz: f64 = 25.0,
        /// Length of the exposure, ms.
        exposure_ms: f64 = 4.0,
        /// From the middle of the exposure to the hand-over of the frame, ms. In lockstep: to the first tick that
        /// may use it.
        latency_ms: f64 = 20.0,
        /// Added to every exposure stamp that the camera gives, ms: what `vservo calibrate latency` found.
        stamp_offset_ms: f64 = 0.0,
        /// How its levels depend on light: `auto` (`unknown` for real cameras, else `linear`), `linear` (levels are light), `unknown` (taken as light; corners of tags are
        /// corrected by an estimate from their edges, with larger covariances), `srgb`, `gamma:G`, or `table:L,L,...` with the light of 2 to 33
        /// equally spaced levels; levels are made proportional to light before anything is measured.
        response: String = "auto".to_owned(),
        /// `[camera.roi]`; left out: all of the sensor.
        roi: Option<RawRoi> = None,
        /// `[camera.lens]`
        lens: RawLens = RawLens::default(),
        /// `[camera.mount]`
        mount: RawMount = RawMount::default(),
        /// `[camera.synthetic]`
        synthetic: RawSynthetic = RawSynthetic::default(),
        /// `[camera.replay]`
        replay: RawReplay = RawReplay::default(),
        /// `[camera.v4l2]`
        v4l2: RawV4l2 = RawV4l2::default(),
        /// `[camera.external]`
        external: RawCameraProgram = RawCameraProgram::default(),
    }
}

table! {
    /// Intrinsic parameters, (5.41), and how the lens bends directions.
    RawLens {
        /// Calibration file of ROS (`camera_info`), which has all that follows; only where it is read.
        file: Option<PathBuf> = None,
        /// Which formula the coefficients are of.
        model: LensWord = LensWord::PlumbBob,
        /// Focal length times horizontal scale, px.
        fx_px: f64 = 800.0,
        /// Focal length times vertical scale, px.
        fy_px: f64 = 800.0,
        /// Column of the principal point, px; the image's centre where it is left out.
        cx_px: Option<f64> = None,
        /// Row of the principal point, px.
        cy_px: Option<f64> = None,
        /// Radial distortion of second order.
        k1: f64 = -0.15,
        /// Radial distortion of fourth order.
        k2: f64 = 0.05,
        /// Tangential distortion.
        p1: f64 = 0.0,
        /// Tangential distortion.
        p2: f64 = 0.0,
        /// Radial distortion of sixth order.
        k3: f64 = 0.0,
        /// Fourth radial coefficient of `rational_polynomial` and `equidistant`.
        k4: f64 = 0.0,
        /// Fifth radial coefficient of `rational_polynomial`.
        k5: f64 = 0.0,
        /// Sixth radial coefficient of `rational_polynomial`.
        k6: f64 = 0.0,
    }
}

word! {
    /// Models of lenses, as ROS names them.
    LensWord {
        /// Radial polynomial and tangential part.
        PlumbBob,
        /// Radial fraction of polynomials and tangential part.
        RationalPolynomial,
        /// Polynomial of the angle from the axis.
        Equidistant,
    }
}

impl From<LensWord> for LensModel {
    fn from(word: LensWord) -> Self {
        match word {
            LensWord::PlumbBob => Self::PlumbBob,
            LensWord::RationalPolynomial => Self::RationalPolynomial,
            LensWord::Equidistant => Self::Equidistant,
        }
    }
}

impl From<LensModel> for LensWord {
    fn from(model: LensModel) -> Self {
        match model {
            LensModel::PlumbBob => Self::PlumbBob,
            LensModel::RationalPolynomial => Self::RationalPolynomial,
            LensModel::Equidistant => Self::Equidistant,
        }
    }
}

impl RawLens {
    /// All coefficients by their names.
    #[must_use]
    pub fn coefficients(&self) -> [(&'static str, f64); 8] {
        let Self { k1, k2, p1, p2, k3, k4, k5, k6, .. } = *self;
        [("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6)]
    }

    /// The coefficient of this name, 0 where there is none.
    #[must_use]
    pub fn coefficient(&self, name: &str) -> f64 {
        self.coefficients().iter().find(|(n, _)| *n == name).map_or(0.0, |(_, value)| *value)
    }

    /// The place of the coefficient of this name.
    pub(super) fn coefficient_mut(&mut self, name: &str) -> Option<&mut f64> {
        Some(match name {
            "k1" => &mut self.k1,
            "k2" => &mut self.k2,
            "p1" => &mut self.p1,
            "p2" => &mut self.p2,
            "k3" => &mut self.k3,
            "k4" => &mut self.k4,
            "k5" => &mut self.k5,
            "k6" => &mut self.k6,
            _ => return None,
        })
    }
}

table! {
    /// The part of the sensor that is read.
    RawRoi {
        /// First column, px.
        x_px: u32 = 0,
        /// First row, px.
        y_px: u32 = 0,
        /// Columns, px.
        width_px: u32 = 0,
        /// Rows, px.
        height_px: u32 = 0,
    }
}

table! {
    /// Imperfections of the synthetic camera.
    RawSynthetic {
        /// Standard deviation of the noise, grey levels.
        noise_sd_levels: f64 = 2.0,
        /// Standard deviation of the optical blur, px.
        blur_sd_px: f64 = 0.5,
        /// Light lost in the corners, as share of that in the centre.
        vignetting: f64 = 0.15,
        /// Whether motion during the exposure blurs the image.
        motion_blur: bool = true,
        /// How its levels really depend on light, as `camera.response`.
        response: String = "linear".to_owned(),
        /// Frames are late by up to this, evenly distributed, ms.
        latency_jitter_ms: f64 = 0.0,
        /// Share of the frames that are lost, 0 to 1.
        frame_loss: f64 = 0.0,
        /// How wrong the exposure stamps are, ms; positive: late.
        stamp_error_ms: f64 = 0.0,
    }
}

table! {
    /// A folder of images, or a recording, as camera.
    RawReplay {
        /// Folder with PNG, PGM or JPEG files, played in the order of their names.
        folder: PathBuf = PathBuf::new(),
        /// Instead of a folder, a recording of vservo or of ROS 2 (MCAP), whose images are played.
        recording: PathBuf = PathBuf::new(),
        /// The topic of the recording whose images are played; where it is left out, that of this camera, or the only one with images.
        topic: Option<String> = None,
        /// Starts again after the last file instead of ending the run.
        repeat: bool = false,
        /// The first file that is damaged ends the run; otherwise it is reported, counted and skipped.
        strict: bool = false,
    }
}

table! {
    /// A camera in another program.
    RawCameraProgram {
        /// Program and arguments that `vservo run` starts as the camera; empty where it is started by other means.
        command: Vec<String> = Vec::new(),
        /// Folder in which it is started; that of the run file where it is left out.
        folder: PathBuf = PathBuf::new(),
        /// Time without images after which the run ends, s; until then the arm holds and the program is awaited.
        give_up_s: f64 = 60.0,
    }
}

/// A camera in another program.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraProgram {
    /// Program and arguments; empty where it is started from outside.
    pub command: Vec<String>,
    /// Where it is started.
    pub folder: PathBuf,
    /// Longest silence.
    pub give_up: SpanNs,
}

/// The program of a camera whose table is `at`; whether it can be started is looked at where it is used.
fn program(raw: &RawCameraProgram, at: &str, is_used: bool, check: &mut Validation<'_>) -> CameraProgram {
    let key = |name: &str| format!("{at}.external.{name}");
    if is_used {
        check.program(&key("command"), &raw.command, &key("folder"), &raw.folder);
    }
    CameraProgram {
        command: raw.command.clone(),
        folder: raw.folder.clone(),
        give_up: SpanNs::from_s(check.range(&key("give_up_s"), raw.give_up_s, 1.0..=86_400.0)),
    }
}

/// Where the images of a replay are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReplayImages {
    /// In the files of a folder.
    Folder(PathBuf),
    /// On a topic of a recording.
    Recording {
        /// The recording.
        file: PathBuf,
        /// The topic; where it is none, that of this camera, or the only one with images.
        topic: Option<String>,
    },
}

/// Producer of frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Source {
    /// Rendered.
    Synthetic {
        /// Grey levels of the scene.
        look: SceneLook,
        /// Imperfections of the sensor.
        sensor: SensorModel,
        /// Whether motion during the exposure blurs the image.
        motion_blur: bool,
        /// How levels depend on light.
        response: Response,
    },
    /// Images that were taken before.
    Replay {
        /// Where they are.
        images: ReplayImages,
        /// Starts again after the last one.
        repeat: bool,
        /// A damaged one ends it.
        strict: bool,
    },
    /// A camera of the kernel's video interface.
    V4l2(V4l2Settings),
    /// Another program.
    External(CameraProgram),
}

impl Source {
    /// The word that names it.
    #[must_use]
    pub fn kind(&self) -> SourceKind {
        match self {
            Self::Synthetic { .. } => SourceKind::Synthetic,
            Self::Replay { .. } => SourceKind::Replay,
            Self::V4l2(_) => SourceKind::V4l2,
            Self::External(_) => SourceKind::External,
        }
    }
}

/// The response that the text at `key` names.
pub(super) fn response(key: &str, text: &str, check: &mut Validation<'_>) -> Response {
    text.parse().unwrap_or_else(|wrong: String| {
        check.wrong(key, wrong);
        Response::Linear
    })
}

/// Where the images of `replay` are.
fn replay_images(
    replay: &RawReplay,
    key: impl Fn(&str) -> String,
    check: &mut Validation<'_>,
) -> ReplayImages {
    let RawReplay { folder, recording, topic, .. } = replay;
    let is_named = |path: &PathBuf| !path.as_os_str().is_empty();
    if is_named(recording) {
        if is_named(folder) {
            check.wrong(&key("replay.folder"), "one of camera.replay.folder and camera.replay.recording");
        } else if !recording.is_file() {
            let file = recording.display();
            check.wrong(&key("replay.recording"), format!("{file} is not a file"));
        } else {
            used::note_path(recording);
        }
        return ReplayImages::Recording { file: recording.clone(), topic: topic.clone() };
    }
    if topic.is_some() {
        check.wrong(&key("replay.topic"), "is of a recording: name it with camera.replay.recording");
    }
    if !is_named(folder) {
        let message =
            "is missing: name the folder of images to replay, or a recording with camera.replay.recording";
        check.wrong(&key("replay.folder"), message);
    } else if !folder.is_dir() {
        check.wrong(&key("replay.folder"), format!("{} is not a folder", folder.display()));
    } else {
        used::note_path(folder);
    }
    ReplayImages::Folder(folder.clone())
}

/// The source of a camera whose table is `at`. `look`: of the scene, where it is simulated.
pub(super) fn source(
    c: &RawCamera,
    look: SceneLook,
    seed: u64,
    at: &str,
    check: &mut Validation<'_>,
) -> Source {
    let key = |name: &str| format!("{at}.{name}");
    let synthetic = &c.synthetic;
    let sensor = SensorModel {
        noise_sd_levels: check.range(
            &key("synthetic.noise_sd_levels"),
            synthetic.noise_sd_levels,
            SensorModel::NOISE_SD_LEVELS,
        ),
        blur_sd_px: check.range(&key("synthetic.blur_sd_px"), synthetic.blur_sd_px, SensorModel::BLUR_SD_PX),
        vignetting: check.range(&key("synthetic.vignetting"), synthetic.vignetting, SensorModel::VIGNETTING),
        seed,
    };
    let response = response(&key("synthetic.response"), &synthetic.response, check);
    if response == Response::Unknown {
        check.wrong(&key("synthetic.response"), "is what the simulated camera has, and cannot be unknown");
    }
    let v4l2 = v4l2::settings(&c.v4l2, at, c.source == SourceKind::V4l2, check);
    let program = program(&c.external, at, c.source == SourceKind::External, check);
    match c.source {
        SourceKind::Synthetic => {
            Source::Synthetic { look, sensor, motion_blur: synthetic.motion_blur, response }
        }
        SourceKind::Replay => {
            let (repeat, strict) = (c.replay.repeat, c.replay.strict);
            Source::Replay { images: replay_images(&c.replay, key, check), repeat, strict }
        }
        SourceKind::V4l2 => Source::V4l2(v4l2),
        SourceKind::External => Source::External(program),
    }
}
