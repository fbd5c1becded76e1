//! A run that is watched, whoever shows it: what its processes send, and control, which is asked beside.

use crate::client::{Client, RunAnswer, RunWatch};
use crate::config::Config;
use crate::input::printable;
use crate::ipc::ReceivedFrame;
use crate::monitor::{MonitorOrder, RunView, WatchedRecord};
use crate::process::{ProcessError, StopFlag};
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector2;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// Period at which it looks whether control is still there. Chosen by hand: it costs some system calls.
const PRESENCE_PERIOD: SpanNs = SpanNs(250_000_000);

/// A run that is watched. Who asks leaves before who watches, which removes what is left.
pub(super) struct WatchedRun {
    asker: Asker,
    watch: RunWatch,
    config: Config,
    next_look: MonoNs,
}

impl WatchedRun {
    /// Joins the run of `client`, whose run file is `config`.
    pub(super) fn join(client: Client, config: Config) -> Result<Self, ProcessError> {
        let instance = client.instance().clone();
        let watch = RunWatch::join(&instance, &config)?;
        Ok(Self { asker: Asker::start(client)?, watch, config, next_look: MonoNs::ZERO })
    }

    /// The same with the images of the first camera.
    pub(super) fn with_images(self) -> Result<Self, ProcessError> {
        let watch = self.watch.with_images(&self.config)?;
        Ok(Self { watch, ..self })
    }

    /// The newest image since the last look.
    pub(super) fn image(&self) -> Result<Option<ReceivedFrame>, ProcessError> {
        self.watch.image()
    }

    /// Takes everything that came, at `time`, into `view`, and shows it `also`. Whether the run is still there.
    pub(super) fn take_all(
        &mut self,
        view: &mut RunView,
        time: MonoNs,
        also: &mut dyn FnMut(&WatchedRecord<'_>),
    ) -> Result<bool, ProcessError> {
        let mut has_new_goal = false;
        let mut take = |record: &WatchedRecord<'_>| {
            has_new_goal |= view.take(record, time);
            also(record);
        };
        self.watch.take_all(&mut take)?;
        if has_new_goal {
            self.asker.ask(None);
        }
        while let Ok((order, answer)) = self.asker.answers.try_recv() {
            take_answer(view, &self.config, order, answer);
        }
        if time < self.next_look {
            return Ok(true);
        }
        self.next_look = time + PRESENCE_PERIOD;
        self.watch.look_for_drive()?;
        let is_there = self.watch.is_there();
        if !is_there {
            // its last words
            self.watch.take_all(&mut |record| {
                view.take(record, time);
                also(record);
            })?;
        }
        Ok(is_there)
    }

    /// The run file of the run.
    pub(super) fn config(&self) -> &Config {
        &self.config
    }

    /// Has control asked for what the user wants.
    pub(super) fn ask(&self, order: MonitorOrder) {
        self.asker.ask(Some(order));
    }
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
        (Ok(a), Some(order)) => view.answered(&match &a.reason {
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

/// Asks control beside whoever shows the run, who must not wait for an answer.
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
            .name("asker".into())
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
