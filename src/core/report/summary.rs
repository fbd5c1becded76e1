//! The summary of a run: what `--summary` writes and the last lines on stdout say.

mod contact_report;
mod found_payload;
mod load_calibration;
mod second_camera_report;
mod stamp_calibration;
mod times;

pub use contact_report::ContactReport;
pub use found_payload::FoundPayload;
pub use load_calibration::{JointFriction, LoadCalibration};
pub use second_camera_report::SecondCameraReport;
pub use stamp_calibration::StampCalibration;
pub use times::{Latencies, ProcessUsage, RealtimeReport, TickTimes};

use crate::control::outcome::Outcome;
use crate::mission::measurement_log::VerdictCounts;
use crate::mission::{Accuracy, DescriptionError, FinalErrors, ModelError, PathTracking, contradicted_text};
use crate::report::histogram::Quantiles;
use crate::report::numbers::significant;
use crate::robot::joint_in_words;
use crate::servo::Stability;
use found_payload::rotors_text;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// How the reason of a summary begins that was made of a recording which ends before its run.
pub const RECORDING_ENDS: &str = "the recording ends before the run";

/// Something that safety saw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SafetyEvent {
    /// Since the first tick, s.
    pub time_s: f64,
    /// What happened.
    pub event: String,
}

/// Where safety stood at the end, and what happened before.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SafetyReport {
    /// Last state of the controller.
    pub state: String,
    /// In the order of time: the first ones and the last ones.
    pub events: Vec<SafetyEvent>,
    /// How many came between those.
    #[serde(default)]
    pub events_left_out: u64,
    /// How often limits acted.
    pub limited_ticks: LimitedTicks,
    /// Which limits in space held the arm back, by the names of the run file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_by: Vec<HeldBy>,
}

/// A limit in space that held the arm back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldBy {
    /// Which.
    pub limit: String,
    /// In how many ticks.
    pub ticks: u64,
}

impl SafetyReport {
    /// Before which event some are left out, and a word about them.
    #[must_use]
    pub fn gap(&self) -> Option<(usize, String)> {
        let text = || format!("{} events are left out here", self.events_left_out);
        (self.events_left_out > 0).then(|| (self.events.len() / 2, text()))
    }
}

/// Ticks in which a limit held a joint back.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LimitedTicks {
    /// The end of a joint's range.
    pub position: u64,
    /// The largest speed of a joint.
    pub velocity: u64,
    /// The largest acceleration of a joint.
    pub acceleration: u64,
    /// The largest jerk of a joint.
    pub jerk: u64,
    /// The largest torque or force of a joint.
    pub effort: u64,
    /// Nearness of a singular posture.
    pub singularity: u64,
    /// A view that was old or uncertain.
    pub view: u64,
    /// A joint that did not move, and was pushed no more than gently.
    #[serde(default)]
    pub stall: u64,
    /// A limit in space.
    #[serde(default)]
    pub workspace: u64,
}

