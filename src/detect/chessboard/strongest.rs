//! The maximum of the ring response in a small window.

use crate::imaging::ImageView;
use crate::imaging::corners::{RING, RING_RADIUS_PX};
use nalgebra::Vector2;

/// Least ring response of a corner that follows, in that of the last one. Chosen by hand: see [`follows`].
pub(super) const FOLLOWS: f32 = 0.5;
/// How far from its place it is looked for, px and squares: the lens bends rows. Chosen by hand: places are foretold with the second
/// difference, a twentieth of a square is what lenses add over one more; twice of it is a window in which clutter is met more often.
pub(super) const MIN_REACH_PX: f64 = 1.5;
pub(super) const BENT: f64 = 0.05;
/// Greatest radius of a window, px. Chosen by hand: a bound on time, since a window costs its square; predictions are better than that.
const MAX_PX: f64 = 64.0;

/// The strongest ring response above `least` within `radius` px of a point.
pub(super) fn strongest(
    image: &ImageView<'_>,
    about: Vector2<f64>,
    radius: f64,
    least: f32,
) -> Option<Vector2<f64>> {
    let r = radius.min(MAX_PX).ceil() as i64;
    // no place of any image, else the loop below would count from there
    if !(about.x.abs() < 1e6 && about.y.abs() < 1e6) {
        return None;
    }
    let (mx, my) = (about.x.round() as i64, about.y.round() as i64);
    let mut best = (least, None);
    for y in my - r..=my + r {
        for x in mx - r..=mx + r {
            let at = Vector2::new(x as f64, y as f64);
            if (at - about).norm() > radius {
                continue;
            }
            if let Some(value) = response(image, x, y)
                && value > best.0
            {
                best = (value, Some(at));
            }
        }
    }
    best.1
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
    let place = strongest(image, about, radius, f32::NEG_INFINITY)?;
    response(image, place.x as i64, place.y as i64)
}

/// Ring response of one pixel, in real numbers: see [`crate::imaging::corners::RingResponse`].
fn response(image: &ImageView<'_>, x: i64, y: i64) -> Option<f32> {
    let level = |dx: i8, dy: i8| {
        let (x, y) = (usize::try_from(x + i64::from(dx)).ok()?, usize::try_from(y + i64::from(dy)).ok()?);
        image.row(y).get(x).map(|&p| f32::from(p))
    };
    let mut a = [0.0f32; 8];
    let (mut edge, mut ring) = (0.0, 0.0);
    for (mean, (&[ax, ay], &[bx, by])) in a.iter_mut().zip(RING.iter().zip(RING.iter().skip(8))) {
        let (p, q) = (level(ax, ay)?, level(bx, by)?);
        *mean = 0.5 * (p + q);
        edge += (p - q).abs() / 8.0;
        ring += 0.125 * *mean;
    }
    let [a0, a1, a2, a3, a4, a5, a6, a7] = a;
    let crossing = ((a0 - a4).abs() + (a1 - a5).abs() + (a2 - a6).abs() + (a3 - a7).abs()) / 4.0;
    let middle = 0.25 * (level(-1, 0)? + level(1, 0)? + level(0, -1)? + level(0, 1)?);
    Some(crossing - edge - 2.0 * (ring - middle).abs())
}
