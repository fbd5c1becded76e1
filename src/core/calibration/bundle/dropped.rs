//! Coefficients that were set to zero, as what they are: unknown, and not zero.
//!
//! A coefficient that the images hardly tell is better left out of the fit, but what it may be is an error of the fit all the same.
//! With the unknowns `t` of the fit, the coefficients `c` that were left out, and the information of all of them at its end:
//!
//! ```text
//! | S_tt S_tc |     G    = S_tt^-1 S_tc               t makes up for a missing c: E[t_found - t] = G c
//! | S_ct S_cc |     I_c  = S_cc - S_ct G              what the images tell of c
//!                   C_c  = (I_c + P)^-1               the same with what is known of lenses, P: see `expected_coefficients`
//!                   c^   = C_c I_c c_all              c_all: what a fit of everything would find, by one step from the end
//!
//! cov (t_found - t, 0 - c) = | S_tt^-1 0 | + | G  | (C_c + c^ c^') | G' -I |
//!                            | 0       0 |   | -I |
//! ```
//! `C_c + c^ c^'` is the mean square of `c` about zero, given the images and that lenses are tame.

use super::equations::{BundleSums, covariance_of};
use super::optics::{Freedom, Optics};
use super::problem::BundleProblem;
use super::select::Selected;
use crate::camera_model::CameraModel;
use crate::pose::Loss;
use nalgebra::{DMatrix, DVector, Vector2};

/// The covariance of the shared unknowns of `end` together with the coefficients that it left out, in the order of the problem
/// in which all of `all` is free; that problem. Where the images do not tell what was left out, of the fit alone. `None` where they do
/// not tell that either.
pub(crate) fn covariance_with_dropped(
    end: &Selected,
    all: &[Freedom],
) -> Option<(BundleProblem, DMatrix<f64>)> {
    let fitted = || Some((end.problem.clone(), end.end.sums.covariance()? * end.variance_factor()));
    if all == end.problem.freedom { fitted() } else { widened(end, all).or_else(fitted) }
}

fn widened(end: &Selected, all: &[Freedom]) -> Option<(BundleProblem, DMatrix<f64>)> {
    let whole = BundleProblem { freedom: all.to_vec(), ..end.problem.clone() };
    let sums = BundleSums::at(&whole, &end.end.state, Loss::Squares)?;
    let S = sums.information()?;
    let dropped = dropped_columns(&whole, &end.problem);
    let kept: Vec<usize> = (0..whole.shared()).filter(|i| !dropped.contains(i)).collect();
    let part = |rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |i, j| S[(rows[i], columns[j])])
    };
    let of_kept = covariance_of(&part(&kept, &kept))?;
    let G = &of_kept * part(&kept, &dropped);
    let factor = end.variance_factor();
    let told = (part(&dropped, &dropped) - part(&dropped, &kept) * &G) / factor;
    let step = sums.step(0.0)?;
    let c = DVector::from_iterator(dropped.len(), dropped.iter().map(|i| step.shared[*i]));
    let expected = expected_coefficients(&whole, end);
    let mut information = told.clone();
    for (i, column) in dropped.iter().enumerate() {
        information[(i, i)] += 1.0 / expected[*column].powi(2).max(f64::MIN_POSITIVE);
    }
    let of_dropped = covariance_of(&information)?;
    let c = &of_dropped * (told * c);
    let mean_square = of_dropped + &c * c.transpose();
    let mut spread = DMatrix::zeros(whole.shared(), dropped.len());
    let mut covariance = DMatrix::zeros(whole.shared(), whole.shared());
    for (i, &row) in kept.iter().enumerate() {
        spread.row_mut(row).copy_from(&G.row(i));
        for (j, &column) in kept.iter().enumerate() {
            covariance[(row, column)] = of_kept[(i, j)] * factor;
        }
    }
    for (j, &row) in dropped.iter().enumerate() {
        spread[(row, j)] = -1.0;
    }
    covariance += &spread * mean_square * spread.transpose();
    Some((whole, covariance))
}

/// The columns of `whole` that `fitted` has not.
fn dropped_columns(whole: &BundleProblem, fitted: &BundleProblem) -> Vec<usize> {
    let of_camera = |(camera, (all, own)): (usize, (&Freedom, &Freedom))| {
        let own: Vec<usize> = own.places().collect();
        let from = whole.optics_from(camera);
        let missing = all.places().enumerate().filter(move |(_, place)| !own.contains(place));
        missing.map(move |(i, _)| from + i).collect::<Vec<_>>()
    };
    whole.freedom.iter().zip(&fitted.freedom).enumerate().flat_map(of_camera).collect()
}

/// The standard deviation of a coefficient of the first camera's lens before any image, by a fit without it.
pub(crate) fn expected_coefficient(end: &Selected, name: &str) -> f64 {
    let of = |optics: &Optics| {
        let expected = expected_of_lens(optics);
        let at = optics.lens.coefficients().into_iter().position(|(own, _)| own == name);
        at.and_then(|at| expected.get(at).copied())
    };
    end.end.state.optics.first().and_then(of).unwrap_or(0.0)
}

/// By coefficient of a lens: its standard deviation before any image. The terms of a lens fall with their order: at the corner of the
/// image that is farthest from the axis, one that was left out is as large as the largest that was found, not larger. Where the images
/// tell the coefficient better than that, it makes no difference; in an equidistant lens whose corners no board reached it is what keeps
/// the stated error finite.
fn expected_of_lens(optics: &Optics) -> Vec<f64> {
    let Ok(model) = CameraModel::new(optics.intrinsics, optics.lens) else { return Vec::new() };
    let (width, height) = (f64::from(optics.intrinsics.width_px), f64::from(optics.intrinsics.height_px));
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    let farthest = corners
        .map(|(u, v)| model.normalized_of(&Vector2::new(u - 0.5, v - 0.5)))
        .into_iter()
        .max_by(|a, b| a.norm().total_cmp(&b.norm()))
        .unwrap_or_default();
    let shifts: Vec<f64> = optics.lens.by_coefficients(&farthest).into_iter().map(|by| by.norm()).collect();
    let values = optics.lens.coefficients();
    let found = values.iter().zip(&shifts).map(|((_, value), shift)| value.abs() * shift).fold(0.0, f64::max);
    shifts.into_iter().take(values.len()).map(|shift| found / shift).collect()
}

/// By shared unknown: [`expected_of_lens`], infinite for what is no coefficient.
fn expected_coefficients(whole: &BundleProblem, end: &Selected) -> Vec<f64> {
    let mut expected = vec![f64::INFINITY; whole.shared()];
    for (camera, (all, optics)) in whole.freedom.iter().zip(&end.end.state.optics).enumerate() {
        let (of_lens, from) = (expected_of_lens(optics), whole.optics_from(camera));
        for (i, place) in all.places().enumerate() {
            if let (Some(of_lens), Some(expected)) =
                (place.checked_sub(4).and_then(|j| of_lens.get(j)), expected.get_mut(from + i))
            {
                *expected = *of_lens;
            }
        }
    }
    expected
}
