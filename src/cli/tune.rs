//! `vservo tune [CONFIG] [KEY=LOW..HIGH]... [--out FILE.toml] [--chart FILE.svg]`: values with which simulated runs settle sooner.

use super::all_cores::{cores, on_threads};
use super::place::run_file_table;
use super::{check_writable, completion, json, shown, write_result};
use crate::config::assemble::{require_controllable, require_one_view};
use crate::config::{Config, ConfigError, Draft, DriveKind};
use crate::input::{number, printable};
use crate::process::ProcessError;
use crate::report::chart::{Panel, Series, Symbol, standalone_svg};
use crate::rt::tell;
use crate::sim::tune::{TuneFigures, TuneKey, figures, margin, search};
use clap::Args;
use clap_complete::engine::ArgValueCandidates;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What is searched where nothing is named: the gain, and the one to which it is reduced near the goal. Chosen by hand, around their defaults of 15
/// and 2 1/s: outside, the arm's limits or the camera's delay decide.
const USUAL: [(&str, (f64, f64)); 2] =
    [("servo.gain_1_s", (2.0, 60.0)), ("servo.gain_at_goal_1_s", (1.0, 30.0))];
/// Longest delay that the loop does not know of and that is tried, ms. Chosen by hand: two and a half periods of a camera of 25 Hz.
const MOST_DELAY_MS: f64 = 100.0;
/// Greatest load that is tried, kg. Chosen by hand: the largest payload that the shipped arms are made for is 5 kg.
const MOST_LOAD_KG: f64 = 10.0;
/// A calm proposal may settle later than the fastest by this factor. Chosen by hand.
const CALM: f64 = 1.25;

