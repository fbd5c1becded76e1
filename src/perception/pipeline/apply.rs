//! What each step does with what it is given: the kernels of `imaging` and the finders of `detect`, in order.

use super::StepFailure;
use super::measure;
use super::step::{PipelineStep, ThresholdRule};
use super::step_output::{MIN_PROMINENCE, StepOutput};
use super::value::{Binary, ContourSet, Field, FieldKind, RegionSet, Shapes, SourceImage, StepValue};
use crate::detect::ellipse::{EllipseFinder, EllipseMiss, EllipseSettings};
use crate::detect::segments::{SegmentFinder, SegmentMiss, SegmentSettings};
use crate::imaging::corners::{RingDetector, StructureDetector};
use crate::imaging::{
    Chains, Components, Connectivity, Contours, Edges, Gaussian, Gradient, Histogram, ImageView, LocalMean,
    LocalThreshold, MomentSums, Operator, Plane, Polarity, Pyramid, Run, Runs, Segmentation, Uniformity,
    Window, direction, edges_by_laplacian, edges_by_magnitude, laplacian, magnitude, magnitude_sum,
};
use std::sync::Arc;

/// Most runs, edge pixels and pixels of contours. Chosen by hand: an image of 8 megapixels with a change at every second pixel.
const MAX_RUNS: usize = 1 << 22;
/// Most corners that are listed. Chosen by hand: more than any use of them needs, and a page stays readable.
const MAX_CORNERS: usize = 4096;
type Result<T> = std::result::Result<T, StepFailure>;

impl PipelineStep {
    /// Does the step. What it does not take, which parsing refuses, it hands on as it is.
    pub(super) fn apply(self, value: StepValue) -> Result<StepOutput> {
        match value {
            StepValue::Image(image) => of_image(self, image),
            StepValue::Gradient(gradient, operator, source) => {
                Ok(of_gradient(self, gradient, operator, source))
            }
            StepValue::Field(field) => match self {
                Self::Above { value, normalized } => above(&field, value, normalized),
                Self::AboveOtsu => above(&field, otsu_of(&field)?, false),
                _ => Ok(StepOutput::new(StepValue::Field(field), [])),
            },
            StepValue::Binary(binary) => match self {
                Self::Regions(connectivity) => Ok(regions_of(binary, connectivity)),
                Self::Contours => contours_of(binary),
                _ => Ok(StepOutput::new(StepValue::Binary(binary), [])),
            },
            StepValue::Regions(regions) => Ok(match self {
                Self::Moments => measure::moments(regions),
                Self::GreyMoments => measure::grey_moments(regions),
                Self::Axes => measure::axes(regions),
                _ => StepOutput::new(StepValue::Regions(regions), []),
            }),
            StepValue::Contours(set) => Ok(match self {
                Self::Moments => measure::moments_of_borders(set),
                Self::Axes => measure::axes_of_borders(set),
                Self::Perimeter => measure::perimeters(set),
                Self::Polygons { tolerance_px } => measure::polygons(set, tolerance_px),
                _ => StepOutput::new(StepValue::Contours(set), []),
            }),
            StepValue::Edges(edges, source) => match self {
                Self::Chains { min_points } => {
                    let mut chains = Box::<Chains>::default();
                    chains.link(&edges, min_points);
                    Ok(measure::chains(chains, source))
                }
                _ => Ok(StepOutput::new(StepValue::Edges(edges, source), [])),
            },
            StepValue::Chains(..) | StepValue::Shapes(..) => Ok(StepOutput::new(value, [])),
        }
    }
}

