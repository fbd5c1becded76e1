//! True parameters of a simulated cell where they differ from the controller's model: `[scene.camera]`, `[scene.target]`,
//! `[scene.arm]`. Each key has the name of the nominal one; left out, the nominal value is true.

use super::LensWord;
use serde::{Deserialize, Serialize};

table! {
    /// True parameters of the simulated camera where they differ from `[camera]`.
    RawTrueCamera {
        /// `[scene.camera.lens]`
        lens: RawTrueLens = RawTrueLens::default(),
        /// `[scene.camera.mount]`
        mount: RawTrueMount = RawTrueMount::default(),
    }
}

table! {
    /// True lens of the simulated camera; left out: that of `[camera.lens]`.
    RawTrueLens {
        /// Which formula the coefficients are of; another one than that of `[camera.lens]` has none of its coefficients.
        model: Option<LensWord> = None,
        /// Focal length times horizontal scale, px.
        fx_px: Option<f64> = None,
        /// Focal length times vertical scale, px.
        fy_px: Option<f64> = None,
        /// Column of the principal point, px.
        cx_px: Option<f64> = None,
        /// Row of the principal point, px.
        cy_px: Option<f64> = None,
        /// Radial distortion of second order.
        k1: Option<f64> = None,
        /// Radial distortion of fourth order.
        k2: Option<f64> = None,
        /// Tangential distortion.
        p1: Option<f64> = None,
        /// Tangential distortion.
        p2: Option<f64> = None,
        /// Radial distortion of sixth order.
        k3: Option<f64> = None,
        /// Fourth radial coefficient of `rational_polynomial` and `equidistant`.
        k4: Option<f64> = None,
        /// Fifth radial coefficient of `rational_polynomial`.
        k5: Option<f64> = None,
        /// Sixth radial coefficient of `rational_polynomial`.
        k6: Option<f64> = None,
    }
}

impl RawTrueLens {
    /// All coefficients by their names.
    #[must_use]
    pub fn coefficients(&self) -> [(&'static str, Option<f64>); 8] {
        let Self { k1, k2, p1, p2, k3, k4, k5, k6, .. } = *self;
        [("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6)]
    }
}

pose_table! {
    /// True pose of the simulated camera, in the frame of `[camera.mount]`; left out: as there.
    RawTrueMount {
        /// The link that carries it.
        #[serde(skip_serializing_if = "Option::is_none")]
        link: Option<String> = None,
        /// Position, m.
        position_m: Option<[f64; 3]> = None,
        /// Roll, pitch, yaw, rad.
        rotation_rpy_rad: Option<[f64; 3]> = None,
    }
}

table! {
    /// True size of the simulated target; left out: that of `[target]`, times `scale`.
    RawTrueTarget {
        /// Factor on every length of `[target]` that is not given here.
        scale: Option<f64> = None,
        /// Side of the square of dots, m.
        side_m: Option<f64> = None,
        /// Radius of dots 2 to 4, m.
        radius_m: Option<f64> = None,
        /// Radius of dot 1, m.
        radius_p1_m: Option<f64> = None,
        /// Radius of dot 2, m.
        radius_p2_m: Option<f64> = None,
        /// Light margin of the plate around the square, m.
        margin_m: Option<f64> = None,
    }
}

table! {
    /// True parameters of the simulated arm; those of its drive are in `[drive.simulated]`.
    RawTrueArm {
        /// Name of a shipped robot, or path of a robot file: lengths, masses and friction. Left out: `robot.model`.
        model: Option<String> = None,
        /// Factor on the masses and inertias of the links.
        mass_scale: Option<f64> = None,
        /// Factor on the joints' friction.
        friction_scale: Option<f64> = None,
        /// True position of each joint less what its encoder reads, rad or m; one value stands for all joints, none for 0.
        q_offset_rad_or_m: Vec<f64> = Vec::new(),
    }
}
