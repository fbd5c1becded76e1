//! The corners of a decoded tag, from its sides, or from the whole of it where cells are narrow, the tag is steep, paper is clipped, or something seems to
//! lie on it.

use super::decode::Decoded;
use super::edge_growth::{LEAST_STEP_BLURS, corrected};
use super::edges::{Believed, Corners, SHARP_CELL_BLURS};
use super::quad::Quad;
use super::whole::WholeMeter;
use crate::imaging::ImageView;

/// From a tilt of 55 degrees on corners are fitted with the whole tag, since sides intersect at small angles there, which amplifies their errors. Derived:
/// a circle appears as an ellipse with the axes `1` and `c`, the cosine of the tilt, and `c + 1 / c` is 2.32 at 55 degrees.
const STEEP: f64 = 2.32;

/// Standard deviation added to corners of narrow-celled tags for which the fit of the whole tag failed, in deviations of the blur. Chosen by hand: that
/// of a side at two blurs a cell is 0.13 (`side::DOUBT`); half and double scale what is stated of such corners, and nothing else.
const UNFITTED_BLURS: f64 = 0.15;
/// The same where the paper is clipped: of a step that is cut off at a share `p` of its contrast half of what is left is reached `z` deviations before its middle,
/// `F(z) = p / 2`, 0.2 to 1.1 for `p` of 0.8 to 0.3. Half and double scale what is stated of such corners, and nothing else.
const UNFITTED_CLIPPED_BLURS: f64 = 0.7;

/// Standard deviation added to corners of tags on which something seems to lie and of which no fit of the whole explains the rest, px. Chosen by hand: covers over a corner were seen to move
/// sides by one to two pixels; half leaves those untrue, the double makes such a tag worth nothing.
const UNEXPLAINED_PX: f64 = 1.0;

/// From this harm on a gamma is tried as its cause where the edges tell none: pulls of 2.15 times the noise's. Chosen by hand: of 329 honest images none had
/// more than 1.6 times, of 16 with an untrue corner by a gamma of 1.3 to 2.2 none less than 2.3. Half fits honest tags twice, the double misses half of
/// those gammas.
const MAYBE_GAMMA: f64 = 4.0;

/// The best corners that the image gives, from those of the sides. Where something seems to lie on the tag they stay, and what the fit of the whole says of them is in their
/// covariance: on photographs, of tags that are bent a little, it is the sides that are true.
pub(super) fn best_corners(
    image: &ImageView<'_>,
    corners: &Corners,
    decoded: &Decoded,
    believed: Believed,
    whole: &mut WholeMeter,
) -> Corners {
    // the growth is measured at edges between cells, for which these must be wider than for the sides
    let sharp = if believed == Believed::Bent { LEAST_STEP_BLURS } else { SHARP_CELL_BLURS };
    let believed = if decoded.clipped { Believed::Bent } else { believed };
    let whole_only = corners.cell_blurs < sharp || decoded.clipped || foreshortened(&corners.px) > STEEP;
    if whole_only && let Some(fitted) = of_whole(image, corners, decoded, believed, whole) {
        return fitted;
    }
    let doubted = match (decoded.clipped, corners.cell_blurs < SHARP_CELL_BLURS) {
        (true, _) => corners.doubted(UNFITTED_CLIPPED_BLURS),
        (false, true) => corners.doubted(UNFITTED_BLURS),
        (false, false) => *corners,
    };
    let (moved, scattered) = corrected(image, &doubted, decoded, believed);
    let grown = believed == Believed::Linear && moved.is_some();
    let usual = moved.unwrap_or(doubted);
    let suspect = corners.uneven || decoded.uneven || scattered;
    if !(suspect || grown) {
        return usual;
    }
    let fitted = if whole_only { None } else { of_whole(image, corners, decoded, believed, whole) };
    match fitted {
        Some(fitted) if suspect || fitted.harm > MAYBE_GAMMA => {
            Corners { px: usual.px, ..fitted.with_difference(&usual) }
        }
        None if suspect => usual.doubted(UNEXPLAINED_PX / corners.blur_px),
        _ => usual,
    }
}

/// The corners by a fit of the whole tag. Where a linear response leaves a growth one with a gamma is fitted; where it leaves a misfit that pulls, one with a gamma tells how far
/// that may have moved the corners.
fn of_whole(
    image: &ImageView<'_>,
    corners: &Corners,
    decoded: &Decoded,
    believed: Believed,
    whole: &mut WholeMeter,
) -> Option<Corners> {
    let fitted = whole.refine(image, corners, decoded, believed)?;
    if believed == Believed::Bent {
        return Some(fitted);
    }
    let (moved, _) = corrected(image, &fitted, decoded, Believed::Linear);
    if moved.is_none() && fitted.harm < MAYBE_GAMMA {
        return Some(fitted);
    }
    let bent = whole.refine(image, corners, decoded, Believed::Bent);
    Some(match moved {
        None => bent.map_or(fitted, |bent| fitted.with_difference(&bent)),
        // what seems to be the response may be light
        Some(moved) if corners.uneven || decoded.uneven || fitted.harm > 0.0 => {
            bent.unwrap_or(moved).with_difference(&fitted)
        }
        Some(moved) => bent.unwrap_or(moved),
    })
}

/// `c + 1 / c` for the ratio `c` of the axes of the ellipse as which a circle in the tag would appear.
fn foreshortened(quad: &Quad) -> f64 {
    let [a, b, c, d] = *quad;
    let (x, y) = (b - a + c - d, d - a + c - b);
    (x.norm_squared() + y.norm_squared()) / x.perp(&y).abs()
}
