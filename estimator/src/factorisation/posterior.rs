//! How well each coefficient of the light is determined.

use crate::factorisation::joint_solution::JointSolution;
use crate::factorisation::projection::Projection;
use crate::factorisation::statistics::Folds;
use firmware_config::tuning::FactorisationTuning;
use nalgebra::{DMatrix, DVector};

/// Condition of the normal equations, and posterior standard deviation of the coefficients `[k]`: noise variance times the
/// inverse of the regularised system. Coefficients that the data do not determine keep the deviation of the prior.
pub(super) fn posterior(
    folds: &Folds,
    projection: &Projection,
    state: &JointSolution,
    regularisation: f64,
    tuning: &FactorisationTuning,
) -> (f64, Vec<f64>) {
    let k = projection.coefficients();
    let light = state.light(projection);
    let mut gram = DMatrix::zeros(k, k);
    let (mut residual, mut total) = (0.0, 0.0);
    for (s, a) in folds.fitted.iter().chain(&folds.held_out).zip(state.albedo.iter().cycle()) {
        gram += &s.gram * (a * a);
        residual += s.residual(*a, &light);
        total += s.square;
    }
    let undetermined = (f64::INFINITY, vec![f64::MAX.sqrt(); k]);
    // The decomposition has absolute tolerances: it gets numbers near 1.
    let scale = gram.amax();
    if total <= 0.0 || !(scale > 0.0 && scale.is_finite()) {
        return undetermined;
    }
    let mut eigen = (gram / scale).symmetric_eigen();
    eigen.eigenvalues *= scale;
    let largest = eigen.eigenvalues.max();
    let smallest = eigen.eigenvalues.min();
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    // The mean of (r − 1)² over directions is Σ (i_k)² / 4π over the bands above 0.
    let prior = (regularisation * total / (4.0 * std::f64::consts::PI)).max(1e-12 * largest);
    let noise = (residual / total).max(1e-12) * tuning.correlated_vertices;
    let eigenvalues: &DVector<f64> = &eigen.eigenvalues;
    let variance = |i: usize| -> f64 {
        let row = eigen.eigenvectors.row(i);
        row.iter().zip(eigenvalues.iter()).map(|(v, e)| v * v * noise / (e.max(0.0) + prior)).sum()
    };
    (condition, (0..k).map(|i| libm::sqrt(variance(i))).collect())
}
