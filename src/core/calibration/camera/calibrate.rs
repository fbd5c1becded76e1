//! From corners to a camera with its covariance.

use super::calibration::{CameraCalibration, DroppedCoefficient};
use super::fits::{fits, result, rms_px};
use super::start::{self, PlaneView};
use super::{BoardExtent, BoardView, CalibrationSettings, CameraCalibrationError, Unused, usable};
use crate::calibration::bundle::{
    BoardObservation, BundleProblem, BundleState, Freedom, Optics, Selected, adjust_selected,
    expected_coefficient,
};
use crate::camera_model::{CameraModel, CameraModelError, Lens, LensModel};
use nalgebra::Vector2;

/// A coefficient within so many standard deviations of zero is not told from it: noise is outside of three once in 370 times, the quantile of
/// the normal distribution. It is left out where zero is the better guess: where the images tell it worse than that lenses are tame.
const TOLD_SD: f64 = 3.0;

/// The camera that took these images, images of `size` columns and rows.
///
/// # Errors
/// [`CameraCalibrationError`]; images that are of no use alone are told in the result.
pub fn calibrate_camera(
    views: &[BoardView],
    size: (u32, u32),
    settings: &CalibrationSettings,
) -> Result<CameraCalibration, CameraCalibrationError> {
    calibrate_keeping(views, size, settings, true)
}

/// The same; `keep`: coefficients that are not told from zero stay where zero is no better guess.
pub(crate) fn calibrate_keeping(
    views: &[BoardView],
    size: (u32, u32),
    settings: &CalibrationSettings,
    keep: bool,
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
    let camera = loop {
        let optics = *end.end.state.optics.first().ok_or(CameraCalibrationError::NoStart)?;
        let camera = CameraModel::new(optics.intrinsics, optics.lens);
        let folds = matches!(camera, Err(CameraModelError::Folded { .. }));
        let Some(without) = high_coefficient(&end, &freedom, settings, folds) else {
            break camera.map_err(CameraCalibrationError::Camera)?;
        };
        let rest = freedom.without(settings.model, without.name);
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
        let problem = BundleProblem { freedom: vec![rest], ..problem.clone() };
        let end_without = adjust_selected(&problem, &state, settings.outlier_sd)?;
        if let (true, Some(sd), Ok(camera)) = (keep, without.sd, camera)
            && sd < expected_coefficient(&end_without, without.name)
        {
            break camera;
        }
        (freedom, end) = (rest, end_without);
        dropped.push(without);
    };
    for (i, misfit) in posed.iter().zip(&end.misfits) {
        if let (Some(why), Some(misfit)) = (unused.get_mut(*i), misfit) {
            *why = Some((*misfit).into());
        }
    }
    let fitted = fits(0, &camera, views, &posed, unused, &end, &extent);
    result(0, &end, &[settings.freedom], camera, fitted, dropped, settings)
}

/// The images that may take part.
fn problem(
    views: &[BoardView],
    posed: &[usize],
    settings: &CalibrationSettings,
    extent: &BoardExtent,
) -> BundleProblem {
    let observation = |i: &usize| {
        let view = views.get(*i)?;
        let points = view.iter().map(|p| extent.point(p, settings.model_sd_px)).collect();
        Some(vec![BoardObservation { camera: 0, points }])
    };
    BundleProblem {
        freedom: vec![settings.freedom],
        warp: settings.warp,
        views: posed.iter().filter_map(observation).collect(),
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
            // Chosen by hand: the two poses of a planar board in the ambiguity differ by far more, and rounding by far less.
            (Some(found), Some(now)) => found.rotation.angle_to(&now.rotation) > 0.1,
            _ => false,
        };
        poses.push(found.or(now.copied())?);
    }
    mirrored.then(|| BundleState { poses, ..end.end.state.clone() })
}
