//! Programs: what `vservo do` has a running instance do, step by step. All of a file is read and checked before anything moves.

use super::named_goal::{ProgramGoal, TargetGoal};
use super::raw::{RawNamedGoal, RawPosture};
use super::source::Document;
use super::targets::unknown;
use super::wait_for::WaitFor;
use super::{ConfigError, Problem, check, tables};
use crate::input::{file, nearest, number};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;

/// Bounds of the times of a step, s. Chosen by hand: from the period at which a program looks, to a day.
const TIME_S: RangeInclusive<f64> = 0.1..=86_400.0;
/// How long a step may take where it does not say, s. Chosen: as long as a run takes at most where its file says nothing.
const USUAL_TIMEOUT_S: f64 = 30.0;
/// Most repetitions. Chosen by hand, more than a day of steps of a second.
const MAX_REPEAT: u32 = 100_000;
/// Steps within steps within steps. Chosen by hand, so that no depth can overflow the stack.
const DEEPEST: usize = 4;

/// A file as it is written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawProgram {
    goals: BTreeMap<String, RawNamedGoal>,
    postures: BTreeMap<String, RawPosture>,
    steps: Vec<RawStep>,
    on_fault: Vec<RawStep>,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawStep {
    goto: Option<String>,
    servo: Option<String>,
    target: Option<String>,
    for_s: Option<f64>,
    wait: Option<String>,
    wait_s: Option<f64>,
    call: Option<Vec<String>>,
    repeat: Option<u32>,
    steps: Vec<RawStep>,
    reset: Option<bool>,
    timeout_s: Option<f64>,
}

/// A program.
#[derive(Debug, Clone)]
pub struct Program {
    /// What it does.
    pub steps: Vec<ProgramStep>,
    /// What it does when one of these fails: a fault, a time that is over, a command that says no.
    pub on_fault: Vec<ProgramStep>,
    /// Its file, for what turns out to be wrong with it later.
    document: Document,
}

/// A step of a program.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgramStep {
    /// Its place in the file, as in `steps[2]`.
    pub key: String,
    /// What it does.
    pub action: StepAction,
    /// How long it may take, s; of `servo`, until the goal is reached.
    pub timeout_s: f64,
}

/// What a step does.
#[derive(Debug, Clone, PartialEq)]
pub enum StepAction {
    /// Moves the arm to a posture, rad or m, and holds it.
    Goto(String, Vec<f64>),
    /// Servoes to a goal until it is reached and held, and goes on for so many seconds.
    Servo(String, TargetGoal, f64),
    /// Waits.
    Wait(WaitFor),
    /// Waits for so many seconds.
    Pause(f64),
    /// Runs a program with its arguments; an exit code other than 0 fails.
    Call(Vec<String>),
    /// Does steps again and again.
    Repeat(u32, Vec<ProgramStep>),
    /// Clears a fault.
    Reset,
}

impl Program {
    /// Reads a file for a run whose file has the goals and postures `of_run`; those of the program itself go first.
    ///
    /// # Errors
    /// All that is wrong with it, each with line and key.
    pub fn load(path: &Path, of_run: NamedPlaces) -> Result<Self, ConfigError> {
        let name = path.display().to_string();
        let text = file::read(path, file::MAX_TOML).map_err(|e| {
            ConfigError::new(vec![Problem::of_file(&name, format!("cannot be read: {e}"))], 0)
        })?;
        Self::parse(&name, &text, path.parent().unwrap_or(Path::new("")), of_run)
    }

    /// Parses the text of a file whose paths are relative to `folder`.
    ///
    /// # Errors
    /// As for [`Self::load`].
    pub fn parse(name: &str, text: &str, folder: &Path, of_run: NamedPlaces) -> Result<Self, ConfigError> {
        let mut document = Document::parse(name, text)?;
        let mut problems = Vec::new();
        let (raw, more): (RawProgram, _) = tables::read(&mut document, &mut problems);
        let mut reader = ProgramReader { document: &document, folder, problems };
        let NamedPlaces { mut goals, mut postures, targets } = of_run;
        for (name, goal) in &raw.goals {
            goals.insert(name.clone(), reader.goal(name, goal, &targets));
        }
        for (name, posture) in &raw.postures {
            postures.insert(name.clone(), reader.posture(name, posture));
        }
        let names = NamedPlaces { goals, postures, targets };
        // Steps of which one is wrong are set aside, which was reported.
        if raw.steps.is_empty() && document.get("steps").is_none() && reader.problems.is_empty() {
            reader.wrong("steps", "a program needs a step: [[steps]]".into());
        }
        let steps = reader.steps("steps", &raw.steps, &names, 1);
        let on_fault = reader.steps("on_fault", &raw.on_fault, &names, 1);
        let problems = reader.problems;
        if problems.is_empty() {
            Ok(Self { steps, on_fault, document })
        } else {
            Err(ConfigError::new(problems, more))
        }
    }

