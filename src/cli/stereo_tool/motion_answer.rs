//! What `vservo stereo motion` answers.

use crate::geometry::Pose;
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;

/// The answer.
#[derive(Serialize)]
pub(super) struct MotionAnswer {
    pub(super) method: &'static str,
    pub(super) pairs: usize,
    /// Of points; the one that most points lie in front of first.
    pub(super) solutions: Vec<PointMotion>,
    /// Of a plane: both readings.
    pub(super) plane: Option<PlaneAnswer>,
    /// For pixels without the cameras: F alone, (10.46).
    pub(super) fundamental: Option<Fundamental>,
    pub(super) ambiguous: bool,
    pub(super) reason: Option<String>,
    /// Of two instants of a recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) recording: Option<RecordedInstants>,
}

impl MotionAnswer {
    /// Camera 2 in camera 1 by the first displacement or reading, of any length.
    pub(super) fn first_displacement(&self) -> Option<Pose> {
        let of_points = self.solutions.first().map(|s| {
            let [x, y, z, w] = s.rotation_xyzw;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            Pose::from_parts(Translation3::from(Vector3::from(s.direction)), turn)
        });
        let of_plane = self.plane.iter().flat_map(|plane| &plane.readings).next().map(|r| {
            let turn = UnitQuaternion::from_matrix(&Matrix3::from_row_slice(r.rotation.as_flattened()));
            Pose::from_parts(Translation3::from(Vector3::from(r.position_over_distance)), turn)
        });
        of_points.or(of_plane)
    }
}

/// Where the points are in camera 1.
#[derive(Serialize)]
pub(super) struct SceneStructure {
    /// What lengths are counted in: `base_line`, `plane_distance` (that of the plane from camera 2), or `m`.
    pub(super) unit: &'static str,
    /// How many points lie in front of both cameras.
    pub(super) in_front: usize,
    pub(super) points: Vec<StructurePoint>,
}

/// A point of the scene.
#[derive(Serialize)]
pub(super) struct StructurePoint {
    pub(super) id: u64,
    /// In camera 1; `null` where the rays do not meet in front of both cameras.
    pub(super) position: Option<[f64; 3]>,
    /// Its depth in camera 2.
    pub(super) depth_2: Option<f64>,
    pub(super) reason: Option<String>,
}

/// The two instants, and what the arm's joints say of the displacement.
#[derive(Serialize)]
pub(super) struct RecordedInstants {
    pub(super) times_s: [f64; 2],
    pub(super) frames: [u64; 2],
    /// Why this method, where none was named.
    pub(super) method_reason: Option<&'static str>,
    pub(super) kinematics: Option<KinematicMotion>,
}

/// Camera 2 in camera 1 by joints and mount, and how far the first displacement of the images lies from it.
#[derive(Serialize)]
pub(super) struct KinematicMotion {
    pub(super) position_m: [f64; 3],
    pub(super) rotation_xyzw: [f64; 4],
    pub(super) base_line_m: f64,
    pub(super) rotation_off_deg: Option<f64>,
    /// `null` where one of them has no base line.
    pub(super) direction_off_deg: Option<f64>,
}

/// Camera 2 in camera 1; the base line has length 1.
#[derive(Serialize)]
pub(super) struct PointMotion {
    pub(super) essential: [[f64; 3]; 3],
    pub(super) fundamental: Option<[[f64; 3]; 3]>,
    /// Normalized; `null` at infinity.
    pub(super) epipole_1: Option<[f64; 2]>,
    pub(super) epipole_2: Option<[f64; 2]>,
    pub(super) rotation_xyzw: [f64; 4],
    pub(super) direction: [f64; 3],
    pub(super) in_front: usize,
    /// Of the first-order error, normalized units.
    pub(super) rms: f64,
    pub(super) inliers: Option<Vec<u64>>,
    /// Of the rotation vector (rad) and the direction of the base line along two unit vectors across it (rad), by rows.
    pub(super) covariance: Option<Vec<f64>>,
    pub(super) tangents: Option<[[f64; 3]; 2]>,
    pub(super) structure: Option<SceneStructure>,
}

/// A plane's homography and its readings.
#[derive(Serialize)]
pub(super) struct PlaneAnswer {
    pub(super) homography: [[f64; 3]; 3],
    pub(super) rms: Option<f64>,
    /// Lengths in units of the plane's distance from camera 2.
    pub(super) readings: Vec<PlaneReading>,
}

