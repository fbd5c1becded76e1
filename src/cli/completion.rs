//! What a shell is offered while a command is typed: commands and options by clap, and what only this program knows: run files that come
//! with it, experiments, and the keys of a run file.

use super::{Cli, lost, shown};
use crate::config::{SHIPPED_FILES, default_keys};
use crate::experiment::EXPERIMENTS;
use crate::pipeline::STEPS;
use crate::process::ProcessError;
use clap::{Args, CommandFactory};
use clap_complete::engine::{CompletionCandidate, PathCompleter, ValueCompleter};
use clap_complete::env::{CompleteEnv, Shells};
use std::ffi::OsStr;
use std::path::Path;
use toml::Value;

/// Shells that are known.
const SHELLS: [&str; 5] = ["bash", "elvish", "fish", "powershell", "zsh"];
/// The variable by which a shell's script asks this program for completions.
const VARIABLE: &str = "COMPLETE";

/// Arguments of `vservo completions`.
#[derive(Debug, Args)]
pub struct CompletionArguments {
    /// Shell
    #[arg(value_parser = SHELLS)]
    shell: String,
}

/// Prints the script that makes a shell ask.
pub(super) fn print_script(arguments: &CompletionArguments) -> Result<u8, ProcessError> {
    Ok(script(&arguments.shell)
        .map_or_else(|cause| lost(Path::new("stdout"), cause, 0), |script| shown(&script, 0)))
}

/// Answers a shell that asks, and ends the process; otherwise nothing happens.
pub(super) fn answer() {
    CompleteEnv::with_factory(Cli::command).var(VARIABLE).complete();
}

fn script(shell: &str) -> std::io::Result<String> {
    let mut script = Vec::new();
    if let Some(completer) = Shells::builtins().completer(shell) {
        completer.write_registration(VARIABLE, "vservo", "vservo", "vservo", &mut script)?;
    }
    Ok(String::from_utf8_lossy(&script).into_owned())
}

/// Names of the shipped run files.
pub(super) fn run_files() -> Vec<CompletionCandidate> {
    SHIPPED_FILES
        .iter()
        .map(|file| CompletionCandidate::new(file.name).help(Some(file.about().into())))
        .collect()
}

/// A run file: a shipped one, or a file.
pub(super) fn run_file(current: &OsStr) -> Vec<CompletionCandidate> {
    let begun = |candidate: &CompletionCandidate| {
        candidate.get_value().as_encoded_bytes().starts_with(current.as_encoded_bytes())
    };
    let shipped = run_files().into_iter().filter(begun);
    let toml = |path: &Path| path.is_dir() || path.extension().is_some_and(|e| e == "toml");
    shipped.chain(PathCompleter::any().filter(toml).complete(current)).collect()
}

/// Steps of `vservo process`: what is typed up to the last bar stays, and a name follows.
pub(super) fn steps(current: &OsStr) -> Vec<CompletionCandidate> {
    let Some(typed) = current.to_str() else { return Vec::new() };
    let at = typed.rfind('|').map_or(0, |bar| bar + 1);
    let (kept, begun) = typed.split_at(at);
    let space = if kept.is_empty() { "" } else { " " };
    STEPS
        .iter()
        .filter(|info| info.name.starts_with(begun.trim_start()))
        .map(|info| {
            let whole = format!("{kept}{space}{}", info.name);
            CompletionCandidate::new(whole).help(Some(format!("{}: {}", info.usage, info.about).into()))
        })
        .collect()
}

/// Names of the experiments.
pub(super) fn experiments() -> Vec<CompletionCandidate> {
    let all = CompletionCandidate::new("all").help(Some("Every one of them, with an index page".into()));
    EXPERIMENTS
        .iter()
        .map(|e| CompletionCandidate::new(e.name).help(Some(e.about.into())))
        .chain([all])
        .collect()
}

/// The keys of a run file that have a default, each with it.
pub(super) fn keys() -> Vec<CompletionCandidate> {
    let mut keys = Vec::new();
    walk("", &default_keys(), &mut keys);
    keys
}

fn walk(path: &str, table: &toml::Table, keys: &mut Vec<CompletionCandidate>) {
    for (key, value) in table {
        let key = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match value {
            Value::Table(inner) => walk(&key, inner, keys),
            value => {
                let default = format!("default {value}");
                keys.push(CompletionCandidate::new(format!("{key}=")).help(Some(default.into())));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(candidates: &[CompletionCandidate]) -> Vec<&str> {
        candidates.iter().filter_map(|c| c.get_value().to_str()).collect()
    }

    #[test]
    fn what_only_this_program_knows_is_offered() {
        assert!(names(&run_file(OsStr::new("ur"))).contains(&"ur5-hybrid"));
        assert!(!names(&run_file(OsStr::new("ur"))).contains(&"panda"));
        assert!(names(&experiments()).contains(&"comparison"));
        let keys = keys();
        assert!(keys.len() > 100, "{}", keys.len());
        assert!(names(&keys).contains(&"servo.gain_1_s="));
    }

    #[test]
    fn every_shell_has_a_script() {
        for shell in SHELLS {
            assert!(script(shell).unwrap().contains("vservo"), "{shell}");
        }
    }
}
