//! A camera that looks at a chessboard, by sampling: shares nothing with the renderer of the project.

#![allow(non_snake_case, dead_code)] // each test uses a part
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

/// SplitMix64.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * self.within(1e-12, 1.0).ln()).sqrt() * self.within(0.0, std::f64::consts::TAU).cos()
    }

    pub(crate) fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }
}

/// Something that lies before the board or behind it: a turned rectangle or ellipse of one level.
#[derive(Clone, Copy)]
pub(crate) struct Thing {
    pub(crate) middle: Vector2<f64>,
    pub(crate) half: Vector2<f64>,
    pub(crate) turn: f64,
    pub(crate) round: bool,
    pub(crate) level: f64,
    /// Stripes of that width, px; 0 for none.
    pub(crate) stripe: f64,
}

impl Thing {
    pub(crate) fn random(random: &mut Random, width: f64, height: f64, largest: f64) -> Self {
        Self {
            middle: Vector2::new(random.within(0.0, width), random.within(0.0, height)),
            half: Vector2::new(random.within(4.0, largest), random.within(4.0, largest)),
            turn: random.within(0.0, 3.2),
            round: random.below(3) == 0,
            level: random.within(5.0, 250.0),
            stripe: if random.below(3) == 0 { random.within(4.0, 30.0) } else { 0.0 },
        }
    }

    /// Its level at a point, if it is there.
    #[inline]
    fn at(&self, p: Vector2<f64>) -> Option<f64> {
        let d = p - self.middle;
        // most samples lie beyond its corners
        if d.norm_squared() > 1.001 * self.half.norm_squared() {
            return None;
        }
        let (s, c) = self.turn.sin_cos();
        let (x, y) = ((c * d.x + s * d.y) / self.half.x, (c * d.y - s * d.x) / self.half.y);
        let inside = if self.round { x * x + y * y < 1.0 } else { x.abs() < 1.0 && y.abs() < 1.0 };
        let odd = self.stripe > 0.0 && is_odd((x * self.half.x / self.stripe).floor());
        inside.then_some(if odd { 255.0 - self.level } else { self.level })
    }
}

/// Whether a whole number is odd: without the division that a remainder of floating point is.
#[inline]
fn is_odd(n: f64) -> bool {
    n as i64 & 1 != 0
}

/// Image of a point under a projective map: component by component, since each sample of an image needs it.
#[inline]
fn mapped(H: &Matrix3<f64>, p: Vector2<f64>) -> Vector2<f64> {
    let along = |i: usize| H[(i, 0)] * p.x + H[(i, 1)] * p.y + H[(i, 2)];
    Vector2::new(along(0), along(1)) / along(2)
}

/// A view of a board with `columns x rows` inner corners and squares of side 1.
#[derive(Clone)]
pub(crate) struct View {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    /// Light rim about the outer squares, in squares.
    pub(crate) margin: f64,
    pub(crate) dark: f64,
    pub(crate) light: f64,
    /// From the board's plane (x, y, 1), corner 0 at the origin, to the undistorted image, px.
    pub(crate) homography: Matrix3<f64>,
    /// Radial distortion about the image's middle: `r (1 + k r^2)`, r in half widths.
    pub(crate) k: f64,
    /// Another lens: where each sample would lie without it, px, row by row.
    pub(crate) undistorted: Option<std::rc::Rc<Vec<Vector2<f64>>>>,
    pub(crate) behind: Vec<Thing>,
    pub(crate) before: Vec<Thing>,
    pub(crate) background: f64,
    /// Relative light at the image's sides: 1 - slope .. 1 + slope.
    pub(crate) slope: Vector2<f64>,
}

