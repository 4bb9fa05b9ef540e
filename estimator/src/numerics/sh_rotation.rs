//! Spherical harmonics turned by any rotation: bands do not mix, so each is fitted to its own turned values, exactly.

use crate::numerics::sh::{MAX_BANDS, MAX_COEFFICIENTS, eval, even_directions};
use glam::DQuat;
use nalgebra::DMatrix;

/// Directions of the fit: enough that the nine bands are told apart by far.
const DIRECTIONS: usize = 400;

/// Coefficients `[k][channel]` of f(turn⁻¹ ω), where `coefficients` are those of f(ω): light that is turned by `turn`.
#[must_use]
pub fn rotated(coefficients: &[[f64; 3]], turn: DQuat) -> Vec<[f64; 3]> {
    let bands = coefficients.len().isqrt().min(MAX_BANDS);
    let count = bands * bands;
    let directions = even_directions(DIRECTIONS);
    let basis = |of: &dyn Fn(usize) -> glam::DVec3| {
        let mut rows = DMatrix::<f64>::zeros(DIRECTIONS, count);
        let mut y = [0.0; MAX_COEFFICIENTS];
        for i in 0..DIRECTIONS {
            eval(of(i), &mut y[..count]);
            rows.row_mut(i).iter_mut().zip(&y).for_each(|(r, y)| *r = *y);
        }
        rows
    };
    let new = basis(&|i| directions[i]);
    let old = basis(&|i| turn.inverse() * directions[i]);
    let mut out = coefficients.to_vec();
    for l in 1..bands {
        let (first, width) = (l * l, 2 * l + 1);
        let (new, old) = (new.columns(first, width), old.columns(first, width));
        let values = DMatrix::from_fn(width, 3, |m, c| coefficients[first + m][c]);
        // The columns are nearly orthogonal, so the system is well conditioned.
        if let Some(system) = (new.transpose() * new).cholesky() {
            let solved = system.solve(&(new.transpose() * (old * values)));
            for m in 0..width {
                out[first + m] = [solved[(m, 0)], solved[(m, 1)], solved[(m, 2)]];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::sh::radiance;
    use crate::render::lighting::panorama::turned;
    use glam::DVec3;

    fn light() -> Vec<[f64; 3]> {
        (0..81u32).map(|k| [1.0 / f64::from(1 + k), f64::from(k % 7) - 3.0, f64::from(k % 5)]).collect()
    }

    #[test]
    fn the_turned_light_has_its_values_in_turned_directions() {
        let turn = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(-1.9);
        let after = rotated(&light(), turn);
        for d in even_directions(50) {
            let (a, b) = (radiance(&light(), d), radiance(&after, turn * d));
            assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-9), "{d}: {a:?} {b:?}");
        }
    }

    #[test]
    fn a_turn_about_the_polar_axis_is_the_closed_form() {
        let closed = turned(&light(), 0.8);
        for (a, b) in rotated(&light(), DQuat::from_axis_angle(DVec3::Z, 0.8)).iter().zip(&closed) {
            assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-9), "{a:?} {b:?}");
        }
    }
}
