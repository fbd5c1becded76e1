//! Faults of frames: when they are handed over, and what they show.

use super::{FaultWindow, MAX_FAULTS};
use crate::time::{MonoNs, SpanNs};

/// Side of the blocks of a corrupt image, px. Chosen by hand, and that of a block of most coded video.
const BLOCK_PX: usize = 16;

/// What is wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FrameFault {
    /// It is lost.
    Drop,
    /// It is handed over later; the frames after it do not overtake it.
    Delay(SpanNs),
    /// It is the frame before once more, image and stamp, under a number of its own.
    Duplicate,
    /// It shows what the frame before showed, with a stamp of its own.
    Freeze,
    /// It is black.
    Black,
    /// It is white.
    Saturated,
    /// Its lower half is that of the frame before.
    Torn,
    /// Left and right are exchanged.
    Mirror,
    /// Its stamp is off by so much: the camera's clock has leapt.
    ClockJump(SpanNs),
    /// It shows everything a second time, so many px to the right, where that is darker: another target beside the one.
    FalseTarget(usize),
    /// Blocks of 16 px of it, as large a share of them, each have one level at random.
    Corrupt(f64),
}

impl FrameFault {
    /// Whether it needs the image of the frame before.
    fn needs_the_frame_before(self) -> bool {
        matches!(self, Self::Duplicate | Self::Freeze | Self::Torn)
    }
}

/// The faults of one camera's frames.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrameFaults {
    list: [Option<(FrameFault, FaultWindow)>; MAX_FAULTS],
}

impl FrameFaults {
    /// Those of `list`, drawn by `seed`; what is beyond [`MAX_FAULTS`] is left out.
    #[must_use]
    pub fn new(list: &[(FrameFault, FaultWindow)], seed: u64) -> Self {
        let mut faults = Self::default();
        for ((i, place), (fault, window)) in (0..).zip(&mut faults.list).zip(list) {
            *place = Some((*fault, window.seeded(seed, i)));
        }
        faults
    }

    /// What acts on frame `id`, exposed at `time`.
    fn acting(&self, time: SpanNs, id: u64) -> impl Iterator<Item = &(FrameFault, FaultWindow)> {
        self.list.iter().flatten().filter(move |(_, window)| window.acts(time, id))
    }

    /// Whether frame `id`, exposed at `time`, is lost.
    #[must_use]
    pub fn drops(&self, time: SpanNs, id: u64) -> bool {
        self.acting(time, id).any(|(fault, _)| *fault == FrameFault::Drop)
    }

    /// By how much frame `id`, exposed at `time`, is later than it would be.
    #[must_use]
    pub fn delay(&self, time: SpanNs, id: u64) -> SpanNs {
        SpanNs(self.acting(time, id).map(|(fault, _)| delay_ns(*fault)).sum())
    }

    /// By how much a frame is later at most.
    #[must_use]
    pub fn longest_delay(&self) -> SpanNs {
        SpanNs(self.list.iter().flatten().map(|(fault, _)| delay_ns(*fault)).sum())
    }
}

fn delay_ns(fault: FrameFault) -> i64 {
    if let FrameFault::Delay(span) = fault { span.0 } else { 0 }
}

/// Puts the faults of images into them, one frame after the other.
#[derive(Debug, Clone, Default)]
pub struct ImageDamage {
    faults: FrameFaults,
    /// The last image that was no repetition, as the camera took it, and the middle of its exposure; empty where no fault needs it.
    before: Vec<u8>,
    taken: MonoNs,
}

impl ImageDamage {
    /// The damage of `faults`.
    #[must_use]
    pub fn new(faults: FrameFaults) -> Self {
        Self { faults, ..Self::default() }
    }

