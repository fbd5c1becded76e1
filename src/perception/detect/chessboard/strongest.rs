//! The maximum of the ring response in a small window.

use crate::imaging::ImageView;
use crate::imaging::corners::{RING, RING_RADIUS_PX};
use crate::imaging::simd::kernel;
use crate::linalg::EightWords;
use nalgebra::Vector2;

/// Least ring response of a corner that follows, in that of the last one. Chosen by hand: see [`follows`].
pub(super) const FOLLOWS: f32 = 0.5;
/// How far from its place it is looked for, px and squares: the lens bends rows. Chosen by hand: places are foretold with the second
/// difference, a twentieth of a square is what lenses add over one more; twice of it is a window in which clutter is met more often.
pub(super) const MIN_REACH_PX: f64 = 1.5;
pub(super) const BENT: f64 = 0.05;
/// Greatest radius of a window, px. Chosen by hand: a bound on time, since a window costs its square; predictions are better than that.
const MAX_PX: f64 = 64.0;

/// Pixels of a row of which the response is computed at once: so many, because a register of 128 bits, which every x86-64 and aarch64 has, holds their sums.
const LANES: usize = 8;
/// Rows that a ring touches, and columns of so many pixels' rings, which follow.
const ROWS: usize = 2 * RING_RADIUS_PX + 1;
const SPAN: usize = LANES + 2 * RING_RADIUS_PX;

/// The strongest ring response above `least` within `radius` px of a point.
pub(super) fn strongest(
    image: &ImageView<'_>,
    about: Vector2<f64>,
    radius: f64,
    least: f32,
) -> Option<Vector2<f64>> {
    maximum(image, about, radius, least).map(|(_, px)| px)
}

/// Whether a corner follows at `next`, straight on from the corner at `last`; `None` where the image does not show it. Where none does, a
/// lone square's corner has no response at all, and clutter rarely half of a corner's.
pub(super) fn follows(image: &ImageView<'_>, last: Vector2<f64>, next: Vector2<f64>) -> Option<bool> {
    let radius = MIN_REACH_PX + BENT * (next - last).norm();
    let (own, there) = (strength(image, last, 1.0)?, strength(image, next, radius)?);
    Some(there > FOLLOWS * own)
}

/// The strongest ring response within `radius` px of a point, all of which the image shows.
pub(super) fn strength(image: &ImageView<'_>, about: Vector2<f64>, radius: f64) -> Option<f32> {
    let room = radius + RING_RADIUS_PX as f64 + 1.0;
    let inside = |at: f64, size: usize| at > room && at + room < size as f64;
    if !(inside(about.x, image.width()) && inside(about.y, image.height())) {
        return None;
    }
    maximum(image, about, radius, f32::NEG_INFINITY).map(|(response, _)| response)
}

kernel!(
    /// The first of the strongest ring responses above `least` within `radius` px of a point, row by row, and its pixel.
    fn maximum(image: &ImageView<'_>, about: Vector2<f64>, radius: f64, least: f32) -> Option<(f32, Vector2<f64>)> = maximum_body
);

#[inline(always)]
fn maximum_body(
    image: &ImageView<'_>,
    about: Vector2<f64>,
    radius: f64,
    least: f32,
) -> Option<(f32, Vector2<f64>)> {
    // no place of any image, else the loop below would count from there
    if !(about.x.abs() < 1e6 && about.y.abs() < 1e6) {
        return None;
    }
    let radius = radius.min(MAX_PX);
    // the ring of a pixel must lie in the image
    let rim = RING_RADIUS_PX as i64;
    let (last_x, last_y) = (image.width() as i64 - 1 - rim, image.height() as i64 - 1 - rim);
    // a response is more than `least` if its whole eighths are more than those below `8 least`
    let (mut best, mut place) = ((8.0 * least).floor() as i16, None);
    for y in range(about.y, radius, rim, last_y) {
        let half = (radius * radius - (y as f64 - about.y).powi(2)).max(0.0).sqrt();
        let columns = range(about.x, half, rim, last_x);
        let (mut x, end) = (*columns.start(), *columns.end());
        while x <= end {
            // the last ones of a row begin so that they end with it
            let from = x.min(last_x + 1 - LANES as i64).max(rim);
            let (left, top) = (from as usize - RING_RADIUS_PX, y as usize - RING_RADIUS_PX);
            let eighths = match around(image, left, top) {
                Some(pixels) => eighths(&pixels),
                None => eighths(&padded(image, left, top).each_ref()),
            };
            x = from + LANES as i64;
            if !eighths.any_above(best) {
                continue;
            }
            for (x, eighths) in (from..).zip(eighths.to_array()) {
                if eighths > best && columns.contains(&x) {
                    (best, place) = (eighths, Some(Vector2::new(x as f64, y as f64)));
                }
            }
        }
    }
    place.map(|px| (f32::from(best) / 8.0, px))
}

/// Whether the image has enough contrast for a ring response of `least`, which is at most half of the difference of a corner's squares.
pub(super) fn has_contrast(image: &ImageView<'_>, least: u8) -> bool {
    let levels = || (0..image.height()).flat_map(|y| image.row(y).iter().copied());
    let (darkest, brightest) = (levels().min().unwrap_or(0), levels().max().unwrap_or(0));
    brightest - darkest >= 2 * least
}

/// Whole numbers about a middle, but none outside of `first..=last`.
#[inline(always)]
fn range(middle: f64, half: f64, first: i64, last: i64) -> std::ops::RangeInclusive<i64> {
    ((middle - half).ceil() as i64).max(first)..=((middle + half).floor() as i64).min(last)
}

/// The pixels from column `x` and row `y` on that eight rings touch; `None` where the image is too narrow for eight.
#[inline(always)]
fn around<'a>(image: &ImageView<'a>, x: usize, y: usize) -> Option<[&'a [u8; SPAN]; ROWS]> {
    let mut rows = [&[0; SPAN]; ROWS];
    for (row, y) in rows.iter_mut().zip(y..) {
        *row = image.row(y).get(x..)?.first_chunk()?;
    }
    Some(rows)
}

