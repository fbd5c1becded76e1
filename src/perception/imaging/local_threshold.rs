//! Thresholds by the least and the greatest level about each place.

use super::ImageView;
use super::simd::kernel;

/// Thresholds that follow the local light: one per tile of [`LocalThreshold::TILE`] px, or of [`LocalThreshold::FINE_TILE`].
#[derive(Debug, Clone)]
pub struct LocalThreshold {
    tile: usize,
    /// Tiles in a row.
    columns: usize,
    low: Vec<u8>,
    high: Vec<u8>,
    /// Of the tiles before the extremes of those beside them are taken in.
    beside: Vec<u8>,
    tiles: Vec<u8>,
    /// Least and greatest level about each tile; the other way round where they differ too little.
    lowest: Vec<u8>,
    highest: Vec<u8>,
    row: Vec<u8>,
    /// Least and greatest level of each column of a band of tiles.
    column_low: Vec<u8>,
    column_high: Vec<u8>,
}

impl Default for LocalThreshold {
    fn default() -> Self {
        Self::with_size(0, 0)
    }
}

impl LocalThreshold {
    /// Side of a tile, px. Chosen by hand: with its neighbours 96 px, across which something dark and something light lie; half misses that about
    /// things of more than 48 px, twice no longer follows light that changes within a target.
    pub const TILE: usize = 32;
    /// Side of a tile where the light margin of a small thing counts, px. Chosen by hand: with its neighbours 12 px, a few cells of a small tag; of a
    /// larger thing's inside it says nothing.
    pub const FINE_TILE: usize = 4;

    /// Buffers for images of at most this size, allocated at once.
    #[must_use]
    pub fn with_size(width: usize, height: usize) -> Self {
        Self::with_tiles(Self::TILE, width, height)
    }

    /// The same with fine tiles.
    #[must_use]
    pub fn fine(width: usize, height: usize) -> Self {
        Self::with_tiles(Self::FINE_TILE, width, height)
    }

    fn with_tiles(tile: usize, width: usize, height: usize) -> Self {
        let tiles = width.div_ceil(tile) * height.div_ceil(tile);
        let (of_tiles, of_columns) = (|| Vec::with_capacity(tiles), || Vec::with_capacity(width));
        Self {
            tile,
            columns: 0,
            low: of_tiles(),
            high: of_tiles(),
            beside: of_tiles(),
            tiles: of_tiles(),
            lowest: of_tiles(),
            highest: of_tiles(),
            row: of_columns(),
            column_low: of_columns(),
            column_high: of_columns(),
        }
    }

    /// Half-way between the least and the greatest level of each tile and its eight neighbours; `otherwise` where
    /// they differ by less than `contrast`. The greatest difference anywhere.
    pub fn set(&mut self, image: &ImageView<'_>, contrast: u8, otherwise: u8) -> u8 {
        self.measure(image);
        self.take_in_neighbours(contrast, otherwise, 0)
    }

    /// The same for pixels *below* their threshold, which a pixel half-way is too ([`Runs::find_below`](super::Runs::find_below)): where
    /// the extremes differ by less than is asked for, no pixel is below. `contrast` is told the spread of levels within a tile that one
    /// in `quiet` of the tiles have at most, and says what to ask for, at least 1. Whether there is as much anywhere.
    pub fn set_below(
        &mut self,
        image: &ImageView<'_>,
        quiet: usize,
        contrast: impl FnOnce(u8) -> u8,
    ) -> bool {
        self.measure(image);
        let contrast = contrast(self.quiet_spread(quiet)).max(1);
        self.take_in_neighbours(contrast, 0, 1) >= contrast
    }

    /// The spread of levels within a tile that one in `quiet` of the tiles have at most.
    fn quiet_spread(&self, quiet: usize) -> u8 {
        let mut counts = [0usize; 256];
        for (low, high) in self.low.iter().zip(&self.high) {
            counts[usize::from(high.saturating_sub(*low))] += 1;
        }
        let (wanted, mut passed) = (self.low.len() / quiet.max(1), 0);
        let spread = counts.iter().position(|count| {
            passed += count;
            passed > wanted
        });
        spread.map_or(0, |spread| spread as u8)
    }

