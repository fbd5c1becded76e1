//! The synthetic camera's image: every pixel of every row, in place.

use super::backdrop::Backdrop;
use super::bands::PER_ROW;
use super::error::{SceneError, in_range};
use super::look::{Paint, SceneLook};
use super::occluder::Occluder;
use super::profile::{EdgeProfile, LANES};
use super::rays::{Rays, RowOfRays};
use super::scenery::{Bystander, Scenery};
use super::sensor::{LEVEL_BITS, MAX_SIDE_PX, Sensor, SensorModel};
use super::view::SceneView;
use crate::camera_model::{CameraModel, LevelTable, Response};
use crate::geometry::Pose;
use crate::imaging::simd::has_avx2;
use crate::target::Target;
use nalgebra::Vector2;

/// Renders the target, and what lies around it, as the camera sees it: perspective, lens, edges to a hundredth of a pixel's coverage,
/// motion blur, vignetting, noise. The same poses, frame number and seed give the same bytes.
#[derive(Debug, Clone)]
pub struct Renderer {
    camera: CameraModel,
    target: Target,
    occluder: Option<Occluder>,
    look: SceneLook,
    /// The layers of a scene that consists of more than dots on a plain background behind one sheet.
    scenery: Scenery,
    rays: Rays,
    profile: EdgeProfile,
    sensor: Sensor,
    views: Vec<SceneView>,
    memories: Vec<Memory>,
    levels: Vec<u16>,
    sums: Vec<u32>,
    directions: RowOfRays,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
    /// What the camera's response leaves of levels.
    bent: Option<LevelTable>,
}

impl Renderer {
    /// Prepares tables for one camera and scene.
    ///
    /// # Errors
    /// [`SceneError`] when a grey level or a property of the sensor is out of range, or the image exceeds
    /// 4096x4096 px.
    pub fn new(
        camera: CameraModel,
        target: impl Into<Target>,
        look: SceneLook,
        sensor: SensorModel,
    ) -> Result<Self, SceneError> {
        in_range("background", look.background, &SceneLook::LEVEL)?;
        in_range("plate", look.plate, &SceneLook::LEVEL)?;
        in_range("dots", look.dots, &SceneLook::LEVEL)?;
        sensor.check()?;
        let (width_px, height_px) = (camera.intrinsics().width_px, camera.intrinsics().height_px);
        if width_px > MAX_SIDE_PX || height_px > MAX_SIDE_PX {
            return Err(SceneError::ImageSize { width_px, height_px });
        }
        let (width, height) = (width_px as usize, height_px as usize);
        let target = target.into();
        // as the target's dots and plate are
        let (plate, dots) = look.of(&target.plate());
        Ok(Self {
            camera,
            occluder: None,
            scenery: Scenery::new(&camera, &target, &look, sensor.blur_sd_px),
            look: SceneLook { plate, dots, ..look },
            rays: Rays::new(&camera),
            profile: EdgeProfile::new(sensor.blur_sd_px),
            sensor: Sensor::new(&sensor, camera.full_size_px(), camera.region()),
            views: vec![SceneView::new(width, height, target.discs().len())],
            target,
            memories: vec![Memory::default()],
            levels: vec![0; width],
            sums: vec![0; width],
            // the chunks of each band, the last one of which may be cut
            directions: RowOfRays::new(width / LANES + PER_ROW),
            wide: has_avx2(),
            bent: None,
        })
    }

    /// Camera that sees the scene.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// Target in the scene.
    #[must_use]
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// The same renderer, with a backdrop around the plate.
    ///
    /// # Errors
    /// [`SceneError`] when a property of the backdrop is out of range.
    pub fn with_backdrop(mut self, backdrop: Backdrop) -> Result<Self, SceneError> {
        backdrop.check()?;
        self.scenery.set_backdrop(backdrop, &self.target);
        Ok(self)
    }

    /// The same renderer, for a camera with this `response` whose images are corrected as if its response were the one `believed`: levels are
    /// mapped by the first, and back by the inverse of the second.
    #[must_use]
    pub fn with_response(mut self, response: &Response, believed: &Response) -> Self {
        let bent = Response::Linear.to(response).then(&believed.to(&Response::Linear));
        self.bent = (*response != Response::Linear || *believed != Response::Linear).then_some(bent);
        self
    }

    /// The same renderer, with other targets beside the one that is looked for.
    #[must_use]
    pub fn with_bystanders(mut self, bystanders: &[Bystander]) -> Self {
        self.scenery.set_bystanders(bystanders);
        self
    }

