//! As much YAML as a calibration file needs: keys with a word, a number or a list, and tables of such keys.
//!
//! The text is read event by event, and nothing is kept but short words and lists, so that no file, however it is nested, takes
//! more memory than its own length. References to other parts of a file are refused.

use super::CameraInfoError;
use saphyr_parser::{Event, Parser};
use std::str::FromStr;

/// Most keys and most entries of a list, so that a hostile file takes no memory: real files have some twenty, and twelve.
const MOST: usize = 256;
/// Longest word that is quoted in a message, characters, so that the message stays a line.
const TOLD: usize = 60;

/// A value and where it stands.
#[derive(Debug)]
struct YamlEntry {
    /// `table.key`.
    key: String,
    line: usize,
    value: YamlValue,
}

#[derive(Debug)]
enum YamlValue {
    Word(String),
    List(Vec<String>),
    Table,
}

/// Rows and columns of a matrix, and its numbers row by row.
type YamlMatrix = ((usize, usize), Vec<f64>);

/// What a file says, key by key.
#[derive(Debug)]
pub(super) struct Entries {
    all: Vec<YamlEntry>,
    last_line: usize,
}

/// A walk through the events of a file.
struct Walk<'a> {
    parser: Parser<'a, saphyr_parser::StrInput<'a>>,
    line: usize,
}

impl<'a> Walk<'a> {
    fn next(&mut self) -> Result<Event<'a>, CameraInfoError> {
        match self.parser.next() {
            Some(Ok((Event::Alias(_), span))) => Err(CameraInfoError {
                line: span.start.line(),
                message: "refers to another part of the file".into(),
            }),
            Some(Ok((event, span))) => {
                self.line = span.start.line();
                Ok(event)
            }
            Some(Err(error)) => {
                let message = format!("not valid YAML: {}", error.info());
                Err(CameraInfoError { line: error.marker().line(), message })
            }
            None => Err(self.wrong("the file ends early")),
        }
    }

    fn wrong(&self, message: impl Into<String>) -> CameraInfoError {
        CameraInfoError { line: self.line, message: message.into() }
    }

    /// Passes over what `event` has begun.
    fn pass_over(&mut self, event: &Event<'_>) -> Result<(), CameraInfoError> {
        let mut depth = 0usize;
        let mut next = None;
        loop {
            match next.as_ref().unwrap_or(event) {
                Event::SequenceStart(..) | Event::MappingStart(..) => depth += 1,
                Event::SequenceEnd | Event::MappingEnd => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 {
                return Ok(());
            }
            next = Some(self.next()?);
        }
    }

    /// The words of a list; one with anything else in it is none that anybody asks for.
    fn list(&mut self) -> Result<Option<Vec<String>>, CameraInfoError> {
        let mut words = Some(Vec::new());
        loop {
            match self.next()? {
                Event::SequenceEnd => return Ok(words),
                Event::Scalar(word, ..) => {
                    if let Some(list) = words.as_mut().filter(|list| list.len() < MOST) {
                        list.push(word.into_owned());
                    } else {
                        words = None;
                    }
                }
                other => {
                    self.pass_over(&other)?;
                    words = None;
                }
            }
        }
    }
}

impl Entries {
    pub(super) fn read(text: &str) -> Result<Self, CameraInfoError> {
        // OpenCV begins its files so, where YAML asks for a blank, and escapes an apostrophe, which YAML does not know.
        let blank;
        let text = if text.starts_with("%YAML:") {
            blank = text.replacen("%YAML:", "#YAML:", 1).replace("\\'", "'");
            blank.as_str()
        } else {
            text
        };
        let mut walk = Walk { parser: Parser::new_from_str(text), line: 1 };
        let mut entries = Self { all: Vec::new(), last_line: text.lines().count().max(1) };
        loop {
            match walk.next()? {
                Event::MappingStart(..) => break,
                Event::StreamStart | Event::DocumentStart(_) | Event::Nothing => {}
                _ => {
                    return Err(
                        walk.wrong("is no calibration file: keys such as `image_width: 640` are expected")
                    );
                }
            }
        }
        entries.table(&mut walk, "")?;
        // What follows must be YAML too, but says nothing.
        while walk.next()? != Event::StreamEnd {}
        Ok(entries)
    }

    fn table(&mut self, walk: &mut Walk<'_>, prefix: &str) -> Result<(), CameraInfoError> {
        loop {
            let name = match walk.next()? {
                Event::MappingEnd => return Ok(()),
                Event::Scalar(name, ..) => name,
                other => {
                    walk.pass_over(&other)?;
                    let value = walk.next()?;
                    walk.pass_over(&value)?;
                    continue;
                }
            };
            let line = walk.line;
            let key = format!("{prefix}{name}");
            if self.all.len() >= MOST {
                return Err(walk.wrong(format!("has more than {MOST} keys")));
            }
            if self.all.iter().any(|entry| entry.key == key) {
                return Err(walk.wrong(format!("{} is given twice", told(&key))));
            }
            let value = match walk.next()? {
                Event::Scalar(word, ..) => YamlValue::Word(word.into_owned()),
                Event::SequenceStart(..) => match walk.list()? {
                    Some(list) => YamlValue::List(list),
                    None => continue,
                },
                Event::MappingStart(..) if prefix.is_empty() => {
                    self.all.push(YamlEntry { key: key.clone(), line, value: YamlValue::Table });
                    self.table(walk, &format!("{key}."))?;
                    continue;
                }
                other => {
                    walk.pass_over(&other)?;
                    continue;
                }
            };
            self.all.push(YamlEntry { key, line, value });
        }
    }

