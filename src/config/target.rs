//! `[target]`: what the camera looks at. Keys and bounds of all kinds in one place.

use super::check::Check;
use super::raw::{table, word};
use crate::target::{DotGrid, FourDots, Target};
use serde::{Deserialize, Serialize};

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
    let length = 1e-6..=100.0;
    for (key, length_m) in [
        ("target.side_m", raw.side_m),
        ("target.radius_m", raw.radius_m),
        ("target.radius_p1_m", raw.radius_p1_m),
        ("target.margin_m", raw.margin_m),
        ("target.dot_grid.pitch_m", raw.dot_grid.pitch_m),
    ] {
        check.range(key, length_m, length.clone());
    }
    let grid = &raw.dot_grid;
    let columns = check.count("target.dot_grid.columns", grid.columns, DotGrid::COUNT);
    let rows = check.count("target.dot_grid.rows", grid.rows, DotGrid::COUNT);
    let mut or = |key: &str, given: Option<f64>, share: f64| {
        given.map_or(share * grid.pitch_m, |m| {
            check.range(&format!("target.dot_grid.{key}"), m, length.clone())
        })
    };
    let radius_m = or("radius_m", grid.radius_m, DotGrid::RADIUS);
    let large_radius_m = or("large_radius_m", grid.large_radius_m, DotGrid::LARGE_RADIUS);
    let margin_m = or("margin_m", grid.margin_m, DotGrid::MARGIN);
    if check.count_problems() > before {
        return None;
    }
    let made = match raw.kind {
        TargetKind::FourDots => {
            FourDots::new(raw.side_m, raw.radius_p1_m, raw.radius_m, raw.margin_m).map(Target::from)
        }
        TargetKind::DotGrid => {
            let (columns, rows) = (columns as usize, rows as usize);
            DotGrid::new(columns, rows, grid.pitch_m, radius_m, large_radius_m, margin_m).map(Target::from)
        }
    };
    made.map_err(|e| check.wrong("target", e.to_string())).ok()
}
