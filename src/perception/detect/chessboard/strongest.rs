//! The maximum of the ring response in a small window.

use crate::imaging::ImageView;
use crate::imaging::corners::{RING, RING_RADIUS_PX};
use nalgebra::Vector2;
use std::array::from_fn;

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

/// The first of the strongest ring responses above `least` within `radius` px of a point, row by row, and its pixel.
fn maximum(
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
    let last = |size: usize| size as i64 - 1 - rim;
    let last_x = last(image.width());
    let range = |middle: f64, half: f64, last: i64| {
        ((middle - half).ceil() as i64).max(rim)..=((middle + half).floor() as i64).min(last)
    };
    // a response is more than `least` if its whole eighths are more than those below `8 least`
    let mut best = ((8.0 * least).floor() as i16, None);
    for y in range(about.y, radius, last(image.height())) {
        let half = (radius.powi(2) - (y as f64 - about.y).powi(2)).max(0.0).sqrt();
        let columns = range(about.x, half, last_x);
        let mut rows = [&[][..]; 2 * RING_RADIUS_PX + 1];
        rows.iter_mut().zip(y as usize - RING_RADIUS_PX..).for_each(|(row, y)| *row = image.row(y));
        let mut take = |x: i64, eighths: &[i16]| {
            if eighths.iter().all(|eighths| *eighths <= best.0) {
                return;
            }
            for (x, eighths) in (x..).zip(eighths) {
                if *eighths > best.0 && columns.contains(&x) {
                    best = (*eighths, Some(Vector2::new(x as f64, y as f64)));
                }
            }
        };
        if last_x + 1 - rim < LANES as i64 {
            columns.clone().for_each(|x| take(x, &eighths::<1>(&rows, x as usize).unwrap_or([i16::MIN])));
            continue;
        }
        for x in columns.clone().step_by(LANES) {
            // the last ones of a row begin so that they end with it
            let x = x.min(last_x + 1 - LANES as i64);
            take(x, &eighths::<LANES>(&rows, x as usize)?);
        }
    }
    best.1.map(|px| (f32::from(best.0) / 8.0, px))
}

/// Of each number and its counterpart.
#[inline(always)]
#[allow(clippy::indexing_slicing)] // 0..COUNT of so many
fn both<const COUNT: usize>(
    a: &[i16; COUNT],
    b: &[i16; COUNT],
    of: impl Fn(i16, i16) -> i16,
) -> [i16; COUNT] {
    from_fn(|i| of(a[i], b[i]))
}

/// Ring response of the pixels from `x` on in the middle one of the rows, in eighths of grey levels, which are whole numbers: see
/// [`crate::imaging::corners::RingResponse`]. `None` where not all of their rings lie in the rows. Written so that compilers make vectors of it.
#[inline(always)]
#[allow(clippy::indexing_slicing)] // as above, and eight opposite pairs of sixteen
fn eighths<const COUNT: usize>(rows: &[&[u8]; 2 * RING_RADIUS_PX + 1], x: usize) -> Option<[i16; COUNT]> {
    let levels = |[dx, dy]: [i8; 2]| -> Option<[i16; COUNT]> {
        let row = rows.get(RING_RADIUS_PX.checked_add_signed(isize::from(dy))?)?;
        let levels = row.get(x.checked_add_signed(isize::from(dx))?..)?.first_chunk::<COUNT>()?;
        Some(from_fn(|i| i16::from(levels[i])))
    };
    let (plus, apart) = (|a: i16, b: i16| a + b, |a: i16, b: i16| (a - b).abs());
    let zero = [0; COUNT];
    // sums of opposite pixels, of their differences, and of the whole ring
    let mut a = [zero; 8];
    let (mut edge, mut ring) = (zero, zero);
    for k in 0..8 {
        let (p, q) = (levels(RING[k])?, levels(RING[k + 8])?);
        a[k] = both(&p, &q, plus);
        edge = both(&edge, &both(&p, &q, apart), plus);
        ring = both(&ring, &a[k], plus);
    }
    let mut crossing = zero;
    for k in 0..4 {
        crossing = both(&crossing, &both(&a[k], &a[k + 4], apart), plus);
    }
    let mut middle = zero;
    for side in [[-1, 0], [1, 0], [0, -1], [0, 1]] {
        middle = both(&middle, &levels(side)?, plus);
    }
    // the means are a sixteenth and a quarter of these
    let stripe = both(&ring, &middle, |ring, middle| (ring - 4 * middle).abs());
    Some(both(&both(&crossing, &edge, |a, b| a - b), &stripe, |a, b| a - b))
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
