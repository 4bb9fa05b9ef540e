//! Squared extrapolation: slow turns of light and albedo in fewer steps.

use crate::numerics::dense::dot;

/// Longest step, in turns.
const LONGEST: f64 = 16.0;

/// Where three positive albedos in succession, `[segment]`, lead to: scheme S3 of Varadhan and Roland (Simple and globally convergent
/// methods for accelerating the convergence of any EM algorithm, 2008) in logarithms.
pub(super) fn extrapolated(first: &[f64], second: &[f64], third: &[f64]) -> Vec<f64> {
    let log = |(a, b): (&f64, &f64)| if *a > 0.0 && *b > 0.0 { libm::log(b / a) } else { 0.0 };
    let once: Vec<f64> = first.iter().zip(second).map(log).collect();
    let bend: Vec<f64> = second.iter().zip(third).map(log).zip(&once).map(|(again, once)| again - once).collect();
    let (speed, bent) = (dot(&once, &once), dot(&bend, &bend));
    let step = if bent > 0.0 { libm::sqrt(speed / bent).clamp(1.0, LONGEST) } else { 1.0 };
    let moved = |((a, r), v): ((&f64, &f64), &f64)| a * libm::exp(2.0 * step * r + step * step * v);
    first.iter().zip(&once).zip(&bend).map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shrinks_by_one_factor_a_turn_ends_at_once() {
        let at = |turn: i32| [0.2 * libm::exp(0.5 * 0.8f64.powi(turn)), 0.7 * libm::exp(-0.3 * 0.8f64.powi(turn))];
        let found = extrapolated(&at(0), &at(1), &at(2));
        assert!((found[0] / 0.2 - 1.0).abs() < 1e-12 && (found[1] / 0.7 - 1.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn turns_that_do_not_shrink_are_not_followed_without_end() {
        let found = extrapolated(&[1.0], &[2.0], &[4.0]);
        assert!(found[0] <= 4.0, "{found:?}");
        let steady = extrapolated(&[1.0], &[1.1], &[1.2]);
        assert!(steady[0].is_finite() && steady[0] < 1.1f64.powi(2 * 16 + 1), "{steady:?}");
        assert_eq!(extrapolated(&[0.0, 1.0], &[0.0, 1.0], &[0.0, 1.0]), [0.0, 1.0]);
    }
}
