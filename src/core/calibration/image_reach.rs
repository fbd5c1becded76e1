//! How far each joint may go in an excitation motion, so that the target moves clearly in the image and yet stays in it.

use crate::camera_model::CameraModel;
use crate::features::point_rows;
use crate::messages::{MAX_FEATURES, Measurement};
use crate::motion::{MAX_EXCITATION, MotionLimits};
use crate::robot::{Mount, Robot};
use nalgebra::{Matrix2, Point3, SMatrix, SVector, Vector2};

/// Largest motion of the camera by one joint, as a share of its distance from the target. Chosen by hand: the linear prediction of the image must hold.
const DEPTH_SHARE: f64 = 0.15;
/// Motion of the image by one joint, from end to end, px. Chosen by hand: hundreds of times the noise of a point, and a small part of an image.
const MOTION_PX: f64 = 40.0;
/// Smallest room that is assumed for a target at the border of the image, px.
const MIN_ROOM_PX: f64 = 2.0;
/// Distance that points keep from the border, as a share of the target's size, because the target is larger than its points. Chosen
/// by hand: outer squares and margin of a 9x6 board take 0.16 of it; half cuts such a target, twice leaves less room for the motion.
const BORDER_SHARE: f64 = 0.25;

/// How far each joint may move, rad or m with its sign, so that the target moves clearly and stays in the image:
/// about 40 px for each joint, less where the target has no room for that. `None` where the measurement does not tell the
/// target's pose.
///
/// `points`: the target's, in O. To first order in the way of the joints, all at their farthest together.
#[must_use]
pub fn image_reach<const N: usize>(
    robot: &Robot<N>,
    mount: &Mount,
    camera: &CameraModel,
    points: &[Point3<f64>],
    limits: &MotionLimits<N>,
    q: &SVector<f64, N>,
    seen: &Measurement,
) -> Option<SVector<f64, N>> {
    let image = PointMotions::of(robot, mount, camera, points, q, seen)?;
    let mut reach = SVector::<f64, N>::zeros();
    for (i, reach) in reach.iter_mut().enumerate() {
        let mut wanted = MAX_EXCITATION;
        // A division by zero leaves a joint that moves nothing its farthest.
        wanted = wanted.min(MOTION_PX / image.px_per_joint(i)).min(image.depth_m / image.camera_m(i));
        // The side on which the least of what there is, of the image and of the joint's range, is used up.
        let used = |sign: f64| {
            let range = limits.room(i, q, sign).max(f64::MIN_POSITIVE);
            image.used(|k| if k == i { sign * wanted } else { 0.0 }).max(wanted / range)
        };
        *reach = if used(-1.0) < used(1.0) { -wanted } else { wanted };
    }
    let used = image.used(|i| reach[i]);
    Some(reach / used.max(1.0))
}

/// The target in the image, and how the joints move it there.
struct PointMotions<const N: usize> {
    /// Each point's motion with the joints, px/rad or px/m.
    rows: [SMatrix<f64, 2, N>; MAX_FEATURES],
    /// Each point's room to the right and bottom, and to the left and top, px.
    rooms: [[Vector2<f64>; 2]; MAX_FEATURES],
    count: usize,
    /// The share of the distance to the nearest point that the camera may move.
    depth_m: f64,
    J_C: SMatrix<f64, 6, N>,
}

impl<const N: usize> PointMotions<N> {
    fn of(
        robot: &Robot<N>,
        mount: &Mount,
        camera: &CameraModel,
        points: &[Point3<f64>],
        q: &SVector<f64, N>,
        seen: &Measurement,
    ) -> Option<Self> {
        let X_CO = seen.pose()?;
        let J_C = *mount.camera(robot, q).1.matrix();
        let i = camera.intrinsics();
        let end = Vector2::new(f64::from(i.width_px) - 1.0, f64::from(i.height_px) - 1.0);
        let places = || seen.features().iter().map(|f| Vector2::new(f.u_px, f.v_px));
        let first = places().next()?;
        let (low, high) = places().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        let border = Vector2::repeat(BORDER_SHARE * (high - low).norm());
        let mut image = Self {
            rows: [SMatrix::zeros(); MAX_FEATURES],
            rooms: [[Vector2::zeros(); 2]; MAX_FEATURES],
            count: 0,
            depth_m: f64::INFINITY,
            J_C,
        };
        let known = seen.features().iter().zip(points);
        for ((feature, p_O), (rows, rooms)) in known.zip(image.rows.iter_mut().zip(&mut image.rooms)) {
            let (s, z_m) = (Vector2::new(feature.x, feature.y), (X_CO * p_O).z);
            if !(z_m > 0.0) {
                return None;
            }
            let lens: Matrix2<f64> = camera.pixel_jacobian(&s);
            *rows = lens * point_rows(&s, z_m) * J_C;
            let px = Vector2::new(feature.u_px, feature.v_px);
            let least = Vector2::repeat(MIN_ROOM_PX);
            *rooms = [(end - px - border).sup(&least), (px - border).sup(&least)];
            image.depth_m = image.depth_m.min(DEPTH_SHARE * z_m);
            image.count += 1;
        }
        Some(image)
    }

    /// The motion of the fastest point, px/rad or px/m.
    fn px_per_joint(&self, joint: usize) -> f64 {
        self.rows.iter().map(|rows| rows.column(joint).norm()).fold(0.0, f64::max)
    }

    /// The camera's motion, m/rad or m/m.
    fn camera_m(&self, joint: usize) -> f64 {
        self.J_C.fixed_view::<3, 1>(0, joint).norm()
    }

    /// The largest share of a point's room to a border that is used up when each joint goes as far as `reach` says, and
    /// those that lead away from the border stand still.
    fn used(&self, reach: impl Fn(usize) -> f64) -> f64 {
        let mut most: f64 = 0.0;
        for (rows, rooms) in self.rows.iter().zip(&self.rooms).take(self.count) {
            for (room, sign) in rooms.iter().zip([1.0, -1.0]) {
                let mut way = Vector2::zeros();
                for (i, column) in rows.column_iter().enumerate() {
                    way += (column * (sign * reach(i))).sup(&Vector2::zeros());
                }
                most = most.max(way.component_div(room).max());
            }
        }
        most
    }
}

#[cfg(test)]
mod tests;
