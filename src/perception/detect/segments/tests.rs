#![allow(clippy::print_stdout)] // numbers for people

use super::*;
use crate::imaging::test_image::{SyntheticImage, any_image};
use crate::linalg::Random;
use proptest::prelude::*;

fn image(blur_px: f64) -> SyntheticImage {
    SyntheticImage { width: 90, height: 90, dark: 40.0, light: 200.0, blur_px, noise_levels: 2.0 }
}

/// Edges of 50 px at all angles and places: offset and angle against the truth, within what is stated.
#[test]
fn lines_and_their_covariance_on_rendered_edges() {
    let mut random = Random::new(2);
    for blur_px in [0.0, 0.5, 0.9] {
        let (mut squares, mut offset, mut turn, mut lost) = (0.0, 0.0, 0.0, 0);
        let trials = 340;
        for k in 0..trials {
            let angle = random.between(-3.1, 3.1);
            let (n, t) = (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
            let middle = Vector2::new(44.5 + random.uniform(), 44.5 + random.uniform());
            // lit on the right of the way along -t; 50 px long, a corner of a square at either end
            let bytes = image(blur_px).render(&mut random, |x, y| {
                let d = Vector2::new(x, y) - middle;
                let (u, v) = (n.dot(&d), t.dot(&d).abs());
                u.min(25.0 - v).min(30.0 - u)
            });
            let view = ImageView::new(&bytes, 90, 90).unwrap();
            let mut finder = SegmentFinder::new(90, 90, SegmentSettings::default());
            let wrong = Vector2::new(random.between(-2.0, 2.0), random.between(-2.0, 2.0));
            let ends = [middle + t * 25.0 + wrong, middle - t * 25.0 - wrong * 0.3];
            let segment = if k % 2 == 0 {
                finder.track(&view, &Segment::expected(ends).unwrap(), 4.0).ok()
            } else {
                let mut found = Vec::new();
                let _ = finder.search(&view, &mut found);
                found.into_iter().find(|s| s.line.normal().dot(&n) > 0.99)
            };
            let Some(s) = segment else {
                lost += 1;
                continue;
            };
            for (end, wanted) in s.ends_px.iter().zip([middle + t * 25.0, middle - t * 25.0]) {
                assert!((end - wanted).norm() < 2.0, "{k} {blur_px}: {end} {wanted}");
            }
            let along = Vector2::new(-s.line.normal_rad.sin(), s.line.normal_rad.cos());
            let e = s.line.distance_px(&middle);
            squares += e * e;
            offset += (e / s.line.sd_px(along.dot(&(middle - s.line.px)))).powi(2);
            let a = (s.line.normal_rad - angle).sin();
            turn += a * a / s.line.covariance[(1, 1)];
        }
        let n = f64::from(trials - lost);
        let (rms, offset, turn) = ((squares / n).sqrt(), offset / n, turn / n);
        assert!(lost <= 2 && rms < 0.01, "{lost} {rms}");
        assert!((0.8..1.25).contains(&offset) && (0.75..1.3).contains(&turn), "{offset} {turn}");
    }
}

#[test]
fn a_square_has_four_sides_and_misses_have_reasons() {
    let mut random = Random::new(7);
    let bytes = image(0.5).render(&mut random, |x, y| {
        let (u, v) = ((x - 45.0) * 0.96 + (y - 44.0) * 0.28, (y - 44.0) * 0.96 - (x - 45.0) * 0.28);
        25.0 - u.abs().max(v.abs())
    });
    let view = ImageView::new(&bytes, 90, 90).unwrap();
    let mut finder = SegmentFinder::new(90, 90, SegmentSettings::default());
    let mut found = Vec::new();
    finder.search(&view, &mut found).unwrap();
    assert_eq!(found.len(), 4, "{found:?}");
    for s in &found {
        assert!((s.length_px() - 50.0).abs() < 2.0 && s.share > 0.9 && (s.step_levels - 160.0).abs() < 4.0);
        assert!((1.3..3.0).contains(&s.noise_levels), "{}", s.noise_levels);
        assert!((s.midpoint_px() - Vector2::new(45.0, 44.0)).dot(&s.line.normal()) < 0.0);
    }
    let blank = vec![90; 90 * 90];
    let view = ImageView::new(&blank, 90, 90).unwrap();
    assert_eq!(finder.search(&view, &mut found), Err(SegmentMiss::NoEdges));
    let somewhere = |x: f64| Segment::expected([Vector2::new(x, 10.0), Vector2::new(x + 5.0, 70.0)]).unwrap();
    assert_eq!(finder.track(&view, &somewhere(30.0), 4.0), Err(SegmentMiss::Lost));
    assert_eq!(finder.track(&view, &somewhere(300.0), 4.0), Err(SegmentMiss::Outside));
    let noise: Vec<u8> = (0..300 * 300).map(|_| random.bits() as u8).collect();
    let view = ImageView::new(&noise, 300, 300).unwrap();
    assert_eq!(finder.search(&view, &mut found), Err(SegmentMiss::TooManyEdges));
    let same = Vector2::new(3.0, 3.0);
    assert!(
        Segment::expected([same, same]).is_none() && Segment::expected([same, same * f64::NAN]).is_none()
    );
}

proptest! {
    #[test]
    fn any_image_is_taken(image in any_image(), ends in prop::array::uniform4(-50.0..250.0f64), slack in -1.0..99.0f64) {
        let settings = SegmentSettings { min_length_px: 0.0, ..SegmentSettings::default() };
        let mut finder = SegmentFinder::new(20, 20, settings);
        let mut found = Vec::new();
        let _ = finder.search(&image.view(), &mut found);
        for s in &found {
            prop_assert!(s.ends_px.iter().all(|p| p.norm().is_finite()));
        }
        let [a, b, c, d] = ends;
        if let Some(s) = Segment::expected([Vector2::new(a, b), Vector2::new(c, d)]) {
            let _ = finder.track(&image.view(), &s, slack);
        }
    }
}
