//! `vservo monitor`: a running instance in this terminal.

use super::completion;
use super::record::config_of_run;
use crate::client::{Client, RunAnswer, RunWatch};
use crate::config::Config;
use crate::input::printable;
use crate::monitor::{CellFacts, MonitorKeys, MonitorOrder, RunView, draw};
use crate::process::{ProcessError, StopFlag};
use crate::rt::{Terminal, now};
use crate::time::{MonoNs, SpanNs};
use clap::Args;
use clap_complete::engine::ArgValueCompleter;
use nalgebra::Vector2;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Period of the screen. Chosen by hand: twenty a second look continuous, and take 1 to 2 % of a core.
const SCREEN_PERIOD: Duration = Duration::from_millis(50);
/// Period at which it looks whether control is still there. Chosen by hand: it costs some system calls.
const PRESENCE_PERIOD: SpanNs = SpanNs(250_000_000);

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
    let instance = client.instance().clone();
    let config = config_of_run(arguments.config.as_deref(), &[], &instance)?;
    let watch = RunWatch::join(&instance, &config)?;
    // Who asks leaves before who watches, which removes what is left.
    let mut run = Some((Asker::start(client)?, watch));
    let mut view = RunView::new(CellFacts::of(&instance, &config));
    let terminal = Terminal::take().ok_or(ProcessError::NoTerminal)?;
    let (mut keys, mut shown, mut next_look) = (MonitorKeys::default(), None, MonoNs::ZERO);
    while !stop.is_requested() {
        let time = now();
        if let Some((asker, watch)) = &run {
            if watch.take_all(&mut view, time)? {
                asker.ask(None);
            }
            while let Ok((order, answer)) = asker.answers.try_recv() {
                take_answer(&mut view, &config, order, answer);
            }
            let looks = time >= next_look;
            next_look = if looks { time + PRESENCE_PERIOD } else { next_look };
            if looks && !watch.is_there() {
                watch.take_all(&mut view, time)?;
                view.end("the run has ended; q leaves");
                run = None;
            }
        }
        let screen = draw(&view, time, keys.asks(), terminal.size());
        // What the terminal did not take is written anew.
        shown = terminal.write(&screen.changes(shown.as_ref())).then_some(screen);
        let Some(typed) = terminal.keys(SCREEN_PERIOD) else { break };
        for order in typed.into_iter().filter_map(|byte| keys.press(byte)) {
            if order == MonitorOrder::Quit {
                return Ok(0);
            }
            if let Some((asker, _)) = &run {
                view.say(format!("{}: asked", order.as_str()));
                asker.ask(Some(order));
            }
        }
    }
    Ok(0)
}

fn take_answer(
    view: &mut RunView,
    config: &Config,
    order: Option<MonitorOrder>,
    answer: Result<RunAnswer, ProcessError>,
) {
    let goal = |a: &RunAnswer| {
        let px = |s: &[f64; 2]| config.camera.model.pixel_of(&Vector2::from(*s));
        a.goal_points.iter().map(|(id, s)| (*id, px(s).into())).collect::<Vec<_>>()
    };
    match (answer, order) {
        (Ok(a), None) => view.goal(goal(&a)),
        (Ok(a), Some(order)) => view.answered(&match a.reason {
            Some(why) => format!("{} was refused: {why}", order.as_str()),
            None => format!("{}: accepted", order.as_str()),
        }),
        // The goal of a run that is about to end is not needed.
        (Err(_), None) => {}
        (Err(error), Some(order)) => {
            view.answered(&format!("{}: {}", order.as_str(), printable(&error.to_string())))
        }
    }
}

/// Asks control beside the screen, which must not wait for an answer.
struct Asker {
    orders: Option<Sender<Option<MonitorOrder>>>,
    answers: Receiver<(Option<MonitorOrder>, Result<RunAnswer, ProcessError>)>,
    leave: StopFlag,
    thread: Option<JoinHandle<()>>,
}

impl Asker {
    fn start(client: Client) -> Result<Self, ProcessError> {
        let (orders, asked) = channel();
        let (tell, answers) = channel();
        let leave = StopFlag::default();
        let client = client.interrupted_by(leave.clone());
        let work = move || {
            while let Ok(order) = asked.recv() {
                let answer = match order {
                    None | Some(MonitorOrder::Quit) => client.status(),
                    Some(MonitorOrder::Start) => client.start(),
                    Some(MonitorOrder::Hold) => client.hold(),
                    Some(MonitorOrder::Stop) => client.stop(),
                    Some(MonitorOrder::Teach) => client.teach(),
                    Some(MonitorOrder::Reset) => client.reset(),
                };
                if tell.send((order, answer)).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("monitor-asker".into())
            .spawn(work)
            .map_err(|cause| ProcessError::Start { what: "the thread that asks", cause })?;
        Ok(Self { orders: Some(orders), answers, leave, thread: Some(thread) })
    }

    /// Asks for the state, or for what the user wants.
    fn ask(&self, order: Option<MonitorOrder>) {
        if let Some(orders) = &self.orders {
            let _ = orders.send(order); // the thread lives as long as this
        }
    }
}

/// Gives up what it waits for, and leaves the instance whole: a thread that ends with its process would leave its connection behind.
impl Drop for Asker {
    fn drop(&mut self) {
        self.leave.request();
        self.orders = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
