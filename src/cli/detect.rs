//! `vservo detect`: a target in image files.

mod answer;
pub(super) mod image_file;
pub(super) mod overlay;
mod shapes;

use super::{DetectArguments, check_writable, shown, write_result};
use crate::camera_model::camera_info::CameraInfo;
use crate::camera_model::{CameraModel, Distortion, Intrinsics, Response};
use crate::detect::Detection;
use crate::detect::tags::{TagDetection, TagFinder};
use crate::imaging::ImageView;
use crate::input::{file, printable};
use crate::messages::TargetStatus;
use crate::pose::RefinedPose;
use crate::process::ProcessError;
use crate::rt::{now, tell};
use crate::target::{DotGrid, Kind, KindError, Tags, Target};
use crate::vision::{Growth, Vision, VisionSettings};
use answer::{ImageAnswer, word};
use image::GrayImage;
use nalgebra::Vector2;
use shapes::{ShapeKind, ShapeSearch};
use std::path::Path;

/// Longest calibration file, bytes. Chosen by hand: real ones have a thousand.
const MAX_CALIBRATION: u64 = 1 << 20;
/// Standard deviation of the errors of real lenses and targets against their description, px. Chosen by hand: between the 0.1 px of a good
/// calibration and the 0.5 px of a poor one.
const MODEL_SD_PX: f64 = 0.2;

const EQUAL_DOTS: &str = "equal dots: numbered as the image stands, for the grid looks the same after a turn";

/// What was found in one image, before it is printed.
struct DetectedImage {
    found: Vec<Detection>,
    px: Vec<Vector2<f64>>,
    pose: Option<RefinedPose>,
    other: Option<(RefinedPose, f64)>,
    rms_px: Option<f64>,
    inconsistent: bool,
    tags: Vec<TagDetection>,
    note: Option<&'static str>,
    /// Dots that are covered or lit in part.
    harmed: Vec<u32>,
    growth: Growth,
    readout_motion_px: Option<f64>,
}

impl DetectedImage {
    /// What the image cannot tell, or tells by a part alone.
    fn note(&self) -> Option<String> {
        let mut notes: Vec<String> = self.note.map(Into::into).into_iter().collect();
        if !self.harmed.is_empty() {
            let ids = self.harmed.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
            notes.push(format!("covered or lit in part, and measured by the rest of the rim: {ids}"));
        }
        if let Some(px) = self.readout_motion_px {
            notes.push(format!(
                "as if something moved by some {px:.1} px while the rows were exposed one after the other, or lens or target are others: the pose is so much less sure"
            ));
        }
        (!notes.is_empty()).then(|| notes.join("; "))
    }
}

/// A miss, by its status, and why.
struct Missed(TargetStatus, String);

impl From<TargetStatus> for Missed {
    fn from(status: TargetStatus) -> Self {
        Self(status, status.as_str().into())
    }
}

/// Everything that is made once for images of one size.
struct ImageDetector {
    size: (u32, u32),
    /// Known by a calibration.
    calibrated: bool,
    camera: CameraModel,
    settings: Box<VisionSettings>,
    finder: DetectionMethod,
}

enum DetectionMethod {
    Target(Box<Vision>),
    /// A grid whose large dots tell its place, or else one of equal dots.
    Grids(Box<[Vision; 2]>),
    /// Any tag of a family, of this size.
    AnyTag(Box<TagFinder>, f64),
}

impl ImageDetector {
    fn new(kind: &Kind, size: (u32, u32), calibration: Option<CameraModel>, response: &Response) -> Self {
        let camera = calibration.unwrap_or_else(|| nominal(size));
        let settings = VisionSettings {
            model_sd_px: MODEL_SD_PX,
            track: false,
            response: *response,
            ..VisionSettings::default()
        };
        let vision = |target: Target| Vision::new(camera, target, settings);
        let finder = match (&kind.target, kind.any_tag) {
            (Target::Tags(tags), true) => {
                let finder = TagFinder::new(tags.family(), size.0 as usize, size.1 as usize);
                let finder = match response {
                    Response::Unknown => finder.for_unknown_response(),
                    _ => finder,
                };
                DetectionMethod::AnyTag(Box::new(finder), tags.size_m())
            }
            (Target::DotGrid(grid), _) => {
                let equal = DotGrid::equal(grid.columns(), grid.rows(), grid.pitch_m());
                let known = vision(grid.clone().into());
                match equal {
                    Ok(equal) => DetectionMethod::Grids(Box::new([known, vision(equal.into())])),
                    Err(_) => DetectionMethod::Target(Box::new(known)),
                }
            }
            (target, _) => DetectionMethod::Target(Box::new(vision(target.clone()))),
        };
        Self { size, calibrated: calibration.is_some(), camera, settings: Box::new(settings), finder }
    }