impl View {
    /// A board in the middle of an image, turned, tilted, its squares about `side` px.
    pub(crate) fn new(
        columns: usize,
        rows: usize,
        size: [usize; 2],
        turn: f64,
        tilt: f64,
        tilt_to: f64,
        side: f64,
    ) -> Self {
        let axis = Vector3::new(tilt_to.cos(), tilt_to.sin(), 0.0);
        let R = Rotation3::new(axis * tilt) * Rotation3::new(Vector3::z() * turn);
        let f = 1.2 * size[0] as f64;
        let z = f / side;
        let middle = Vector3::new(0.5 * (columns as f64 - 1.0), 0.5 * (rows as f64 - 1.0), 0.0);
        let t = Vector3::new(0.0, 0.0, z) - R * middle;
        let m = R.matrix();
        let K = Matrix3::new(
            f,
            0.0,
            0.5 * size[0] as f64 - 0.5,
            0.0,
            f,
            0.5 * size[1] as f64 - 0.5,
            0.0,
            0.0,
            1.0,
        );
        let H = K * Matrix3::from_columns(&[m.column(0).into_owned(), m.column(1).into_owned(), t]);
        Self {
            width: size[0],
            height: size[1],
            columns,
            rows,
            margin: 1.0,
            dark: 40.0,
            light: 200.0,
            homography: H,
            k: 0.0,
            undistorted: None,
            behind: Vec::new(),
            before: Vec::new(),
            background: 120.0,
            slope: Vector2::zeros(),
        }
    }

