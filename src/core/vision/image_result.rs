//! Detection and pose in a single image, without tracking: what `vservo detect` reports.
//!
//! Data flow: search of the whole image, examination for partial occlusion, pose with its ambiguity, misfit, motion during the readout; see [`Vision::process`] for sequences.

use super::frame_estimate::FrameEstimate;
use super::readout_motion::ReadoutMotion;
use super::{Growth, Prior, Vision};
use crate::detect::Detection;
use crate::detect::tags::TagDetection;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;
use crate::pose::RefinedPose;
use nalgebra::{Matrix6, Vector2};

/// Detections and pose of a single image.
#[derive(Debug, Clone, Copy)]
pub struct ImageResult<'a> {
    /// The points of the target, ids rising.
    pub found: &'a [Detection],
    /// Images of the points' centres, px, in the same order; those of dots are corrected for perspective and lens.
    pub px: &'a [Vector2<f64>],
    /// Pose of the target in the camera; `None` where the points do not determine it.
    pub pose: Option<&'a RefinedPose>,
    /// Where the pose is ambiguous, the other pose, and the logarithm of the likelihood ratio of the first to it.
    pub other: Option<&'a (RefinedPose, f64)>,
    /// Reprojection error, root mean square, px.
    pub rms_px: f64,
    /// Whether one pose explains the points within their stated deviations.
    pub consistent: bool,
    /// Factors on the variances of points and pose by the misfit; the pose's covariance contains its factor already.
    pub growth: Growth,
    /// Where the points look as if the target, or the camera, moved while rows were exposed one after the other: by about so many px from the first row to the last. The covariance
    /// of the poses contains it.
    pub readout_motion_px: Option<f64>,
    /// Ids of dots that are partly occluded or unevenly lit, and were measured by the rest of their rims.
    pub harmed: &'a [u32],
    /// All tags in the image, where the target is made of tags.
    pub tags: &'a [TagDetection],
}

impl Vision {
    /// Searches a single image. The state of tracking is neither used nor changed.
    ///
    /// # Errors
    /// The status that says why there is no target.
    pub fn process_image(&mut self, image: &ImageView<'_>) -> Result<ImageResult<'_>, TargetStatus> {
        self.search_alone(image)?;
        let estimate = &mut self.searched;
        self.estimator.describe(estimate, &self.finder, &Prior::default(), None, &[]);
        self.estimator.leave_out_strays(estimate, &self.finder);
        let growth = estimate.growth(0.0);
        let FrameEstimate { pairs, dots, pose, other, .. } = estimate;
        let mut enlarge = |pose: &mut RefinedPose| {
            let motion = ReadoutMotion::of(pose, pairs, dots, &self.estimator.camera);
            pose.covariance =
                pose.covariance * growth.pose + motion.map_or(Matrix6::zeros(), |m| m.covariance);
            motion.map(|motion| motion.px)
        };
        // three points leave nothing that a motion could explain
        let readout_motion_px = pose.as_mut().filter(|_| dots.len() > 3).and_then(&mut enlarge);
        if let Some((pose, log_ratio)) = other {
            enlarge(pose);
            *log_ratio /= growth.points;
        }
        Ok(ImageResult {
            growth,
            readout_motion_px,
            found: &estimate.dots,
            px: &estimate.px,
            pose: estimate.pose.as_ref().filter(|_| estimate.dots.len() > 3),
            other: estimate.other.as_ref(),
            rms_px: estimate.rms_px,
            // a single point, the centre of an ellipse, has no redundancy
            consistent: self.estimator.target.points().len() == 1 || self.estimator.believes(estimate),
            harmed: &self.harmed,
            tags: self.finder.tags(),
        })
    }

    /// The same without a calibrated lens: the points alone, without corrections and pose.
    ///
    /// # Errors
    /// As for [`Self::process_image`].
    pub fn points_of(&mut self, image: &ImageView<'_>) -> Result<ImageResult<'_>, TargetStatus> {
        self.search_alone(image)?;
        let estimate = &mut self.searched;
        estimate.px.clear();
        estimate.px.extend(estimate.dots.iter().map(|dot| dot.px));
        Ok(ImageResult {
            found: &estimate.dots,
            px: &estimate.px,
            pose: None,
            other: None,
            rms_px: f64::NAN,
            consistent: true,
            growth: Growth::NONE,
            readout_motion_px: None,
            harmed: &self.harmed,
            tags: self.finder.tags(),
        })
    }

    fn search_alone(&mut self, image: &ImageView<'_>) -> Result<(), TargetStatus> {
        let i = self.estimator.camera.intrinsics();
        if (image.width(), image.height()) != (i.width_px as usize, i.height_px as usize) {
            return Err(TargetStatus::WrongSize);
        }
        let Self { finder, searched, mirrored, .. } = self;
        if let Err(status) = finder.search(image, &mut searched.dots) {
            let finds = |image: &ImageView<'_>| finder.search(image, &mut searched.dots).is_ok();
            return Err(mirrored.look_once(status, image, finds));
        }
        self.finder.examine_occlusion(image, &mut self.searched.dots, &mut self.harmed);
        Ok(())
    }
}
