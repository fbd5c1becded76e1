//! Corners of chessboard squares in a whole image: the local maxima of the ring response, with the directions of their edges.

use super::ring::{RING, RING_RADIUS_PX, RingResponse};
use crate::imaging::ImageView;
use std::f32::consts::PI;

/// A maximum is the greatest response within so many pixels in x and y. Chosen by hand: a corner's response is some pixels wide, more when it is
/// blurred; twice as many would merge corners of squares of 6 px.
const ALONE_PX: usize = 3;

/// Where four squares meet, as the ring about it shows it; good to some tenths of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RingCorner {
    /// Position, px.
    pub x: f32,
    /// Position, px.
    pub y: f32,
    /// Ring response, grey levels.
    pub response: u8,
    /// Difference between the light and the dark squares on the ring, grey levels.
    pub contrast: f32,
    /// Direction of the edge across which the image becomes lighter with rising angle (from x to y), in `0..pi`, rad.
    pub rising: f32,
    /// Direction of the other edge, in `0..pi`, rad.
    pub falling: f32,
}

/// Finds corners by their ring response. Owns its buffers.
#[derive(Debug, Clone)]
pub struct RingDetector {
    response: RingResponse,
    corners: Vec<RingCorner>,
    limit: usize,
}

impl RingDetector {
    /// For images of up to `pixels` pixels and at most `limit` corners (the strongest are kept); allocated at once.
    #[must_use]
    pub fn new(pixels: usize, limit: usize) -> Self {
        let limit = limit.max(1);
        Self { response: RingResponse::with_capacity(pixels), corners: Vec::with_capacity(2 * limit), limit }
    }

    /// The corners found last, the strongest first.
    #[must_use]
    pub fn corners(&self) -> &[RingCorner] {
        &self.corners
    }

    /// Finds the corners with a response of more than `least` grey levels.
    pub fn find(&mut self, image: &ImageView<'_>, least: u8) -> &[RingCorner] {
        self.response.compute(image, least);
        self.corners.clear();
        let mut least = least;
        let (width, height) = self.response.size();
        // where the responses end, a maximum may be none
        let rim = RING_RADIUS_PX + 1;
        for y in rim..height.saturating_sub(rim) {
            let row = self.response.row(y);
            let mut x = 0;
            for part in row.chunks(32) {
                // nearly all parts hold nothing
                if part.iter().fold(0, |a, &b| a.max(b)) > least {
                    let columns = x.max(rim)..(x + part.len()).min(width.saturating_sub(rim));
                    for (at, about) in columns.clone().zip(row.windows(3).skip(columns.start - 1)) {
                        // of equal ones the first is the peak
                        if let &[before, value, behind] = about
                            && value > least
                            && before < value
                            && behind <= value
                            && is_peak(&self.response, at, y, value)
                        {
                            self.corners.extend(corner(image, &self.response, at, y, value));
                        }
                    }
                }
                x += part.len();
            }
            if self.corners.len() + width / ALONE_PX >= 2 * self.limit {
                least = self.keep_strongest().max(least);
            }
        }
        self.keep_strongest();
        &self.corners
    }

    /// Sorts, and leaves out those over the limit; the response of the first that was left out.
    fn keep_strongest(&mut self) -> u8 {
        // position breaks ties, so that the order does not hang on the sort
        let place = |c: &RingCorner| (c.y, c.x);
        self.corners.sort_unstable_by(|a, b| {
            b.response
                .cmp(&a.response)
                .then(place(a).partial_cmp(&place(b)).unwrap_or(std::cmp::Ordering::Equal))
        });
        let over = self.corners.get(self.limit).map_or(0, |c| c.response);
        self.corners.truncate(self.limit);
        over
    }
}

/// Whether no response nearby is greater; of equal ones the first in reading order counts.
fn is_peak(response: &RingResponse, x: usize, y: usize, value: u8) -> bool {
    let columns = x.saturating_sub(ALONE_PX)..x + ALONE_PX + 1;
    (y.saturating_sub(ALONE_PX)..y + ALONE_PX + 1).all(|v| {
        let row = response.row(v);
        let end = columns.end.min(row.len());
        let Some(part) = row.get(columns.start.min(end)..end) else { return true };
        part.iter().enumerate().all(|(i, &other)| {
            let before = (v, columns.start + i) < (y, x);
            other < value || (other == value && !before)
        })
    })
}