    fn look(&mut self, image: &ImageView<'_>) -> Result<DetectedImage, Missed> {
        match &mut self.finder {
            DetectionMethod::Target(vision) => seen(vision, image, self.calibrated),
            DetectionMethod::Grids(both) => {
                let [known, equal] = both.as_mut();
                seen(known, image, self.calibrated).or_else(|missed| {
                    let seen = seen(equal, image, self.calibrated).map_err(|_| missed)?;
                    Ok(DetectedImage { note: Some(EQUAL_DOTS), ..seen })
                })
            }
            DetectionMethod::AnyTag(finder, size_m) => {
                let mut tags = Vec::new();
                finder.search(image, &mut tags).map_err(|miss| Missed(miss.into(), miss.to_string()))?;
                // a single tag is a target
                if let ([one], true) = (tags.as_slice(), self.calibrated)
                    && let Ok(target) = Tags::one(finder.family(), *size_m, one.id)
                {
                    return seen(
                        &mut Vision::new(self.camera, Target::from(target), *self.settings),
                        image,
                        true,
                    );
                }
                let found: Vec<_> = tags.iter().flat_map(corners).collect();
                let px = found.iter().map(|point| point.px).collect();
                Ok(DetectedImage {
                    px,
                    found,
                    pose: None,
                    other: None,
                    rms_px: None,
                    inconsistent: false,
                    tags,
                    note: None,
                    harmed: Vec::new(),
                    growth: Growth::NONE,
                    readout_motion_px: None,
                })
            }
        }
    }
}

fn seen(vision: &mut Vision, image: &ImageView<'_>, calibrated: bool) -> Result<DetectedImage, Missed> {
    let still = if calibrated { vision.process_image(image) } else { vision.points_of(image) };
    let detected = still.map(|still| DetectedImage {
        found: still.found.to_vec(),
        px: still.px.to_vec(),
        pose: still.pose.copied(),
        other: still.other.copied(),
        rms_px: Some(still.rms_px).filter(|rms| calibrated && rms.is_finite()),
        inconsistent: !still.consistent,
        tags: still.tags.to_vec(),
        note: None,
        harmed: still.harmed.to_vec(),
        growth: still.growth,
        readout_motion_px: still.readout_motion_px,
    });
    detected.map_err(|status| Missed(status, vision.missed_in_words(status)))
}

/// The corners of a tag, numbered as if the tags of the family were listed by their ids.
fn corners(tag: &TagDetection) -> [Detection; 4] {
    [0, 1, 2, 3].map(|corner| Detection {
        id: 4 * tag.id + corner as u32,
        px: tag.corners_px.get(corner).copied().unwrap_or_default(),
        sd_px: tag.sd_px(corner),
        area_px2: 0.0,
        covariance_px2: [0.0; 3],
        dark_level: tag.dark_level,
        plate_level: tag.light_level,
        disturbance_px: 0.0,
    })
}

/// A camera without distortion that sees some 45 degrees: where nothing is known, good enough to tell points apart.
fn nominal((width_px, height_px): (u32, u32)) -> CameraModel {
    let f = 1.2 * f64::from(width_px.max(height_px));
    let (cx_px, cy_px) = (0.5 * (f64::from(width_px) - 1.0), 0.5 * (f64::from(height_px) - 1.0));
    let intrinsics = Intrinsics { fx_px: f, fy_px: f, cx_px, cy_px, width_px, height_px };
    // whatever size an image may have is one that a camera may have
    CameraModel::new(intrinsics, Distortion::default()).unwrap_or_else(|_| smallest())
}

fn smallest() -> CameraModel {
    let intrinsics =
        Intrinsics { fx_px: 16.0, fy_px: 16.0, cx_px: 7.5, cy_px: 7.5, width_px: 16, height_px: 16 };
    #[allow(clippy::expect_used)] // constants
    CameraModel::new(intrinsics, Distortion::default()).expect("a camera of constants")
}

/// What is looked for: a target, or shapes.
enum Wanted {
    Target(Box<Kind>),
    Shapes(ShapeKind),
}

impl Wanted {
    fn parse(text: &str) -> Result<Self, String> {
        match ShapeKind::parse(text) {
            Some(shapes) => shapes.map(Self::Shapes),
            None => {
                text.parse().map(|kind| Self::Target(Box::new(kind))).map_err(|e: KindError| e.to_string())
            }
        }
    }

    fn search(self, calibration: Option<CameraModel>, response: &Response) -> WantedSearch {
        match self {
            Self::Target(kind) => {
                WantedSearch::Target { kind, calibration, response: Box::new(*response), bench: None }
            }
            Self::Shapes(kind) => WantedSearch::Shapes(ShapeSearch::new(kind, calibration)),
        }
    }
}

