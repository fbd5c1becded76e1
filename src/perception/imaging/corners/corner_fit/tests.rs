//! Against an independent rendering: squares sampled 8 x 8 to the pixel, blurred by a sampled Gaussian, summed to pixels.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // numbers for people

use super::*;

const SIZE: usize = 19;
/// Samples to a pixel and side.
const FINE: usize = 8;

struct XorShift(u64);

impl XorShift {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-12).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// One corner of a board: pixels without noise, truth, and what a finder would guess.
struct CornerSample {
    levels: Vec<f64>,
    truth: Vector2<f64>,
    steps: [Vector2<f64>; 2],
}

fn view(
    random: &mut XorShift,
    side: f64,
    skew: f64,
    blur: f64,
    low: f64,
    high: f64,
    light: f64,
) -> CornerSample {
    let turn = random.within(0.0, std::f64::consts::TAU);
    let open = std::f64::consts::FRAC_PI_2 + random.within(-skew, skew);
    let steps = [turn, turn + open].map(|a| Vector2::new(a.cos(), a.sin()) * side);
    let middle = (SIZE / 2) as f64;
    let truth = Vector2::new(middle + random.within(-0.5, 0.5), middle + random.within(-0.5, 0.5));
    let area = steps[0].x * steps[1].y - steps[0].y * steps[1].x;
    let next = [1, 0].map(|i: usize| (area / steps[i].norm()).abs());
    let (slant, direction) = (random.within(0.0, light), random.within(0.0, std::f64::consts::TAU));
    let border = 11;
    let n = SIZE * FINE + 2 * border * FINE;
    let sample = |i: usize| (i as f64 + 0.5) / FINE as f64 - 0.5 - border as f64;
    let mut fine = vec![0.0f32; n * n];
    for (i, value) in fine.iter_mut().enumerate() {
        let d = Vector2::new(sample(i % n), sample(i / n)) - truth;
        let u = (d.x * steps[1].y - d.y * steps[1].x) / area;
        let v = (steps[0].x * d.y - steps[0].y * d.x) / area;
        // a sample that an edge passes through has its share of both colours
        let wave = |t: f64, px: f64| {
            let nearest = t.round();
            let sign = if nearest.rem_euclid(2.0) < 0.5 { 1.0 } else { -1.0 };
            sign * ((t - nearest) * px * 2.0 * FINE as f64).clamp(-1.0, 1.0)
        };
        let share = 0.5 + 0.5 * wave(u, next[0]) * wave(v, next[1]);
        let level = low + (high - low) * share;
        *value = (level * (1.0 + slant * (d.x * direction.cos() + d.y * direction.sin()))) as f32;
    }
    // Gaussian along rows, then along columns, only where a pixel needs it; pixels are sums of samples
    let reach = (4.2 * blur * FINE as f64) as isize;
    let kernel: Vec<f32> = (-reach..=reach)
        .map(|k| {
            let x = k as f64 / FINE as f64 / blur;
            (-0.5 * x * x).exp() as f32
        })
        .collect();
    let total: f32 = kernel.iter().sum();
    // kernel of Gaussian and pixel together
    let mut wide = vec![0.0f32; kernel.len() + FINE - 1];
    for (i, k) in kernel.iter().enumerate() {
        for j in 0..FINE {
            wide[i + j] += k / total / FINE as f32;
        }
    }
    let mut rows = vec![0.0f32; SIZE * n];
    for y in 0..n {
        for x in 0..SIZE {
            let from = (border + x) * FINE - reach as usize;
            let part = &fine[y * n + from..][..wide.len()];
            rows[y * SIZE + x] = part.iter().zip(&wide).map(|(a, b)| a * b).sum();
        }
    }
    let mut levels = vec![0.0; SIZE * SIZE];
    for (i, level) in levels.iter_mut().enumerate() {
        let (x, y) = (i % SIZE, i / SIZE);
        let from = (border + y) * FINE - reach as usize;
        *level = wide.iter().enumerate().map(|(k, w)| f64::from(rows[(from + k) * SIZE + x] * w)).sum();
    }
    CornerSample { levels, truth, steps }
}

fn noisy(view: &CornerSample, noise: f64, random: &mut XorShift) -> Vec<u8> {
    view.levels.iter().map(|l| (l + noise * random.normal()).round().clamp(0.0, 255.0) as u8).collect()
}