    /// Least and greatest level of each tile.
    fn measure(&mut self, image: &ImageView<'_>) {
        let (columns, rows) = (image.width().div_ceil(self.tile), image.height().div_ceil(self.tile));
        self.columns = columns;
        for buffer in [&mut self.low, &mut self.high] {
            buffer.clear();
            buffer.resize(columns * rows, 0);
        }
        for buffer in [&mut self.column_low, &mut self.column_high, &mut self.row] {
            buffer.clear();
            buffer.resize(image.width(), 0);
        }
        let bands = self.low.chunks_mut(columns).zip(self.high.chunks_mut(columns));
        for (band, (low, high)) in bands.enumerate() {
            self.column_low.fill(255);
            self.column_high.fill(0);
            let (from, last) = (band * self.tile, image.height() - 1);
            for y in (from..=last).take(self.tile).step_by(4) {
                // the last row again where there are no more
                let rows = [y, y + 1, y + 2, y + 3].map(|y| image.row(y.min(last)));
                four_rows(rows, &mut self.column_low, &mut self.column_high);
            }
            let columns = [&self.column_low[..], &self.column_high];
            match self.tile {
                Self::FINE_TILE => of_tiles::<{ Self::FINE_TILE }>(columns, [low, high]),
                _ => of_tiles::<{ Self::TILE }>(columns, [low, high]),
            }
        }
    }

    /// Thresholds half-way between the extremes of 3 x 3 tiles, and `above` that; `otherwise` where they differ by less than `contrast`. The
    /// greatest difference.
    fn take_in_neighbours(&mut self, contrast: u8, otherwise: u8, above: u8) -> u8 {
        let columns = self.columns;
        beside_in_rows(&mut self.low, &mut self.beside, columns, u8::min);
        beside_in_rows(&mut self.high, &mut self.beside, columns, u8::max);
        for buffer in [&mut self.tiles, &mut self.lowest, &mut self.highest] {
            buffer.clear();
            buffer.resize(self.low.len(), 0);
        }
        let out = self.tiles.chunks_mut(columns).zip(self.lowest.chunks_mut(columns));
        let (rows, mut greatest) = (self.low.len() / columns, 0);
        for (row, ((tiles, lowest), highest)) in out.zip(self.highest.chunks_mut(columns)).enumerate() {
            let near = [row.saturating_sub(1), row, (row + 1).min(rows - 1)];
            let [low, high] = [&self.low, &self.high]
                .map(|tiles| near.map(|row| tiles.get(row * columns..(row + 1) * columns).unwrap_or(&[])));
            greatest =
                greatest.max(halves(low, high, [contrast, otherwise, above], [tiles, lowest, highest]));
        }
        greatest
    }

    /// Moves the thresholds that were [`set`](Self::set) to another `share` of the way from the least level to the greatest, in
    /// 256ths.
    pub fn move_to(&mut self, share: u8) {
        for (tile, (&low, &high)) in self.tiles.iter_mut().zip(self.lowest.iter().zip(&self.highest)) {
            if high >= low {
                *tile = (u16::from(low) + ((u16::from(high - low) * u16::from(share)) >> 8)) as u8;
            }
        }
    }

    /// The threshold of a pixel.
    #[inline]
    pub(super) fn at(&self, x: u32, y: u32) -> u8 {
        // by constants, since divisions by others take long
        let [column, row] = match self.tile {
            Self::FINE_TILE => [x, y].map(|p| p as usize / Self::FINE_TILE),
            _ => [x, y].map(|p| p as usize / Self::TILE),
        };
        self.tiles.get(row * self.columns + column).copied().unwrap_or(0)
    }

    /// Thresholds of the pixels of row `y`, to be asked for in order.
    pub(super) fn row(&mut self, y: usize) -> &[u8] {
        if y.is_multiple_of(self.tile)
            && let Some(tiles) = self.tiles.get(y / self.tile * self.columns..)
        {
            match self.tile {
                Self::FINE_TILE => fill::<{ Self::FINE_TILE }>(tiles, &mut self.row),
                _ => fill::<{ Self::TILE }>(tiles, &mut self.row),
            }
        }
        &self.row
    }
}