/// The summary of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// How it ended.
    pub outcome: Outcome,
    /// Why.
    pub reason: String,
    /// Clock of the control loop.
    pub clock: String,
    /// Servo law.
    pub scheme: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Length by the loop's own clock, s.
    pub duration_s: f64,
    /// Length by the wall clock, from first to last tick, s; `None` of a recorded run in simulated time.
    pub wall_s: Option<f64>,
    /// Control ticks.
    pub ticks: u64,
    /// Ticks whose command came too late or not at all.
    pub missed_deadlines: u64,
    /// Those of them that were not served at all.
    pub skipped_ticks: u64,
    /// Frames that vision received.
    pub frames: u64,
    /// Measurements that reached control.
    pub measurements: u64,
    /// What became of them.
    pub intake: VerdictCounts,
    /// Frames that the camera sent and vision skipped.
    pub frames_dropped: u64,
    /// How often the target was lost.
    pub target_lost: u64,
    /// Ticks that found no new state of an external drive in time.
    pub late_drive_states: u64,
    /// From then on the feature error stayed below 2 % of its first value, s; `null` when it did not.
    pub settling_time_s: Option<f64>,
    /// Errors at the end: against simulated truth where there is one, else from the last measurement.
    #[serde(rename = "final")]
    pub final_errors: FinalErrors,
    /// How near to its goal the camera is by all that the run has seen, and within which bound; `null` where the goal was taught, or nothing tells.
    #[serde(default)]
    pub accuracy: Option<Accuracy>,
    /// The numbers of the description that the views of the run contradict together with its joints, the surest first; left out where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contradicted: Vec<DescriptionError>,
    /// Latencies of the measurements.
    pub latency_us: Latencies,
    /// Times of the control tick.
    pub tick_us: TickTimes,
    /// What the real-time thread had from the system; `null` in lockstep.
    #[serde(default)]
    pub realtime: Option<RealtimeReport>,
    /// What each process used, by role; only the supervisor knows.
    #[serde(default)]
    pub processes: BTreeMap<String, ProcessUsage>,
    /// How often each process was started anew, by role; those that never were are left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub restarts: BTreeMap<String, u32>,
    /// What safety saw.
    pub safety: SafetyReport,
    /// Ticks of a realtime run that are missing in latencies, settling and events, because their record was lost.
    #[serde(default)]
    pub lost_traces: u64,
    /// Commands of a realtime run that never reached the external drive, because control's second thread did not come round.
    #[serde(default)]
    pub lost_commands: u64,
    /// Commands that the gate before the drive had to change.
    #[serde(default)]
    pub gated_commands: u64,
    /// What the arm was found to carry and the run file does not tell; `null` where nothing was found.
    #[serde(default)]
    pub payload: Option<FoundPayload>,
    /// Inertia of rotors as each joint feels it that was found and the robot file does not tell, kg m^2 or kg: 0 for a joint whose torques may be a payload's; empty where none was.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rotors_kg_m2_or_kg: Vec<f64>,
    /// Its standard deviation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rotors_sd_kg_m2_or_kg: Vec<f64>,
    /// Measurements whose points fit the description of lens and target only with a model error; `null` where all fit.
    #[serde(default)]
    pub model_error: Option<ModelError>,
    /// The names of the joints in the robot file, in the order of all lists of joints.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint_names: Vec<String>,
    /// What touched the arm and stopped it; left out where nothing did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<ContactReport>,
    /// Joints, from 0, whose encoders were not trusted at the end; left out where all were.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub untrusted_encoders: Vec<usize>,
    /// Over every joint state of a lockstep run, hexadecimal; `null` in real time.
    pub state_hash: Option<String>,
    /// What a calibration run found; left out in other runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<StampCalibration>,
    /// What `vservo calibrate load` found; left out in other runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load: Option<LoadCalibration>,
    /// How far the law is from instability with what it believes, as `vservo check` tells it; left out for other laws than scheme D, and
    /// without a scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stability: Option<Stability>,
    /// How near the features stayed to a goal that moves on a path; left out for a goal at rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathTracking>,
    /// What the second of two cameras that control the arm saw, and its goal; left out of runs with one. The rest is of the first camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_camera: Option<SecondCameraReport>,
}

/// A duration of a histogram, us, to the digits that its buckets resolve: their width is 1.6 to 3.1 % of the duration.
fn counted_us(us: f64) -> String {
    // 1 / 32, the widest bucket of the histogram, which follows from its `SUB_BITS`.
    const WIDTH: f64 = 0.031;
    let power = |x: f64| x.log10().floor();
    significant(us, if us > 0.0 { (power(us) - power(us * WIDTH)) as usize + 1 } else { 1 })
}