/// Arguments of `vservo tune`.
#[derive(Debug, Args)]
pub struct TuneArguments {
    /// Run file, and keys with their ranges, as in `ur5 servo.gain_1_s=2..60`; without keys: the gains of the law
    #[arg(value_name = "CONFIG | KEY=LOW..HIGH")]
    pub what: Vec<String>,
    /// Change one value first; may be repeated
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
    /// Run file to write, with the fastest values
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Drawing of the trade-off to write
    #[arg(long, value_name = "FILE.svg")]
    pub chart: Option<PathBuf>,
    /// Try all places of a grid of so many values of each key instead of searching; at most 10 000 runs
    #[arg(long, value_name = "N")]
    pub sweep: Option<usize>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// One run of the search.
#[derive(Debug, Clone, Serialize)]
struct TuneTrial {
    values: Vec<f64>,
    figures: Option<TuneFigures>,
}

/// Values that are proposed, or that the file has.
#[derive(Debug, Serialize)]
struct TuneProposal {
    what: &'static str,
    values: Vec<f64>,
    figures: TuneFigures,
    /// Delay that the loop does not know of and stands, ms.
    delay_margin_ms: f64,
    /// Load that the loop does not know of and stands, kg; `None` where the drive is not simulated with its masses.
    load_margin_kg: Option<f64>,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct TuneAnswer<'a> {
    keys: Vec<&'a str>,
    runs: usize,
    proposals: &'a [TuneProposal],
    trials: &'a [TuneTrial],
}

/// # Errors
/// When the run file is wrong, or cannot be simulated.
pub(super) fn tune(arguments: &TuneArguments) -> Result<u8, ProcessError> {
    for path in arguments.out.iter().chain(&arguments.chart) {
        check_writable(path)?;
    }
    let (path, keys) = match asked(&arguments.what) {
        Ok(asked) => asked,
        Err(message) => {
            tell(format_args!("vservo: {}", printable(&message)));
            return Ok(2);
        }
    };
    let bench = TuneBench { path, set: &arguments.set, keys: &keys };
    let config = bench.config(&[], &[])?;
    require_controllable(&config)?;
    require_one_view(&config, "`vservo tune`")?;
    if config.scene.is_none() || config.drive.kind == DriveKind::External || !config.closes_the_loop() {
        tell(format_args!(
            "vservo: tune runs in simulation: set camera.source=synthetic and drive.kind=simulated, with the cell's own numbers"
        ));
        return Ok(3);
    }
    let start = keys.iter().map(|key| written(&config, &key.name)).collect::<Result<Vec<f64>, String>>();
    let start = match start {
        Ok(start) => start,
        Err(message) => {
            tell(format_args!("vservo: {}", printable(&message)));
            return Ok(3);
        }
    };
    // what is wrong with a range is told at its ends, before all the runs
    for (k, key) in keys.iter().enumerate() {
        for end in [key.range.0, key.range.1] {
            let values: Vec<f64> =
                start.iter().enumerate().map(|(i, v)| if i == k { end } else { *v }).collect();
            bench.config(&values, &[])?;
        }
    }
    let mut trials = Vec::new();
    let mut evaluate = |all: &[Vec<f64>]| -> Vec<f64> {
        let done = bench.run_all(all);
        let costs = done.iter().map(|t| t.figures.map_or(f64::MAX, |f| f.cost())).collect();
        trials.extend(done);
        costs
    };
    match arguments.sweep {
        None => drop(search(&keys, &start, &mut evaluate)),
        Some(places) => match grid(&keys, places) {
            Some(all) => {
                tell(format_args!("vservo: {} runs", all.len() + 1));
                drop(evaluate(&[vec![start], all].concat()));
            }
            None => {
                tell(format_args!("vservo: --sweep {places}: 2 to 100 values a key, and at most 10000 runs"));
                return Ok(2);
            }
        },
    }
    let proposals = proposals(&bench, &config, &trials);
    let Some(fastest) = proposals.iter().find(|p| p.what == FASTEST) else {
        tell(format_args!("vservo: none of {} runs converges; `vservo check` may say why", trials.len()));
        return Ok(5);
    };
    let mut code = 0;
    if let Some(out) = &arguments.out {
        code = write_result(out, run_file(&bench, &fastest.values)?, code);
    }
    if let Some(chart) = &arguments.chart {
        code = write_result(chart, drawn(&keys, &trials, &proposals), code);
    }
    let names = keys.iter().map(|key| key.name.as_str()).collect();
    let answer = TuneAnswer { keys: names, runs: trials.len(), proposals: &proposals, trials: &trials };
    Ok(shown(&if arguments.json { json(&answer) } else { words(&answer) }, code))
}

/// The run file and the keys that are named.
fn asked(what: &[String]) -> Result<(Option<&Path>, Vec<TuneKey>), String> {
    let (mut path, mut keys) = (None, Vec::new());
    for word in what {
        match word.split_once('=') {
            None if path.is_none() && keys.is_empty() => path = Some(Path::new(word.as_str())),
            None => {
                return Err(format!("`{word}`: expected KEY=LOW..HIGH, for example servo.gain_1_s=2..60"));
            }
            Some((name, _)) if keys.iter().any(|key: &TuneKey| key.name == name.trim()) => {
                return Err(format!("`{word}`: {} is named twice: one range for each key", name.trim()));
            }
            Some((name, range)) => {
                keys.push(TuneKey { name: name.trim().into(), range: range_of(word, range)? })
            }
        }
    }
    if keys.is_empty() {
        keys.extend(USUAL.map(|(name, range)| TuneKey { name: name.into(), range }));
    }
    Ok((path, keys))
}

/// Two numbers with `..` between them.
fn range_of(word: &str, range: &str) -> Result<(f64, f64), String> {
    let ends = range
        .split_once("..")
        .and_then(|(low, high)| Some((low.trim().parse().ok()?, high.trim().parse().ok()?)));
    match ends {
        Some((low, high)) if f64::is_finite(low) && f64::is_finite(high) && low < high => Ok((low, high)),
        _ => Err(format!(
            "`{word}`: expected KEY=LOW..HIGH with LOW below HIGH, for example servo.gain_1_s=2..60"
        )),
    }
}

/// The number that the run file, or the default, has at `key`.
fn written(config: &Config, key: &str) -> Result<f64, String> {
    let table = toml::Table::try_from(&config.effective).map_err(|e| e.to_string())?;
    let mut at = Some(&toml::Value::Table(table)).cloned();
    for name in key.split('.') {
        at = at.and_then(|value| value.get(name).cloned());
    }
    match at {
        Some(toml::Value::Float(value)) => Ok(value),
        Some(toml::Value::Integer(_)) => {
            Err(format!("{key}: is a whole number; tune varies keys of any value between two, such as gains"))
        }
        Some(_) => Err(format!("{key}: is not a number")),
        None => Err(format!("{key}: is no key of a run file, or has no value there; give it one with --set")),
    }
}

/// The run file with changes.
struct TuneBench<'a> {
    path: Option<&'a Path>,
    set: &'a [String],
    keys: &'a [TuneKey],
}