    /// The same renderer, with further targets anywhere, each with its pose in the frame of the one that is looked for first. Where one is seen before
    /// that one, it lies under it all the same.
    #[must_use]
    pub fn with_further_targets<'a>(mut self, further: impl IntoIterator<Item = (&'a Target, Pose)>) -> Self {
        self.scenery.set_targets(further);
        self
    }

    /// From now on images show `occluders` in front of the target, each over those before it, or nothing.
    pub fn occlude(&mut self, occluders: impl IntoIterator<Item = Occluder>) {
        let mut occluders = occluders.into_iter();
        self.occluder = occluders.next();
        self.scenery.occlude(self.occluder.iter().copied().chain(occluders));
    }

    /// Fills `out` (`width * height` bytes; rows that do not fit are left out) with the frame `frame_id`: the mean
    /// over the given poses of O in C, one per part of the exposure. Without a pose the scene is empty.
    ///
    /// Allocates only when a call brings more poses than any call before.
    pub fn render(&mut self, X_CO_over_exposure: &[Pose], frame_id: u64, out: &mut [u8]) {
        self.render_moving(X_CO_over_exposure, &[], frame_id, out);
    }

    /// The same with further targets that move: at each pose of the exposure those of all of them in the frame of the first one, one after the other.
    pub fn render_moving(
        &mut self,
        X_CO_over_exposure: &[Pose],
        X_OT: &[Pose],
        frame_id: u64,
        out: &mut [u8],
    ) {
        self.render_light((X_CO_over_exposure, X_OT), frame_id, out);
        if let Some(bent) = &self.bent {
            bent.apply(out);
        }
    }

    /// Renders levels that are proportional to light: those before the camera's response.
    fn render_light(
        &mut self,
        (X_CO_over_exposure, X_OT): (&[Pose], &[Pose]),
        frame_id: u64,
        out: &mut [u8],
    ) {
        let i = self.camera.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        if !self.scenery.is_simple(X_CO_over_exposure) {
            self.scenery.set(X_CO_over_exposure, X_OT, &self.camera);
            self.fill_layers(X_CO_over_exposure.len(), frame_id, out);
            return;
        }
        while self.views.len() < X_CO_over_exposure.len() {
            self.views.push(SceneView::new(width, height, self.target.discs().len()));
            self.memories.push(Memory::default());
        }
        self.memories.fill(Memory::default());
        for (view, X_CO) in self.views.iter_mut().zip(X_CO_over_exposure) {
            view.set(X_CO, &self.camera, &self.target, self.occluder.as_ref(), self.profile.half_px());
        }
        let count = X_CO_over_exposure.len();
        if count == 0 {
            self.levels.fill(fixed(self.look.background));
        }
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.fill_wide(count, frame_id, out);
            }
            return;
        }
        self.fill(count, frame_id, out);
    }

    /// All rows of the mean of the first `count` views of a scene in layers.
    fn fill_layers(&mut self, count: usize, frame_id: u64, out: &mut [u8]) {
        let i = self.camera.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        let mean = Mean::of(count);
        for (y, row) in out.chunks_exact_mut(width).take(height).enumerate() {
            if count < 2 {
                self.scenery.paint(0, y, &self.rays, &mut self.levels);
            } else {
                self.sums.fill(0);
                for view in 0..count {
                    self.scenery.paint(view, y, &self.rays, &mut self.levels);
                    for (sum, &level) in self.sums.iter_mut().zip(&self.levels) {
                        *sum += u32::from(level);
                    }
                }
                for (level, &sum) in self.levels.iter_mut().zip(&self.sums) {
                    *level = mean.rounded(sum);
                }
            }
            self.sensor.expose(frame_id, y, &self.levels, row);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn fill_wide(&mut self, count: usize, frame_id: u64, out: &mut [u8]) {
        self.fill(count, frame_id, out);
    }

    /// All rows of the mean of the first `count` views; the compiler widens it to whatever the caller may use, which changes
    /// no bit of the result.
    #[inline(always)]
    fn fill(&mut self, count: usize, frame_id: u64, out: &mut [u8]) {
        let i = self.camera.intrinsics();
        let (width, height) = (i.width_px as usize, i.height_px as usize);
        let paint = Paint { rays: &self.rays, profile: &self.profile, look: &self.look };
        let mean = Mean::of(count);
        // Between rows without any edge the image does not change: the row of levels is kept.
        let mut fresh = false;
        for (y, row) in out.chunks_exact_mut(width).take(height).enumerate() {
            let views = self.views.get(..count).unwrap_or(&[]);
            let flat = views.iter().all(|view| view.bands().row(y).is_empty());
            if count > 0 && !(flat && fresh) {
                if let ([view], Some(memory)) = (views, self.memories.first_mut()) {
                    fill_row(view, memory, y, &paint, &mut self.directions, &mut self.levels, true);
                } else {
                    self.sums.fill(0);
                    for (view, memory) in views.iter().zip(&mut self.memories) {
                        fill_row(view, memory, y, &paint, &mut self.directions, &mut self.levels, false);
                        for (sum, &level) in self.sums.iter_mut().zip(&self.levels) {
                            *sum += u32::from(level);
                        }
                    }
                    for (level, &sum) in self.levels.iter_mut().zip(&self.sums) {
                        *level = mean.rounded(sum);
                    }
                }
            }
            fresh = flat;
            self.sensor.expose(frame_id, y, &self.levels, row);
        }
    }

    /// True pixel of each of the target's points. NaN for a point that the camera cannot see from any pixel (behind it).
    #[must_use]
    pub fn truth(&self, X_CO: &Pose) -> Vec<Vector2<f64>> {
        let pixel = |p_O| self.camera.project(&(X_CO * p_O)).unwrap_or_else(|| Vector2::repeat(f64::NAN));
        self.target.points().iter().map(|point| pixel(point.p_O)).collect()
    }
}

/// Rounded mean of a number of levels, without a division for every pixel: `x / n` is the upper half of `x (2^32 / n + 1)` as
/// long as `n x < 2^32`, and sums of levels stay far below that.
#[derive(Debug, Clone, Copy)]
struct Mean {
    half: u32,
    reciprocal: u64,
}

impl Mean {
    fn of(count: usize) -> Self {
        let count = count.max(1) as u32;
        Self { half: count / 2, reciprocal: (1 << 32) / u64::from(count) + 1 }
    }

    #[inline(always)]
    fn rounded(self, sum: u32) -> u16 {
        ((u64::from(sum + self.half) * self.reciprocal) >> 32) as u16
    }
}

/// A grey level in the sensor's fixed point.
fn fixed(level: f64) -> u16 {
    (level * f64::from(1 << LEVEL_BITS) + 0.5) as u16
}

/// A flat span `from..to` of a row, and its level.
#[derive(Debug, Clone, Copy, Default)]
struct LevelSpan {
    from: usize,
    to: usize,
    level: u16,
}

/// The flat spans of the row above. A span that overlaps the one above it lies on the same surface: an edge between two
/// neighbouring pixels would have put at least one of them into a band.
#[derive(Debug, Clone, Copy, Default)]
struct Memory {
    row: usize,
    spans: [LevelSpan; PER_ROW + 1],
}

/// Exact levels of one row: flat spans between the bands are filled with the level at their middle. `kept`: the levels still
/// hold the row that the memory is of.
#[inline(always)]
fn fill_row(
    view: &SceneView,
    memory: &mut Memory,
    y: usize,
    paint: &Paint<'_>,
    directions: &mut RowOfRays,
    levels: &mut [u16],
    kept: bool,
) {
    let v = y as f64;
    let follows = memory.row + 1 == y;
    memory.row = y;
    let bands = view.bands().row(y);
    let ends = bands.iter().map(|band| (band.first as usize, band.last as usize + 1, band.mask));
    let width = levels.len();
    if !paint.rays.ideal() {
        directions.clear();
        for band in bands {
            SceneView::add_middles(band.first as usize, band.last as usize + 1, directions);
        }
        paint.rays.at_each(directions, v);
    }
    let mut directions = directions.iter();
    let mut from = 0;
    for ((to, next, mask), above) in ends.chain(std::iter::once((width, width, 0))).zip(&mut memory.spans) {
        if let Some(span) = levels.get_mut(from..to).filter(|span| !span.is_empty()) {
            let level = if follows && from.max(above.from) < to.min(above.to) {
                above.level
            } else {
                fixed(view.flat_level(0.5 * (from + to - 1) as f64, v, paint))
            };
            // Where the row above is still in the buffer, the pixels below its span of the same surface have their level already.
            let (start, end) = if kept && follows && above.level == level {
                (above.from.clamp(from, to) - from, above.to.clamp(from, to) - from)
            } else {
                (0, 0)
            };
            if let Some((left, rest)) = span.split_at_mut_checked(start) {
                left.fill(level);
                if let Some(right) = rest.get_mut(end.saturating_sub(start)..) {
                    right.fill(level);
                }
            }
            *above = LevelSpan { from, to, level };
        } else {
            *above = LevelSpan::default();
        }
        if let Some(span) = levels.get_mut(to..next) {
            view.edge_levels(to, v, mask, paint, &mut directions, span);
        }
        from = next;
    }
    // forget the spans of the row above that have no counterpart in this row
    if let Some(rest) = memory.spans.get_mut(bands.len() + 1..) {
        rest.fill(LevelSpan::default());
    }
}

#[cfg(test)]
mod tests;