impl Summary {
    /// The summary of a run whose control process left none.
    #[must_use]
    pub fn without_control(config: &crate::config::Config, wall: crate::time::SpanNs) -> Self {
        Self {
            outcome: Outcome::Fault,
            reason: String::new(),
            clock: config.clock_name().into(),
            scheme: config.scheme_name().into(),
            seed: config.seed,
            duration_s: 0.0,
            wall_s: Some(wall.as_s()),
            ticks: 0,
            missed_deadlines: 0,
            skipped_ticks: 0,
            frames: 0,
            measurements: 0,
            intake: VerdictCounts::default(),
            frames_dropped: 0,
            target_lost: 0,
            late_drive_states: 0,
            settling_time_s: None,
            final_errors: FinalErrors::default(),
            accuracy: None,
            contradicted: Vec::new(),
            latency_us: Latencies::default(),
            tick_us: TickTimes::default(),
            realtime: None,
            processes: BTreeMap::new(),
            restarts: BTreeMap::new(),
            safety: SafetyReport { state: "fault".into(), ..SafetyReport::default() },
            lost_traces: 0,
            lost_commands: 0,
            gated_commands: 0,
            payload: None,
            rotors_kg_m2_or_kg: Vec::new(),
            rotors_sd_kg_m2_or_kg: Vec::new(),
            model_error: None,
            contact: None,
            untrusted_encoders: Vec::new(),
            joint_names: Vec::new(),
            state_hash: None,
            calibration: None,
            load: None,
            stability: None,
            path: None,
            second_camera: None,
        }
    }