    fn find(&self, key: &str) -> Option<&YamlEntry> {
        self.all.iter().find(|entry| entry.key == key)
    }

    /// A problem with `key`, at its line.
    pub(super) fn wrong(&self, key: &str, message: impl AsRef<str>) -> CameraInfoError {
        let line = self.find(key).map_or(self.last_line, |entry| entry.line);
        CameraInfoError { line, message: format!("{key} {}", message.as_ref()) }
    }

    pub(super) fn missing(&self, key: &str) -> CameraInfoError {
        self.wrong(key, "is missing")
    }

    /// The word at `key`, where it is given.
    pub(super) fn text(&self, key: &str) -> Result<Option<&str>, CameraInfoError> {
        match self.find(key).map(|entry| &entry.value) {
            None => Ok(None),
            Some(YamlValue::Word(word)) => Ok(Some(word)),
            Some(_) => Err(self.wrong(key, "must be a single word")),
        }
    }

    /// The number at `key`.
    pub(super) fn number<T: FromStr>(&self, key: &str, wanted: &str) -> Result<T, CameraInfoError> {
        let word = self.text(key)?.ok_or_else(|| self.missing(key))?;
        word.parse().map_err(|_| self.wrong(key, format!("is `{}`, {wanted} is expected", told(word))))
    }

    /// The matrix at `key` with so many rows, where it is given.
    pub(super) fn matrix<const N: usize>(
        &self,
        key: &str,
        rows: usize,
    ) -> Result<Option<[f64; N]>, CameraInfoError> {
        let cols = N / rows.max(1);
        let Some((found, data)) = self.sized(key)? else { return Ok(None) };
        let shape = |rows: usize, cols: usize| format!("{rows} x {cols}");
        if found != (rows, cols) {
            let message = format!("is {}, {} is expected", shape(found.0, found.1), shape(rows, cols));
            return Err(self.wrong(key, message));
        }
        let data = data.try_into().map_err(|_| self.wrong(key, format!("is not {}", shape(rows, cols))))?;
        Ok(Some(data))
    }

    /// The numbers of a matrix of one row (or one column) at `key`, where it is given.
    pub(super) fn row(&self, key: &str) -> Result<Option<Vec<f64>>, CameraInfoError> {
        let Some(((rows, cols), data)) = self.sized(key)? else { return Ok(None) };
        if rows != 1 && cols != 1 {
            return Err(self.wrong(key, format!("is {rows} x {cols}, one row is expected")));
        }
        Ok(Some(data))
    }

    /// The list of finite numbers at `key`.
    pub(super) fn numbers(&self, key: &str) -> Result<Vec<f64>, CameraInfoError> {
        let list = match self.find(key).map(|entry| &entry.value) {
            None => return Err(self.missing(key)),
            Some(YamlValue::List(list)) => list,
            Some(_) => return Err(self.wrong(key, "must be a list of numbers")),
        };
        let mut data = Vec::new();
        for (i, word) in list.iter().enumerate() {
            let value: Option<f64> = word.parse().ok().filter(|value: &f64| value.is_finite());
            let message = || format!("has `{}` as entry {}, a number is expected", told(word), i + 1);
            data.push(value.ok_or_else(|| self.wrong(key, message()))?);
        }
        Ok(data)
    }

    /// Rows, columns and numbers of the matrix at `key`, as many as rows and columns say.
    fn sized(&self, key: &str) -> Result<Option<YamlMatrix>, CameraInfoError> {
        let Some(entry) = self.find(key) else { return Ok(None) };
        if !matches!(entry.value, YamlValue::Table) {
            return Err(self.wrong(key, "must have rows, cols and data"));
        }
        let count = |name: &str| self.number(&format!("{key}.{name}"), "a whole number");
        let (rows, cols): (usize, usize) = (count("rows")?, count("cols")?);
        let data_key = format!("{key}.data");
        let data = self.numbers(&data_key)?;
        if rows.checked_mul(cols) != Some(data.len()) {
            let message = format!("has {} entries, {rows} rows of {cols} are announced", data.len());
            return Err(self.wrong(&data_key, message));
        }
        Ok(Some(((rows, cols), data)))
    }
}

/// A word of a file, short enough for a message.
fn told(word: &str) -> String {
    word.chars().take(TOLD).collect()
}

/// A number as all YAML readers take it for one: those of Python ask for a point, and for a sign of the exponent.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((digits, exponent)) = text.split_once('e') else { return text };
    let point = if digits.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{digits}{point}e{sign}{exponent}")
}

/// A word as all YAML readers take it for one: plain where it looks like a name, otherwise in quotes.
pub(super) fn word(text: &str) -> String {
    const NO_NAMES: [&str; 9] = ["true", "false", "yes", "no", "on", "off", "null", "y", "n"];
    let plain = text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !NO_NAMES.contains(&text.to_ascii_lowercase().as_str());
    if plain {
        return text.into();
    }
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted.push(' '),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}
