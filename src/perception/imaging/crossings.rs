//! An outline to a fraction of a pixel: each side of a pixel that it goes along, moved to where the grey levels cross the threshold.

use super::outlines::Walker;
use super::{ImageView, LocalThreshold, Outline, Outlines, Run, Runs};
use std::ops::Range;

/// A place between pixels (column, row), px of the image or window that was looked at.
pub type WindowPoint = [f32; 2];

impl Outlines {
    /// Fills `points` with the outline `outline`, one of those found last for `runs`, the pixels of `image` below `thresholds`
    /// ([`Runs::find_below`]): px, clockwise on the screen with the region to the right, from the upper side of its first pixel on. False where
    /// they are more than `most`.
    pub fn crossings(
        &self,
        outline: &Outline,
        runs: &Runs,
        image: &ImageView<'_>,
        thresholds: &LocalThreshold,
        most: usize,
        points: &mut Vec<WindowPoint>,
    ) -> bool {
        points.clear();
        points.resize(most, [0.0; 2]);
        let mut sides = Crossings { image, thresholds, points, count: 0 };
        self.retrace(runs.as_slice(), outline, &mut sides);
        let count = sides.count;
        points.truncate(count);
        points.reverse();
        count <= most
    }
}

/// Collects the sides of pixels along an outline.
struct Crossings<'a> {
    image: &'a ImageView<'a>,
    thresholds: &'a LocalThreshold,
    points: &'a mut [WindowPoint],
    /// Of all points, also of those for which there is no room.
    count: usize,
}

impl Crossings<'_> {
    /// The side of pixel (x, y), which is below its threshold and `dark`, towards its neighbour at `out`, which is not.
    #[inline(always)]
    fn push(&mut self, x: u32, y: u32, out: [f32; 2], dark: u8, light: u8) {
        let slot = self.points.get_mut(self.count);
        self.count += 1;
        let Some(slot) = slot else { return };
        let threshold = f32::from(self.thresholds.at(x, y)) - 0.5;
        let (dark, light) = (f32::from(dark), f32::from(light));
        let share = if light > dark { ((threshold - dark) / (light - dark)).clamp(0.0, 1.0) } else { 0.5 };
        *slot = [x as f32 + share * out[0], y as f32 + share * out[1]];
    }

    /// The left side of pixel (x, y), or its right one.
    #[inline(always)]
    fn beside(&mut self, x: u32, y: u32, right: bool) {
        let row = self.image.row(y as usize);
        let level = |x: u32| row.get(x as usize).copied().unwrap_or(0);
        let (next, out) = if right { (x + 1, [1.0, 0.0]) } else { (x.wrapping_sub(1), [-1.0, 0.0]) };
        self.push(x, y, out, level(x), level(next));
    }

    /// Upper sides of pixels `to..from` of a row, to the left.
    #[inline(always)]
    fn west(&mut self, from: u32, to: u32, y: u32) {
        let levels = levels(self.image, to..from, y, y.wrapping_sub(1));
        levels.rev().for_each(|(x, dark, light)| self.push(x, y, [0.0, -1.0], dark, light));
    }

    /// Lower sides of pixels `from..to` of a row, to the right.
    #[inline(always)]
    fn east(&mut self, from: u32, to: u32, y: u32) {
        let levels = levels(self.image, from..to, y, y + 1);
        levels.for_each(|(x, dark, light)| self.push(x, y, [0.0, 1.0], dark, light));
    }
}

/// Columns `range`, and their levels in row `y` and in row `next`, which may be none of the image.
#[inline(always)]
fn levels<'a>(
    image: &'a ImageView<'a>,
    range: Range<u32>,
    y: u32,
    next: u32,
) -> impl DoubleEndedIterator<Item = (u32, u8, u8)> + use<'a> {
    let (row, other) = (image.row(y as usize), image.row(next as usize));
    let level = |row: &[u8], x: u32| row.get(x as usize).copied().unwrap_or(0);
    range.map(move |x| (x, level(row, x), level(other, x)))
}

