//! Requests that carry numbers: goals, postures, small motions, settings.

use super::{Client, RunAnswer, WaitFor};
use crate::config::{
    FIRST_TARGET, GoalFeature, GoalFile, NamedPlaces, ProgramGoal, RawNamedGoal, RawPosture, TargetGoal,
};
use crate::control::lifecycle::{Refusal, Request};
use crate::geometry::Pose;
use crate::input::nearest;
use crate::ipc::Role;
use crate::messages::{CommandForm, ControlCommand, ControlState};
use crate::process::ProcessError;
use crate::scene::sight_angle_rad;
use nalgebra::Vector3;
use serde::de::DeserializeOwned;
use std::path::Path;

/// What may be set in a running loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// Gain of a resolved-velocity law, 1/s (`servo.gain_1_s`).
    Gain,
    /// Feature error at which the goal counts as reached, px (`goal.feature_error_px`).
    Tolerance,
    /// Time for which the goal must be held, s (`goal.hold_s`).
    Hold,
}

impl Setting {
    fn form(self) -> CommandForm {
        match self {
            Self::Gain => CommandForm::Gain,
            Self::Tolerance => CommandForm::Tolerance,
            Self::Hold => CommandForm::Hold,
        }
    }
}

impl Client {
    /// Makes the features of a file of `vservo teach` or `vservo ctl teach --save` the goal.
    ///
    /// # Errors
    /// As for [`Self::status`], and when the file cannot be read or is of another target than the run's.
    pub fn goal_file(&self, path: &Path) -> Result<RunAnswer, ProcessError> {
        let goal = GoalFile::load(path).map_err(ProcessError::NoCommand)?;
        self.goal(&goal).map_err(|error| match error {
            ProcessError::NoCommand(why) => ProcessError::NoCommand(format!("{}: {why}", path.display())),
            other => other,
        })
    }

    /// Makes the goal that the run file has under `name` the goal (`[goals.NAME]`).
    ///
    /// # Errors
    /// As for [`Self::status`], and when the run file has none of this name.
    pub fn goal_named(&self, name: &str) -> Result<RunAnswer, ProcessError> {
        let raw: RawNamedGoal = self.named("goals", name)?;
        match raw.checked() {
            Some(goal) => self.goal_of_program(&goal).map_err(|error| match error {
                ProcessError::NoCommand(why) => ProcessError::NoCommand(format!("goals.{name}: {why}")),
                other => other,
            }),
            None => Err(ProcessError::NoCommand(format!("`{name}` of the run file is no goal"))),
        }
    }

    /// Makes `goal` the goal; where it is the present one nothing changes.
    pub(super) fn goal_of_program(&self, of: &TargetGoal) -> Result<RunAnswer, ProcessError> {
        let client = match &of.target {
            Some(name) => self.clone().of_target(name)?,
            None if self.target == 0 && of.goal != ProgramGoal::Present => self.clone().of_first_target(),
            None => self.clone(),
        };
        if let Some(name) = of.target.as_ref().filter(|_| self.target != 0 && self.target != client.target) {
            return Err(ProcessError::NoCommand(format!("is a goal of the target `{name}`")));
        }
        match &of.goal {
            ProgramGoal::Present if client.target == 0 => client.status(),
            ProgramGoal::Present => client.last_goal(),
            ProgramGoal::Taught(goal) => client.goal(goal),
            ProgramGoal::Pose(X_DO) => client.goal_pose(X_DO),
        }
    }

    /// The goals and postures that the run file has names for; none where control does not run.
    #[must_use]
    pub fn named_places(&self) -> NamedPlaces {
        let targets = self.targets().into_iter().skip(1).map(|target| target.name).collect();
        let mut places = NamedPlaces { targets, ..NamedPlaces::default() };
        for (key, text) in self.instance().agreement_of(Role::Control).unwrap_or_default() {
            // What is none, as of another version, has no name here: a program that uses it is told so.
            if let Some(name) = key.strip_prefix("goals.") {
                let goal = serde_json::from_str(&text).ok().and_then(RawNamedGoal::checked);
                places.goals.extend(goal.map(|goal| (name.to_owned(), Some(goal))));
            } else if let Some(name) = key.strip_prefix("postures.") {
                let posture = serde_json::from_str(&text).ok().map(|posture: RawPosture| posture.q_rad_or_m);
                places.postures.extend(posture.map(|posture| (name.to_owned(), Some(posture))));
            }
        }
        places
    }

