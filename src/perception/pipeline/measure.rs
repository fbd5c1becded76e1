//! The measures of each value: single numbers, and tables.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::colour_image::{ColourImage, dimmed};
use super::outline;
use super::step_output::{MIN_PROMINENCE, StepOutput};
use super::table::StepTable;
use super::value::{Binary, ContourSet, Field, RegionSet, Shapes, SourceImage, StepValue};
use crate::imaging::{
    Chains, Contour, Edges, Histogram, MomentSums, Moments, Plane, Polarity, Polygons, chain_length_px,
    circularity, perimeter_px,
};
use nalgebra::Vector2;
use std::ops::AddAssign;

/// Height of the bars of a histogram's image, px; each level is as many columns wide as told here.
const BARS_PX: (usize, usize) = (200, 2);
const CORNER: [u8; 3] = [255, 90, 208];

impl RegionSet {
    pub(super) fn none(source: SourceImage) -> Self {
        let (labels, sums, grey, boxes) = (Plane::default(), Vec::new(), Vec::new(), Vec::new());
        Self { labels, sums, grey, boxes, source }
    }
}

pub(super) fn image(image: SourceImage) -> StepOutput {
    let levels = image.as_slice();
    let sum: u64 = levels.iter().map(|v| u64::from(*v)).sum();
    let facts = [
        ("width_px", image.width() as f64),
        ("height_px", image.height() as f64),
        ("min_level", levels.iter().min().copied().unwrap_or(0).into()),
        ("greatest_level", levels.iter().max().copied().unwrap_or(0).into()),
        ("mean_level", sum as f64 / levels.len().max(1) as f64),
    ];
    StepOutput::new(StepValue::Image(image), facts)
}

/// The histogram with its normalized values, and both thresholds.
pub(super) fn histogram(histogram: &Histogram, polarity: Polarity, source: SourceImage) -> StepOutput {
    let shares = histogram.normalized();
    let mut facts = vec![("pixels", histogram.count() as f64)];
    if let Some(otsu) = histogram.otsu() {
        facts.push(("otsu_threshold", otsu.threshold.into()));
        facts.push(("otsu_separability", otsu.separability));
    }
    if let Some(valley) = histogram.valley(polarity, MIN_PROMINENCE) {
        facts.push(("valley_threshold", valley.threshold.into()));
        facts.push(("background_level", valley.background.into()));
        facts.push(("object_level", valley.object.into()));
    }
    let rows = (0..256).zip(histogram.bins()).zip(&shares);
    let rows = rows.map(|((level, count), share)| [f64::from(level), f64::from(*count), *share]);
    let table = StepTable::new("level", ["level", "pixels", "share"], rows);
    let (height, columns) = BARS_PX;
    let most = shares.iter().fold(1e-12f64, |m, s| m.max(*s));
    let bars = ColourImage::from_fn(256 * columns, height, |x, y| {
        let share = shares.get(x / columns).copied().unwrap_or(0.0);
        let inked = share / most * height as f64 > (height - 1 - y) as f64;
        if inked { [40; 3] } else { [255; 3] }
    });
    StepOutput::new(StepValue::Image(source), facts).with_table(table).with_drawn(bars)
}

pub(super) fn field(field: Field) -> StepOutput {
    let values = field.values.as_slice();
    let extreme = |pick: fn(f64, f64) -> f64, start| values.iter().fold(start, |m, v| pick(m, f64::from(*v)));
    let sum: f64 = values.iter().map(|v| f64::from(*v)).sum();
    let facts = [
        ("least", extreme(f64::min, f64::INFINITY)),
        ("greatest", extreme(f64::max, f64::NEG_INFINITY)),
        ("mean", sum / values.len().max(1) as f64),
        ("normalized_one", field.full),
    ];
    StepOutput::new(StepValue::Field(field), facts)
}

