//! `vservo faults [--case NAME]... [--law NAME]... [--arm NAME]... [--seeds N] [--json] [--out DIR]`: what control makes of faults that are put into simulated cells.

use super::all_cores::{cores, on_threads};
use super::{json, shown, write_result};
use crate::input::{nearest, printable};
use crate::process::ProcessError;
use crate::rt::tell;
use crate::sim::faults::{CAMPAIGN_ARMS, CAMPAIGN_LAWS, FAULT_CASES, FaultTable, jobs};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `vservo faults`.
#[derive(Debug, Args)]
pub struct FaultsArguments {
    /// Only this case; may be repeated (--list tells which there are)
    #[arg(long = "case", value_name = "NAME")]
    pub cases: Vec<String>,
    /// Only this law: B, D-mean or hybrid; may be repeated
    #[arg(long = "law", value_name = "NAME")]
    pub laws: Vec<String>,
    /// Only this arm: ur5, panda, xarm7, ur5-unlike, panda-unlike or ur5-velocity; may be repeated
    #[arg(long = "arm", value_name = "NAME")]
    pub arms: Vec<String>,
    /// Runs of each case, law and arm, each with a seed and a time of its own
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub seeds: u16,
    /// Threads that simulate; as many as there are cores where it is left out
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Tell the cases with their entry in `[[faults]]`, and do nothing else
    #[arg(long)]
    pub list: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Folder for faults.json and faults.csv; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// # Errors
/// When the folder cannot be made.
pub(super) fn faults(arguments: &FaultsArguments) -> Result<u8, ProcessError> {
    if arguments.list {
        let lines = FAULT_CASES.iter().map(|case| format!("{:<20} {}\n", case.name, case.told()));
        return Ok(shown(&lines.collect::<String>(), 0));
    }
    let known = [
        ("case", &arguments.cases, FAULT_CASES.iter().map(|case| case.name).collect::<Vec<_>>()),
        ("law", &arguments.laws, CAMPAIGN_LAWS.iter().map(|law| law.0).collect()),
        ("arm", &arguments.arms, CAMPAIGN_ARMS.iter().map(|arm| arm.name).collect()),
    ];
    for (what, asked, known) in known {
        if let Some(name) = asked.iter().find(|name| !known.contains(&name.as_str())) {
            let meant = nearest(name, known.iter().copied());
            let meant = meant.map_or(String::new(), |name| format!("; did you mean {name}?"));
            let name = printable(name);
            tell(format_args!(
                "vservo: faults: there is no {what} `{name}`: choose of {}{meant}",
                known.join(", ")
            ));
            return Ok(3);
        }
    }
    if let Some(out) = &arguments.out {
        std::fs::create_dir_all(out).map_err(|cause| ProcessError::Write { path: out.clone(), cause })?;
    }
    let jobs = jobs(&arguments.cases, &arguments.laws, &arguments.arms, u64::from(arguments.seeds));
    let threads = arguments.threads.map_or_else(cores, usize::from);
    tell(format_args!("vservo: {} runs on {threads} threads", jobs.len()));
    let runs: Result<Vec<_>, _> = on_threads(threads, &jobs, |job| job.run()).into_iter().collect();
    let table = match runs {
        Ok(runs) => FaultTable::new(&jobs, runs),
        Err(error) => {
            tell(format_args!("vservo: faults: {}", printable(&error.to_string())));
            return Ok(1);
        }
    };
    let answer = if arguments.json { json(&table) } else { table.to_text() };
    let mut code = shown(&answer, 0);
    if let Some(out) = &arguments.out {
        code = write_result(&out.join("faults.json"), json(&table), code);
        code = write_result(&out.join("faults.csv"), table.to_csv(), code);
    }
    Ok(code)
}
