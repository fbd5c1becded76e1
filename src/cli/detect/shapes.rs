//! `--target segments` and `--target ellipses`: what edges show, whatever it belongs to.

use super::answer::{EllipseOut, FeatureOut, ImageAnswer, SegmentOut};
use crate::camera_model::CameraModel;
use crate::detect::ellipse::{EllipseDetection, EllipseFinder, EllipseMiss, EllipseSettings};
use crate::detect::segments::{Segment, SegmentFinder, SegmentMiss, SegmentSettings};
use crate::features::segment_features;
use crate::imaging::ImageView;
use crate::rt::now;
use image::GrayImage;

/// A kind of shape, from `segments[:MIN_LENGTH_PX]` or `ellipses[:MIN_AXIS_PX]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ShapeKind {
    Segments { min_length_px: f64 },
    Ellipses { min_axis_px: f64 },
}

impl ShapeKind {
    /// `None` for words that name no shapes; an error for a bad number.
    pub(super) fn parse(text: &str) -> Option<Result<Self, String>> {
        let (word, number) = text.split_once(':').map_or((text, None), |(word, number)| (word, Some(number)));
        let least = |default: f64, floor: f64, what: &str| match number {
            None => Ok(default),
            Some(text) => text.parse().ok().filter(|v| (floor..=1e4).contains(v)).ok_or_else(|| {
                format!("{word}: the least {what} is a number of px from {floor} to 10000, not `{text}`")
            }),
        };
        match word {
            "segments" => {
                Some(least(20.0, 8.0, "length").map(|min_length_px| Self::Segments { min_length_px }))
            }
            "ellipses" => {
                Some(least(5.0, 5.0, "half axis").map(|min_axis_px| Self::Ellipses { min_axis_px }))
            }
            _ => None,
        }
    }
}

/// A finder for images of one size.
enum EdgeShapeFinder {
    Segments(Box<SegmentFinder>),
    Ellipses(Box<EllipseFinder>),
}

/// What is searched, with the finder for the size of the last image.
pub(super) struct ShapeSearch {
    kind: ShapeKind,
    camera: Option<CameraModel>,
    made_for: Option<((u32, u32), EdgeShapeFinder)>,
}

impl ShapeSearch {
    pub(super) fn new(kind: ShapeKind, camera: Option<CameraModel>) -> Self {
        Self { kind, camera, made_for: None }
    }

    pub(super) fn look(&mut self, name: String, image: &GrayImage) -> ImageAnswer {
        let size = image.dimensions();
        let (width, height) = (size.0 as usize, size.1 as usize);
        let Ok(view) = ImageView::new(image.as_raw(), width, height) else {
            return ImageAnswer::nothing(name, "no_contrast", "the image has no pixels".into());
        };
        let mut finder = match self.made_for.take() {
            Some((made_for, finder)) if made_for == size => finder,
            _ => match self.kind {
                ShapeKind::Segments { min_length_px } => {
                    let settings = SegmentSettings { min_length_px, ..SegmentSettings::default() };
                    EdgeShapeFinder::Segments(Box::new(SegmentFinder::new(width, height, settings)))
                }
                ShapeKind::Ellipses { min_axis_px } => {
                    let settings = EllipseSettings { min_axis_px, ..EllipseSettings::default() };
                    EdgeShapeFinder::Ellipses(Box::new(EllipseFinder::new(width, height, settings)))
                }
            },
        };
        let start = now();
        let mut answer = match &mut finder {
            EdgeShapeFinder::Segments(finder) => {
                let mut found = Vec::new();
                match finder.search(&view, &mut found) {
                    Ok(()) => self.segments(name, &found),
                    Err(miss) => missed(name, miss == SegmentMiss::NoEdges, miss.to_string()),
                }
            }
            EdgeShapeFinder::Ellipses(finder) => {
                let mut found = Vec::new();
                match finder.search(&view, &mut found) {
                    Ok(()) => ellipses(name, &found),
                    Err(miss) => missed(name, miss == EllipseMiss::NoEdges, miss.to_string()),
                }
            }
        };
        answer.time_us = (now() - start).as_s() * 1e6;
        self.made_for = Some((size, finder));
        answer
    }

    fn segments(&self, name: String, found: &[Segment]) -> ImageAnswer {
        let feature = |(id, s): (u32, &Segment)| {
            let middle = s.midpoint_px();
            FeatureOut { id, u_px: middle.x, v_px: middle.y, sd_px: s.line.sd_px(0.0) }
        };
        let out = |(id, s): (u32, &Segment)| SegmentOut {
            id,
            ends_px: s.ends_px.map(Into::into),
            end_covariance_px2: [0, 1].map(|end| {
                let c = s.end_covariance_px2(end);
                [c[(0, 0)], c[(0, 1)], c[(1, 1)]]
            }),
            length_px: s.length_px(),
            orientation_rad: s.orientation_rad(),
            orientation_sd_rad: s.line.covariance[(1, 1)].sqrt(),
            features: self
                .camera
                .as_ref()
                .map(|camera| segment_features(&s.ends_px.map(|px| camera.normalized_of(&px))).into()),
        };
        ImageAnswer {
            features: (0..).zip(found).map(feature).collect(),
            segments: Some((0..).zip(found).map(out).collect()),
            ..ImageAnswer::found(name)
        }
    }
}

fn ellipses(name: String, found: &[EllipseDetection]) -> ImageAnswer {
    let feature = |(id, e): (u32, &EllipseDetection)| {
        let centre = e.fit.ellipse.centre_px;
        let sd_px = (0.5 * e.fit.centre_covariance_px2().trace()).sqrt();
        FeatureOut { id, u_px: centre.x, v_px: centre.y, sd_px }
    };
    let out = |(id, e): (u32, &EllipseDetection)| EllipseOut {
        id,
        axes_px: e.fit.ellipse.axes_px().into(),
        axis_rad: e.fit.ellipse.angle_rad(),
        // symmetric: by rows is by columns
        covariance: e.fit.covariance.iter().copied().collect(),
        rim_share: e.share,
        is_light: e.light,
    };
    ImageAnswer {
        features: (0..).zip(found).map(feature).collect(),
        ellipses: Some((0..).zip(found).map(out).collect()),
        ..ImageAnswer::found(name)
    }
}

fn missed(name: String, no_edges: bool, reason: String) -> ImageAnswer {
    ImageAnswer::nothing(name, if no_edges { "no_contrast" } else { "no_match" }, reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_a_least_size() {
        let least = |text: &str| ShapeKind::parse(text);
        assert_eq!(least("segments"), Some(Ok(ShapeKind::Segments { min_length_px: 20.0 })));
        assert_eq!(least("ellipses:8"), Some(Ok(ShapeKind::Ellipses { min_axis_px: 8.0 })));
        assert!(least("segments:3").unwrap().unwrap_err().contains("from 8"));
        assert!(least("ellipses:x").unwrap().is_err());
        assert_eq!(least("ellipse:0.1x0.1"), None);
    }
}
