//! The result for a camera, as JSON and as lines for people.

use super::boards::Boards;
use crate::calibration::camera::{
    CalibrationVerdict, CameraCalibration, CrossValidation, ImageCoverage, NextView, ProjectionUncertainty,
    board_bend, cross_validation, next_view,
};
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::input::printable;
use nalgebra::{Point3, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A camera with all that is known about how good it is.
pub(super) struct Examined {
    pub(super) calibration: CameraCalibration,
    pub(super) uncertainty: ProjectionUncertainty,
    pub(super) halves: Option<CrossValidation>,
    pub(super) coverage: ImageCoverage,
    pub(super) next: Option<NextView>,
    pub(super) verdict: CalibrationVerdict,
}

impl Examined {
    /// At a depth, that of the boards where it is not given. `None` when the corners fix no pose, which those of a calibration do.
    pub(super) fn new(
        calibration: CameraCalibration,
        boards: &Boards,
        board: &[Point3<f64>],
        distance_m: Option<f64>,
    ) -> Option<Self> {
        let mut depths: Vec<f64> = calibration.points_used().map(|p| p.p_C.z).collect();
        depths.sort_unstable_by(f64::total_cmp);
        let usual_m = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
        let uncertainty = ProjectionUncertainty::new(&calibration, distance_m.unwrap_or(usual_m))?;
        let halves = cross_validation(&boards.views, &calibration, &uncertainty);
        let coverage = ImageCoverage::of(&calibration);
        let next = next_view(board, &calibration, &uncertainty);
        let verdict = CalibrationVerdict::new(&calibration, &uncertainty, halves.as_ref(), &coverage)
            .with_bend(board_bend(&boards.views, &calibration));
        Some(Self { calibration, uncertainty, halves, coverage, next, verdict })
    }
}

#[derive(Serialize)]
pub(super) struct CameraOut {
    width_px: u32,
    height_px: u32,
    fx_px: f64,
    fy_px: f64,
    cx_px: f64,
    cy_px: f64,
    model: &'static str,
    distortion: Vec<f64>,
    /// Their names.
    #[serde(skip)]
    coefficients: Vec<&'static str>,
}

impl From<&CameraModel> for CameraOut {
    fn from(camera: &CameraModel) -> Self {
        let (i, lens) = (camera.intrinsics(), camera.lens());
        Self {
            width_px: i.width_px,
            height_px: i.height_px,
            fx_px: i.fx_px,
            fy_px: i.fy_px,
            cx_px: i.cx_px,
            cy_px: i.cy_px,
            model: lens.model().name(),
            distortion: lens.coefficients().into_iter().map(|(_, value)| value).collect(),
            coefficients: lens.coefficients().into_iter().map(|(name, _)| name).collect(),
        }
    }
}

impl CameraOut {
    /// Names and values of all its parameters.
    pub(super) fn parameters(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let i = [("fx_px", self.fx_px), ("fy_px", self.fy_px), ("cx_px", self.cx_px), ("cy_px", self.cy_px)];
        i.into_iter().chain(self.coefficients.iter().copied().zip(self.distortion.iter().copied()))
    }
}

#[derive(Serialize)]
pub(super) struct ViewOut {
    image: String,
    rms_px: Option<f64>,
    used: bool,
    reason: Option<String>,
    corners: usize,
    left_out: usize,
    pose: Option<PlaceOut>,
}

#[derive(Serialize)]
pub(super) struct PlaceOut {
    pub(super) position_m: [f64; 3],
    pub(super) rotation_xyzw: [f64; 4],
}

impl From<&Pose> for PlaceOut {
    fn from(X: &Pose) -> Self {
        let q = X.rotation.coords;
        Self { position_m: X.translation.vector.into(), rotation_xyzw: [q.x, q.y, q.z, q.w] }
    }
}

#[derive(Serialize)]
struct UncertaintyOut {
    center: f64,
    corner: f64,
    /// The worst in the middle 80 % of the image's width and height.
    middle: f64,
    /// The worst where corners of the board were seen.
    seen: f64,
    distance_m: f64,
}

#[derive(Serialize)]
struct HalvesOut {
    difference_px: f64,
    predicted_px: f64,
    ratio: f64,
}

#[derive(Serialize)]
struct NextOut {
    #[serde(flatten)]
    pose: PlaceOut,
    corners_px: Vec<[f64; 2]>,
    worst_now_px: f64,
    worst_then_px: f64,
    words: String,
}

#[derive(Serialize)]
struct DroppedOut {
    name: &'static str,
    value: f64,
    sd: Option<f64>,
    rms_px: f64,
}

#[derive(Serialize)]
struct WarpOut {
    x_m: f64,
    y_m: f64,
    sd_x_m: f64,
    sd_y_m: f64,
}

#[derive(Serialize)]
struct ResponseOut {
    gamma: f64,
    sd: f64,
    /// What to set; `null` where the response cannot be distinguished from a linear one, or is not believed.
    setting: Option<String>,
    /// Whether levels are proportional to light, as far as edges tell; with no setting either, they do not tell.
    linear: bool,
}

/// One camera as JSON.
#[derive(Serialize)]
pub(super) struct CameraAnswer {
    camera: CameraOut,
    sd: BTreeMap<&'static str, f64>,
    rms_px: f64,
    noise_px: f64,
    views: Vec<ViewOut>,
    uncertainty_px: UncertaintyOut,
    verdict: String,
    usable: bool,
    coverage: f64,
    uncovered: Vec<&'static str>,
    cross_validation: Option<HalvesOut>,
    next_view: Option<NextOut>,
    dropped: Vec<DroppedOut>,
    warp: Option<WarpOut>,
    response: Option<ResponseOut>,
}

impl CameraAnswer {
    pub(super) fn new(examined: &Examined, boards: &Boards) -> Self {
        let Examined { calibration, halves, coverage, next, verdict, .. } = examined;
        Self {
            camera: (&calibration.camera).into(),
            sd: calibration.deviations().collect(),
            rms_px: calibration.rms_px,
            noise_px: calibration.noise_px,
            views: views(calibration, boards),
            uncertainty_px: UncertaintyOut {
                center: verdict.center_px,
                corner: verdict.corner_px,
                middle: verdict.middle_px,
                seen: verdict.seen_px,
                distance_m: verdict.distance_m,
            },
            verdict: verdict.to_string(),
            usable: verdict.is_usable(),
            coverage: coverage.share(),
            uncovered: coverage.uncovered(),
            cross_validation: halves.map(|h| HalvesOut {
                difference_px: h.difference_px,
                predicted_px: h.predicted_px,
                ratio: h.ratio,
            }),
            next_view: next.as_ref().map(|next| NextOut {
                pose: (&next.X_CO).into(),
                corners_px: next.corners_px.iter().map(|px: &Vector2<f64>| [px.x, px.y]).collect(),
                worst_now_px: next.worst_now_px,
                worst_then_px: next.worst_then_px,
                words: next.describe(boards.size),
            }),
            dropped: (calibration.dropped.iter())
                .map(|d| DroppedOut { name: d.name, value: d.value, sd: d.sd, rms_px: d.rms_px })
                .collect(),
            warp: calibration.warp_m.map(|(warp, sd)| WarpOut {
                x_m: warp.x,
                y_m: warp.y,
                sd_x_m: sd.x,
                sd_y_m: sd.y,
            }),
            response: boards.response.gamma().map(|estimate| ResponseOut {
                gamma: estimate.gamma,
                sd: estimate.sd,
                setting: estimate.response().map(|response| response.to_string()),
                linear: estimate.is_linear(),
            }),
        }
    }
}

/// Why an image takes no part: what the finder said goes before what the calibration says.
pub(super) fn reasons<'a>(
    calibration: &'a CameraCalibration,
    boards: &'a Boards,
) -> impl Iterator<Item = Option<String>> + 'a {
    let miss = boards.misses.iter();
    calibration
        .views
        .iter()
        .zip(miss)
        .map(|(fit, miss)| miss.clone().or(fit.unused.map(|why| why.to_string())))
}