/// The corner at a maximum of the response, if its ring crosses two edges.
fn corner(
    image: &ImageView<'_>,
    response: &RingResponse,
    x: usize,
    y: usize,
    value: u8,
) -> Option<RingCorner> {
    let [rising, falling, contrast] = ring_edges(image, x, y)?;
    // vertex of the parabola through three responses
    let vertex = |a: u8, c: u8| {
        let (a, b, c) = (f32::from(a), f32::from(value), f32::from(c));
        let bend = 2.0 * b - a - c;
        if bend > 0.0 { (0.5 * (c - a) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    Some(RingCorner {
        x: x as f32 + vertex(response.at(x - 1, y), response.at(x + 1, y)),
        y: y as f32 + vertex(response.at(x, y - 1), response.at(x, y + 1)),
        response: value,
        contrast,
        rising,
        falling,
    })
}

/// Directions of the two edges that cross the ring about a pixel, rad in `0..pi`: rising and falling; and the contrast on the ring,
/// grey levels. `None` when there are not two.
pub(super) fn ring_edges(image: &ImageView<'_>, x: usize, y: usize) -> Option<[f32; 3]> {
    let mut means = [0.0f32; 8];
    for (mean, (&[ax, ay], &[bx, by])) in means.iter_mut().zip(RING.iter().zip(RING.iter().skip(8))) {
        let at = |dx: i8, dy: i8| {
            let row = image.row(y.checked_add_signed(isize::from(dy))?);
            row.get(x.checked_add_signed(isize::from(dx))?).map(|&p| f32::from(p))
        };
        *mean = 0.5 * (at(ax, ay)? + at(bx, by)?);
    }
    crossings(&means).or_else(|| {
        let mut smooth = means;
        for (k, s) in smooth.iter_mut().enumerate() {
            let near = |i: usize| means.get((k + i) % 8).copied().unwrap_or(0.0);
            *s = 0.5 * near(0) + 0.25 * (near(1) + near(7));
        }
        crossings(&smooth)
    })
}

/// Where the eight means of opposite samples cross the middle of their extremes: once upwards, once downwards.
fn crossings(means: &[f32; 8]) -> Option<[f32; 3]> {
    let (low, high) = means.iter().fold((f32::MAX, f32::MIN), |(l, h), &m| (l.min(m), h.max(m)));
    let middle = 0.5 * (low + high);
    let (mut up, mut down, mut count) = (0.0, 0.0, 0);
    for k in 0..8 {
        let (Some(&a), Some(&b)) = (means.get(k), means.get((k + 1) % 8)) else { return None };
        if (a > middle) == (b > middle) {
            continue;
        }
        count += 1;
        let part = (middle - a) / (b - a);
        let angle = |k: usize| RING.get(k).map_or(0.0, |&[x, y]| f32::from(y).atan2(f32::from(x)));
        // the ninth is opposite of the first
        let (from, to) = (angle(k), if k == 7 { PI } else { angle(k + 1) });
        let at = (from + part * (to - from)).rem_euclid(PI);
        *(if b > a { &mut up } else { &mut down }) = at;
    }
    (count == 2).then_some([up, down, high - low])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_turned_squares_are_found_with_their_edges() {
        let (width, height) = (200, 160);
        for turn in [0.0f32, 0.2, 0.7, 1.3] {
            let (s, c) = turn.sin_cos();
            let side = 17.0;
            let cell = |x: f32, y: f32| ((c * x + s * y) / side, (c * y - s * x) / side);
            let mut pixels = vec![0u8; width * height];
            for (i, p) in pixels.iter_mut().enumerate() {
                let mut sum = 0.0;
                for k in 0..16 {
                    let (dx, dy) = ((k % 4) as f32 / 4.0 - 0.375, (k / 4) as f32 / 4.0 - 0.375);
                    let (u, v) = cell((i % width) as f32 + dx, (i / width) as f32 + dy);
                    sum += f32::from(u8::from((u.floor() + v.floor()).rem_euclid(2.0) > 0.5));
                }
                *p = (40.0 + 10.0 * sum) as u8;
            }
            let image = ImageView::new(&pixels, width, height).unwrap();
            let mut detector = RingDetector::new(width * height, 500);
            let corners = detector.find(&image, 10).to_vec();
            assert!(corners.len() > 60, "{}", corners.len());
            // of a corner nearer to the rim only the flank is seen
            let inside = |k: &&RingCorner| k.x > 9.0 && k.y > 9.0 && k.x < 190.0 && k.y < 150.0;
            for k in corners.iter().filter(inside) {
                let (u, v) = cell(k.x, k.y);
                assert!((u - u.round()).hypot(v - v.round()) * side < 1.0, "{turn} {k:?} {u} {v}");
                let off = |angle: f32| {
                    let d = (angle - turn).rem_euclid(PI / 2.0);
                    d.min(PI / 2.0 - d)
                };
                assert!(off(k.rising) < 0.12 && off(k.falling) < 0.12, "{turn} {k:?}");
                let between = (k.rising - k.falling).abs();
                assert!((between - PI / 2.0).abs() < 0.3);
                // a step along the ring past the rising edge is light
                let (ps, pc) = (k.rising + 0.6).sin_cos();
                let (px, py) = ((k.x + 5.0 * pc).round() as usize, (k.y + 5.0 * ps).round() as usize);
                assert!(image.row(py)[px] > 120);
            }
            // every inner corner of the image is there
            let mut missing = 0;
            for i in -20..20i8 {
                for j in -20..20i8 {
                    let (u, v) = (f32::from(i) * side, f32::from(j) * side);
                    let (x, y) = (c * u - s * v, s * u + c * v);
                    let inside = x > 7.0 && y > 7.0 && x < width as f32 - 8.0 && y < height as f32 - 8.0;
                    missing += usize::from(inside && !corners.iter().any(|k| (k.x - x).hypot(k.y - y) < 1.0));
                }
            }
            assert_eq!(missing, 0);
        }
    }

    #[test]
    fn the_strongest_are_kept() {
        let mut state = 1u64;
        let pixels: Vec<u8> = (0..300 * 200)
            .map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            })
            .collect();
        let image = ImageView::new(&pixels, 300, 200).unwrap();
        let all = RingDetector::new(300 * 200, 50_000).find(&image, 1).to_vec();
        let few = RingDetector::new(300 * 200, 40).find(&image, 1).to_vec();
        assert!(all.len() > 100 && few.len() == 40, "{}", all.len());
        assert_eq!(all[..40], few[..]);
    }
}
