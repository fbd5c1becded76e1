//! Looking for tags allocates nothing once it runs: searching, tracking, and images without tags alike.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::tag_scene::{Canvas, Dice, Look, Map};
use assert_no_alloc::assert_no_alloc;
use vservo::detect::tags::{MAX_TAGS, PredictedTag, TagFinder, TagPoints};
use vservo::imaging::ImageView;
use vservo::target::TagFamily;

#[test]
fn nothing_is_allocated_per_frame() {
    let (w, h) = (320, 240);
    let (mut dice, look) = (Dice(4), Look { samples: 3, ..Look::default() });
    let mut canvas = Canvas::new(w, h, look.ground);
    canvas.clutter(40, &mut dice);
    for (id, u) in [(5, 80.0), (6, 230.0)] {
        let map = Map::view(8.0, u, 120.0, 70.0, 0.3, 0.4, 1.0, 400.0, (160.0, 120.0));
        canvas.draw(TagFamily::Tag36h11, id, &map, &look, &mut dice);
    }
    let pixels = canvas.expose(&look, &mut dice);
    let noise = Canvas::new(w, h, 120.0).expose(&Look { noise: 80.0, ..look }, &mut dice);
    let (image, noise) = (ImageView::new(&pixels, w, h).unwrap(), ImageView::new(&noise, w, h).unwrap());
    let mut finder = TagFinder::new(TagFamily::Tag36h11, w, h);
    let mut points = TagPoints::new(TagFinder::new(TagFamily::Tag36h11, w, h), &[5, 6]);
    let (mut found, mut corners) = (Vec::with_capacity(MAX_TAGS), Vec::with_capacity(64));
    let mut counts = [0; 3];
    assert_no_alloc(|| {
        for _ in 0..5 {
            let _ = finder.search(&noise, &mut found);
            let _ = finder.search(&image, &mut found);
            counts[0] += found.len();
            if let Some(tag) = found.first().copied() {
                let expected = [PredictedTag { id: tag.id, corners_px: tag.corners_px, slack_px: 4.0 }];
                counts[1] += usize::from(finder.track(&image, &expected, &mut found));
            }
            let _ = points.search(&image, &mut corners);
            counts[2] += corners.len();
        }
    });
    assert_eq!(counts, [10, 5, 40]);
}