/// Root mean square error of a coordinate, px, and normalized error squared of both; views that failed.
fn errors(
    side: f64,
    blur: f64,
    noise: f64,
    contrast: f64,
    views: usize,
    skew: f64,
    light: f64,
) -> (f64, f64, usize) {
    let mut random = XorShift((side * 1e3 + blur * 1e5 + noise * 1e7 + contrast * 1e9) as u64);
    let mut fitter = CornerFitter::default();
    let (mut squares, mut normalized, mut failed, mut n) = (0.0, 0.0, 0, 0);
    for _ in 0..views {
        let low = random.within(15.0, 240.0 - contrast);
        let view = view(&mut random, side, skew, blur, low, low + contrast, light);
        for _ in 0..8 {
            let pixels = noisy(&view, noise, &mut random);
            let image = ImageView::new(&pixels, SIZE, SIZE).unwrap();
            let off = Vector2::new(random.within(-0.4, 0.4), random.within(-0.4, 0.4));
            let guess = CornerGuess {
                px: view.truth + off,
                steps_px: view.steps,
                changes_px: [Vector2::zeros(); 2],
                blur_px: blur.hypot(0.29) * random.within(0.9, 1.1),
                blur_spread: 0.15,
                goes_on: [true; 4],
            };
            let Some(fit) = fitter.fit(&image, &guess, 1.5) else {
                failed += 1;
                continue;
            };
            let e = fit.px - view.truth;
            let [xx, xy, yy] = fit.covariance_px2;
            let q = (yy * e.x * e.x - 2.0 * xy * e.x * e.y + xx * e.y * e.y) / (xx * yy - xy * xy);
            squares += 0.5 * e.norm_squared();
            normalized += 0.5 * q;
            n += 1;
        }
    }
    ((squares / n as f64).sqrt(), normalized / n as f64, failed)
}

#[test]
fn errors_are_small_and_as_stated() {
    let mut wrong = Vec::new();
    for blur in [0.5, 1.0, 1.7, 2.5] {
        for side in [6.0, 8.0, 14.0, 60.0] {
            for (noise, contrast) in
                [(1.0, 200.0), (2.0, 160.0), (4.0, 120.0), (6.0, 80.0), (2.0, 40.0), (6.0, 40.0)]
            {
                let (rms, normalized, failed) = errors(side, blur, noise, contrast, 25, 0.3, 0.004);
                let line = format!(
                    "blur {blur} side {side} noise {noise} contrast {contrast}: rms {rms:.4} px, normalized {normalized:.2}, failed {failed}"
                );
                // where next to nothing is left of the pattern, corners may be refused
                let poor = rms > 0.15;
                let low = if poor { 0.3 } else { 0.8 };
                if !(low..1.25).contains(&normalized) || (failed > 4 && !poor) {
                    wrong.push(line);
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}: {wrong:#?}", wrong.len());
}

#[test]
fn kernels_agree() {
    let mut random = XorShift(77);
    for side in [6.0, 11.0, 40.0] {
        for _ in 0..20 {
            let view = view(&mut random, side, 0.4, 1.1, 40.0, 190.0, 0.01);
            let pixels = noisy(&view, 5.0, &mut random);
            let image = ImageView::new(&pixels, SIZE, SIZE).unwrap();
            let guess = CornerGuess {
                px: view.truth + Vector2::new(0.3, -0.2),
                steps_px: view.steps,
                changes_px: [Vector2::new(0.05, 0.02); 2],
                blur_px: 1.0,
                blur_spread: 0.5,
                goes_on: [true, side > 7.0, true, true],
            };
            let mut fitter = CornerFitter::default();
            let best = fitter.fit(&image, &guess, 1.5);
            fitter.wide = false;
            assert_eq!(best, fitter.fit(&image, &guess, 1.5));
            assert!(best.is_some());
        }
    }
}

#[test]
fn what_is_no_corner_is_refused() {
    let mut random = XorShift(5);
    let mut fitter = CornerFitter::default();
    let guess = |x: f64, y: f64, a: [f64; 2], b: [f64; 2]| CornerGuess {
        px: Vector2::new(x, y),
        steps_px: [a.into(), b.into()],
        changes_px: [Vector2::zeros(); 2],
        blur_px: 1.0,
        blur_spread: 0.5,
        goes_on: [true; 4],
    };
    let (a, b) = ([9.0, 0.0], [0.0, 9.0]);
    for kind in 0..4 {
        let pixels: Vec<u8> = (0..SIZE * SIZE)
            .map(|i| match kind {
                0 => 0,
                1 => 255,
                2 => (random.unit() * 256.0) as u8,
                _ => u8::from(i % SIZE > 9) * 200,
            })
            .collect();
        let image = ImageView::new(&pixels, SIZE, SIZE).unwrap();
        for (x, y, a, b) in [
            (9.0, 9.0, a, b),
            (0.0, 9.0, a, b),
            (-5.0, 1e9, a, b),
            (f64::NAN, 9.0, a, b),
            (9.0, 9.0, a, a),
            (9.0, 9.0, [f64::NAN; 2], b),
            (9.0, 9.0, [f64::INFINITY, 0.0], b),
            (9.0, 9.0, [0.1, 0.0], b),
        ] {
            let fit = fitter.fit(&image, &guess(x, y, a, b), 1.5);
            // noise may look like anything; a corner in it says how little it knows
            assert!(fit.is_none_or(|f| f.half_contrast.abs() < 1.0 || kind >= 2), "{kind} {fit:?}");
            assert!(kind >= 2 || fit.is_none_or(|f| f.covariance_px2[0] > 1.0), "{kind} {fit:?}");
        }
    }
}
