//! One robot pose as ViSP writes a pose vector: a matrix of 6 x 1, `tx ty tz` in m and `theta u` in rad, as YAML.
//!
//! ```text
//! rows: 6
//! cols: 1
//! data:
//!   - [0.335091]
//!   - ...
//! ```

use super::poses_file::PosesFileError;
use crate::geometry::Pose;
use nalgebra::Vector3;
use saphyr_parser::{Event, Parser};

/// Most words of a file. Chosen by hand: rows, cols, data and their numbers are some ten.
const MAX_WORDS: usize = 64;

/// The pose in a file's text.
///
/// # Errors
/// [`PosesFileError`] with the line.
pub fn read_visp_pose(text: &str) -> Result<Pose, PosesFileError> {
    let mut words: Vec<(String, usize)> = Vec::new();
    let mut line = 1;
    // ViSP and OpenCV begin files in a way that YAML does not know
    let text =
        if text.starts_with("%YAML:") { text.replacen("%YAML:", "#YAML:", 1) } else { text.to_owned() };
    for event in Parser::new_from_str(&text) {
        match event {
            Ok((Event::Scalar(word, ..), span)) => {
                line = span.start.line();
                words.push((word.into_owned(), line));
            }
            Ok((Event::Alias(_), span)) => {
                return Err(PosesFileError::at(span.start.line(), "refers to another part of the file"));
            }
            Ok(_) => {}
            Err(error) => {
                let message = format!("not valid YAML: {}", error.info());
                return Err(PosesFileError::at(error.marker().line(), message));
            }
        }
        if words.len() > MAX_WORDS {
            return Err(PosesFileError::at(line, "is longer than a pose of 6 numbers"));
        }
    }
    let after = |key: &str| words.iter().position(|(word, _)| word == key).map(|at| at + 1);
    for (key, wanted) in [("rows", "6"), ("cols", "1")] {
        let found = after(key).and_then(|at| words.get(at));
        match found {
            Some((word, _)) if word == wanted => {}
            Some((word, line)) => {
                let shown: String = word.chars().take(20).collect();
                return Err(PosesFileError::at(
                    *line,
                    format!("{key} is {shown}, a pose tx ty tz and theta u has {wanted}"),
                ));
            }
            None => {
                return Err(PosesFileError::at(
                    line,
                    format!("has no {key}: a pose vector of ViSP is expected"),
                ));
            }
        }
    }
    let Some(from) = after("data") else {
        return Err(PosesFileError::at(line, "has no data: a pose vector of ViSP is expected"));
    };
    let mut numbers = Vec::new();
    for (word, line) in words.iter().skip(from) {
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => numbers.push(number),
            // a further key
            _ if numbers.len() == 6 => break,
            _ => return Err(PosesFileError::at(*line, "data has something that is not a finite number")),
        }
    }
    let [x, y, z, a, b, c] = *numbers.as_slice() else {
        return Err(PosesFileError::at(line, format!("data has {} numbers, a pose 6", numbers.len())));
    };
    Ok(Pose::new(Vector3::new(x, y, z), Vector3::new(a, b, c)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn pose_vectors_are_read() {
        let text = "%YAML:1.0\nrows: 6\ncols: 1\ndata: \n  - [0.3]\n  - [-0.03]\n  - [0.3]\n  - [-3.0]\n  - [0.02]\n  - [-0.4]\n";
        let X = read_visp_pose(text).unwrap();
        assert_eq!(X, Pose::new(Vector3::new(0.3, -0.03, 0.3), Vector3::new(-3.0, 0.02, -0.4)));
        for (from, to, line, told) in [
            ("rows: 6", "rows: 4", 2, "rows is 4"),
            ("[0.02]", "[x]", 9, "not a finite number"),
            ("  - [-0.4]\n", "", 9, "5 numbers"),
            ("data", "date", 10, "no data"),
            ("- [0.3]", "- [0.3", 6, "YAML"),
        ] {
            let error = read_visp_pose(&text.replace(from, to)).unwrap_err();
            assert!(error.message.contains(told), "{from}: {error}");
            assert!(error.line.abs_diff(line) <= 1, "{from}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_pose_or_an_error(text in "(rows: [0-9]|cols: [0-9]|data:|[-: \\[\\]{}&*a0-9.\n]){0,30}") {
            let _ = read_visp_pose(&text);
        }
    }
}