fn of_image(step: PipelineStep, source: SourceImage) -> Result<StepOutput> {
    let Some(view) = source.view() else { return Ok(StepOutput::new(StepValue::Image(source), [])) };
    match step {
        PipelineStep::Histogram(polarity) => {
            let histogram = Histogram::of(&view);
            Ok(measure::histogram(&histogram, polarity, source))
        }
        PipelineStep::GreyMoments => {
            let sums = MomentSums::of_grey(&view, &Window::whole(&view));
            Ok(measure::grey_moments_of_image(&sums, source))
        }
        PipelineStep::Gaussian { sd_px } => {
            let mut filter = Gaussian::new(sd_px).map_err(|e| StepFailure::Refused(e.to_string()))?;
            let mut out = Plane::default();
            filter.filter(&view, &mut out);
            Ok(measure::image(Arc::new(out)))
        }
        PipelineStep::Pyramid { level } => {
            let mut pyramid = Pyramid::new(level);
            pyramid.build(&view);
            match pyramid.level(level).map(|small| StepValue::image(&small)) {
                Some(StepValue::Image(small)) => Ok(measure::image(small)),
                _ => Ok(measure::image(source)),
            }
        }
        PipelineStep::Threshold(rule, polarity) => {
            let level = level(&Histogram::of(&view), rule, polarity)?;
            let runs = binarized(&view, |runs| runs.binarize(&view, &Window::whole(&view), level, polarity))?;
            Ok(measure::binary(Binary { runs, source }, Some(level.into())))
        }
        PipelineStep::LocalMean { radius_px, offset_levels, polarity } => {
            let mut thresholds = LocalMean::new(radius_px, offset_levels);
            let runs = binarized(&view, |runs| runs.binarize_mean(&view, &mut thresholds, polarity))?;
            Ok(measure::binary(Binary { runs, source }, None))
        }
        PipelineStep::LocalExtremes { contrast, polarity } => {
            let mut thresholds = LocalThreshold::with_size(view.width(), view.height());
            // where there is no contrast nothing is an object
            let nothing = if polarity == Polarity::Dark { 0 } else { 255 };
            thresholds.set(&view, contrast, nothing);
            let runs = binarized(&view, |runs| runs.binarize_local(&view, &mut thresholds, polarity))?;
            Ok(measure::binary(Binary { runs, source }, None))
        }
        PipelineStep::Merge { uniformity, min_area_px2 } => merged(&view, uniformity, min_area_px2, &source),
        PipelineStep::Gradient(operator) => {
            let mut gradient = Box::<Gradient>::default();
            gradient.find(&view, operator);
            let most =
                |plane: &Plane<i16>| plane.as_slice().iter().map(|v| v.unsigned_abs()).max().unwrap_or(0);
            let facts = [
                ("greatest_first", most(gradient.first()).into()),
                ("greatest_second", most(gradient.second()).into()),
            ];
            Ok(StepOutput::new(StepValue::Gradient(gradient, operator, source), facts))
        }
        PipelineStep::Laplacian => {
            let mut quarters = Plane::default();
            laplacian(&view, &mut quarters);
            let values = mapped(&quarters, |l: i16| f32::from(l) / 4.0);
            Ok(measure::field(Field { values, what: FieldKind::Laplacian, full: 255.0, source }))
        }
        PipelineStep::LaplacianEdges { threshold_levels, min_magnitude } => {
            let (mut gradient, mut sum, mut quarters) =
                (Gradient::default(), Plane::default(), Plane::default());
            gradient.find(&view, Operator::Sobel);
            magnitude_sum(&gradient, &mut sum);
            laplacian(&view, &mut quarters);
            let mut mask = Plane::default();
            edges_by_laplacian(&quarters, (4.0 * threshold_levels) as u16, &sum, min_magnitude, &mut mask);
            Ok(measure::binary(Binary { runs: runs_of_mask(&mask)?, source }, None))
        }
        PipelineStep::Edges(thresholds) => {
            let limit = limit(&view);
            let mut edges = Box::new(Edges::with_limit(limit));
            edges.find(&view, &thresholds);
            if edges.overflowed() {
                return Err(StepFailure::TooMany { what: "edge pixels", limit });
            }
            Ok(measure::edges(edges, source))
        }
        PipelineStep::Segments { min_length_px } => {
            let settings = SegmentSettings { min_length_px, ..SegmentSettings::default() };
            let mut found = Vec::new();
            match SegmentFinder::new(view.width(), view.height(), settings).search(&view, &mut found) {
                Err(SegmentMiss::TooManyEdges) => Err(too_many_edges(&view)),
                _ => Ok(measure::shapes(Shapes::Segments(found), source)),
            }
        }
        PipelineStep::Ellipses { min_axis_px } => {
            let settings = EllipseSettings { min_axis_px, ..EllipseSettings::default() };
            let mut found = Vec::new();
            match EllipseFinder::new(view.width(), view.height(), settings).search(&view, &mut found) {
                Err(EllipseMiss::TooManyEdges) => Err(too_many_edges(&view)),
                _ => Ok(measure::shapes(Shapes::Ellipses(found), source)),
            }
        }
        PipelineStep::Corners { strength } => {
            let mut detector = StructureDetector::new(view.width(), view.height(), MAX_CORNERS);
            let found = detector.find(&view, strength).to_vec();
            Ok(measure::shapes(Shapes::Corners(found), source))
        }
        PipelineStep::Crossings { response } => {
            let mut detector = RingDetector::new(view.width() * view.height(), MAX_CORNERS);
            let found = detector.find(&view, response).to_vec();
            Ok(measure::shapes(Shapes::Crossings(found), source))
        }
        _ => Ok(StepOutput::new(StepValue::Image(source), [])),
    }
}

