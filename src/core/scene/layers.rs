//! A scene of any shapes at one instant: layers of ink, painted one over the other from the background to the front.
//!
//! ```text
//! outlines in a plane ─► cut at the camera's field of view ─► perspective ─► lens, in pieces that follow the curve ─► edges, from top to bottom
//! row y: of each layer the edges within reach ─► Ink ─► levels
//! ```
//! The simple scenes of dots go another way: `SceneView`.

use super::ink::{BorderSegment, Ink, PixelKernel};
use super::sensor::LEVEL_BITS;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::target::ClosedOutline;
use nalgebra::{Vector2, Vector3};

/// Largest distance of a piece of a border from its curve in the image, px. Derived: it changes a pixel by 0.4 % of the contrast, a level of 255.
const SAG_PX: f64 = 0.004;
/// Nearest depth that is drawn, m, because at depth zero there is no projection; no lens has it in focus.
const NEAR_M: f64 = 1e-6;
/// Most pieces of one side. Chosen by hand, as a bound on time: 512 chords of a quarter of a circle lie within 0.004 px up to a radius of 3400 px.
const MAX_PIECES: f64 = 512.0;

/// Outlines in one plane, painted in one grey level.
#[derive(Debug, Clone)]
pub(super) struct PaintedPlane {
    /// The plane's frame in that of the object.
    pub(super) X_OS: Pose,
    pub(super) loops: Vec<ClosedOutline>,
    pub(super) level: f64,
    /// Seen from both sides; else only from that towards which z_S does not point.
    pub(super) both_sides: bool,
}

/// One sheet in the image.
#[derive(Debug, Clone, Default)]
struct Layer {
    level: f32,
    /// -1 where the sheet is seen from behind, so that its outlines run the other way round.
    sign: f32,
    /// From top to bottom.
    edges: Vec<BorderSegment>,
    /// Edges from here on lie below the present row's reach.
    next: usize,
    /// Edges within reach of the present row.
    active: Vec<BorderSegment>,
}

/// All of it.
#[derive(Debug, Clone)]
pub(super) struct Layers {
    layers: Vec<Layer>,
    count: usize,
    clip: Clip,
    corners: Vec<Vector2<f64>>,
    spare: Vec<Vector2<f64>>,
}

/// The part of a plane that the camera can see, in normalized coordinates.
#[derive(Debug, Clone, Copy)]
struct Clip {
    low: Vector2<f64>,
    high: Vector2<f64>,
    focal_px: f64,
    ideal: bool,
}

impl Clip {
    fn new(camera: &CameraModel, margin_px: f64) -> Self {
        // Chosen by hand: the rays are followed along the whole border, and between two of them a lens is nearly linear.
        const STEPS: u32 = 32;
        let i = camera.intrinsics();
        let (w, h) = (f64::from(i.width_px), f64::from(i.height_px));
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for step in 0..=STEPS {
            let t = f64::from(step) / f64::from(STEPS);
            for (u, v) in [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)] {
                let s = camera.normalized_of(&Vector2::new(u - 0.5, v - 0.5));
                low = low.inf(&s);
                high = high.sup(&s);
            }
        }
        let margin = (margin_px + 4.0) / i.fx_px.min(i.fy_px);
        let ideal = camera.lens().is_ideal();
        let (low, high) = (low.add_scalar(-margin), high.add_scalar(margin));
        Self { low, high, focal_px: i.fx_px.max(i.fy_px), ideal }
    }
}

impl Layers {
    pub(super) fn new(camera: &CameraModel, kernel: &PixelKernel) -> Self {
        let clip = Clip::new(camera, kernel.reach_px());
        Self { layers: Vec::new(), count: 0, clip, corners: Vec::new(), spare: Vec::new() }
    }

