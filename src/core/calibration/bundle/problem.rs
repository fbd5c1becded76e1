//! What is known, what is asked for, and what is believed of it.

use super::optics::{Freedom, Optics, PointImage};
use super::rows::{Room, SharedColumns};
use crate::geometry::{Pose, skew};
use nalgebra::{Matrix2, Matrix3, Translation3, UnitQuaternion, Vector2, Vector3};

/// A corner of the board, seen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BundlePoint {
    /// Place on the flat board, from its middle, m.
    pub(crate) r: Vector3<f64>,
    /// What a unit of each coefficient of the warp lifts it by.
    pub(crate) lift: Vector2<f64>,
    /// Where it is seen, px.
    pub(crate) px: Vector2<f64>,
    /// `W` with `W^T W = C^-1`, 1/px.
    pub(crate) whitening: Matrix2<f64>,
}

/// The board in one image of one camera.
#[derive(Debug, Clone)]
pub(crate) struct BoardObservation {
    /// Which camera.
    pub(crate) camera: usize,
    /// Corners.
    pub(crate) points: Vec<BundlePoint>,
}

/// What is known, and which parameters are free.
#[derive(Debug, Clone)]
pub(crate) struct BundleProblem {
    /// Of each camera.
    pub(crate) freedom: Vec<Freedom>,
    /// The board's two coefficients of warp are estimated.
    pub(crate) warp: bool,
    /// Measurements at each instant.
    pub(crate) views: Vec<Vec<BoardObservation>>,
}

/// An estimate of everything.
#[derive(Debug, Clone)]
pub(crate) struct BundleState {
    /// Of each camera.
    pub(crate) optics: Vec<Optics>,
    /// Pose of camera 0 in each further camera.
    pub(crate) X_j0: Vec<Pose>,
    /// Height of the board's middle over its edges, from the shape along x and along y, m.
    pub(crate) warp_m: Vector2<f64>,
    /// Pose of the board's middle in camera 0, of each view.
    pub(crate) poses: Vec<Pose>,
}

/// A rigid body turned about its origin and shifted: `p -> exp(w) R r + t + v`, twist `[v; w]`.
pub(crate) fn moved(X: &Pose, twist: &[f64]) -> Pose {
    let of = |i: usize| twist.get(i).copied().unwrap_or(0.0);
    let (v, w) = (Vector3::new(of(0), of(1), of(2)), Vector3::new(of(3), of(4), of(5)));
    let rotation = UnitQuaternion::from_scaled_axis(w) * X.rotation;
    Pose::from_parts(Translation3::from(X.translation.vector + v), UnitQuaternion::new_normalize(*rotation))
}

/// A corner in camera j, and what moves it there.
struct CornerPlace {
    p_j: Vector3<f64>,
    /// R_jO r: from the board's middle to the point.
    arm: Vector3<f64>,
    /// R_j0 p_0: from the origin of camera 0 to the point.
    from_0: Vector3<f64>,
    /// Third column of R_jO.
    normal: Vector3<f64>,
}

impl BundleProblem {
    /// Number of shared unknowns.
    pub(crate) fn shared(&self) -> usize {
        let optics: usize = self.freedom.iter().map(Freedom::count).sum();
        optics + 6 * self.freedom.len().saturating_sub(1) + self.warp_count()
    }

    fn warp_count(&self) -> usize {
        if self.warp { 2 } else { 0 }
    }

    /// Where the parameters of a camera begin among the shared ones.
    pub(crate) fn optics_from(&self, camera: usize) -> usize {
        self.freedom.iter().take(camera).map(Freedom::count).sum()
    }

    /// Where the twist of X_j0 begins, j >= 1.
    pub(crate) fn pose_from(&self, camera: usize) -> usize {
        self.optics_from(self.freedom.len()) + 6 * camera.saturating_sub(1)
    }

    /// Where the warp begins.
    pub(crate) fn warp_from(&self) -> usize {
        self.pose_from(self.freedom.len())
    }

    /// Corners of all views.
    pub(crate) fn points(&self) -> usize {
        self.views.iter().flatten().map(|s| s.points.len()).sum()
    }

    /// Equations less unknowns.
    pub(crate) fn degrees_of_freedom(&self) -> usize {
        (2 * self.points()).saturating_sub(self.shared() + 6 * self.views.len())
    }

    /// Which shared unknowns a corner seen by this camera depends on.
    pub(super) fn border(&self, camera: usize) -> SharedColumns {
        let optics = self.optics_from(camera);
        let own = self.freedom.get(camera).map_or(0, Freedom::count);
        let mut columns: Vec<usize> = (optics..optics + own).collect();
        if camera > 0 {
            let from = self.pose_from(camera);
            columns.extend(from..from + 6);
        }
        if self.warp {
            let from = self.warp_from();
            columns.extend(from..from + 2);
        }
        SharedColumns { columns }
    }

