//! The answer for one image: a line for people, an object for programs.

use super::DetectedImage;
use crate::detect::Detection;
use crate::detect::tags::TagDetection;
use crate::input::printable;
use crate::messages::TargetStatus;
use crate::pose::RefinedPose;
use crate::vision::Growth;
use nalgebra::Vector2;
use serde::Serialize;

/// What was found in one image.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ImageAnswer {
    pub(super) image: String,
    pub(super) status: &'static str,
    pub(super) reason: Option<String>,
    pub(super) features: Vec<FeatureOut>,
    pub(super) pose: Option<PoseOut>,
    /// Where two poses explain the image almost equally well: the less likely one.
    pub(super) other_pose: Option<OtherPose>,
    pub(super) reprojection_rms_px: Option<f64>,
    /// The variance of points over the one that noise explains, where they do not fit the pose as they should.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) misfit: Option<f64>,
    /// By how much something seems to have moved while rows were exposed one after the other, px from the first row to the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) readout_motion_px: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) tags: Option<Vec<TagOut>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) segments: Option<Vec<SegmentOut>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) ellipses: Option<Vec<EllipseOut>>,
    /// What the image cannot tell of what was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) note: Option<String>,
    pub(super) time_us: f64,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct FeatureOut {
    pub(super) id: u32,
    pub(super) u_px: f64,
    pub(super) v_px: f64,
    /// Under the key that it has had since the first answers.
    #[serde(rename = "sigma_px")]
    pub(super) sd_px: f64,
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct PoseOut {
    pub(super) position_m: [f64; 3],
    pub(super) rotation_xyzw: [f64; 4],
    pub(super) covariance: Vec<f64>,
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct OtherPose {
    #[serde(flatten)]
    pub(super) pose: PoseOut,
    /// How many times less likely it is.
    pub(super) likelihood_ratio: f64,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct TagOut {
    pub(super) id: u32,
    pub(super) corners_px: [[f64; 2]; 4],
    pub(super) hamming: u32,
}

/// A straight piece of an edge, the light on its right from the first end to the second.
#[derive(Debug, Clone, Serialize)]
pub(super) struct SegmentOut {
    pub(super) id: u32,
    pub(super) ends_px: [[f64; 2]; 2],
    /// Of each end `[uu, uv, vv]`, px^2.
    pub(super) end_covariance_px2: [[f64; 3]; 2],
    pub(super) length_px: f64,
    pub(super) orientation_rad: f64,
    pub(super) orientation_sd_rad: f64,
    /// `[x, y, L, alpha]` of (10.28), normalized; with a camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) features: Option<[f64; 4]>,
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct EllipseOut {
    pub(super) id: u32,
    /// Half axes, the longer first.
    pub(super) axes_px: [f64; 2],
    pub(super) axis_rad: f64,
    /// Of centre u, v (px) and the shape's uu, uv, vv (px^2), by rows: 25 numbers.
    pub(super) covariance: Vec<f64>,
    /// Share of the rim that is seen and fits.
    pub(super) rim_share: f64,
    pub(super) is_light: bool,
}

impl From<&RefinedPose> for PoseOut {
    fn from(pose: &RefinedPose) -> Self {
        let (p, q) = (pose.X_CO.translation.vector, pose.X_CO.rotation.coords);
        Self {
            position_m: p.into(),
            rotation_xyzw: [q.x, q.y, q.z, q.w],
            // symmetric: by rows is by columns
            covariance: pose.covariance.iter().copied().collect(),
        }
    }
}

impl From<&TagDetection> for TagOut {
    fn from(tag: &TagDetection) -> Self {
        Self { id: tag.id, corners_px: tag.corners_px.map(Into::into), hamming: tag.hamming }
    }
}

/// A status as a word for programs.
pub(super) fn word(status: TargetStatus) -> &'static str {
    match status {
        TargetStatus::Found => "found",
        TargetStatus::NoContrast => "no_contrast",
        TargetStatus::TooFewRegions => "too_few_regions",
        TargetStatus::NoMatch => "no_match",
        TargetStatus::Ambiguous => "ambiguous",
        TargetStatus::WrongSize => "wrong_size",
        TargetStatus::Inconsistent => "inconsistent",
        TargetStatus::NoPair => "no_pair",
        TargetStatus::TooFewShared => "too_few_shared",
        TargetStatus::GivenUp => "given_up",
        TargetStatus::OtherTags => "other_tags",
        TargetStatus::Mirrored => "mirrored",
    }
}

impl ImageAnswer {
    pub(super) fn nothing(image: String, status: &'static str, reason: String) -> Self {
        Self {
            image,
            status,
            reason: Some(reason),
            features: Vec::new(),
            pose: None,
            other_pose: None,
            reprojection_rms_px: None,
            misfit: None,
            readout_motion_px: None,
            tags: None,
            segments: None,
            ellipses: None,
            note: None,
            time_us: 0.0,
        }
    }

    /// Something that has yet to be told.
    pub(super) fn found(image: String) -> Self {
        Self { status: "found", reason: None, ..Self::nothing(image, "found", String::new()) }
    }

    pub(super) fn of(image: String, seen: &DetectedImage, time_us: f64) -> Self {
        let feature = |(found, px): (&Detection, &Vector2<f64>)| FeatureOut {
            id: found.id,
            u_px: px.x,
            v_px: px.y,
            // what misfits is in what is told of each
            sd_px: found.sd_px * seen.growth.points.sqrt(),
        };
        let other = seen.other.as_ref().map(|(pose, log_ratio)| OtherPose {
            pose: pose.into(),
            // exp(709) is the largest double: otherwise JSON would get an infinity.
            likelihood_ratio: log_ratio.min(700.0).exp(),
        });
        // points that no pose explains are told all the same: whoever asks by hand may know why
        let reason = seen.inconsistent.then(|| {
            format!("{}; or the camera file is another camera's", TargetStatus::Inconsistent.as_str())
        });
        Self {
            image,
            status: if seen.inconsistent { word(TargetStatus::Inconsistent) } else { "found" },
            reason,
            features: seen.found.iter().zip(&seen.px).map(feature).collect(),
            pose: seen.pose.as_ref().map(Into::into),
            other_pose: other,
            reprojection_rms_px: seen.rms_px,
            misfit: (seen.growth != Growth::NONE).then_some(seen.growth.points),
            readout_motion_px: seen.readout_motion_px,
            tags: (!seen.tags.is_empty()).then(|| seen.tags.iter().map(Into::into).collect()),
            segments: None,
            ellipses: None,
            note: seen.note(),
            time_us,
        }
    }

    /// For people.
    pub(super) fn line(&self) -> String {
        let mut line = format!("{}: ", printable(&self.image));
        match &self.reason {
            None => {
                let what = match (&self.segments, &self.ellipses) {
                    (Some(_), _) => "segments",
                    (_, Some(_)) => "ellipses",
                    _ => "points",
                };
                line += &format!("{} {what}", self.features.len());
            }
            Some(reason) => line += &format!("{}: {}", self.status, printable(reason)),
        }
        if let Some(tags) = &self.tags {
            let ids: Vec<_> = tags.iter().map(|tag| tag.id.to_string()).collect();
            line += &format!(", tags {}", ids.join(" "));
        }
        if let Some(pose) = &self.pose {
            let [x, y, z] = pose.position_m;
            line += &format!(", at ({x:.4}, {y:.4}, {z:.4}) m");
        }
        if let Some(rms_px) = self.reprojection_rms_px {
            line += &format!(", rms {rms_px:.3} px");
        }
        if let Some(other) = &self.other_pose {
            line += &format!(", another pose is {:.1} times less likely", other.likelihood_ratio);
        }
        if let Some(misfit) = self.misfit {
            line += &format!(" ({:.0} times what noise explains)", misfit.sqrt());
        }
        if let Some(note) = &self.note {
            line += &format!(" ({note})");
        }
        if self.time_us > 0.0 {
            line += &format!(", {:.0} us", self.time_us);
        }
        line + "\n"
    }
}
