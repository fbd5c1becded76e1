//! From text to steps that fit each other.

use super::step::{PipelineStep, ThresholdRule};
use super::{PipelineError, STEPS, StepInfo, ValueKind};
use crate::imaging::{Connectivity, EdgeThresholds, Norm, Operator, Polarity, Uniformity};
use crate::input::nearest;
use std::ops::RangeInclusive;

const POLARITIES: [(&str, Polarity); 2] = [("dark", Polarity::Dark), ("light", Polarity::Light)];

/// Reads all steps, in order, with what is written of each.
pub(super) fn parse(text: &str) -> Result<Vec<(String, PipelineStep)>, PipelineError> {
    let mut steps = Vec::new();
    let (mut kind, mut before) = (ValueKind::Image, "the file".to_owned());
    for (number, part) in (1..).zip(text.split('|')) {
        let written = part.trim();
        let info = find(number, written)?;
        if !info.takes.contains(&kind) {
            return Err(mismatch(number, written, info, &before, kind));
        }
        let mut parameters = Parameters::of(written);
        let step = step(info.name, kind, &mut parameters).and_then(|step| {
            let extra = parameters.next();
            extra.map_or(Ok(step), |word| Err(format!("`{word}` is one parameter too many")))
        });
        let step = step.map_err(|problem| PipelineError::Parameter {
            number,
            step: written.into(),
            problem,
            usage: info.usage,
        })?;
        kind = info.gives.unwrap_or(kind);
        before = format!("`{written}`");
        steps.push((written.to_owned(), step));
    }
    Ok(steps)
}

fn find(number: usize, written: &str) -> Result<&'static StepInfo, PipelineError> {
    let word = written.split(':').next().unwrap_or_default().trim();
    if word.is_empty() {
        return Err(PipelineError::Empty { number });
    }
    STEPS.iter().find(|info| info.name == word).ok_or_else(|| {
        let hint = match nearest(word, STEPS.iter().map(|info| info.name)) {
            Some(meant) => format!(": did you mean `{meant}`?"),
            None => format!("; steps are {}", listed(|_| true)),
        };
        PipelineError::Unknown { number, word: word.into(), hint }
    })
}

fn listed(which: impl Fn(&StepInfo) -> bool) -> String {
    let names: Vec<_> = STEPS.iter().filter(|info| which(info)).map(|info| info.name).collect();
    if names.is_empty() { "no step".into() } else { names.join(", ") }
}

fn mismatch(number: usize, written: &str, info: &StepInfo, before: &str, given: ValueKind) -> PipelineError {
    let takes: Vec<_> = info.takes.iter().map(ValueKind::to_string).collect();
    PipelineError::Mismatch {
        number,
        step: written.into(),
        takes: takes.join(" or ").into(),
        before: before.into(),
        given,
        takers: listed(|other| other.takes.contains(&given)).into(),
        givers: if info.takes.contains(&ValueKind::Image) {
            "the file itself, and filters".into()
        } else {
            listed(|other| other.gives.is_some_and(|gives| info.takes.contains(&gives))).into()
        },
    }
}

/// The parameters of one step, as they are asked for. Errors are sentences without the step's name.
struct Parameters<'a> {
    words: std::str::Split<'a, char>,
}

impl<'a> Parameters<'a> {
    fn of(written: &'a str) -> Self {
        let mut words = written.split(':');
        words.next(); // the step's own word
        Self { words }
    }

    fn next(&mut self) -> Option<&'a str> {
        self.words.next().map(str::trim)
    }

    /// Whether `word` comes next, which is then taken.
    fn is_next(&mut self, word: &str) -> bool {
        let mut ahead = self.words.clone();
        let is_next = ahead.next().map(str::trim) == Some(word);
        if is_next {
            self.words = ahead;
        }
        is_next
    }

    /// A number within a range; `default` where it is left out.
    fn number(
        &mut self,
        what: &str,
        range: RangeInclusive<f64>,
        default: Option<f64>,
    ) -> Result<f64, String> {
        match (self.next(), default) {
            (Some(word), _) => word.parse().ok().filter(|v| range.contains(v)).ok_or_else(|| {
                format!("{what} is a number from {} to {}, not `{word}`", range.start(), range.end())
            }),
            (None, Some(default)) => Ok(default),
            (None, None) => Err(format!("{what} is missing")),
        }
    }

    /// A whole number within a range.
    fn whole(&mut self, what: &str, range: RangeInclusive<f64>, default: Option<f64>) -> Result<f64, String> {
        let value = self.number(what, range, default)?;
        if value.fract() == 0.0 { Ok(value) } else { Err(format!("{what} is a whole number, not {value}")) }
    }

    /// One of some words; the first one's where it is left out.
    fn choice<T: Copy, const N: usize>(&mut self, choices: [(&str, T); N]) -> Result<T, String> {
        let word = self.next().or(choices.first().map(|c| c.0)).unwrap_or_default();
        chosen(word, &choices)
    }
}

fn chosen<T: Copy>(word: &str, choices: &[(&str, T)]) -> Result<T, String> {
    choices.iter().find(|(name, _)| *name == word).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<_> = choices.iter().map(|(name, _)| format!("`{name}`")).collect();
        format!("`{word}` is none of {}", names.join(", "))
    })
}