    /// A few lines for people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut t = String::new();
        let pair = |q: &Quantiles| {
            format!("p50 {}  p99 {}  max {} us", counted_us(q.p50), counted_us(q.p99), counted_us(q.max))
        };
        let or_unknown = |v: Option<f64>, scale: f64, unit: &str| {
            v.map_or_else(|| "unknown".to_string(), |v| format!("{:.4} {unit}", v * scale))
        };
        let f = &self.final_errors;
        let _ = writeln!(t, "outcome       {} ({})", self.outcome.as_str(), self.reason);
        let wall = self.wall_s.map_or_else(String::new, |wall_s| format!(" in {wall_s:.3} s"));
        let _ = writeln!(
            t,
            "run           {:.3} s {}{wall}, {} ticks, {} deadlines missed",
            self.duration_s, self.clock, self.ticks, self.missed_deadlines
        );
        let _ = writeln!(
            t,
            "vision        {} frames, {} dropped, {} measurements used, target lost {} times",
            self.frames,
            self.frames_dropped,
            self.intake.used + self.intake.used_from_future,
            self.target_lost
        );
        let i = &self.intake;
        let refused = i.refused_not_newer + i.refused_from_future + i.refused_too_old;
        if i.used_from_future + refused > 0 {
            let _ = writeln!(
                t,
                "stamps        {} used from the future; refused: {} from the future, {} not newer, {} too old",
                i.used_from_future, i.refused_from_future, i.refused_not_newer, i.refused_too_old
            );
        }
        if i.degraded > 0 {
            let _ = writeln!(
                t,
                "degraded      {} measurements in which a part of the target was hidden",
                i.degraded
            );
        }
        if i.refused_inconsistent > 0 {
            let _ = writeln!(
                t,
                "refused       {} measurements whose points do not fit one pose",
                i.refused_inconsistent
            );
        }
        if let Some(model_error) = &self.model_error {
            let _ = writeln!(t, "model error   {}", model_error.to_text());
        }
        let _ = writeln!(
            t,
            "final error   features {}, position {}, orientation {}",
            or_unknown(f.feature_error_px, 1.0, "px"),
            or_unknown(f.position_error_m, 1e3, "mm"),
            or_unknown(f.orientation_error_rad, 180.0 / std::f64::consts::PI, "deg"),
        );
        if f.is_not_as_believed() {
            let b = &f.believed;
            let _ = writeln!(
                t,
                "as measured   features {}, position {}, orientation {}",
                or_unknown(b.feature_error_px, 1.0, "px"),
                or_unknown(b.position_error_m, 1e3, "mm"),
                or_unknown(b.orientation_error_rad, 180.0 / std::f64::consts::PI, "deg"),
            );
        }
        if let Some(second) = &self.second_camera {
            let _ = writeln!(t, "second camera {}", second.to_text());
        }
        if let Some(accuracy) = &self.accuracy {
            let _ = writeln!(t, "accuracy      {}", accuracy.to_text());
        }
        if let Some(text) = contradicted_text(&self.contradicted) {
            let _ = writeln!(t, "description   {text}");
        }
        if let Some(path) = &self.path {
            let _ = writeln!(t, "path          {}", path.describe());
        }
        if let Some(payload) = &self.payload {
            let _ = writeln!(t, "payload       {}", payload.to_text());
        }
        if let Some(text) = rotors_text(self) {
            let _ = writeln!(t, "rotors        {text}");
        }
        if let Some(contact) = &self.contact {
            let _ = writeln!(t, "contact       {}", contact.to_text());
        }
        if !self.untrusted_encoders.is_empty() {
            let called = self.untrusted_encoders.iter().map(|i| joint_in_words(&self.joint_names, *i));
            let _ = writeln!(t, "encoders      not trusted: {}", called.collect::<Vec<_>>().join(", "));
        }
        if self.late_drive_states > 0 {
            let _ = writeln!(t, "drive         {} ticks without a new state in time", self.late_drive_states);
        }
        if let Some(settling) = self.settling_time_s {
            let _ = writeln!(t, "settling      {settling:.3} s to 2 % of the first feature error");
        }
        let latency = &self.latency_us;
        if latency.exposure_to_command.max > 0.0 {
            let _ = writeln!(t, "latency       exposure to command: {}", pair(&latency.exposure_to_command));
            for (name, stage) in [
                ("exposure to frame:  ", &latency.exposure_to_frame),
                ("frame to vision:    ", &latency.frame_to_vision),
                ("vision:             ", &latency.vision),
                ("to command:         ", &latency.measurement_to_command),
            ] {
                if stage.max > 0.0 {
                    let _ = writeln!(t, "              {name} {}", pair(stage));
                }
            }
        }
        if self.tick_us.step.max > 0.0 {
            let _ = writeln!(t, "tick          wake: {}", pair(&self.tick_us.wake));
            let _ = writeln!(t, "              step: {}", pair(&self.tick_us.step));
            let _ = writeln!(
                t,
                "              total: {}, {} of {} ticks missed, {} of them skipped",
                pair(&self.tick_us.total),
                self.missed_deadlines,
                self.ticks + self.skipped_ticks,
                self.skipped_ticks
            );
        }
        if let Some(realtime) = &self.realtime {
            let spin = spin_text(realtime.spin_us, realtime.spin_share);
            let _ = writeln!(
                t,
                "real time     {}{spin}, {} page faults",
                realtime.scheduling, realtime.page_faults
            );
        }
        for (i, (name, used)) in self.processes.iter().enumerate() {
            let _ = writeln!(
                t,
                "{:<13} {name:<8} {:5.1} % of a core, {:.3} s, {:.1} MB",
                if i == 0 { "processes" } else { "" },
                used.cpu_share * 100.0,
                used.cpu_s,
                used.max_resident_mb
            );
        }
        if !self.restarts.is_empty() {
            let times: Vec<_> = self.restarts.iter().map(|(name, n)| format!("{name} {n}")).collect();
            let _ = writeln!(t, "started anew  {}", times.join(", "));
        }
        let gap = self.safety.gap();
        for (i, e) in self.safety.events.iter().enumerate() {
            if let Some((_, text)) = gap.as_ref().filter(|(at, _)| *at == i) {
                let _ = writeln!(t, "safety        {text}");
            }
            let _ = writeln!(t, "safety        {:.3} s: {}", e.time_s, e.event);
        }
        if let Some(hash) = &self.state_hash {
            let _ = writeln!(t, "state hash    {hash}");
        }
        if let Some(found) = &self.calibration {
            let _ = writeln!(t, "calibration   {}", found.describe());
        }
        if let Some(found) = &self.load {
            let _ = writeln!(t, "load          {}", found.describe());
        }
        t
    }
}

/// The words for a spin and its cost, after the scheduling that was obtained; empty where there is none.
#[must_use]
pub fn spin_text(spin_us: f64, share: f64) -> String {
    if spin_us <= 0.0 {
        return String::new();
    }
    format!(", spins the last {spin_us} us ({:.1} % of a core)", share * 100.0)
}

#[cfg(test)]
mod tests;
