//! Mixing of the last turns of an alternation: Anderson (1965), in the form of Walker and Ni (2011), type II.

use nalgebra::{DMatrix, DVector};
use std::collections::VecDeque;

/// Turns that are mixed.
const TURNS: usize = 6;
/// Added to the diagonal of the normal equations, as a share of its mean.
const RIDGE: f64 = 1e-9;

/// The last turns x → g(x).
#[derive(Debug, Default)]
pub(super) struct Mixing {
    /// g(x) and g(x) − x, the newest last.
    turns: VecDeque<(DVector<f64>, DVector<f64>)>,
}

impl Mixing {
    /// Takes in a turn from `point` to `image`, and gives the point to go on from: g_n − Σ γ_j (g_{j+1} − g_j) with the γ that
    /// minimise |f_n − Σ γ_j (f_{j+1} − f_j)|², f = g − x. That is `image` after the first turn.
    pub fn next(&mut self, point: &DVector<f64>, image: DVector<f64>) -> DVector<f64> {
        let moved = &image - point;
        if self.turns.len() == TURNS {
            self.turns.pop_front();
        }
        self.turns.push_back((image.clone(), moved.clone()));
        let steps = self.turns.len() - 1;
        let older = self.turns.iter().zip(self.turns.iter().skip(1));
        let (images, moves): (Vec<_>, Vec<_>) = older.map(|(a, b)| (&b.0 - &a.0, &b.1 - &a.1)).unzip();
        let mut normal = DMatrix::from_fn(steps, steps, |i, j| moves[i].dot(&moves[j]));
        let ridge = RIDGE * normal.trace() / steps.max(1) as f64;
        (0..steps).for_each(|i| normal[(i, i)] += ridge);
        let right = DVector::from_fn(steps, |i, _| moves[i].dot(&moved));
        let Some(decomposed) = normal.cholesky() else { return image };
        let shares = decomposed.solve(&right);
        let mixed = images.iter().zip(shares.iter()).fold(image.clone(), |sum, (g, share)| sum - g * *share);
        if mixed.iter().all(|v| v.is_finite()) { mixed } else { image }
    }

    /// Forgets all turns.
    pub fn restart(&mut self) {
        self.turns.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns until a linear contraction with factors of up to 0.99 is within 1e-9 of its fixed point, 1.
    fn turns(mixed: bool) -> usize {
        let factors = DVector::from_vec(vec![0.99, 0.9, 0.5, 0.1]);
        let image = |x: &DVector<f64>| DVector::from_fn(4, |i, _| 1.0 + factors[i] * (x[i] - 1.0));
        let (mut x, mut mixing) = (DVector::zeros(4), Mixing::default());
        (1..10_000)
            .find(|_| {
                let g = image(&x);
                x = if mixed { mixing.next(&x, g) } else { g };
                x.add_scalar(-1.0).amax() < 1e-9
            })
            .unwrap()
    }

    #[test]
    fn a_slow_contraction_takes_few_turns() {
        assert!(turns(false) > 1000, "{}", turns(false));
        assert!(turns(true) < 20, "{}", turns(true));
    }

    #[test]
    fn turns_that_move_nothing_stay() {
        let (x, mut mixing) = (DVector::from_element(3, 2.0), Mixing::default());
        (0..10).for_each(|_| assert_eq!(mixing.next(&x, x.clone()), x));
    }
}
