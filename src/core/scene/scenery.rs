//! Everything in a scene of layers, and its images at the instants of one exposure.

use super::backdrop::{Backdrop, Texture, rectangle};
use super::ink::{Ink, PixelKernel};
use super::layers::{Layers, PaintedPlane};
use super::look::SceneLook;
use super::occluder::Occluder;
use super::rays::Rays;
use super::sensor::LEVEL_BITS;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::target::{ClosedOutline, Disc, Mark, Sheet, Target};
use nalgebra::{Point3, Translation3, Vector2, Vector3};

/// The polygon that stands for a curved outline deviates from it by at most this share of its size. Derived: of an outline 100 px large that is a
/// hundredth of a pixel, as exact as other edges are rendered.
const SAG: f64 = 1e-4;

/// Least radius of curvature of a dot's rim, px, of which `SceneView` knows the coverage: within a pixel it takes the rim as a parabola.
const MIN_CURVE_PX: f64 = 0.5;

/// A target that is not looked for, beside the one that is. Where the two overlap, it lies under the other one.
#[derive(Debug, Clone, PartialEq)]
pub struct Bystander {
    /// What it is.
    pub target: Target,
    /// Its origin in the plane of the target that is looked for, m.
    pub position_m: Vector2<f64>,
    /// From x_o towards y_o of that one to its own x, rad.
    pub turn_rad: f64,
}

/// The scene in layers.
#[derive(Debug, Clone)]
pub(super) struct Scenery {
    /// Whether it consists of dots on a plain background and at most one sheet in front of them, which `SceneView` draws.
    dots: bool,
    discs: Box<[Disc]>,
    simple_front: bool,
    look: SceneLook,
    backdrop: Backdrop,
    clutter: Vec<PaintedPlane>,
    bystanders: Vec<PaintedPlane>,
    /// Sheets of further targets, each with the number of its target, from 0, and its own pose in that one's frame.
    further: Vec<(usize, Pose, PaintedPlane)>,
    target: Vec<PaintedPlane>,
    occluders: Vec<PaintedPlane>,
    kernel: PixelKernel,
    ink: Ink,
    views: Vec<Layers>,
    /// The mottled surface in the middle of the exposure: its soft spots are not blurred by motion.
    texture: Texture,
    surface: Vec<u16>,
    camera: CameraModel,
    /// Instants of the present exposure.
    count: usize,
}

impl Scenery {
    pub(super) fn new(camera: &CameraModel, target: &Target, look: &SceneLook, blur_sd_px: f64) -> Self {
        let kernel = PixelKernel::new(blur_sd_px);
        Self {
            dots: !target.discs().is_empty(),
            discs: target.discs().into(),
            simple_front: true,
            look: *look,
            backdrop: Backdrop::default(),
            clutter: Vec::new(),
            bystanders: Vec::new(),
            further: Vec::new(),
            target: sheets(target, Pose::identity(), look),
            occluders: Vec::new(),
            ink: Ink::new(camera.intrinsics().width_px as usize, &kernel),
            views: vec![Layers::new(camera, &kernel)],
            texture: Texture::new(),
            surface: vec![0; camera.intrinsics().width_px as usize],
            kernel,
            camera: *camera,
            count: 0,
        }
    }

    pub(super) fn set_backdrop(&mut self, backdrop: Backdrop, target: &Target) {
        self.clutter = backdrop.sheets(&target.plate(), self.look.dots, self.look.plate);
        self.backdrop = backdrop;
    }