fn of_gradient(
    step: PipelineStep,
    gradient: Box<Gradient>,
    operator: Operator,
    source: SourceImage,
) -> StepOutput {
    let mut values = Plane::default();
    let what = match step {
        PipelineStep::Magnitude { sum: false } => {
            magnitude(&gradient, &mut values);
            FieldKind::Magnitude
        }
        PipelineStep::Magnitude { sum: true } => {
            let mut sum = Plane::default();
            magnitude_sum(&gradient, &mut sum);
            values = mapped(&sum, f32::from);
            FieldKind::Magnitude
        }
        PipelineStep::Direction => {
            direction(&gradient, &mut values);
            FieldKind::Direction
        }
        _ => return StepOutput::new(StepValue::Gradient(gradient, operator, source), []),
    };
    // The sum of the magnitudes of the operator's weights, which follows from its mask: 2 or 8.
    let weights = match operator {
        Operator::FirstDifferences | Operator::Roberts => 2.0,
        Operator::Sobel => 8.0,
    };
    let full = if what == FieldKind::Magnitude { 255.0 * weights } else { 1.0 };
    measure::field(Field { values, what, full, source })
}

/// Otsu's threshold of a field, by 256 levels of equal width from its least number to its greatest.
fn otsu_of(field: &Field) -> Result<f64> {
    let values = field.values.as_slice();
    let (least, greatest) =
        values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    let width = f64::from(greatest - least) / 256.0;
    let levels = mapped(&field.values, |v: f32| (f64::from(v - least) / width) as u8);
    let view = ImageView::new(levels.as_slice(), field.values.width(), field.values.height());
    let split = view.ok().filter(|_| width > 0.0).and_then(|view| Histogram::of(&view).otsu());
    split
        .map(|split| f64::from(least) + width * f64::from(split.threshold.saturating_add(1)))
        .ok_or(StepFailure::OneLevel)
}

/// The level of a rule.
fn level(histogram: &Histogram, rule: ThresholdRule, polarity: Polarity) -> Result<u8> {
    match rule {
        ThresholdRule::Level(level) => Ok(level),
        ThresholdRule::Otsu => histogram.otsu().map(|o| o.threshold).ok_or(StepFailure::OneLevel),
        ThresholdRule::Valley => {
            let valley = histogram.valley(polarity, MIN_PROMINENCE);
            valley.map(|v| v.threshold).ok_or(StepFailure::OneMode)
        }
    }
}

/// As many runs as every second pixel being an object gives, or [`MAX_RUNS`].
fn limit(view: &ImageView<'_>) -> usize {
    (view.width().div_ceil(2) * view.height()).min(MAX_RUNS)
}

fn binarized(view: &ImageView<'_>, fill: impl FnOnce(&mut Runs)) -> Result<Runs> {
    let limit = limit(view);
    let mut runs = Runs::with_limit(limit);
    fill(&mut runs);
    if runs.overflowed() { Err(StepFailure::TooMany { what: "runs of pixels", limit }) } else { Ok(runs) }
}

/// The runs of what is 255 in a mask.
fn runs_of_mask(mask: &Plane<u8>) -> Result<Runs> {
    let Some(view) = mask.view() else { return Ok(Runs::with_limit(0)) };
    binarized(&view, |runs| runs.binarize(&view, &Window::whole(&view), 127, Polarity::Light))
}