    /// Moves the arm to the posture that the run file has under `name` (`[postures.NAME]`), and holds it there.
    ///
    /// # Errors
    /// As for [`Self::status`], and when the run file has none of this name.
    pub fn goto_named(&self, name: &str) -> Result<RunAnswer, ProcessError> {
        let raw: RawPosture = self.named("postures", name)?;
        self.goto(&raw.q_rad_or_m)
    }

    /// What `place` names: the goal of the run file of this name, where it is a word and there is no such file, or a file.
    ///
    /// # Errors
    /// As for [`Self::goal_named`] and [`Self::goal_file`].
    pub fn goal_at(&self, place: &Path) -> Result<RunAnswer, ProcessError> {
        match word(place) {
            Some(name) => self.goal_named(name),
            None => self.goal_file(place),
        }
    }

    /// The same of a posture.
    ///
    /// # Errors
    /// As for [`Self::goto_named`] and [`Self::goto_file`].
    pub fn goto_at(&self, place: &Path) -> Result<RunAnswer, ProcessError> {
        match word(place) {
            Some(name) => self.goto_named(name),
            None => self.goto_file(place),
        }
    }

    /// What stands under `name` in `table` of the run file.
    fn named<T: DeserializeOwned>(&self, table: &str, name: &str) -> Result<T, ProcessError> {
        let agreement = self.instance().agreement_of(Role::Control).unwrap_or_default();
        if let Some(value) =
            agreement.get(&format!("{table}.{name}")).and_then(|text| serde_json::from_str(text).ok())
        {
            return Ok(value);
        }
        let prefix = format!("{table}.");
        let names: Vec<&str> = agreement.keys().filter_map(|key| key.strip_prefix(&prefix)).collect();
        let meant = match (nearest(name, names.iter().copied()), names.as_slice()) {
            (Some(meant), _) => format!("; did you mean `{meant}`?"),
            (None, []) => format!("; the run file has no [{table}.NAME]"),
            (None, names) => format!("; there are {}", names.join(", ")),
        };
        Err(ProcessError::NoCommand(format!(
            "`{name}` is no file, and not in [{table}] of the run file{meant}"
        )))
    }

    /// Makes the features of `goal` the goal.
    ///
    /// # Errors
    /// As for [`Self::status`], and when it is of another target than the run's.
    pub fn goal(&self, goal: &GoalFile) -> Result<RunAnswer, ProcessError> {
        if let Some(name) = goal.target_name.as_ref().filter(|_| self.target == 0) {
            let of_its_target = self.clone().of_target(name)?;
            return of_its_target.goal(goal);
        }
        if let Some(target) = self.present_target()?.filter(|target| target.kind != goal.target) {
            let (key, kind) = (target.key(), &target.kind);
            let why =
                format!("is of a target of kind \"{}\", {key}.kind of the run is \"{kind}\"", goal.target);
            return Err(ProcessError::NoCommand(why));
        }
        let s: Vec<f64> = goal.features.iter().flat_map(|feature| feature.s).collect();
        let mut command = with_numbers(Request::Goal, CommandForm::Features, &s)?;
        command.ids.iter_mut().zip(&goal.features).for_each(|(place, feature)| *place = feature.id);
        self.send(Request::Goal, command)
    }

