//! What a step gives, to be looked at: grey levels, numbers as grey levels, or colours over the image.
//!
//! The numbers here are layout, or keep logarithms and divisions from zero and infinity; they were chosen by hand.

use super::outline;
use super::value::{Field, FieldKind, RegionSet, Shapes, StepValue};
use crate::imaging::{ImageView, MomentSums, Plane, Point};
use nalgebra::Vector2;

/// Colours that tell neighbours apart on grey, the colour-blind's set of Okabe and Ito.
const COLOURS: [[u8; 3]; 7] = [
    [230, 159, 0],
    [86, 180, 233],
    [0, 158, 115],
    [240, 228, 66],
    [0, 114, 178],
    [213, 94, 0],
    [204, 121, 167],
];
const OUTER: [u8; 3] = [0, 224, 74];
const HOLE: [u8; 3] = [255, 90, 208];
/// Half the length of a cross, px.
const CROSS_PX: f64 = 4.0;

/// Red, green and blue of each pixel, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColourImage {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// The pixels of a straight line between two places, both included; none where it is longer than 1e5 px.
pub fn segment_pixels(from: Vector2<f64>, to: Vector2<f64>) -> impl Iterator<Item = Vector2<f64>> {
    let length = (to - from).amax();
    let steps = if length < 1e5 { length.ceil().max(1.0) } else { -1.0 };
    (0..=steps as i64).take_while(move |_| steps > 0.0).map(move |i| from + (to - from) * (i as f64 / steps))
}

impl ColourImage {
    /// From a function of column and row.
    pub(super) fn from_fn(width: usize, height: usize, level: impl Fn(usize, usize) -> [u8; 3]) -> Self {
        let rgb = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).flat_map(|(x, y)| level(x, y));
        Self { width: width as u32, height: height as u32, rgb: rgb.collect() }
    }

    /// An image as it is.
    #[must_use]
    pub fn of_image(image: &ImageView<'_>) -> Self {
        let level = |x: usize, y: usize| image.row(y).get(x).copied().unwrap_or(0);
        Self::from_fn(image.width(), image.height(), |x, y| [level(x, y); 3])
    }

    /// The image with every so many columns and rows alone that it is no wider than told.
    #[must_use]
    pub fn thinned(&self, widest: u32) -> Self {
        let step = self.width.div_ceil(widest.max(1)).max(1) as usize;
        let (width, height) = (self.width as usize, self.height as usize);
        Self::from_fn(width.div_ceil(step), height.div_ceil(step), |x, y| {
            let at = 3 * (y * step * width + x * step);
            self.rgb.get(at..at + 3).and_then(|rgb| rgb.try_into().ok()).unwrap_or_default()
        })
    }

    pub(super) fn of(value: &StepValue) -> Self {
        match value {
            StepValue::Image(image) => grey(image),
            StepValue::Gradient(gradient, ..) => {
                // both derivatives side by side, 0 in the middle of the scale
                let (first, second) = (gradient.first(), gradient.second());
                let most = first.as_slice().iter().chain(second.as_slice()).map(|v| v.unsigned_abs()).max();
                let scale = 127.0 / f64::from(most.unwrap_or(0).max(1));
                let w = first.width();
                Self::from_fn(2 * w, first.height(), |x, y| {
                    let v = if x < w { first.get(x, y) } else { second.get(x - w, y) };
                    [(128.0 + scale * f64::from(v.unwrap_or(0))) as u8; 3]
                })
            }
            StepValue::Field(field) => of_field(field),
            StepValue::Binary(binary) => {
                let mut mask = Plane::<u8>::with_size(binary.source.width(), binary.source.height());
                for run in binary.runs.as_slice() {
                    if let Some(part) = mask.row_mut(run.y as usize).get_mut(run.x0 as usize..run.x1 as usize)
                    {
                        part.fill(255);
                    }
                }
                grey(&mask)
            }
            StepValue::Regions(regions) => of_regions(regions),
            StepValue::Contours(set) => {
                let mut drawn = dimmed(&set.source);
                for contour in set.contours.as_slice() {
                    let colour = if contour.hole { HOLE } else { OUTER };
                    for Point { x, y } in set.contours.points(contour) {
                        drawn.dot(Vector2::new(f64::from(*x), f64::from(*y)), colour);
                    }
                }
                drawn
            }
            StepValue::Edges(edges, source) => {
                let mut drawn = Self::from_fn(source.width(), source.height(), |_, _| [0; 3]);
                for p in edges.pixels() {
                    drawn.dot(Vector2::new(f64::from(p.column), f64::from(p.row)), [255; 3]);
                }
                drawn
            }
            StepValue::Chains(chains, source) => {
                let mut drawn = Self::from_fn(source.width(), source.height(), |_, _| [0; 3]);
                for (chain, colour) in chains.as_slice().iter().zip(COLOURS.into_iter().cycle()) {
                    for p in chains.of(chain) {
                        drawn.dot(Vector2::new(f64::from(p.column), f64::from(p.row)), colour);
                    }
                }
                drawn
            }
            StepValue::Shapes(shapes, source) => {
                let mut drawn = dimmed(source);
                match shapes {
                    Shapes::Segments(segments) => {
                        for (s, colour) in segments.iter().zip(COLOURS.into_iter().cycle()) {
                            drawn.line(s.ends_px[0], s.ends_px[1], colour);
                        }
                    }
                    Shapes::Ellipses(ellipses) => {
                        for (e, colour) in ellipses.iter().zip(COLOURS.into_iter().cycle()) {
                            drawn.polygon(&outline::of_ellipse(&e.fit.ellipse), colour);
                            drawn.cross(e.fit.ellipse.centre_px, colour);
                        }
                    }
                    Shapes::Corners(corners) => {
                        corners.iter().for_each(|c| drawn.cross(Vector2::new(c.x, c.y), OUTER));
                    }
                    Shapes::Crossings(corners) => {
                        let at = |v: f32| f64::from(v);
                        corners.iter().for_each(|c| drawn.cross(Vector2::new(at(c.x), at(c.y)), OUTER));
                    }
                }
                drawn
            }
        }
    }

    fn dot(&mut self, px: Vector2<f64>, colour: [u8; 3]) {
        let (x, y) = (px.x.round(), px.y.round());
        if x >= 0.0 && y >= 0.0 && x < f64::from(self.width) && y < f64::from(self.height) {
            let at = 3 * (y as usize * self.width as usize + x as usize);
            if let Some(pixel) = self.rgb.get_mut(at..at + 3) {
                pixel.copy_from_slice(&colour);
            }
        }
    }

    pub(super) fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, colour: [u8; 3]) {
        segment_pixels(from, to).for_each(|px| self.dot(px, colour));
    }

    pub(super) fn cross(&mut self, px: Vector2<f64>, colour: [u8; 3]) {
        for arm in [Vector2::x(), Vector2::y()] {
            self.line(px - arm * CROSS_PX, px + arm * CROSS_PX, colour);
        }
    }

    /// A closed way through places.
    pub(super) fn polygon(&mut self, corners: &[Vector2<f64>], colour: [u8; 3]) {
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            self.line(*from, *to, colour);
        }
    }
}

