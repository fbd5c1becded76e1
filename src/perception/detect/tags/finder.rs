//! Detection of the tags of one family: search of a whole frame, and tracking in windows about expected tags.
//!
//! Data flow: local threshold, dark regions, their outlines, quadrilaterals ([`quad`]), bits ([`decode`](super::decode)), corners from the sides
//! ([`EdgeMeter`]) or from the whole tag ([`WholeMeter`]), correction for growth ([`super::edge_growth`]).

use super::best_corners::best_corners;
use super::codebook::Codebook;
use super::decode::{Decoded, NoTag, decode};
use super::edges::{Believed, Corners, EdgeMeter};
use super::quad::{self, Quad};
use super::whole::WholeMeter;
use crate::imaging::{
    Components, Connectivity, ImageView, LocalThreshold, Outlines, Runs, Window, WindowPoint,
};
use crate::messages::TargetStatus;
use crate::target::TagFamily;
use nalgebra::Vector2;
use thiserror::Error;

/// Most tags of one frame. Chosen by hand: room for results is allocated once; further tags of a frame are left out.
pub const MAX_TAGS: usize = 256;
/// Largest frame, px each way. Chosen by hand: the power of two above the 14 192 px of industrial sensors with 151 megapixels. Half refuses
/// these, the double doubles what the buffers of the largest frames need each way.
const MAX_SIDE: usize = 1 << 14;
/// Smallest region: greater and lesser side of its box, and its pixels. Chosen by hand: a square of 12 px that is tilted by 55 degrees is 7 px
/// high, and the border of a 36h11 fills 28 of 64 cells, 37 px of these 84. Cells would have 1.5 px then; the tests ask for tags from 14 px on
/// (`corners_lie_where_they_are_and_as_surely_as_stated`). Half lets regions through that are not read anyway, the double loses those tags.
const MIN_BOX_PX: (u32, u32) = (12, 7);
const MIN_PIXELS: u64 = 30;
/// Of more runs than one for so many pixels, and than so many, the last are left out: no image of tags has them. Chosen by hand: buffers are
/// allocated once and grow with both; half of the pixels doubles them, and with the double an image full of texture loses its lowest rows sooner.
const PIXELS_OF_RUN: usize = 8;
const MAX_RUNS: usize = 1 << 17;
/// Least and greatest contrast that is asked of 3 x 3 tiles, grey levels. Only bands along edges remain of large dark areas, and their outer
/// outline is the same. Chosen by hand: the least counts where noise is below 1.4 levels, for the numbers below ask for 7 deviations; half takes the
/// paper's texture for edges there, the double loses tags in deep shadow. The greatest counts above 5.7 levels of noise: half labels noise there, the
/// double loses tags of less than 80 levels of contrast.
const MIN_CONTRAST: f64 = 10.0;
const MAX_CONTRAST: f64 = 40.0;
/// The noise of an image spreads the 16 pixels of a tile by 2.9 deviations or less in one tile of five, and the 144 of 3 x 3 tiles by 5.3 on
/// average, by more than 7 in 0.6 % of the cases: 2.4 times the former is the latter, so that hardly any noise is labelled. With half of the factor most
/// places would be, and with the double tags of less than 14 deviations of contrast are lost.
const QUIET_TILES: usize = 5;
const CONTRAST_IN_SPREADS: f64 = 2.4;
/// The outline of a convex region is as long as that of its box; noise makes it longer. Chosen by hand: half would refuse all tags, the double
/// follows outlines of clutter for longer before they are refused.
const LONGEST_OUTLINE: f64 = 1.6;
/// Margin of the window around an expected tag beyond its slack, px: three tiles of the threshold, whose values at the margin need the next tile
/// on each side, and two pixels, since regions that touch the window's border are left out. Chosen by hand: half loses
/// tags whose margin has no threshold, the double takes more time and clutter in.
const AROUND_PX: f64 = 14.0;

