//! Assembly for a pair of cameras: the taught view, the vision core, and the set-point of the law.

use super::{AssembleError, measurement_faults};
use crate::camera_model::CameraModel;
use crate::config::stereo::between;
use crate::config::{Camera, Config, Scene, Source, Stereo};
use crate::detect::Finder;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::scene::Renderer;
use crate::servo::SetPoint;
use crate::vision::{SpacePoint, StereoVision, TaughtPoint, TaughtView};
use nalgebra::{Matrix3, Point3, Vector3};

/// Pairs of images from which a simulated pair is taught, so that its noise is a quarter of that of one pair, 1 / sqrt(16).
const TEACH_FRAMES: u64 = 16;
/// Their number, which must be that of no frame of a run: noise is drawn by it.
const FIRST_TEACH_FRAME: u64 = 1 << 48;

/// The pair of a configuration, and its right camera.
fn pair(config: &Config) -> Result<(&Stereo, &Camera), AssembleError> {
    config.stereo.as_ref().zip(config.further_cameras.first()).ok_or(AssembleError::NoStereo)
}

/// The vision core of two cameras.
///
/// # Errors
/// [`AssembleError`], where a simulated pair does not see the target in the desired pose.
pub fn stereo_vision(config: &Config) -> Result<StereoVision, AssembleError> {
    let (stereo, right) = pair(config)?;
    let view = taught_view(config)?;
    let vision = StereoVision::new(stereo.rig.clone(), &config.target, view, stereo.tolerance);
    let vision = vision.for_responses(&config.camera.response, &right.response);
    Ok(match measurement_faults(config) {
        Some(faults) => vision.with_faults(faults),
        None => vision,
    })
}

/// The taught view: that of the run file, or that of a simulated pair in the desired pose. It is bit-identical in all processes.
///
/// # Errors
/// As for [`stereo_vision`].
pub fn taught_view(config: &Config) -> Result<TaughtView, AssembleError> {
    let (stereo, right) = pair(config)?;
    if let Some(view) = &stereo.taught {
        return Ok(view.clone());
    }
    let (scene, X_DO) = (config.scene.as_ref().ok_or(AssembleError::NotTaught)?, stereo.X_DO);
    let X_LR = between(&scene.mount, &right.mount).ok_or(AssembleError::NoStereo)?;
    let mut left = SimulatedEye::new(config, (&config.camera, scene.camera), X_DO, scene)?;
    let mut right = SimulatedEye::new(config, (right, right.model), X_LR.inv_mul(&X_DO), scene)?;
    let mut views = Vec::new();
    for frame_id in FIRST_TEACH_FRAME..FIRST_TEACH_FRAME + TEACH_FRAMES {
        let (left, right) = (left.look(frame_id)?, right.look(frame_id)?);
        let points = StereoVision::points_in(&stereo.rig, left, right);
        views.push(points.map_err(|(side, status)| AssembleError::NotSeen {
            side: side.as_str(),
            status: status.as_str(),
        })?);
    }
    Ok(TaughtView::new(&taught_points(&views), X_DO)?)
}

/// The points that are in all views, each with the mean of its positions.
#[must_use]
pub fn taught_points(views: &[Vec<SpacePoint>]) -> Vec<TaughtPoint> {
    let (Some(first), over) = (views.first(), 1.0 / views.len() as f64) else { return Vec::new() };
    let of = |id: u32| {
        let each = views.iter().map(|view| {
            let at = view.binary_search_by_key(&id, |point| point.id).ok()?;
            view.get(at).map(|point| (point.p_L.coords, point.covariance))
        });
        let sum = each.collect::<Option<Vec<_>>>()?.into_iter();
        let (p, covariance) = sum.fold((Vector3::zeros(), Matrix3::zeros()), |s, e| (s.0 + e.0, s.1 + e.1));
        Some(TaughtPoint { id, p_D: Point3::from(p * over), covariance: covariance * (over * over) })
    };
    first.iter().filter_map(|point| of(point.id)).collect()
}

/// The set-point of a law with a pair of cameras: the taught points at their taught positions.
///
/// # Errors
/// As for [`stereo_vision`].
pub fn stereo_set_point(config: &Config) -> Result<SetPoint, AssembleError> {
    let view = taught_view(config)?;
    let (ids, points): (Vec<u32>, Vec<Point3<f64>>) = view.points_O().unzip();
    SetPoint::from_pose(view.X_DO(), &points)
        .and_then(|goal| goal.with_ids(&ids))
        .ok_or(AssembleError::NoStereo)
}

/// One camera of a simulated pair, at the desired pose.
struct SimulatedEye {
    renderer: Renderer,
    finder: Finder,
    X_CO: Pose,
    size: (usize, usize),
    pixels: Vec<u8>,
}

impl SimulatedEye {
    /// `lens` is the true one, before an object that is truly at `X_CO`.
    fn new(
        config: &Config,
        (camera, lens): (&Camera, CameraModel),
        X_CO: Pose,
        scene: &Scene,
    ) -> Result<Self, AssembleError> {
        let Source::Synthetic { look, sensor, .. } = &camera.source else {
            return Err(AssembleError::NoScene);
        };
        let i = lens.intrinsics();
        let size = (i.width_px as usize, i.height_px as usize);
        Ok(Self {
            renderer: Renderer::new(lens, scene.target.clone(), *look, *sensor)?
                .with_backdrop(scene.backdrop)?
                .with_bystanders(&scene.bystanders),
            finder: Finder::new(camera.model, &config.target).for_response(&camera.response),
            X_CO,
            size,
            pixels: vec![0; size.0 * size.1],
        })
    }

    /// An image, and who looks at it.
    fn look(&mut self, frame_id: u64) -> Result<(&mut Finder, ImageView<'_>), AssembleError> {
        self.renderer.render(&[self.X_CO], frame_id, &mut self.pixels);
        let (width, height) = self.size;
        Ok((&mut self.finder, ImageView::new(&self.pixels, width, height)?))
    }
}
