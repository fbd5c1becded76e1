//! Whether the corners of a fitted convex polygon are there, from which the pieces of its sides keep away.
//!
//! The rim of a small oval, a letter's bowl, fits the sides of a pentagon or a hexagon within the tolerance of a search; what it lacks are the corners. On the way from
//! a corner to the centroid the level is half-way between both sides' where the rim is:
//!
//! ```text
//! corner ──── d (a blurred corner) ──────── h (the oval of the same area and spread) ───────── centroid
//! ```
//! The polygon is one where the middle one of its corners is nearer to `d` than to `h`.

use super::ShapeFinder;
use super::edge::level;
use super::fit::Fitted;
use super::warp::{Projective, Warp};
use crate::imaging::ImageView;
use nalgebra::{Matrix2, Vector2};

/// Corners that are looked at, the first ones. Chosen by hand: an outline of more sides than these is like no letter.
const MOST: usize = 32;
/// Sides shorter than so many deviations of the blur in the image let the next corner into the level. Derived: beyond three deviations lies a thousandth of a step.
const CLEAR_BLURS: f64 = 3.0;
/// Least difference of both distances that tells, px. Chosen by hand: with half of it, levels between pixels decide, with twice of it ovals of 16 px go by.
const LEAST_PX: f64 = 0.3;
/// Fewest corners that tell. Chosen by hand: with three the middle one is none that is covered or lit by chance.
const FEWEST: usize = 3;
/// Steps on the way from a corner to the oval, twice as far at most. Chosen by hand: a twentieth of the difference that is judged.
const STEPS: u32 = 40;

impl ShapeFinder {
    /// Whether nothing tells that the corners of a convex polygon are those of an oval.
    pub(super) fn has_corners(&self, image: &ImageView<'_>, fitted: &Fitted<8, Projective>) -> bool {
        let [inside, outside] = fitted.levels;
        let px = |u: &Vector2<f64>| self.camera.pixel_of(&fitted.warp.at(u));
        let at = |s: f64| self.outline.at(s).0;
        let [xx, xy, yy] = self.outline.spread;
        // the outline's coordinates begin at its centroid
        let (Some(spread), centre) = (Matrix2::new(xx, xy, xy, yy).try_inverse(), px(&Vector2::zeros()))
        else {
            return true;
        };
        let parts = &self.outline.parts;
        let (mut rounds, mut count) = ([0.0; MOST], 0);
        for (before, after) in parts.iter().zip(parts.iter().cycle().skip(1)) {
            let (first, second) = (before.to - before.from, after.to - after.from);
            let u = at(before.to);
            let corner = px(&u);
            // the directions at the corner: of a tenth of each side, as perspective changes them along it
            let (a, b) =
                (px(&at(before.to - 0.1 * first)) - corner, px(&at(after.from + 0.1 * second)) - corner);
            // a concave outline is like no oval; its inside lies from x towards y of its direction
            if !((-a).perp(&b) > 0.0) {
                return true;
            }
            let clear = |end: Vector2<f64>| (end - corner).norm() > CLEAR_BLURS * fitted.blur_px;
            // the oval of the same spread ends at two deviations in each direction
            let beyond = 0.5 * u.dot(&(spread * u)).sqrt();
            if !(beyond > 1.0 && clear(px(&at(before.from))) && clear(px(&at(after.to)))) {
                continue;
            }
            let oval_px = (px(&(u / beyond)) - corner).norm();
            let sharp_px = fitted.blur_px * blurred(a.angle(&b));
            if oval_px - sharp_px < LEAST_PX {
                continue;
            }
            let way = (centre - corner).normalize() * (2.0 * oval_px / f64::from(STEPS));
            let is_inside = |k: &u32| {
                level(image, &(corner + way * f64::from(*k)))
                    .is_some_and(|level| (level - outside) / (inside - outside) >= 0.5)
            };
            let seen_px = way.norm() * f64::from((0..STEPS).find(is_inside).unwrap_or(STEPS));
            if let Some(slot) = rounds.get_mut(count) {
                *slot = (seen_px - sharp_px) / (oval_px - sharp_px);
                count += 1;
            }
        }
        let Some(told) = rounds.get_mut(..count).filter(|told| told.len() >= FEWEST) else { return true };
        let middle = told.len() / 2;
        // what is no number is no reason
        !(*told.select_nth_unstable_by(middle, f64::total_cmp).1 > 0.5)
    }
}

/// How far within a corner of an angle, along its bisector, a blur of deviation 1 leaves half of the step. The corner is where two normal deviates, whose
/// correlation is the cosine between the sides' normals, are below `s`, half of the time for `s` of 0.642, 0.545, 0.459, 0.394, 0.206 at 60, 90, 108, 120 and 150
/// degrees (distribution function of the bivariate normal distribution); the parabola is derived from these and within 0.015 of them.
fn blurred(angle: f64) -> f64 {
    let off = angle - std::f64::consts::FRAC_PI_2;
    (0.545 - 0.2375 * off - 0.095 * off * off).max(0.0) / (0.5 * angle).sin()
}

#[cfg(test)]
mod tests {
    use super::blurred;
    use crate::linalg::Random;

    #[test]
    fn a_blurred_corner_is_where_it_is_told() {
        let mut random = Random::new(6);
        for degrees in [60.0f64, 75.0, 90.0, 108.0, 120.0, 150.0] {
            let angle = degrees.to_radians();
            let d = blurred(angle);
            // the share of the blur about (d, 0) that lies in the corner about the x axis, with its tip at 0
            let share = (0..100_000)
                .filter(|_| {
                    let (x, y) = (d + random.gaussian(), random.gaussian());
                    x > 0.0 && y.abs() < x * (0.5 * angle).tan()
                })
                .count();
            assert!((share as f64 / 1e5 - 0.5).abs() < 0.015, "{degrees}: {share}");
        }
    }
}
