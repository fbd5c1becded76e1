//! Thresholds by the least and the greatest level about each place.

use super::ImageView;
use super::simd::kernel;

/// Thresholds that follow the local light: one per tile of [`LocalThreshold::TILE`] px.
#[derive(Debug, Clone, Default)]
pub struct LocalThreshold {
    low: Vec<u8>,
    high: Vec<u8>,
    tiles: Vec<u8>,
    /// Least and greatest level about each tile; the other way round where they differ too little.
    extremes: Vec<(u8, u8)>,
    row: Vec<u8>,
    /// Least and greatest level of each column of a band of tiles.
    column_low: Vec<u8>,
    column_high: Vec<u8>,
}

impl LocalThreshold {
    /// Side of a tile, px.
    pub const TILE: usize = 32;

    /// Buffers for images of at most this size, allocated at once.
    #[must_use]
    pub fn with_size(width: usize, height: usize) -> Self {
        let tiles = width.div_ceil(Self::TILE) * height.div_ceil(Self::TILE);
        let (of_tiles, of_columns) = (|| Vec::with_capacity(tiles), || Vec::with_capacity(width));
        Self {
            low: of_tiles(),
            high: of_tiles(),
            tiles: of_tiles(),
            extremes: Vec::with_capacity(tiles),
            row: of_columns(),
            column_low: of_columns(),
            column_high: of_columns(),
        }
    }

    /// Half-way between the least and the greatest level of each tile and its eight neighbours; `otherwise` where
    /// they differ by less than `contrast`. The greatest difference anywhere.
    pub fn set(&mut self, image: &ImageView<'_>, contrast: u8, otherwise: u8) -> u8 {
        let (columns, rows) = (image.width().div_ceil(Self::TILE), image.height().div_ceil(Self::TILE));
        for (buffer, value) in [(&mut self.low, 255), (&mut self.high, 0), (&mut self.tiles, otherwise)] {
            buffer.clear();
            buffer.resize(columns * rows, value);
        }
        self.extremes.clear();
        self.extremes.resize(columns * rows, (255, 0));
        for (buffer, value) in
            [(&mut self.column_low, 255), (&mut self.column_high, 0), (&mut self.row, otherwise)]
        {
            buffer.clear();
            buffer.resize(image.width(), value);
        }
        let bands = self.low.chunks_mut(columns).zip(self.high.chunks_mut(columns));
        for (band, (low, high)) in bands.enumerate() {
            self.column_low.fill(255);
            self.column_high.fill(0);
            let (from, last) = (band * Self::TILE, image.height() - 1);
            for y in (from..=last).take(Self::TILE).step_by(4) {
                // the last row again where there are no more
                let rows = [y, y + 1, y + 2, y + 3].map(|y| image.row(y.min(last)));
                four_rows(rows, &mut self.column_low, &mut self.column_high);
            }
            for (low, part) in low.iter_mut().zip(self.column_low.chunks(Self::TILE)) {
                *low = part.iter().fold(255, |a, &p| a.min(p));
            }
            for (high, part) in high.iter_mut().zip(self.column_high.chunks(Self::TILE)) {
                *high = part.iter().fold(0, |a, &p| a.max(p));
            }
        }
        let mut greatest = 0;
        for ty in 0..rows {
            for tx in 0..columns {
                let (mut low, mut high) = (255u8, 0u8);
                for ny in ty.saturating_sub(1)..(ty + 2).min(rows) {
                    for nx in tx.saturating_sub(1)..(tx + 2).min(columns) {
                        low = self.low.get(ny * columns + nx).map_or(low, |&v| v.min(low));
                        high = self.high.get(ny * columns + nx).map_or(high, |&v| v.max(high));
                    }
                }
                greatest = greatest.max(high.saturating_sub(low));
                if high.saturating_sub(low) >= contrast
                    && let Some(tile) = self.tiles.get_mut(ty * columns + tx)
                    && let Some(extremes) = self.extremes.get_mut(ty * columns + tx)
                {
                    *extremes = (low, high);
                    *tile = ((u16::from(low) + u16::from(high)) / 2) as u8;
                }
            }
        }
        greatest
    }

    /// Moves the thresholds that were [`set`](Self::set) to another `share` of the way from the least level to the greatest, in
    /// 256ths.
    pub fn move_to(&mut self, share: u8) {
        for (tile, &(low, high)) in self.tiles.iter_mut().zip(&self.extremes) {
            if high >= low {
                *tile = (u16::from(low) + ((u16::from(high - low) * u16::from(share)) >> 8)) as u8;
            }
        }
    }

    /// Thresholds of the pixels of row `y`, to be asked for in order.
    pub(super) fn row(&mut self, y: usize) -> &[u8] {
        let columns = self.row.len().div_ceil(Self::TILE);
        if y.is_multiple_of(Self::TILE)
            && let Some(tiles) = self.tiles.get(y / Self::TILE * columns..)
        {
            for (part, &tile) in self.row.chunks_mut(Self::TILE).zip(tiles) {
                part.fill(tile);
            }
        }
        &self.row
    }
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
    }
}
