//! Tracking of a board: corners in windows about their predictions.
//!
//! The first corners are searched in their whole windows by the ring response; the others start at their prediction, shifted by their neighbours'
//! displacement, and are found by the sub-pixel fit alone.

use super::board::Board;
use super::strongest::strongest;
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Greatest part of a square that a prediction may be off. Derived: the next corner of the same colours is a diagonal away, 1.41 squares, and
/// from half of that on would be as near; a little is left for perspective.
const MAX_SLACK: f64 = 0.6;
/// Greatest displacement that a fit alone takes in, px. Chosen by hand: the fit sees an edge only within some deviations of the blur, of
/// which 0.3 to 1 px are usual; from further away the ring is searched first.
const FIT_PX: f64 = 1.5;
/// Least ring response, grey levels. Chosen by hand: two thirds of a search's, since here a corner is known to be near.
const MIN_RESPONSE: f32 = 4.0;
/// How far a corner may be from where its neighbours' displacement has it: part of the slack, added to [`FIT_PX`]. Chosen by hand: neighbours
/// move alike but for the change of scale and turn over one square; 0 loses boards that turn quickly, 0.3 lets a fit end at something else.
const UNEVEN: f64 = 0.15;

/// Prediction of a corner, px, and its largest error.
pub(super) struct Prediction {
    pub(super) id: u32,
    pub(super) px: Vector2<f64>,
    pub(super) slack_px: f64,
}

/// Fits expected corners into `board`. `predicted` holds their expected positions.
pub(super) fn track(
    image: &ImageView<'_>,
    expected: impl Iterator<Item = Prediction>,
    predicted: &Board,
    board: &mut Board,
    blur_px: f64,
) {
    for Prediction { id, px, slack_px } in expected {
        let Some(steps) = predicted.steps(id) else { continue };
        let Some((c, r)) = board.column_and_row(id) else { continue };
        let slack = slack_px.max(0.0);
        if !(slack < MAX_SLACK * steps[0].norm().min(steps[1].norm())) {
            continue;
        }
        // displacement of those neighbours that were found just now
        let (mut sum, mut n) = (Vector2::zeros(), 0.0);
        for (dc, dr) in [(-1, 0), (0, -1), (1, -1), (-1, -1)] {
            if let (Some(now), Some(then)) = (board.px(c + dc, r + dr), predicted.px(c + dc, r + dr)) {
                sum += now - then;
                n += 1.0;
            }
        }
        let (begin, reach) = if n > 0.0 {
            (px + sum / n, FIT_PX + UNEVEN * slack)
        } else if slack > FIT_PX {
            match strongest(image, px, slack + 1.0, MIN_RESPONSE) {
                Some(at) => (at, FIT_PX + 0.5),
                None => continue,
            }
        } else {
            (px, FIT_PX + slack)
        };
        board.follow(image, id, begin, steps, blur_px, reach);
    }
}