    /// What a run finds wrong with values at keys of the file, as an error that names their positions.
    #[must_use]
    pub fn error(&self, found: Vec<(String, String)>) -> ConfigError {
        let problems = found.into_iter().map(|(key, message)| self.document.problem(&key, message));
        ConfigError::new(problems.collect(), 0)
    }

    /// All steps, those within others included.
    pub fn all_steps(&self) -> Vec<&ProgramStep> {
        fn walk<'a>(steps: &'a [ProgramStep], all: &mut Vec<&'a ProgramStep>) {
            for step in steps {
                all.push(step);
                if let StepAction::Repeat(_, inner) = &step.action {
                    walk(inner, all);
                }
            }
        }
        let mut all = Vec::new();
        walk(&self.steps, &mut all);
        walk(&self.on_fault, &mut all);
        all
    }
}

/// Goals, and joint positions (rad or m), by their names; `None` what is written, but wrong.
#[derive(Debug, Clone, Default)]
pub struct NamedPlaces {
    /// `[goals.NAME]`
    pub goals: BTreeMap<String, Option<TargetGoal>>,
    /// `[postures.NAME]`
    pub postures: BTreeMap<String, Option<Vec<f64>>>,
    /// Names of `[targets.NAME]`.
    pub targets: Vec<String>,
}

struct ProgramReader<'a> {
    document: &'a Document,
    folder: &'a Path,
    problems: Vec<Problem>,
}

