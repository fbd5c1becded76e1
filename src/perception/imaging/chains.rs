//! Edge linking, Sect. 10.2.1: edge pixels become chains of sub-pixel points that run along the edge, light on the right hand as the
//! image is seen (y down).
//!
//! Each pixel looks among its eight neighbours for the nearest one ahead and the nearest one behind, of similar gradient; two that
//! chose each other are linked. Ends that are left take what is still free, a pixel farther too. So a chain never forks, and passes a corner of up to 90
//! degrees.

use super::edges::{EdgePixel, Edges, NONE};

/// Fewest points of an open chain whose ends can meet. Chosen by hand: the smallest loop of pixels around a pixel has eight.
const MIN_LOOP: usize = 8;

/// One chain: a range of [`Chains::points`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chain {
    /// Its first point.
    pub start: usize,
    /// Behind its last one.
    pub end: usize,
    /// Whether the ends meet: the last point lies within two columns and rows of the first, with a similar gradient.
    pub closed: bool,
}

/// Linked edges of an image. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Chains {
    points: Vec<EdgePixel>,
    chains: Vec<Chain>,
    next: Vec<u32>,
    previous: Vec<u32>,
    ahead: Vec<u32>,
    behind: Vec<u32>,
}

impl Chains {
    /// The points of all chains, chain by chain.
    #[must_use]
    pub fn points(&self) -> &[EdgePixel] {
        &self.points
    }

    /// The chains, in reading order of where they start.
    #[must_use]
    pub fn as_slice(&self) -> &[Chain] {
        &self.chains
    }

    /// The points of one chain; none where the chain is of another image.
    #[must_use]
    pub fn of(&self, chain: &Chain) -> &[EdgePixel] {
        self.points.get(chain.start..chain.end).unwrap_or(&[])
    }

    /// Links the edges; chains of fewer than `least` points are dropped.
    pub fn link(&mut self, edges: &Edges, least: usize) {
        let pixels = edges.pixels();
        self.ahead.clear();
        self.behind.clear();
        for (i, (p, around)) in (0..).zip(pixels.iter().zip(edges.around())) {
            let (ahead, behind) = nearest(pixels, p, around.indices(i), |_| true);
            self.ahead.push(ahead);
            self.behind.push(behind);
        }
        let count = pixels.len();
        for list in [&mut self.next, &mut self.previous] {
            list.clear();
            list.resize(count, NONE);
        }
        for i in 0..count {
            if let Some(&n) = self.ahead.get(i)
                && self.behind.get(n as usize) == Some(&(i as u32))
            {
                self.tie(i, n);
            }
        }
        for (i, (p, around)) in pixels.iter().zip(edges.around()).enumerate() {
            if self.next.get(i) != Some(&NONE) {
                continue;
            }
            let free = |n: u32| n as usize != i && self.previous.get(n as usize) == Some(&NONE);
            let mut n = nearest(pixels, p, around.indices(i as u32), free).0;
            // a spur of a pixel may lie between
            for a in around.indices(i as u32) {
                if let (NONE, Some(other)) = (n, edges.around().get(a as usize)) {
                    n = nearest(pixels, p, other.indices(a), free).0;
                }
            }
            if n != NONE {
                self.tie(i, n);
            }
        }
        self.trace(pixels, least);
    }

    fn tie(&mut self, from: usize, to: u32) {
        if let (Some(next), Some(previous)) = (self.next.get_mut(from), self.previous.get_mut(to as usize)) {
            (*next, *previous) = (to, from as u32);
        }
    }

    /// Follows the links: open chains from their starts, then what is left, the closed ones.
    fn trace(&mut self, pixels: &[EdgePixel], least: usize) {
        self.points.clear();
        self.chains.clear();
        for closed in [false, true] {
            for i in 0..pixels.len() {
                let start = if closed {
                    self.next.get(i) != Some(&NONE)
                } else {
                    self.previous.get(i) == Some(&NONE)
                };
                if !start {
                    continue;
                }
                let from = self.points.len();
                let mut at = i as u32;
                while let (Some(p), Some(next)) = (pixels.get(at as usize), self.next.get_mut(at as usize)) {
                    self.points.push(*p);
                    at = std::mem::replace(next, NONE);
                }
                // a closed chain ends with the pixel it started from
                let end = self.points.len() - usize::from(closed);
                self.points.truncate(end);
                if end - from < least.max(1) {
                    self.points.truncate(from);
                } else {
                    let ends = (self.points.get(from), self.points.last());
                    let meet = end - from >= MIN_LOOP && matches!(ends, (Some(a), Some(b)) if beside(a, b));
                    self.chains.push(Chain { start: from, end, closed: closed || meet });
                }
            }
            // single pixels and the last ones of open chains have no next; those of closed chains all have
        }
    }
}

