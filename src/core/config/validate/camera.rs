//! `[camera]`, or each entry of `[[cameras]]`.

use super::lens;
use super::mount::mount;
use crate::camera_model::{CameraModel, Region};
use crate::config::check::Validation;
use crate::config::frame_source;
use crate::config::place::RawMount;
use crate::config::raw::{RawCamera, RawConfig, RawLens, RawRoi};
use crate::config::stereo::right_mount;
use crate::config::{Camera, Document, DriveKind};
use crate::messages::{CameraId, MAX_CAMERAS};
use crate::scene::{FrameSchedule, Irregularity, MAX_SIDE_PX, SceneLook};
use crate::time::SpanNs;

/// Fewest columns and rows of an image. Chosen by hand: no target is found in fewer.
const MIN_SIDE_PX: u32 = 16;

/// The first camera and the others. A list of one is the same as `[camera]`; from here on `raw.camera` is the first.
pub(super) fn cameras(
    raw: &mut RawConfig,
    document: &Document,
    check: &mut Validation<'_>,
) -> Option<(Camera, Vec<Camera>)> {
    let list = std::mem::take(&mut raw.cameras);
    if list.is_empty() {
        return Some((camera(raw, (&raw.camera, CameraId::FIRST, "camera"), check)?, Vec::new()));
    }
    if document.table.contains_key("camera") {
        check.wrong("cameras", "[camera] and [[cameras]] are both given: move all of [camera] into the list");
        return None;
    }
    if list.len() > MAX_CAMERAS {
        check.wrong("cameras", format!("has {} entries, at most {MAX_CAMERAS} are possible", list.len()));
        return None;
    }
    let mut made: Vec<Option<Camera>> = Vec::new();
    for (id, c) in (0..).zip(&list) {
        let at = format!("cameras[{id}]");
        let mut one = camera(raw, (c, CameraId(id), &at), check);
        if let (1, Some(Some(left)), Some(right)) = (id, made.first(), &mut one) {
            right.mount = right_mount(raw, &c.mount, &left.mount, check).unwrap_or(right.mount);
        }
        made.push(one);
        if list.first().is_some_and(|first| first.source != c.source) {
            check.wrong(&format!("{at}.source"), "must be that of the first camera: all are of one cell");
        }
    }
    raw.camera = list.first()?.clone();
    if list.len() > 1 {
        raw.cameras = list;
    }
    let mut made = made.into_iter().collect::<Option<Vec<_>>>()?.into_iter();
    Some((made.next()?, made.collect()))
}

