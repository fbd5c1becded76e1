//! `vservo process`: image processing of Sect. 10.2, step by step.

mod page;

use super::detect::{image_file, refused};
use super::{ProcessArguments, json, lost, shown, write_result};
use crate::imaging::ImageView;
use crate::input::{number, printable};
use crate::pipeline::{Pipeline, STEPS, StepOutcome};
use crate::process::ProcessError;
use crate::source::encode_png;
use image::ExtendedColorType;
use serde_json::{Map, Value};
use std::path::Path;

/// Does the steps and tells what they gave; the exit code.
pub(super) fn process_image(arguments: &ProcessArguments) -> Result<u8, ProcessError> {
    let (Some(path), Some(steps)) = (&arguments.image, &arguments.steps) else {
        return Ok(shown(&list(), 0));
    };
    let pipeline = match Pipeline::parse(steps) {
        Ok(pipeline) => pipeline,
        Err(e) => return Ok(refused(&format!("--steps: {e}"), 2)),
    };
    let name = path.display().to_string();
    let image = match image_file::load(path) {
        Ok(image) => image,
        Err(reason) => return Ok(refused(&format!("{name}: {reason}"), 3)),
    };
    let (width, height) = image.dimensions();
    let Ok(view) = ImageView::new(image.as_raw(), width as usize, height as usize) else {
        return Ok(refused(&format!("{name}: the image has no pixels"), 3));
    };
    let outcomes = match pipeline.run(&view) {
        Ok(outcomes) => outcomes,
        Err(e) => return Ok(refused(&e.to_string(), 5)),
    };
    let text = match (arguments.json, arguments.csv) {
        (true, _) => json(&as_json(&name, (width, height), &outcomes)),
        (_, true) => csv(&outcomes),
        _ => outcomes.iter().map(lines).collect(),
    };
    let exit_code = shown(&text, 0);
    Ok(match &arguments.out {
        Some(folder) => write(folder, &name, steps, &image, &outcomes, exit_code),
        None => exit_code,
    })
}

/// All steps for people.
fn list() -> String {
    let mut text = String::new();
    for info in STEPS {
        let takes: Vec<_> = info.takes.iter().map(|kind| kind.word()).collect();
        let gives = info.gives.map_or("the same", |kind| kind.word());
        text += &format!("{}\n    {} -> {gives}: {}\n", info.usage, takes.join(" or "), info.about);
    }
    text
}

/// Numbers of a step for people; of a long table its first rows.
fn lines(outcome: &StepOutcome) -> String {
    // Chosen by hand: half of a terminal's usual height.
    const ROWS: usize = 12;
    let facts: Vec<_> = outcome.facts.iter().map(|(name, v)| format!("{name} {}", short(*v))).collect();
    let mut text = format!("{} -> {}: {}\n", printable(&outcome.step), outcome.kind.word(), facts.join(", "));
    let Some(table) = &outcome.table else { return text };
    text += &format!("    {}\n", table.columns.join(" "));
    for row in table.rows.iter().take(ROWS) {
        let cells: Vec<_> = row.iter().map(|v| short(*v)).collect();
        text += &format!("    {}\n", cells.join(" "));
    }
    if table.rows.len() > ROWS {
        text += &format!("    ... {} rows (--csv, --json and --out have all)\n", table.rows.len());
    }
    text
}

/// Six digits that mean something; whole numbers whole.
fn short(value: f64) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    // Six significant digits, chosen by hand.
    let digits = (5.0 - value.abs().max(1e-12).log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    text.to_owned()
}

fn csv(outcomes: &[StepOutcome]) -> String {
    match outcomes.iter().rev().find_map(|outcome| outcome.table.as_ref()) {
        Some(table) => table.csv(),
        None => {
            let facts = outcomes.last().map(|o| o.facts.as_slice()).unwrap_or_default();
            let rows = facts.iter().map(|(name, value)| format!("{name},{}\n", number(*value)));
            format!("name,value\n{}", rows.collect::<String>())
        }
    }
}

fn as_json(name: &str, (width, height): (u32, u32), outcomes: &[StepOutcome]) -> Value {
    let object = |pairs: &mut dyn Iterator<Item = (&str, f64)>| -> Value {
        // what is no number has no JSON: null
        pairs.map(|(name, v)| (name.to_owned(), serde_json::json!(v))).collect::<Map<_, _>>().into()
    };
    let step = |outcome: &StepOutcome| {
        let mut step = Map::new();
        step.insert("step".into(), outcome.step.clone().into());
        step.insert("kind".into(), outcome.kind.word().into());
        step.insert("facts".into(), object(&mut outcome.facts.iter().map(|(name, v)| (*name, *v))));
        if let Some(table) = &outcome.table {
            let row = |row: &Vec<f64>| object(&mut table.columns.iter().copied().zip(row.iter().copied()));
            step.insert("rows_of".into(), table.of.into());
            step.insert("rows".into(), table.rows.iter().map(row).collect::<Vec<_>>().into());
        }
        Value::from(step)
    };
    serde_json::json!({
        "image": name,
        "width_px": width,
        "height_px": height,
        "steps": outcomes.iter().map(step).collect::<Vec<_>>(),
    })
}

/// The name of a step's files without their end: its number and its word.
fn stem(number: usize, outcome: &StepOutcome) -> String {
    let word: String = outcome.step.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
    format!("{number}-{word}")
}

/// Writes images, tables and the page; the exit code.
fn write(
    folder: &Path,
    name: &str,
    steps: &str,
    image: &image::GrayImage,
    outcomes: &[StepOutcome],
    mut exit_code: u8,
) -> u8 {
    if let Err(cause) = std::fs::create_dir_all(folder) {
        return lost(folder, cause, exit_code);
    }
    for (number, outcome) in (1..).zip(outcomes) {
        let stem = stem(number, outcome);
        let drawn = &outcome.drawn;
        match encode_png(&drawn.rgb, drawn.width, drawn.height, ExtendedColorType::Rgb8) {
            Ok(bytes) => exit_code = write_result(&folder.join(format!("{stem}.png")), bytes, exit_code),
            Err(e) => exit_code = lost(folder, std::io::Error::other(e), exit_code),
        }
        if let Some(table) = &outcome.table {
            exit_code = write_result(&folder.join(format!("{stem}.csv")), table.csv(), exit_code);
        }
    }
    let page = page::page(name, steps, image, outcomes);
    write_result(&folder.join("index.html"), page, exit_code)
}
