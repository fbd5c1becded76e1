//! Simulated truth for the tests: an arm, a board, a camera with a lens, and what each measures.

use super::{BoardCorner, CameraMount, HandEyeView, LoopSample, RobotSd};
use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::geometry::{Pose, Twist, integrate_body_twist};
use crate::linalg::Random;
use nalgebra::{Point3, SVector, Vector2, Vector3};
use std::sync::LazyLock;

pub(super) fn pose(a: [f64; 6]) -> Pose {
    Pose::new(Vector3::new(a[0], a[1], a[2]), Vector3::new(a[3], a[4], a[5]))
}

/// A camera with a lens; checked once.
pub(super) fn camera() -> CameraModel {
    static CAMERA: LazyLock<CameraModel> = LazyLock::new(new_camera);
    *CAMERA
}

fn new_camera() -> CameraModel {
    let intrinsics =
        Intrinsics { fx_px: 610.0, fy_px: 605.0, cx_px: 322.0, cy_px: 239.0, width_px: 640, height_px: 480 };
    let lens = Distortion { k1: -0.1, k2: 0.02, p1: 5e-4, p2: -3e-4, k3: 0.0 };
    CameraModel::new(intrinsics, lens).unwrap()
}

/// What is true, and how well it is measured.
#[derive(Debug, Clone)]
pub(super) struct SimulatedCell {
    pub place: CameraMount,
    pub X_MC: Pose,
    pub X_WO: Pose,
    pub corner_sd_px: f64,
    pub robot: RobotSd,
    /// The flange is where the robot says so much before the image, s.
    pub offset_s: f64,
}

impl SimulatedCell {
    pub(super) fn new(place: CameraMount, random: &mut Random) -> Self {
        let mut turn = |size: f64| Vector3::from_fn(|_, _| random.between(-size, size));
        let X_MC = match place {
            CameraMount::EyeInHand => Pose::new(turn(0.08), turn(0.6)),
            // about a metre before the arm, looking back at it
            CameraMount::EyeToHand => {
                Pose::new(Vector3::new(1.2, 0.1, 0.4) + turn(0.1), Vector3::new(0.3, -1.9, 0.2) + turn(0.3))
            }
        };
        let X_WO = match place {
            CameraMount::EyeInHand => Pose::new(Vector3::new(0.5, 0.1, 0.0) + turn(0.2), turn(1.5)),
            CameraMount::EyeToHand => Pose::new(turn(0.1), turn(1.0)),
        };
        let robot = RobotSd { rotation_rad: 0.0, translation_m: 0.0 };
        Self { place, X_MC, X_WO, corner_sd_px: 0.0, robot, offset_s: 0.0 }
    }

    /// The flange that has the board at `X_CO`.
    pub(super) fn flange(&self, X_CO: &Pose) -> Pose {
        // X_WM X_MC X_CO = X_WO
        let X_WM = self.X_WO * X_CO.inverse() * self.X_MC.inverse();
        self.place.X_WM(&X_WM) // inverts for the one, nothing for the other: its own inverse
    }

    /// What is seen and said of the board at `X_CO`, the flange moving at `V_BE_E`.
    pub(super) fn view(&self, X_CO: &Pose, V_BE_E: Option<Twist>, random: &mut Random) -> HandEyeView {
        let X_BE = self.flange(X_CO);
        let at_stamp = integrate_body_twist(&X_BE, &V_BE_E.unwrap_or_else(Twist::zeros), -self.offset_s);
        let off = SVector::<f64, 6>::from_fn(|i, _| {
            random.gaussian() * if i < 3 { self.robot.translation_m } else { self.robot.rotation_rad }
        });
        // the truth is the stated pose with a correction: the other way round
        let said = super::rows::moved_inside(&at_stamp, &-off);
        let corners = board()
            .map(|p_O| {
                let px = camera().project(&(X_CO * p_O)).expect("the board is before the camera");
                let noise = Vector2::new(random.gaussian(), random.gaussian()) * self.corner_sd_px;
                BoardCorner {
                    p_O,
                    px: px + noise,
                    sd_px: if self.corner_sd_px > 0.0 { self.corner_sd_px } else { 0.1 },
                }
            })
            .collect();
        HandEyeView { name: "view".into(), X_BE: said, V_BE_E, corners }
    }

    /// Views from all around.
    pub(super) fn views(&self, count: usize, random: &mut Random) -> Vec<HandEyeView> {
        (0..count)
            .map(|_| {
                let X_CO = around(random);
                self.view(&X_CO, None, random)
            })
            .collect()
    }

    pub(super) fn sample(&self, X_CO: &Pose) -> LoopSample {
        LoopSample { X_WM: self.place.X_WM(&self.flange(X_CO)), X_CO: *X_CO }
    }
}

/// A board before the camera, tilted by up to some 35 degrees, turned by up to 85.
pub(super) fn around(random: &mut Random) -> Pose {
    let mut within = |size: f64| random.between(-size, size);
    let place = Vector3::new(within(0.05), within(0.04), 0.5 + within(0.1));
    let turn = Pose::rotation(Vector3::new(0.0, 0.0, within(1.5)));
    let tilt = Pose::rotation(Vector3::new(within(0.6), within(0.6), 0.0));
    Pose::from_parts(place.into(), (tilt * turn).rotation) * Pose::translation(-0.1, -0.06, 0.0)
}

pub(super) fn board() -> impl Iterator<Item = Point3<f64>> {
    (0..54).map(|i| Point3::new(f64::from(i % 9) * 0.025, f64::from(i / 9) * 0.025, 0.0))
}

/// The greater of the distances in position, m, and rotation, rad.
pub(super) fn gap(a: &Pose, b: &Pose) -> f64 {
    (a.translation.vector - b.translation.vector).norm().max(a.rotation.angle_to(&b.rotation))
}
