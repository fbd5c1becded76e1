//! What a run would refuse of a program, found before its first step: all of it, each with its place in the file.

use super::{Client, RunAnswer};
use crate::config::{Program, ProgramStep, StepAction};
use crate::input::number;
use crate::ipc::Role;
use crate::messages::ControlState;
use crate::process::ProcessError;

/// Refuses a program that this run cannot do: postures of another arm or beyond a limit, goals of another target or that no camera could see there, a run that
/// does not stay.
///
/// # Errors
/// All that is wrong, with line and key; as for [`Client::status`] where the run does not answer.
pub(super) fn examine(client: &Client, program: &Program) -> Result<(), ProcessError> {
    let status = client.status()?;
    if status.served != Some(true) {
        let why = "this run ends at its goal: a program needs one of `vservo serve`";
        return Err(ProcessError::NoCommand(why.into()));
    }
    let joints = Joints::of(client, &status);
    let examining = client.examining();
    let mut ask = |step: &StepAction, from: Option<&[f64]>| match step {
        StepAction::Goto(_, q) => match joints.refuse(q) {
            Some(why) => Ok(Some(why)),
            None => refused(examining.goto(&[from.unwrap_or_default(), q].concat())),
        },
        StepAction::Servo(_, goal, _) => refused(examining.goal_of_program(goal)),
        _ => Ok(None),
    };
    let stands = [ControlState::Idle, ControlState::Held].iter().any(|state| state.as_str() == status.state);
    let mut found = Vec::new();
    let from = stands.then(|| status.q_rad_or_m.clone());
    walk(&program.steps, from, &mut ask, &mut found)?;
    walk(&program.on_fault, None, &mut ask, &mut found)?;
    if found.is_empty() { Ok(()) } else { Err(program.error(found).into()) }
}

/// Why something was refused; what is no command is refused, too.
fn refused(answer: Result<RunAnswer, ProcessError>) -> Result<Option<String>, ProcessError> {
    match answer {
        Ok(answer) => Ok(answer.reason.map(Into::into)),
        Err(ProcessError::NoCommand(why)) => Ok(Some(why)),
        Err(error) => Err(error),
    }
}

/// Why a step would be refused where the arm stands before it in this posture, rad or m.
type AskOfStep<'a> = dyn FnMut(&StepAction, Option<&[f64]>) -> Result<Option<String>, ProcessError> + 'a;

/// Asks `ask` of each step, with the posture in which the arm stands before it where that is known, and adds what it says to `found`, with its key. Gives the
/// posture behind the last step.
fn walk(
    steps: &[ProgramStep],
    mut from: Option<Vec<f64>>,
    ask: &mut AskOfStep<'_>,
    found: &mut Vec<(String, String)>,
) -> Result<Option<Vec<f64>>, ProcessError> {
    for step in steps {
        let (word, name) = match &step.action {
            StepAction::Goto(name, _) => ("goto", name.as_str()),
            StepAction::Servo(name, ..) => ("servo", name.as_str()),
            StepAction::Repeat(count, steps) => {
                from = walk(steps, from, ask, found)?;
                // The second round begins where the first one ended, and so do all others.
                if *count > 1 {
                    from = walk(steps, from, ask, found)?;
                }
                continue;
            }
            // An arm that stands goes on standing.
            StepAction::Pause(_) | StepAction::Call(_) => continue,
            StepAction::Wait(_) | StepAction::Reset => {
                from = None;
                continue;
            }
        };
        if let Some(why) = ask(&step.action, from.as_deref())? {
            let told = (format!("{}.{word}", step.key), format!("`{name}`: {why}"));
            if !found.contains(&told) {
                found.push(told);
            }
        }
        from = if let StepAction::Goto(_, q) = &step.action { Some(q.clone()) } else { None };
    }
    Ok(from)
}

/// The arm's joints, as far as the run tells of them.
struct Joints {
    count: usize,
    names: Vec<String>,
    ranges_rad_or_m: Vec<[Option<f64>; 2]>,
}

impl Joints {
    fn of(client: &Client, status: &RunAnswer) -> Self {
        let agreement = client.instance().agreement_of(Role::Control).unwrap_or_default();
        let text = |key: &str| agreement.get(key).map_or("", String::as_str);
        Self {
            count: status.q_rad_or_m.len(),
            names: serde_json::from_str(text("robot.joints")).unwrap_or_default(),
            ranges_rad_or_m: serde_json::from_str(text("robot.ranges_rad_or_m")).unwrap_or_default(),
        }
    }

