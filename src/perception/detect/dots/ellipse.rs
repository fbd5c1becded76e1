//! The pixels of an ellipse, row by row.

/// An ellipse of pixels, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelEllipse {
    pub(super) x: f64,
    pub(super) y: f64,
    /// Half of its extent in rows.
    pub(super) height: f64,
    /// Displacement of the middle of a row per row.
    pub(super) slope: f64,
    /// Half of its width in the row of its centre.
    pub(super) width: f64,
    /// One over the square of the height.
    pub(super) inverse: f64,
}

impl PixelEllipse {
    /// The ellipse `d^T S^-1 d <= 1` about `(x, y)`, `S = [xx, xy, yy]`.
    pub(super) fn new(x: f64, y: f64, [xx, xy, yy]: [f64; 3]) -> Self {
        let slope = xy / yy;
        let (height, width) = (yy.max(0.0).sqrt(), (xx - xy * slope).max(0.0).sqrt());
        Self { x, y, height, slope, width, inverse: 1.0 / (height * height) }
    }

    /// The pixels `x0..x1` of one row of it; not cut to any image, but at 0.
    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> Option<(usize, usize)> {
        let dy = f64::from(y as u32) - self.y;
        let square = 1.0 - dy * dy * self.inverse;
        // NaN gives none
        if !(square > 0.0) {
            return None;
        }
        let (half, middle) = (self.width * square.sqrt(), self.x + self.slope * dy);
        if middle + half < 0.0 {
            return None;
        }
        Some((ceil(middle - half) as usize, ((middle + half) as i32 + 1) as usize))
    }

    /// Mean square of the distances of its rim's two points from its centre, so far from the centre's row, px^2. Beyond its ends there is
    /// the tail of the blur: somewhere in the `length` px that are used there.
    #[inline(always)]
    pub(super) fn rim_at(&self, away: f64, length: f64) -> f64 {
        let square = away * away;
        let along =
            self.width * self.width * (1.0 - square * self.inverse) + self.slope * self.slope * square;
        let least = length * length * (1.0 / 24.0);
        (if along > least { along } else { least }) + square
    }

    /// First row and the one behind the last, in an image of that height.
    #[inline(always)]
    pub(super) fn span(&self, height: usize) -> (i32, i32) {
        // NaN gives no rows
        let some = self.height > 0.0 && self.y + self.height >= 0.0;
        if some {
            (ceil(self.y - self.height), ((self.y + self.height) as i32 + 1).min(height as i32))
        } else {
            (0, 0)
        }
    }

    /// Every `step`-th row of it in an image of the given size, as `(y, x0, x1)`: its pixels are `x0..x1`.
    #[inline(always)]
    pub(super) fn rows(&self, width: usize, height: usize, step: usize) -> EllipseRows {
        let (top, bottom) = self.span(height);
        let Self { x, y: centre, slope, width: half, inverse, .. } = *self;
        EllipseRows {
            y: top,
            bottom,
            step: step as i32,
            limit: width as i32,
            x,
            centre,
            slope,
            half,
            inverse,
        }
    }
}

/// See [`PixelEllipse::rows`].
pub(super) struct EllipseRows {
    y: i32,
    bottom: i32,
    step: i32,
    limit: i32,
    x: f64,
    centre: f64,
    slope: f64,
    half: f64,
    inverse: f64,
}

impl Iterator for EllipseRows {
    type Item = (usize, usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        while self.y < self.bottom {
            let y = self.y;
            self.y += self.step;
            let dy = f64::from(y) - self.centre;
            let square = 1.0 - dy * dy * self.inverse;
            let half = self.half * if square > 0.0 { square } else { 0.0 }.sqrt();
            let middle = self.x + self.slope * dy;
            if middle + half < 0.0 {
                continue;
            }
            let (x0, x1) = (ceil(middle - half), ((middle + half) as i32 + 1).min(self.limit));
            if x0 < x1 {
                return Some((y as usize, x0 as usize, x1 as usize));
            }
        }
        None
    }
}

/// The least whole number that is not below `x`, nor below 0. A cast: `ceil` is a call on the baseline processor.
#[inline(always)]
fn ceil(x: f64) -> i32 {
    let x = if x > 0.0 { x } else { 0.0 };
    let whole = x as i32;
    whole + i32::from(x > f64::from(whole))
}
