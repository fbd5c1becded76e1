//! The command that repeats a run.

use super::{CellArguments, RunArguments};
use crate::input::shell_word;
use crate::report::summary::Summary;

/// The arguments of `vservo run` beside its cell and the places of its results.
#[must_use]
pub(super) fn of_run(arguments: &RunArguments) -> Vec<String> {
    let duration = arguments.duration_s.map(|s| ["--duration-s".to_owned(), s.to_string()]);
    let strict = arguments.strict.then(|| "--strict".to_owned());
    let anyway = arguments.anyway.then(|| "--anyway".to_owned());
    duration.into_iter().flatten().chain(strict).chain(anyway).collect()
}

/// `vservo WORDS CONFIG --clock C --seed N --set ... MORE`, for a shell: clock and seed are named whoever chose them.
#[must_use]
pub(super) fn command(words: &[&str], cell: &CellArguments, more: &[String], summary: &Summary) -> String {
    let mut all: Vec<String> = ["vservo"].iter().chain(words).map(ToString::to_string).collect();
    if let Some(config) = &cell.config {
        let path = config.display().to_string();
        // A name that begins like an option is still a file.
        all.push(if path.starts_with('-') { format!("./{path}") } else { path });
    }
    all.extend(["--clock".into(), summary.clock.clone(), "--seed".into(), summary.seed.to_string()]);
    for set in &cell.set {
        all.extend(["--set".into(), set.clone()]);
    }
    all.extend_from_slice(more);
    all.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use crate::config::Config;
    use crate::time::SpanNs;
    use clap::Parser;

    #[test]
    fn the_command_reads_back_as_the_same_run() {
        let given = [
            "vservo",
            "run",
            "my cell.toml",
            "--duration-s",
            "2.5",
            "--strict",
            "--set",
            "run.seed=9",
            "--set",
            "robot.q_start_rad_or_m=[0.0, 'x']",
        ];
        let Some(Command::Run(arguments)) = Cli::parse_from(given).command else { panic!("no run") };
        let mut summary = Summary::without_control(&Config::load(None, &[]).unwrap(), SpanNs(0));
        summary.seed = 9;
        let line = command(&["run"], &arguments.cell, &of_run(&arguments), &summary);
        assert_eq!(
            line,
            "vservo run 'my cell.toml' --clock realtime --seed 9 --set run.seed=9 --set \
             'robot.q_start_rad_or_m=[0.0, '\\''x'\\'']' --duration-s 2.5 --strict"
        );
    }
}
