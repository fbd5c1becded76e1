//! The tags of a target's plate: predictions of its points become predictions of its tags, and the bias of corners by the lens's distortion is computed.
//!
//! A side is measured as a straight line. A lens with distortion bends it, and the best line intersects that of
//! the next side not at the image of the corner: by 0.05 px for a side of 120 px at k1 = -0.15, [`TagPlateFinder::bias_px`].

use super::points::TagPoints;
use super::{PredictedTag, TagDetection, TagFinder};
use crate::camera_model::CameraModel;
use crate::detect::{Detection, PredictedPoint};
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;
use crate::target::{Tags, TargetPoint};
use nalgebra::{Point3, Vector2};

/// Places along a side, from one end to the other, at which it is taken to be measured. Chosen by hand: rows near the ends of a side are left out
/// of its measurement (`side::CLEAR_BLURS`), here by 6 % of it. Of a side that is bowed as a parabola half or double of either number
/// changes the bias by 5 to 12 % of itself, which follows from the line of least squares through the places.
const PLACES: u32 = 9;
const FROM_END: f64 = 0.06;

/// Finds the tags of one plate. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct TagPlateFinder {
    points: TagPoints,
    /// The id of each tag of the plate.
    ids: Box<[u32]>,
    expected: Vec<PredictedTag>,
    camera: CameraModel,
    corners: Box<[TargetPoint]>,
}

impl TagPlateFinder {
    /// A finder for frames of `camera` and one plate.
    #[must_use]
    pub fn new(camera: &CameraModel, target: &Tags) -> Self {
        let i = camera.intrinsics();
        let finder = TagFinder::new(target.family(), i.width_px as usize, i.height_px as usize);
        let ids: Box<[u32]> = target.tags().iter().map(|tag| tag.id).collect();
        Self {
            points: TagPoints::new(finder, &ids),
            expected: Vec::with_capacity(ids.len()),
            ids,
            camera: *camera,
            corners: target.points().into(),
        }
    }

    /// The same for a camera whose response is not known: see [`TagFinder::for_unknown_response`].
    #[must_use]
    pub fn for_unknown_response(mut self) -> Self {
        self.points = self.points.for_unknown_response();
        self
    }

    /// All tags of the family in the last frame, ids rising, also those that do not belong to the plate.
    #[must_use]
    pub fn tags(&self) -> &[TagDetection] {
        self.points.seen()
    }

    /// In words, which tags the last frame showed, and which belong to the plate.
    #[must_use]
    pub fn seen_in_words(&self) -> String {
        self.points.seen_in_words()
    }

    /// Searches the whole frame: fills `found` with the corners of the plate's tags, ids rising.
    ///
    /// # Errors
    /// The status that says why there is none: `Ambiguous` where each is there more than once.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        self.points.search(image, found)
    }

    /// Tracks the tags of which all four corners are expected. Returns whether any was detected.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedPoint],
        found: &mut Vec<Detection>,
    ) -> bool {
        self.expected.clear();
        for corners in expected.chunk_by(|a, b| a.id / 4 == b.id / 4) {
            let [a, b, c, d] = corners else { continue };
            let Some(id) = self.ids.get(a.id as usize / 4) else { continue };
            let slack_px = corners.iter().map(|corner| corner.slack_px).fold(0.0, f64::max);
            let corners_px = [a, b, c, d].map(|corner| corner.px);
            self.expected.push(PredictedTag { id: *id, corners_px, slack_px });
        }
        self.points.track(image, &self.expected, found)
    }

    /// Bias of the measured corner `id`: its offset from the projection of the true corner by the lens's distortion, px, for the plate at `X_CO`.
    #[must_use]
    pub fn bias_px(&self, id: u32, X_CO: &Pose) -> Vector2<f64> {
        if self.camera.lens().is_ideal() {
            return Vector2::zeros();
        }
        self.bias(id as usize, X_CO).unwrap_or_else(Vector2::zeros)
    }

    fn bias(&self, i: usize, X_CO: &Pose) -> Option<Vector2<f64>> {
        let corner = |k: usize| self.corners.get(i / 4 * 4 + k % 4).map(|point| point.p_O);
        let (before, here, after) = (corner(i + 3)?, corner(i)?, corner(i + 1)?);
        let (one, other) = (self.side(&before, &here, X_CO)?, self.side(&here, &after, X_CO)?);
        // intersection of the lines n . p = d
        let det = one.0.perp(&other.0);
        let meet =
            Vector2::new(one.1 * other.0.y - other.1 * one.0.y, one.0.x * other.1 - other.0.x * one.1) / det;
        let bias = meet - self.camera.project(&(X_CO * here))?;
        // Chosen by hand, px: lenses move such corners by tenths of a pixel; more means that the pose must be wrong, and then nothing is corrected.
        (bias.norm() < 10.0).then_some(bias)
    }

    /// Normal and offset of the line that fits the image of a side best.
    fn side(&self, from: &Point3<f64>, to: &Point3<f64>, X_CO: &Pose) -> Option<(Vector2<f64>, f64)> {
        let (mut sum, mut squares) = (Vector2::zeros(), nalgebra::Matrix2::zeros());
        let ends = self.camera.project(&(X_CO * from))?;
        for k in 0..PLACES {
            let t = FROM_END + (1.0 - 2.0 * FROM_END) * f64::from(k) / f64::from(PLACES - 1);
            // from an end of the side, so that the squares are small
            let p = self.camera.project(&(X_CO * (from + (to - from) * t)))? - ends;
            sum += p;
            squares += p * p.transpose();
        }
        let mean = sum / f64::from(PLACES);
        let spread = squares / f64::from(PLACES) - mean * mean.transpose();
        // the direction of the greatest spread
        let angle = 0.5 * (2.0 * spread.m12).atan2(spread.m11 - spread.m22);
        let normal = Vector2::new(-angle.sin(), angle.cos());
        Some((normal, normal.dot(&(mean + ends))))
    }
}
