//! The arguments of `vservo ctl`.

use crate::client::WaitFor;
use clap::{Args, Subcommand};

/// Arguments of `vservo ctl`.
#[derive(Debug, Args)]
pub struct CtlArguments {
    /// What to do
    #[command(subcommand)]
    pub what: CtlCommand,
    /// Which run, and how it answers
    #[command(flatten)]
    pub common: CtlCommon,
}

/// Which run is asked, and how it answers.
#[derive(Debug, Args)]
pub struct CtlCommon {
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default", global = true)]
    pub instance: String,
    /// Print the answer as JSON
    #[arg(long, global = true)]
    pub json: bool,
    /// How long to wait for the answer, s (5 where it is left out); of `wait`, how long at most (30)
    #[arg(long, value_name = "S", global = true)]
    pub timeout_s: Option<f64>,
}

/// Requests to control.
#[derive(Debug, Subcommand)]
pub enum CtlCommand {
    /// Say how it stands
    Status,
    /// Go for the goal
    Start,
    /// Stand until the next start
    Hold,
    /// Make what the camera sees the goal; the arm stands
    Teach,
    /// Forget the fault
    Reset,
    /// Stand, and be idle
    Stop,
    /// Stop, and end the run
    Shutdown,
    /// Wait until the goal is reached and held, the view is lost, there is a fault, or control is in a state: exit code 0; 5 when the time
    /// is over, or when it ends otherwise, with what is there instead
    Wait {
        /// converged, holding, fault, or state=NAME
        what: WaitFor,
    },
}