impl TuneBench<'_> {
    fn draft(&self, values: &[f64], further: &[String]) -> Result<Draft, ConfigError> {
        let values =
            self.keys.iter().zip(values).map(|(key, value)| format!("{}={}", key.name, literal(*value)));
        let set = ["run.clock=lockstep".to_owned()].into_iter().chain(self.set.iter().cloned()).chain(values);
        Draft::load(self.path, &set.chain(further.iter().cloned()).collect::<Vec<_>>())
    }

    fn config(&self, values: &[f64], further: &[String]) -> Result<Config, ConfigError> {
        self.draft(values, further)?.validate()
    }

    fn figures(&self, values: &[f64], further: &[String]) -> Option<TuneFigures> {
        figures(&self.config(values, further).ok()?).ok()
    }

    /// Simulates all of them, on as many threads as there are cores.
    fn run_all(&self, all: &[Vec<f64>]) -> Vec<TuneTrial> {
        on_threads(cores(), all, |values| TuneTrial {
            values: values.clone(),
            figures: self.figures(values, &[]),
        })
    }
}

/// As TOML reads it as a floating point number.
fn literal(value: f64) -> String {
    format!("{value:?}")
}

/// Every place of a grid, evenly on the scale of the search.
fn grid(keys: &[TuneKey], places: usize) -> Option<Vec<Vec<f64>>> {
    if !(2..=100).contains(&places) || places.checked_pow(keys.len() as u32)? > 10_000 {
        return None;
    }
    let mut all = vec![Vec::new()];
    for key in keys {
        let values = (0..places).map(|i| key.at(i as f64 / (places - 1) as f64));
        let values: Vec<f64> = values.collect();
        all = all
            .iter()
            .flat_map(|head: &Vec<f64>| values.iter().map(|v| [head.as_slice(), &[*v]].concat()))
            .collect();
    }
    Some(all)
}

const FASTEST: &str = "fastest";

/// The file's own values, the fastest, and the calmest of those that are not much slower, with their margins.
fn proposals(bench: &TuneBench<'_>, config: &Config, trials: &[TuneTrial]) -> Vec<TuneProposal> {
    let good = || {
        let converged = |t: &TuneTrial| Some((t.values.clone(), t.figures.filter(|f| f.converged)?));
        trials.iter().filter_map(converged)
    };
    let fastest = good().min_by(|a, b| a.1.cost().total_cmp(&b.1.cost()));
    let limit = fastest.as_ref().map_or(0.0, |(_, f)| CALM * f.cost());
    let calmest =
        good().filter(|(_, f)| f.cost() <= limit).min_by(|a, b| a.1.rest_px.total_cmp(&b.1.rest_px));
    let own = trials.first().and_then(|t| Some((t.values.clone(), t.figures?)));
    let all = [("as it is", own), (FASTEST, fastest), ("calm", calmest)];
    let all =
        all.into_iter().filter_map(|(what, found)| found.map(|(values, figures)| (what, values, figures)));
    let with_margins = |(what, values, figures): (&'static str, Vec<f64>, TuneFigures)| {
        let stands = |set: &[(&str, f64)]| {
            let set: Vec<_> = set.iter().map(|(key, x)| format!("{key}={}", literal(*x))).collect();
            bench.figures(&values, &set).is_some_and(|f| f.withstands(&figures))
        };
        // Images that are older than their stamps come later, too, so that no stamp lies in the future.
        let latency_ms = 1e-6 * config.camera.latency.0 as f64;
        let delayed =
            |ms: f64| [("camera.synthetic.stamp_error_ms", ms), ("camera.latency_ms", latency_ms + ms)];
        let load = config.drive.kind == DriveKind::Simulated;
        let (delay_margin_ms, load_margin_kg) = (
            margin(MOST_DELAY_MS, &mut |ms| stands(&delayed(ms))),
            load.then(|| margin(MOST_LOAD_KG, &mut |kg| stands(&[("drive.simulated.payload_kg", kg)]))),
        );
        TuneProposal { what, values, figures, delay_margin_ms, load_margin_kg }
    };
    all.map(with_margins).collect()
}

