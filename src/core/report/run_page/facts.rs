//! What the summary of a run says, in the words of the page.

use crate::control::outcome::Outcome;
use crate::mission::contradicted_text;
use crate::report::summary::{RECORDING_ENDS, Summary};
use crate::servo::{Margins, StabilityMargin};

/// How the run ended, in a sentence.
#[must_use]
pub fn run_verdict(summary: &Summary) -> String {
    let how = match summary.outcome {
        Outcome::Converged => "Converged",
        Outcome::NotConverged => "Did not converge",
        Outcome::Finished => "Finished",
        Outcome::Stopped if summary.reason.starts_with(RECORDING_ENDS) => "Cut off",
        Outcome::Stopped => "Stopped on request",
        Outcome::Fault => "Ended by a fault",
    };
    format!("{how} after {:.2} s: {}.", summary.duration_s, summary.reason.trim_end_matches('.'))
}

/// Names and values, in the order in which one reads them.
#[must_use]
pub fn run_facts(s: &Summary) -> Vec<(String, String)> {
    let mut facts = Vec::new();
    let mut tell = |name: &str, value: String| facts.push((name.to_owned(), value));
    tell("servo law", s.scheme.clone());
    let pace = match s.clock.as_str() {
        "lockstep" => {
            let wall =
                s.wall_s.map_or_else(String::new, |wall_s| format!(", {wall_s:.2} s by the wall clock"));
            format!("lockstep (simulated time){wall}")
        }
        other => other.to_owned(),
    };
    tell("clock", pace);
    let missed = match (s.missed_deadlines, s.clock.as_str()) {
        (_, "lockstep") => String::new(),
        (0, _) => ", no deadline missed".into(),
        (missed, _) => format!(", {missed} deadlines missed, {} of them skipped", s.skipped_ticks),
    };
    tell("control ticks", format!("{}{missed}", s.ticks));
    tell(
        "frames",
        format!(
            "{} measured, {} skipped by vision, {} measurements used, target lost {} times",
            s.frames,
            s.frames_dropped,
            s.intake.used + s.intake.used_from_future,
            s.target_lost
        ),
    );
    if let Some(contact) = &s.contact {
        tell("contact", contact.to_text());
    }
    if let Some(model_error) = &s.model_error {
        tell("model error", model_error.to_text());
    }
    if let Some(settling_s) = s.settling_time_s {
        tell("settling", format!("{settling_s:.3} s to 2 % of the first feature error"));
    }
    let f = &s.final_errors;
    let errors = |px: Option<f64>, m: Option<f64>, rad: Option<f64>| {
        let part =
            |value: Option<f64>, scale: f64, unit: &str| value.map(|v| format!("{:.4} {unit}", v * scale));
        let parts = [part(px, 1.0, "px"), part(m, 1e3, "mm"), part(rad, 180.0 / std::f64::consts::PI, "deg")];
        let told: Vec<String> = parts.into_iter().flatten().collect();
        if told.is_empty() { "unknown".to_owned() } else { told.join(", ") }
    };
    tell("error at the end", errors(f.feature_error_px, f.position_error_m, f.orientation_error_rad));
    if f.is_not_as_believed() {
        let b = &f.believed;
        tell("the same as measured", errors(b.feature_error_px, b.position_error_m, b.orientation_error_rad));
    }
    if let Some(accuracy) = &s.accuracy {
        tell("accuracy", accuracy.to_text());
    }
    if let Some(text) = contradicted_text(&s.contradicted) {
        tell("description", text);
    }
    if let Some(path) = &s.path {
        tell("path of the goal", path.describe());
    }
    if let Some(stability) = &s.stability {
        let at = |place: &str, margins: &Margins| {
            let StabilityMargin { definite, slowest } = margins.joints;
            format!(
                "{place} the slowest error falls at {slowest:.3} times the gain, least eigenvalue {definite:.3}"
            )
        };
        let goal = stability.goal.as_ref().map(|margins| at("at the goal", margins));
        let told: Vec<String> = goal.into_iter().chain([at("at the start", &stability.start)]).collect();
        tell("stability, (10.91)", told.join("; "));
    }
    if let Some(realtime) = &s.realtime {
        tell("real time", format!("{}, {} page faults", realtime.scheduling, realtime.page_faults));
    }
    if s.lost_traces > 0 {
        tell("lost records", format!("{} ticks are missing in this report", s.lost_traces));
    }
    for (name, used) in &s.processes {
        let share = used.cpu_share * 100.0;
        tell(name, format!("{share:.1} % of a core, {:.1} MB at most", used.max_resident_mb));
    }
    if let Some(hash) = &s.state_hash {
        tell("state hash", hash.clone());
    }
    if let Some(found) = &s.calibration {
        tell("calibration", found.describe());
    }
    facts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::mission::DescriptionError;
    use crate::time::SpanNs;

    #[test]
    fn what_was_never_measured_is_not_told() {
        let config = Config::load(None, &[]).unwrap();
        let mut summary = Summary::without_control(&config, SpanNs(0));
        summary.reason = "the arm fell over.".into();
        assert_eq!(run_verdict(&summary), "Ended by a fault after 0.00 s: the arm fell over.");
        let value = |name: &str, s: &Summary| run_facts(s).into_iter().find(|f| f.0 == name).map(|f| f.1);
        assert_eq!(value("error at the end", &summary).unwrap(), "unknown");
        assert_eq!((value("settling", &summary), value("state hash", &summary)), (None, None));
        summary.missed_deadlines = 3;
        assert_eq!(value("control ticks", &summary).unwrap(), "0, 3 deadlines missed, 0 of them skipped");
        assert_eq!((value("accuracy", &summary), value("description", &summary)), (None, None));
        let size = DescriptionError { key: "size".into(), described: 1.0, estimated: 1.04, sd: 0.002 };
        summary.contradicted.push(size);
        assert!(
            value("description", &summary)
                .unwrap()
                .starts_with("size looks like 1.0400 +- 0.0020 (told 1.0000)")
        );
        summary.final_errors.feature_error_px = Some(0.04567);
        assert_eq!(value("error at the end", &summary).unwrap(), "0.0457 px");
    }
}
