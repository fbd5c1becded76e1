//! A dark region with its holes filled: glare on a dot leaves a light spot in it.

use crate::imaging::{Component, Run};

/// The region that contains each row of a region's box from its first to its last dark pixel. `runs` are those that the region was made
/// of, in reading order.
pub(super) fn filled(runs: &[Run], region: &Component) -> Component {
    let mut out = Component {
        x0: u32::MAX,
        y0: region.y0,
        y1: region.y1,
        touches_border: region.touches_border,
        ..Component::default()
    };
    let from = runs.partition_point(|run| run.y < region.y0);
    let mut rest = runs.get(from..).unwrap_or(&[]);
    while let Some(y) = rest.first().map(|run| run.y).filter(|y| *y < region.y1) {
        let count = rest.partition_point(|run| run.y == y);
        let (row, below) = rest.split_at(count);
        rest = below;
        // the runs of a row lie from left to right
        let first = row.partition_point(|run| run.x1 <= region.x0);
        let end = row.partition_point(|run| run.x0 < region.x1);
        let Some([first, .., last] | [first @ last]) = row.get(first..end) else { continue };
        out.add_run(&Run { y, x0: first.x0.max(region.x0), x1: last.x1.min(region.x1) });
    }
    out.x0 = out.x0.min(out.x1);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::{Components, Connectivity, ImageView, Runs, Window};

    fn regions(inside: impl Fn(f64, f64) -> bool) -> (Runs, Vec<Component>) {
        let pixels: Vec<u8> = (0..90 * 70)
            .map(|i| if inside(f64::from(i % 90), f64::from(i / 90)) { 0 } else { 255 })
            .collect();
        let image = ImageView::new(&pixels, 90, 70).unwrap();
        let window = Window::whole(&image);
        let (mut runs, mut components) = (Runs::with_limit(1000), Components::with_limit(1000));
        runs.find(&image, &window, 128);
        components.find(&runs, &window, Connectivity::Eight);
        (runs, components.as_slice().to_vec())
    }

    #[test]
    fn a_dot_with_a_hole_becomes_the_dot() {
        let disc = |x: f64, y: f64| (x - 40.3).hypot(y - 30.6) < 18.0;
        let (_, whole) = regions(disc);
        let (runs, holed) = regions(|x, y| disc(x, y) && (x - 36.0).hypot(y - 33.0) > 6.0);
        assert!(holed[0].m00 < whole[0].m00);
        assert_eq!(filled(runs.as_slice(), &holed[0]), whole[0]);
    }

    #[test]
    fn what_has_no_hole_stays() {
        let (runs, found) = regions(|x, y| ((x - 40.0) / 20.0).powi(2) + ((y - 30.0) / 9.0).powi(2) < 1.0);
        assert_eq!(filled(runs.as_slice(), &found[0]), found[0]);
        assert_eq!(filled(&[], &found[0]).m00, 0);
    }
}
