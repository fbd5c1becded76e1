//! Orientation of all triples of points, and from it the order of the corners of all their convex quadrilaterals.

/// Of a few points, for each pair, as bits: the points behind both on one side, and on the other. The buffer is reused.
#[derive(Debug, Clone)]
pub(super) struct Turns {
    points: Vec<(f64, f64)>,
    /// Of the points `i < j`: the points `k > j` of which the turn from `i` over `j` is one of x towards y, and those of which it is
    /// the other way round. Neither where they lie on a line.
    sides: Vec<[u32; 2]>,
}

impl Turns {
    /// For at most `limit` points, 32 of them.
    pub(super) fn with_limit(limit: usize) -> Self {
        Self { points: Vec::with_capacity(limit), sides: Vec::with_capacity(limit * limit) }
    }

    pub(super) fn set(&mut self, points: impl Iterator<Item = (f64, f64)>) {
        self.points.clear();
        self.points.extend(points.take(32));
        self.sides.clear();
        for (i, p) in self.points.iter().enumerate() {
            for (j, q) in self.points.iter().enumerate() {
                let mut sides = [0, 0];
                for (k, r) in self.points.iter().enumerate().skip(j + 1).filter(|_| i < j) {
                    let turn = (q.0 - p.0) * (r.1 - q.1) - (q.1 - p.1) * (r.0 - q.0);
                    sides[0] |= u32::from(turn > 0.0) << k;
                    sides[1] |= u32::from(turn < 0.0) << k;
                }
                self.sides.push(sides);
            }
        }
    }

    /// Four points, rising, in the order in which a walk around them meets them, x towards y; `None` when they are not the corners of a
    /// convex quadrilateral.
    #[inline]
    pub(super) fn convex_order(&self, [a, b, c, d]: [usize; 4]) -> Option<[usize; 4]> {
        let turn = |p: usize, q: usize, r: usize| {
            let [left, right] = self.sides.get(p * self.points.len() + q)?;
            if left >> r & 1 == 1 { Some(true) } else { (right >> r & 1 == 1).then_some(false) }
        };
        // the turns abc, abd, acd, bcd leave one order, or none
        match (turn(a, b, c)?, turn(a, b, d)?, turn(a, c, d)?, turn(b, c, d)?) {
            (true, true, true, true) => Some([a, b, c, d]),
            (true, true, false, false) => Some([a, b, d, c]),
            (false, true, true, false) => Some([a, c, b, d]),
            (false, false, true, true) => Some([a, c, d, b]),
            (true, false, false, true) => Some([a, d, b, c]),
            (false, false, false, false) => Some([a, d, c, b]),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// By the angles about the middle.
    fn slow(points: &[(f64, f64)], which: [usize; 4]) -> Option<[usize; 4]> {
        let mut out = which;
        let mean = |part: fn(&(f64, f64)) -> f64| which.iter().map(|&i| part(&points[i])).sum::<f64>() / 4.0;
        let (x, y) = (mean(|p| p.0), mean(|p| p.1));
        let angle = |i: usize| (points[i].1 - y).atan2(points[i].0 - x);
        out.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
        let convex = (0..4).all(|i| {
            let [p, q, r] = [0, 1, 2].map(|k| points[out[(i + k) % 4]]);
            (q.0 - p.0) * (r.1 - q.1) - (q.1 - p.1) * (r.0 - q.0) > 0.0
        });
        let start = out.iter().position(|&i| i == which[0])?;
        out.rotate_left(start);
        convex.then_some(out)
    }

    proptest! {
        #[test]
        fn quadrilaterals_are_walked_around(points in prop::collection::vec((0i32..40, 0i32..30), 4..9)) {
            // whole numbers: three of some lie on a line
            let points: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (f64::from(x), f64::from(y))).collect();
            let mut turns = Turns::with_limit(16);
            turns.set(points.iter().copied());
            let n = points.len();
            for i in 0..n {
                for (j, k) in (i + 1..n).flat_map(|j| (j + 1..n).map(move |k| (j, k))) {
                    for l in k + 1..n {
                        prop_assert_eq!(turns.convex_order([i, j, k, l]), slow(&points, [i, j, k, l]));
                    }
                }
            }
        }
    }
}
