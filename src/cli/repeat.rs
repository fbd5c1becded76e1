//! The command that repeats a run.

use super::CellArguments;
use crate::input::shell_word;
use crate::report::summary::Summary;

/// `vservo WORDS CONFIG --clock C --seed N --set ...`, for a shell: clock and seed are named whoever chose them.
#[must_use]
pub(super) fn command(
    words: &[&str],
    cell: &CellArguments,
    duration_s: Option<f64>,
    summary: &Summary,
) -> String {
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
    if let Some(s) = duration_s {
        all.extend(["--duration-s".into(), s.to_string()]);
    }
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
            "--set",
            "run.seed=9",
            "--set",
            "robot.q_start_rad_or_m=[0.0, 'x']",
        ];
        let Some(Command::Run(arguments)) = Cli::parse_from(given).command else { panic!("no run") };
        let mut summary = Summary::without_control(&Config::load(None, &[]).unwrap(), SpanNs(0));
        summary.seed = 9;
        let line = command(&["run"], &arguments.cell, Some(2.5), &summary);
        assert_eq!(
            line,
            "vservo run 'my cell.toml' --clock realtime --seed 9 --set run.seed=9 --set \
             'robot.q_start_rad_or_m=[0.0, '\\''x'\\'']' --duration-s 2.5"
        );
    }
}
