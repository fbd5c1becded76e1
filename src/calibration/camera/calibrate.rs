//! From corners to a camera with its covariance.

use super::start::{self, PlaneView};
use super::{BoardExtent, BoardView, CalibrationSettings, CameraCalibrationError, Unused, usable};
use crate::calibration::bundle::{
    BoardSighting, BundleProblem, BundleState, Freedom, Optics, Selected, adjust_selected,
};
use crate::camera_model::{CameraModel, CameraModelError, Lens, LensModel};
use crate::geometry::Pose;
use crate::pose::{Loss, PixelCorrespondence, refine_pixels};
use nalgebra::{DMatrix, Matrix2, Point3, Translation3, Vector2};

/// A coefficient within so many standard deviations of zero is not told from it.
const TOLD_SD: f64 = 3.0;

/// A corner and how well it fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointFit {
    /// Its id.
    pub id: u32,
    /// Its place in the camera, m.
    pub p_C: Point3<f64>,
    /// Where it is seen, px.
    pub px: Vector2<f64>,
    /// Seen minus predicted, px.
    pub error_px: Vector2<f64>,
    /// Whether it took part.
    pub used: bool,
}

/// A picture and how well it fits.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewFit {
    /// Why it took no part, where it did not.
    pub unused: Option<Unused>,
    /// Pose of the board in the camera, where there is one: also of a picture that took no part.
    pub X_CO: Option<Pose>,
    /// Root mean square of the distances of its corners from where they are predicted, px; of those that took part where it did.
    pub rms_px: Option<f64>,
    /// Its corners; empty without a pose.
    pub points: Vec<PointFit>,
}

/// A coefficient that was fixed at zero though it was free: a high polynomial bends as it likes where no corner holds it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DroppedCoefficient {
    /// Its name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its standard deviation, of which the value is too few to be told from zero; none where it had to go: with it the lens
    /// shows two directions in one pixel, or nothing tells it at all.
    pub sd: Option<f64>,
    /// What the root mean square error is with it, px.
    pub rms_px: f64,
}

/// A camera, how certain it is, and how the pictures fit.
#[derive(Debug, Clone)]
pub struct CameraCalibration {
    /// The camera.
    pub camera: CameraModel,
    /// Which parameters were estimated.
    pub freedom: Freedom,
    /// Covariance of these, in the order of [`Freedom::names`]. The noise is that which the errors tell.
    pub covariance: DMatrix<f64>,
    /// Height of the board's middle over its edges by its shape along x_O and y_O (towards z_O), m, and its deviations; where asked
    /// for.
    pub warp_m: Option<(Vector2<f64>, Vector2<f64>)>,
    /// Pictures, in the order given.
    pub views: Vec<ViewFit>,
    /// Root mean square of the distances of corners from where they are predicted, px: OpenCV's figure.
    pub rms_px: f64,
    /// Noise of a coordinate of a corner, as the errors tell it: one standard deviation, px.
    pub noise_px: f64,
    /// Factor on the given covariances (with the floor) that the errors tell.
    pub variance_factor: f64,
    /// Coefficients that were fixed at zero though they were free.
    pub dropped: Vec<DroppedCoefficient>,
    /// The floor of the noise that was used, px.
    pub model_sd_px: f64,
    /// Steps of the last refinement.
    pub iterations: u32,
}

impl CameraCalibration {
    /// The parameters that were estimated: name and standard deviation.
    pub fn deviations(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let names = self.freedom.names(self.camera.lens().model());
        names.into_iter().enumerate().map(|(i, name)| (name, self.covariance[(i, i)].max(0.0).sqrt()))
    }

    /// Corners that took part.
    pub fn points_used(&self) -> impl Iterator<Item = &PointFit> + Clone {
        let views = self.views.iter().filter(|view| view.unused.is_none());
        views.flat_map(|view| &view.points).filter(|point| point.used)
    }

    /// How many pictures took part.
    #[must_use]
    pub fn views_used(&self) -> usize {
        self.views.iter().filter(|view| view.unused.is_none()).count()
    }
}

