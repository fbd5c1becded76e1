use super::super::camera::BoardPoint;
use super::*;
use nalgebra::{Matrix2, Point3};

/// Subsamples of a pixel along each side.
const FINE: i32 = 8;
const SIZE: [usize; 2] = [260, 200];

/// Weight of a blur at a place, px.
type Kernel = fn(f64, f64) -> f64;

/// A board of 7x5 corners, turned and seen obliquely: each pixel the sum of subsamples under its box and the blur, then bent by the response.
fn view(turn: f64, kernel: Kernel, response: Response, seed: u64) -> (Vec<u8>, BoardView) {
    let (sin, cos) = turn.sin_cos();
    // board to image: squares of about 26 px, an eighth smaller at one end
    let place = |u: f64, v: f64| {
        let (x, y) = (26.0 * (cos * (u - 3.0) - sin * (v - 2.0)), 26.0 * (sin * (u - 3.0) + cos * (v - 2.0)));
        let w = 1.0 + 1e-3 * x;
        Vector2::new(129.3 + x / w, 99.6 + y / w)
    };
    let light = |px: f64, py: f64| {
        let (a, b) = (px - 129.3, py - 99.6);
        let w = 1.0 / (1.0 - 1e-3 * a);
        let (x, y) = (a * w / 26.0, b * w / 26.0);
        let (u, v) = (cos * x + sin * y + 3.0, cos * y - sin * x + 2.0);
        let dark = (u.floor() + v.floor()).rem_euclid(2.0) == 0.0;
        if dark && (-1.0..7.0).contains(&u) && (-1.0..5.0).contains(&v) { 0.04 } else { 0.6 }
    };
    // the blur and the box together, on the grid of subsamples
    let step = 1.0 / f64::from(FINE);
    let reach = 2 * FINE;
    let mut weights = Vec::new();
    for (j, i) in (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (j, i))) {
        let half = 0.5 * step * f64::from(FINE - 1);
        let boxed = (0..FINE * FINE).map(|k| {
            let (x, y) = (f64::from(k % FINE) * step - half, f64::from(k / FINE) * step - half);
            kernel(f64::from(i) * step - x, f64::from(j) * step - y)
        });
        let weight: f64 = boxed.sum();
        if weight > 0.0 {
            weights.push((i + reach, j + reach, weight));
        }
    }
    let [width, height] = SIZE.map(|size| size as i32 * FINE + 2 * reach);
    let at = |i: i32| f64::from(i - reach) * step;
    let lights: Vec<f64> =
        (0..height).flat_map(|j| (0..width).map(move |i| (i, j))).map(|(i, j)| light(at(i), at(j))).collect();
    let all: f64 = weights.iter().map(|w| w.2).sum();
    let mut state = seed;
    let mut noise = || {
        // a sum of twelve is as good as normal
        let sum: f64 = (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            })
            .sum();
        sum - 6.0
    };
    let mut pixels = Vec::new();
    for (y, x) in (0..SIZE[1] as i32).flat_map(|y| (0..SIZE[0] as i32).map(move |x| (y, x))) {
        let light = |dx: i32, dy: i32| lights[((y * FINE + dy) * width + x * FINE + dx) as usize];
        let sum: f64 = weights.iter().map(|(dx, dy, weight)| weight * light(*dx, *dy)).sum();
        pixels.push((255.0 * response.level(sum / all) + noise()).round().clamp(0.0, 255.0) as u8);
    }
    let corner = |id: u32| BoardPoint {
        id,
        p_O: Point3::origin(),
        px: place(f64::from(id % 7), f64::from(id / 7)),
        covariance_px2: Matrix2::identity(),
    };
    (pixels, (0..35).map(corner).collect())
}

fn estimate(kernel: Kernel, response: Response) -> GammaEstimate {
    let mut evidence = ResponseEvidence::default();
    for (seed, turn) in (1..).zip([0.0, 0.2, 0.5]) {
        let (pixels, board) = view(turn, kernel, response, seed);
        evidence.add(&ImageView::new(&pixels, SIZE[0], SIZE[1]).unwrap(), &board, 7);
    }
    evidence.gamma().unwrap()
}

fn sharp(x: f64, y: f64) -> f64 {
    (-0.5 * (x * x + y * y) / (0.4 * 0.4)).exp()
}

fn disc(x: f64, y: f64) -> f64 {
    f64::from(u8::from(x.hypot(y) < 1.3))
}

fn motion(x: f64, y: f64) -> f64 {
    f64::from(u8::from(x.abs() < 0.8 && y.abs() < 0.8))
}

#[test]
fn linear_levels_tell_no_response_whatever_the_blur() {
    for (name, kernel) in [("sharp", sharp as Kernel), ("disc", disc), ("motion", motion)] {
        let found = estimate(kernel, Response::Linear);
        assert_eq!(found.response(), None, "{name}: {found:?}");
        assert!((found.gamma - 1.0).abs() < 3.0 * found.sd && found.is_linear(), "{name}: {found:?}");
    }
}

#[test]
fn bent_levels_tell_their_gamma_whatever_the_blur() {
    for (name, kernel) in [("disc", disc as Kernel), ("motion", motion)] {
        for gamma in [1.8, 2.2] {
            let found = estimate(kernel, Response::Gamma(gamma));
            assert!(found.response().is_some() && !found.is_linear(), "{name} {gamma}: {found:?}");
            assert!((found.gamma - gamma).abs() < 3.0 * found.sd, "{name} {gamma}: {found:?}");
        }
    }
}

#[test]
fn gammas_that_no_camera_has_are_not_told() {
    let good = GammaEstimate { gamma: 2.2, sd: 0.07, support: 1.5 };
    assert_eq!(good.response(), Some(Response::Gamma(2.2)));
    for bad in [
        GammaEstimate { gamma: 0.4, ..good },
        GammaEstimate { gamma: 4.8, ..good },
        GammaEstimate { sd: 0.5, ..good },
        GammaEstimate { support: 0.3, ..good },
    ] {
        assert!(bad.response().is_none() && !bad.is_linear(), "{bad:?}");
    }
}
