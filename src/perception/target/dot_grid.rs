//! Dots in rows and columns on a light plate; large ones among them tell where in the grid one looks.
//!
//! ```text
//!   0   1   2   3      --> x_o      id = row x columns + column. Point 0 is the origin.
//!   o   O   o   o      |            Which dots are large is drawn from repeatable random numbers, such that no two
//!   O   o   o   O      v y_o        windows of w x w dots look alike, however they are turned: whoever sees
//!   o   O   O   o                   one such window knows which it is. w is 3 for grids up to about 7 x 7.
//! ```
//! A grid of equal dots ([`DotGrid::equal`]) looks the same after a turn: seen whole, its dots are numbered as the image stands.

use super::{Disc, Plate, Symmetry, TargetError, TargetPoint};
use crate::linalg::Random;
use nalgebra::{Point3, Vector2};
use std::ops::RangeInclusive;

/// Smallest window that identifies its place in the grid. Chosen by hand: 3 x 3 dots have 2^9 patterns, 2 x 2 would have 16, too few
/// for a grid.
const MIN_WINDOW: usize = 3;
/// Random patterns that are tried for each window size. Chosen by hand; each trial draws the whole grid, and a larger window is
/// tried when all of them fail, so that more trials can only keep a window smaller.
const TRIALS: u64 = 2000;

/// A grid of dots, in the object frame (m).
#[derive(Debug, Clone, PartialEq)]
pub struct DotGrid {
    columns: usize,
    rows: usize,
    pitch_m: f64,
    radius_m: f64,
    large_radius_m: f64,
    margin_m: f64,
    window: usize,
    large: Box<[bool]>,
    points: Box<[TargetPoint]>,
    discs: Box<[Disc]>,
    light_on_dark: bool,
}

impl DotGrid {
    /// Numbers of columns and rows. Chosen by hand: a window must fit, and 32 is more than any print has.
    pub const COUNT: RangeInclusive<u32> = MIN_WINDOW as u32..=32;
    /// Default radii of small and large dots, and margin of the plate about the outer centres, in pitches. Chosen by hand: large dots are 1.6
    /// times as large as small ones, and neighbouring large ones still leave a third of a pitch between them.
    pub const RADIUS: f64 = 0.2;
    /// Chosen by hand with [`Self::RADIUS`].
    pub const LARGE_RADIUS: f64 = 0.32;
    /// Chosen by hand with [`Self::RADIUS`]: about a large dot there is a little more room than between two.
    pub const MARGIN: f64 = 0.75;
    /// Largest radius of equal dots that is expected, in pitches. Chosen by hand: the surroundings of a dot are searched no farther than it leaves free.
    const EQUAL_RADIUS: f64 = 0.36;

