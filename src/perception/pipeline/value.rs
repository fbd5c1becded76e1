//! What passes from step to step.

use crate::detect::ellipse::EllipseDetection;
use crate::detect::segments::Segment;
use crate::imaging::corners::{RingCorner, StructureCorner};
use crate::imaging::{Chains, Contours, Edges, Gradient, ImageView, MomentSums, Operator, Plane, Runs};
use std::fmt;
use std::sync::Arc;

/// What a step takes or gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ValueKind {
    /// Grey levels, 0 to 255.
    Image,
    /// Two derivatives of each pixel.
    Gradient,
    /// One number of each pixel: a magnitude, a direction, a Laplacian.
    Field,
    /// Which pixels belong to objects.
    Binary,
    /// Connected regions with their moments.
    Regions,
    /// Borders of regions and holes.
    Contours,
    /// Edges one pixel thin.
    Edges,
    /// Edges linked to curves.
    Chains,
    /// Segments, ellipses or corners; no step takes them.
    Shapes,
}

impl fmt::Display for ValueKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Image => "an image",
            Self::Gradient => "a gradient",
            Self::Field => "a field of numbers",
            Self::Binary => "a binary image",
            Self::Regions => "regions",
            Self::Contours => "contours",
            Self::Edges => "edges",
            Self::Chains => "chains",
            Self::Shapes => "shapes",
        })
    }
}

impl ValueKind {
    /// Its word for programs.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Gradient => "gradient",
            Self::Field => "field",
            Self::Binary => "binary",
            Self::Regions => "regions",
            Self::Contours => "contours",
            Self::Edges => "edges",
            Self::Chains => "chains",
            Self::Shapes => "shapes",
        }
    }
}

/// The grey image that later steps look back at.
pub(super) type SourceImage = Arc<Plane<u8>>;

#[derive(Debug, Clone)]
pub(super) enum StepValue {
    Image(SourceImage),
    Gradient(Box<Gradient>, Operator, SourceImage),
    Field(Field),
    Binary(Binary),
    Regions(RegionSet),
    Contours(ContourSet),
    Edges(Box<Edges>, SourceImage),
    Chains(Box<Chains>, SourceImage),
    Shapes(Shapes, SourceImage),
}

/// One number of each pixel.
#[derive(Debug, Clone)]
pub(super) struct Field {
    pub(super) values: Plane<f32>,
    pub(super) what: FieldKind,
    /// What 1 stands for where the field is normalized: white beside black through an operator of weights that add up to 1 on either side.
    pub(super) full: f64,
    pub(super) source: SourceImage,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FieldKind {
    Magnitude,
    Direction,
    Laplacian,
}

/// The objects' pixels, as runs.
#[derive(Debug, Clone)]
pub(super) struct Binary {
    pub(super) runs: Runs,
    pub(super) source: SourceImage,
}

/// Regions of a binary image, or grown by merging.
#[derive(Debug, Clone)]
pub(super) struct RegionSet {
    /// Of each pixel 0, or 1 + the region's index.
    pub(super) labels: Plane<u32>,
    /// Of each region, each pixel of weight one.
    pub(super) sums: Vec<MomentSums>,
    /// Of each region, each pixel weighted with its level.
    pub(super) grey: Vec<MomentSums>,
    /// First column and row, and those behind the last.
    pub(super) boxes: Vec<[u32; 4]>,
    pub(super) source: SourceImage,
}

#[derive(Debug, Clone)]
pub(super) struct ContourSet {
    pub(super) contours: Box<Contours>,
    pub(super) source: SourceImage,
}

#[derive(Debug, Clone)]
pub(super) enum Shapes {
    Segments(Vec<Segment>),
    Ellipses(Vec<EllipseDetection>),
    Corners(Vec<StructureCorner>),
    Crossings(Vec<RingCorner>),
}

impl StepValue {
    /// A copy of an image.
    pub(super) fn image(image: &ImageView<'_>) -> Self {
        let mut plane = Plane::with_size(image.width(), image.height());
        for y in 0..image.height() {
            plane.row_mut(y).copy_from_slice(image.row(y));
        }
        Self::Image(Arc::new(plane))
    }

    pub(super) fn kind(&self) -> ValueKind {
        match self {
            Self::Image(_) => ValueKind::Image,
            Self::Gradient(..) => ValueKind::Gradient,
            Self::Field(_) => ValueKind::Field,
            Self::Binary(_) => ValueKind::Binary,
            Self::Regions(_) => ValueKind::Regions,
            Self::Contours(_) => ValueKind::Contours,
            Self::Edges(..) => ValueKind::Edges,
            Self::Chains(..) => ValueKind::Chains,
            Self::Shapes(..) => ValueKind::Shapes,
        }
    }
}