/// One tag in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TagDetection {
    /// Which tag of the family.
    pub id: u32,
    /// Bits that had to be corrected.
    pub hamming: u32,
    /// Decision margin: mean distance of the bits' levels from their threshold, the smaller mean of white and black bits, grey levels.
    pub margin_levels: f64,
    /// Corners of the black square in the distorted image, px, in the order of [`TagFamily::corner`].
    pub corners_px: [Vector2<f64>; 4],
    /// Covariance `[xx, xy, yy]` of each corner, px^2.
    pub covariance_px2: [[f64; 3]; 4],
    /// Grey level of the ink.
    pub dark_level: f64,
    /// Grey level of the paper.
    pub light_level: f64,
}

impl TagDetection {
    /// One standard deviation of each coordinate of a corner, px: the root of their mean variance. Infinite for other corners than 0 to 3.
    #[must_use]
    pub fn sd_px(&self, corner: usize) -> f64 {
        self.covariance_px2.get(corner).map_or(f64::INFINITY, |[xx, _, yy]| (0.5 * (xx + yy)).sqrt())
    }

    /// Intersection of the diagonals: the image of the tag's centre, px.
    #[must_use]
    pub fn middle_px(&self) -> Vector2<f64> {
        let [a, b, c, d] = self.corners_px;
        let (one, two) = (c - a, d - b);
        let det = one.perp(&two);
        if det == 0.0 { 0.25 * (a + b + c + d) } else { a + one * ((b - a).perp(&two) / det) }
    }
}

/// Prediction of a tag in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedTag {
    /// Which tag.
    pub id: u32,
    /// Its corners, px, in the order of [`TagFamily::corner`].
    pub corners_px: [Vector2<f64>; 4],
    /// Largest error of each corner for which the prediction allows, px.
    pub slack_px: f64,
}

/// Why no tag was found in a frame: the stage at which the best candidate failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Error)]
pub enum TagMiss {
    /// The frame is larger than the finder was made for.
    #[error("frame larger than the finder was made for")]
    WrongSize,
    /// There is no contrast anywhere.
    #[error("no contrast in the frame")]
    NoContrast,
    /// No dark region is large enough.
    #[error("no dark region is large enough for a tag")]
    NoRegion,
    /// No dark region is bounded by four straight sides.
    #[error("no dark region has four straight sides")]
    NoQuad,
    /// No quadrilateral is black along its sides and white around them.
    #[error("no quadrilateral has a black border within a white margin")]
    NoBorder,
    /// Cells within a border are neither black nor white.
    #[error("the cells within a border are neither black nor white")]
    Unclear,
    /// The bits within a border are no code of the family.
    #[error("a border holds no code of the family")]
    NoCode,
    /// A tag was read, but its sides could not be measured.
    #[error("the sides of a tag could not be measured")]
    NoEdges,
}

impl From<TagMiss> for TargetStatus {
    fn from(miss: TagMiss) -> Self {
        match miss {
            TagMiss::WrongSize => Self::WrongSize,
            TagMiss::NoContrast => Self::NoContrast,
            TagMiss::NoRegion => Self::TooFewRegions,
            TagMiss::NoQuad | TagMiss::NoBorder | TagMiss::Unclear | TagMiss::NoCode | TagMiss::NoEdges => {
                Self::NoMatch
            }
        }
    }
}

impl From<NoTag> for TagMiss {
    fn from(no: NoTag) -> Self {
        match no {
            NoTag::Border => Self::NoBorder,
            NoTag::Unclear => Self::Unclear,
            NoTag::NoCode => Self::NoCode,
        }
    }
}

/// Finds the tags of one family. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
pub struct TagFinder {
    family: TagFamily,
    width: usize,
    height: usize,
    book: Codebook,
    local: LocalThreshold,
    runs: Runs,
    components: Components,
    outlines: Outlines,
    points: Vec<WindowPoint>,
    meter: EdgeMeter,
    whole: WholeMeter,
    believed: Believed,
}

impl TagFinder {
    /// A finder for frames of at most this size (px; 16384 each way at most).
    #[must_use]
    pub fn new(family: TagFamily, width_px: usize, height_px: usize) -> Self {
        let (width, height) = (width_px.min(MAX_SIDE), height_px.min(MAX_SIDE));
        let limit = (width * height / PIXELS_OF_RUN).clamp(64, MAX_RUNS);
        Self {
            family,
            width,
            height,
            book: Codebook::new(family),
            local: LocalThreshold::fine(width, height),
            runs: Runs::with_limit(limit),
            components: Components::with_limit(limit),
            outlines: Outlines::with_limit(limit),
            points: Vec::with_capacity(longest_outline(width as u32, height as u32)),
            meter: EdgeMeter::with_size(width, height),
            whole: WholeMeter::new(),
            believed: Believed::Linear,
        }
    }

