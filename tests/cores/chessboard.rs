//! Chessboards: in photographs against OpenCV, in sampled views against truth, under covers, clutter and lenses never a wrong label.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::render::{Random, Thing, View};
use nalgebra::Vector2;
use std::path::Path;
use vservo::detect::chessboard::{ChessboardFinder, ChessboardMiss};
use vservo::detect::{Detection, PredictedPoint};
use vservo::imaging::ImageView;

const REFERENCE: &str = include_str!("../fixtures/opencv_chessboard_corners.csv");

fn reference(name: &str) -> Vec<Vector2<f64>> {
    let lines = REFERENCE.lines().filter(|l| l.split(',').next() == Some(name));
    let number = |s: Option<&str>| s.unwrap().parse::<f64>().unwrap();
    lines
        .map(|l| (number(l.split(',').nth(2)), number(l.split(',').nth(3))))
        .map(|(x, y)| Vector2::new(x, y))
        .collect()
}

fn photographs() -> Vec<(String, image::GrayImage)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/opencv-stereo-chessboard");
    let names = ["left", "right"].into_iter().flat_map(|side| (1..=9).map(move |n| format!("{side}{n:02}")));
    names
        .filter_map(|name| {
            let image = image::open(folder.join(format!("{name}.jpg"))).ok()?;
            Some((name, image.to_luma8()))
        })
        .collect()
}