/// The step of a name of [`STEPS`] with its parameters; `kind` is what it is given.
fn step(name: &str, kind: ValueKind, p: &mut Parameters<'_>) -> Result<PipelineStep, String> {
    Ok(match name {
        "histogram" => PipelineStep::Histogram(p.choice(POLARITIES)?),
        "gaussian" => {
            PipelineStep::Gaussian { sd_px: p.number("the standard deviation", 0.05..=20.0, None)? }
        }
        "pyramid" => PipelineStep::Pyramid { level: p.whole("the level", 1.0..=8.0, None)? as usize },
        "threshold" if kind == ValueKind::Image => threshold(p)?,
        "threshold" if p.is_next("otsu") => PipelineStep::AboveOtsu,
        "threshold" => PipelineStep::Above {
            value: p.number("the threshold, if it is not `otsu`,", -1e9..=1e9, None)?,
            normalized: p.choice([("", false), ("normalized", true)])?,
        },
        "local_mean" => PipelineStep::LocalMean {
            radius_px: p.whole("the radius", 1.0..=1447.0, None)? as u16,
            offset_levels: p.whole("the offset", -255.0..=255.0, Some(-8.0))? as i16,
            polarity: p.choice(POLARITIES)?,
        },
        "local_extremes" => PipelineStep::LocalExtremes {
            contrast: p.whole("the contrast", 0.0..=255.0, None)? as u8,
            polarity: p.choice(POLARITIES)?,
        },
        "regions" => {
            PipelineStep::Regions(p.choice([("8", Connectivity::Eight), ("4", Connectivity::Four)])?)
        }
        "merge" => merge(p)?,
        "differences" => PipelineStep::Gradient(Operator::FirstDifferences),
        "roberts" => PipelineStep::Gradient(Operator::Roberts),
        "sobel" => PipelineStep::Gradient(Operator::Sobel),
        "magnitude" => PipelineStep::Magnitude { sum: p.choice([("", false), ("sum", true)])? },
        "direction" => PipelineStep::Direction,
        "laplacian" => PipelineStep::Laplacian,
        "laplacian_edges" => PipelineStep::LaplacianEdges {
            threshold_levels: p.number("the threshold", 0.25..=255.0, None)?,
            min_magnitude: p.whole("the least magnitude", 0.0..=2040.0, Some(100.0))? as u16,
        },
        "edges" => {
            let default = EdgeThresholds { norm: Norm::Euclidean, ..EdgeThresholds::default() };
            let high = p.number("the high threshold", 1.0..=1443.0, Some(default.high.into()))? as f32;
            // Canny's advice: the low one two to three times below the high one
            let low =
                p.number("the low threshold", 1.0..=f64::from(high), Some((0.4 * high).max(1.0).into()))?;
            PipelineStep::Edges(EdgeThresholds { high, low: low as f32, ..default })
        }
        "chains" => PipelineStep::Chains {
            min_points: p.whole("the number of points", 2.0..=1e6, Some(8.0))? as usize,
        },
        "contours" => PipelineStep::Contours,
        "polygons" => PipelineStep::Polygons { tolerance_px: p.number("the tolerance", 0.0..=1e4, None)? },
        "perimeter" => PipelineStep::Perimeter,
        "moments" => PipelineStep::Moments,
        "grey_moments" => PipelineStep::GreyMoments,
        "axes" => PipelineStep::Axes,
        "segments" => {
            PipelineStep::Segments { min_length_px: p.number("the least length", 8.0..=1e4, Some(20.0))? }
        }
        "ellipses" => {
            PipelineStep::Ellipses { min_axis_px: p.number("the least half axis", 5.0..=1e4, Some(5.0))? }
        }
        "corners" => {
            PipelineStep::Corners { strength: p.number("the strength", 0.0..=1e6, Some(400.0))? as f32 }
        }
        "crossings" => {
            PipelineStep::Crossings { response: p.whole("the response", 0.0..=255.0, Some(24.0))? as u8 }
        }
        other => return Err(format!("`{other}` has a name and no meaning")),
    })
}

fn threshold(p: &mut Parameters<'_>) -> Result<PipelineStep, String> {
    let rule = match p.next() {
        Some("otsu") => ThresholdRule::Otsu,
        Some("valley") => ThresholdRule::Valley,
        Some(word) => {
            let level = word.parse().map_err(|_| {
                format!("`{word}` is none of `otsu`, `valley` and a grey level from 0 to 255")
            })?;
            ThresholdRule::Level(level)
        }
        None => return Err("the threshold is missing".into()),
    };
    Ok(PipelineStep::Threshold(rule, p.choice(POLARITIES)?))
}

fn merge(p: &mut Parameters<'_>) -> Result<PipelineStep, String> {
    let word = p.next().ok_or("the uniformity predicate is missing")?;
    let interval = chosen(word, &[("interval", true), ("means", false)])?;
    let levels = p.number("the number of levels", 0.0..=255.0, None)?;
    let uniformity = match interval {
        true if levels.fract() == 0.0 => Uniformity::Range(levels as u8),
        true => return Err(format!("an interval has a whole number of levels, not {levels}")),
        false => Uniformity::Means(levels),
    };
    let min_area_px2 = p.whole("the least area", 0.0..=1e9, Some(0.0))? as u32;
    Ok(PipelineStep::Merge { uniformity, min_area_px2 })
}
