use super::super::canvas::{Width, overlap};
use super::super::{figure, figure_svg};
use super::draw::{equal, thinned};
use super::*;
use proptest::prelude::*;

#[test]
fn equal_scales_are_equal() {
    let (x, y) = equal(Axis::linear(0.0, 1.0), Axis::linear(0.0, 3.0), (400.0, 200.0));
    let length = |axis: Axis| axis.ends().1 - axis.ends().0;
    assert!((length(x) / 400.0 - length(y) / 200.0).abs() < 1e-12 && (length(y) - 3.0).abs() < 1e-12);
}

#[test]
fn thinning_keeps_every_peak() {
    let mut points: Vec<[f64; 2]> = (0..50_000).map(|i| [f64::from(i) * 0.01, 5.0]).collect();
    points[12_345][1] = -7.0;
    let kept = thinned(&points);
    assert!(kept.len() < 2100 && kept.contains(&points[12_345]), "{}", kept.len());
    assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
    let circle: Vec<[f64; 2]> =
        (0..1000).map(|i| f64::from(i) * 0.00628).map(|a| [9.0 * a.cos(), 9.0 * a.sin()]).collect();
    let kept = thinned(&circle);
    assert!(kept.len() < 160 && kept.last() == circle.last());
}

#[test]
fn two_decades_want_a_logarithm() {
    assert!(spans_decades([0.01, 1.5].into_iter()) && !spans_decades([0.02, 1.5].into_iter()));
    assert!(!spans_decades([0.0, 1.5].into_iter()), "there is no place for zero");
    assert!(!spans_decades(std::iter::empty()));
}

fn panels(values: &[(f64, f64)], log: bool) -> Vec<Panel> {
    let time = Panel::new("a title that is longer than the panel is wide, perhaps", "t, s", "speed, rad/s")
        .with(Series::line(0, values.iter().copied()).label("measured"))
        .with(Series::new(Symbol::Dashed, 1, values.iter().map(|(x, y)| (*x, -y))).label("commanded"))
        .with(Series::new(Symbol::Limit, 0, [(0.0, 1.0), (9.0, 1.0)]).label("limit"));
    let time = if log { time.log_y() } else { time };
    let paths = Panel::new("paths", "u, px", "v, px, down")
        .equal_scales()
        .y_down()
        .with(Series::new(Symbol::Cross, 2, values.iter().copied()).label("start"))
        .with(Series::new(Symbol::Circle, 9, values.iter().copied()));
    vec![time, paths, Panel::new("nothing", "X", "Y")]
}

proptest! {
    #[test]
    fn no_letters_overlap_and_no_number_is_none(
        values in prop::collection::vec((-1e7..1e7f64, -1e7..1e7f64), 0..40), small in -12..4i32, log in any::<bool>()
    ) {
        let scaled: Vec<_> = values.iter().map(|(x, y)| (*x, y * 10f64.powi(small))).collect();
        for width in Width::ALL {
            let (canvas, height) = figure(&panels(&scaled, log), 2, width);
            let texts = canvas.texts();
            for (i, a) in texts.iter().enumerate() {
                prop_assert!(a[0] >= -1.0 && a[2] <= width.units() + 1.0, "cut off: {a:?} in {width:?}");
                prop_assert!(a[1] >= -1.0 && a[3] <= height + 1.0, "cut off: {a:?} of {height}");
                // A hundredth of a unit is rounding, which nobody sees.
                let inner = [a[0] + 0.01, a[1] + 0.01, a[2] - 0.01, a[3] - 0.01];
                for b in &texts[i + 1..] {
                    prop_assert!(!overlap(&inner, b), "{a:?} {b:?} in {width:?}");
                }
            }
        }
        let svg = figure_svg(&panels(&scaled, log), 2, Width::Narrow, "f");
        prop_assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{svg}");
    }
}