fn search(finder: &mut ChessboardFinder, image: &image::GrayImage) -> Result<Vec<Detection>, ChessboardMiss> {
    let view = ImageView::new(image.as_raw(), image.width() as usize, image.height() as usize).unwrap();
    let mut found = Vec::new();
    finder.search_or_why(&view, &mut found).map(|()| found)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn photographs_as_opencv_has_them() {
    let photographs = photographs();
    if photographs.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    assert_eq!(photographs.len(), 18);
    let mut finder = ChessboardFinder::new(9, 6, 640, 480);
    let mut off = Vec::new();
    for (name, image) in &photographs {
        let found = search(&mut finder, image).unwrap_or_else(|miss| panic!("{name}: {miss}"));
        assert_eq!(found.len(), 54, "{name}");
        let reference = reference(name);
        off.extend(found.iter().map(|f| (f.px - reference[f.id as usize]).norm()));
    }
    let most = off.iter().fold(0.0f64, |a, b| a.max(*b));
    let middle = median(off);
    println!("median {middle:.3} px, at most {most:.3} px from OpenCV");
    assert!(middle < 0.1 && most < 0.5);
}

/// With a quarter of the image covered: right labels or a refusal, and mostly found.
#[test]
fn photographs_with_a_quarter_covered() {
    let photographs = photographs();
    if photographs.is_empty() {
        println!("skipped: no ../shared");
        return;
    }
    let mut finder = ChessboardFinder::new(9, 6, 640, 480);
    let (mut views, mut found_in, mut corners, mut visible) = (0, 0, 0, 0);
    for (name, image) in &photographs {
        let reference = reference(name);
        for (quarter, level) in (0..4).flat_map(|q| [0u8, 128, 255].map(|l| (q, l))) {
            let mut covered = image.clone();
            let (x0, y0) = (quarter % 2 * 320, quarter / 2 * 240);
            let hidden = |x: f64, y: f64, by: f64| {
                x > f64::from(x0) - by
                    && y > f64::from(y0) - by
                    && x < f64::from(x0 + 320) + by
                    && y < f64::from(y0 + 240) + by
            };
            for y in y0..y0 + 240 {
                for x in x0..x0 + 320 {
                    covered.put_pixel(x, y, image::Luma([level]));
                }
            }
            views += 1;
            let Ok(found) = search(&mut finder, &covered) else {
                println!("{name} without quarter {quarter}, level {level}: refused");
                continue;
            };
            found_in += 1;
            corners += found.len();
            visible += reference.iter().filter(|p| !hidden(p.x, p.y, 5.0)).count();
            for f in &found {
                let p = reference[f.id as usize];
                let off = (f.px - p).norm();
                assert!(
                    off < if hidden(p.x, p.y, 9.0) { 2.0 } else { 0.5 },
                    "{name} {quarter} {level}: {f:?} {p}"
                );
            }
        }
    }
    println!("found in {found_in} of {views}, {corners} of {visible} corners");
    assert!(found_in * 10 > views * 9 && corners * 100 > visible * 97);
}

/// The greatest distance between what was found and the truth, px; modulo the symmetry that colours leave.
fn worst(view: &View, found: &[Detection]) -> f64 {
    let (c, r) = (view.columns, view.rows);
    let off = |turn: usize| {
        let at = |f: &Detection| {
            let (x, y) = (f.id as usize % c, f.id as usize / c);
            match turn {
                0 => (x, y),
                1 => (y, c - 1 - x),
                2 => (c - 1 - x, r - 1 - y),
                _ => (r - 1 - y, x),
            }
        };
        found.iter().map(|f| (view.corner(at(f).0, at(f).1) - f.px).norm()).fold(0.0, f64::max)
    };
    let turns: &[usize] = match (c == r && c % 2 == 0, (c + r) % 2) {
        (true, _) => &[0, 1, 2, 3],
        (false, 0) => &[0, 2],
        _ => &[0],
    };
    turns.iter().map(|t| off(*t)).fold(f64::INFINITY, f64::min)
}

fn random_view(random: &mut Random) -> View {
    let sizes = [(9, 6), (9, 6), (8, 6), (7, 7), (6, 6), (11, 8), (5, 4)];
    let (columns, rows) = sizes[random.below(sizes.len())];
    let size = [360, 270];
    let side = random.within(9.0, 36.0).min(1.15 * 300.0 / columns as f64);
    let (turn, tilt, to) = (random.within(0.0, 6.3), random.within(0.0, 1.0), random.within(0.0, 6.3));
    let mut view = View::new(columns, rows, size, turn, tilt, to, side);
    view = view.shifted(random.within(-60.0, 60.0), random.within(-45.0, 45.0));
    view.margin = random.within(0.15, 1.2);
    let contrast = random.within(60.0, 190.0);
    view.dark = random.within(10.0, 200.0 - contrast);
    view.light = view.dark + contrast;
    view.k = random.within(-0.15, 0.1);
    view.background = random.within(5.0, 220.0);
    view.slope = Vector2::new(random.within(-0.2, 0.2), random.within(-0.2, 0.2));
    view
}

/// Thousands of views (`VSERVO_CAMPAIGN` sets how many) with covers, clutter and lenses: no corner under a wrong label.
#[test]
fn no_wrong_label() {
    let views: u64 = std::env::var("VSERVO_CAMPAIGN").ok().and_then(|v| v.parse().ok()).unwrap_or(50);
    let first: u64 = std::env::var("VSERVO_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    let (mut clear, mut clear_found, mut part, mut part_found) = (0, 0, 0, 0);
    let mut wrong = Vec::new();
    for seed in first..first + views {
        let mut random = Random(seed * 1000 + 7);
        let mut view = random_view(&mut random);
        let (w, h) = (view.width as f64, view.height as f64);
        for _ in 0..random.below(12) {
            view.behind.push(Thing::random(&mut random, w, h, 60.0));
        }
        let covers = random.below(4);
        for _ in 0..covers {
            view.before.push(Thing::random(&mut random, w, h, 70.0));
        }
        let blur = random.within(0.4, 1.4);
        let noise = random.within(0.5, 4.0);
        let pixels = view.render(3, blur, noise, &mut random);
        let image = ImageView::new(&pixels, view.width, view.height).unwrap();
        let mut finder = ChessboardFinder::new(view.columns, view.rows, view.width, view.height);
        let mut found = Vec::new();
        let result = finder.search_or_why(&image, &mut found);
        let worst = worst(&view, &found);
        if worst > 3.0 {
            wrong.push(format!(
                "seed {seed}: {}x{} {} corners, {worst:.1} px",
                view.columns,
                view.rows,
                found.len()
            ));
        }
        let inside = |c: usize, r: usize| {
            let p = view.corner(c, r);
            p.x > 8.0 && p.y > 8.0 && p.x < w - 9.0 && p.y < h - 9.0
        };
        let all = (0..view.columns).all(|c| (0..view.rows).all(|r| inside(c, r)));
        if all && covers == 0 {
            clear += 1;
            clear_found += u32::from(result.is_ok());
            if let Err(miss) = result {
                println!("seed {seed}: {}x{} {miss}", view.columns, view.rows);
            }
        } else {
            part += 1;
            part_found += u32::from(result.is_ok());
        }
    }
    println!("{clear_found} of {clear} whole boards, {part_found} of {part} parts; {} wrong", wrong.len());
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(clear_found * 100 >= clear * 90, "{clear_found} of {clear}");
}

/// Contrast 160, noise 2: at most 0.025 px at a blur of 1 px, at most 0.05 px on squares of 8 px; errors as large as stated.
#[test]
fn corners_are_accurate() {
    for (side, blur, goal_px) in [(24.0, 1.0, 0.025), (14.0, 1.0, 0.025), (8.0, 0.7, 0.05), (8.0, 1.0, 0.05)]
    {
        let mut random = Random((side * 100.0 + blur) as u64);
        let (mut squares, mut normalized, mut n) = (0.0, 0.0, 0.0);
        for _ in 0..4 {
            let (turn, to) = (random.within(0.0, 6.3), random.within(0.0, 6.3));
            let size = [(side * 13.0) as usize + 30, (side * 13.0) as usize + 30];
            let mut view = View::new(9, 6, size, turn, 0.35, to, side);
            view = view.shifted(random.within(-0.5, 0.5), random.within(-0.5, 0.5));
            let pixels = view.render(10, blur, 2.0, &mut random);
            let image = ImageView::new(&pixels, view.width, view.height).unwrap();
            let mut finder = ChessboardFinder::new(9, 6, view.width, view.height);
            let mut found = Vec::new();
            finder.search_or_why(&image, &mut found).unwrap();
            assert_eq!(found.len(), 54);
            for (f, (id, [xx, xy, yy])) in found.iter().zip(finder.covariances_px2()) {
                assert_eq!(f.id, id);
                let e = f.px - view.corner(id as usize % 9, id as usize / 9);
                squares += 0.5 * e.norm_squared();
                normalized +=
                    0.5 * (yy * e.x * e.x - 2.0 * xy * e.x * e.y + xx * e.y * e.y) / (xx * yy - xy * xy);
                n += 1.0;
            }
        }
        let (rms, normalized) = ((squares / n).sqrt(), normalized / n);
        println!("squares {side} px, blur {blur} px: rms {rms:.4} px, normalized {normalized:.2}");
        assert!(rms < goal_px && normalized < 1.35, "{side} {blur}: {rms} {normalized}");
    }
}

#[test]
fn a_part_without_border_is_refused() {
    let mut random = Random(3);
    // more squares than the image shows
    let view = View::new(20, 16, [360, 270], 0.3, 0.2, 1.0, 30.0);
    let pixels = view.render(3, 0.7, 2.0, &mut random);
    let image = ImageView::new(&pixels, 360, 270).unwrap();
    let mut found = Vec::new();
    let mut large = ChessboardFinder::new(20, 16, 360, 270);
    assert_eq!(large.search_or_why(&image, &mut found), Err(ChessboardMiss::NoBorder));
    assert!(found.is_empty());
    let mut small = ChessboardFinder::new(5, 4, 360, 270);
    assert_eq!(small.search_or_why(&image, &mut found), Err(ChessboardMiss::TooLarge));
    let mut other = ChessboardFinder::new(5, 4, 361, 270);
    assert_eq!(other.search_or_why(&image, &mut found), Err(ChessboardMiss::WrongSize));
}

/// A floor of squares, seen from anywhere, with so many things on it; where a board of one of these sizes is found in it, how many corners.
fn boards_in_a_floor(
    random: &mut Random,
    (low, high): (usize, usize),
    sizes: &[(usize, usize)],
) -> Vec<(usize, usize, usize)> {
    let (turn, tilt, to) = (random.within(0.0, 6.3), random.within(0.0, 1.2), random.within(0.0, 6.3));
    let mut view = View::new(61, 60, [360, 270], turn, tilt, to, random.within(14.0, 52.0));
    view.k = random.within(-0.15, 0.1);
    view.slope = Vector2::new(random.within(-0.2, 0.2), random.within(-0.2, 0.2));
    for _ in 0..low + random.below(high - low) {
        view.before.push(Thing::random(random, 360.0, 270.0, 90.0));
    }
    let (blur, noise) = (random.within(0.4, 1.4), random.within(0.5, 4.0));
    let pixels = view.render(3, blur, noise, random);
    let image = ImageView::new(&pixels, 360, 270).unwrap();
    let mut found = Vec::new();
    let count = |&(columns, rows): &(usize, usize)| {
        let mut finder = ChessboardFinder::new(columns, rows, 360, 270);
        finder.search_or_why(&image, &mut found).is_ok().then_some((columns, rows, found.len()))
    };
    sizes.iter().filter_map(count).collect()
}

/// None of their parts is a board.
#[test]
fn a_floor_is_no_board() {
    let views: u64 = std::env::var("VSERVO_CAMPAIGN").ok().and_then(|v| v.parse().ok()).unwrap_or(50);
    let first: u64 = std::env::var("VSERVO_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    let found = |seed| boards_in_a_floor(&mut Random(seed * 1000 + 19), (0, 9), &[(7, 5), (6, 4)]);
    let found: Vec<_> =
        (first..first + views).map(|k| (k, found(k))).filter(|(_, f)| !f.is_empty()).collect();
    assert!(found.is_empty(), "{} of {views} floors: {found:?}", found.len());
}

/// Nor are the pieces that three to sixteen things leave of them: of such floors two of these 80, and 7 of 70 others, were boards of one of these sizes.
#[test]
fn pieces_of_a_floor_are_no_board() {
    let views: u64 = std::env::var("VSERVO_CAMPAIGN").ok().and_then(|v| v.parse().ok()).unwrap_or(80);
    let first: u64 = std::env::var("VSERVO_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    let sizes = [(7, 5), (6, 4), (9, 6), (8, 5), (5, 4)];
    let found = |seed| boards_in_a_floor(&mut Random(seed * 7919 + 3), (3, 17), &sizes);
    let found: Vec<_> =
        (first..first + views).map(|k| (k, found(k))).filter(|(_, f)| !f.is_empty()).collect();
    assert!(found.is_empty(), "{} of {views} floors: {found:?}", found.len());
}

/// A hundred parts of boards: the search ends with a word before it has looked at all.
#[test]
fn too_many_parts_are_given_up() {
    let (width, height) = (900, 900);
    // three by three inner corners each, 24 px apart from the next
    let square = |x: usize, y: usize| {
        let (i, j) = ((x % 90) / 15, (y % 90) / 15);
        if i < 4 && j < 4 && (i + j) % 2 == 0 { 40 } else { 200 }
    };
    let pixels: Vec<u8> = (0..width * height).map(|i| square(i % width, i / width)).collect();
    let image = ImageView::new(&pixels, width, height).unwrap();
    let mut found = Vec::new();
    let mut finder = ChessboardFinder::new(7, 6, width, height);
    assert_eq!(finder.search_or_why(&image, &mut found), Err(ChessboardMiss::GivenUp));
    assert!(found.is_empty());
}

#[test]
fn a_moved_board_is_tracked() {
    let mut random = Random(8);
    let mut finder = ChessboardFinder::new(9, 6, 360, 270);
    let mut found = Vec::new();
    let views = [0.0, 6.0].map(|x| View::new(9, 6, [360, 270], 0.4, 0.4, 1.0, 24.0).shifted(x, 0.7 * x));
    let images = views.each_ref().map(|v| v.render(3, 0.8, 2.0, &mut random));
    let view = |i: usize| ImageView::new(&images[i], 360, 270).unwrap();
    finder.search_or_why(&view(0), &mut found).unwrap();
    let expected: Vec<PredictedPoint> = found
        .iter()
        .map(|f| PredictedPoint {
            id: f.id,
            px: f.px,
            covariance_px2: f.covariance_px2,
            area_px2: f.area_px2,
            slack_px: 9.0,
            threshold: 0,
        })
        .collect();
    assert!(finder.track(&view(1), &expected, &mut found));
    assert_eq!(found.len(), 54);
    assert!(worst(&views[1], &found) < 0.15, "{}", worst(&views[1], &found));
    // a third of the predictions alone; and none where a prediction may be off by a square
    assert!(finder.track(&view(1), &expected[9..27], &mut found));
    assert!(found.len() == 18 && worst(&views[1], &found) < 0.15);
    let blind: Vec<PredictedPoint> =
        expected.iter().map(|e| PredictedPoint { slack_px: 24.0, ..*e }).collect();
    assert!(!finder.track(&view(1), &blind, &mut found) && found.is_empty());
    // somewhere else
    let far: Vec<PredictedPoint> =
        expected.iter().map(|e| PredictedPoint { px: e.px * 30.0, ..*e }).collect();
    assert!(!finder.track(&view(1), &far, &mut found));
    let nan: Vec<PredictedPoint> =
        expected.iter().map(|e| PredictedPoint { px: e.px * f64::NAN, slack_px: f64::NAN, ..*e }).collect();
    assert!(!finder.track(&view(1), &nan, &mut found));
}

#[test]
fn bad_images_are_refused() {
    let mut random = Random(1);
    let mut found = Vec::new();
    for (w, h) in
        [(1, 1), (2, 900), (900, 2), (11, 11), (12, 40), (500, 13), (161, 97), (640, 480), (801, 603)]
    {
        for kind in 0..6 {
            let pixels: Vec<u8> = (0..w * h)
                .map(|i| match kind {
                    0 => 0,
                    1 => 255,
                    2 => (random.bits() >> 56) as u8,
                    3 => {
                        if random.bits() & 1 == 0 {
                            0
                        } else {
                            255
                        }
                    }
                    4 => {
                        if (i % w / 3 + i / w / 3) % 2 == 0 {
                            0
                        } else {
                            255
                        }
                    }
                    _ => {
                        if (i % w / 9 + i / w / 9) % 2 == 0 {
                            20
                        } else {
                            230
                        }
                    }
                })
                .collect();
            let image = ImageView::new(&pixels, w, h).unwrap();
            for (c, r) in [(9, 6), (2, 2), (60, 60), (0, 0), (3, 1000)] {
                let mut finder = ChessboardFinder::new(c, r, w, h);
                let result = finder.search(&image, &mut found);
                // the last pattern is a chessboard, and fits some of these
                assert!(kind == 5 || result.is_err(), "{w}x{h} {kind} {c}x{r}: {} corners", found.len());
                let expected = [PredictedPoint {
                    id: 3,
                    px: Vector2::new(5.0, 5.0),
                    covariance_px2: [1.0, 0.0, 1.0],
                    area_px2: 3.0,
                    slack_px: 4.0,
                    threshold: 9,
                }; 7];
                finder.track(&image, &expected, &mut found);
            }
        }
    }
}