/// The same with 0 beyond the image.
#[cold]
fn padded(image: &ImageView<'_>, x: usize, y: usize) -> [[u8; SPAN]; ROWS] {
    let mut rows = [[0; SPAN]; ROWS];
    for (row, y) in rows.iter_mut().zip(y..) {
        let levels = image.row(y).get(x..).unwrap_or(&[]);
        row.iter_mut().zip(levels).for_each(|(pixel, level)| *pixel = *level);
    }
    rows
}

/// Levels of eight pixels, so far from those whose rings are [`around`].
#[inline(always)]
#[allow(clippy::indexing_slicing)] // the ring's radius and less, each way
fn levels(pixels: &[&[u8; SPAN]; ROWS], [dx, dy]: [i8; 2]) -> EightWords {
    let middle = RING_RADIUS_PX as i8;
    let row = &pixels[(middle + dy) as usize][(middle + dx) as usize..];
    EightWords::from_bytes(row.first_chunk().copied().unwrap_or_default())
}

/// Ring response of eight pixels, in eighths of grey levels, which are whole numbers: see [`crate::imaging::corners::RingResponse`].
#[inline(always)]
#[allow(clippy::indexing_slicing)] // eight opposite pairs of sixteen
fn eighths(pixels: &[&[u8; SPAN]; ROWS]) -> EightWords {
    // sums of opposite pixels, of their differences, and of the whole ring
    let mut a = [EightWords::ZERO; 8];
    let (mut edge, mut ring) = (EightWords::ZERO, EightWords::ZERO);
    for k in 0..8 {
        let (p, q) = (levels(pixels, RING[k]), levels(pixels, RING[k + 8]));
        a[k] = p.plus(q);
        edge = edge.plus(p.minus(q).abs());
        ring = ring.plus(a[k]);
    }
    let mut crossing = EightWords::ZERO;
    for k in 0..4 {
        crossing = crossing.plus(a[k].minus(a[k + 4]).abs());
    }
    let mut middle = EightWords::ZERO;
    for side in [[-1, 0], [1, 0], [0, -1], [0, 1]] {
        middle = middle.plus(levels(pixels, side));
    }
    // the means are a sixteenth and a quarter of these
    let twice = middle.plus(middle);
    crossing.minus(edge).minus(ring.minus(twice.plus(twice)).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// As the text of `RingResponse` has it, in real numbers.
    fn response(image: &ImageView<'_>, x: i64, y: i64) -> Option<f64> {
        let at = |[dx, dy]: [i8; 2]| {
            let (x, y) = (usize::try_from(x + i64::from(dx)).ok()?, usize::try_from(y + i64::from(dy)).ok()?);
            (y < image.height()).then(|| image.row(y).get(x).map(|&p| f64::from(p))).flatten()
        };
        let ring: Option<Vec<f64>> = RING.iter().map(|&d| at(d)).collect();
        let (ring, mut crossing, mut edge) = (ring?, 0.0, 0.0);
        (0..4).for_each(|k| crossing += (ring[k] + ring[k + 8] - ring[k + 4] - ring[k + 12]).abs() / 8.0);
        (0..8).for_each(|k| edge += (ring[k] - ring[k + 8]).abs() / 8.0);
        let middle = (at([-1, 0])? + at([1, 0])? + at([0, -1])? + at([0, 1])?) / 4.0;
        Some(crossing - edge - 2.0 * (ring.iter().sum::<f64>() / 16.0 - middle).abs())
    }

    proptest! {
        #[test]
        fn the_strongest_response_in_a_disc_is_found(
            size in (1usize..40, 1usize..24), seed in any::<u64>(), bits in 0u32..8,
            about in (-4.0f64..44.0, -4.0f64..28.0), radius in 0.0f64..9.0, least in -800.0f32..20.0,
        ) {
            let (width, height) = size;
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8 >> bits << bits
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let about = Vector2::new(about.0, about.1);
            let mut best = (f64::from(least), None);
            for y in 0..height as i64 {
                for x in 0..width as i64 {
                    let at = Vector2::new(x as f64, y as f64);
                    if let Some(value) = response(&image, x, y)
                        && value > best.0
                        && (at - about).norm() <= radius
                    {
                        best = (value, Some(at));
                    }
                }
            }
            let found = maximum(&image, about, radius, least);
            prop_assert_eq!(found.map(|(value, px)| (f64::from(value), px)), best.1.map(|px| (best.0, px)));
        }
    }
}
