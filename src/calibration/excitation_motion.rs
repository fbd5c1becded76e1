//! An excitation motion of all joints at once, from rest back to the same rest, that shows in the image how each moves.
//!
//! ```text
//! q_i(t) = q_i(0) + a_i (1 - cos W t) / 2 (1 - cos n_i W t) / 2,   W = 2 pi / T,   n_i = 3, 4, ...
//! ```
//! Each joint has a whole number n_i of its own, so that after T all are back where they began, and the motion of one is
//! not taken for that of another. Position, velocity, acceleration and jerk begin and end with zero. A joint moves to one
//! side only, a_i of either sign: a target at the border of the image moves inwards. Over the whole motion, position and
//! velocity are orthogonal: an error of the hand-eye pose, which goes with the first, is not taken for a delay, which goes
//! with the second.

use crate::camera_model::CameraModel;
use crate::features::point_rows;
use crate::messages::{MAX_FEATURES, Measurement};
use crate::motion::MotionLimits;
use crate::robot::{Mount, Robot};
use crate::time::SpanNs;
use nalgebra::{Matrix2, Point3, SMatrix, SVector, Vector2};
use std::f64::consts::TAU;

/// T: how long the motion takes.
const DURATION: SpanNs = SpanNs(8_000_000_000);
/// n of the first joint.
const FIRST_CYCLES: usize = 3;
/// Share of a joint's limits on velocity, acceleration and jerk that the motion may use.
const LIMIT_SHARE: f64 = 0.25;
/// Share of the way to the end of its range that a joint may go.
const RANGE_SHARE: f64 = 0.5;
/// Farthest that a joint goes, whatever the camera sees of it, rad or m.
const FARTHEST: f64 = 0.15;
/// A joint moves the camera by at most this share of its distance from the target.
const DEPTH_SHARE: f64 = 0.15;
/// What the motion of one joint shall be in the image, from end to end, px.
const MOTION_PX: f64 = 40.0;
/// A target at the border of the image still has so much room there, px.
const MIN_ROOM_PX: f64 = 2.0;
/// Points stay away from the border by this share of the target's size: there is more to it than its points.
const BORDER_SHARE: f64 = 0.25;

/// The motion of `N` joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExcitationTrajectory<const N: usize> {
    amplitude: SVector<f64, N>,
    elapsed: SpanNs,
}

impl<const N: usize> ExcitationTrajectory<N> {
    /// A motion that begins in `q` and goes no farther than by `reach`, of either sign; both rad or m. It goes less far
    /// where that keeps a joint well within its range and its limits on velocity, acceleration and jerk.
    #[must_use]
    pub fn new(q: &SVector<f64, N>, reach: &SVector<f64, N>, limits: &MotionLimits<N>) -> Self {
        let amplitude = SVector::from_fn(|i, _| {
            // A sum of cosines of up to n + 1 cycles within +-a/2 of its middle: its k-th derivative is at most
            // a/2 ((n + 1) W)^k (Bernstein).
            let fastest_rad_s = (cycles(i) + 1.0) * base_rad_s();
            let largest = [
                FARTHEST,
                RANGE_SHARE * room(i, q, limits, reach[i]),
                2.0 * LIMIT_SHARE * limits.velocity[i] / fastest_rad_s,
                2.0 * LIMIT_SHARE * limits.acceleration[i] / fastest_rad_s.powi(2),
                2.0 * LIMIT_SHARE * limits.jerk[i] / fastest_rad_s.powi(3),
            ];
            largest.into_iter().fold(reach[i].abs(), f64::min).max(0.0).copysign(reach[i])
        });
        Self { amplitude, elapsed: SpanNs(0) }
    }

    /// The velocity for the next `dt`, rad/s or m/s. Time passes only here: a tick that was missed shifts the motion, but
    /// leaves nothing of it out.
    pub fn advance(&mut self, dt: SpanNs) -> SVector<f64, N> {
        let qd = self.velocity(self.elapsed);
        self.elapsed = SpanNs(self.elapsed.0.saturating_add(dt.0));
        qd
    }

    /// Whether the motion has come to its end.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.elapsed >= DURATION
    }

    /// How far each joint goes from where it began, rad or m.
    #[must_use]
    pub fn amplitude(&self) -> &SVector<f64, N> {
        &self.amplitude
    }

    fn velocity(&self, time: SpanNs) -> SVector<f64, N> {
        if time >= DURATION {
            return SVector::zeros();
        }
        let phase = base_rad_s() * time.as_s();
        let (window, window_slope) = (0.5 * (1.0 - phase.cos()), 0.5 * phase.sin());
        SVector::from_fn(|i, _| {
            let (sin, cos) = (cycles(i) * phase).sin_cos();
            self.amplitude[i] * base_rad_s() * 0.5 * (window_slope * (1.0 - cos) + window * cycles(i) * sin)
        })
    }
}

fn cycles(joint: usize) -> f64 {
    (FIRST_CYCLES + joint) as f64
}

fn base_rad_s() -> f64 {
    TAU / DURATION.as_s()
}

/// The way of a joint to that end of its range that lies in the direction of `sign`.
fn room<const N: usize>(joint: usize, q: &SVector<f64, N>, limits: &MotionLimits<N>, sign: f64) -> f64 {
    if sign < 0.0 { q[joint] - limits.lower[joint] } else { limits.upper[joint] - q[joint] }
}

/// How far each joint may go, rad or m and to which side, so that the target moves clearly and yet stays in the image:
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
        let mut wanted = FARTHEST;
        // A division by zero leaves a joint that moves nothing its farthest.
        wanted = wanted.min(MOTION_PX / image.px_per_joint(i)).min(image.depth_m / image.camera_m(i));
        // The side on which the least of what there is, of the image and of the joint's range, is used up.
        let used = |sign: f64| {
            let range = room(i, q, limits, sign).max(f64::MIN_POSITIVE);
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
