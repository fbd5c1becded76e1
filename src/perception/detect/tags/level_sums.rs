//! Sums of grey levels between any two points of a row or column, each pixel one wide about its centre.

use crate::imaging::ImageView;

/// Pixels that are summed beforehand, from the middle on either side. Derived: windows reach 8 px (`MAX_HALF_PX` of the edges), those of the levels 2.5 px
/// further, on a diagonal 1.4 times as much, and a pixel is cut at either end.
const REACH: usize = 17;
/// Sums that are kept, which follows: of none, and of each pixel more.
const COUNT: usize = 2 * REACH + 2;

/// One row or column of an image, and the sums of its levels from a pixel on.
pub(super) struct LevelSums<'a> {
    image: &'a ImageView<'a>,
    /// Number of the row (true) or column.
    line: (usize, bool),
    /// The first pixel that is summed, and the sums of none, of it, of it and the next, and so on.
    from: usize,
    sums: [u32; COUNT],
    count: usize,
}

impl<'a> LevelSums<'a> {
    /// Of no line yet.
    pub(super) fn new(image: &'a ImageView<'a>) -> Self {
        Self { image, line: (0, true), from: 0, sums: [0; COUNT], count: 0 }
    }

    /// Takes the sums of line number `line.0`, a row where `line.1`, from one place to another, px.
    #[inline]
    pub(super) fn take(&mut self, line: (usize, bool), (low, high): (f64, f64)) {
        let (number, is_row) = line;
        let size = if is_row { self.image.width() } else { self.image.height() };
        // frames fit into 32 bits, to which less is converted
        let from = ((low + 0.5) as u32 as usize).min(size);
        let until = ((high + 0.5) as u32 as usize + 1).min(size).min(from + COUNT - 1).max(from);
        (self.line, self.from, self.count) = (line, from, until - from);
        let mut sum = 0;
        let mut note = |(slot, level): (&mut u32, u8)| {
            sum += u32::from(level);
            *slot = sum;
        };
        let slots = self.sums.iter_mut().skip(1);
        if is_row {
            let levels = self.image.row(number).get(from..until).unwrap_or(&[]);
            slots.zip(levels.iter().copied()).for_each(&mut note);
        } else {
            slots.zip(self.image.column_from(number, from).take(until - from)).for_each(&mut note);
        }
    }

    /// The integral of the levels from where the sums begin to `x`, which lies within the line, level px; only differences count.
    #[inline]
    pub(super) fn up_to(&self, x: f64) -> f64 {
        let pixels = x + 0.5 - self.from as f64;
        let whole = pixels as u32 as usize;
        let part = pixels - whole as f64;
        if part >= 0.0
            && whole < self.count
            && let Some(&[before, with]) = self.sums.get(whole..).and_then(|sums| sums.first_chunk())
        {
            f64::from(before) + part * f64::from(with - before)
        } else {
            self.added(x)
        }
    }

    /// The same where the pixels are not summed yet.
    #[cold]
    fn added(&self, x: f64) -> f64 {
        let at = |k: usize| {
            let (x, y) = if self.line.1 { (k, self.line.0) } else { (self.line.0, k) };
            let level = (y < self.image.height()).then(|| self.image.row(y).get(x)).flatten();
            level.map_or(0.0, |level| f64::from(*level))
        };
        let edge = (x + 0.5).max(0.0);
        let last = edge as usize;
        let part = (edge - last as f64) * at(last);
        if last >= self.from {
            (self.from..last).map(at).sum::<f64>() + part
        } else {
            part - (last..self.from).map(at).sum::<f64>()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sums_are_those_of_pixels_one_wide(
            seed in any::<u64>(), is_row in any::<bool>(), middle in 0.0f64..60.0, reach in 0.0f64..16.0,
            (a, b) in (-0.4f64..59.4, -0.4f64..59.4),
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..60 * 60).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            }).collect();
            let image = ImageView::new(&pixels, 60, 60).unwrap();
            let (x0, x1) = (a.min(b), a.max(b));
            let level = |k: usize| f64::from(if is_row { image.row(7)[k] } else { image.row(k)[7] });
            let share = |k: f64| ((k + 0.5).min(x1) - (k - 0.5).max(x0)).max(0.0);
            let expected: f64 = (0..60).map(|k| share(k as f64) * level(k)).sum();
            let mut sums = LevelSums::new(&image);
            // of another line before
            sums.take((9, !is_row), (middle - reach, middle + reach));
            sums.take((7, is_row), (middle - reach, middle + reach));
            prop_assert!((sums.up_to(x1) - sums.up_to(x0) - expected).abs() < 1e-9);
        }
    }
}
