//! What the edges of chessboards tell of a camera's response, in sampled views of known gammas.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::render::{Random, View};
use nalgebra::{Matrix2, Point3, Vector2};
use vservo::calibration::camera::BoardPoint;
use vservo::calibration::{GammaEstimate, ResponseEvidence};
use vservo::detect::chessboard::ChessboardFinder;
use vservo::imaging::ImageView;

/// The response of a camera by the edges of its boards: none is told that is not there, and most that are there are told.
#[test]
fn boards_tell_the_cameras_response() {
    let first: u64 = std::env::var("VSERVO_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    let mut told = 0;
    let bent = [1.3, 1.8, 2.2];
    for (k, gamma) in (0..).zip([1.0, 1.0].into_iter().chain([bent; 4].concat())) {
        let estimate = gamma_by_boards(gamma, &mut Random(first + 91 + k));
        println!("gamma {gamma}: {estimate:?}");
        let right =
            (estimate.gamma - gamma).abs() < 0.05 + 4.0 * estimate.sd && estimate.sd < 0.04 + 0.1 * gamma;
        assert_eq!(estimate.is_linear(), gamma == 1.0, "{gamma}: {estimate:?}");
        assert!(right || gamma > 1.5 && estimate.response().is_none(), "{gamma}: {estimate:?}");
        told += usize::from(estimate.response().is_some());
    }
    // Strongly bent edges may draw the estimate beyond what cameras have: then nothing is told.
    assert!(told >= 9, "{told} of 12");
}

/// What six pictures of a board tell, seen by a camera whose levels are `light^(1 / gamma)`.
fn gamma_by_boards(gamma: f64, random: &mut Random) -> GammaEstimate {
    let mut evidence = ResponseEvidence::default();
    for _ in 0..6 {
        let (turn, to) = (random.within(-0.4, 0.4), random.within(0.0, 6.3));
        let mut view =
            View::new(7, 5, [360, 270], turn, random.within(0.0, 0.7), to, random.within(24.0, 34.0));
        (view.dark, view.light) = (random.within(12.0, 40.0), random.within(130.0, 200.0));
        view.slope = Vector2::new(random.within(-0.15, 0.15), random.within(-0.15, 0.15));
        // light first: its noise keeps bytes from rounding the same way everywhere
        let mut pixels = view.render(4, random.within(0.6, 1.3), 0.5, random);
        for level in &mut pixels {
            let bent = 255.0 * (f64::from(*level) / 255.0).powf(1.0 / gamma);
            *level = (bent + 1.5 * random.normal()).round().clamp(0.0, 255.0) as u8;
        }
        let image = ImageView::new(&pixels, 360, 270).unwrap();
        let (mut finder, mut found) = (ChessboardFinder::new(7, 5, 360, 270), Vec::new());
        finder.search_or_why(&image, &mut found).unwrap();
        let board = found.iter().map(|f| BoardPoint {
            id: f.id,
            p_O: Point3::origin(),
            px: f.px,
            covariance_px2: Matrix2::identity(),
        });
        evidence.add(&image, &board.collect(), 7);
    }
    evidence.gamma().unwrap()
}