/// The same with what is made once for images of one size.
enum WantedSearch {
    Target {
        kind: Box<Kind>,
        calibration: Option<CameraModel>,
        response: Box<Response>,
        bench: Option<ImageDetector>,
    },
    Shapes(ShapeSearch),
}

impl WantedSearch {
    fn look(&mut self, name: String, image: &GrayImage) -> ImageAnswer {
        match self {
            Self::Target { kind, calibration, response, bench } => {
                let size = image.dimensions();
                let mut at = match bench.take() {
                    Some(bench) if bench.size == size => bench,
                    _ => ImageDetector::new(kind, size, *calibration, response),
                };
                let answer = one(&mut at, name, image);
                *bench = Some(at);
                answer
            }
            Self::Shapes(search) => search.look(name, image),
        }
    }

    /// The target that is looked for, with the camera that is believed.
    fn target(&self) -> Option<(&Kind, &CameraModel)> {
        match self {
            Self::Target { kind, bench, .. } => bench.as_ref().map(|bench| (kind.as_ref(), &bench.camera)),
            Self::Shapes(_) => None,
        }
    }
}

pub(super) fn detect(arguments: &DetectArguments) -> Result<u8, ProcessError> {
    let wanted = match Wanted::parse(&arguments.target) {
        Ok(wanted) => wanted,
        Err(e) => return Ok(refused(&format!("--target: {e}"), 2)),
    };
    if arguments.overlay.is_some() && arguments.images.len() > 1 {
        return Ok(refused("--overlay takes one image: its image would be overwritten by the next", 2));
    }
    let calibration = match arguments.camera.as_deref().map(calibration).transpose() {
        Ok(calibration) => calibration,
        Err(e) => return Ok(refused(&format!("--camera: {e}"), 3)),
    };
    if let Some(path) = &arguments.overlay {
        check_writable(path)?;
    }
    let (mut unreadable, mut any, mut lost) = (false, false, 0);
    let mut search = wanted.search(calibration, &arguments.response);
    for path in &arguments.images {
        let name = path.display().to_string();
        let (answer, image) = match image_file::load(path) {
            Err(reason) => {
                unreadable = true;
                tell(format_args!("vservo: {}: {}", printable(&name), printable(&reason)));
                (ImageAnswer::nothing(name, "unreadable", reason), None)
            }
            Ok(mut image) => {
                if let Some(table) = arguments.response.linearization() {
                    table.apply(&mut image);
                }
                (search.look(name, &image), Some(image))
            }
        };
        any |= answer.status == "found";
        unreadable |= answer.status == "wrong_size";
        let text = if arguments.json {
            serde_json::to_string(&answer).unwrap_or_default() + "\n"
        } else {
            answer.line()
        };
        if lost == 0 {
            lost = shown(&text, 0);
        }
        if let (Some(path), Some(image)) = (&arguments.overlay, image) {
            let drawn = overlay::draw(&image, &answer, search.target());
            lost = drawn.map_or(1, |bytes| write_result(path, bytes, lost));
        }
    }
    Ok(match (unreadable, any) {
        _ if lost != 0 => lost,
        (true, _) => 3,
        (false, false) => 5,
        (false, true) => 0,
    })
}

/// Tells why nothing is done; the exit code.
pub(super) fn refused(message: &str, exit_code: u8) -> u8 {
    tell(format_args!("vservo: {}", printable(message)));
    exit_code
}

/// The camera of a calibration file, or why there is none.
pub(super) fn calibration(path: &Path) -> Result<CameraModel, String> {
    let named = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
    let text = file::read(path, MAX_CALIBRATION).map_err(|e| named(&e))?;
    CameraInfo::read(&text).map_err(|e| named(&e))?.camera().map_err(|e| named(&e))
}

/// What one image shows.
fn one(bench: &mut ImageDetector, name: String, image: &GrayImage) -> ImageAnswer {
    let (width, height) = image.dimensions();
    let Ok(view) = ImageView::new(image.as_raw(), width as usize, height as usize) else {
        return ImageAnswer::nothing(name, "no_contrast", "the image has no pixels".into());
    };
    let i = bench.camera.intrinsics();
    if (i.width_px, i.height_px) != (width, height) {
        let reason = format!("the image is {width}x{height} px, the camera {}x{}", i.width_px, i.height_px);
        return ImageAnswer::nothing(name, "wrong_size", reason);
    }
    let start = now();
    let result = bench.look(&view);
    let time_us = (now() - start).as_s() * 1e6;
    match result {
        Ok(seen) => ImageAnswer::of(name, &seen, time_us),
        Err(Missed(status, reason)) => {
            ImageAnswer { time_us, ..ImageAnswer::nothing(name, word(status), reason) }
        }
    }
}