/// A value for each `TILE` pixels.
fn fill<const TILE: usize>(tiles: &[u8], row: &mut [u8]) {
    let (whole, rest) = row.as_chunks_mut::<TILE>();
    for (pixels, tile) in whole.iter_mut().zip(tiles) {
        *pixels = [*tile; TILE];
    }
    if let Some(tile) = tiles.get(whole.len()) {
        rest.fill(*tile);
    }
}

/// Least and greatest of each `TILE` columns.
fn of_tiles<const TILE: usize>([low, high]: [&[u8]; 2], [low_out, high_out]: [&mut [u8]; 2]) {
    let least = |part: &[u8]| part.iter().fold(255, |a: u8, &b| a.min(b));
    let greatest = |part: &[u8]| part.iter().fold(0, |a: u8, &b| a.max(b));
    let ((lows, low_rest), (highs, high_rest)) = (low.as_chunks::<TILE>(), high.as_chunks::<TILE>());
    low_out.iter_mut().zip(lows).for_each(|(out, part)| *out = least(part));
    high_out.iter_mut().zip(highs).for_each(|(out, part)| *out = greatest(part));
    if !low_rest.is_empty()
        && let (Some(low), Some(high)) = (low_out.get_mut(lows.len()), high_out.get_mut(highs.len()))
    {
        (*low, *high) = (least(low_rest), greatest(high_rest));
    }
}

/// Extremes of each tile and those beside it in its row; `before` is room for a copy.
fn beside_in_rows(tiles: &mut [u8], before: &mut Vec<u8>, columns: usize, pick: impl Fn(u8, u8) -> u8) {
    before.clear();
    before.extend_from_slice(tiles);
    for (row, from) in tiles.chunks_mut(columns).zip(before.chunks(columns)) {
        for (tile, &other) in row.iter_mut().zip(from.get(1..).unwrap_or(&[])) {
            *tile = pick(*tile, other);
        }
        for (tile, &other) in row.get_mut(1..).unwrap_or(&mut []).iter_mut().zip(from) {
            *tile = pick(*tile, other);
        }
    }
}

kernel!(fn halves(low: [&[u8]; 3], high: [&[u8]; 3], rule: [u8; 3], out: [&mut [u8]; 3]) -> u8 = halves_body);

/// The thresholds of a row of tiles by the extremes of three rows, and these extremes; the rule is that of
/// [`take_in_neighbours`](LocalThreshold::take_in_neighbours). The greatest difference.
#[inline(always)]
fn halves_body(
    [a, b, c]: [&[u8]; 3],
    [d, e, f]: [&[u8]; 3],
    [contrast, otherwise, above]: [u8; 3],
    [tiles, lowest, highest]: [&mut [u8]; 3],
) -> u8 {
    let low = a.iter().zip(b).zip(c);
    let high = d.iter().zip(e).zip(f);
    let out = tiles.iter_mut().zip(lowest).zip(highest);
    let mut greatest = 0;
    for ((((&a, &b), &c), ((&d, &e), &f)), ((tile, lowest), highest)) in low.zip(high).zip(out) {
        let (low, high) = (a.min(b).min(c), d.max(e).max(f));
        let difference = high - low;
        greatest = greatest.max(difference);
        let half = (low + difference / 2).saturating_add(above);
        let is_clear = difference >= contrast;
        *tile = if is_clear { half } else { otherwise };
        // the other way round where they differ too little
        *lowest = if is_clear { low } else { 255 };
        *highest = if is_clear { high } else { 0 };
    }
    greatest
}

kernel!(fn four_rows(rows: [&[u8]; 4], low: &mut [u8], high: &mut [u8]) = four_rows_body);