    /// Damages the image `pixels` of frame `id`, `width` columns, which was exposed at `mid`, `time` after frame 0. Gives the middle of the exposure that
    /// the frame is stamped with.
    pub fn apply(
        &mut self,
        (id, time): (u64, SpanNs),
        mid: MonoNs,
        width: usize,
        pixels: &mut [u8],
    ) -> MonoNs {
        let faults = self.faults;
        let mut all = faults.list.iter().flatten();
        if all.clone().next().is_none() {
            return mid;
        }
        let acts = |wanted: FrameFault| faults.acting(time, id).any(|(fault, _)| *fault == wanted);
        let (duplicate, freeze) = (acts(FrameFault::Duplicate), acts(FrameFault::Freeze));
        let mut stamp = mid;
        if self.before.len() == pixels.len() && (duplicate || freeze) {
            pixels.copy_from_slice(&self.before);
            stamp = if duplicate { self.taken } else { mid };
        } else if all.any(|(fault, _)| fault.needs_the_frame_before()) {
            let middle = width * (pixels.len() / width.max(1) / 2);
            if self.before.len() == pixels.len() && acts(FrameFault::Torn) {
                pixels[middle..].swap_with_slice(&mut self.before[middle..]);
                self.before[..middle].copy_from_slice(&pixels[..middle]);
            } else {
                self.before.clear();
                self.before.extend_from_slice(pixels);
            }
            self.taken = mid;
        }
        for (fault, window) in faults.acting(time, id) {
            match fault {
                FrameFault::Black => pixels.fill(0),
                FrameFault::Saturated => pixels.fill(u8::MAX),
                FrameFault::Mirror => pixels.chunks_mut(width.max(1)).for_each(<[u8]>::reverse),
                FrameFault::ClockJump(span) => stamp = stamp + *span,
                FrameFault::FalseTarget(px) => {
                    pixels.chunks_mut(width.max(1)).for_each(|row| double(*px, row))
                }
                FrameFault::Corrupt(share) => corrupt(*share, (window, id), width, pixels),
                _ => {}
            }
        }
        stamp
    }
}

/// Shows a row a second time, `px` to the right, where that is darker.
fn double(px: usize, row: &mut [u8]) {
    for u in (px..row.len()).rev() {
        row[u] = row[u].min(row[u - px]);
    }
}

