//! Range checks of single values, and the list of problems: every key of a run file passes through here.

use super::{Document, Problem, pose_forms};
use crate::geometry::{Pose, rotation_x, rotation_y, rotation_z};
use crate::input::number;
use crate::time::SpanNs;
use nalgebra::{Translation3, UnitQuaternion};
use std::ops::RangeInclusive;
use std::path::Path;

/// The problems found so far, each with its position in the document.
pub(super) struct Validation<'a> {
    document: &'a Document,
    problems: &'a mut Vec<Problem>,
    warnings: Vec<Problem>,
}

impl<'a> Validation<'a> {
    pub(super) fn new(document: &'a Document, problems: &'a mut Vec<Problem>) -> Self {
        Self { document, problems, warnings: Vec::new() }
    }

    pub(super) fn take_warnings(&mut self) -> Vec<Problem> {
        std::mem::take(&mut self.warnings)
    }

    /// Whether the run file or an argument has the key, or a part of the table.
    pub(super) fn is_written(&self, key: &str) -> bool {
        self.document.get(key).is_some()
    }

    /// The numbers of the list that is written at `key`.
    pub(super) fn written_list(&self, key: &str) -> Option<Vec<f64>> {
        let number = |value: &toml::Value| value.as_float().or(value.as_integer().map(|i| i as f64));
        self.document.get(key)?.as_array()?.iter().map(number).collect()
    }

    pub(super) fn count_problems(&self) -> usize {
        self.problems.len()
    }

    /// Whether a pose is unknown because it is invalid: checks that depend on it are then skipped.
    pub(super) fn misses_a_pose(&self) -> bool {
        self.problems.iter().any(|problem| pose_forms::is_form(&problem.key))
    }

    pub(super) fn wrong(&mut self, key: &str, message: impl Into<String>) {
        self.problems.push(self.document.problem(key, message));
    }

    /// Allowed, but hardly what is meant.
    pub(super) fn doubtful(&mut self, key: &str, message: impl Into<String>) {
        self.warnings.push(self.document.problem(key, message));
    }

    /// The one bound of a number: every key goes through here or through [`Self::count`]. The ranges are those that no
    /// real cell leaves, so that no computation on them leaves the finite numbers.
    pub(super) fn range(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>) -> f64 {
        if !allowed.contains(&value) {
            let (low, high) = (number(*allowed.start()), number(*allowed.end()));
            self.wrong(key, format!("{} is out of range, allowed is {low} to {high}", number(value)));
        }
        value
    }

    pub(super) fn count(&mut self, key: &str, value: u32, allowed: RangeInclusive<u32>) -> u32 {
        if !allowed.contains(&value) {
            self.wrong(
                key,
                format!("{value} is out of range, allowed is {} to {}", allowed.start(), allowed.end()),
            );
        }
        value
    }

    /// A program that the run starts, and where: `command` is empty where it is started by other means.
    pub(super) fn program(&mut self, command_key: &str, command: &[String], folder_key: &str, folder: &Path) {
        if command.first().is_some_and(String::is_empty) {
            self.wrong(command_key, "the program's name is empty");
        }
        if !command.is_empty() && !folder.is_dir() {
            self.wrong(folder_key, format!("{} is not a folder", folder.display()));
        }
    }

    pub(super) fn span_ms(&mut self, key: &str, value_ms: f64, allowed: RangeInclusive<f64>) -> SpanNs {
        SpanNs::from_s(self.range(key, value_ms, allowed) * 1e-3)
    }

    pub(super) fn pose(&mut self, key: &str, position_m: [f64; 3], rotation_rpy_rad: [f64; 3]) -> Pose {
        for (i, v) in position_m.iter().enumerate() {
            self.range(&format!("{key}.position_m[{i}]"), *v, -100.0..=100.0);
        }
        for (i, v) in rotation_rpy_rad.iter().enumerate() {
            self.range(&format!("{key}.rotation_rpy_rad[{i}]"), *v, -6.3..=6.3);
        }
        pose(position_m, rotation_rpy_rad)
    }
}

/// The pose of a position, m, and roll, pitch, yaw, rad.
pub(super) fn pose(position_m: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Pose {
    let R = rotation_z(yaw) * rotation_y(pitch) * rotation_x(roll);
    Pose::from_parts(Translation3::from(position_m), UnitQuaternion::from_rotation_matrix(&R))
}