/// A displacement and the plane's normal that explain a homography.
#[derive(Serialize)]
pub(super) struct PlaneReading {
    pub(super) rotation: [[f64; 3]; 3],
    pub(super) position_over_distance: [f64; 3],
    /// `null` of a camera that turned alone: its images of any plane are alike.
    pub(super) normal_2: Option<[f64; 3]>,
    pub(super) structure: Option<SceneStructure>,
}

/// What pixels tell without cameras.
#[derive(Serialize)]
pub(super) struct Fundamental {
    pub(super) matrix: [[f64; 3]; 3],
    pub(super) epipole_1_px: Option<[f64; 2]>,
    pub(super) epipole_2_px: Option<[f64; 2]>,
    pub(super) rms_px: f64,
}

/// For people.
pub(super) fn told(answer: &MotionAnswer) -> String {
    let list = |numbers: &[f64]| numbers.iter().map(|v| format!("{v:.6}")).collect::<Vec<_>>().join(", ");
    let matrix = |m: &[[f64; 3]; 3]| m.iter().map(|row| format!("      {}\n", list(row))).collect::<String>();
    let mut text = format!("{}: {} pairs", answer.method, answer.pairs);
    if let Some(reason) = &answer.reason {
        text += &format!("; {}{reason}", if answer.ambiguous { "ambiguous: " } else { "" });
    }
    text.push('\n');
    for (i, s) in (1..).zip(&answer.solutions) {
        text += &format!(
            "{i}: base line along ({}), rotation ({}), {} in front, rms {:.3e}\n   E\n{}",
            list(&s.direction),
            list(&s.rotation_xyzw),
            s.in_front,
            s.rms,
            matrix(&s.essential)
        );
        if let Some(inliers) = &s.inliers {
            text += &format!("   {} of {} pairs agree\n", inliers.len(), answer.pairs);
        }
        text += &structure_told(s.structure.as_ref());
    }
    if let Some(plane) = &answer.plane {
        text += &format!("H\n{}", matrix(&plane.homography));
        for (i, r) in (1..).zip(&plane.readings) {
            text += &format!(
                "{i}: position over distance ({}), normal in frame 2 ({})\n   R\n{}",
                list(&r.position_over_distance),
                r.normal_2.map_or("none".to_owned(), |n| list(&n)),
                matrix(&r.rotation)
            );
            text += &structure_told(r.structure.as_ref());
        }
    }
    if let Some(f) = &answer.fundamental {
        text += &format!("F, rms {:.4} px\n{}", f.rms_px, matrix(&f.matrix));
    }
    if let Some(recording) = &answer.recording {
        text += &recording_told(recording);
    }
    text
}

/// Most points that are told to people. Chosen by hand: a screen.
const TOLD: usize = 24;

fn structure_told(structure: Option<&SceneStructure>) -> String {
    let Some(structure) = structure else { return String::new() };
    let unit = match structure.unit {
        "base_line" => "base lines",
        "plane_distance" => "distances of the plane from camera 2",
        unit => unit,
    };
    let all = structure.points.len();
    let mut text = format!("   structure, in camera 1, {unit}; {} of {all} in front\n", structure.in_front);
    for p in structure.points.iter().take(TOLD) {
        text += &match (p.position, &p.reason) {
            (Some([x, y, z]), _) => format!("      {:>4}  {x:>10.6} {y:>10.6} {z:>10.6}\n", p.id),
            (None, reason) => format!("      {:>4}  {}\n", p.id, reason.as_deref().unwrap_or("no position")),
        };
    }
    if all > TOLD {
        text += &format!("      and {} more: --json\n", all - TOLD);
    }
    text
}

fn recording_told(recording: &RecordedInstants) -> String {
    let [a, b] = recording.times_s;
    let [first, second] = recording.frames;
    let mut text = format!("views of {a:.3} s and {b:.3} s (frames {first} and {second})");
    text += &recording.method_reason.map_or_else(String::new, |reason| format!("; {reason}"));
    text.push('\n');
    let Some(k) = &recording.kinematics else {
        return text + "by the joints: unknown, so that the length of the base line is too\n";
    };
    let [x, y, z] = k.position_m;
    text += &format!(
        "by the joints: camera 2 at ({x:.6}, {y:.6}, {z:.6}) m in camera 1, {:.6} m away",
        k.base_line_m
    );
    if let Some(deg) = k.rotation_off_deg {
        text += &format!("; the images turn it {deg:.3} deg further");
    }
    if let Some(deg) = k.direction_off_deg {
        text += &format!(", and have its base line {deg:.3} deg beside that");
    }
    text.push('\n');
    text
}