    /// The same for a camera of unknown response: the growth that the response may have caused is estimated from each tag's own grey levels and
    /// corrected, and the remaining uncertainty is in the covariance of the corners. For a linear camera this costs 4 to 15 % of precision.
    #[must_use]
    pub fn for_unknown_response(mut self) -> Self {
        self.believed = Believed::Bent;
        self
    }

    /// Number of wrong bits that are corrected by default. With it random bits are taken for a code in 2e-5, 1e-4 and 2e-3 of the cases (36h11, 25h9,
    /// 16h5).
    #[must_use]
    pub const fn usual_wrong_bits(family: TagFamily) -> u32 {
        match family {
            TagFamily::Tag36h11 => 2,
            TagFamily::Tag25h9 => 1,
            TagFamily::Tag16h5 => 0,
        }
    }

    /// The family of the tags.
    #[must_use]
    pub fn family(&self) -> TagFamily {
        self.family
    }

    /// Searches the whole frame: fills `found` with the detected tags, ids rising; the same tag may be detected more than once.
    ///
    /// # Errors
    /// [`TagMiss`] when there is none. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<TagDetection>) -> Result<(), TagMiss> {
        found.clear();
        let best = self.search_window(image, &Window::whole(image), found);
        sort(found);
        if found.is_empty() { Err(best) } else { Ok(()) }
    }

    /// Tracks expected tags (ids rising) in windows: fills `found` with those that were detected. Returns whether there is any.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedTag],
        found: &mut Vec<TagDetection>,
    ) -> bool {
        found.clear();
        for tag in expected.iter().take(MAX_TAGS) {
            let [a, b, c, d] = tag.corners_px;
            let (low, high) = (a.inf(&b).inf(&c).inf(&d), a.sup(&b).sup(&c).sup(&d));
            // the margin: a cell, and tiles of the threshold
            let cells = f64::from(self.family.cells_per_side());
            let size = high - low;
            let margin = Vector2::repeat(AROUND_PX + tag.slack_px.max(0.0)) + size / cells;
            let (middle, half) = (0.5 * (low + high), 0.5 * size + margin);
            let window = Window::around(middle.x, middle.y, half.x, half.y, image);
            let before = found.len();
            self.search_window(image, &window, found);
            // of those found in the window the expected one
            let off = |t: &TagDetection| {
                let offs = t.corners_px.iter().zip(&tag.corners_px).map(|(p, q)| (p - q).norm());
                offs.fold(0.0, f64::max)
            };
            let fits = |t: &&TagDetection| t.id == tag.id && off(t) <= tag.slack_px + 1.0;
            let best = found
                .get(before..)
                .unwrap_or(&[])
                .iter()
                .filter(fits)
                .min_by(|a, b| off(a).total_cmp(&off(b)))
                .copied();
            found.truncate(before);
            found.extend(
                best.filter(|best| !found.iter().any(|t| (t.middle_px() - best.middle_px()).norm() < 1.0)),
            );
        }
        sort(found);
        !found.is_empty()
    }

    /// Adds the tags of a window to `found`; returns the stage at which the best other candidate failed.
    fn search_window(
        &mut self,
        image: &ImageView<'_>,
        window: &Window,
        found: &mut Vec<TagDetection>,
    ) -> TagMiss {
        if image.width() > self.width || image.height() > self.height {
            return TagMiss::WrongSize;
        }
        let Some(part) = image.part(window) else { return TagMiss::NoContrast };
        let contrast = |quiet_spread: u8| {
            (CONTRAST_IN_SPREADS * f64::from(quiet_spread)).clamp(MIN_CONTRAST, MAX_CONTRAST) as u8
        };
        if !self.local.set_below(&part, QUIET_TILES, contrast) {
            return TagMiss::NoContrast;
        }
        self.runs.find_below(&part, &mut self.local);
        // Light pixels join by 8 neighbours, dark ones by 4: a thin white margin keeps a tag apart.
        self.components.find(&self.runs, &Window::whole(&part), Connectivity::Four);
        self.outlines.find(&self.runs, Connectivity::Four);
        let outer = self.outlines.as_slice().iter().filter(|outline| !outline.hole);
        let mut best = TagMiss::NoRegion;
        for (region, outline) in self.components.as_slice().iter().zip(outer) {
            let (w, h) = (region.x1 - region.x0, region.y1 - region.y0);
            let small = w.max(h) < MIN_BOX_PX.0 || w.min(h) < MIN_BOX_PX.1 || region.m00 < MIN_PIXELS;
            // a tag has its margin in the image
            if small || region.touches_border {
                continue;
            }
            let most = longest_outline(w, h);
            if !self.outlines.crossings(outline, &self.runs, &part, &self.local, most, &mut self.points) {
                best = best.max(TagMiss::NoQuad);
                continue;
            }
            let Some(quad) = quad::of_outline(&self.points) else {
                best = best.max(TagMiss::NoQuad);
                continue;
            };
            let origin = Vector2::new(window.x0 as f64, window.y0 as f64);
            let quad = quad.map(|p| p + origin);
            match read(image, &quad, &self.book, self.family, self.believed, &mut self.meter, &mut self.whole)
            {
                Ok(tag) if found.len() < MAX_TAGS => found.push(tag),
                Ok(_) => {}
                Err(miss) => best = best.max(miss),
            }
        }
        best
    }
}

