use super::super::test_image::{TestImage, any_image};
use super::thin::{GradientRow, euclidean_body, euclidean_row, thin_body, thin_row};
use super::*;
use proptest::prelude::*;

/// Edges by the definition: planes, sectors by angles, flood fill.
fn slow(image: &TestImage, width: i64, height: i64, t: &EdgeThresholds) -> Vec<(u32, u32)> {
    let gradient = |x: i64, y: i64| {
        let at = |i, j| image.at(x + i, y + j);
        (
            at(1, -1) + 2 * at(1, 0) + at(1, 1) - at(-1, -1) - 2 * at(-1, 0) - at(-1, 1),
            at(-1, 1) + 2 * at(0, 1) + at(1, 1) - at(-1, -1) - 2 * at(0, -1) - at(1, -1),
        )
    };
    let magnitude = |x: i64, y: i64| {
        if x < 0 || y < 0 || x >= width || y >= height {
            return 0.0;
        }
        let (a, b) = gradient(x, y);
        match t.norm {
            Norm::Sum => (a.abs() + b.abs()) as f64,
            Norm::Euclidean => (32.0 * (a as f64).hypot(b as f64) as f32).round() as f64 / 32.0,
        }
    };
    let floor = |t: f32| if t.is_nan() { 0.0 } else { f64::from(t).max(0.0) };
    let mut kept = std::collections::BTreeMap::new();
    for y in 0..height {
        for x in 0..width {
            let (a, b) = gradient(x, y);
            let m = magnitude(x, y);
            if m <= floor(t.low) {
                continue;
            }
            let degrees = (b.abs() as f64).atan2(a.abs() as f64).to_degrees();
            let (i, j) = if degrees < 22.5 {
                (1, 0)
            } else if degrees > 67.5 {
                (0, 1)
            } else if (a < 0) == (b < 0) {
                (1, 1)
            } else {
                (-1, 1)
            };
            let (before, after) = (magnitude(x - i, y - j), magnitude(x + i, y + j));
            let diagonal = i != 0 && j != 0;
            if m > before && (m > after || !diagonal && m == after) {
                kept.insert((y, x), m > floor(t.high));
            }
        }
    }
    let mut edge = std::collections::BTreeSet::new();
    let mut open: Vec<(i64, i64)> = kept.iter().filter(|(_, strong)| **strong).map(|(&p, _)| p).collect();
    while let Some((y, x)) = open.pop() {
        if kept.contains_key(&(y, x)) && edge.insert((y, x)) {
            open.extend((-1..=1).flat_map(|j| (-1..=1).map(move |i| (y + j, x + i))));
        }
    }
    edge.into_iter().map(|(y, x)| (x as u32, y as u32)).collect()
}

proptest! {
    #[test]
    fn edges_are_those_of_the_definition(
        image in any_image(), before in any_image(), low in 0u16..600, more in 0u16..900, euclidean in any::<bool>(),
    ) {
        let norm = if euclidean { Norm::Euclidean } else { Norm::Sum };
        let thresholds = EdgeThresholds { low: f32::from(low), high: f32::from(low + more), norm };
        let mut edges = Edges::with_limit(100_000);
        edges.find(&before.view(), &thresholds);
        let view = image.view();
        edges.find(&view, &thresholds);
        let got: Vec<_> = edges.pixels().iter().map(|p| (p.column, p.row)).collect();
        prop_assert_eq!(&got, &slow(&image, view.width() as i64, view.height() as i64, &thresholds));
        // every neighbour is told, from both sides
        for (me, ((x, y), around)) in (0..).zip(got.iter().zip(edges.around())) {
            let mut told: Vec<u32> = around.indices(me).collect();
            told.sort_unstable();
            let beside = |(u, v): &(u32, u32)| u.abs_diff(*x) <= 1 && v.abs_diff(*y) <= 1 && (u, v) != (x, y);
            let wanted: Vec<u32> = (0..).zip(&got).filter(|(_, p)| beside(p)).map(|(i, _)| i).collect();
            prop_assert_eq!(told, wanted);
        }
        for p in edges.pixels() {
            prop_assert!((p.x_px - p.column as f32).abs() <= 1.0 && (p.y_px - p.row as f32).abs() <= 1.0);
        }
    }

    #[test]
    fn kernels_agree(
        m in prop::collection::vec(0u16..2041, 3 * 98), g in prop::collection::vec(-1020i16..=1020, 2 * 96), low in 0u16..2000,
    ) {
        let magnitude = [m[..98].to_vec(), m[98..196].to_vec(), m[196..].to_vec()];
        let gradient = GradientRow { dx: g[..96].to_vec(), dy: g[96..].to_vec() };
        let (mut a, mut b) = (Vec::new(), Vec::new());
        thin_row(&magnitude, &gradient, low, &mut a);
        thin_body(&magnitude, &gradient, low, &mut b);
        prop_assert_eq!(a, b);
        let (mut a, mut b) = (vec![0; 96], vec![0; 96]);
        euclidean_row(&gradient.dx, &gradient.dy, &mut a);
        euclidean_body(&gradient.dx, &gradient.dy, &mut b);
        prop_assert_eq!(a, b);
    }
}

#[test]
fn limits_are_kept_and_nonsense_is_taken() {
    let image = TestImage::new(100, 50, 0, 0, 3);
    let mut edges = Edges::with_limit(200);
    edges.find(&image.view(), &EdgeThresholds { low: 0.0, high: 0.0, norm: Norm::Sum });
    assert!(edges.overflowed() && edges.pixels().len() <= 200);
    edges.find(&image.view(), &EdgeThresholds { low: 2040.0, high: 2040.0, norm: Norm::Sum });
    assert!(!edges.overflowed() && edges.pixels().is_empty());
    for t in [f32::NAN, f32::INFINITY, -5.0, 1e30] {
        for norm in [Norm::Sum, Norm::Euclidean] {
            edges.find(&image.view(), &EdgeThresholds { low: t, high: t, norm });
        }
    }
    Edges::with_limit(0).find(&image.view(), &EdgeThresholds::default());
}

/// A soft edge at any angle and place is told to a few hundredths of a pixel.
#[test]
fn points_lie_on_the_edge() {
    let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    for k in 0..60 {
        let (sin, cos) = (0.1047 * f64::from(k) + 0.02).sin_cos();
        let offset = 0.37 * f64::from(k) % 1.0;
        let bytes: Vec<u8> = (0..64 * 64)
            .map(|i| {
                let d = (f64::from(i % 64) - 31.5) * cos + (f64::from(i / 64) - 31.5) * sin - offset;
                // a logistic step of about 0.9 px of blur
                (40.0 + 160.0 / (1.0 + (-1.9 * d).exp())).round() as u8
            })
            .collect();
        let mut edges = Edges::with_limit(5000);
        edges.find(&ImageView::new(&bytes, 64, 64).unwrap(), &EdgeThresholds::default());
        assert!(edges.pixels().len() > 50);
        for p in edges.pixels().iter().filter(|p| (3..61).contains(&p.column) && (3..61).contains(&p.row)) {
            let d = (f64::from(p.x_px) - 31.5) * cos + (f64::from(p.y_px) - 31.5) * sin - offset;
            worst = worst.max(d.abs());
            sum += d * d;
            count += 1.0;
        }
    }
    assert!(worst < 0.15 && (sum / count).sqrt() < 0.04, "{worst} {}", (sum / count).sqrt());
}