    /// The whole image moved by so much, px.
    pub(crate) fn shifted(mut self, x: f64, y: f64) -> Self {
        self.homography = Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0) * self.homography;
        self
    }

    fn middle(&self) -> Vector2<f64> {
        Vector2::new(0.5 * self.width as f64 - 0.5, 0.5 * self.height as f64 - 0.5)
    }

    /// Image of a corner, px.
    pub(crate) fn corner(&self, column: usize, row: usize) -> Vector2<f64> {
        let seen = mapped(&self.homography, Vector2::new(column as f64, row as f64));
        let d = (seen - self.middle()) / (0.5 * self.width as f64);
        self.middle() + d * (1.0 + self.k * d.norm_squared()) * (0.5 * self.width as f64)
    }

    /// Level at a point of the image, the `sample`-th.
    fn at(&self, inverse: &Matrix3<f64>, p: Vector2<f64>, sample: usize) -> f64 {
        if let Some(level) = self.before.iter().rev().find_map(|t| t.at(p)) {
            return level;
        }
        let half = 0.5 * self.width as f64;
        let d = (p - self.middle()) / half;
        let mut u = d;
        if self.k != 0.0 {
            for _ in 0..8 {
                u = d / (1.0 + self.k * u.norm_squared());
            }
        }
        let q = self.undistorted.as_ref().map_or(self.middle() + u * half, |all| all[sample]);
        let place = mapped(inverse, q);
        let (x, y) = (place.x, place.y);
        let (c, r) = (self.columns as f64, self.rows as f64);
        let on = |m: f64| x > -1.0 - m && y > -1.0 - m && x < c + m && y < r + m;
        let level = if on(0.0) {
            // dark above left of corner 0
            if is_odd(x.floor() + y.floor()) { self.light } else { self.dark }
        } else if on(self.margin) {
            self.light
        } else {
            self.behind.iter().rev().find_map(|t| t.at(p)).unwrap_or(self.background)
        };
        level * (1.0 + self.slope.dot(&d))
    }

    /// Mean level over the area of a sample well inside a board with nothing before it and even light; `all`: where samples lie on the
    /// board. Exact for straight edges: points alone, nine a pixel, are 0.02 px off.
    fn covered(&self, all: &[Vector2<f64>], i: usize, width: usize) -> Option<f64> {
        let p = all[i];
        let (c, r) = (self.columns as f64 - 0.2, self.rows as f64 - 0.2);
        let inside = p.x > -0.8 && p.y > -0.8 && p.x < c && p.y < r;
        if !inside || !self.before.is_empty() || self.slope != Vector2::zeros() {
            return None;
        }
        let step = |k: usize| (all.get(i + k).copied().unwrap_or(p) - all[i.saturating_sub(k)]) * 0.5;
        let (across, down) = (step(1), step(width));
        // of a line x = n that crosses a sample, which x spans by a trapezoid of sides a and b: twice the share beyond it, less one
        let side = |x: f64, a: f64, b: f64| {
            let n = x.round();
            let long = a.abs().max(b.abs());
            let short = a.abs().min(b.abs()).max(0.01 * long);
            let ramp = |t: f64| 0.5 * t.max(0.0).powi(2);
            let (l, s) = (0.5 * long, 0.5 * short);
            let d = x - n;
            let beyond =
                (ramp(d + l + s) - ramp(d + l - s) - ramp(d - l + s) + ramp(d - l - s)) / (long * short);
            let odd = is_odd(n);
            if odd { 1.0 - 2.0 * beyond } else { 2.0 * beyond - 1.0 }
        };
        // dark above left of corner 0
        let both = side(p.x, across.x, down.x) * side(p.y, across.y, down.y);
        Some(0.5 * (self.dark + self.light) + both * 0.5 * (self.dark - self.light))
    }

    /// Pixels: `fine x fine` samples each, blurred by a Gaussian of `blur` px, with noise.
    pub(crate) fn render(&self, fine: usize, blur: f64, noise: f64, random: &mut Random) -> Vec<u8> {
        let inverse = self.homography.try_inverse().unwrap();
        let (w, h) = (self.width * fine, self.height * fine);
        let mut samples = vec![0.0f32; w * h];
        let on_board: Option<Vec<Vector2<f64>>> =
            self.undistorted.as_ref().map(|all| all.iter().map(|q| mapped(&inverse, *q)).collect());
        for (i, s) in samples.iter_mut().enumerate() {
            if let Some(level) = on_board.as_ref().and_then(|all| self.covered(all, i, w)) {
                *s = level as f32;
                continue;
            }
            let at = |k: usize| (k as f64 + 0.5) / fine as f64 - 0.5;
            *s = self.at(&inverse, Vector2::new(at(i % w), at(i / w)), i) as f32;
        }
        // the Gaussian by samples of it, along rows and then along columns
        let reach = (3.5 * blur * fine as f64).ceil() as isize;
        let mut kernel: Vec<f32> = (-reach..=reach)
            .map(|k| (-0.5 * (k as f64 / fine as f64 / blur.max(1e-6)).powi(2)).exp() as f32)
            .collect();
        let sum: f32 = kernel.iter().sum();
        kernel.iter_mut().for_each(|k| *k /= sum);
        // pixels are sums of samples: both in one kernel
        let mut wide = vec![0.0f32; kernel.len() + fine - 1];
        for (i, k) in kernel.iter().enumerate() {
            for j in 0..fine {
                wide[i + j] += k / fine as f32;
            }
        }
        let clamp = |i: isize, n: usize| i.clamp(0, n as isize - 1) as usize;
        let mut rows = vec![0.0f32; self.width * h];
        for (row, sums) in samples.chunks(w).zip(rows.chunks_mut(self.width)) {
            // side by side, so that no sum waits for the one before it
            let line: Vec<f32> = (0..w + wide.len()).map(|i| row[clamp(i as isize - reach, w)]).collect();
            for (k, f) in wide.iter().enumerate() {
                for (sum, value) in sums.iter_mut().zip(line[k..].iter().step_by(fine)) {
                    *sum += f * value;
                }
            }
        }
        let mut sums = vec![0.0f32; self.width * self.height];
        for y in 0..self.height {
            let from = (y * fine) as isize - reach;
            for (k, f) in wide.iter().enumerate() {
                let row = &rows[clamp(from + k as isize, h) * self.width..][..self.width];
                for (s, r) in sums[y * self.width..][..self.width].iter_mut().zip(row) {
                    *s += f * r;
                }
            }
        }
        sums.iter()
            .map(|s| (f64::from(*s) + noise * random.normal()).round().clamp(0.0, 255.0) as u8)
            .collect()
    }
}
