//! `vservo record`.

use super::black_box;
use super::completion;
use super::{check_writable, config_on_stdin, doctor, json, shown, warn};
use crate::config::{Clock, Config};
use crate::ipc::Instance;
use crate::process::recorder::{self, BlackBoxSettings, RecordedFile};
use crate::process::{self, ProcessError, StopFlag};
use crate::robot;
use crate::rt::tell;
use crate::time::SpanNs;
use clap::Args;
use clap_complete::engine::ArgValueCompleter;
use std::path::{Path, PathBuf};

/// Arguments of `vservo record`.
#[derive(Debug, Args)]
pub struct RecordArguments {
    /// Run file of the processes, where no supervisor left it
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// File to write; with --last the folder of the black box
    #[arg(long, value_name = "FILE.mcap|DIR")]
    pub out: PathBuf,
    /// A black box: keep so much of the last in memory, such as 60s, and write it into the folder at each fault, and at Ctrl-C
    #[arg(long, value_name = "60s", value_parser = black_box::last)]
    pub last: Option<SpanNs>,
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Change one value of the run file; must be the same for all processes
    #[arg(long, value_name = "key.path=value", requires = "config")]
    pub set: Vec<String>,
    /// Process id of the supervisor
    #[arg(long, hide = true)]
    pub supervised_by: Option<i32>,
    /// The run file is open on stdin; CONFIG is only its name
    #[arg(long, hide = true)]
    pub config_on_stdin: bool,
}

/// Records an instance to its end; the exit code. A recording that could not be written whole is a result that could not.
pub(super) fn record(arguments: &RecordArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let instance: Instance = arguments.instance.parse()?;
    let config = match &arguments.config {
        Some(name) if arguments.config_on_stdin => config_on_stdin(name, &arguments.set)?,
        path => config_of_run(path.as_deref(), &arguments.set, &instance)?,
    };
    match arguments.supervised_by {
        // which has warned, and looked at the file
        Some(supervisor) => process::follow_parent(supervisor, &stop),
        None if arguments.last.is_some() => warn(&config),
        None => {
            warn(&config);
            check_writable(&arguments.out)?;
        }
    }
    if let Some(last) = arguments.last {
        if config.clock == Clock::Lockstep {
            let why = "--last: a run in lockstep waits for a recorder and not for a black box, which would miss most; record all of it, without --last";
            return Err(ProcessError::NoCommand(why.into()));
        }
        let writes_at_stop = arguments.supervised_by.is_none();
        let settings = BlackBoxSettings { last, folder: arguments.out.clone(), writes_at_stop };
        recorder::keep_the_last(&config, &instance, &stop, &settings, files(&config))?;
        return Ok(0);
    }
    let end = recorder::run(&config, &instance, &stop, &arguments.out, &files(&config))?;
    let exit_code = if arguments.supervised_by.is_some() {
        // stdout belongs to the results of the run
        end.to_text().lines().for_each(tell);
        0
    } else {
        shown(&end.to_text(), 0)
    };
    match end.failure {
        None => Ok(exit_code),
        Some(error) => {
            tell("vservo: the recording ended before the run, which goes on");
            Err(error)
        }
    }
}

/// The run file of a run that is there: the one that is named, or what its supervisor left.
pub(super) fn config_of_run(
    path: Option<&Path>,
    set: &[String],
    instance: &Instance,
) -> Result<Config, ProcessError> {
    match path {
        Some(path) => Ok(Config::load(Some(path), set)?),
        None if !instance.config_path().exists() => Err(ProcessError::NobodyThere(instance.to_string())),
        None => Ok(Config::load(Some(&instance.config_path()), &[])?),
    }
}

/// What a recording has beside the messages, so that it is complete by itself.
fn files(config: &Config) -> Vec<RecordedFile> {
    let machine = json(&doctor::examine()).into_bytes();
    let mut files =
        vec![RecordedFile { name: "machine.json".into(), media_type: "application/json", data: machine }];
    let arm = &config.effective;
    for (folder, model) in [("robot", Some(&arm.robot.model)), ("scene.arm", arm.scene.arm.model.as_ref())] {
        // what was just loaded is there, unless somebody removed it meanwhile
        for (name, text) in model.and_then(|model| robot::files(model).ok()).into_iter().flatten() {
            let (name, data) = (format!("{folder}/{name}"), text.into_bytes());
            files.push(RecordedFile { name, media_type: "text/plain", data });
        }
    }
    files
}
