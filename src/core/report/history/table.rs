//! The history as CSV: what people plot, and what the page is made of.

use super::{DetectionRow, RunHistory, TickRow};
use crate::control::trace::LatencyStages;
use crate::messages::{ControlState, TargetStatus, measurement_flag};
use crate::motion::Limit;
use crate::servo::{MeasurementVerdict, NoTask};
use crate::time::SpanNs;
use std::collections::BTreeSet;
use std::fmt::{Display, Write};

/// Names of the columns of a pose.
const POSE: [&str; 7] = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"];
/// Columns of each joint: measured, commanded, requested.
const JOINT: [&str; 6] = ["q", "qd", "tau", "q_r", "qd_r", "requested_qd"];

/// What follows of a posture of the arm.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PostureFacts {
    /// The flange in B, m.
    pub p_BE: [f64; 3],
    /// The camera in B as position, m, and quaternion `x y z w`.
    pub X_BC: [f64; 7],
    /// The least singular value of the Jacobian by which the joints move the camera against the object, m and rad mixed: 0 in a singular posture.
    pub min_singular_value: f64,
}

impl RunHistory {
    /// `trace.csv`: a row a tick. `places` gives what follows of the joints' positions, rad or m.
    #[must_use]
    pub fn trace_csv(&self, mut places: impl FnMut(&[f64]) -> PostureFacts) -> String {
        let mut out = String::from("tick,time_s,command_after_us,state");
        for limit in Limit::ALL {
            // a String takes everything
            let _ = write!(out, ",limit_{}", format!("{limit:?}").to_lowercase());
        }
        for column in JOINT {
            cells(&mut out, (1..=self.joints).map(|joint| format!("{column}_{joint}")));
        }
        out.push_str(",E_x_m,E_y_m,E_z_m");
        cells(&mut out, POSE.iter().map(|part| format!("C_{part}")));
        out.push_str(",min_singular_value\n");
        for row in self.ticks.all() {
            self.tick_line(&mut out, row, &mut places);
        }
        out
    }

    fn tick_line(&self, out: &mut String, row: &TickRow, places: &mut impl FnMut(&[f64]) -> PostureFacts) {
        let n = self.joints;
        let _ = write!(
            out,
            "{},{:.9},{:.3},{}",
            row.tick,
            self.seconds(row.time),
            f64::from(row.total_ns) * 1e-3,
            ControlState::from_code(u32::from(row.state)).as_str()
        );
        cells(out, row.limits);
        cells(out, row.q.iter().take(n).map(nano));
        cells(out, row.qd.iter().take(n).chain(row.tau.iter().take(n)));
        cells(out, row.q_r.iter().take(n).map(nano));
        cells(out, row.qd_r.iter().take(n).chain(row.requested_qd.iter().take(n)));
        let PostureFacts { p_BE, X_BC, min_singular_value } = places(row.q.get(..n).unwrap_or(&row.q));
        cells(out, p_BE.iter().chain(&X_BC).map(nano));
        let _ = writeln!(out, ",{min_singular_value:.6}");
    }

    /// `measurements.csv`: a row a measurement; what is not known is empty.
    #[must_use]
    pub fn measurements_csv(&self) -> String {
        let mut out = String::from(
            "frame_id,camera,target_number,exposure_s,taken_s,status,verdict,error_px,tracked,features,reprojection_rms_px,\
             exposure_to_frame_us,frame_to_vision_us,vision_us,measurement_to_command_us,exposure_to_command_us",
        );
        cells(&mut out, POSE.iter().map(|part| format!("CO_{part}")));
        // A column has the point of its number of whichever target the row is of.
        let ids: BTreeSet<u32> = self.targets.iter().flatten().copied().collect();
        cells(&mut out, ids.iter().map(|id| format!("u_{0}_px,v_{0}_px", id + 1)));
        out.push('\n');
        let width = 2 * self.points;
        for (i, row) in self.measurements.all().enumerate() {
            let px = self.px.get(i * width..(i + 1) * width).unwrap_or(&self.last_px);
            self.measurement_line(&mut out, row);
            let own = self.targets.get(row.target_number as usize).map_or(&[][..], Vec::as_slice);
            for id in &ids {
                let place = own.iter().position(|one| one == id).and_then(|at| px.get(2 * at..2 * at + 2));
                point(&mut out, place.unwrap_or(&[f32::NAN; 2]));
            }
            out.push('\n');
        }
        out
    }

    fn measurement_line(&self, out: &mut String, row: &DetectionRow) {
        let time_s = self.seconds(row.exposure);
        let _ = write!(out, "{},{},{},{time_s:.9},", row.frame_id, row.camera, row.target_number);
        if let Some(taken) = row.taken {
            let _ = write!(out, "{:.9}", self.seconds(taken));
        }
        let status = TargetStatus::from_code(row.status);
        let _ = write!(out, ",{status:?},{},", row.verdict.map_or("", verdict_word));
        if row.error_px.is_finite() {
            let _ = write!(out, "{}", row.error_px);
        }
        let tracked = u8::from(row.flags & measurement_flag::TRACKED != 0);
        let _ = write!(out, ",{tracked},{},{}", row.count, row.rms_px);
        let LatencyStages {
            exposure_to_frame,
            frame_to_vision,
            vision,
            measurement_to_command,
            exposure_to_command,
        } = row.latency.unwrap_or_default();
        for span in [exposure_to_frame, frame_to_vision, vision, measurement_to_command, exposure_to_command]
        {
            out.push(',');
            if let Some(SpanNs(ns)) = span {
                let _ = write!(out, "{:.3}", ns as f64 * 1e-3);
            }
        }
        let posed = row.flags & measurement_flag::POSE != 0;
        for value in row.pose {
            out.push(',');
            if posed {
                let _ = write!(out, "{value:.9}");
            }
        }
    }

    fn seconds(&self, time: crate::time::MonoNs) -> f64 {
        self.first.map_or(0.0, |first| (time - first).as_s())
    }
}

/// The cells of a point, empty where it was not seen.
fn point(out: &mut String, px: &[f32]) {
    for value in px {
        out.push(',');
        if value.is_finite() {
            let _ = write!(out, "{value}"); // a String takes everything
        }
    }
}

/// To a billionth.
fn nano(value: &f64) -> String {
    format!("{value:.9}")
}

fn cells<T: Display>(out: &mut String, values: impl IntoIterator<Item = T>) {
    for value in values {
        let _ = write!(out, ",{value}"); // a String takes everything
    }
}

fn verdict_word(verdict: MeasurementVerdict) -> &'static str {
    match verdict {
        MeasurementVerdict::Used => "used",
        MeasurementVerdict::UsedFromFuture => "used_from_future",
        MeasurementVerdict::NoTarget => "no_target",
        MeasurementVerdict::NoTask(NoTask::NoPose) => "no_pose",
        MeasurementVerdict::NoTask(NoTask::TooFew) => "too_few_for_the_law",
        MeasurementVerdict::NoTask(NoTask::Singular) => "singular",
        MeasurementVerdict::OtherFeatures => "other_features",
        MeasurementVerdict::OtherTarget => "other_target",
        MeasurementVerdict::TooFewFeatures => "too_few_features",
        MeasurementVerdict::ImpossiblePose => "impossible_pose",
        MeasurementVerdict::Inconsistent => "inconsistent",
        MeasurementVerdict::NotNewer => "not_newer",
        MeasurementVerdict::RefusedFromFuture => "refused_from_future",
        MeasurementVerdict::TooOld => "too_old",
    }
}