/// The camera that took these pictures, images of `size` columns and rows.
///
/// # Errors
/// [`CameraCalibrationError`]; pictures that are of no use alone are told in the result.
pub fn calibrate_camera(
    views: &[BoardView],
    size: (u32, u32),
    settings: &CalibrationSettings,
) -> Result<CameraCalibration, CameraCalibrationError> {
    settings.check(size)?;
    let (mut unused, usable): (Vec<_>, Vec<_>) = {
        let all: Vec<Option<Unused>> = views.iter().map(|view| usable(view).err()).collect();
        let usable = (0..views.len()).filter(|i| all.get(*i).is_some_and(Option::is_none)).collect();
        (all, usable)
    };
    let extent = BoardExtent::of(views.iter().flatten());
    let planes: Vec<PlaneView> = (usable.iter())
        .map(|i: &usize| views.get(*i).map_or_else(Vec::new, |view| plane(view, &extent)))
        .collect();
    if usable.is_empty() {
        return Err(CameraCalibrationError::TooFewViews { usable: 0, needed: 1 });
    }
    let start = start::start(&planes, size, settings.model, &settings.freedom)
        .ok_or(CameraCalibrationError::NoStart)?;
    let mut posed: Vec<usize> = Vec::new();
    for (i, X) in usable.iter().zip(&start.poses) {
        match (X, unused.get_mut(*i)) {
            (Some(_), _) => posed.push(*i),
            (None, Some(why)) => *why = Some(Unused::NoPose),
            (None, None) => {}
        }
    }
    let problem = problem(views, &posed, settings, &extent);
    let mut state = BundleState {
        optics: vec![start.optics],
        X_j0: Vec::new(),
        warp_m: Vector2::zeros(),
        poses: start.poses.iter().flatten().copied().collect(),
    };
    let mut dropped = Vec::new();
    let mut freedom = settings.freedom;
    let mut end = adjust_selected(&problem, &state, settings.outlier_sd)?;
    if let Some(better) = unmirrored(views, &posed, &end, &problem, &extent) {
        // where that is no start, or no better, the first one stands
        if let Ok(other) = adjust_selected(&problem, &better, settings.outlier_sd)
            && other.variance_factor() < end.variance_factor()
        {
            end = other;
        }
    }
    loop {
        let optics = *end.end.state.optics.first().ok_or(CameraCalibrationError::NoStart)?;
        let camera = CameraModel::new(optics.intrinsics, optics.lens);
        let folds = matches!(camera, Err(CameraModelError::Folded { .. }));
        let Some(without) = high_coefficient(&end, &freedom, settings, folds) else {
            let camera = camera.map_err(CameraCalibrationError::Camera)?;
            for (i, misfit) in posed.iter().zip(&end.misfits) {
                if let (Some(why), Some(misfit)) = (unused.get_mut(*i), misfit) {
                    *why = Some((*misfit).into());
                }
            }
            let fitted = fits(0, &camera, views, &posed, unused, &end, &extent);
            return result(0, &end, camera, fitted, dropped, settings);
        };
        freedom = freedom.without(settings.model, without.name);
        let lens = Lens::of(settings.model, |name| {
            let kept =
                optics.lens.coefficients().into_iter().find(|(own, _)| *own == name && name != without.name);
            kept.map_or(0.0, |(_, value)| value)
        });
        // what folds is no place to start from
        if !folds {
            state = BundleState { poses: end.all_poses(&state), ..end.end.state.clone() };
            state.optics = vec![Optics { lens, ..optics }];
        }
        dropped.push(without);
        let problem = BundleProblem { freedom: vec![freedom], ..problem.clone() };
        end = adjust_selected(&problem, &state, settings.outlier_sd)?;
    }
}

/// The pictures that may take part.
fn problem(
    views: &[BoardView],
    posed: &[usize],
    settings: &CalibrationSettings,
    extent: &BoardExtent,
) -> BundleProblem {
    let sighting = |i: &usize| {
        let view = views.get(*i)?;
        let points = view.iter().map(|p| extent.point(p, settings.model_sd_px)).collect();
        Some(vec![BoardSighting { camera: 0, points }])
    };
    BundleProblem {
        freedom: vec![settings.freedom],
        warp: settings.warp,
        views: posed.iter().filter_map(sighting).collect(),
    }
}

