//! Which marks of the target are in the image as a whole, not by their centres alone.

use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::target::{Mark, PointKind, Sheet, Target};
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use serde::Serialize;

/// The polygons that stand for dots deviate from them by at most this share of the radius: of a dot of 50 px by a tenth of a pixel, so that
/// whether the dot is in the image is right to that distance.
const SAG: f64 = 0.002;
/// Margin about a dot that must be in the image, px. Derived: the finder refuses a dark region that touches the border, and a dot that just fits
/// does not touch it.
const ROOM_ABOUT_A_DOT_PX: f64 = 0.0;
/// What a corner of a tag or of an outline, and one of a chessboard need about them, px. Chosen by hand for the first, so that the blur of both
/// edges is in the image; derived for the second: the ring by which it is found has a radius of 5 px.
const ROOM_ABOUT_A_CORNER_PX: f64 = 2.0;
const ROOM_ABOUT_A_SADDLE_PX: f64 = 5.0;

/// The largest angle between the line of sight and the normal of a plane at which anything on it is found, rad: 88 degrees. Measured: without noise the finders
/// of all kinds of targets found theirs, 0.12 to 0.4 m before a camera of 640x480 px, up to 78 degrees (dots in a grid) to 87 (tags), and none beyond.
pub(crate) const MAX_SIGHT_ANGLE_RAD: f64 = 88.0 * std::f64::consts::PI / 180.0;

/// How far something is beyond each border of the image, px; zero where it is not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Overhang {
    /// Beyond the left border.
    pub left_px: f64,
    /// Beyond the right border.
    pub right_px: f64,
    /// Beyond the upper border.
    pub above_px: f64,
    /// Beyond the lower border.
    pub below_px: f64,
}

impl Overhang {
    /// Whether all is in the image.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// In words: `12.3 px beyond the left border`.
    #[must_use]
    pub fn describe(&self) -> String {
        let sides = [
            ("left", self.left_px),
            ("right", self.right_px),
            ("upper", self.above_px),
            ("lower", self.below_px),
        ];
        let told = sides.into_iter().filter(|(_, px)| *px > 0.0);
        let told: Vec<_> = told.map(|(side, px)| format!("{px:.1} px beyond the {side} border")).collect();
        told.join(" and ")
    }
}

/// One point of the target in the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointVisibility {
    /// Its number, from 1, as everywhere in a run file.
    pub point: usize,
    /// Where its centre is, px; `None` behind the camera or beyond what the lens shows.
    pub px: Option<[f64; 2]>,
    /// Whether everything about it that the finder needs is in the image.
    pub whole: bool,
    /// How far it lies outside of the image.
    pub outside: Overhang,
    /// It is on a face of a body that is turned away from the camera.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub turned_away: bool,
}

/// The target in the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Visibility {
    /// Its points.
    pub points: Vec<PointVisibility>,
    /// Whether the camera looks at the side with the marks.
    pub front: bool,
    /// The angle at which it sees the target's plane, or that of the face it sees best, rad: [`sight_angle_rad`].
    pub sight_angle_rad: f64,
    /// The plate; `None` where a part of it is behind the camera or beyond what the lens shows.
    pub plate_outside: Option<Overhang>,
    /// Least distance of a mark from the border, px; negative where one is cut.
    pub room_px: f64,
    /// How many points are in the image as a whole.
    pub whole: usize,
    /// How many it takes to find the target.
    pub needed: usize,
    /// Width and height of its points in the image plane where they do not fit into the image however the camera is turned to them, and those
    /// of the image, px.
    pub too_large_px: Option<[[f64; 2]; 2]>,
}

