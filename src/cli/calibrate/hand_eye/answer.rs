//! The result of a hand-eye calibration: JSON for programs, lines for people, TOML for the run file.

use crate::calibration::hand_eye::{CameraMount, ClosedFormCamera, HandEyeReport, HandEyeView, HeldOutView};
use crate::geometry::Pose;
use crate::report::hand_eye_page::{HandEyePage, hand_eye_page};
use nalgebra::{Matrix6, Rotation3};
use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};
use std::fmt::Write;

/// An image in which nothing was found.
pub(super) struct UnusedImage {
    /// Its place among all images.
    pub at: usize,
    pub name: String,
    pub reason: String,
}

/// What is found, under the keys of DESIGN.
pub(super) struct HandEyeAnswer {
    report: HandEyeReport,
    views: Vec<HandEyeViewOut>,
    driven: Option<Driven>,
}

/// What a session of a simulated arm adds: how far the mounting that was found lies from others.
#[derive(Serialize)]
pub(super) struct Driven {
    from_run_file: Gap,
    /// What is simulated.
    from_truth: Option<Gap>,
}

#[derive(Serialize)]
struct Gap {
    position_mm: f64,
    rotation_deg: f64,
}

impl Driven {
    /// The camera found, the run file's and the simulated one.
    pub(super) fn new(found: &Pose, believed: &Pose, truth: Option<&Pose>) -> Self {
        let gap = |other: &Pose| Gap {
            position_mm: (found.translation.vector - other.translation.vector).norm() * 1e3,
            rotation_deg: found.rotation.angle_to(&other.rotation).to_degrees(),
        };
        Self { from_run_file: gap(believed), from_truth: truth.map(gap) }
    }

    /// In words.
    fn lines(&self) -> Vec<String> {
        let gap = |g: &Gap| format!("{:.2} mm and {:.3} deg", g.position_mm, g.rotation_deg);
        let truth = self.from_truth.as_ref();
        let truth = truth.map(|g| format!("What was found is off the simulated truth by {}.", gap(g)));
        let own = format!("The run file's own mounting is off by {}.", gap(&self.from_run_file));
        std::iter::once(own).chain(truth).collect()
    }
}

#[derive(Serialize)]
struct MountOut {
    position_m: [f64; 3],
    rotation_xyzw: [f64; 4],
    rotation_rpy_rad: [f64; 3],
    /// Of `[v; w]`, row by row: `v` what the position is off by, `w` the small turn about the position (rotation = exp(w) rotation), both
    /// along the axes of the outer frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<Vec<f64>>,
}

impl MountOut {
    fn new(X: &Pose, covariance: Option<&Matrix6<f64>>) -> Self {
        let (roll, pitch, yaw) = Rotation3::from(X.rotation).euler_angles();
        let q = X.rotation.coords;
        Self {
            position_m: X.translation.vector.into(),
            rotation_xyzw: [q.x, q.y, q.z, q.w],
            rotation_rpy_rad: [roll, pitch, yaw],
            covariance: covariance.map(|C| C.iter().copied().collect()),
        }
    }
}

#[derive(Serialize)]
struct ClosedForm {
    method: &'static str,
    pose: MountOut,
    rotation_error_deg: f64,
    position_error_mm: f64,
}

/// What the views by themselves make of a board whose pose was said, and how far that is from it.
#[derive(Serialize)]
struct BoardOut {
    pose: MountOut,
    position_error_mm: f64,
    rotation_error_deg: f64,
    chi_square: f64,
    contradicted: bool,
}

#[derive(Serialize)]
struct ErrorsOut {
    rotation_error_deg: f64,
    position_error_mm: f64,
    rms_px: f64,
}

#[derive(Serialize)]
struct Uncertainty {
    camera_mm: f64,
    camera_deg: f64,
    working_distance_m: f64,
    position_at_working_distance_mm: f64,
}

#[derive(Serialize)]
struct Deviation {
    translation_mm: f64,
    rotation_deg: f64,
}

#[derive(Serialize)]
struct Offset {
    camera_stamp_offset_ms: f64,
    sd_ms: f64,
}

