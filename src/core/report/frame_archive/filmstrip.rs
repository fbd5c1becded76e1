//! The filmstrip of a run: small frames, evenly spread over it however long it lasts.
//!
//! Every frame is kept until there is no more room; then every second one goes, and from then on only every second frame is taken, and so on.

use super::{Keepsake, KeptImage};
use crate::messages::Measurement;

/// Most frames of a strip; even, so that thinning leaves one in two. Chosen by hand: two rows of a page, of which at least a half is always there.
const MAX_FRAMES: usize = 16;
/// Greatest width of its frames, px. Chosen by hand: a quarter of a page on a screen.
const WIDEST_PX: u32 = 320;

/// The frames of a strip.
#[derive(Debug)]
pub(super) struct Filmstrip {
    frames: Vec<KeptImage>,
    /// How many are in use.
    kept: usize,
    /// One of so many frames is taken.
    every: u64,
    /// Each pixel is the mean of a square of so many.
    by: u32,
}

impl Filmstrip {
    /// For frames of this size, px; the frames of the strip are smaller by a whole number.
    pub(super) fn new((width, height): (u32, u32)) -> Self {
        let by = width.div_ceil(WIDEST_PX).max(1);
        let size_px = (width / by, height / by);
        // Written to, so that the memory is there and not only promised.
        let grey = vec![1; size_px.0 as usize * size_px.1 as usize];
        let empty = || KeptImage {
            why: Keepsake::Strip,
            size_px,
            grey: grey.clone(),
            measurement: Measurement::default(),
        };
        Self { frames: (0..MAX_FRAMES).map(|_| empty()).collect(), kept: 0, every: 1, by }
    }

    /// Takes in frame `number` of the run, counted from 0.
    pub(super) fn note(&mut self, number: u64, image: &KeptImage) {
        if !number.is_multiple_of(self.every) {
            return;
        }
        if self.kept == self.frames.len() {
            for i in 0..self.kept / 2 {
                self.frames.swap(i, 2 * i);
            }
            self.kept /= 2;
            self.every *= 2;
            if !number.is_multiple_of(self.every) {
                return;
            }
        }
        let by = self.by;
        let Some(place) = self.frames.get_mut(self.kept) else { return };
        reduce(image, place, by);
        place.measurement = image.measurement;
        self.kept += 1;
    }

    /// The frames in the order of time.
    pub(super) fn images(&self) -> impl Iterator<Item = &KeptImage> {
        self.frames.iter().take(self.kept)
    }
}

/// Means of squares of `by` times `by` pixels.
fn reduce(from: &KeptImage, to: &mut KeptImage, by: u32) {
    let (width, by) = (from.size_px.0 as usize, by as usize);
    let (columns, area) = (to.size_px.0 as usize, (by * by) as u32);
    for (y, row) in to.grey.chunks_exact_mut(columns.max(1)).enumerate() {
        for (x, level) in row.iter_mut().enumerate() {
            let lines = (0..by).filter_map(|j| {
                let begin = (y * by + j) * width + x * by;
                from.grey.get(begin..begin + by)
            });
            let sum: u32 = lines.flatten().map(|level| u32::from(*level)).sum();
            *level = u8::try_from(sum / area).unwrap_or(u8::MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(number: u64, (width, height): (u32, u32)) -> KeptImage {
        KeptImage {
            why: Keepsake::Last,
            size_px: (width, height),
            grey: (0..width * height).map(|i| if i % 2 == 0 { 10 } else { 20 }).collect(),
            measurement: Measurement { frame_id: number, ..Measurement::default() },
        }
    }

    #[test]
    fn frames_are_spread_evenly_over_any_run() {
        for count in [1, 5, 16, 17, 100, 1000, 12_345] {
            let mut strip = Filmstrip::new((8, 4));
            (0..count).for_each(|number| strip.note(number, &image(number, (8, 4))));
            let ids: Vec<u64> = strip.images().map(|image| image.measurement.frame_id).collect();
            let even = (0..).map(|k| k * strip.every).take_while(|id| *id < count);
            assert_eq!(ids, even.collect::<Vec<_>>());
            assert!(ids.len() as u64 >= count.min(MAX_FRAMES as u64 / 2), "{count}: {ids:?}");
        }
    }

    #[test]
    fn large_frames_are_made_small_by_means() {
        let size_px = (1300, 7);
        let mut strip = Filmstrip::new(size_px);
        strip.note(0, &image(0, size_px));
        let kept = strip.images().next().unwrap();
        assert_eq!((kept.size_px, kept.grey.len()), ((260, 1), 260));
        assert!(kept.grey.iter().all(|level| (14..=16).contains(level)), "{:?}", kept.grey);
    }
}
