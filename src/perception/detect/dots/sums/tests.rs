use super::*;
use proptest::prelude::*;

fn noise(seed: u64) -> Vec<u8> {
    let mut state = seed;
    let mut next = move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 56) as u8
    };
    (0..70 * 40).map(|_| next()).collect()
}

proptest! {
    /// Against the definition, pixel by pixel in floating point, at the border of the image too.
    #[test]
    fn sums_are_those_of_the_definition(
        x in -5.0..75.0f64, y in -5.0..45.0f64, a in 4.0..30.0f64, b in 4.0..30.0f64, r in -0.9..0.9f64,
        seed in any::<u64>(), edge in 1000i16..3600, span in 40i16..900, margin in 0i16..20, light in any::<bool>(),
        tilt in prop::array::uniform2(-0.004..0.004f64), bend in prop::array::uniform3(-2e-5..2e-5f64),
        hollow in any::<bool>(),
    ) {
        let pixels = noise(seed);
        let image = ImageView::new(&pixels, 70, 40).unwrap();
        let S = [a * a, r * a * b, b * b];
        let (outer, inner) = (PixelEllipse::new(x, y, S), PixelEllipse::new(x, y, S.map(|s| 0.3 * s)));
        let relative = [tilt[0], tilt[1], bend[0], bend[1], bend[2]];
        let scale = Scale { edge, span, margin, light, relative };
        let got = weighted_sums(&image, [&outer, &outer], hollow.then_some(&inner), &scale);
        prop_assert_eq!(weighted_sums_by_rows(&image, [&outer, &outer], hollow.then_some(&inner), &scale), got);
        let (mut w, mut wx, mut wy) = (0.0, 0.0, 0.0);
        let det = S[0] * S[2] - S[1] * S[1];
        for v in 0..40 {
            for u in 0..70 {
                let (dx, dy) = (f64::from(u) - x, f64::from(v) - y);
                let d = (S[2] * dx * dx - 2.0 * S[1] * dx * dy + S[0] * dy * dy) / det;
                prop_assume!((d - 1.0).abs() > 1e-9 && (d - 0.3).abs() > 1e-9);
                if d < 1.0 {
                    let lit = 1.0 + tilt[0] * dx + tilt[1] * dy + bend[0] * dx * dx + bend[1] * dx * dy + bend[2] * dy * dy;
                    let level = f64::from(pixels[(v * 70 + u) as usize]) * 16.0 * lit;
                    let away = if light { level - f64::from(edge) } else { f64::from(edge) - level };
                    let whole = hollow && d < 0.3;
                    let weight = if whole { f64::from(span) } else { away.clamp(0.0, f64::from(span)) };
                    w += weight;
                    wx += weight * (f64::from(u) - x.round());
                    wy += weight * (f64::from(v) - y.round());
                }
            }
        }
        // relative light is rounded to 1/4096, levels down to 1/16
        let close = |got: i64, wanted: f64, reach: f64| (got as f64 - wanted).abs() < 4.0 * a * b * 3.2 * reach + 1.0;
        prop_assert!(close(got.w, w, 1.0), "{} {}", got.w, w);
        prop_assert!(close(got.wx, wx, a), "{} {}", got.wx, wx);
        prop_assert!(close(got.wy, wy, b), "{} {}", got.wy, wy);
    }

    #[test]
    fn every_path_gives_the_same(
        seed in any::<u64>(), from in 0usize..2700, count in 0usize..100, edge in 0i16..4080, span in 1i16..4080, margin in 0i16..200,
        light in any::<bool>(), at in 0.6..1.6f64, slope in -0.002..0.002f64, bend in -1e-5..1e-5f64,
    ) {
        let pixels = noise(seed);
        let (row, scale) = (&pixels[from..], Scale { edge, span, margin, light, relative: [0.0; 5] });
        let fixed = |x: f64| (x * ONE) as i32;
        let light = RowLight { at: fixed(at), slope: fixed(slope), bend: fixed(bend) };
        let wanted = row_sums_portable(row, count, &scale, &light);
        prop_assert_eq!(row_sums(row, count, &scale, &light), wanted);
    }
}
