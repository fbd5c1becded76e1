//! `vservo watch`: a running instance in a browser. It reads what `vservo monitor` reads, without real-time priority, and orders nothing.

mod foxglove;
mod live;
mod page;
mod process_facts;
mod request;
mod server;

use super::record::config_of_run;
use super::watched_run::WatchedRun;
use super::{completion, shown};
use crate::client::Client;
use crate::config::Config;
use crate::input::printable;
use crate::ipc::Instance;
use crate::monitor::{CellFacts, RunView};
use crate::process::{ProcessError, StopFlag};
use crate::rt::{now, tell};
use crate::time::{MonoNs, SpanNs};
use clap::Args;
use clap_complete::engine::ArgValueCompleter;
use foxglove::{ChannelHub, LivePublisher};
use live::{Live, WatchMoment};
use process_facts::ProcessFacts;
use request::ViewerGate;
use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Period of looks at the services. Chosen by hand, as a monitor's: half a second of measurements and a second of ticks wait at most.
const PERIOD: Duration = Duration::from_millis(50);
/// Looks for each message to the viewers, and each image: ten a second, chosen by hand so that motion looks continuous and a page takes a few per cent of a core.
const LOOKS_PER_MOMENT: u64 = 2;
/// Period at which it looks for a run that is not there. Chosen by hand: it costs some system calls.
const NEXT_RUN_PERIOD: SpanNs = SpanNs(500_000_000);
/// Bytes of a token: 128 bits are more than anybody can try, as is usual for keys that need no derivation.
const TOKEN_BYTES: usize = 16;

/// Arguments of `vservo watch`.
#[derive(Debug, Args)]
pub struct WatchArguments {
    /// Run file of the processes, where no supervisor left it
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Port of the page; 0: any that is free
    #[arg(long, value_name = "N", default_value_t = 8470)]
    pub port: u16,
    /// Address of this machine at which others may look too, with the token that is printed; without it 127.0.0.1 alone
    #[arg(long, value_name = "ADDRESS")]
    pub listen: Option<IpAddr>,
    /// Origin of pages that may read along through the WebSocket, scheme and host as browsers send it; again for more. Those of this machine and Foxglove's own may
    #[arg(long, value_name = "ORIGIN")]
    pub origin: Vec<String>,
}

/// A run that is there, and what is shown of it.
struct WatchSession {
    run: WatchedRun,
    view: RunView,
    processes: ProcessFacts,
    publisher: LivePublisher,
}

/// Shows the runs of an instance, one after the other, until a signal; the exit code.
pub(super) fn watch(arguments: &WatchArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let instance: Instance = arguments.instance.parse()?;
    // A file that is wrong is told at once, not in the page.
    arguments.config.as_deref().map(|path| Config::load(Some(path), &[])).transpose()?;
    let (listener, gate, url) = listen(arguments)?;
    let live = Arc::new(Live::default());
    live.show(WatchMoment::without_run(&waits_for(&instance)));
    let hub = Arc::new(ChannelHub::default());
    server::serve(listener, gate, Arc::clone(&live), Arc::clone(&hub))?;
    let socket = url.replacen("http", "ws", 1);
    let code = shown(&format!("{url}\n{socket} (Foxglove)\n"), 0);
    if code != 0 {
        return Ok(code); // nobody knows the address
    }
    watch_runs(arguments, &instance, &stop, (&live, &hub));
    Ok(0)
}

/// The listener, to whom requests must be addressed, and the address to open.
fn listen(arguments: &WatchArguments) -> Result<(TcpListener, ViewerGate, String), ProcessError> {
    let address = SocketAddr::new(arguments.listen.unwrap_or(Ipv4Addr::LOCALHOST.into()), arguments.port);
    let failed = |cause| ProcessError::Listen { address, cause };
    let listener = TcpListener::bind(address).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    let token = arguments.listen.map(|_| new_token()).transpose();
    let token = token.map_err(|cause| ProcessError::Start { what: "watching: no random numbers", cause })?;
    let query = token.as_ref().map(|token| format!("?token={token}")).unwrap_or_default();
    let url = format!("http://{bound}/{query}");
    let origins = arguments.origin.clone();
    Ok((listener, ViewerGate { token, address: arguments.listen, origins }, url))
}

