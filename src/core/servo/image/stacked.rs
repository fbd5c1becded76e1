//! The stacked feature error e_s and interaction matrix L_s of the selected features, for laws with full gain matrices, for studies and plots.

use super::{Interaction, Visitor, sides, visit};
use crate::features::{Feature, NormalEquations, StackRow};
use crate::messages::MAX_FEATURES;
use crate::servo::{FeatureMatrix, SetPoint, TwistTask, View, WrenchTask};
use nalgebra::{DMatrix, DVector, Matrix6, SVector, Vector6};

/// Most numbers of an error, since of all features normalized moments have the most, six.
const MAX_NUMBERS: usize = 6 * MAX_FEATURES;
const EMPTY: StackRow = StackRow { row: [0.0; 6], error: 0.0, weight: 0.0 };

/// L_s (k x 6), e_s (k) and the weights, a row for each number of the selected features. Rows of hidden features are zero, so that a gain matrix acts
/// on the others as if it had no rows and columns for the hidden ones.
struct Rows {
    interaction: Interaction,
    rows: [StackRow; MAX_NUMBERS],
    count: usize,
}

impl Rows {
    fn of(set_point: &SetPoint, view: &View, interaction: Interaction) -> Option<Self> {
        let (now, goal) = sides(set_point, view, interaction)?;
        let mut all = Self { interaction, rows: [EMPTY; MAX_NUMBERS], count: 0 };
        visit((set_point, view), (&now, &goal), &mut all)?;
        Some(all)
    }

    fn rows(&self) -> &[StackRow] {
        self.rows.get(..self.count).unwrap_or(&self.rows)
    }

    /// `L_s^T K x` for a stacked vector x with an element for each row.
    fn moved(&self, K: &FeatureMatrix, x: impl Iterator<Item = f64> + Clone) -> Vector6<f64> {
        let mut sum = Vector6::zeros();
        for (i, row) in self.rows().iter().enumerate() {
            sum += Vector6::from(row.row) * K.row_times(i, x.clone());
        }
        sum
    }
}

impl Visitor for Rows {
    fn pair<const K: usize>(
        &mut self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
        weight: f64,
    ) -> Option<()> {
        let (L, e) = (self.interaction.of(now, goal)?, now.error(&goal.value()));
        for k in 0..K {
            let row = StackRow { row: std::array::from_fn(|j| L[(k, j)]), error: e[k], weight };
            *self.rows.get_mut(self.count)? = row;
            self.count += 1;
        }
        Some(())
    }

    fn skip(&mut self, numbers: usize) {
        self.count = (self.count + numbers).min(MAX_NUMBERS);
    }
}

/// Normal equations of the selected features, `L_s^T W L_s` and `L_s^T W K_s e_s`, for a matrix K_s: (10.91).
///
/// `None` as for [`image_task`](super::image_task), and when K_s is for another number of features.
#[must_use]
pub fn image_task_by(
    set_point: &SetPoint,
    view: &View,
    interaction: Interaction,
    K_s: &FeatureMatrix,
) -> Option<TwistTask> {
    let stacked = Rows::of(set_point, view, interaction).filter(|stacked| K_s.fits(stacked.count))?;
    let (mut equations, mut error2) = (NormalEquations::new(), 0.0);
    let errors = stacked.rows().iter().map(|row| row.error);
    for (i, row) in stacked.rows().iter().enumerate() {
        equations.add_row(&row.row, K_s.row_times(i, errors.clone()), row.weight);
        error2 += row.error * row.error;
    }
    Some(TwistTask::new(&equations, error2.sqrt()))
}

/// Scheme C: wrench `L_s^T K_Ps e_s` and damping `L_s^T K_Ds L_s` of (10.84) for matrices K_Ps, in N m, and K_Ds, in N m s. The features'
/// weights do not enter. Without K_Ds only the damping of the joints acts.
///
/// `None` as for [`image_task_by`].
#[must_use]
pub fn image_wrench_by(
    set_point: &SetPoint,
    view: &View,
    interaction: Interaction,
    K_Ps: &FeatureMatrix,
    K_Ds: Option<&FeatureMatrix>,
) -> Option<WrenchTask> {
    let stacked = Rows::of(set_point, view, interaction)?;
    if !K_Ps.fits(stacked.count) || !K_Ds.is_none_or(|K_Ds| K_Ds.fits(stacked.count)) {
        return None;
    }
    let wrench = stacked.moved(K_Ps, stacked.rows().iter().map(|row| row.error));
    let mut damping = Matrix6::zeros();
    if let Some(K_Ds) = K_Ds {
        for j in 0..6 {
            damping.set_column(j, &stacked.moved(K_Ds, stacked.rows().iter().map(|row| row.row[j])));
        }
    }
    Some(WrenchTask { wrench, damping })
}

/// The law's estimate of L_s, k x 6, and e_s of (10.79), each row times the square root of its feature's weight. For studies: it allocates.
///
/// `None` as for [`image_task`](super::image_task).
#[must_use]
pub fn weighted_rows(
    set_point: &SetPoint,
    view: &View,
    interaction: Interaction,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    rows_by(set_point, view, interaction, &FeatureMatrix::Scalar(1.0), true)
}

/// L_s, k x 6, and `K e_s` for a matrix K; where features are `weighted`, each row times the square root of its feature's weight. For studies:
/// it allocates.
///
/// `None` as for [`image_task_by`].
pub(in crate::servo) fn rows_by(
    set_point: &SetPoint,
    view: &View,
    interaction: Interaction,
    K: &FeatureMatrix,
    weighted: bool,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let stacked = Rows::of(set_point, view, interaction).filter(|stacked| K.fits(stacked.count))?;
    let rows = stacked.rows();
    let errors = rows.iter().map(|row| row.error);
    let root = |row: &StackRow| if weighted { row.weight.sqrt() } else { 1.0 };
    let scaled = rows.iter().flat_map(|row| row.row.map(|x| x * root(row)));
    let L = DMatrix::from_row_iterator(rows.len(), 6, scaled);
    let e = rows.iter().enumerate().map(|(i, row)| K.row_times(i, errors.clone()) * root(row));
    Some((L, DVector::from_iterator(rows.len(), e)))
}

/// The stacked error e_s (normalized coordinates) of the selected features that are not hidden, and how many numbers it has; for plots and checks.
#[must_use]
pub fn image_error(set_point: &SetPoint, view: &View) -> Option<(SVector<f64, MAX_NUMBERS>, usize)> {
    let (now, goal) = sides(set_point, view, Interaction::TEXTBOOK)?;
    let mut errors = StackedErrors { e: SVector::zeros(), count: 0 };
    visit((set_point, view), (&now, &goal), &mut errors)?;
    Some((errors.e, errors.count))
}

struct StackedErrors {
    e: SVector<f64, MAX_NUMBERS>,
    count: usize,
}

impl Visitor for StackedErrors {
    fn pair<const K: usize>(
        &mut self,
        now: &impl Feature<K>,
        goal: &impl Feature<K>,
        _weight: f64,
    ) -> Option<()> {
        let e = now.error(&goal.value());
        for (place, e) in self.e.as_mut_slice().get_mut(self.count..)?.iter_mut().zip(e.iter()) {
            *place = *e;
            self.count += 1;
        }
        Some(())
    }
}
