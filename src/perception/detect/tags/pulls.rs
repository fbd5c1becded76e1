//! What a misfit that parts of a tag have in common does to its corners.
//!
//! The covariance of a fit takes what is left over at the pixels as noise, each pixel's for itself. A shadow, a highlight or a cover leaves over the same in
//! many neighbouring pixels, and these pull the corners together. With the residuals `r` and their derivatives `J` a part of the tag pulls by
//!
//! ```text
//! pull = F N^-1 sum_part J' r              N: normal matrix; F: displacement of a corner by the parameters
//! ```
//! The sum of its squares over all parts is the corner's covariance if the parts err independently (White's sandwich, with parts in the place of
//! pixels): where noise alone is left over it equals that of the fit, and where misfit is, it is larger.

use super::plane_map::PlaneMap;
use super::whole_model::{COUNT, GAMMA, RATIO, TagJacobian, TagPixels, UNKNOWNS};
use crate::imaging::simd::kernel;
use crate::linalg::Eight;
use nalgebra::Vector2;

/// Parts of a tag along a side. Chosen by hand on 381 images of shadowed tags, all fitted as a whole and with twice the pulls' variance: with 3, 4, 5 and 10 of them
/// 10, 3, 3 and 13 were more than five deviations off. Half do not tell a shadow from the fit's own freedom, the double cut it to pieces.
const PARTS: usize = 4;
/// Pulls beyond noise, as share of the covariance by noise: from the first they count in part, from the second wholly. The mean of all corners, and the
/// largest, which scatters more. Measured: of 329 images without harm, with five parts a side, 5 % had a mean above 1.1, none above 1.6; 2 % a largest above 2.3,
/// none above 2.8. Half counts noise for harm; the double lets a quarter of the untrue shadowed corners through.
const MEAN: [f64; 2] = [1.15, 1.4];
const MOST: [f64; 2] = [2.6, 3.2];
/// What variances by pulls are multiplied by: neighbouring parts do not err independently, and the fit takes up what it can of a misfit. Chosen by hand:
/// with a third of it 19 of 381 shadowed tags, all fitted as a whole, are beyond five deviations, with two thirds 3, with it 1; the double states 1.4
/// times the deviations for none.
const TOGETHER: f64 = 3.0;

/// Where the pixels of one fit lie, and what its last step was.
pub(super) struct LastStep<'a> {
    pub(super) pixels: &'a [TagPixels],
    /// Derivatives and residuals before the step.
    pub(super) rows: &'a [TagJacobian],
    pub(super) by: &'a [f64; UNKNOWNS],
    /// Inverse of the normal matrix.
    pub(super) inverse: &'a [[f64; UNKNOWNS]; UNKNOWNS],
    /// From pixels to cells, of which the tag has so many, and the origin of the pixels' positions.
    pub(super) back: &'a PlaneMap,
    pub(super) cells: f64,
    pub(super) origin: Vector2<f64>,
}

impl LastStep<'_> {
    /// How far what pulls is beyond noise: 0 within it, 1 where it counts wholly. Adds that share of it to the covariances of the corners, which the
    /// homography's parameters displace by `fields`.
    pub(super) fn add_pulls(&self, fields: &[[Vector2<f64>; 8]; 4], covariances: &mut [[f64; 3]; 4]) -> f64 {
        let mut sums = [[Eight::ZERO; UNKNOWNS]; PARTS * PARTS];
        add_parts(self, &mut sums);
        let sums = sums.map(|sums| sums.map(|sum| f64::from(sum.sum())));
        let (mut pulls, mut mean, mut most) = ([[0.0; 3]; 4], 0.0, 0.0f64);
        for ((field, stated), pulls) in fields.iter().zip(covariances.iter()).zip(&mut pulls) {
            let mut per_sum = [Vector2::zeros(); UNKNOWNS];
            for (field, row) in field.iter().zip(self.inverse) {
                for (per, v) in per_sum.iter_mut().zip(row) {
                    *per += field * *v;
                }
            }
            for sums in &sums {
                let pull: Vector2<f64> = per_sum.iter().zip(sums).map(|(per, sum)| per * *sum).sum();
                let [xx, xy, yy] = pulls;
                (*xx, *xy, *yy) = (*xx + pull.x * pull.x, *xy + pull.x * pull.y, *yy + pull.y * pull.y);
            }
            let share = (pulls[0] + pulls[2]) / (stated[0] + stated[2]);
            (mean, most) = (mean + 0.25 * share, most.max(share));
        }
        let beyond = |share: f64, [from, to]: [f64; 2]| ((share - from) / (to - from)).max(0.0);
        let harm = beyond(mean, MEAN).max(beyond(most, MOST));
        for (stated, pulls) in covariances.iter_mut().zip(&pulls) {
            for (stated, pull) in stated.iter_mut().zip(pulls) {
                *stated += TOGETHER * harm.min(1.0) * pull;
            }
        }
        harm
    }
}

