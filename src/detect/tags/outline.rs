//! The outer outline of a dark region: along the sides of its pixels, the region to the right, each side moved to where the grey
//! levels cross the threshold.

use super::regions::DarkRegion;
use super::threshold::DarkBits;
use crate::imaging::ImageView;

/// A point of an outline, px of the window.
pub(super) type WindowPoint = [f32; 2];

/// Steps to the right, down, left, up: clockwise on the screen.
const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
/// From the corner where a step ends to the pixel ahead on the right, and on the left.
const RIGHT_AHEAD: [[i32; 2]; 4] = [[0, 0], [-1, 0], [-1, -1], [0, -1]];

/// Follows the outline of `region` into `points`; false when it is longer than `most` sides.
pub(super) fn follow(
    image: &ImageView<'_>,
    origin: (usize, usize),
    bits: &DarkBits,
    region: &DarkRegion,
    most: usize,
    points: &mut Vec<WindowPoint>,
) -> bool {
    points.clear();
    let start = [region.x as i32, region.y as i32];
    // corner (x, y) is the upper left one of pixel (x, y)
    let (mut at, mut heading) = (start, 0usize);
    loop {
        if points.len() >= most {
            return false;
        }
        // the side from `at` in direction `heading` has its dark pixel on the right
        let offset = RIGHT_AHEAD.get(heading).copied().unwrap_or([0; 2]);
        let dark = [at[0] + offset[0], at[1] + offset[1]];
        let out = STEPS.get((heading + 3) % 4).copied().unwrap_or([0; 2]);
        let light = [dark[0] + out[0], dark[1] + out[1]];
        let level = f32::from(bits.level(dark[0], dark[1]));
        let (a, b) = (level_of(image, origin, dark), level_of(image, origin, light));
        let share = if b > a { ((level - 0.5 - a) / (b - a)).clamp(0.0, 1.0) } else { 0.5 };
        points.push([dark[0] as f32 + share * out[0] as f32, dark[1] as f32 + share * out[1] as f32]);

        let step = STEPS.get(heading).copied().unwrap_or([0; 2]);
        at = [at[0] + step[0], at[1] + step[1]];
        let ahead = |turn: usize| {
            // right ahead of a left turn is what lies left ahead now
            let offset = RIGHT_AHEAD.get((heading + turn) % 4).copied().unwrap_or([0; 2]);
            bits.is_dark(at[0] + offset[0], at[1] + offset[1])
        };
        if !ahead(0) {
            heading = (heading + 1) % 4;
        } else if ahead(3) {
            heading = (heading + 3) % 4;
        }
        if at == start && heading == 0 {
            return true;
        }
    }
}

fn level_of(image: &ImageView<'_>, origin: (usize, usize), at: [i32; 2]) -> f32 {
    let (Ok(x), Ok(y)) = (usize::try_from(at[0]), usize::try_from(at[1])) else { return 0.0 };
    image.row(origin.1 + y).get(origin.0 + x).map_or(0.0, |&p| f32::from(p))
}
