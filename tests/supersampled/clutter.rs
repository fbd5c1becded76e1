//! What lies about a target: discs, or a mottled ground, seen in the image's own pixels.

use super::Dice;
use nalgebra::Vector2;

/// Dark shapes on what is not the plate. Lengths in px.
#[derive(Debug, Clone, Default)]
pub struct Clutter {
    /// Level of what is dark.
    pub level: f64,
    discs: Vec<(Vector2<f64>, f64)>,
    /// Values of a smooth random field on a grid of `grain` px, and the value above which it is dark.
    field: Vec<f64>,
    grain: f64,
    above: f64,
}

/// Side of the field's table, which goes on from its start.
const SIDE: usize = 256;

impl Clutter {
    /// So many discs of random radii at random places of an image.
    pub fn discs(
        dice: &mut Dice,
        count: usize,
        (low, high): (f64, f64),
        [width, height]: [usize; 2],
    ) -> Self {
        let disc = |dice: &mut Dice| {
            let at = Vector2::new(dice.within(0.0, width as f64), dice.within(0.0, height as f64));
            (at, dice.within(low, high))
        };
        Self { discs: (0..count).map(|_| disc(dice)).collect(), ..Self::default() }
    }

    /// Discs of two radii, drawn for each, in rows and columns a `pitch` apart that stand askew over all of an image.
    pub fn lattice(dice: &mut Dice, pitch: f64, radii: [f64; 2], [width, height]: [usize; 2]) -> Self {
        let (sin, cos) = dice.within(-3.2, 3.2).sin_cos();
        let middle = Vector2::new(width as f64, height as f64) * 0.5;
        let reach = (middle.norm() / pitch).ceil() as i32;
        let mut discs = Vec::new();
        for (i, j) in
            (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (f64::from(i), f64::from(j))))
        {
            let at = middle + Vector2::new(cos * i - sin * j, sin * i + cos * j) * pitch;
            discs.push((at, radii[usize::from(dice.unit() < 0.5)]));
        }
        Self { discs, ..Self::default() }
    }

    /// Patches that cover this share of the ground.
    pub fn mottle(dice: &mut Dice, share: f64, grain: f64) -> Self {
        let field: Vec<f64> = (0..SIDE * SIDE).map(|_| dice.normal()[0]).collect();
        let mut clutter = Self { field, grain, ..Self::default() };
        // the share is that of the interpolated field, which is less rough than its table
        let mut values: Vec<f64> = (0..40_000)
            .map(|_| clutter.value(&Vector2::new(dice.within(0.0, 4000.0), dice.within(0.0, 4000.0))))
            .collect();
        values.sort_unstable_by(f64::total_cmp);
        clutter.above = values[((1.0 - share) * values.len() as f64) as usize];
        clutter
    }

    pub fn is_empty(&self) -> bool {
        self.discs.is_empty() && self.field.is_empty()
    }

    /// The level of a place whose ground has `level`; edges are as wide as `blur_px` makes them.
    pub fn over(&self, level: f64, px: &Vector2<f64>, blur_px: f64) -> f64 {
        let width = blur_px.max(0.5);
        let mut dark = 0.0f64;
        for (at, radius) in &self.discs {
            let (from, reach) = (px - at, radius + 6.0 * width);
            if from.norm_squared() < reach * reach {
                let inside = (radius - from.norm()) / width;
                dark = dark.max(step(inside));
            }
        }
        if !self.field.is_empty() {
            // the field's own slope is about one per grain
            dark = dark.max(step((self.value(px) - self.above) * self.grain / width));
        }
        level + (self.level - level) * dark
    }

    fn value(&self, px: &Vector2<f64>) -> f64 {
        let (u, v) = (px.x / self.grain, px.y / self.grain);
        let at = |i: f64, j: f64| self.field[(j as usize % SIDE) * SIDE + i as usize % SIDE];
        let (i, j) = (u.floor(), v.floor());
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (a, b) = (smooth(u - i), smooth(v - j));
        let top = at(i, j) * (1.0 - a) + at(i + 1.0, j) * a;
        let bottom = at(i, j + 1.0) * (1.0 - a) + at(i + 1.0, j + 1.0) * a;
        top * (1.0 - b) + bottom * b
    }
}

/// From 0 to 1 over about four units.
fn step(x: f64) -> f64 {
    1.0 / (1.0 + (-1.7 * x).exp())
}