#[derive(Serialize)]
struct HandEyeViewOut {
    image: String,
    used: bool,
    reason: Option<String>,
    corners: usize,
    rms_px: Option<f64>,
    rms_corrected_px: Option<f64>,
    correction_mm: Option<f64>,
    correction_deg: Option<f64>,
    speed_px_s: Option<f64>,
    /// Predicted by the others.
    held_out: Option<ErrorsOut>,
}

impl From<&HeldOutView> for ErrorsOut {
    fn from(view: &HeldOutView) -> Self {
        Self {
            rotation_error_deg: view.rotation_rad.to_degrees(),
            position_error_mm: view.position_m * 1e3,
            rms_px: view.rms_px,
        }
    }
}

impl HandEyeAnswer {
    /// `views`: those in which the board was found, as the report has them.
    pub(super) fn new(report: HandEyeReport, views: &[HandEyeView], unused: Vec<UnusedImage>) -> Self {
        let mut held = report.held_out.iter().flat_map(|held| &held.views);
        let mut told: Vec<HandEyeViewOut> = Vec::with_capacity(views.len() + unused.len());
        for (view, residual) in views.iter().zip(&report.views) {
            let held = if residual.used { held.next().and_then(Option::as_ref) } else { None };
            told.push(HandEyeViewOut {
                image: view.name.clone(),
                used: residual.used,
                reason: residual.reason.clone(),
                corners: view.corners.len(),
                rms_px: residual.rms_px,
                rms_corrected_px: residual.rms_corrected_px,
                correction_mm: residual.correction_m.map(|m| m * 1e3),
                correction_deg: residual.correction_rad.map(f64::to_degrees),
                speed_px_s: residual.speed_px_s,
                held_out: held.map(ErrorsOut::from),
            });
        }
        for image in unused {
            let out = HandEyeViewOut {
                image: image.name,
                used: false,
                reason: Some(image.reason),
                corners: 0,
                rms_px: None,
                rms_corrected_px: None,
                correction_mm: None,
                correction_deg: None,
                speed_px_s: None,
                held_out: None,
            };
            told.insert(image.at.min(told.len()), out);
        }
        Self { report, views: told, driven: None }
    }

    /// Whether images and robot contradict each other.
    pub(super) fn is_contradicted(&self) -> bool {
        self.report.is_contradicted()
    }

    /// With what a session adds.
    pub(super) fn driven(self, driven: Driven) -> Self {
        Self { driven: Some(driven), ..self }
    }

    /// The lines of the run file.
    pub(super) fn to_toml(&self) -> String {
        format!("# vservo calibrate hand-eye:\n{}", self.report.to_toml())
    }

    /// The page of `--report`.
    pub(super) fn page(&self) -> String {
        let nothing_found = self.views.iter().filter(|view| view.corners == 0);
        let unused: Vec<_> =
            nothing_found.map(|view| (view.image.clone(), view.reason.clone().unwrap_or_default())).collect();
        let gaps: Vec<String> = self.driven.iter().flat_map(Driven::lines).collect();
        hand_eye_page(&HandEyePage { report: &self.report, unused: &unused, gaps: &gaps })
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let r = &self.report;
        let mut text = String::new();
        for view in &self.views {
            let _ = match (view.used, view.rms_px, &view.held_out) {
                (true, Some(rms_px), held) => {
                    let held = held.as_ref().map_or_else(String::new, |h| {
                        format!(
                            ", predicted by the others to {:.1} px, {:.2} mm",
                            h.rms_px, h.position_error_mm
                        )
                    });
                    writeln!(text, "{}: {} points, rms {rms_px:.2} px{held}", view.image, view.corners)
                }
                _ => {
                    let reason = view.reason.as_deref().unwrap_or("no reason");
                    writeln!(text, "{}: left out: {reason}", view.image)
                }
            };
        }
        let _ = writeln!(
            text,
            "all: rms {:.2} px with the robot's poses as they are, {:.3} px with small corrections; the board's places scatter by \
             {:.3} deg and {:.2} mm\n\n{}\n\nput this into the run file:\n",
            r.rms_px,
            r.fit.rms_px,
            r.scatter.rotation_rad.to_degrees(),
            r.scatter.position_m * 1e3,
            r.verdict
        );
        for line in self.driven.iter().flat_map(Driven::lines) {
            let _ = writeln!(text, "# {line}");
        }
        text + &self.mount_lines()
    }