    /// Sets the layers up for the pose `X_CO`, from the background to the front.
    pub(super) fn set<'a>(
        &mut self,
        X_CO: &Pose,
        camera: &CameraModel,
        sheets: impl Iterator<Item = &'a PaintedPlane>,
    ) {
        self.count = 0;
        for sheet in sheets {
            let X_CS = X_CO * sheet.X_OS;
            let R = X_CS.rotation.to_rotation_matrix();
            let columns = R.matrix();
            let facing = columns.column(2).dot(&X_CS.translation.vector);
            let front = facing > 0.0;
            // a sheet that is seen edge-on is a line without width, and rounding would determine its normal
            if !facing.is_finite() || facing.abs() < 1e-9 || !(front || sheet.both_sides) {
                continue;
            }
            if self.layers.len() == self.count {
                self.layers.push(Layer::default());
            }
            let Some(layer) = self.layers.get_mut(self.count) else { break };
            self.count += 1;
            let scale = f64::from(1u32 << LEVEL_BITS);
            layer.level = (sheet.level * scale) as f32;
            layer.sign = if front { 1.0 } else { -1.0 };
            layer.edges.clear();
            layer.active.clear();
            layer.next = 0;
            // places in the plane to places before the camera
            let map = [columns.column(0).into(), columns.column(1).into(), X_CS.translation.vector];
            for outline in &sheet.loops {
                self.corners.clear();
                self.corners.extend(outline.iter());
                cut(&mut self.corners, &mut self.spare, &map, &self.clip);
                project(&self.corners, &map, camera, &self.clip, &mut layer.edges);
            }
            layer.edges.sort_unstable_by(|a, b| a.top().total_cmp(&b.top()));
        }
    }

    /// Paints row `y` over `levels`; rows from top to bottom.
    pub(super) fn paint(&mut self, y: usize, kernel: &PixelKernel, ink: &mut Ink, levels: &mut [u16]) {
        let (v, reach) = (y as f64, kernel.reach_px());
        for layer in self.layers.iter_mut().take(self.count) {
            while let Some(edge) = layer.edges.get(layer.next).filter(|edge| edge.top() < v + reach) {
                layer.active.push(*edge);
                layer.next += 1;
            }
            layer.active.retain(|edge| edge.bottom() > v - reach);
            if layer.active.is_empty() {
                continue;
            }
            for edge in &layer.active {
                ink.add(edge, v, kernel);
            }
            ink.paint(layer.sign, layer.level, levels);
        }
    }
}

/// Cuts a polygon to what the camera can see (Sutherland and Hodgman). Parts of it stay joined by sides along the cut, which enclose no
/// area.
fn cut(corners: &mut Vec<Vector2<f64>>, spare: &mut Vec<Vector2<f64>>, map: &[Vector3<f64>; 3], clip: &Clip) {
    let [a, b, p] = map;
    let forms = [
        Vector3::new(a.z, b.z, p.z - NEAR_M),
        row(map, |c| c.x - clip.low.x * c.z),
        row(map, |c| clip.high.x * c.z - c.x),
        row(map, |c| c.y - clip.low.y * c.z),
        row(map, |c| clip.high.y * c.z - c.y),
    ];
    for form in forms {
        let value = |r: &Vector2<f64>| form.x * r.x + form.y * r.y + form.z;
        if corners.iter().all(|corner| value(corner) >= 0.0) {
            continue;
        }
        spare.clear();
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let (start, end) = (value(from), value(to));
            if start >= 0.0 {
                spare.push(*from);
            }
            if (start >= 0.0) != (end >= 0.0) {
                spare.push(from + (to - from) * (start / (start - end)));
            }
        }
        std::mem::swap(corners, spare);
    }
}

/// The form of places in the plane that `of` is of places before the camera.
fn row(map: &[Vector3<f64>; 3], of: impl Fn(&Vector3<f64>) -> f64) -> Vector3<f64> {
    let [a, b, p] = map;
    Vector3::new(of(a), of(b), of(p))
}

/// Adds the sides of a polygon as the camera sees them.
fn project(
    corners: &[Vector2<f64>],
    [a, b, p]: &[Vector3<f64>; 3],
    camera: &CameraModel,
    clip: &Clip,
    edges: &mut Vec<BorderSegment>,
) {
    let normalized = |r: &Vector2<f64>| {
        let c = a * r.x + b * r.y + p;
        Vector2::new(c.x / c.z, c.y / c.z)
    };
    let pixel = |s: &Vector2<f64>| {
        let px = camera.pixel_of(s);
        [px.x, px.y]
    };
    let Some(first) = corners.last() else { return };
    let mut from = normalized(first);
    let mut last = pixel(&from);
    for corner in corners {
        let to = normalized(corner);
        let end = pixel(&to);
        let pieces = if clip.ideal {
            1.0
        } else {
            // the sag of the whole, twice what its middle shows for curves that turn; it falls with the square of the number
            let middle = pixel(&((from + to) * 0.5));
            let sag = (0.5 * (last[0] + end[0]) - middle[0]).hypot(0.5 * (last[1] + end[1]) - middle[1]);
            let long = (to - from).norm() * clip.focal_px / 40.0;
            (2.0 * sag / SAG_PX).sqrt().ceil().max(long.ceil()).clamp(1.0, MAX_PIECES)
        };
        for i in 1..=pieces as u32 {
            let next = if f64::from(i) == pieces {
                end
            } else {
                pixel(&(from + (to - from) * (f64::from(i) / pieces)))
            };
            if (last[0] + last[1] + next[0] + next[1]).is_finite() {
                edges.push(BorderSegment { from: last, to: next });
            }
            last = next;
        }
        from = to;
    }
}

#[cfg(test)]
mod tests;