impl LastStep<'_> {
    /// The part of the tag in which the middle of eight pixels lies.
    #[inline(always)]
    fn part(&self, eight: &TagPixels) -> usize {
        let middle = |of: &Eight| f64::from(of.0.get(4).copied().unwrap_or(0.0));
        let at = self.back.at(self.origin + Vector2::new(middle(&eight.x), middle(&eight.y)));
        let along = |c: f64| ((c / self.cells * PARTS as f64).max(0.0) as u32 as usize).min(PARTS - 1);
        along(at.y) * PARTS + along(at.x)
    }
}

kernel!(
    /// Adds derivatives times residuals after the step to the sums of the parts in which their pixels lie.
    fn add_parts(last: &LastStep<'_>, sums: &mut [[Eight; UNKNOWNS]; PARTS * PARTS]) = add_parts_body
);

#[inline(always)]
#[allow(clippy::indexing_slicing)] // indices below the lengths of arrays
fn add_parts_body(last: &LastStep<'_>, sums: &mut [[Eight; UNKNOWNS]; PARTS * PARTS]) {
    let by = last.by.map(|by| by as f32);
    for (row, eight) in last.rows.iter().zip(last.pixels) {
        // the derivatives by the last two unknowns, gamma and ratio, lie behind the residuals
        let mut left = row[COUNT] - row[GAMMA] * by[COUNT] - row[RATIO] * by[COUNT + 1];
        for (derivative, by) in row.iter().zip(&by[..COUNT]) {
            left = left - *derivative * *by;
        }
        let sums = &mut sums[last.part(eight)];
        for (sum, derivative) in sums.iter_mut().zip(&row[..COUNT]) {
            *sum = *sum + *derivative * left;
        }
        sums[COUNT] = sums[COUNT] + row[GAMMA] * left;
        sums[COUNT + 1] = sums[COUNT + 1] + row[RATIO] * left;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::tags::whole_model::COLUMNS;

    /// Pulls of 40 x 40 px that determine a shift in x and y, where `left` is left over: harm, and the corners' variance in x over that by noise of one level.
    fn pulled(left: impl Fn(usize, usize) -> f32) -> (f64, f64) {
        let quad = [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0)].map(|(x, y)| Vector2::new(x, y));
        let back = PlaneMap::of_square(&quad, 8.0).and_then(|map| map.inverse()).unwrap();
        let (mut pixels, mut rows) = (Vec::new(), Vec::new());
        for (y, x) in (0..40).flat_map(|y| (0..40).step_by(8).map(move |x| (y, x))) {
            let eight = |of: &dyn Fn(usize) -> f32| Eight(std::array::from_fn(|i| of(x + i)));
            let (along, y_px) = (eight(&|x| x as f32), Eight([y as f32; 8]));
            pixels.push(TagPixels { x: along, y: y_px, level: Eight::ZERO, weight: Eight([1.0; 8]) });
            let mut row = [Eight::ZERO; COLUMNS];
            (row[0], row[3], row[COUNT]) = (Eight([1.0; 8]), Eight([1.0; 8]), eight(&|x| left(x, y)));
            rows.push(row);
        }
        let mut inverse = [[0.0; UNKNOWNS]; UNKNOWNS];
        (inverse[0][0], inverse[3][3]) = (1.0 / 1600.0, 1.0 / 1600.0);
        let mut field = [Vector2::zeros(); 8];
        (field[0], field[3]) = (Vector2::x(), Vector2::y());
        let mut covariances = [[1.0 / 1600.0, 0.0, 1.0 / 1600.0]; 4];
        let by = [0.0; UNKNOWNS];
        let (inverse, origin) = (&inverse, Vector2::zeros());
        let last =
            LastStep { pixels: &pixels, rows: &rows, by: &by, inverse, back: &back, cells: 8.0, origin };
        let harm = last.add_pulls(&[field; 4], &mut covariances);
        (harm, 1600.0 * covariances[2][0])
    }

    #[test]
    fn what_parts_have_in_common_is_in_the_covariance() {
        // alike in no part
        assert_eq!(pulled(|x, y| if (x + y) % 2 == 0 { 1.0 } else { -1.0 }), (0.0, 1.0));
        // half of the tag too light, half too dark: as much noise, and each part has 80 px of a kind more than of the other
        let (harm, variance) = pulled(|x, _| if x < 20 { 1.0 } else { -1.0 });
        assert!(harm > 1.0, "{harm}");
        let wanted = 1.0 + TOGETHER * 6400.0 * (PARTS * PARTS) as f64 / 1600.0;
        assert!((variance - wanted).abs() < 1e-6 * wanted, "{variance} {wanted}");
    }
}