    /// A grid with the usual radii and margin.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn with_pitch(columns: usize, rows: usize, pitch_m: f64) -> Result<Self, TargetError> {
        let of = |share: f64| share * pitch_m;
        Self::new(columns, rows, pitch_m, of(Self::RADIUS), of(Self::LARGE_RADIUS), of(Self::MARGIN))
    }

    /// A grid of `columns` x `rows` dots, their centres `pitch_m` apart; radii of the small and of the large dots; the plate's margin
    /// about the outer centres. Lengths in m.
    ///
    /// # Errors
    /// [`TargetError`] when there are too few dots or too many, lengths are not positive, dots touch each other or the plate's
    /// edge, or large and small ones are too much alike.
    pub fn new(
        columns: usize,
        rows: usize,
        pitch_m: f64,
        radius_m: f64,
        large_radius_m: f64,
        margin_m: f64,
    ) -> Result<Self, TargetError> {
        Self::check_size(columns, rows, pitch_m)?;
        TargetError::if_not_positive([
            ("radius_m", radius_m),
            ("large_radius_m", large_radius_m),
            ("margin_m", margin_m),
        ])?;
        // chosen by hand: half the logarithm of the areas' ratio is then 0.26, which blur must not take from a small dot
        if large_radius_m < 1.3 * radius_m {
            return Err(TargetError::Radii { first_radius_m: large_radius_m, radius_m });
        }
        if 2.2 * large_radius_m > pitch_m {
            return Err(TargetError::Pitch { pitch_m, radius_m, mark_radius_m: large_radius_m });
        }
        if large_radius_m >= margin_m {
            return Err(TargetError::Margin { margin_m, first_radius_m: large_radius_m });
        }
        let (window, large) = pattern(columns, rows);
        Ok(Self::of_pattern([columns, rows], pitch_m, [radius_m, large_radius_m], margin_m, window, large))
    }

    /// A grid of equal dots of any radius, as printed for calibrations. It is found whole or not at all, and a turn that it looks the
    /// same after is not told: ids are those of the way it stands in the image, rows from above, columns from the left.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn equal(columns: usize, rows: usize, pitch_m: f64) -> Result<Self, TargetError> {
        Self::check_size(columns, rows, pitch_m)?;
        let (radius_m, margin_m) = (Self::EQUAL_RADIUS * pitch_m, Self::MARGIN * pitch_m);
        let (window, none) = (columns.min(rows), vec![false; columns * rows].into());
        Ok(Self::of_pattern([columns, rows], pitch_m, [radius_m; 2], margin_m, window, none))
    }

    fn check_size(columns: usize, rows: usize, pitch_m: f64) -> Result<(), TargetError> {
        let sizes = *Self::COUNT.start() as usize..=*Self::COUNT.end() as usize;
        if !sizes.contains(&columns) || !sizes.contains(&rows) {
            return Err(TargetError::Count { columns, rows });
        }
        TargetError::if_not_positive([("pitch_m", pitch_m)])
    }

    fn of_pattern(
        [columns, rows]: [usize; 2],
        pitch_m: f64,
        [radius_m, large_radius_m]: [f64; 2],
        margin_m: f64,
        window: usize,
        large: Box<[bool]>,
    ) -> Self {
        let place = |i: usize| Vector2::new((i % columns) as f64, (i / columns) as f64) * pitch_m;
        let points = (0..columns * rows)
            .map(|i| TargetPoint { id: i as u32, p_O: Point3::new(place(i).x, place(i).y, 0.0) })
            .collect();
        let discs = large
            .iter()
            .enumerate()
            .map(|(i, large)| Disc {
                centre_m: place(i),
                radius_m: if *large { large_radius_m } else { radius_m },
            })
            .collect();
        Self {
            columns,
            rows,
            pitch_m,
            radius_m,
            large_radius_m,
            margin_m,
            window,
            large,
            points,
            discs,
            light_on_dark: false,
        }
    }

    /// Whether all dots are alike.
    #[must_use]
    pub fn is_equal(&self) -> bool {
        !self.large.contains(&true)
    }

    /// Fewest dots by which it is found: a window, or of equal dots all.
    #[must_use]
    pub fn min_to_find(&self) -> usize {
        if self.is_equal() { self.points.len() } else { self.window * self.window }
    }

    /// Dots in a row.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Dots in a column.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Distance of neighbouring centres, m.
    #[must_use]
    pub fn pitch_m(&self) -> f64 {
        self.pitch_m
    }

    /// Radius of the small dots, m.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Radius of the large dots, m.
    #[must_use]
    pub fn large_radius_m(&self) -> f64 {
        self.large_radius_m
    }

    /// Whether the dot in `row` and `column` is a large one; `None` outside of the grid.
    #[must_use]
    pub fn is_large(&self, column: usize, row: usize) -> Option<bool> {
        let inside = column < self.columns && row < self.rows;
        self.large.get(row * self.columns + column).copied().filter(|_| inside)
    }

    /// Side, in dots, of the windows that are all different.
    #[must_use]
    pub fn window(&self) -> usize {
        self.window
    }

    /// The dots' centres, row by row.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// The same grid with light dots on a dark plate, or not.
    #[must_use]
    pub fn light_on_dark(self, light_on_dark: bool) -> Self {
        Self { light_on_dark, ..self }
    }

    /// The dots.
    #[must_use]
    pub fn discs(&self) -> &[Disc] {
        &self.discs
    }

    /// Which turns and mirror images of the grid look like it: no turn, because no two windows look alike, but of equal dots.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        let (columns, rows) = (self.columns, self.rows);
        let same = |place: &dyn Fn(usize, usize) -> (usize, usize)| {
            (0..columns * rows).all(|i| {
                let (x, y) = (i % columns, i / columns);
                let (u, v) = place(x, y);
                self.is_large(x, y) == self.is_large(u, v)
            })
        };
        let mirrored = same(&|x, y| (columns - 1 - x, y))
            || same(&|x, y| (x, rows - 1 - y))
            || columns == rows && (same(&|x, y| (y, x)) || same(&|x, y| (rows - 1 - y, columns - 1 - x)));
        let turns = match self.is_equal() {
            true if columns == rows => 4,
            true => 2,
            false => 1,
        };
        Symmetry { turns, mirrored }
    }

    /// The plate.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let end = |count: usize| (count - 1) as f64 * self.pitch_m + self.margin_m;
        Plate {
            low_m: Vector2::new(-self.margin_m, -self.margin_m),
            high_m: Vector2::new(end(self.columns), end(self.rows)),
            light: !self.light_on_dark,
        }
    }

    /// Every how many columns and rows a dot serves as feature, so that a measurement carries them all.
    pub(super) fn feature_stride(&self) -> usize {
        super::stride(self.columns, self.rows)
    }
}

/// Which dots are large, and the side of the windows that tell their place.
fn pattern(columns: usize, rows: usize) -> (usize, Box<[bool]>) {
    let mut window = MIN_WINDOW;
    loop {
        for seed in 0..TRIALS {
            let mut random = Random::new(seed);
            let large: Box<[bool]> = (0..columns * rows).map(|_| random.uniform() < 0.5).collect();
            // the last size is the whole grid: if that is symmetric, the next draw is not
            if all_windows_differ(&large, columns, rows, window) {
                return (window, large);
            }
        }
        window = (window + 1).min(columns.min(rows));
    }
}

