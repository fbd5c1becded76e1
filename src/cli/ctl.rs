//! `vservo ctl`: one request to a running instance, and its answer.

use super::ctl_arguments::{CtlArguments, CtlCommand};
use super::{json, shown};
use crate::client::{Client, RunAnswer, USUAL_WAIT_S, WaitEnd, WaitFor};
use crate::control::outcome::Outcome;
use crate::input::printable;
use crate::process::{ProcessError, StopFlag};
use crate::rt::tell;

/// The exit code of what was refused, or was not reached.
fn in_vain() -> u8 {
    Outcome::NotConverged.exit_code()
}

/// Asks, and tells the answer. The exit code: 5 where control refuses, and where a wait ends in vain.
pub(super) fn ctl(arguments: &CtlArguments) -> Result<u8, ProcessError> {
    let common = &arguments.common;
    if let Some(timeout_s) = common.timeout_s {
        Client::check_timeout_s(timeout_s)?;
    }
    let client = Client::connect(&common.instance)?.interrupted_by(StopFlag::on_signals()?);
    if let CtlCommand::Wait { what } = &arguments.what {
        let end = client.wait(*what, common.timeout_s.unwrap_or(USUAL_WAIT_S))?;
        return Ok(told_wait(*what, &end, common.json));
    }
    let client = match common.timeout_s {
        Some(timeout_s) => client.with_timeout_s(timeout_s)?,
        None => client,
    };
    let answer = match &arguments.what {
        CtlCommand::Status | CtlCommand::Wait { .. } => client.status(),
        CtlCommand::Start => client.start(),
        CtlCommand::Hold => client.hold(),
        CtlCommand::Teach => client.teach(),
        CtlCommand::Reset => client.reset(),
        CtlCommand::Stop => client.stop(),
        CtlCommand::Shutdown => client.shutdown(),
    }?;
    Ok(told(&answer, common.json))
}

fn told(answer: &RunAnswer, as_json: bool) -> u8 {
    let exit_code = if answer.accepted { 0 } else { in_vain() };
    if let Some(reason) = answer.reason {
        tell(format_args!("vservo: {} was refused: {reason}", answer.request));
    }
    if as_json {
        shown(&json(answer), exit_code)
    } else if answer.accepted {
        shown(&answer.line(), exit_code)
    } else {
        exit_code
    }
}

fn told_wait(what: WaitFor, end: &WaitEnd, as_json: bool) -> u8 {
    let exit_code = if end.is_reached { 0 } else { in_vain() };
    if !end.is_reached {
        tell(format_args!("vservo: {what} was not reached: {}", printable(&end.reason)));
    }
    match &end.status {
        _ if as_json => shown(&json(end), exit_code),
        Some(status) if end.is_reached => shown(&status.line(), exit_code),
        _ => exit_code,
    }
}