fn views(calibration: &CameraCalibration, boards: &Boards) -> Vec<ViewOut> {
    let reasons = reasons(calibration, boards);
    let all = calibration.views.iter().zip(&boards.names).zip(&boards.views).zip(reasons);
    all.map(|(((fit, name), view), reason)| ViewOut {
        image: name.clone(),
        rms_px: fit.rms_px,
        used: fit.unused.is_none(),
        reason,
        corners: view.len(),
        left_out: if fit.unused.is_none() { fit.points.iter().filter(|p| !p.used).count() } else { 0 },
        pose: fit.X_CO.as_ref().map(Into::into),
    })
    .collect()
}

/// One camera for people.
pub(super) fn lines(examined: &Examined, boards: &Boards) -> String {
    let Examined { calibration, halves, coverage, next, verdict, .. } = examined;
    let i = calibration.camera.intrinsics();
    let mut text =
        format!("{}x{} px, {}\n", i.width_px, i.height_px, calibration.camera.lens().model().name());
    let all = [("fx_px", i.fx_px), ("fy_px", i.fy_px), ("cx_px", i.cx_px), ("cy_px", i.cy_px)];
    let sd: BTreeMap<_, _> = calibration.deviations().collect();
    for (name, value) in all.into_iter().chain(calibration.camera.lens().coefficients()) {
        let digits = if name.ends_with("_px") { 2 } else { 5 };
        let _ = match sd.get(name) {
            Some(sd) => writeln!(text, "  {name:6}{value:>11.digits$} +- {sd:.digits$}"),
            None => writeln!(text, "  {name:6}{value:>11.digits$}    fixed"),
        };
    }
    for d in &calibration.dropped {
        let _ = match d.sd {
            Some(sd) => writeln!(text, "{} is not told from zero: {:.4} +- {sd:.4}", d.name, d.value),
            None => {
                writeln!(
                    text,
                    "{} is left out: with {:.4} the lens folds inside the image, or no corner tells it",
                    d.name, d.value
                )
            }
        };
    }
    if let Some((warp, sd)) = calibration.warp_m {
        let mm = |x: f64| x * 1e3;
        let (x, y, sx, sy) = (mm(warp.x), mm(warp.y), mm(sd.x), mm(sd.y));
        let _ = writeln!(text, "board bent by {x:.3} +- {sx:.3} mm along x, {y:.3} +- {sy:.3} mm along y");
    }
    if let Some(estimate) = boards.response.gamma() {
        let (gamma, sd) = (estimate.gamma, estimate.sd);
        let _ = match estimate.response() {
            Some(response) => writeln!(
                text,
                "levels are not proportional to light: gamma {gamma:.2} +- {sd:.2}; set camera.response (or --response) to \"{response}\""
            ),
            None if estimate.is_linear() => Ok(()),
            None => writeln!(
                text,
                "the edges do not tell how levels depend on light (gamma {gamma:.2} +- {sd:.2} is not believed): for that, take images with squares of \
                 20 px and more, a contrast of 100 levels and none of them clipped"
            ),
        };
    }
    let _ = writeln!(
        text,
        "{} of {} images, rms {:.3} px, noise of a coordinate {:.3} px, corners in {:.0} % of the image",
        calibration.views_used(),
        calibration.views.len(),
        calibration.rms_px,
        calibration.noise_px,
        100.0 * coverage.share()
    );
    for ((fit, name), reason) in calibration.views.iter().zip(&boards.names).zip(reasons(calibration, boards))
    {
        let rms = fit.rms_px.map_or_else(|| "-".into(), |rms| format!("{rms:.3} px"));
        let out = fit.points.iter().filter(|p| !p.used).count();
        let _ = write!(text, "  {}: {rms}", printable(name));
        let _ = match reason {
            Some(reason) => writeln!(text, ", not used: {}", printable(&reason)),
            None if out > 0 => writeln!(text, ", {out} corners left out"),
            None => writeln!(text),
        };
    }
    if let Some(h) = halves {
        let _ = writeln!(
            text,
            "halves of the images differ by {:.3} px over the image, {:.2} times what the noise explains",
            h.difference_px, h.ratio
        );
    }
    let _ = writeln!(text, "{verdict}");
    if let Some(next) = next {
        let _ = writeln!(text, "next: {}", next.describe(boards.size));
    }
    text
}