/// Decodes a quadrilateral and measures its corners; where it cannot be read the corners are measured first.
fn read(
    image: &ImageView<'_>,
    quad: &Quad,
    book: &Codebook,
    family: TagFamily,
    believed: Believed,
    meter: &mut EdgeMeter,
    whole: &mut WholeMeter,
) -> Result<TagDetection, TagMiss> {
    let (cells, max_wrong) = (family.cells_per_side(), TagFinder::usual_wrong_bits(family));
    let (decoded, corners) = match decode(image, quad, book, family, max_wrong) {
        Ok(decoded) => (
            decoded,
            meter.refine(image, quad, cells, Some(&decoded.inside), believed).ok_or(TagMiss::NoEdges)?,
        ),
        Err(NoTag::Border) => return Err(TagMiss::NoBorder),
        Err(_) => {
            let corners = meter.refine(image, quad, cells, None, believed).ok_or(TagMiss::NoEdges)?;
            let decoded = decode(image, &corners.px, book, family, max_wrong)?;
            (
                decoded,
                meter
                    .refine(image, &corners.px, cells, Some(&decoded.inside), believed)
                    .ok_or(TagMiss::NoEdges)?,
            )
        }
    };
    let corners = best_corners(image, &corners, &decoded, believed, whole);
    Ok(found(&decoded, &corners))
}

/// Corners in the order of the tag, from those of the quadrilateral, which go clockwise from anywhere.
fn found(decoded: &Decoded, corners: &Corners) -> TagDetection {
    let turns = decoded.reading.turns as usize;
    let mut tag = TagDetection {
        id: decoded.reading.id,
        hamming: decoded.reading.hamming,
        margin_levels: decoded.margin_levels,
        corners_px: corners.px,
        covariance_px2: corners.covariance_px2,
        dark_level: decoded.dark_level,
        light_level: decoded.light_level,
    };
    for (k, (px, covariance)) in tag.corners_px.iter_mut().zip(&mut tag.covariance_px2).enumerate() {
        // upper left, upper right, lower right, lower left of the tag are 4 - turns and on; corners count the other way round
        let from = (4 - turns + 3 - k) % 4;
        (*px, *covariance) = (
            corners.px.get(from).copied().unwrap_or_default(),
            corners.covariance_px2.get(from).copied().unwrap_or_default(),
        );
    }
    tag
}

fn sort(found: &mut [TagDetection]) {
    found.sort_unstable_by(|a, b| {
        let key = |t: &TagDetection| t.corners_px[0].x;
        a.id.cmp(&b.id).then(key(a).total_cmp(&key(b)))
    });
}

fn longest_outline(width: u32, height: u32) -> usize {
    (LONGEST_OUTLINE * 2.0 * f64::from(width + height)) as usize + 16
}
