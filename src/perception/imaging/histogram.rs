//! Grey-level histogram and the threshold that splits it best into a dark and a light class (Otsu).

use super::ImageView;

/// Number of pixels of each grey level.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Histogram {
    bins: [u32; 256],
}

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: [0; 256] }
    }
}

/// A split of a histogram into dark (`<= threshold`) and light pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Otsu {
    /// Greatest level of the dark class.
    pub threshold: u8,
    /// Mean level of the dark class.
    pub dark_mean: f64,
    /// Mean level of the light class.
    pub light_mean: f64,
    /// Variance between the classes over the whole variance, 0..=1. Pure Gaussian noise gives 0.64.
    pub separability: f64,
}

impl Histogram {
    /// Counts all pixels.
    #[must_use]
    pub fn of(image: &ImageView<'_>) -> Self {
        let mut counts = Counts::new();
        image.pieces().for_each(|piece| counts.add(piece));
        counts.sum()
    }

    /// Counts the pixels of every `step`-th row (0 counts as 1): a fair sample of the image in a fraction of the time.
    #[must_use]
    pub fn of_rows(image: &ImageView<'_>, step: usize) -> Self {
        let step = step.max(1);
        let mut counts = Counts::new();
        for y in (step / 2..image.height()).step_by(step) {
            counts.add(image.row(y));
        }
        counts.sum()
    }

    /// Pixels of each level.
    #[must_use]
    pub fn bins(&self) -> &[u32; 256] {
        &self.bins
    }

    /// Otsu's threshold: the one with the greatest variance between the classes; the middle one of those that part the pixels alike, and of
    /// other equals the darkest.
    /// `None` when all pixels have one level, or there are none.
    #[must_use]
    pub fn otsu(&self) -> Option<Otsu> {
        let (mut total, mut sum, mut sum2) = (0u64, 0u64, 0u64);
        for (level, &count) in (0u64..).zip(&self.bins) {
            total += u64::from(count);
            sum += u64::from(count) * level;
            sum2 += u64::from(count) * level * level;
        }
        let (n, mean) = (total as f64, sum as f64 / total.max(1) as f64);
        let variance = sum2 as f64 / total.max(1) as f64 - mean * mean;
        let (mut dark, mut dark_sum) = (0u64, 0u64);
        let mut best: Option<(f64, usize, usize)> = None;
        for (level, &count) in self.bins.iter().enumerate() {
            dark += u64::from(count);
            dark_sum += u64::from(count) * level as u64;
            if dark == 0 {
                continue;
            }
            if dark == total {
                break;
            }
            // (N m_dark - n_dark m)^2 / (n_dark n_light): variance between the classes, times N
            let d = n * dark_sum as f64 - dark as f64 * sum as f64;
            let between = d * d / (dark as f64 * (total - dark) as f64);
            match &mut best {
                Some((value, _, last)) if between == *value && level == *last + 1 => *last = level,
                Some((value, ..)) if between <= *value => {}
                _ => best = Some((between, level, level)),
            }
        }
        let (between, first, last) = best?;
        let threshold = (first + last) / 2;
        let (mut dark, mut dark_sum) = (0u64, 0u64);
        for (level, &count) in self.bins.iter().enumerate().take(threshold + 1) {
            dark += u64::from(count);
            dark_sum += u64::from(count) * level as u64;
        }
        Some(Otsu {
            threshold: threshold as u8,
            dark_mean: dark_sum as f64 / dark as f64,
            light_mean: (sum - dark_sum) as f64 / (total - dark) as f64,
            // an image of one level has no variance, and would divide by it
            separability: (between / (n * n) / variance.max(1e-12)).min(1.0),
        })
    }
}

/// Counts pixels by neighbouring pairs: half the increments, in a table of 256 KiB that is kept between images. Faster
/// than [`Histogram::of`] where one histogram follows another and levels are not spread at random.
#[derive(Debug, Clone)]
pub struct PairCounter {
    pairs: Vec<u32>,
}

impl Default for PairCounter {
    fn default() -> Self {
        Self { pairs: vec![0; 1 << 16] }
    }
}

impl PairCounter {
    /// Counts all pixels.
    #[must_use]
    pub fn count(&mut self, image: &ImageView<'_>) -> Histogram {
        let mut bins = [0u32; 256];
        let Some(pairs) = self.pairs.first_chunk_mut::<{ 1 << 16 }>() else { return Histogram { bins } };
        for piece in image.pieces() {
            let (words, rest) = piece.as_chunks::<8>();
            for word in words {
                let word = u64::from_le_bytes(*word);
                pairs[usize::from(word as u16)] += 1;
                pairs[usize::from((word >> 16) as u16)] += 1;
                pairs[usize::from((word >> 32) as u16)] += 1;
                pairs[usize::from((word >> 48) as u16)] += 1;
            }
            for &p in rest {
                bins[usize::from(p)] += 1;
            }
        }
        // sums of rows and of columns; the table is left empty for the next image
        for (second, row) in pairs.as_chunks_mut::<256>().0.iter_mut().enumerate() {
            let mut sum = 0;
            for (bins, row) in bins.as_chunks_mut::<32>().0.iter_mut().zip(row.as_chunks_mut::<32>().0) {
                // most pairs of levels never meet: what is empty is read, not written
                if row.iter().fold(0, |any, &pair| any | pair) == 0 {
                    continue;
                }
                for (bin, pair) in bins.iter_mut().zip(row) {
                    sum += *pair;
                    *bin += *pair;
                    *pair = 0;
                }
            }
            bins[second] += sum;
        }
        Histogram { bins }
    }
}