    /// Makes the view with the target at `X_DO` in the camera the goal.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn goal_pose(&self, X_DO: &Pose) -> Result<RunAnswer, ProcessError> {
        let (p, q) = (X_DO.translation.vector, X_DO.rotation.coords);
        let numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w];
        let mut answer =
            self.send(Request::Goal, with_numbers(Request::Goal, CommandForm::Pose, &numbers)?)?;
        let of_angle = [Refusal::EdgeOn, Refusal::FromBehind].map(Refusal::describe);
        if let Some(reason) = answer.reason.as_mut().filter(|reason| of_angle.contains(&reason.as_ref())) {
            let deg = sight_angle_rad(X_DO).to_degrees();
            *reason = format!("{reason} (its plane would be seen {deg:.1} deg off its normal)").into();
        }
        Ok(answer)
    }

    /// Moves the arm to the posture `q`, rad or m, and holds it there.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn goto(&self, q: &[f64]) -> Result<RunAnswer, ProcessError> {
        self.send(Request::Goto, with_numbers(Request::Goto, CommandForm::Joints, q)?)
    }

    /// The same to the posture in which the goal of a file was taught.
    ///
    /// # Errors
    /// As for [`Self::status`], and when the file cannot be read or has no posture.
    pub fn goto_file(&self, path: &Path) -> Result<RunAnswer, ProcessError> {
        let goal = GoalFile::load(path).map_err(ProcessError::NoCommand)?;
        if goal.q_rad_or_m.is_empty() {
            let why = "has no q_rad_or_m: `vservo ctl teach --save FILE` writes the posture beside the goal";
            return Err(ProcessError::NoCommand(format!("{}: {why}", path.display())));
        }
        self.goto(&goal.q_rad_or_m)
    }

    /// Moves each joint by `dq`, rad or m, and holds it there.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn jog_joints(&self, dq: &[f64]) -> Result<RunAnswer, ProcessError> {
        self.send(Request::Jog, with_numbers(Request::Jog, CommandForm::Joints, dq)?)
    }

    /// Moves the camera by `position_m` and by the rotation vector `rotation_rad`, both in its own frame, and holds it there.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn jog_camera(
        &self,
        position_m: &Vector3<f64>,
        rotation_rad: &Vector3<f64>,
    ) -> Result<RunAnswer, ProcessError> {
        let (p, r) = (position_m, rotation_rad);
        let numbers = [p.x, p.y, p.z, r.x, r.y, r.z];
        self.send(Request::Jog, with_numbers(Request::Jog, CommandForm::CameraMotion, &numbers)?)
    }

    /// Changes what may change in a running loop.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn set(&self, setting: Setting, value: f64) -> Result<RunAnswer, ProcessError> {
        self.send(Request::Set, with_numbers(Request::Set, setting.form(), &[value])?)
    }

    /// Teaches, waits until the goal is taught, and returns it with the arm's posture; a refusal is the `Err` of the result.
    ///
    /// # Errors
    /// As for [`Self::wait`].
    pub fn taught(&self, timeout_s: f64) -> Result<Result<GoalFile, String>, ProcessError> {
        let answer = self.teach()?;
        if let Some(reason) = answer.reason {
            return Ok(Err(reason.into_owned()));
        }
        let end = self.wait(WaitFor::State(ControlState::Held), timeout_s)?;
        let Some(status) = end.status.filter(|_| end.is_reached) else { return Ok(Err(end.reason)) };
        if status.goal == answer.goal {
            return Ok(Err("teaching was given up".to_owned()));
        }
        let feature = |(id, s): &(u32, [f64; 2])| GoalFeature { id: *id, s: *s, px: None, spread_px: None };
        let target = self.targets().into_iter().nth(status.target_number.unwrap_or(0) as usize);
        Ok(Ok(GoalFile {
            target_name: target
                .as_ref()
                .filter(|target| target.name != FIRST_TARGET)
                .map(|target| target.name.clone()),
            target: target.map(|target| target.kind).unwrap_or_default(),
            measurements: None,
            q_rad_or_m: status.q_rad_or_m,
            thumbnail: None,
            pose: None,
            features: status.goal_points.iter().map(feature).collect(),
        }))
    }

    pub(super) fn send(&self, request: Request, command: ControlCommand) -> Result<RunAnswer, ProcessError> {
        let target = if request == Request::Goal { self.target } else { 0 };
        let command = ControlCommand { target, ..command };
        if self.examines {
            return self.answer(Some(request), ControlCommand { request: 0, ..command });
        }
        self.ask_with(Some(request), command)
    }

    /// The same client, whose goals and postures are only examined: the answer tells whether they would be refused, and nothing changes.
    pub(super) fn examining(&self) -> Self {
        Self { examines: true, ..self.clone() }
    }
}

/// `place`, where it is a name and no file.
fn word(place: &Path) -> Option<&str> {
    let is_word = place.extension().is_none() && place.components().count() == 1 && !place.exists();
    place.to_str().filter(|_| is_word)
}

pub(super) fn with_numbers(
    request: Request,
    form: CommandForm,
    numbers: &[f64],
) -> Result<ControlCommand, ProcessError> {
    ControlCommand::with_numbers(request as u32, form, numbers).ok_or_else(|| {
        ProcessError::NoCommand(format!("{} numbers are more than a request carries", numbers.len()))
    })
}