    /// Why the arm cannot be at `q`, rad or m, by the number and the ranges of its joints.
    fn refuse(&self, q: &[f64]) -> Option<String> {
        if q.len() != self.count {
            return Some(format!("has {} joints, the arm {}", q.len(), self.count));
        }
        let places = self.names.iter().zip(&self.ranges_rad_or_m).zip(q);
        let told = places.filter_map(|((name, [lower, upper]), q)| {
            let is_within = lower.is_none_or(|lower| *q >= lower) && upper.is_none_or(|upper| *q <= upper);
            let end = |end: &Option<f64>| end.map_or("no end".to_owned(), number);
            let (lower, upper) = (end(lower), end(upper));
            let at = number(*q);
            (!is_within)
                .then(|| format!("the joint `{name}` would be at {at}, its range is {lower} to {upper}"))
        });
        let told: Vec<_> = told.collect();
        (!told.is_empty()).then(|| told.join("; "))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::NamedPlaces;
    use std::path::Path;

    fn program(text: &str) -> Program {
        Program::parse("p.toml", text, Path::new("."), NamedPlaces::default()).unwrap()
    }

    const NAMES: &str = "[postures.a]\nq_rad_or_m = [1.0]\n[postures.b]\nq_rad_or_m = [2.0]\n\
                         [goals.g]\nposition_m = [0, 0, 0.5]\n";

    #[test]
    fn all_that_a_run_refuses_is_found_before_the_first_step() {
        let program = program(&format!(
            "{NAMES}[[steps]]\ngoto = \"a\"\n\
             [[steps]]\nrepeat = 3\nsteps = [{{ servo = \"g\" }}, {{ repeat = 2, steps = [{{ goto = \"b\" }}] }}]\n\
             [[on_fault]]\nreset = true\n[[on_fault]]\ngoto = \"b\"\n"
        ));
        let mut found = Vec::new();
        let mut ask = |step: &StepAction, _: Option<&[f64]>| {
            let is_good = matches!(step, StepAction::Goto(name, _) if name == "a");
            Ok((!is_good).then(|| "no".to_owned()))
        };
        walk(&program.steps, None, &mut ask, &mut found).unwrap();
        walk(&program.on_fault, None, &mut ask, &mut found).unwrap();
        let told = program.error(found).to_string();
        let lines: Vec<_> = told.lines().collect();
        assert_eq!(
            lines,
            [
                "p.toml:11:12: steps[1].steps[0].servo: `g`: no",
                "p.toml:11:52: steps[1].steps[1].steps[0].goto: `b`: no",
                "p.toml:15:1: on_fault[1].goto: `b`: no",
            ]
        );
    }

    #[test]
    fn a_way_is_looked_at_where_its_begin_is_known() {
        let ways = |steps: &str| {
            let mut ways = Vec::new();
            let mut ask = |step: &StepAction, from: Option<&[f64]>| {
                if let StepAction::Goto(_, q) = step {
                    ways.push((from.map(|q| q[0]), q[0]));
                }
                Ok(None)
            };
            let program = program(&format!("{NAMES}{steps}"));
            walk(&program.steps, Some(vec![0.0]), &mut ask, &mut Vec::new()).unwrap();
            ways
        };
        let [a, b] = ["[[steps]]\ngoto = \"a\"\n", "[[steps]]\ngoto = \"b\"\n"];
        let pause = "[[steps]]\nwait_s = 1\n";
        assert_eq!(ways(&format!("{a}{pause}{b}")), [(Some(0.0), 1.0), (Some(1.0), 2.0)]);
        assert_eq!(ways(&format!("{a}[[steps]]\nservo = \"g\"\n{b}")), [(Some(0.0), 1.0), (None, 2.0)]);
        let round = "[[steps]]\nrepeat = 5\nsteps = [{ goto = \"a\" }, { goto = \"b\" }]\n";
        assert_eq!(
            ways(round),
            [(Some(0.0), 1.0), (Some(1.0), 2.0), (Some(2.0), 1.0), (Some(1.0), 2.0)],
            "the second round begins where the first one ended"
        );
    }

    #[test]
    fn joints_beyond_their_ranges_are_told_by_name() {
        let names = ["base", "lift", "turn"].map(ToOwned::to_owned).to_vec();
        let ranges_rad_or_m = vec![[Some(-1.0), Some(1.0)], [None, Some(0.5)], [None, None]];
        let joints = Joints { count: 3, names, ranges_rad_or_m };
        assert_eq!(joints.refuse(&[1.0, -90.0, 50.0]), None);
        let told = joints.refuse(&[-1.5, 0.7, 0.0]).unwrap();
        assert_eq!(
            told,
            "the joint `base` would be at -1.5, its range is -1 to 1; the joint `lift` would be at 0.7, its range is no end to 0.5"
        );
        assert_eq!(joints.refuse(&[0.0]).unwrap(), "has 1 joints, the arm 3");
    }
}