/// Which coefficients of the highest orders may go, in this order.
fn droppable(model: LensModel) -> &'static [&'static str] {
    match model {
        LensModel::PlumbBob => &["k3"],
        LensModel::RationalPolynomial => &["k6", "k3", "k5"],
        LensModel::Equidistant => &["k4", "k3"],
    }
}

/// The free coefficient of the highest order where it does harm: the lens folds with it, or the corners do not tell it from zero.
fn high_coefficient(
    end: &Selected,
    freedom: &Freedom,
    settings: &CalibrationSettings,
    folds: bool,
) -> Option<DroppedCoefficient> {
    let names = freedom.names(settings.model);
    let of = |name: &&'static str| Some((*name, names.iter().position(|own| own == name)?));
    let (name, place) = droppable(settings.model).iter().find_map(of)?;
    let coefficients = end.end.state.optics.first()?.lens.coefficients();
    let (_, value) = coefficients.into_iter().find(|(own, _)| *own == name)?;
    let rms_px = rms_px(end, None);
    let sd = end.end.sums.covariance().and_then(|C| C.get((place, place)).copied());
    let Some(sd) = sd.map(|variance| (variance * end.variance_factor()).sqrt()).filter(|_| !folds) else {
        return Some(DroppedCoefficient { name, value, sd: None, rms_px });
    };
    (settings.drop_untold && value.abs() < TOLD_SD * sd).then_some(DroppedCoefficient {
        name,
        value,
        sd: Some(sd),
        rms_px,
    })
}

fn plane(view: &BoardView, extent: &BoardExtent) -> PlaneView {
    view.iter().map(|p| (extent.centred(&p.p_O).0.xy(), p.px)).collect()
}

/// The state with the poses that the camera found so far gives to planes, where one is clearly another: at the start a plane may have
/// been taken for its mirror image.
fn unmirrored(
    views: &[BoardView],
    posed: &[usize],
    end: &Selected,
    problem: &BundleProblem,
    extent: &BoardExtent,
) -> Option<BundleState> {
    let optics = end.end.state.optics.first()?;
    let camera = CameraModel::new(optics.intrinsics, optics.lens).ok()?;
    let mut poses = Vec::with_capacity(problem.views.len());
    let mut mirrored = false;
    for (place, i) in posed.iter().enumerate() {
        let found = start::pose(&camera, &plane(views.get(*i)?, extent)).0;
        let now = end.views.iter().position(|v| *v == place).and_then(|at| end.end.state.poses.get(at));
        mirrored |= match (&found, now) {
            (Some(found), Some(now)) => found.rotation.angle_to(&now.rotation) > 0.1,
            _ => false,
        };
        poses.push(found.or(now.copied())?);
    }
    mirrored.then(|| BundleState { poses, ..end.end.state.clone() })
}

/// What one camera of a rig is found to be.
pub(crate) fn result(
    camera_index: usize,
    end: &Selected,
    camera: CameraModel,
    views: Vec<ViewFit>,
    dropped: Vec<DroppedCoefficient>,
    settings: &CalibrationSettings,
) -> Result<CameraCalibration, CameraCalibrationError> {
    let variance_factor = end.variance_factor();
    let covariance = end.end.sums.covariance().ok_or(CameraCalibrationError::Degenerate)? * variance_factor;
    let freedom = *end.problem.freedom.get(camera_index).ok_or(CameraCalibrationError::NoStart)?;
    let (from, warp, n) = (end.problem.optics_from(camera_index), end.problem.warp_from(), freedom.count());
    let warp_m = end.problem.warp.then(|| {
        let sd = |i: usize| covariance.get((warp + i, warp + i)).map_or(0.0, |x| x.max(0.0).sqrt());
        (end.end.state.warp_m, Vector2::new(sd(0), sd(1)))
    });
    Ok(CameraCalibration {
        camera,
        freedom,
        covariance: covariance.view((from, from), (n, n)).into_owned(),
        warp_m,
        rms_px: rms_px(end, Some(camera_index)),
        noise_px: (variance_factor * mean_variance(end)).sqrt(),
        variance_factor,
        dropped,
        model_sd_px: settings.model_sd_px,
        iterations: end.end.iterations,
        views,
    })
}

