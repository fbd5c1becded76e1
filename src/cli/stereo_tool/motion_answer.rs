//! What `vservo stereo motion` answers.

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
        }
    }
    if let Some(f) = &answer.fundamental {
        text += &format!("F, rms {:.4} px\n{}", f.rms_px, matrix(&f.matrix));
    }
    text
}
