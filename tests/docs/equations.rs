//! docs/equations.md: every numbered equation and every problem of the chapter has a row, whose functions, tests and commands exist, and the figures
//! of the studies are those that the experiments have today.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers beside the tests

use clap::{Command, CommandFactory};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use vservo::config::Config;
use vservo::experiment::{CameraKind, Options, find};

/// The last equation and the last problem of the chapter.
const EQUATIONS: u32 = 97;
const PROBLEMS: u32 = 13;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn page() -> String {
    std::fs::read_to_string(root().join("docs/equations.md")).unwrap()
}

fn texts(folder: &Path, found: &mut String) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        if entry.path().is_dir() {
            texts(&entry.path(), found);
        } else if entry.path().extension().is_some_and(|e| e == "rs") {
            *found += &std::fs::read_to_string(entry.path()).unwrap();
        }
    }
}

fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

/// Whether `text` has a definition of this name, and not the beginning of a longer one.
fn defines(text: &str, kind: &str, name: &str) -> bool {
    text.match_indices(&format!("{kind} {name}")).any(|(at, found)| {
        let next = text[at + found.len()..].chars().next();
        !next.is_some_and(|c| c.is_alphanumeric() || c == '_')
    })
}

/// Whether the program knows such a command: its sub-commands and options, the run file with what is set in it, the experiment.
fn knows(command: &str, sets: &[String]) -> Result<(), String> {
    let mut words = command.split(' ').skip(1).peekable();
    let mut known: Command = vservo::cli::Cli::command();
    let mut names = Vec::new();
    while let Some(sub) = words.peek().and_then(|word| known.find_subcommand(word)).cloned() {
        names.push(words.next().unwrap());
        known = sub;
    }
    if names.is_empty() {
        return Err("no such command".into());
    }
    let (mut file, mut sets) = (None, sets.to_vec());
    while let Some(word) = words.next() {
        if word == "--set" {
            sets.extend(words.next().map(str::to_string));
        } else if let Some(option) = word.strip_prefix("--") {
            if !known.get_arguments().any(|argument| argument.get_long() == Some(option)) {
                return Err(format!("no option --{option}"));
            }
            if words.peek().is_some_and(|value| !value.starts_with("--")) {
                words.next();
            }
        } else {
            file = Some(word);
        }
    }
    match (names[0], file) {
        ("experiment", Some(name)) => find(name).map(|_| ()).map_err(|why| why.to_string()),
        ("run" | "check", file) => {
            Config::load(file.map(Path::new), &sets).map(|_| ()).map_err(|why| why.to_string())
        }
        (_, None) => Ok(()),
        (_, Some(word)) => Err(format!("what is {word}?")),
    }
}

/// Each row names a function that its file has, tests that exist, and a command that the program knows, or says "library".
#[test]
fn every_function_test_and_command_of_the_page_exists() {
    let mut everything = String::new();
    texts(&root().join("src"), &mut everything);
    texts(&root().join("tests"), &mut everything);
    let (mut functions, mut tests, mut commands) = (0, 0, 0);
    for line in page().lines().filter(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').collect();
        let (checks, reached) = match cells.as_slice() {
            [_, _, names, file, checks, reached] if file.contains("src/") => {
                let path = root().join(quoted(file).first().unwrap());
                let mut text = String::new();
                if path.is_dir() {
                    texts(&path, &mut text);
                } else {
                    text = std::fs::read_to_string(&path)
                        .unwrap_or_else(|_| panic!("no file {}", path.display()));
                }
                for name in quoted(names) {
                    let own = name.rsplit("::").next().unwrap();
                    let found = ["fn", "struct", "enum"].iter().any(|kind| defines(&text, kind, own));
                    assert!(found, "{name} is not in {}", path.display());
                    functions += 1;
                }
                (*checks, Some(*reached))
            }
            [problem, _, checks, reached] if problem.contains("Problem") => (*checks, Some(*reached)),
            [_, _, checks] if checks.contains('`') => (*checks, None),
            _ => continue,
        };
        if let Some(reached) = reached.filter(|reached| !reached.trim().starts_with("library: ")) {
            let (given, sets): (Vec<_>, Vec<_>) =
                quoted(reached).into_iter().partition(|word| word.starts_with("vservo "));
            let sets: Vec<_> = sets.into_iter().filter(|word| word.starts_with("servo.")).collect();
            assert!(!given.is_empty(), "nothing reaches: {line}");
            for command in given {
                knows(&command, &sets).unwrap_or_else(|why| panic!("{command}: {why}\n{line}"));
                commands += 1;
            }
        }
        let named = quoted(checks);
        assert!(!named.is_empty(), "no test in: {line}");
        for test in named {
            assert!(defines(&everything, "fn", &test), "no test {test}");
            tests += 1;
        }
    }
    assert!(functions > 80 && tests > 100 && commands > 80, "{functions} {tests} {commands}");
    assert!(knows("vservo run nothing-such", &[]).is_err() && knows("vservo pose --such", &[]).is_err());
    assert!(knows("vservo run ur5", &["servo.no_such_key=1".into()]).is_err());
}