    /// The state after a step of the shared unknowns and of each pose.
    pub(crate) fn moved(&self, state: &BundleState, shared: &[f64], poses: &[[f64; 6]]) -> BundleState {
        let part = |from: usize| shared.get(from..).unwrap_or_default();
        let optics = (state.optics.iter().zip(&self.freedom).enumerate())
            .map(|(j, (optics, freedom))| freedom.moved(optics, part(self.optics_from(j))))
            .collect();
        let X_j0 = (1..).zip(&state.X_j0).map(|(j, X)| moved(X, part(self.pose_from(j)))).collect();
        let mut warp_m = state.warp_m;
        if let (true, [a, b, ..]) = (self.warp, part(self.warp_from())) {
            warp_m += Vector2::new(*a, *b);
        }
        let poses = state.poses.iter().zip(poses).map(|(X, twist)| moved(X, twist)).collect();
        BundleState { optics, X_j0, warp_m, poses }
    }
}

/// A camera and the board in one view, as matrices.
pub(super) struct ViewTransforms {
    camera: usize,
    R_0O: Matrix3<f64>,
    p_0O: Vector3<f64>,
    R_j0: Matrix3<f64>,
    p_j0: Vector3<f64>,
}

impl BundleState {
    /// Of a camera and a view.
    pub(super) fn frames(&self, camera: usize, view: usize) -> Option<ViewTransforms> {
        let matrices = |X: &Pose| (X.rotation.to_rotation_matrix().into_inner(), X.translation.vector);
        let (R_0O, p_0O) = matrices(self.poses.get(view)?);
        let (R_j0, p_j0) = match camera.checked_sub(1) {
            Some(j) => matrices(self.X_j0.get(j)?),
            None => (Matrix3::identity(), Vector3::zeros()),
        };
        Some(ViewTransforms { camera, R_0O, p_0O, R_j0, p_j0 })
    }

    #[inline]
    fn place(&self, frames: &ViewTransforms, point: &BundlePoint) -> CornerPlace {
        let r = point.r + Vector3::z() * self.warp_m.dot(&point.lift);
        let arm = frames.R_0O * r;
        let p_0 = arm + frames.p_0O;
        let normal: Vector3<f64> = frames.R_0O.column(2).into();
        if frames.camera == 0 {
            return CornerPlace { p_j: p_0, arm, from_0: p_0, normal };
        }
        let from_0 = frames.R_j0 * p_0;
        CornerPlace {
            p_j: from_0 + frames.p_j0,
            arm: frames.R_j0 * arm,
            from_0,
            normal: frames.R_j0 * normal,
        }
    }

    /// Where a camera sees a corner of view `view`.
    pub(crate) fn image(&self, camera: usize, view: usize, point: &BundlePoint) -> Option<PointImage> {
        let frames = self.frames(camera, view)?;
        PointImage::new(self.optics.get(camera)?, &self.place(&frames, point).p_j)
    }

    /// Writes the two whitened rows of a corner: derivatives by the border's unknowns, by the pose's twist, and the error.
    /// Returns the squared size of the error; `None` behind the camera.
    #[inline]
    pub(super) fn rows<const M: usize>(
        &self,
        problem: &BundleProblem,
        frames: &ViewTransforms,
        point: &BundlePoint,
        rows: &mut [[f64; M]; 2],
    ) -> Option<f64> {
        let optics = self.optics.get(frames.camera)?;
        let freedom = problem.freedom.get(frames.camera)?;
        let place = self.place(frames, point);
        let image = PointImage::new(optics, &place.p_j)?;
        let W = &point.whitening;
        let mut room = Room::new(rows, W);
        for column in freedom.reduced(optics, &image.by_optics) {
            room.push(&column);
        }
        let J = &image.by_point;
        if frames.camera > 0 {
            // X_j0 moves by [v; w]: dp = v + w x (R_j0 p_0)
            room.push_three(J);
            room.push_three(&(J * -skew(&place.from_0)));
        }
        if problem.warp {
            let along = J * place.normal;
            room.push(&(along * point.lift.x));
            room.push(&(along * point.lift.y));
        }
        // the board moves by [v; w] in camera 0: dp = R_j0 (v + w x (R_0O r))
        let (along, about) = (*J, J * -skew(&place.arm));
        let (along, about) =
            if frames.camera > 0 { (along * frames.R_j0, about * frames.R_j0) } else { (along, about) };
        room.push_three(&along);
        room.push_three(&about);
        let error = point.px - image.px;
        room.push(&error);
        Some((W * error).norm_squared())
    }
}