fn above(field: &Field, value: f64, normalized: bool) -> Result<StepOutput> {
    let value = if normalized { value * field.full } else { value };
    let mut mask = Plane::default();
    edges_by_magnitude(&field.values, value as f32, &mut mask);
    let binary = Binary { runs: runs_of_mask(&mask)?, source: field.source.clone() };
    Ok(measure::binary(binary, Some(value)))
}

fn too_many_edges(view: &ImageView<'_>) -> StepFailure {
    StepFailure::TooMany { what: "edge pixels", limit: view.width() * view.height() / 8 }
}

fn mapped<T: Copy + Default, U: Copy + Default>(plane: &Plane<T>, f: impl Fn(T) -> U) -> Plane<U> {
    let mut out = Plane::with_size(plane.width(), plane.height());
    for y in 0..plane.height() {
        out.row_mut(y).iter_mut().zip(plane.row(y)).for_each(|(out, v)| *out = f(*v));
    }
    out
}

fn regions_of(binary: Binary, connectivity: Connectivity) -> StepOutput {
    let Binary { runs, source } = binary;
    let Some(view) = source.view() else { return measure::regions(RegionSet::none(source)) };
    let mut components = Components::with_limit(runs.as_slice().len());
    components.find(&runs, &Window::whole(&view), connectivity);
    let mut set = RegionSet::none(source.clone());
    components.label_image(&runs, view.width(), view.height(), &mut set.labels);
    components.grey_sums(&view, &runs, &mut set.grey);
    set.boxes = components.as_slice().iter().map(|c| [c.x0, c.y0, c.x1, c.y1]).collect();
    set.sums = vec![MomentSums::default(); set.boxes.len()];
    for (run, &region) in runs.as_slice().iter().zip(components.of_runs()) {
        if let Some(sums) = set.sums.get_mut(region as usize) {
            *sums += MomentSums::of_run(run);
        }
    }
    measure::regions(set)
}

fn merged(
    view: &ImageView<'_>,
    uniformity: Uniformity,
    min_area_px2: u32,
    source: &SourceImage,
) -> Result<StepOutput> {
    let mut segmentation = Segmentation::with_limit((view.width() * view.height()).min(1 << 24));
    segmentation.find(view, uniformity, min_area_px2)?;
    let mut set = RegionSet::none(source.clone());
    set.labels.reshape(view.width(), view.height());
    set.grey = vec![MomentSums::default(); segmentation.as_slice().len()];
    for y in 0..view.height() {
        let (labels, levels) = (segmentation.labels().row(y), view.row(y));
        set.labels.row_mut(y).iter_mut().zip(labels).for_each(|(out, label)| *out = label + 1);
        let mut x = 0;
        for stretch in labels.chunk_by(|a, b| a == b) {
            let end = x + stretch.len();
            let grey = stretch.first().and_then(|label| set.grey.get_mut(*label as usize));
            if let (Some(grey), Some(levels)) = (grey, levels.get(x..end)) {
                grey.add_grey(levels, x as u32, y as u32);
            }
            x = end;
        }
    }
    set.sums = segmentation.as_slice().iter().map(|r| r.sums).collect();
    set.boxes = segmentation.as_slice().iter().map(|r| [r.x0, r.y0, r.x1, r.y1]).collect();
    Ok(measure::regions(set))
}

fn contours_of(binary: Binary) -> Result<StepOutput> {
    let Binary { runs, source } = binary;
    // a pixel's border is passed four times at most, and no region has more border than pixels beside it
    let limit = runs.as_slice().iter().map(|r: &Run| 2 * (r.x1 - r.x0) as usize + 2).sum::<usize>();
    let limit = limit.min(2 * MAX_RUNS);
    let mut contours = Box::new(Contours::with_limits(runs.as_slice().len(), limit));
    contours.find(&runs, Connectivity::Eight);
    if contours.overflowed() {
        return Err(StepFailure::TooMany { what: "pixels of contours", limit });
    }
    Ok(measure::contours(ContourSet { contours, source }))
}