/// Least and greatest level of each column with four more rows.
#[inline(always)]
fn four_rows_body([a, b, c, d]: [&[u8]; 4], low: &mut [u8], high: &mut [u8]) {
    let rows = a.iter().zip(b).zip(c.iter().zip(d));
    for ((((&a, &b), (&c, &d)), low), high) in rows.zip(low).zip(high) {
        *low = a.min(b).min(c.min(d)).min(*low);
        *high = a.max(b).max(c.max(d)).max(*high);
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_image::TestImage;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn thresholds_lie_between_the_extremes_of_nine_tiles(
            size in (1usize..150, 1usize..100), gap in 0usize..5, kind in 0u8..4, seed in any::<u64>(),
            contrast in any::<u8>(), otherwise in any::<u8>(), share in any::<u8>(),
        ) {
            const TILE: usize = LocalThreshold::TILE;
            let image = TestImage::new(size.0, size.1, gap, kind, seed);
            let view = image.view();
            let (columns, rows) = (view.width().div_ceil(TILE), view.height().div_ceil(TILE));
            let mut extremes = vec![(255u8, 0u8); columns * rows];
            for y in 0..view.height() {
                for (x, &p) in view.row(y).iter().enumerate() {
                    let (low, high) = &mut extremes[y / TILE * columns + x / TILE];
                    (*low, *high) = (p.min(*low), p.max(*high));
                }
            }
            let mut local = LocalThreshold::default();
            let mut greatest = 0;
            let told = local.set(&view, contrast, otherwise);
            let mut moved = local.clone();
            moved.move_to(share);
            for y in 0..view.height() {
                let (half, part) = (local.row(y).to_vec(), moved.row(y).to_vec());
                for x in 0..view.width() {
                    let near = extremes.iter().enumerate().filter(|(i, _)| {
                        (i / columns).abs_diff(y / TILE) < 2 && (i % columns).abs_diff(x / TILE) < 2
                    });
                    let (low, high) = near.fold((255, 0), |a, (_, b)| (b.0.min(a.0), b.1.max(a.1)));
                    greatest = greatest.max(high - low);
                    let step = (u16::from(high - low) * u16::from(share) / 256) as u8;
                    let wanted = if high - low >= contrast { (low.midpoint(high), low + step) } else { (otherwise, otherwise) };
                    prop_assert_eq!((half[x], part[x]), wanted);
                }
            }
            prop_assert_eq!(told, greatest);
            let rows = [0, 1, 2, 3].map(|y| view.row(y % view.height()));
            let extremes = |kernel: fn([&[u8]; 4], &mut [u8], &mut [u8])| {
                let (mut low, mut high) = (vec![contrast; view.width()], vec![share; view.width()]);
                kernel(rows, &mut low, &mut high);
                (low, high)
            };
            prop_assert_eq!(extremes(four_rows), extremes(four_rows_body));
        }

        /// From the definition, pixel by pixel.
        #[test]
        fn fine_thresholds_ask_for_more_than_quiet_tiles_have(
            size in (1usize..90, 1usize..40), gap in 0usize..5, kind in 0u8..4, seed in any::<u64>(), more in 0u8..60, quiet in 2usize..9,
        ) {
            const TILE: usize = LocalThreshold::FINE_TILE;
            let image = TestImage::new(size.0, size.1, gap, kind, seed);
            let view = image.view();
            let (columns, rows) = (view.width().div_ceil(TILE), view.height().div_ceil(TILE));
            let about = |x: usize, y: usize, reach: usize| {
                let (mut low, mut high) = (255u8, 0u8);
                let near = |at: usize, count: usize, size: usize| {
                    at.saturating_sub(reach) * TILE..((at + reach + 1).min(count) * TILE).min(size)
                };
                for v in near(y, rows, view.height()) {
                    for &p in &view.row(v)[near(x, columns, view.width())] {
                        (low, high) = (low.min(p), high.max(p));
                    }
                }
                (low, high - low)
            };
            let mut spreads: Vec<u8> = (0..columns * rows).map(|i| about(i % columns, i / columns, 0).1).collect();
            spreads.sort_unstable();
            let (mut local, mut told) = (LocalThreshold::fine(0, 0), 0);
            let any = local.set_below(&view, quiet, |spread| {
                told = spread;
                spread.saturating_add(more)
            });
            prop_assert_eq!(told, spreads[spreads.len() / quiet]);
            let contrast = told.saturating_add(more).max(1);
            let mut is_anywhere = false;
            for y in 0..view.height() {
                for (x, got) in local.row(y).to_vec().into_iter().enumerate() {
                    let (low, difference) = about(x / TILE, y / TILE, 1);
                    is_anywhere |= difference >= contrast;
                    let wanted = if difference >= contrast { (low + difference / 2).saturating_add(1) } else { 0 };
                    prop_assert_eq!((got, local.at(x as u32, y as u32)), (wanted, wanted));
                }
            }
            prop_assert_eq!(any, is_anywhere);
        }
    }
}