pub(super) fn binary(binary: Binary, threshold: Option<f64>) -> StepOutput {
    let objects: u64 = binary.runs.as_slice().iter().map(|r| u64::from(r.x1 - r.x0)).sum();
    let all = binary.source.as_slice().len().max(1);
    let mut facts = vec![("object_pixels", objects as f64), ("object_share", objects as f64 / all as f64)];
    facts.extend(threshold.map(|threshold| ("threshold", threshold)));
    StepOutput::new(StepValue::Binary(binary), facts)
}

pub(super) fn regions(set: RegionSet) -> StepOutput {
    let rows = (0..).zip(set.sums.iter().zip(&set.grey).zip(&set.boxes)).map(|(i, ((sums, grey), b))| {
        let mean = grey.m00 as f64 / sums.m00.max(1) as f64;
        let [x0, y0, x1, y1] = b.map(f64::from);
        [f64::from(i), sums.m00 as f64, mean, x0, y0, x1 - 1.0, y1 - 1.0]
    });
    let names = ["region", "area_px2", "mean_level", "first_x_px", "first_y_px", "last_x_px", "last_y_px"];
    let table = StepTable::new("region", names, rows);
    StepOutput::new(StepValue::Regions(set), [("regions", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn contours(set: ContourSet) -> StepOutput {
    let rows = (0..).zip(set.contours.as_slice()).map(|(i, c)| {
        let parent = c.parent().map_or(f64::NAN, |p| p as f64);
        let hole = f64::from(u8::from(c.hole));
        [f64::from(i), c.region.into(), hole, c.depth.into(), parent, c.len() as f64, c.area_px2 as f64]
    });
    let names = ["contour", "region", "is_hole", "depth", "parent", "pixels", "area_px2"];
    let table = StepTable::new("contour", names, rows);
    StepOutput::new(StepValue::Contours(set), [("contours", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn moments(set: RegionSet) -> StepOutput {
    let table = moment_table(&set.sums);
    StepOutput::new(StepValue::Regions(set), [("regions", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn grey_moments(set: RegionSet) -> StepOutput {
    let table = moment_table(&set.grey);
    StepOutput::new(StepValue::Regions(set), [("regions", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn grey_moments_of_image(sums: &MomentSums, image: SourceImage) -> StepOutput {
    let table = moment_table(std::slice::from_ref(sums));
    StepOutput::new(StepValue::Image(image), [("mass", sums.m00 as f64)]).with_table(table)
}

pub(super) fn moments_of_borders(set: ContourSet) -> StepOutput {
    let table = moment_table(&sums_of_borders(&set));
    StepOutput::new(StepValue::Contours(set), [("regions", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn axes(set: RegionSet) -> StepOutput {
    let table = axes_table(&set.sums);
    StepOutput::new(StepValue::Regions(set), [("regions", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn axes_of_borders(set: ContourSet) -> StepOutput {
    let table = axes_table(&sums_of_borders(&set));
    let mut drawn = dimmed(&set.source);
    for moments in sums_of_borders(&set).iter().filter_map(MomentSums::central) {
        let centre = Vector2::new(moments.x, moments.y);
        outline::half_axes(&moments).iter().for_each(|half| drawn.line(centre - half, centre + half, CORNER));
    }
    StepOutput::new(StepValue::Contours(set), [("regions", table.rows.len() as f64)])
        .with_table(table)
        .with_drawn(drawn)
}

/// Of each region, from its outer border and those of its holes.
fn sums_of_borders(set: &ContourSet) -> Vec<MomentSums> {
    let contours = set.contours.as_slice();
    let count = contours.iter().map(|c| c.region as usize + 1).max().unwrap_or(0);
    let mut sums = vec![MomentSums::default(); count];
    for contour in contours {
        if let Some(sums) = sums.get_mut(contour.region as usize) {
            sums.add_assign(MomentSums::of_border(set.contours.points(contour)));
        }
    }
    sums
}

/// Sums about the image's origin to the second order, centroid, and central moments to the third.
fn moment_table(sums: &[MomentSums]) -> StepTable {
    let names = [
        "region", "m00", "m10", "m01", "m20", "m11", "m02", "x_px", "y_px", "mu20", "mu11", "mu02", "mu30",
        "mu21", "mu12", "mu03",
    ];
    let rows = (0..).zip(sums).map(|(i, s)| {
        let raw = [s.m00, s.m10, s.m01, s.m20, s.m11, s.m02].map(|v| v as f64);
        let central = s
            .central()
            .map_or([f64::NAN; 9], |c| [c.x, c.y, c.mu20, c.mu11, c.mu02, c.mu30, c.mu21, c.mu12, c.mu03]);
        let mut row = [f64::from(i); 16];
        row.iter_mut().skip(1).zip(raw.into_iter().chain(central)).for_each(|(cell, v)| *cell = v);
        row
    });
    StepTable::new("region", names, rows)
}

/// Principal axes and orientation, (10.2).
fn axes_table(sums: &[MomentSums]) -> StepTable {
    let names = [
        "region",
        "x_px",
        "y_px",
        "major_px",
        "minor_px",
        "axis_rad",
        "direction_rad",
        "heavy_side_rad",
        "asymmetry",
    ];
    let rows = (0..).zip(sums).map(|(i, s)| {
        let own = s.central().map_or([f64::NAN; 8], |m: Moments| {
            let [major, minor] = outline::half_axes(&m).map(|half| half.norm());
            let angle = |angle: Option<f64>| angle.unwrap_or(f64::NAN);
            let (axis, direction, heavy) = (m.axis_rad(), m.direction_rad(), m.skew_direction_rad());
            [m.x, m.y, major, minor, angle(axis), angle(direction), angle(heavy), m.asymmetry()]
        });
        let mut row = [f64::from(i); 9];
        row.iter_mut().skip(1).zip(own).for_each(|(cell, v)| *cell = v);
        row
    });
    StepTable::new("region", names, rows)
}

pub(super) fn perimeters(set: ContourSet) -> StepOutput {
    let rows = (0..).zip(set.contours.as_slice()).map(|(i, contour): (u32, &Contour)| {
        let points = set.contours.points(contour);
        let length = perimeter_px(points);
        // that of a hole is seen from around it
        let round =
            length.filter(|_| !contour.hole).map_or(f64::NAN, |l| circularity(contour.area_px2 as f64, l));
        let hole = f64::from(u8::from(contour.hole));
        let length = length.unwrap_or(f64::NAN);
        [
            i.into(),
            contour.region.into(),
            hole,
            contour.area_px2 as f64,
            chain_length_px(points),
            length,
            round,
        ]
    });
    let names = ["contour", "region", "is_hole", "area_px2", "chain_px", "perimeter_px", "circularity"];
    let table = StepTable::new("contour", names, rows);
    StepOutput::new(StepValue::Contours(set), [("contours", table.rows.len() as f64)]).with_table(table)
}

pub(super) fn polygons(set: ContourSet, tolerance_px: f64) -> StepOutput {
    let mut polygons = Polygons::default();
    let mut rows = Vec::new();
    let mut drawn = dimmed(&set.source);
    for (i, contour) in (0u32..).zip(set.contours.as_slice()) {
        let corners = polygons.closed(set.contours.points(contour), tolerance_px);
        let places: Vec<_> = corners.iter().map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))).collect();
        rows.extend((0..).zip(&places).map(|(k, p)| [f64::from(i), f64::from(k), p.x, p.y]));
        drawn.polygon(&places, [0, 224, 74]);
        places.iter().for_each(|p| drawn.cross(*p, CORNER));
    }
    let table = StepTable::new("corner", ["contour", "corner", "x_px", "y_px"], rows);
    let facts = [("contours", set.contours.as_slice().len() as f64), ("corners", table.rows.len() as f64)];
    StepOutput::new(StepValue::Contours(set), facts).with_table(table).with_drawn(drawn)
}

pub(super) fn edges(edges: Box<Edges>, source: SourceImage) -> StepOutput {
    let rows = (0..).zip(edges.pixels()).map(|(i, p): (u32, _)| {
        let (dx, dy) = (f64::from(p.dx), f64::from(p.dy));
        [i.into(), p.x_px.into(), p.y_px.into(), dx.hypot(dy), dy.atan2(dx)]
    });
    let table = StepTable::new("edge pixel", ["pixel", "x_px", "y_px", "magnitude", "direction_rad"], rows);
    StepOutput::new(StepValue::Edges(edges, source), [("edge_pixels", table.rows.len() as f64)])
        .with_table(table)
}

pub(super) fn chains(chains: Box<Chains>, source: SourceImage) -> StepOutput {
    let rows = (0..).zip(chains.as_slice()).map(|(i, chain): (u32, _)| {
        let points = chains.of(chain);
        let place = |p: Option<&crate::imaging::EdgePixel>| {
            p.map_or([f64::NAN; 2], |p| [f64::from(p.x_px), f64::from(p.y_px)])
        };
        let ([x0, y0], [x1, y1]) = (place(points.first()), place(points.last()));
        [i.into(), points.len() as f64, f64::from(u8::from(chain.closed)), x0, y0, x1, y1]
    });
    let names = ["chain", "points", "is_closed", "first_x_px", "first_y_px", "last_x_px", "last_y_px"];
    let table = StepTable::new("chain", names, rows);
    StepOutput::new(StepValue::Chains(chains, source), [("chains", table.rows.len() as f64)])
        .with_table(table)
}

pub(super) fn shapes(shapes: Shapes, source: SourceImage) -> StepOutput {
    let table = match &shapes {
        Shapes::Segments(segments) => {
            let rows = (0..).zip(segments).map(|(i, s): (u32, _)| {
                let ([a, b], middle) = (s.ends_px, s.midpoint_px());
                let sd = s.line.sd_px(0.0);
                [
                    i.into(),
                    a.x,
                    a.y,
                    b.x,
                    b.y,
                    middle.x,
                    middle.y,
                    s.length_px(),
                    s.orientation_rad(),
                    sd,
                    s.line.covariance[(1, 1)].sqrt(),
                    s.step_levels,
                ]
            });
            let names = [
                "segment",
                "x0_px",
                "y0_px",
                "x1_px",
                "y1_px",
                "midpoint_x_px",
                "midpoint_y_px",
                "length_px",
                "orientation_rad",
                "across_sd_px",
                "orientation_sd_rad",
                "step_levels",
            ];
            StepTable::new("segment", names, rows)
        }
        Shapes::Ellipses(ellipses) => {
            let rows = (0..).zip(ellipses).map(|(i, e): (u32, _)| {
                let (ellipse, covariance) = (e.fit.ellipse, e.fit.centre_covariance_px2());
                let ((a, b), c) = (ellipse.axes_px(), ellipse.centre_px);
                let sd = (0.5 * covariance.trace()).sqrt();
                [i.into(), c.x, c.y, a, b, ellipse.angle_rad(), sd, e.share, f64::from(u8::from(e.light))]
            });
            let names = [
                "ellipse",
                "x_px",
                "y_px",
                "major_px",
                "minor_px",
                "axis_rad",
                "centre_sd_px",
                "rim_share",
                "is_light",
            ];
            StepTable::new("ellipse", names, rows)
        }
        Shapes::Corners(corners) => {
            let rows = (0..).zip(corners).map(|(i, c): (u32, _)| {
                let [xx, xy, yy] = c.covariance_px2;
                [i.into(), c.x, c.y, xx, xy, yy]
            });
            let names = ["corner", "x_px", "y_px", "xx_px2", "xy_px2", "yy_px2"];
            StepTable::new("corner", names, rows)
        }
        Shapes::Crossings(corners) => {
            let rows = (0..)
                .zip(corners)
                .map(|(i, c): (u32, _)| [i.into(), c.x.into(), c.y.into(), f64::from(c.response)]);
            StepTable::new("crossing", ["crossing", "x_px", "y_px", "response_levels"], rows)
        }
    };
    StepOutput::new(StepValue::Shapes(shapes, source), [("found", table.rows.len() as f64)]).with_table(table)
}