/// Gives a share of the blocks one level each.
fn corrupt(share: f64, (window, id): (&FaultWindow, u64), width: usize, pixels: &mut [u8]) {
    let mut random = window.random(id);
    random.bits(); // which has said whether it acts
    for rows in pixels.chunks_mut((BLOCK_PX * width).max(1)) {
        for left in (0..width).step_by(BLOCK_PX) {
            let (is_hit, level) = (random.uniform() < share, random.bits() as u8);
            if is_hit {
                rows.chunks_mut(width).for_each(|row| row[left..(left + BLOCK_PX).min(width)].fill(level));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 64;
    const PERIOD: SpanNs = SpanNs(40_000_000);

    fn window(from: u64, until: u64) -> FaultWindow {
        let at = |id: u64| SpanNs(PERIOD.0 * id as i64);
        FaultWindow { from: at(from), until: at(until), probability: 1.0, seed: 0 }
    }

    /// Eight frames of 64 by 32, each of its own level, with a fault of frames 3 and 4: images and stamps in frames.
    fn frames(fault: FrameFault, probability: f64, seed: u64) -> Vec<(Vec<u8>, i64)> {
        let window = FaultWindow { probability, ..window(3, 5) };
        let mut damage = ImageDamage::new(FrameFaults::new(&[(fault, window)], seed));
        let frame = |id: u64| {
            let (time, mut pixels) = (SpanNs(PERIOD.0 * id as i64), vec![10 * id as u8; WIDTH * 32]);
            let stamp = damage.apply((id, time), MonoNs(time.0), WIDTH, &mut pixels);
            (pixels, stamp.0 / PERIOD.0)
        };
        (0..8).map(frame).collect()
    }

    fn corners(fault: FrameFault) -> Vec<(u8, u8, i64)> {
        let frames = frames(fault, 1.0, 1);
        frames.iter().map(|(pixels, stamp)| (pixels[0], pixels[WIDTH * 32 - 1], *stamp)).collect()
    }

    #[test]
    fn each_fault_shows_what_it_says_in_its_time_alone() {
        let whole = |id: usize| (10 * id as u8, 10 * id as u8, id as i64);
        let wanted = |third, fourth| {
            let mut all: Vec<_> = (0..8).map(whole).collect();
            (all[3], all[4]) = (third, fourth);
            all
        };
        assert_eq!(corners(FrameFault::Duplicate), wanted((20, 20, 2), (20, 20, 2)));
        assert_eq!(corners(FrameFault::Freeze), wanted((20, 20, 3), (20, 20, 4)));
        assert_eq!(corners(FrameFault::Torn), wanted((30, 20, 3), (40, 30, 4)));
        assert_eq!(corners(FrameFault::Black), wanted((0, 0, 3), (0, 0, 4)));
        assert_eq!(corners(FrameFault::Saturated), wanted((255, 255, 3), (255, 255, 4)));
        let mut damage = ImageDamage::new(FrameFaults::new(&[(FrameFault::Mirror, window(0, 1))], 0));
        let mut pixels = vec![1, 2, 3, 4, 5, 6];
        damage.apply((0, SpanNs::ZERO), MonoNs::ZERO, 3, &mut pixels);
        assert_eq!(pixels, [3, 2, 1, 6, 5, 4]);
        let mut damage = ImageDamage::new(FrameFaults::new(&[(FrameFault::FalseTarget(2), window(0, 1))], 0));
        let mut pixels = vec![9, 1, 8, 7, 6, 5];
        damage.apply((0, SpanNs::ZERO), MonoNs::ZERO, 6, &mut pixels);
        assert_eq!(pixels, [9, 1, 8, 1, 6, 5]);
        let late = |id: usize| (10 * id as u8, 10 * id as u8, id as i64 + 1);
        assert_eq!(corners(FrameFault::ClockJump(PERIOD)), wanted(late(3), late(4)));
        for timing in [FrameFault::Drop, FrameFault::Delay(PERIOD)] {
            assert_eq!(corners(timing), (0..8).map(whole).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_corrupt_image_has_its_share_of_blocks_by_the_seed() {
        let changed = |seed| {
            let frames = frames(FrameFault::Corrupt(0.25), 1.0, seed);
            (0..8).map(|id| frames[id].0.iter().filter(|level| **level != 10 * id as u8).count()).collect()
        };
        let counts: Vec<usize> = changed(1);
        assert_eq!(counts, changed(1));
        assert_ne!(counts, changed(2));
        // Of 8 blocks of 256 pixels a quarter, 2 of 8.
        assert!(
            counts[3] + counts[4] > 0 && counts[3] <= 6 * 256 && counts[3].is_multiple_of(256),
            "{counts:?}"
        );
        assert_eq!(counts.iter().sum::<usize>(), counts[3] + counts[4]);
    }

    #[test]
    fn without_faults_an_image_is_not_even_kept() {
        let mut damage = ImageDamage::default();
        let mut pixels = vec![7; WIDTH * 32];
        assert_eq!(damage.apply((0, SpanNs(0)), MonoNs(5), WIDTH, &mut pixels), MonoNs(5));
        assert!(pixels.iter().all(|level| *level == 7) && damage.before.is_empty());
    }

    #[test]
    fn drops_and_delays_are_of_their_frames_alone() {
        let faults = [(FrameFault::Drop, window(2, 3)), (FrameFault::Delay(PERIOD), window(5, 7))];
        let faults = FrameFaults::new(&faults, 3);
        let time = |id: u64| SpanNs(PERIOD.0 * id as i64);
        let of = |id| (faults.drops(time(id), id), faults.delay(time(id), id).0 / PERIOD.0);
        assert_eq!((0..8).filter(|id| of(*id).0).collect::<Vec<_>>(), [2]);
        assert_eq!((0..8).filter(|id| of(*id).1 == 1).collect::<Vec<_>>(), [5, 6]);
        assert_eq!(faults.longest_delay(), PERIOD);
    }
}