fn camera(
    raw: &RawConfig,
    (c, id, at): (&RawCamera, CameraId, &str),
    check: &mut Validation<'_>,
) -> Option<Camera> {
    let (lens, synthetic) = (&c.lens, &c.synthetic);
    let key = |name: &str| format!("{at}.{name}");
    let before = check.count_problems();
    let width_px = check.count(&key("width_px"), c.width_px, MIN_SIDE_PX..=MAX_SIDE_PX);
    let height_px = check.count(&key("height_px"), c.height_px, MIN_SIDE_PX..=MAX_SIDE_PX);
    let rate_hz = check.range(&key("rate_hz"), c.rate_hz, 0.1..=1000.0);
    let exposure = check.span_ms(&key("exposure_ms"), c.exposure_ms, 0.0..=1000.0);
    let latency = check.span_ms(&key("latency_ms"), c.latency_ms, 0.0..=500.0);
    let stamp_offset = check.span_ms(&key("stamp_offset_ms"), c.stamp_offset_ms, -500.0..=500.0);
    let stamp_error =
        check.span_ms(&key("synthetic.stamp_error_ms"), synthetic.stamp_error_ms, -500.0..=500.0);
    let X = check.pose(&key("mount"), c.mount.position_m, c.mount.rotation_rpy_rad);
    let mount = mount(raw, (&c.mount, X, &key("mount")), check);
    let look = SceneLook {
        background: check.range("scene.background_level", raw.scene.background_level, SceneLook::LEVEL),
        plate: check.range("scene.plate_level", raw.scene.plate_level, SceneLook::LEVEL),
        dots: check.range("scene.dot_level", raw.scene.dot_level, SceneLook::LEVEL),
    };
    if look.plate <= look.dots {
        check.wrong(
            "scene.plate_level",
            "must be brighter than scene.dot_level: the dots are dark on a light plate",
        );
    }
    // Each camera has noise and losses of its own.
    let seed = raw.run.seed ^ u64::from(id.0).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let source = frame_source::source(c, look, seed, at, check);
    let text = match (c.response.as_str(), c.source) {
        ("auto", kind) if kind.is_simulated() => "linear",
        // a real camera, or images that one took
        ("auto", _) => "unknown",
        (text, _) => text,
    };
    if !c.source.is_simulated() && c.source.closes_the_loop() {
        uncalibrated((c, raw.drive.kind != DriveKind::None), at, check);
    }
    let response = frame_source::response(&key("response"), text, check);
    let (intrinsics, bends) = lens::believed(at, lens, (width_px, height_px), check);
    let region = region(c, at, check);
    let irregularity = Irregularity {
        jitter: check.span_ms(&key("synthetic.latency_jitter_ms"), synthetic.latency_jitter_ms, 0.0..=500.0),
        loss: check.range(&key("synthetic.frame_loss"), synthetic.frame_loss, 0.0..=0.99),
        seed,
    };
    if check.count_problems() > before {
        return None;
    }
    // Other frames come as they are: only a simulated camera is irregular by intent.
    let (irregularity, stamp_error) = if c.source.is_simulated() {
        (irregularity, stamp_error)
    } else {
        (Irregularity::default(), SpanNs(0))
    };
    let schedule = FrameSchedule::new(rate_hz, latency, irregularity);
    let model = CameraModel::new(intrinsics, bends);
    match model.and_then(|whole| region.map_or(Ok(whole), |region| whole.cropped(&region))) {
        Ok(model) => Some(Camera {
            id,
            name: c.name.clone().unwrap_or_else(|| id.to_string()),
            source,
            response,
            model,
            mount,
            rate_hz,
            exposure,
            latency,
            schedule,
            stamp_offset,
            stamp_error,
        }),
        Err(e) => {
            check.wrong(&key("lens"), e.to_string());
            None
        }
    }
}

/// Tells where a real camera has a lens or a mount that nobody has given: what the default camera has is nobody's.
fn uncalibrated((c, moves): (&RawCamera, bool), at: &str, check: &mut Validation<'_>) {
    if c.lens == RawLens::default() {
        check.doubtful(
            &format!("{at}.lens"),
            "is the default lens, which no real camera has: `vservo calibrate camera` finds this one; until then distances and poses \
             are wrong, and with them every law that needs them",
        );
    }
    if moves && c.mount == RawMount::default() {
        check.doubtful(
            &format!("{at}.mount"),
            "is the default mount, which no real camera has: `vservo calibrate hand-eye` finds this one; until then the arm moves \
             another way than the law means",
        );
    }
}

/// `[camera.roi]`: the part of the image that is read.
fn region(c: &RawCamera, at: &str, check: &mut Validation<'_>) -> Option<Region> {
    let roi = c.roi.as_ref()?;
    let key = |name: &str| format!("{at}.roi.{name}");
    let sides = [
        ("x_px", roi.x_px, "width_px", roi.width_px, c.width_px),
        ("y_px", roi.y_px, "height_px", roi.height_px, c.height_px),
    ];
    for (from_name, from, length_name, length, side) in sides {
        let whole = format!("{at}.{length_name} is {side}");
        if length < MIN_SIDE_PX {
            check.wrong(
                &key(length_name),
                format!("is {length}: give the region a size, at least {MIN_SIDE_PX} px a side"),
            );
        } else if from.checked_add(length).is_none_or(|to| to > side) {
            check.wrong(
                &key(length_name),
                format!(
                    "the region ends outside of the image, at {from} + {length} px where {whole}: make {length_name} at most {}, \
                     or {from_name} smaller",
                    side.saturating_sub(from)
                ),
            );
        }
    }
    let &RawRoi { x_px, y_px, width_px, height_px } = roi;
    Some(Region { x_px, y_px, width_px, height_px })
}
