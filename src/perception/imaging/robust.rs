//! What robust fits share: the spread of residuals among which some are wrong, and by how much a fit's own misfit widens its covariance.

/// How much greater a covariance is than the points' deviations alone explain, from the squared residuals per degree of freedom: as
/// much as these tell, where it is no chance.
pub(super) fn growth(chi2: f64, freedom: usize) -> f64 {
    if chi2 > 1.0 + 2.0 * (2.0 / freedom.max(1) as f64).sqrt() { chi2 } else { 1.0 }
}

/// Robust scale of residuals, at least 1: 1.4826 times the median of their amounts, of up to 128 of them.
pub(super) fn spread<T>(points: &[T], residual: impl Fn(&T) -> f64) -> f64 {
    let mut amounts = [0.0; 128];
    let step = points.len().div_ceil(amounts.len()).max(1);
    let count =
        amounts.iter_mut().zip(points.iter().step_by(step)).map(|(a, p)| *a = residual(p).abs()).count();
    match amounts.get_mut(..count) {
        Some(amounts @ [_, ..]) => {
            let (_, median, _) = amounts.select_nth_unstable_by(count / 2, f64::total_cmp);
            (1.4826 * *median).max(1.0)
        }
        _ => 1.0,
    }
}