impl ProgramReader<'_> {
    fn wrong(&mut self, key: &str, message: String) {
        self.problems.push(self.document.problem(key, message));
    }

    fn within(&mut self, key: &str, value: f64, allowed: &RangeInclusive<f64>) -> f64 {
        if !allowed.contains(&value) {
            let (low, high) = (number(*allowed.start()), number(*allowed.end()));
            self.wrong(key, format!("{} is out of range, allowed is {low} to {high}", number(value)));
        }
        value
    }

    fn goal(&mut self, name: &str, raw: &RawNamedGoal, targets: &[String]) -> Option<TargetGoal> {
        let (folder, key) = (self.folder, format!("goals.{name}"));
        let mut raw = raw.clone();
        raw.resolve(&key, self.document, |path| folder.join(path), &mut self.problems);
        self.check_target(&format!("{key}.target"), raw.target.as_deref(), targets);
        raw.goal(&key, &mut check::Validation::new(self.document, &mut self.problems))
    }

    fn check_target(&mut self, key: &str, name: Option<&str>, targets: &[String]) {
        if let Some(why) = name.and_then(|name| unknown(name, targets.iter().map(String::as_str))) {
            self.wrong(key, why);
        }
    }

    fn posture(&mut self, name: &str, raw: &RawPosture) -> Option<Vec<f64>> {
        let (folder, key) = (self.folder, format!("postures.{name}"));
        let mut raw = raw.clone();
        raw.resolve(&key, self.document, |path| folder.join(path), &mut self.problems);
        raw.posture(&key, &mut check::Validation::new(self.document, &mut self.problems))
    }

    fn steps(&mut self, key: &str, raw: &[RawStep], names: &NamedPlaces, depth: usize) -> Vec<ProgramStep> {
        let steps = raw.iter().enumerate();
        steps.filter_map(|(i, raw)| self.step(format!("{key}[{i}]"), raw, names, depth)).collect()
    }

    fn step(&mut self, key: String, raw: &RawStep, names: &NamedPlaces, depth: usize) -> Option<ProgramStep> {
        let is_written = [
            ("goto", raw.goto.is_some()),
            ("servo", raw.servo.is_some()),
            ("wait", raw.wait.is_some()),
            ("wait_s", raw.wait_s.is_some()),
            ("call", raw.call.is_some()),
            ("repeat", raw.repeat.is_some()),
            ("reset", raw.reset.is_some()),
        ];
        let written: Vec<_> =
            is_written.iter().filter(|(_, is_written)| *is_written).map(|(word, _)| *word).collect();
        let [word] = written[..] else {
            let words = is_written.map(|(word, _)| word).join(", ");
            self.wrong(&key, format!("a step has exactly one of {words}; this one has {}", written.len()));
            return None;
        };
        for (name, belongs, is_there) in [
            ("for_s", "servo", raw.for_s.is_some()),
            ("target", "servo", raw.target.is_some()),
            ("steps", "repeat", !raw.steps.is_empty()),
        ] {
            if is_there && word != belongs {
                self.wrong(&format!("{key}.{name}"), format!("goes with {belongs}, not with {word}"));
            }
        }
        if word == "wait_s" && raw.timeout_s.is_some() {
            self.wrong(
                &format!("{key}.timeout_s"),
                "does not go with wait_s, which says itself how long it takes".into(),
            );
        }
        // Repeated steps have times of their own, and a pause takes the time that it says.
        let has_own = ["repeat", "wait_s"].contains(&word);
        let usual = if has_own { f64::INFINITY } else { USUAL_TIMEOUT_S };
        let timeout_s = raw.timeout_s.map_or(usual, |s| self.within(&format!("{key}.timeout_s"), s, &TIME_S));
        let at = format!("{key}.{word}");
        let action = match word {
            "goto" => {
                let name = raw.goto.clone()?;
                let q = self.named(&at, &name, &names.postures, "postures")?;
                StepAction::Goto(name, q)
            }
            "servo" => {
                let (name, for_s) = (raw.servo.clone()?, raw.for_s.unwrap_or(0.0));
                self.within(&format!("{key}.for_s"), for_s, &(0.0..=*TIME_S.end()));
                self.check_target(&format!("{key}.target"), raw.target.as_deref(), &names.targets);
                let mut goal = if name == "present" {
                    TargetGoal { goal: ProgramGoal::Present, target: None }
                } else {
                    self.named(&at, &name, &names.goals, "goals")?
                };
                if let (Some(own), Some(other)) = (&goal.target, &raw.target)
                    && own != other
                {
                    self.wrong(&format!("{key}.target"), format!("`{name}` is a goal of the target `{own}`"));
                }
                goal.target = goal.target.or_else(|| raw.target.clone());
                StepAction::Servo(name, goal, for_s)
            }
            "wait" => match raw.wait.as_deref()?.parse() {
                Ok(what) => StepAction::Wait(what),
                Err(why) => {
                    self.wrong(&at, why);
                    return None;
                }
            },
            "wait_s" => StepAction::Pause(self.within(&at, raw.wait_s?, &TIME_S)),
            "call" => {
                let mut command = raw.call.clone()?;
                if let Some(why) = self.no_program(&command) {
                    self.wrong(&at, why);
                }
                if let Some(program) = command.first_mut().filter(|program| program.contains('/')) {
                    *program = self.folder.join(&*program).to_string_lossy().into_owned();
                }
                StepAction::Call(command)
            }
            "repeat" => {
                let count = raw.repeat?;
                if !(1..=MAX_REPEAT).contains(&count) {
                    self.wrong(&at, format!("{count} is out of range, allowed is 1 to {MAX_REPEAT}"));
                }
                if raw.steps.is_empty() {
                    self.wrong(&at, "needs steps = [{ ... }, { ... }]".into());
                }
                if depth >= DEEPEST {
                    self.wrong(&at, format!("lies in {depth} steps, at most {DEEPEST} are allowed"));
                    return None;
                }
                StepAction::Repeat(count, self.steps(&format!("{key}.steps"), &raw.steps, names, depth + 1))
            }
            _ => StepAction::Reset,
        };
        Some(ProgramStep { key, action, timeout_s })
    }

    /// What `name` names among `places`; of one that is wrong, that was reported.
    fn named<T: Clone>(
        &mut self,
        key: &str,
        name: &str,
        places: &BTreeMap<String, Option<T>>,
        table: &str,
    ) -> Option<T> {
        if let Some(place) = places.get(name) {
            return place.clone();
        }
        let meant = nearest(name, places.keys().map(String::as_str));
        let meant = meant.map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
        self.wrong(key, format!("`{name}` is not in [{table}] of this file or of the run file{meant}"));
        None
    }

    /// Why a command cannot be run: its program is not there.
    fn no_program(&self, command: &[String]) -> Option<String> {
        let Some(program) = command.first().filter(|program| !program.is_empty()) else {
            return Some("needs a program and its arguments, as in [\"gripper\", \"close\"]".into());
        };
        let is_there = if program.contains('/') {
            self.folder.join(program).is_file()
        } else {
            let path = std::env::var_os("PATH").unwrap_or_default();
            std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
        };
        (!is_there).then(|| {
            format!("there is no program `{program}`, neither in PATH nor, with a `/`, beside this file")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Program, String> {
        Program::parse("p.toml", text, Path::new("."), NamedPlaces::default()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_program_is_its_steps_with_their_names_resolved() {
        let text = "[postures.home]\nq_rad_or_m = [0.1, -0.2]\n\
                    [goals.pick]\nposition_m = [0, 0, 0.5]\nrotation_rpy_deg = [0, 0, 90]\n\
                    [[steps]]\ngoto = \"home\"\n[[steps]]\nrepeat = 3\nsteps = [{ servo = \"pick\", for_s = 1, timeout_s = 7 }, { call = [\"true\"] }]\n\
                    [[on_fault]]\nreset = true\n";
        let program = parse(text).unwrap();
        assert_eq!(program.steps[0].action, StepAction::Goto("home".into(), vec![0.1, -0.2]));
        let StepAction::Repeat(3, inner) = &program.steps[1].action else { panic!("{:?}", program.steps[1]) };
        let StepAction::Servo(name, goal, for_s) = &inner[0].action else { panic!() };
        let ProgramGoal::Pose(X_DO) = &goal.goal else { panic!() };
        assert_eq!((name.as_str(), *for_s, inner[0].timeout_s), ("pick", 1.0, 7.0));
        assert!((X_DO.rotation.angle().to_degrees() - 90.0).abs() < 1e-9);
        assert_eq!((program.on_fault[0].action.clone(), program.all_steps().len()), (StepAction::Reset, 5));
    }

    #[test]
    fn a_pause_and_a_repetition_have_no_time_of_their_own() {
        let of = |text: &str| parse(text).unwrap().steps[0].timeout_s;
        assert_eq!(of("[[steps]]\nwait_s = 40\n"), f64::INFINITY, "longer than other steps may take");
        assert_eq!(of("[[steps]]\nrepeat = 2\nsteps = [{ wait_s = 1 }]\n"), f64::INFINITY);
        assert_eq!(of("[[steps]]\nrepeat = 2\ntimeout_s = 3\nsteps = [{ wait_s = 1 }]\n"), 3.0);
        assert_eq!(of("[[steps]]\ncall = [\"true\"]\n"), USUAL_TIMEOUT_S);
        let told = parse("[[steps]]\nwait_s = 5\ntimeout_s = 2\n").unwrap_err();
        assert!(told.contains("p.toml:3:1: steps[0].timeout_s: does not go with wait_s"), "{told}");
    }

    #[test]
    fn all_that_is_wrong_is_told_with_line_and_key() {
        let text = "[postures.home]\nq_rad_or_m = []\n\
                    [goals.pick]\nposition_m = [0, 0, 500]\n\
                    [[steps]]\ngoto = \"hom\"\n\
                    [[steps]]\nservo = \"pick\"\ntimeout_s = 0\n\
                    [[steps]]\nwait_s = 1\nfor_s = 2\n\
                    [[steps]]\ncall = [\"no-such-program-anywhere\"]\n\
                    [[steps]]\nwait = \"state=dancing\"\n\
                    [[steps]]\ngoto = \"home\"\nservo = \"pick\"\n";
        let told = parse(text).unwrap_err();
        for line in [
            "p.toml:1:11: postures.home: needs either q_rad_or_m or file",
            "p.toml:4:21: goals.pick.position_m[2]: 500 is out of range",
            "p.toml:6:1: steps[0].goto: `hom` is not in [postures] of this file or of the run file; did you mean `home`?",
            "p.toml:9:1: steps[1].timeout_s: 0 is out of range",
            "p.toml:12:1: steps[2].for_s: goes with servo, not with wait_s",
            "p.toml:14:1: steps[3].call: there is no program `no-such-program-anywhere`",
            "p.toml:16:1: steps[4].wait: `dancing` is no state",
            "steps[5]: a step has exactly one of goto, servo",
        ] {
            assert!(told.contains(line), "{line}\n{told}");
        }
        assert!(parse("").unwrap_err().contains("a program needs a step"));
        let unknown = parse("[[steps]]\njump = 1\n").unwrap_err();
        assert!(
            unknown.contains("p.toml:2:") && unknown.contains("steps[0].jump: unknown field"),
            "{unknown}"
        );
    }
}