/// Random letters that nobody guesses.
fn new_token() -> std::io::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn waits_for(instance: &Instance) -> String {
    format!("no run of instance `{instance}` is there: waits for one")
}

fn watch_runs(
    arguments: &WatchArguments,
    instance: &Instance,
    stop: &StopFlag,
    (live, hub): (&Live, &Arc<ChannelHub>),
) {
    let (mut session, mut shows_end): (Option<WatchSession>, bool) = (None, false);
    let (mut next_try, mut runs, mut looks, mut told) = (MonoNs::ZERO, 0, 0_u64, String::new());
    while !stop.is_requested() {
        let time = now();
        if session.is_none() && time >= next_try {
            next_try = time + NEXT_RUN_PERIOD;
            let word = match join(arguments, instance, (runs + 1, hub)) {
                Ok(joined) => {
                    (runs, shows_end, session) = (runs + 1, false, Some(joined));
                    format!("run {runs} of instance `{instance}` is shown")
                }
                Err(ProcessError::NobodyThere(_)) => waits_for(instance),
                Err(error) => error.lines().join("; "),
            };
            if session.is_none() && !shows_end && word != told {
                live.show(WatchMoment::without_run(&word));
            }
            if word != told {
                tell(format_args!("vservo watch: {}", printable(&word)));
                told = word;
            }
        }
        if let Some(mut present) = session.take() {
            let is_moment = looks.is_multiple_of(LOOKS_PER_MOMENT);
            if let Some(why) = look(&mut present, is_moment.then_some(live), time) {
                present.view.end(format!("{why}; waits for the next run of instance `{instance}`"));
                live.show(WatchMoment::of(runs, &present.view, present.view.snapshot(time, Vec::new())));
                shows_end = true;
            } else {
                if is_moment {
                    let rows = present.processes.rows(time);
                    live.show(WatchMoment::of(runs, &present.view, present.view.snapshot(time, rows)));
                }
                session = Some(present);
            }
        }
        looks += 1;
        std::thread::sleep(PERIOD);
    }
}

/// Joins the run that is there, the `run`-th of this watcher.
fn join(
    arguments: &WatchArguments,
    instance: &Instance,
    (run, hub): (u64, &Arc<ChannelHub>),
) -> Result<WatchSession, ProcessError> {
    let client = Client::connect(&arguments.instance)?;
    let config = config_of_run(arguments.config.as_deref(), &[], instance)?;
    let facts = CellFacts { has_keys: false, ..CellFacts::of(instance, &config) };
    let watched = WatchedRun::join(client, config)?.with_images()?;
    let publisher = LivePublisher::new(Arc::clone(hub), run, &arguments.instance, watched.config());
    Ok(WatchSession {
        run: watched,
        view: RunView::new(facts),
        processes: ProcessFacts::of(instance),
        publisher,
    })
}

/// Takes what came, and an image where one is to be shown by `live` or elsewhere; why nothing comes any more, where that is so.
fn look(session: &mut WatchSession, live: Option<&Live>, time: MonoNs) -> Option<String> {
    let WatchSession { run, view, publisher, .. } = session;
    let goal_px = view.goal_px().clone();
    let looked = run.take_all(view, time, &mut |record| publisher.publish(record, &goal_px));
    let looked = looked.and_then(|is_there| {
        let shown = live.filter(|live| live.wants_images(time));
        if is_there
            && (shown.is_some() || live.is_some() && publisher.wants_images())
            && let Some(frame) = run.image()?
        {
            publisher.image(&frame.header(), frame.pixels());
            if let Some(live) = shown {
                live.show_image(frame.header(), frame.pixels().to_vec());
            }
        }
        Ok(is_there)
    });
    match looked {
        Ok(true) => None,
        Ok(false) => Some("the run has ended".into()),
        Err(error) => Some(format!("the run cannot be read any more: {error}")),
    }
}
