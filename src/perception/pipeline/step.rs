//! The steps: their words, what they take and give, and what they do where that is no matter of their parameters.

use super::ValueKind;
use crate::imaging::{Connectivity, EdgeThresholds, Operator, Polarity, Uniformity};

/// A step with its description for people.
#[derive(Debug, Clone, Copy)]
pub struct StepInfo {
    /// Its word.
    pub name: &'static str,
    /// How it is written, with its parameters; those in brackets may be left out.
    pub usage: &'static str,
    /// What it takes.
    pub takes: &'static [ValueKind],
    /// What it gives; `None` for a step that measures, and gives what it was given.
    pub gives: Option<ValueKind>,
    /// What it does, with units.
    pub about: &'static str,
}

/// All steps, in the order of Sect. 10.2.
pub const STEPS: &[StepInfo] = &[
    StepInfo {
        name: "histogram",
        usage: "histogram[:dark|light]",
        takes: &[ValueKind::Image],
        gives: None,
        about: "pixels of each grey level, their shares, Otsu's threshold, and the valley beside the background",
    },
    StepInfo {
        name: "gaussian",
        usage: "gaussian:SD_PX",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Image),
        about: "Gaussian filter of this standard deviation, more than 0 and at most 20 px",
    },
    StepInfo {
        name: "pyramid",
        usage: "pyramid:LEVEL",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Image),
        about: "the image 2^LEVEL times smaller, filtered against aliasing; 1 to 8",
    },
    StepInfo {
        name: "threshold",
        usage: "threshold:otsu|valley|LEVEL[:dark|light] of an image, threshold:otsu|NUMBER[:normalized] of a field",
        takes: &[ValueKind::Image, ValueKind::Field],
        gives: Some(ValueKind::Binary),
        about: "objects at most at the level (dark, the default) or above it; of a field what is greater than the number",
    },
    StepInfo {
        name: "local_mean",
        usage: "local_mean:RADIUS_PX[:OFFSET[:dark|light]]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Binary),
        about: "threshold at the mean of the square of 2 RADIUS_PX + 1 px about each pixel plus OFFSET levels (-8; for light objects above 0)",
    },
    StepInfo {
        name: "local_extremes",
        usage: "local_extremes:CONTRAST[:dark|light]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Binary),
        about: "threshold half-way between least and greatest level about tiles of 32 px, where these differ by CONTRAST levels",
    },
    StepInfo {
        name: "regions",
        usage: "regions[:4|8]",
        takes: &[ValueKind::Binary],
        gives: Some(ValueKind::Regions),
        about: "connected regions of the objects' pixels, neighbours by sides (4) or also by corners (8, the default)",
    },
    StepInfo {
        name: "merge",
        usage: "merge:interval|means:LEVELS[:MIN_AREA_PX2]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Regions),
        about: "regions grown by merging: all levels in an interval of LEVELS, or means that differ by LEVELS at most",
    },
    StepInfo {
        name: "differences",
        usage: "differences",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Gradient),
        about: "gradient by first differences along x and y",
    },
    StepInfo {
        name: "roberts",
        usage: "roberts",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Gradient),
        about: "gradient by first differences along the diagonals of 2 x 2 pixels",
    },
    StepInfo {
        name: "sobel",
        usage: "sobel",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Gradient),
        about: "gradient by weighted differences over 3 x 3 pixels, 8 times the slope per pixel",
    },
    StepInfo {
        name: "magnitude",
        usage: "magnitude[:sum]",
        takes: &[ValueKind::Gradient],
        gives: Some(ValueKind::Field),
        about: "length of the gradient, or the sum of the amounts of both derivatives",
    },
    StepInfo {
        name: "direction",
        usage: "direction",
        takes: &[ValueKind::Gradient],
        gives: Some(ValueKind::Field),
        about: "direction of the gradient, rad from the first derivative towards the second",
    },
    StepInfo {
        name: "laplacian",
        usage: "laplacian",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Field),
        about: "level less the mean of the four neighbours, grey levels",
    },
    StepInfo {
        name: "laplacian_edges",
        usage: "laplacian_edges:LEVELS[:MIN_MAGNITUDE]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Binary),
        about: "where the Laplacian is below LEVELS and Sobel's |d1| + |d2| at least MIN_MAGNITUDE (100)",
    },
    StepInfo {
        name: "edges",
        usage: "edges[:HIGH[:LOW]]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Edges),
        about: "edges one pixel thin, to a fraction of a pixel, by Sobel's magnitude with hysteresis",
    },
    StepInfo {
        name: "chains",
        usage: "chains[:MIN_POINTS]",
        takes: &[ValueKind::Edges],
        gives: Some(ValueKind::Chains),
        about: "edge pixels linked to curves of at least MIN_POINTS (8)",
    },
    StepInfo {
        name: "contours",
        usage: "contours",
        takes: &[ValueKind::Binary],
        gives: Some(ValueKind::Contours),
        about: "border pixels of each region and each hole, in order, and which lies in which",
    },
    StepInfo {
        name: "polygons",
        usage: "polygons:TOLERANCE_PX",
        takes: &[ValueKind::Contours],
        gives: None,
        about: "corners of each contour, from whose sides no pixel lies farther than the tolerance",
    },
    StepInfo {
        name: "perimeter",
        usage: "perimeter",
        takes: &[ValueKind::Contours],
        gives: None,
        about: "length of each contour, and how round what it encloses is (1 for a disc)",
    },
    StepInfo {
        name: "moments",
        usage: "moments",
        takes: &[ValueKind::Regions, ValueKind::Contours],
        gives: None,
        about: "moments (10.1), centroid and central moments of each region, from its pixels or from its borders alone",
    },
    StepInfo {
        name: "grey_moments",
        usage: "grey_moments",
        takes: &[ValueKind::Regions, ValueKind::Image],
        gives: None,
        about: "the same with each pixel weighted by its level; of an image those of all of it",
    },
    StepInfo {
        name: "axes",
        usage: "axes",
        takes: &[ValueKind::Regions, ValueKind::Contours],
        gives: None,
        about: "principal axes and orientation (10.2) of each region, over half a turn and, by third moments, the full one",
    },
    StepInfo {
        name: "segments",
        usage: "segments[:MIN_LENGTH_PX]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Shapes),
        about: "straight segments of edges, with their deviations",
    },
    StepInfo {
        name: "ellipses",
        usage: "ellipses[:MIN_AXIS_PX]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Shapes),
        about: "ellipses of edges, whole or in part, with their deviations; half axes of at least 5 px",
    },
    StepInfo {
        name: "corners",
        usage: "corners[:STRENGTH]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Shapes),
        about: "corners of edges of any kind by the structure tensor, squared grey levels per px^2 (400)",
    },
    StepInfo {
        name: "crossings",
        usage: "crossings[:RESPONSE]",
        takes: &[ValueKind::Image],
        gives: Some(ValueKind::Shapes),
        about: "where four squares meet, as on a chessboard: ring response of more than so many grey levels (24)",
    },
];

/// Where a threshold lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ThresholdRule {
    /// Greatest variance between the classes.
    Otsu,
    /// The valley beside the background's mode.
    Valley,
    /// A grey level.
    Level(u8),
}

/// A step with its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PipelineStep {
    Histogram(Polarity),
    Gaussian { sd_px: f64 },
    Pyramid { level: usize },
    Threshold(ThresholdRule, Polarity),
    Above { value: f64, normalized: bool },
    AboveOtsu,
    LocalMean { radius_px: u16, offset_levels: i16, polarity: Polarity },
    LocalExtremes { contrast: u8, polarity: Polarity },
    Regions(Connectivity),
    Merge { uniformity: Uniformity, min_area_px2: u32 },
    Gradient(Operator),
    Magnitude { sum: bool },
    Direction,
    Laplacian,
    LaplacianEdges { threshold_levels: f64, min_magnitude: u16 },
    Edges(EdgeThresholds),
    Chains { min_points: usize },
    Contours,
    Polygons { tolerance_px: f64 },
    Perimeter,
    Moments,
    GreyMoments,
    Axes,
    Segments { min_length_px: f64 },
    Ellipses { min_axis_px: f64 },
    Corners { strength: f32 },
    Crossings { response: u8 },
}