impl Visibility {
    /// The `target` at `X_CO` in the image of `camera`.
    #[must_use]
    pub fn of(target: &Target, camera: &CameraModel, X_CO: &Pose) -> Self {
        let marks = outlines(target);
        let mut room_px = f64::INFINITY;
        let points: Vec<_> = target
            .points()
            .iter()
            .zip(&marks)
            .zip(1..)
            .map(|((point, (outline, needs_px)), number)| {
                let px = camera.project(&(X_CO * point.p_O)).map(Into::into);
                let turned_away = !target.is_turned_to_camera(number - 1, X_CO);
                let extent = OutlineBounds::of(outline, camera, X_CO);
                let (outside, room) = extent.map_or((Overhang::default(), f64::NEG_INFINITY), |e| {
                    (e.overhang(camera), e.room(camera))
                });
                room_px = if turned_away { room_px } else { room_px.min(room) };
                let whole = extent.is_some() && room >= *needs_px && !turned_away;
                PointVisibility { point: number, px, whole, outside, turned_away }
            })
            .collect();
        let sheets = target.sheets();
        let is_seen = |sheet: &&Sheet| !sheet.is_face || is_front(&(X_CO * sheet.X_OS));
        let edges: Vec<_> = sheets.iter().filter(is_seen).flat_map(edge).collect();
        let plate_outside = OutlineBounds::of(&edges, camera, X_CO).map(|extent| extent.overhang(camera));
        let angles = sheets.iter().map(|sheet| sight_angle_rad(&(X_CO * sheet.X_OS)));
        let sight_angle_rad = angles.fold(std::f64::consts::PI, f64::min);
        let front = sheets.iter().any(|sheet| is_front(&(X_CO * sheet.X_OS)));
        let whole = points.iter().filter(|point| point.whole).count();
        let too_large_px = too_large(target, camera, X_CO);
        let needed = target.min_to_find();
        Self { points, front, sight_angle_rad, plate_outside, room_px, whole, needed, too_large_px }
    }

    /// That the target is larger than the image, in words.
    #[must_use]
    pub fn too_large_in_words(&self) -> Option<String> {
        let [[width, height], [of_width, of_height]] = self.too_large_px?;
        Some(format!(
            "the target is {width:.0} x {height:.0} px here, the image {of_width:.0} x {of_height:.0}: make it smaller, or look from farther away"
        ))
    }

    /// Whether the target's plane is seen so edge-on that nothing on it is found.
    #[must_use]
    pub fn is_edge_on(&self) -> bool {
        is_edge_on_at(self.sight_angle_rad)
    }

    /// Whether the finder can find the target: enough whole marks, from the side where they are.
    #[must_use]
    pub fn can_be_found(&self) -> bool {
        self.front && !self.is_edge_on() && self.whole >= self.needed
    }

    /// Whether it can be found, and nothing of what faces the camera is cut.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.can_be_found() && self.points.iter().all(|point| point.whole || point.turned_away)
    }

    /// Why the target cannot be found, in words; `None` where it can.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let deg = self.sight_angle_rad.to_degrees();
        if !self.front {
            return Some(format!(
                "the camera looks at the back of the target: the target's z must point away from the camera (it is {deg:.1} deg off)"
            ));
        }
        if self.is_edge_on() {
            return Some(format!(
                "the camera sees the target edge-on, {deg:.1} deg off its normal: turn it more towards the camera"
            ));
        }
        if self.can_be_found() {
            return None;
        }
        let cut: Vec<_> = self.points.iter().filter(|point| !point.whole && !point.turned_away).collect();
        let told: Vec<_> = cut.iter().take(4).map(|point| point.fault()).collect();
        let more = cut.len().saturating_sub(told.len());
        let more = if more > 0 { format!(", and {more} more") } else { String::new() };
        let seen = if self.needed == self.points.len() {
            String::new()
        } else {
            format!(" ({} points are seen whole, {} are needed)", self.whole, self.needed)
        };
        Some(format!("{}{more}{seen}", told.join(", ")))
    }
}

