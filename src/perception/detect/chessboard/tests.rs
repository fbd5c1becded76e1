use super::*;
use nalgebra::{Matrix3, Vector3};

const SIZE: [usize; 2] = [640, 480];

/// A 9x6 board of unit squares at a pose, as an equidistant fisheye sees it: 4x4 subsamples of each pixel are traced back to the board.
fn fisheye(f_px: f64, R_CO: Matrix3<f64>, p_CO: Vector3<f64>, margin: f64) -> (Vec<u8>, Vec<Vector2<f64>>) {
    let centre = Vector2::new(319.5, 239.5);
    let middle = Vector2::new(4.0, 2.5);
    let normal = R_CO.column(2).into_owned();
    let level = |px: Vector2<f64>| {
        let r = px - centre;
        let angle = r.norm() / f_px;
        let side = if angle > 1e-9 { r * (angle.sin() / r.norm()) } else { Vector2::zeros() };
        let ray = Vector3::new(side.x, side.y, angle.cos());
        let depth = normal.dot(&p_CO) / normal.dot(&ray);
        let on = (R_CO.transpose() * (ray * depth - p_CO)).xy() + middle;
        let within = |by: f64| on.x > -1.0 - by && on.y > -1.0 - by && on.x < 9.0 + by && on.y < 6.0 + by;
        let dark = (on.x.floor() + on.y.floor()).rem_euclid(2.0) == 0.0;
        match (depth > 0.0 && within(0.0), depth > 0.0 && within(margin)) {
            (true, _) if dark => 30.0,
            (_, true) => 210.0,
            _ => 110.0,
        }
    };
    let pixel = |x: usize, y: usize| {
        let at = |i: usize| (i as f64 - 1.5) / 4.0;
        let parts = (0..16).map(|i| level(Vector2::new(x as f64 + at(i % 4), y as f64 + at(i / 4))));
        (parts.sum::<f64>() / 16.0).round() as u8
    };
    let pixels = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))).map(|(x, y)| pixel(x, y));
    let corner = |id: usize| {
        let p = R_CO * (Vector2::new((id % 9) as f64, (id / 9) as f64) - middle).push(0.0) + p_CO;
        centre + p.xy() * (f_px * p.xy().norm().atan2(p.z) / p.xy().norm())
    };
    (pixels.collect(), (0..54).map(corner).collect())
}

/// All of each is in the image; a third of its corners must be found, with their own labels. Squares of these shrink by a fifth from one to the next at the image's edge.
#[test]
fn boards_under_a_fisheye_are_found() {
    let poses = [
        (
            198.8,
            [0.6097, -0.7072, -0.358, 0.7492, 0.6616, -0.0309, 0.2587, -0.2494, 0.9332],
            [-1.778, -1.625, 4.428],
            0.58,
        ),
        (
            161.6,
            [-0.9084, -0.3688, -0.197, 0.2993, -0.9025, 0.3098, -0.292, 0.2224, 0.9302],
            [0.961, 2.321, 6.437],
            0.79,
        ),
        (
            168.1,
            [0.8863, 0.192, 0.4213, 0.0878, 0.8238, -0.5601, -0.4546, 0.5334, 0.7133],
            [-0.569, -1.728, 4.155],
            0.44,
        ),
    ];
    let mut finder = ChessboardFinder::new(9, 6, SIZE[0], SIZE[1]);
    let mut found = Vec::new();
    for (f_px, rotation, place, margin) in poses {
        let (pixels, corners) = fisheye(f_px, Matrix3::from_row_slice(&rotation), place.into(), margin);
        let image = ImageView::new(&pixels, SIZE[0], SIZE[1]).unwrap();
        assert_eq!(finder.search_or_why(&image, &mut found), Ok(()), "{place:?}");
        assert!(found.len() >= 18, "{place:?}: {}", found.len());
        let worst = found.iter().map(|f| (f.px - corners[f.id as usize]).norm()).fold(0.0, f64::max);
        assert!(worst < 0.5, "{place:?}: {worst} px");
    }
}

/// The status is one, the reasons are two, and each says how to mend it.
#[test]
fn ambiguous_boards_say_which_reason_it_is() {
    let (width, height) = (400, 160);
    let board = |x: usize, y: usize, left: usize, columns: usize, rows: usize| {
        let on = x >= left && x < left + 20 * columns && y >= 40 && y < 40 + 20 * rows;
        on && ((x - left) / 20 + (y - 40) / 20).is_multiple_of(2)
    };
    let words = |dark: &dyn Fn(usize, usize) -> bool, columns: usize, rows: usize| {
        let pixels: Vec<u8> =
            (0..width * height).map(|i| if dark(i % width, i / width) { 30 } else { 210 }).collect();
        let image = ImageView::new(&pixels, width, height).unwrap();
        let mut finder = ChessboardFinder::new(columns, rows, width, height);
        assert_eq!(finder.search(&image, &mut Vec::new()), Err(TargetStatus::Ambiguous));
        crate::detect::Finder::Chessboard(Box::new(finder)).missed_in_words(TargetStatus::Ambiguous).unwrap()
    };
    let two = words(&|x, y| board(x, y, 40, 5, 4) || board(x, y, 240, 5, 4), 4, 3);
    assert!(two.contains("two chessboards") && two.contains("cover one"), "{two}");
    // squares without an end in the image
    let part = words(&|x, y| (x / 20 + y / 20).is_multiple_of(2), 30, 20);
    assert!(part.contains("border") && part.contains("into view"), "{part}");
}