/// Root mean square of the distances of corners from where they are predicted, px; of one camera or all.
pub(crate) fn rms_px(end: &Selected, camera: Option<usize>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, view) in end.problem.views.iter().enumerate() {
        for (sighting, point) in view.iter().flat_map(|s| s.points.iter().map(move |p| (s, p))) {
            if camera.is_some_and(|camera| camera != sighting.camera) {
                continue;
            }
            let image = end.end.state.image(sighting.camera, i, point);
            count += 1.0;
            sum += image.map_or(0.0, |image| (point.px - image.px).norm_squared());
        }
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Mean variance of a coordinate as it was given, with the floor, px^2.
pub(crate) fn mean_variance(end: &Selected) -> f64 {
    let points = || end.problem.views.iter().flatten().flat_map(|s| &s.points);
    let variance = |W: &Matrix2<f64>| {
        // C = (W^T W)^-1
        let square = W.tr_mul(W);
        0.5 * square.trace() / square.determinant()
    };
    points().map(|p| variance(&p.whitening)).sum::<f64>() / points().count().max(1) as f64
}

/// How the pictures of one camera of the rig fit.
pub(crate) fn fits(
    camera_index: usize,
    camera: &CameraModel,
    views: &[BoardView],
    posed: &[usize],
    unused: Vec<Option<Unused>>,
    end: &Selected,
    extent: &BoardExtent,
) -> Vec<ViewFit> {
    let state = &end.end.state;
    let to_corner = Translation3::from(-extent.middle.push(0.0));
    let fit = |(i, (view, unused)): (usize, (&BoardView, Option<Unused>))| {
        let place = posed.iter().position(|p| *p == i);
        let at = place.and_then(|place| end.views.iter().position(|v| *v == place));
        let X_0O = at.and_then(|at| state.poses.get(at)).map(|X| X * to_corner);
        let X_j0 = camera_index.checked_sub(1).and_then(|j| state.X_j0.get(j)).copied().unwrap_or_default();
        let X_CO = match X_0O {
            Some(X) => Some(X_j0 * X),
            // a picture that took no part still shows the board somewhere
            None if place.is_some() => board_pose(camera, view),
            None => None,
        };
        let Some(X) = X_CO else { return ViewFit { unused, X_CO: None, rms_px: None, points: Vec::new() } };
        let kept = place
            .and_then(|place| end.kept.get(place))
            .and_then(|sightings| sightings.get(camera_index.min(sightings.len().saturating_sub(1))));
        let point = |(k, p): (usize, &super::BoardPoint)| {
            let (r, lift) = extent.centred(&p.p_O);
            let lifted = p.p_O.coords.xy().push(r.z + state.warp_m.dot(&lift));
            let p_C = X * Point3::from(lifted);
            let predicted = camera.project(&p_C)?;
            let kept = kept.and_then(|kept| kept.get(k)).copied().unwrap_or(false);
            Some(PointFit {
                id: p.id,
                p_C,
                px: p.px,
                error_px: p.px - predicted,
                used: kept && unused.is_none(),
            })
        };
        let points: Vec<PointFit> = view.iter().enumerate().filter_map(point).collect();
        let counted = || points.iter().filter(|p| p.used || unused.is_some());
        let sum: f64 = counted().map(|p| p.error_px.norm_squared()).sum();
        let rms_px = (counted().count() > 0).then(|| (sum / counted().count() as f64).sqrt());
        ViewFit { unused, X_CO, rms_px, points }
    };
    views.iter().zip(unused).enumerate().map(fit).collect()
}

/// Pose of a board in a camera that is known.
pub(crate) fn board_pose(camera: &CameraModel, view: &BoardView) -> Option<Pose> {
    let flat: PlaneView = view.iter().map(|p| (p.p_O.coords.xy(), p.px)).collect();
    let start = start::pose(camera, &flat).0?;
    let points: Vec<_> = (view.iter())
        .map(|p| PixelCorrespondence { r: p.p_O, px: p.px, covariance_px2: Matrix2::identity() })
        .collect();
    Some(refine_pixels(&start, &points, camera, Loss::Squares).map_or(start, |end| end.X_CO))
}