/// Whether a loop can go on from `a` with `b`: a spur of a pixel may lie between.
fn beside(a: &EdgePixel, b: &EdgePixel) -> bool {
    let dot = i32::from(a.dx) * i32::from(b.dx) + i32::from(a.dy) * i32::from(b.dy);
    a.column.abs_diff(b.column) <= 2 && a.row.abs_diff(b.row) <= 2 && dot > 0
}

/// The nearest neighbours ahead and behind, `NONE` for none: of gradient within 60 degrees.
#[inline]
fn nearest(
    pixels: &[EdgePixel],
    p: &EdgePixel,
    around: impl Iterator<Item = u32>,
    free: impl Fn(u32) -> bool,
) -> (u32, u32) {
    let (dx, dy) = (f32::from(p.dx), f32::from(p.dy));
    let size = 0.25 * (dx * dx + dy * dy);
    let (mut ahead, mut behind) = ((NONE, f32::INFINITY), (NONE, f32::INFINITY));
    for n in around {
        let Some(q) = pixels.get(n as usize) else { continue };
        let (qx, qy) = (f32::from(q.dx), f32::from(q.dy));
        let dot = dx * qx + dy * qy;
        if dot <= 0.0 || dot * dot < size * (qx * qx + qy * qy) {
            continue;
        }
        let (x, y) = (q.x_px - p.x_px, q.y_px - p.y_px);
        // the edge runs along (dy, -dx) here and along (qy, -qx) there: as far along both
        let along = x * (dy + qy) - y * (dx + qx);
        let distance = x * x + y * y;
        let best = if along > 0.0 { &mut ahead } else { &mut behind };
        if along != 0.0 && distance < best.1 && free(n) {
            *best = (n, distance);
        }
    }
    (ahead.0, behind.0)
}

#[cfg(test)]
mod tests {
    use super::super::test_image::any_image;
    use super::super::{EdgeThresholds, ImageView};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every pixel at most once, neighbours beside each other, nothing lost.
        #[test]
        fn chains_are_paths(image in any_image(), least in 0usize..8) {
            let (mut edges, mut chains) = (Edges::with_limit(10_000), Chains::default());
            edges.find(&image.view(), &EdgeThresholds { low: 30.0, high: 60.0, ..EdgeThresholds::default() });
            chains.link(&edges, least);
            let mut seen = std::collections::BTreeSet::new();
            for chain in chains.as_slice() {
                let points = chains.of(chain);
                prop_assert!(points.len() >= least.max(1));
                prop_assert!(points.windows(2).all(|w| super::beside(&w[0], &w[1])));
                prop_assert!(!chain.closed || points.len() > 2 && super::beside(&points[0], &points[points.len() - 1]));
                for p in points {
                    prop_assert!(seen.insert((p.row, p.column)));
                    prop_assert!(edges.pixels().contains(p));
                }
            }
            if least <= 1 {
                prop_assert_eq!(seen.len(), edges.pixels().len());
            }
        }
    }

    fn disc(radius: f64, x: f64, y: f64) -> Vec<u8> {
        (0..100 * 100)
            .map(|i| {
                let d = (f64::from(i % 100) - x).hypot(f64::from(i / 100) - y) - radius;
                (40.0 + 160.0 / (1.0 + (-1.9 * d).exp())).round() as u8
            })
            .collect()
    }

    #[test]
    fn a_dark_disc_is_one_closed_chain_with_the_light_on_its_right() {
        for k in 0..40 {
            let r = 4.0 + 0.9 * f64::from(k);
            let (x, y) = (49.5 + 0.13 * f64::from(k) % 1.0, 49.7 - 0.29 * f64::from(k) % 1.0);
            let bytes = disc(r, x, y);
            let (mut edges, mut chains) = (Edges::with_limit(10_000), Chains::default());
            edges.find(&ImageView::new(&bytes, 100, 100).unwrap(), &EdgeThresholds::default());
            chains.link(&edges, 5);
            let [chain] = chains.as_slice() else { panic!("{r}: {:?}", chains.as_slice()) };
            assert!(chain.closed, "{r}");
            let points = chains.of(chain);
            let mut area = 0.0;
            for (p, q) in points.iter().zip(points.iter().cycle().skip(1)) {
                area += 0.5 * f64::from(p.x_px * q.y_px - q.x_px * p.y_px);
            }
            // counter-clockwise as seen, that is negative with y down: the dark disc on the left hand
            assert!((-area / (std::f64::consts::PI * r * r) - 1.0).abs() < 0.06, "{r}: {area}");
        }
    }
}