/// Size of the points' box and of the image, px, where the box is wider or higher than the image though the camera at `X_CO` before the target were turned to its middle:
/// what is beyond the border for no reason but its place far off the axis is not too large.
fn too_large(target: &Target, camera: &CameraModel, X_CO: &Pose) -> Option<[[f64; 2]; 2]> {
    let facing: Vec<_> =
        target.points().iter().enumerate().filter(|(i, _)| target.is_turned_to_camera(*i, X_CO)).collect();
    let in_camera = || facing.iter().map(|(_, point)| X_CO * point.p_O);
    let middle = in_camera().map(|p| p.coords).sum::<Vector3<f64>>();
    let turn = UnitQuaternion::rotation_between(&middle, &Vector3::z())?;
    let seen: Vec<Vector2<f64>> = in_camera().filter_map(|p| camera.project(&(turn * p))).collect();
    let span = |k: usize| {
        let along = || seen.iter().filter_map(move |px| px.get(k).copied());
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    let (size, i) = ([span(0), span(1)], camera.intrinsics());
    let image = [f64::from(i.width_px), f64::from(i.height_px)];
    size.iter().zip(&image).any(|(span, room)| span > room).then_some([size, image])
}

impl PointVisibility {
    /// What is wrong with its place, in words.
    #[must_use]
    pub fn fault(&self) -> String {
        let n = self.point;
        if self.turned_away {
            format!("point {n} is on a face that is turned away")
        } else if self.px.is_none() {
            format!("point {n} lies behind the camera or beyond what its lens shows")
        } else if self.outside.is_none() {
            format!("point {n} touches the border of the image")
        } else {
            format!("point {n} is outside, {}", self.outside.describe())
        }
    }
}

/// Whether a camera sees the side of a plane towards which its z does not point.
#[must_use]
pub fn is_front(X_CS: &Pose) -> bool {
    (X_CS.rotation * Vector3::z()).dot(&X_CS.translation.vector) > 0.0
}

/// The angle between the line of sight to the origin of a plane and the plane's z, rad: 0 from straight ahead, a right angle edge-on, more from behind.
#[must_use]
pub fn sight_angle_rad(X_CS: &Pose) -> f64 {
    (X_CS.rotation * Vector3::z()).angle(&X_CS.translation.vector)
}

/// Whether a camera sees the front of a plane, but so edge-on that nothing on it is found.
#[must_use]
pub fn is_edge_on(X_CS: &Pose) -> bool {
    is_front(X_CS) && is_edge_on_at(sight_angle_rad(X_CS))
}

fn is_edge_on_at(sight_angle_rad: f64) -> bool {
    sight_angle_rad > MAX_SIGHT_ANGLE_RAD
}

/// The edge of a sheet's plate, in O, in pieces that follow a lens.
fn edge(sheet: &Sheet) -> Vec<Point3<f64>> {
    let (low, high) = (sheet.plate.low_m, sheet.plate.high_m);
    let corners = [low, Vector2::new(high.x, low.y), high, Vector2::new(low.x, high.y)];
    let along = |a: Vector2<f64>, b: Vector2<f64>| (0..16).map(move |i| a + (b - a) * (f64::from(i) / 16.0));
    let next = corners.into_iter().cycle().skip(1);
    let places = corners.into_iter().zip(next).flat_map(|(a, b)| along(a, b));
    places.map(|p| sheet.X_OS * in_plane(&p)).collect()
}

fn in_plane(p: &Vector2<f64>) -> Point3<f64> {
    Point3::new(p.x, p.y, 0.0)
}

/// The mark of each point, as an outline in O, m, and the margin that the finder needs about it, px.
fn outlines(target: &Target) -> Vec<(Vec<Point3<f64>>, f64)> {
    if target.point_kind() == PointKind::Dots {
        let outline = |i: usize| {
            let (X_OF, disc) = target.dot(i)?;
            let loops = Mark::Disc(disc).loops(SAG * disc.radius_m);
            let places = loops.iter().flat_map(|outline| outline.iter().map(|p| X_OF * in_plane(p)));
            Some((places.collect(), ROOM_ABOUT_A_DOT_PX))
        };
        return (0..target.points().len()).map_while(outline).collect();
    }
    let needs_px = match target {
        Target::Chessboard(_) => ROOM_ABOUT_A_SADDLE_PX,
        _ => ROOM_ABOUT_A_CORNER_PX,
    };
    target.points().iter().map(|point| (vec![point.p_O], needs_px)).collect()
}

/// Least and greatest column and row of an outline, px.
#[derive(Debug, Clone, Copy)]
struct OutlineBounds {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl OutlineBounds {
    /// `None` where no pixel can see a part of it.
    fn of(outline: &[Point3<f64>], camera: &CameraModel, X_CO: &Pose) -> Option<Self> {
        let mut extent =
            Self { low: Vector2::repeat(f64::INFINITY), high: Vector2::repeat(f64::NEG_INFINITY) };
        for p in outline {
            let px = camera.project(&(X_CO * p))?;
            (extent.low, extent.high) = (extent.low.inf(&px), extent.high.sup(&px));
        }
        Some(extent)
    }

    /// Distances from the left, right, upper and lower border, px; negative beyond.
    fn distances(&self, camera: &CameraModel) -> [f64; 4] {
        let i = camera.intrinsics();
        let (right, bottom) = (f64::from(i.width_px) - 0.5, f64::from(i.height_px) - 0.5);
        [self.low.x + 0.5, right - self.high.x, self.low.y + 0.5, bottom - self.high.y]
    }

    fn room(&self, camera: &CameraModel) -> f64 {
        self.distances(camera).into_iter().fold(f64::INFINITY, f64::min)
    }

    fn overhang(&self, camera: &CameraModel) -> Overhang {
        let [left_px, right_px, above_px, below_px] = self.distances(camera).map(|d| (-d).max(0.0));
        Overhang { left_px, right_px, above_px, below_px }
    }
}