impl Walker for Crossings<'_> {
    fn start(&mut self, _: &Run, _: bool) {}

    #[inline(always)]
    fn step(&mut self, from_right: bool, from: &Run, to_right: bool, to: &Run) {
        let (a, b) = (from.x0, from.x1);
        self.beside(if from_right { b - 1 } else { a }, from.y, from_right);
        match (from_right, to_right) {
            // down: along the top of the run below, or along the own bottom
            (false, false) if to.x0 < a => self.west(a, to.x0, to.y),
            (false, false) => self.east(a, to.x0, from.y),
            // up: along the bottom of the run above, or along the own top
            (true, true) if to.x1 > b => self.east(b, to.x1, to.y),
            (true, true) => self.west(b, to.x1, from.y),
            // around the lower end, and the upper one
            (false, true) if to.x0 == a => self.east(a, b, from.y),
            (true, false) if to.x0 == a => self.west(b, a, from.y),
            // over to the run before by the one below that joins both, to the run behind by the one above
            (false, true) => self.west(a, to.x1, from.y + 1),
            (true, false) => self.east(b, to.x0, from.y - 1),
        }
    }

    fn end(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::super::test_image::TestImage;
    use super::*;
    use crate::imaging::{Components, Connectivity, Window};
    use proptest::prelude::*;

    /// By the definition: from pixel side to pixel side with the region to the right, turning right where that is light.
    fn slow(view: &ImageView<'_>, thresholds: &[Vec<u8>], start: [i32; 2]) -> Vec<[f32; 2]> {
        const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
        // from a pixel's corner to the pixel ahead on the right
        const RIGHT_AHEAD: [[i32; 2]; 4] = [[0, 0], [-1, 0], [-1, -1], [0, -1]];
        let value = |rows: &dyn Fn(usize) -> Option<Vec<u8>>, [x, y]: [i32; 2]| {
            let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
            rows(y)?.get(x).copied()
        };
        let level = |at| value(&|y| Some(view.row(y).to_vec()), at);
        let threshold = |at| value(&|y| thresholds.get(y).cloned(), at);
        let is_dark = |at| level(at).zip(threshold(at)).is_some_and(|(level, t)| level < t);
        let add = |a: [i32; 2], b: [i32; 2]| [a[0] + b[0], a[1] + b[1]];
        let (mut at, mut heading, mut points) = (start, 0, Vec::new());
        loop {
            let dark = add(at, RIGHT_AHEAD[heading]);
            let out = STEPS[(heading + 3) % 4];
            let (a, b) = (f32::from(level(dark).unwrap()), level(add(dark, out)).map_or(0.0, f32::from));
            let t = f32::from(threshold(dark).unwrap()) - 0.5;
            let share = if b > a { ((t - a) / (b - a)).clamp(0.0, 1.0) } else { 0.5 };
            points.push([dark[0] as f32 + share * out[0] as f32, dark[1] as f32 + share * out[1] as f32]);
            at = add(at, STEPS[heading]);
            if !is_dark(add(at, RIGHT_AHEAD[heading])) {
                heading = (heading + 1) % 4;
            } else if is_dark(add(at, RIGHT_AHEAD[(heading + 3) % 4])) {
                heading = (heading + 3) % 4;
            }
            if at == start && heading == 0 {
                return points;
            }
        }
    }

    proptest! {
        #[test]
        fn outlines_are_those_of_the_definition(
            size in (1usize..70, 1usize..40), gap in 0usize..5, kind in 0u8..4, seed in any::<u64>(),
        ) {
            let image = TestImage::new(size.0, size.1, gap, kind, seed);
            let view = image.view();
            let mut local = LocalThreshold::fine(0, 0);
            local.set_below(&view, 5, |spread| spread / 2);
            let thresholds: Vec<_> = (0..view.height()).map(|y| local.row(y).to_vec()).collect();
            let mut runs = Runs::with_limit(4000);
            runs.find_below(&view, &mut local);
            let (mut components, mut outlines) = (Components::default(), Outlines::default());
            components.find(&runs, &Window::whole(&view), Connectivity::Four);
            outlines.find(&runs, Connectivity::Four);
            let outer: Vec<_> = outlines.as_slice().iter().filter(|o| !o.hole).collect();
            prop_assert_eq!(outer.len(), components.as_slice().len());
            let mut points = Vec::new();
            for (i, outline) in outer.iter().enumerate() {
                let first = runs.as_slice()[outline.run as usize];
                let wanted = slow(&view, &thresholds, [first.x0 as i32, first.y as i32]);
                prop_assert!(outlines.crossings(outline, &runs, &view, &local, wanted.len(), &mut points));
                prop_assert_eq!(&points, &wanted, "outline {}", i);
                prop_assert!(!outlines.crossings(outline, &runs, &view, &local, wanted.len() - 1, &mut points));
                let component = &components.as_slice()[i];
                prop_assert_eq!((component.y0, outline.region as usize), (first.y, i));
            }
        }
    }
}
