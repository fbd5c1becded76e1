//! The targets of a run: which there are, and goals of a certain one.

use super::{Client, RunAnswer};
use crate::config::FIRST_TARGET;
use crate::control::lifecycle::Request;
use crate::input::nearest;
use crate::ipc::{Instance, Role};
use crate::messages::ControlCommand;
use crate::process::ProcessError;

/// A target of the run's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunTarget {
    /// Its name.
    pub name: String,
    /// The word for its kind.
    pub kind: String,
}

impl RunTarget {
    /// Its table in the run file.
    pub(super) fn key(&self) -> String {
        if self.name == FIRST_TARGET { FIRST_TARGET.to_owned() } else { format!("targets.{}", self.name) }
    }
}

/// What is read of a target.
#[derive(serde::Deserialize)]
struct KindOfTarget {
    kind: String,
}

impl Client {
    /// The targets of the run, by their numbers; none where control does not run.
    #[must_use]
    pub fn targets(&self) -> Vec<RunTarget> {
        targets_of(self.instance())
    }

    /// The same client, whose goals are of the target `name` from now on: with them vision looks for that one.
    ///
    /// # Errors
    /// When the run file has no target of this name; the error names those that there are.
    pub fn of_target(self, name: &str) -> Result<Self, ProcessError> {
        let targets = self.targets();
        let names = targets.iter().map(|target| target.name.as_str());
        if let Some(number) = names.clone().position(|one| one == name) {
            return Ok(Self { target: number as u32 + 1, ..self });
        }
        let meant =
            nearest(name, names.clone()).map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
        let there = names.collect::<Vec<_>>().join(", ");
        Err(ProcessError::NoCommand(format!(
            "`{name}` is no target of the run file; there are {there}{meant}"
        )))
    }

    pub(super) fn of_first_target(self) -> Self {
        Self { target: 1, ..self }
    }

    /// Looks for the target `name` from now on, with the last goal that it had; before the first one that is the desired view of the run file.
    ///
    /// # Errors
    /// As for [`Self::status`] and [`Self::of_target`].
    pub fn look_for(&self, name: &str) -> Result<RunAnswer, ProcessError> {
        self.clone().of_target(name)?.last_goal()
    }

    pub(super) fn last_goal(&self) -> Result<RunAnswer, ProcessError> {
        self.send(Request::Goal, ControlCommand::of(Request::Goal as u32))
    }

    /// The target of the goals that this client sets.
    pub(super) fn present_target(&self) -> Result<Option<RunTarget>, ProcessError> {
        let targets = self.targets();
        let number = match self.target.checked_sub(1) {
            Some(number) => number,
            None if targets.len() < 2 => 0,
            None => self.status()?.target_number.unwrap_or(0),
        };
        Ok(targets.into_iter().nth(number as usize))
    }
}

/// The targets of a run of `instance`, by their numbers.
pub(super) fn targets_of(instance: &Instance) -> Vec<RunTarget> {
    let agreement = instance.agreement_of(Role::Control).unwrap_or_default();
    let first = agreement
        .get("target.kind")
        .map(|kind| RunTarget { name: FIRST_TARGET.to_owned(), kind: kind.trim_matches('"').to_owned() });
    // Their keys are in the order of the names, as the targets are.
    let further = agreement.iter().filter_map(|(key, text)| {
        let KindOfTarget { kind } = serde_json::from_str(text).ok()?;
        Some(RunTarget { name: key.strip_prefix("targets.")?.to_owned(), kind })
    });
    first.into_iter().chain(further).collect()
}
