//! The chessboard finder allocates nothing once it has seen a frame.

#![allow(clippy::unwrap_used)] // helpers of tests

use crate::render::{Random, Thing, View};
use assert_no_alloc::assert_no_alloc;
use vservo::detect::chessboard::ChessboardFinder;
use vservo::detect::{Detection, PredictedPoint};
use vservo::imaging::ImageView;

#[test]
fn searching_and_tracking() {
    let mut random = Random(4);
    let mut images = Vec::new();
    for covers in 0..4 {
        let mut view = View::new(9, 6, [640, 480], 0.3 * f64::from(covers), 0.4, 1.0, 40.0);
        for _ in 0..covers {
            view.before.push(Thing::random(&mut random, 640.0, 480.0, 80.0));
            view.behind.push(Thing::random(&mut random, 640.0, 480.0, 80.0));
        }
        images.push(view.render(2, 0.8, 2.0, &mut random));
    }
    images.push((0..640 * 480).map(|_| (random.bits() >> 56) as u8).collect());
    let mut finder = ChessboardFinder::new(9, 6, 640, 480);
    let mut found: Vec<Detection> = Vec::with_capacity(54);
    let mut expected: Vec<PredictedPoint> = Vec::with_capacity(54);
    finder.search(&ImageView::new(&images[0], 640, 480).unwrap(), &mut found).unwrap();
    let mut seen = 0;
    for pixels in &images {
        let image = ImageView::new(pixels, 640, 480).unwrap();
        assert_no_alloc(|| {
            seen += usize::from(finder.search(&image, &mut found).is_ok());
            expected.clear();
            expected.extend(found.iter().map(|f| PredictedPoint {
                id: f.id,
                px: f.px,
                covariance_px2: f.covariance_px2,
                area_px2: f.area_px2,
                slack_px: 4.0,
                threshold: 0,
            }));
            finder.track(&image, &expected, &mut found);
        });
    }
    assert!(seen >= 2, "{seen}");
}
