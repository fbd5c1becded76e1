//! `[workspace]`: limits in space.

use serde::{Deserialize, Serialize};

table! {
    /// How fast camera and flange may be, and where the arm may be.
    RawWorkspace {
        /// Largest speed of the camera's centre, m/s.
        #[serde(skip_serializing_if = "Option::is_none")]
        camera_speed_m_s: Option<f64> = None,
        /// Largest rate at which the camera turns, rad/s.
        #[serde(skip_serializing_if = "Option::is_none")]
        camera_turn_rad_s: Option<f64> = None,
        /// Largest speed of the flange's centre, m/s.
        #[serde(skip_serializing_if = "Option::is_none")]
        flange_speed_m_s: Option<f64> = None,
        /// Distance that the reference keeps from planes, and of parts from each other, m.
        margin_m: f64 = 0.01,
        /// Whether links are kept inside; else only camera, tool and flange.
        links: bool = true,
        /// Radius of each link about the straight line between its joints, m; one value stands for all.
        link_radius_m: Vec<f64> = vec![0.06],
        /// Radius of the camera about its centre, m.
        camera_radius_m: f64 = 0.04,
        /// Tip of a tool in the flange's frame, m.
        #[serde(skip_serializing_if = "Option::is_none")]
        tool_m: Option<[f64; 3]> = None,
        /// Radius of the tool, m.
        tool_radius_m: f64 = 0.02,
        /// Whether links, camera and tool are kept off each other.
        self_collision: bool = false,
        /// `[[workspace.planes]]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        planes: Vec<RawPlane> = Vec::new(),
        /// `[[workspace.boxes]]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        boxes: Vec<RawBox> = Vec::new(),
    }
}

table! {
    /// A plane that nothing of the arm may pass.
    RawPlane {
        /// What messages call it.
        name: String = String::new(),
        /// A point of it in the frame of the base, m.
        point_m: [f64; 3] = [0.0; 3],
        /// The direction out of it to where the arm may be, of any length.
        normal: [f64; 3] = [0.0, 0.0, 1.0],
    }
}

table! {
    /// A box, along the axes of the frame of the base, that nothing of the arm may leave.
    RawBox {
        /// What messages call it.
        name: String = String::new(),
        /// Least coordinates, m.
        min_m: [f64; 3] = [-1.0; 3],
        /// Greatest coordinates, m.
        max_m: [f64; 3] = [1.0; 3],
    }
}