/// The numbers in `(10.7)` and `(10.7)-(10.9)`.
fn numbers(cell: &str) -> BTreeSet<u32> {
    let mut found = BTreeSet::new();
    let mut rest = cell;
    while let Some((_, after)) = rest.split_once("(10.") {
        let (number, after) = after.split_once(')').unwrap();
        let first: u32 = number.parse().unwrap();
        let last = after.strip_prefix("-(10.").and_then(|more| more.split_once(')')?.0.parse().ok());
        found.extend(first..=last.unwrap_or(first));
        rest = after;
    }
    found
}

#[test]
fn every_equation_and_every_problem_has_a_row() {
    let page = page();
    let first_cells = || page.lines().filter_map(|line| line.strip_prefix('|')?.split('|').next());
    let equations: BTreeSet<u32> = first_cells().flat_map(numbers).collect();
    let missing: Vec<u32> = (1..=EQUATIONS).filter(|n| !equations.contains(n)).collect();
    assert!(missing.is_empty(), "no row for (10.n), n = {missing:?}");
    let rows: Vec<&str> = first_cells().map(str::trim).collect();
    let missing: Vec<u32> =
        (1..=PROBLEMS).filter(|n| !rows.contains(&format!("Problem 10.{n}").as_str())).collect();
    assert!(missing.is_empty(), "no row for Problem 10.n, n = {missing:?}");
}

/// The figures are run again, and must stand on the page as they come out.
#[test]
fn figures_of_the_studies_are_measured() {
    let page = page().split_whitespace().collect::<Vec<_>>().join(" ");
    let metrics = |name: &str| {
        let options = Options { camera: CameraKind::Ideal, count: 20, progress: &|_| {} };
        find(name).unwrap().run(&options).unwrap().metrics
    };
    let told = |words: String| assert!(page.contains(&words), "docs/equations.md does not say: {words}");
    let number =
        |value: &Value, key: &str| value[key].as_f64().unwrap_or_else(|| panic!("no {key} in {value}"));

    let moving = metrics("moving-target");
    let px = |motion: &str, camera: &str, feed_forward: bool| {
        let runs = moving["runs"].as_array().unwrap();
        let run = runs.iter().find(|run| {
            run["motion"].as_str().unwrap().starts_with(motion)
                && run["camera"] == camera
                && run["feed_forward"] == feed_forward
        });
        number(run.unwrap(), "steady_rms_px")
    };
    told(format!("behind a conveyor of 0.2 m/s {:.3} px rms", px("conveyor", "regular", true)));
    told(format!("({:.3} px with a tenth of the frames", px("conveyor", "irregular", true)));
    let pendulum = |feed_forward| px("pendulum", "regular", feed_forward);
    told(format!("0.2 Hz {:.2} px, {:.1} px without", pendulum(true), pendulum(false)));

    let system = metrics("gain-system");
    let best = |update: &str| {
        let of = |latency_ms: u64| {
            let loops = system["loops"].as_array().unwrap();
            let found = loops.iter().find(|l| l["update"] == update && l["latency_ms"] == latency_ms);
            number(found.unwrap(), "best_settling_time_s")
        };
        format!("{:.2} and {:.2} s under `{update}`", of(40), of(80))
    };
    for update in ["frame", "tick", "predict"] {
        told(best(update));
    }
}