pub(super) fn grey(image: &Plane<u8>) -> ColourImage {
    ColourImage::from_fn(image.width(), image.height(), |x, y| [image.get(x, y).unwrap_or(0); 3])
}

/// The image at half its brightness, so that colours stand out.
pub(super) fn dimmed(image: &Plane<u8>) -> ColourImage {
    ColourImage::from_fn(image.width(), image.height(), |x, y| [image.get(x, y).unwrap_or(0) / 2; 3])
}

fn of_field(field: &Field) -> ColourImage {
    let values = &field.values;
    let most = values.as_slice().iter().fold(0.0f32, |m, v| m.max(v.abs())).max(1e-9);
    ColourImage::from_fn(values.width(), values.height(), |x, y| {
        let v = values.get(x, y).unwrap_or(0.0);
        match field.what {
            FieldKind::Magnitude => [(255.0 * v / most) as u8; 3],
            FieldKind::Laplacian => [(128.0 + 127.0 * v / most) as u8; 3],
            FieldKind::Direction => wheel(v),
        }
    })
}

/// A colour for an angle, rad: red along x, around by green and blue.
fn wheel(angle: f32) -> [u8; 3] {
    let third = std::f32::consts::TAU / 3.0;
    [0.0, third, -third].map(|at| (127.5 + 127.5 * (angle - at).cos()) as u8)
}

fn of_regions(regions: &RegionSet) -> ColourImage {
    let mut drawn = ColourImage::from_fn(regions.labels.width(), regions.labels.height(), |x, y| {
        let level = regions.source.get(x, y).unwrap_or(0);
        match regions.labels.get(x, y).unwrap_or(0) {
            0 => [level / 3; 3],
            label => COLOURS.get((label as usize - 1) % COLOURS.len()).copied().unwrap_or([255; 3]),
        }
    });
    for moments in regions.sums.iter().filter_map(MomentSums::central) {
        let centre = Vector2::new(moments.x, moments.y);
        for half in outline::half_axes(&moments) {
            drawn.line(centre - half, centre + half, [0; 3]);
        }
        drawn.cross(centre, [255; 3]);
    }
    drawn
}
