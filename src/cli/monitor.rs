//! `vservo monitor`: a running instance in this terminal.

use super::completion;
use super::record::config_of_run;
use super::watched_run::WatchedRun;
use crate::client::Client;
use crate::monitor::{CellFacts, MonitorKeys, MonitorOrder, RunView, draw};
use crate::process::{ProcessError, StopFlag};
use crate::rt::{Terminal, now};
use clap::Args;
use clap_complete::engine::ArgValueCompleter;
use std::path::PathBuf;
use std::time::Duration;

/// Period of the screen. Chosen by hand: twenty a second look continuous, and take 1 to 2 % of a core.
const SCREEN_PERIOD: Duration = Duration::from_millis(50);

/// Arguments of `vservo monitor`.
#[derive(Debug, Args)]
pub struct MonitorArguments {
    /// Run file of the processes, where no supervisor left it
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Shows a run until the user leaves; the exit code.
pub(super) fn monitor(arguments: &MonitorArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let client = Client::connect(&arguments.instance)?;
    let config = config_of_run(arguments.config.as_deref(), &[], client.instance())?;
    let mut view = RunView::new(CellFacts::of(client.instance(), &config));
    let mut run = Some(WatchedRun::join(client, config)?);
    let terminal = Terminal::take().ok_or(ProcessError::NoTerminal)?;
    let (mut keys, mut shown) = (MonitorKeys::default(), None);
    while !stop.is_requested() {
        let time = now();
        if let Some(watched) = &mut run
            && !watched.take_all(&mut view, time, &mut |_| {})?
        {
            view.end("the run has ended; q leaves");
            run = None;
        }
        let screen = draw(&view, time, keys.asks(), terminal.size());
        // What the terminal did not take is written anew.
        shown = terminal.write(&screen.changes(shown.as_ref())).then_some(screen);
        let Some(typed) = terminal.keys(SCREEN_PERIOD) else { break };
        for order in typed.into_iter().filter_map(|byte| keys.press(byte)) {
            if order == MonitorOrder::Quit {
                return Ok(0);
            }
            if let Some(watched) = &run {
                view.say(format!("{}: asked", order.as_str()));
                watched.ask(order);
            }
        }
    }
    Ok(0)
}