    pub(super) fn set_bystanders(&mut self, bystanders: &[Bystander]) {
        let of = |b: &Bystander| {
            let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), b.turn_rad);
            let X_OS = Pose::from_parts(Translation3::new(b.position_m.x, b.position_m.y, 0.0), turn);
            sheets(&b.target, X_OS, &self.look)
        };
        self.bystanders = bystanders.iter().flat_map(of).collect();
    }

    /// Sets further targets, each with its pose in the frame of the one that is looked for first.
    pub(super) fn set_targets<'a>(&mut self, further: impl IntoIterator<Item = (&'a Target, Pose)>) {
        let drawn = further.into_iter().enumerate().flat_map(|(number, (target, X_OT))| {
            let sheets = sheets(target, Pose::identity(), &self.look);
            sheets
                .into_iter()
                .map(move |sheet| (number, sheet.X_OS, PaintedPlane { X_OS: X_OT * sheet.X_OS, ..sheet }))
        });
        self.further = drawn.collect();
    }

    /// Places the further targets at `X_OT`, in the order in which they were set; those without a pose stay.
    fn place(&mut self, X_OT: &[Pose]) {
        for (number, X_TS, sheet) in &mut self.further {
            if let Some(X_OT) = X_OT.get(*number) {
                sheet.X_OS = X_OT * *X_TS;
            }
        }
    }

    pub(super) fn occlude(&mut self, occluders: impl Iterator<Item = Occluder>) {
        self.occluders.clear();
        for occluder in occluders {
            let (low, high) = occluder.corners_m();
            let X_OS = Pose::translation(0.0, 0.0, -occluder.height_m);
            let loops = vec![rectangle(&low, &high)];
            self.occluders.push(PaintedPlane { X_OS, loops, level: occluder.level, both_sides: true });
        }
        self.simple_front = self.occluders.len() < 2;
    }

    /// Whether `SceneView` can draw it at these poses. It cannot where a dot is seen so obliquely, or from so far, that its rim bends within a pixel.
    pub(super) fn is_simple(&self, X_CO_over_exposure: &[Pose]) -> bool {
        self.is_made_of_dots() && !X_CO_over_exposure.iter().any(|X_CO| self.has_thin_dots(X_CO))
    }

    /// An ellipse of half axes `a`, `b` is most curved at the ends of the longer one, with the radius `b^2 / a`. Seen under the angle of the
    /// cosine `c` to the normal, a disc has `b = a c`.
    fn has_thin_dots(&self, X_CO: &Pose) -> bool {
        let i = self.camera.intrinsics();
        let f_px = i.fx_px.min(i.fy_px);
        let normal = X_CO.rotation * Vector3::z();
        let thin = |disc: &Disc| {
            let c = (X_CO * Point3::new(disc.centre_m.x, disc.centre_m.y, 0.0)).coords;
            let slant = normal.dot(&c);
            // behind the camera there is nothing to see
            c.z > 0.0 && disc.radius_m * f_px * slant * slant < MIN_CURVE_PX * c.z * c.norm_squared()
        };
        self.discs.iter().any(thin)
    }

    fn is_made_of_dots(&self) -> bool {
        self.dots
            && self.simple_front
            && self.bystanders.is_empty()
            && self.further.is_empty()
            && self.clutter.is_empty()
            && self.backdrop.texture_levels == 0.0
    }

    /// Sets the images up for the poses of an exposure; `X_OT` are those of the further targets at each of them, one after the other, or none where they rest.
    pub(super) fn set(&mut self, X_CO_over_exposure: &[Pose], X_OT: &[Pose], camera: &CameraModel) {
        self.count = X_CO_over_exposure.len();
        while self.views.len() < self.count {
            self.views.push(Layers::new(&self.camera, &self.kernel));
        }
        let each = X_OT.len() / self.count.max(1);
        for (i, X_CO) in X_CO_over_exposure.iter().enumerate() {
            self.place(X_OT.get(i * each..(i + 1) * each).unwrap_or_default());
            let further = self.further.iter().map(|(_, _, sheet)| sheet);
            let below = self.clutter.iter().chain(&self.bystanders).chain(further);
            let Some(layers) = self.views.get_mut(i) else { break };
            layers.set(X_CO, camera, below.chain(&self.target).chain(&self.occluders));
        }
        if let Some(X_CO) = X_CO_over_exposure.get(self.count / 2) {
            self.texture.set(X_CO);
        }
    }

    /// Exact levels of row `y` at instant `view`; rows of one instant from top to bottom.
    pub(super) fn paint(&mut self, view: usize, y: usize, rays: &Rays, levels: &mut [u16]) {
        let plain = (self.look.background * f64::from(1u32 << LEVEL_BITS) + 0.5) as u16;
        let Some(layers) = self.views.get_mut(..self.count).and_then(|v| v.get_mut(view)) else {
            levels.fill(plain);
            return;
        };
        if self.backdrop.texture_levels > 0.0 {
            if view == 0 {
                self.texture.fill(&self.backdrop, self.look.background, rays, y as f64, &mut self.surface);
            }
            levels.iter_mut().zip(&self.surface).for_each(|(level, surface)| *level = *surface);
        } else {
            levels.fill(plain);
        }
        layers.paint(y, &self.kernel, &mut self.ink, levels);
    }
}

/// A target's flat parts, each with its marks. Faces of a body do not hide one another as long as it is convex.
fn sheets(target: &Target, X_OT: Pose, look: &SceneLook) -> Vec<PaintedPlane> {
    let painted = |sheet: Sheet| {
        let Sheet { X_OS, plate, marks, is_face } = sheet;
        let X_OS = X_OT * X_OS;
        let (plate_level, level) = look.of(&plate);
        let size_m = (plate.high_m - plate.low_m).amax();
        let loops = |mark: &Mark| -> Vec<ClosedOutline> {
            let radius_m = match mark {
                Mark::Disc(disc) => disc.radius_m,
                _ => size_m,
            };
            mark.loops(SAG * radius_m).into_vec()
        };
        let ground = vec![rectangle(&plate.low_m, &plate.high_m)];
        let drawn = marks.iter().flat_map(loops).collect();
        [
            PaintedPlane { X_OS, loops: ground, level: plate_level, both_sides: !is_face },
            PaintedPlane { X_OS, loops: drawn, level, both_sides: false },
        ]
    };
    target.sheets().into_iter().flat_map(painted).collect()
}