    fn mount_lines(&self) -> String {
        self.report.to_toml().lines().filter(|l| !l.starts_with('#')).map(|l| format!("{l}\n")).collect()
    }
}

impl Serialize for HandEyeAnswer {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let r = &self.report;
        let closed = |form: &ClosedFormCamera| ClosedForm {
            method: form.method,
            pose: MountOut::new(&form.X_MC, None),
            rotation_error_deg: form.scatter.rotation_rad.to_degrees(),
            position_error_mm: form.scatter.position_m * 1e3,
        };
        let deviation = |rotation_rad: f64, translation_m: f64| Deviation {
            translation_mm: translation_m * 1e3,
            rotation_deg: rotation_rad.to_degrees(),
        };
        let mut map = serializer.serialize_map(None)?;
        let place = if r.place == CameraMount::EyeInHand { "eye_in_hand" } else { "eye_to_hand" };
        map.serialize_entry("place", place)?;
        map.serialize_entry(r.place.camera_name(), &MountOut::new(&r.X_MC(), Some(&r.fit.covariance_X_MC)))?;
        map.serialize_entry(r.place.board_name(), &MountOut::new(&r.fit.X_WO, Some(&r.fit.covariance_X_WO)))?;
        map.serialize_entry("rms_px", &r.rms_px)?;
        map.serialize_entry("rms_corrected_px", &r.fit.rms_px)?;
        map.serialize_entry("rotation_error_deg", &r.scatter.rotation_rad.to_degrees())?;
        map.serialize_entry("position_error_mm", &(r.scatter.position_m * 1e3))?;
        let held = r.held_out.as_ref().map(|held| ErrorsOut {
            rotation_error_deg: held.rotation_rad.to_degrees(),
            position_error_mm: held.position_m * 1e3,
            rms_px: held.rms_px,
        });
        map.serialize_entry("leave_one_out", &held)?;
        let d = &r.distance;
        map.serialize_entry(
            "sd",
            &Uncertainty {
                camera_mm: d.camera_m * 1e3,
                camera_deg: d.rotation_rad.to_degrees(),
                working_distance_m: d.distance_m,
                position_at_working_distance_mm: d.position_m * 1e3,
            },
        )?;
        map.serialize_entry(
            "robot_sd_stated",
            &deviation(r.robot_stated.rotation_rad, r.robot_stated.translation_m),
        )?;
        map.serialize_entry(
            "robot_sd_seen",
            &deviation(r.robot_seen.rotation_rad, r.robot_seen.translation_m),
        )?;
        map.serialize_entry("model_sd_px", &r.model_sd_px)?;
        let offset = r
            .fit
            .offset_sd_s
            .map(|sd_s| Offset { camera_stamp_offset_ms: r.fit.offset_s * 1e3, sd_ms: sd_s * 1e3 });
        map.serialize_entry("time_offset", &offset)?;
        map.serialize_entry("closed_forms", &r.closed_forms.iter().map(closed).collect::<Vec<_>>())?;
        map.serialize_entry("known_board", &r.known_board)?;
        let board = r.board_as_seen.map(|board| BoardOut {
            pose: MountOut::new(&board.X_WO, None),
            position_error_mm: board.position_m * 1e3,
            rotation_error_deg: board.rotation_rad.to_degrees(),
            chi_square: board.chi_square,
            contradicted: board.is_contradicted(),
        });
        map.serialize_entry("board_as_seen", &board)?;
        if let Some(driven) = &self.driven {
            map.serialize_entry("driven", driven)?;
        }
        map.serialize_entry("views", &self.views)?;
        map.serialize_entry("verdict", &r.verdict.lines().collect::<Vec<_>>())?;
        map.end()
    }
}
