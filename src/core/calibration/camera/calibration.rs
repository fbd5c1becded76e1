//! What a calibration tells: the camera, its covariance, and how each image and corner fits.

use super::Unused;
use crate::calibration::bundle::Freedom;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use nalgebra::{DMatrix, Point3, Vector2};

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

/// An image and how well it fits.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewFit {
    /// Why it took no part, where it did not.
    pub unused: Option<Unused>,
    /// Pose of the board in the camera, where there is one: also of an image that took no part.
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

/// A camera, how certain it is, and how the images fit.
#[derive(Debug, Clone)]
pub struct CameraCalibration {
    /// The camera.
    pub camera: CameraModel,
    /// Which parameters were estimated.
    pub freedom: Freedom,
    /// Which parameters are unknown: those that were estimated, and those that were fixed at zero though they were free.
    pub unknown: Freedom,
    /// Covariance of the unknown parameters, in the order of [`Freedom::names`]. The noise is that which the errors tell; what a
    /// coefficient fixed at zero may be counts as an error of it and of all others.
    pub covariance: DMatrix<f64>,
    /// Height of the board's middle over its edges by its shape along x_O and y_O (towards z_O), m, and its deviations; where asked
    /// for.
    pub warp_m: Option<(Vector2<f64>, Vector2<f64>)>,
    /// Images, in the order given.
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
    /// The unknown parameters: name and standard deviation.
    pub fn deviations(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let names = self.unknown.names(self.camera.lens().model());
        names.into_iter().enumerate().map(|(i, name)| (name, self.covariance[(i, i)].max(0.0).sqrt()))
    }

    /// Corners that took part.
    pub fn points_used(&self) -> impl Iterator<Item = &PointFit> + Clone {
        let views = self.views.iter().filter(|view| view.unused.is_none());
        views.flat_map(|view| &view.points).filter(|point| point.used)
    }

    /// How many images took part.
    #[must_use]
    pub fn views_used(&self) -> usize {
        self.views.iter().filter(|view| view.unused.is_none()).count()
    }
}