fn words(answer: &TuneAnswer<'_>) -> String {
    let mut lines = vec![format!("{} runs", answer.runs)];
    for p in answer.proposals {
        let values =
            answer.keys.iter().zip(&p.values).map(|(key, value)| format!("{key} = {}", number(*value)));
        lines.push(format!("{}: {}", p.what, values.collect::<Vec<_>>().join(", ")));
        let settling = match p.figures.settling_s {
            Some(s) if p.figures.converged => format!("settles in {s:.3} s"),
            _ => "does not converge".into(),
        };
        let load = p.load_margin_kg.map_or(String::new(), |kg| format!(", a load of {kg:.2} kg"));
        lines.push(format!(
            "  {settling}, overshoot {:.1} %, at rest {:.3} px; stands an untold delay of {:.1} ms{load}",
            100.0 * p.figures.overshoot,
            p.figures.rest_px,
            p.delay_margin_ms,
        ));
    }
    lines.join("\n") + "\n"
}

fn run_file(bench: &TuneBench<'_>, values: &[f64]) -> Result<String, ConfigError> {
    let draft = Draft::load(bench.path, bench.set)?;
    let mut table = run_file_table(&draft);
    for (key, value) in bench.keys.iter().zip(values) {
        let names: Vec<&str> = key.name.split('.').collect();
        if let Some((last, tables)) = names.split_last() {
            super::place::change(&mut table, tables, &mut |inner| {
                inner.insert((*last).to_owned(), toml::Value::Float(*value));
            });
        }
    }
    let told = bench.keys.iter().map(|key| key.name.clone()).collect::<Vec<_>>().join(", ");
    Ok(format!("# `vservo tune` chose {told}.\n{}", toml::to_string(&table).unwrap_or_default()))
}

/// Settling over the value of each key, and what is left at rest over settling.
fn drawn(keys: &[TuneKey], trials: &[TuneTrial], proposals: &[TuneProposal]) -> String {
    let good: Vec<(&TuneTrial, TuneFigures, f64)> = trials
        .iter()
        .filter_map(|t| t.figures.filter(|f| f.converged).and_then(|f| Some((t, f, f.settling_s?))))
        .collect();
    let chosen = |x: &dyn Fn(&TuneProposal) -> f64, y: &dyn Fn(&TuneProposal) -> f64, panel: Panel| {
        proposals.iter().zip(1..).fold(panel, |panel, (p, colour)| {
            panel.with(Series::new(Symbol::Circle, colour, [(x(p), y(p))]).label(p.what))
        })
    };
    let settling = |p: &TuneProposal| p.figures.settling_s.unwrap_or(f64::NAN);
    let of_key = |(k, key): (usize, &TuneKey)| {
        let of = |values: &[f64]| values.get(k).copied().unwrap_or(f64::NAN);
        let points = good.iter().map(|(t, _, s)| (of(&t.values), *s));
        let panel = Panel::new(key.name.clone(), key.name.clone(), "settling, s")
            .with(Series::new(Symbol::Cross, 0, points).label("run"));
        let panel = if key.range.0 > 0.0 { panel.log_x() } else { panel };
        chosen(&|p| of(&p.values), &settling, panel)
    };
    let mut panels: Vec<Panel> = keys.iter().enumerate().map(of_key).collect();
    let rest = good.iter().map(|(_, f, s)| (*s, f.rest_px));
    let trade = Panel::new("trade-off", "settling, s", "error at rest, px")
        .with(Series::new(Symbol::Cross, 0, rest).label("run"));
    panels.push(chosen(&settling, &|p| p.figures.rest_px, trade));
    let columns = panels.len().min(2);
    standalone_svg(&panels, columns, "vservo tune")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_is_named_twice_is_refused() {
        let words =
            |words: &[&str]| asked(&words.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>()).map(|_| ());
        assert_eq!(words(&["ur5", "servo.gain_1_s=2..60", "servo.gain_at_goal_1_s=1..3"]), Ok(()));
        let twice = words(&["ur5", "servo.gain_1_s=2..60", "servo.gain_1_s =5..9"]);
        assert!(twice.unwrap_err().contains("named twice"));
    }
}
