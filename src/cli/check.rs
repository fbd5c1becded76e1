//! `vservo check [CONFIG]`: what is wrong with a run file, and what a run of it has before it, in words or as JSON.

use super::{json, shown, warn};
use crate::config::assemble::require_controllable;
use crate::config::{Config, Draft, SetPointKind};
use crate::input::printable;
use crate::process::ProcessError;
use crate::rt::tell;
use crate::sim::preflight::{Preflight, Reach};
use serde::Serialize;
use std::borrow::Cow;
use std::path::Path;

/// What `--json` prints.
#[derive(Serialize)]
struct CheckAnswer<'a> {
    ok: bool,
    errors: Vec<String>,
    warnings: Vec<String>,
    #[serde(flatten)]
    preflight: &'a Preflight,
    #[serde(skip_serializing_if = "Option::is_none")]
    second_view: Option<&'a Preflight>,
}

/// # Errors
/// When the run file is wrong, or its run would be futile: the target cannot be found, the goal not be reached.
pub(super) fn check(path: Option<&Path>, set: &[String], as_json: bool) -> Result<u8, ProcessError> {
    let draft = Draft::load(path, set)?;
    // Of a run file that is wrong only in what is seen, the rest is told all the same.
    let (config, unseen) = match draft.clone().validate() {
        Ok(config) => (config, None),
        Err(error) => match draft.clone().validate_whatever_is_seen() {
            Ok(config) => (config, Some(error)),
            Err(_) => return Err(error.into()),
        },
    };
    require_controllable(&config)?;
    let preflight = Preflight::of(&config)?.with_names(&config)?;
    let second = second_preflight(&config)?;
    let (mut faults, mut doubts) = judged(&preflight);
    if let Some((of_faults, of_doubts)) = second.as_ref().map(judged) {
        faults.extend(of_second(of_faults));
        doubts.extend(of_second(of_doubts));
    }
    let core = config.realtime.request.cpu.and_then(crate::rt::why_not_on);
    faults.extend(core.map(|why| ("realtime.cpu".into(), why)));
    let error = unseen.or_else(|| (!faults.is_empty()).then(|| draft.error(faults)));
    let doubts = draft.problems_of(doubts);
    if as_json {
        let answer = CheckAnswer {
            ok: error.is_none(),
            errors: error.iter().flat_map(|error| error.lines()).collect(),
            warnings: config.warnings.iter().chain(&doubts).map(ToString::to_string).collect(),
            preflight: &preflight,
            second_view: second.as_ref(),
        };
        let code = shown(&json(&answer), 0);
        return error.map_or(Ok(code), |error| Err(error.into()));
    }
    if error.is_none() {
        warn(&config);
        for doubt in &doubts {
            tell(format_args!("vservo: warning: {}", printable(&doubt.to_string())));
        }
    }
    let mut lines = preflight.lines();
    if let (Some(second), Some(view)) = (&second, &config.second_view) {
        lines.push(format!("  second camera `{}`, weight {}:", view.cell.camera.name, view.weight));
        lines.append(&mut second.lines());
    }
    let what = lines.iter().map(|line| printable(line) + "\n").collect::<String>();
    match error {
        None => Ok(shown(&(first_line(path, &config) + &what), 0)),
        Some(error) => {
            shown(&what, 0);
            Err(error.into())
        }
    }
}

fn first_line(path: Option<&Path>, config: &Config) -> String {
    let (width_px, height_px) = config.camera.full_size_px();
    let of_whole = |region| format!("{region} of ");
    format!(
        "{}: ok: {} on {}, {}{width_px}x{height_px} px at {} Hz, {}\n",
        path.map_or_else(|| "default".to_owned(), |path| printable(&path.display().to_string())),
        config.scheme_name(),
        printable(&config.robot.name),
        config.camera.roi().map_or_else(String::new, of_whole),
        config.camera.rate_hz,
        config.clock_name()
    )
}

/// What the second of two cameras that control the arm has before it.
fn second_preflight(config: &Config) -> Result<Option<Preflight>, ProcessError> {
    Ok(config.second_view.as_ref().map(|view| Preflight::of(&view.cell)).transpose()?)
}

/// The same lines, of the second camera.
fn of_second(told: Told) -> Told {
    told.into_iter()
        .map(|(key, message)| (key, format!("of the second camera ([second_view]): {message}")))
        .collect()
}

/// The lines by key.
type Told = Vec<(Cow<'static, str>, String)>;

/// What makes the run futile, and what is only doubtful. Where the object moves by itself, nothing is certain.
fn judged(preflight: &Preflight) -> (Told, Told) {
    let (mut faults, mut doubts) = (preflight.faults(), preflight.doubts());
    if !preflight.object_rests {
        doubts.append(&mut faults);
    }
    (faults, doubts)
}

/// Tells before a run what `check` would refuse: the run itself goes on, because the cell may still be another one than it is thought to
/// be. Where it `refuses`, a desired pose that the arm cannot reach is an error.
///
/// # Errors
/// When an arm cannot be built, and for such a goal.
pub(super) fn warn_of_preflight(draft: &Draft, config: &Config, refuses: bool) -> Result<(), ProcessError> {
    let preflight = Preflight::of(config)?;
    let (mut faults, _) = judged(&preflight);
    if let Some(second) = second_preflight(config)? {
        faults.extend(of_second(judged(&second).0));
    }
    // The pose behind features is only as good as the lens; what was taught may be reached all the same.
    let is_pose = config.effective.servo.set_point.kind == SetPointKind::Pose;
    let is_beyond = is_pose && preflight.object_rests && matches!(preflight.reach, Reach::Beyond { .. });
    if refuses && is_beyond {
        faults
            .iter_mut()
            .for_each(|(_, message)| message.push_str(" (`vservo run --anyway` runs all the same)"));
        return Err(draft.error(faults).into());
    }
    faults.extend(preflight.covered.map(|message| ("scene".into(), message)));
    for problem in draft.problems_of(faults) {
        tell(format_args!("vservo: warning: {}", printable(&problem.to_string())));
    }
    Ok(())
}