/// Eight tables side by side: equal neighbours do not wait for each other's increment.
struct Counts {
    tables: [[u32; 256]; 8],
}

impl Counts {
    fn new() -> Self {
        Self { tables: [[0; 256]; 8] }
    }

    fn add(&mut self, pixels: &[u8]) {
        let (words, rest) = pixels.as_chunks::<8>();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = &mut self.tables;
        for word in words {
            let word = u64::from_le_bytes(*word);
            t0[usize::from(word as u8)] += 1;
            t1[usize::from((word >> 8) as u8)] += 1;
            t2[usize::from((word >> 16) as u8)] += 1;
            t3[usize::from((word >> 24) as u8)] += 1;
            t4[usize::from((word >> 32) as u8)] += 1;
            t5[usize::from((word >> 40) as u8)] += 1;
            t6[usize::from((word >> 48) as u8)] += 1;
            t7[usize::from((word >> 56) as u8)] += 1;
        }
        for &p in rest {
            t0[usize::from(p)] += 1;
        }
    }

    fn sum(&self) -> Histogram {
        let mut bins = [0; 256];
        for table in &self.tables {
            for (bin, count) in bins.iter_mut().zip(table) {
                *bin += count;
            }
        }
        Histogram { bins }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_levels_are_split_half_way() {
        let mut pixels = vec![40u8; 60];
        pixels.extend([200; 40]);
        let otsu = Histogram::of(&ImageView::new(&pixels, 10, 10).unwrap()).otsu().unwrap();
        assert!((119..=120).contains(&otsu.threshold), "{otsu:?}");
        assert_eq!((otsu.dark_mean, otsu.light_mean), (40.0, 200.0));
        assert!((otsu.separability - 1.0).abs() < 1e-12);
    }

    /// Two splits that are as good as each other, and one between them that is worse: the middle is no split of theirs.
    #[test]
    fn of_two_best_splits_one_is_taken() {
        let otsu = Histogram::of(&ImageView::new(&[0, 90, 110, 200], 4, 1).unwrap()).otsu().unwrap();
        assert_eq!((otsu.dark_mean, otsu.light_mean), (0.0, 400.0 / 3.0), "{otsu:?}");
    }

    #[test]
    fn one_level_has_no_split() {
        assert_eq!(Histogram::of(&ImageView::new(&[255; 100], 10, 10).unwrap()).otsu(), None);
        assert_eq!(Histogram::default().otsu(), None);
    }

    proptest! {
        #[test]
        fn histogram_counts_every_pixel(pixels in prop::collection::vec(any::<u8>(), 1..300)) {
            let n = pixels.len();
            let h = Histogram::of(&ImageView::new(&pixels, n, 1).unwrap());
            let mut counter = PairCounter::default();
            for _ in 0..2 {
                prop_assert_eq!(&counter.count(&ImageView::new(&pixels, n, 1).unwrap()), &h);
            }
            for level in 0..=255u8 {
                let count = pixels.iter().filter(|&&p| p == level).count();
                prop_assert_eq!(h.bins()[usize::from(level)] as usize, count);
            }
        }

        /// The definition: no other threshold has a greater variance between the classes.
        #[test]
        fn otsu_is_the_best_split(pixels in prop::collection::vec(any::<u8>(), 2..200)) {
            let n = pixels.len();
            let between = |t: u8| {
                let dark: Vec<_> = pixels.iter().filter(|&&p| p <= t).map(|&p| f64::from(p)).collect();
                let light: Vec<_> = pixels.iter().filter(|&&p| p > t).map(|&p| f64::from(p)).collect();
                if dark.is_empty() || light.is_empty() {
                    return 0.0;
                }
                let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
                dark.len() as f64 * light.len() as f64 * (mean(&dark) - mean(&light)).powi(2)
            };
            let best = (0..=255).map(between).fold(0.0, f64::max);
            if let Some(otsu) = Histogram::of(&ImageView::new(&pixels, n, 1).unwrap()).otsu() {
                prop_assert!(between(otsu.threshold) >= best * (1.0 - 1e-9));
            } else {
                prop_assert_eq!(best, 0.0);
            }
        }
    }
}