/// Whether no two windows (of at most 64 dots) look alike, in any of their four turns, and none looks like itself turned.
fn all_windows_differ(large: &[bool], columns: usize, rows: usize, window: usize) -> bool {
    let last = window - 1;
    let mut seen = std::collections::HashSet::new();
    for row in 0..=rows - window {
        for column in 0..=columns - window {
            let bit =
                |x: usize, y: usize| large.get((row + y) * columns + column + x).copied().unwrap_or(false);
            for turn in 0..4 {
                let bits = (0..window * window).map(|i| (i % window, i / window)).map(|(x, y)| match turn {
                    0 => bit(x, y),
                    1 => bit(last - y, x),
                    2 => bit(last - x, last - y),
                    _ => bit(y, last - x),
                });
                if !seen.insert(bits.fold(0u64, |code, bit| code << 1 | u64::from(bit))) {
                    return false;
                }
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_of_any_size_have_a_pattern_that_tells_the_place() {
        for (columns, rows, most) in
            [(3, 3, 3), (4, 3, 3), (7, 5, 3), (6, 6, 3), (9, 6, 4), (12, 12, 4), (32, 32, 6)]
        {
            let grid = DotGrid::with_pitch(columns, rows, 0.03).unwrap();
            assert!(grid.window() <= most, "{columns} x {rows}: {}", grid.window());
            assert_eq!(grid.points().len(), columns * rows);
            let large = grid.large.iter().filter(|large| **large).count();
            assert!(large * 5 > columns * rows && large * 5 < 4 * columns * rows, "{large}");
            // derived anew: two windows, one of them turned by matrices of signs
            let w = grid.window() as i64;
            let at = |x: i64, y: i64| grid.is_large(x as usize, y as usize).unwrap();
            for (x0, y0) in [(0, 0), ((columns as i64 - w), 0), (0, (rows as i64 - w))] {
                for (cos, sin) in [(0, 1), (-1, 0), (0, -1)] {
                    let turned = |x: i64, y: i64| {
                        let (u, v) = (2 * x - (w - 1), 2 * y - (w - 1));
                        ((cos * u - sin * v + w - 1) / 2, (sin * u + cos * v + w - 1) / 2)
                    };
                    let alike = (0..w * w).all(|i| {
                        let (x, y) = turned(i % w, i / w);
                        at(x0 + x, y0 + y) == at(i % w, i / w)
                    });
                    assert!(!alike, "{columns} x {rows}");
                }
            }
        }
        assert_eq!(DotGrid::with_pitch(7, 5, 0.03).unwrap(), DotGrid::with_pitch(7, 5, 0.03).unwrap());
    }

    #[test]
    fn equal_dots_look_the_same_turned() {
        let symmetry = |columns, rows| DotGrid::equal(columns, rows, 0.03).unwrap().symmetry();
        assert_eq!(symmetry(6, 6), Symmetry { turns: 4, mirrored: true });
        assert_eq!(symmetry(7, 5), Symmetry { turns: 2, mirrored: true });
        let grid = DotGrid::equal(7, 5, 0.03).unwrap();
        assert!(grid.is_equal() && grid.min_to_find() == 35);
        assert!(!DotGrid::with_pitch(7, 5, 0.03).unwrap().is_equal());
        assert!(DotGrid::equal(2, 5, 0.03).is_err() && DotGrid::equal(5, 5, -1.0).is_err());
    }

    #[test]
    fn impossible_grids_are_refused() {
        assert!(matches!(DotGrid::with_pitch(2, 5, 0.03), Err(TargetError::Count { .. })));
        assert!(matches!(DotGrid::with_pitch(5, 33, 0.03), Err(TargetError::Count { .. })));
        assert!(matches!(DotGrid::with_pitch(5, 5, f64::NAN), Err(TargetError::Length { .. })));
        assert!(matches!(DotGrid::new(5, 5, 0.03, 0.006, 0.007, 0.02), Err(TargetError::Radii { .. })));
        assert!(matches!(DotGrid::new(5, 5, 0.03, 0.006, 0.014, 0.02), Err(TargetError::Pitch { .. })));
        assert!(matches!(DotGrid::new(5, 5, 0.03, 0.006, 0.01, 0.009), Err(TargetError::Margin { .. })));
    }

    #[test]
    fn a_measurement_carries_the_features_of_large_grids() {
        for (columns, rows, features) in [(8, 8, 64), (9, 8, 20), (7, 5, 35), (32, 32, 64)] {
            let target = crate::target::Target::from(DotGrid::with_pitch(columns, rows, 0.01).unwrap());
            let ids: Vec<_> = target.features().map(|point| point.id).collect();
            assert_eq!(ids.len(), features, "{columns} x {rows}");
            assert!(ids.is_sorted());
        }
    }
}
