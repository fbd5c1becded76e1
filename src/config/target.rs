//! `[target]`: what the camera looks at. Keys and bounds of all kinds in one place.

use super::check::Check;
use crate::target::{DotGrid, FourDots, Target};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

pub(super) const LENGTH_M: RangeInclusive<f64> = 1e-6..=100.0;

word! {
    /// What the camera looks at.
    TargetKind {
        /// Four dark dots on a light plate, the first one larger.
        FourDots,
        /// Dark dots in rows and columns, some of them larger.
        DotGrid,
    }
}

table! {
    /// The target's geometry.
    RawTarget {
        /// Kind of target.
        kind: TargetKind = TargetKind::FourDots,
        /// Side of the square of dots, m.
        side_m: f64 = 0.1,
        /// Radius of dots 2 to 4, m.
        radius_m: f64 = 0.010,
        /// Radius of dot 1, m.
        radius_p1_m: f64 = 0.015,
        /// Light margin of the plate around the square, m.
        margin_m: f64 = 0.030,
        /// `[target.dot_grid]`
        dot_grid: RawDotGrid = RawDotGrid::default(),
    }
}

table! {
    /// A grid of dots.
    RawDotGrid {
        /// Dots in a row.
        columns: u32 = 7,
        /// Dots in a column.
        rows: u32 = 5,
        /// Distance of neighbouring dots, m.
        pitch_m: f64 = 0.03,
        /// Radius of the small dots, m; left out: a fifth of the pitch.
        radius_m: Option<f64> = None,
        /// Radius of the large dots, m; left out: 0.32 of the pitch.
        large_radius_m: Option<f64> = None,
        /// Light margin of the plate around the outer centres, m; left out: three quarters of the pitch.
        margin_m: Option<f64> = None,
    }
}

/// The target, where nothing is wrong with it.
pub(super) fn target(raw: &RawTarget, check: &mut Check<'_>) -> Option<Target> {
    let before = check.count_problems();
    let grid = &raw.dot_grid;
    for (key, length_m) in [
        ("target.side_m", Some(raw.side_m)),
        ("target.radius_m", Some(raw.radius_m)),
        ("target.radius_p1_m", Some(raw.radius_p1_m)),
        ("target.margin_m", Some(raw.margin_m)),
        ("target.dot_grid.pitch_m", Some(grid.pitch_m)),
        ("target.dot_grid.radius_m", grid.radius_m),
        ("target.dot_grid.large_radius_m", grid.large_radius_m),
        ("target.dot_grid.margin_m", grid.margin_m),
    ] {
        if let Some(length_m) = length_m {
            check.range(key, length_m, LENGTH_M);
        }
    }
    check.count("target.dot_grid.columns", grid.columns, DotGrid::COUNT);
    check.count("target.dot_grid.rows", grid.rows, DotGrid::COUNT);
    if check.count_problems() > before {
        return None;
    }
    made("target", raw, check)
}

/// The target that lengths within their ranges make; what they do not make is told at `key`.
pub(super) fn made(key: &str, raw: &RawTarget, check: &mut Check<'_>) -> Option<Target> {
    let made = match raw.kind {
        TargetKind::FourDots => {
            FourDots::new(raw.side_m, raw.radius_p1_m, raw.radius_m, raw.margin_m).map(Target::from)
        }
        TargetKind::DotGrid => {
            let grid = &raw.dot_grid;
            let or = |given: Option<f64>, share: f64| given.unwrap_or(share * grid.pitch_m);
            DotGrid::new(
                grid.columns as usize,
                grid.rows as usize,
                grid.pitch_m,
                or(grid.radius_m, DotGrid::RADIUS),
                or(grid.large_radius_m, DotGrid::LARGE_RADIUS),
                or(grid.margin_m, DotGrid::MARGIN),
            )
            .map(Target::from)
        }
    };
    made.map_err(|e| check.wrong(key, e.to_string())).ok()
}

impl RawTarget {
    /// The same target with all lengths times `scale`.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        let grid = &self.dot_grid;
        let times = |given: Option<f64>| given.map(|m| m * scale);
        Self {
            side_m: self.side_m * scale,
            radius_m: self.radius_m * scale,
            radius_p1_m: self.radius_p1_m * scale,
            margin_m: self.margin_m * scale,
            dot_grid: RawDotGrid {
                pitch_m: grid.pitch_m * scale,
                radius_m: times(grid.radius_m),
                large_radius_m: times(grid.large_radius_m),
                margin_m: times(grid.margin_m),
                ..grid.clone()
            },
            ..self.clone()
        }
    }
}
