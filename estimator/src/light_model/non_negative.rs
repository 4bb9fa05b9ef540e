//! Light of a quadratic form: non-negative radiance over directions, and non-negative sources.

use crate::numerics::dense::{self, add_scaled, dot};
use isa::{Hot, Isa, dispatch};
use nalgebra::{DMatrix, DVector};

/// Times that Newton's method is tried, its steps, and sweeps of coordinate descent after each time that it does not settle, at most.
const ATTEMPTS: usize = 6;
const STEPS: usize = 25;
const SWEEPS: usize = 50;
/// A slope this small, relative to its terms, is none.
const FLAT: f64 = 1e-12;
/// Directions that the surfaces tell less of than this share of the best observed one are held at the mean by more.
const MIN_OBSERVABILITY: f64 = 5e-3;

/// `min ½ zᵀ H z − gᵀ z + ½ Σ_d s_d (r_d − mean r)²` where the first entries of z are `projection · r` with r ≥ 0 and the others, the extras,
/// are ≥ 0. The mean counts as given: no derivative is taken of it.
pub(super) struct NonNegative<'a> {
    /// H: `[dim][dim]`.
    pub gram: DMatrix<f64>,
    /// g: `[dim]`.
    pub cross: DVector<f64>,
    /// `[coefficient][direction]`.
    pub projection: &'a DMatrix<f64>,
    /// Upper bound of the last entry.
    pub last_at_most: f64,
}

impl NonNegative<'_> {
    /// z, and its radiance in `r`, which is where the search starts, with the extras of `start`. The s_d sum up to `strength`, or more
    /// where directions are hardly observed.
    pub fn solve(&self, strength: f64, r: &mut DVector<f64>, start: &DVector<f64>) -> DVector<f64> {
        let k = self.projection.nrows();
        let dim = self.gram.nrows();
        let products = dense::product(&self.gram.columns(0, k).into_owned(), self.projection);
        let products = products.as_slice();
        let of = |d: usize| dot(self.direction(d), &products[d * dim..][..k]).max(0.0);
        // None where the light has no coefficients.
        let observed: Vec<f64> = if k > 0 { (0..self.projection.ncols()).map(of).collect() } else { Vec::new() };
        let least = MIN_OBSERVABILITY * observed.iter().copied().fold(0.0, f64::max);
        let strength = strength / observed.len().max(1) as f64;
        let held = observed.iter().map(|&o| (o, strength * (1.0 + least / o.max(1e-4 * least))));
        let held: Vec<(f64, f64)> = held.collect();
        let mut z = start.clone();
        z.rows_mut(0, k).copy_from(&dense::times(self.projection, r));
        for _ in 0..ATTEMPTS {
            if let Some((light, radiance)) = self.newton(&held, r, &z) {
                *r = radiance;
                return light;
            }
            let mut gradient = dense::times(&self.gram, &z) - &self.cross;
            let (gradient, entries) = (gradient.as_mut_slice(), z.as_mut_slice());
            let descent = Descent { form: self, products, held: &held, gradient, r, z: entries };
            let has_converged = dispatch(Isa::detect(), descent);
            z.rows_mut(0, k).copy_from(&dense::times(self.projection, r));
            if has_converged {
                break;
            }
        }
        z
    }

    /// Newton's method on what holds at the minimum, r_d = max(0, m − p_dᵀ y / s_d) with the gradient y and the mean m: linear in z and m
    /// once it is known which entries are free (a primal-dual active set method). z and r; `None` if the free ones have not settled. `held`
    /// is that of [`Descent`].
    fn newton(
        &self,
        held: &[(f64, f64)],
        r: &DVector<f64>,
        start: &DVector<f64>,
    ) -> Option<(DVector<f64>, DVector<f64>)> {
        if held.is_empty() || held.iter().any(|(_, strength)| *strength <= 0.0) {
            return None;
        }
        let k = self.projection.nrows();
        let at = |j: usize| [0.0, self.most(j)].into_iter().find(|bound| start[j] == *bound);
        let mut free =
            Free { radiances: r.iter().map(|r| *r > 0.0).collect(), bounds: (k..start.len()).map(at).collect() };
        for _ in 0..STEPS {
            let (z, mean) = self.with_free(&free, held)?;
            let gradient = dense::times(&self.gram, &z) - &self.cross;
            let slope = |d: usize| dot(self.direction(d), &gradient.as_slice()[..k]);
            let radiance = DVector::from_fn(held.len(), |d, _| mean - slope(d) / held[d].1);
            if !radiance.iter().chain(z.iter()).all(|x| x.is_finite()) {
                return None;
            }
            let bounds = free.bounds.iter().enumerate();
            let next = Free {
                radiances: radiance.iter().map(|r| *r > 0.0).collect(),
                bounds: bounds.map(|(j, bound)| self.bound(k + j, *bound, &z, &gradient)).collect(),
            };
            if next == free {
                return Some((z, radiance.map(|r| r.max(0.0))));
            }
            free = next;
        }
        None
    }

    /// z and the mean m where only these entries are free.
    fn with_free(&self, free: &Free, held: &[(f64, f64)]) -> Option<(DVector<f64>, f64)> {
        let (k, dim) = (self.projection.nrows(), self.gram.nrows());
        let numbers = (0..held.len()).filter(|d| free.radiances[*d]);
        let count = numbers.clone().count();
        let columns = numbers.map(|d| (self.direction(d), held[d].1));
        let Sums { squares, plain, divided } = dispatch(Isa::detect(), Summed { k, columns });
        let (form, known) = (self.gram.rows(0, k).into_owned(), self.cross.rows(0, k).into_owned());
        let (mut system, mut right) = (DMatrix::zeros(dim + 1, dim + 1), DVector::zeros(dim + 1));
        // The coefficients are those of the free radiances, Σ p (m − pᵀ y / s), …
        system.view_mut((0, 0), (k, dim)).copy_from(&dense::product(&squares, &form));
        for i in 0..k {
            system[(i, i)] += 1.0;
            system[(i, dim)] = -plain[i];
        }
        right.rows_mut(0, k).copy_from(&(&squares * &known));
        // … the others are at their bounds or where the gradient is zero, …
        for (j, bound) in (k..dim).zip(&free.bounds) {
            match bound {
                Some(value) => (system[(j, j)], right[j]) = (1.0, *value),
                None => {
                    system.view_mut((j, 0), (1, dim)).copy_from(&self.gram.row(j));
                    right[j] = self.cross[j];
                }
            }
        }
        // … and m is the mean over all directions.
        system.view_mut((dim, 0), (1, dim)).copy_from(&(divided.transpose() * &form));
        system[(dim, dim)] = held.len() as f64 - count as f64;
        right[dim] = divided.dot(&known);
        let found = system.lu().solve(&right)?;
        let mut z = found.rows(0, dim).into_owned();
        // Rounding leaves none of them below zero.
        (k..dim).zip(&free.bounds).for_each(|(j, bound)| z[j] = bound.unwrap_or(z[j]));
        Some((z, found[dim]))
    }

    /// The bound that entry `j`, no coefficient, is held at next; `None` where it is free.
    fn bound(&self, j: usize, now: Option<f64>, z: &DVector<f64>, gradient: &DVector<f64>) -> Option<f64> {
        match now {
            Some(value) => {
                let rises = if value <= 0.0 { gradient[j] } else { -gradient[j] };
                // What rounding makes of nothing frees no entry.
                (rises >= -FLAT * self.cross[j].abs()).then_some(value)
            }
            None if z[j] < 0.0 => Some(0.0),
            None => (z[j] > self.most(j)).then(|| self.most(j)),
        }
    }

    /// Upper bound of entry `j`.
    fn most(&self, j: usize) -> f64 {
        if j + 1 == self.gram.nrows() { self.last_at_most } else { f64::INFINITY }
    }

    /// p of a direction: `[coefficient]`.
    fn direction(&self, d: usize) -> &[f64] {
        let k = self.projection.nrows();
        &self.projection.as_slice()[d * k..][..k]
    }
}

/// Which entries are free.
#[derive(PartialEq)]
struct Free {
    /// Radiances above zero: `[direction]`.
    radiances: Vec<bool>,
    /// Of the entries that are no coefficients, the bound of those at one.
    bounds: Vec<Option<f64>>,
}

/// Sums over the free directions.
struct Sums {
    /// Σ p pᵀ / s: `[k][k]`.
    squares: DMatrix<f64>,
    /// Σ p: `[k]`.
    plain: DVector<f64>,
    /// Σ p / s: `[k]`.
    divided: DVector<f64>,
}

/// Adds up columns of the projection, `[k]`, each with its s.
struct Summed<C> {
    k: usize,
    columns: C,
}

impl<'c, C: Iterator<Item = (&'c [f64], f64)>> Hot for Summed<C> {
    type Output = Sums;

    #[inline(always)]
    fn run(self) -> Sums {
        let Self { k, columns } = self;
        let (mut squares, mut plain, mut divided) = (DMatrix::zeros(k, k), DVector::zeros(k), DVector::zeros(k));
        for (column, strength) in columns {
            add_scaled(plain.as_mut_slice(), 1.0, column);
            add_scaled(divided.as_mut_slice(), 1.0 / strength, column);
            for (j, (sums, p)) in squares.as_mut_slice().chunks_exact_mut(k).zip(column).enumerate() {
                add_scaled(&mut sums[..=j], p / strength, &column[..=j]);
            }
        }
        squares.fill_lower_triangle_with_upper_triangle();
        Sums { squares, plain, divided }
    }
}

/// Coordinate descent.
struct Descent<'a> {
    form: &'a NonNegative<'a>,
    /// The form times the projection: `[direction][dim]`.
    products: &'a [f64],
    /// Observability and strength of the prior: `[direction]`; empty where the light has no coefficients.
    held: &'a [(f64, f64)],
    gradient: &'a mut [f64],
    r: &'a mut DVector<f64>,
    z: &'a mut [f64],
}

impl Hot for Descent<'_> {
    /// True if the last sweep changed nothing to speak of.
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { form, products, held, gradient, r, z } = self;
        let (k, dim, gram) = (form.projection.nrows(), gradient.len(), form.gram.as_slice());
        for _ in 0..SWEEPS {
            let (mut moved, mut size) = (0.0, 0.0);
            let mean = r.mean();
            let r = r.as_mut_slice();
            for (d, &(observed, strength)) in held.iter().enumerate() {
                let diagonal = observed + strength;
                if diagonal <= 0.0 {
                    continue;
                }
                let slope = dot(form.direction(d), &gradient[..k]) + strength * (r[d] - mean);
                let step = (r[d] - slope / diagonal).max(0.0) - r[d];
                if step != 0.0 {
                    r[d] += step;
                    add_scaled(gradient, step, &products[d * dim..][..dim]);
                    moved += step * step * observed;
                }
                size += r[d] * r[d] * observed;
            }
            for j in k..dim {
                let column = &gram[j * dim..][..dim];
                let diagonal = column[j];
                if diagonal <= 0.0 {
                    continue;
                }
                let step = (z[j] - gradient[j] / diagonal).clamp(0.0, form.most(j)) - z[j];
                if step != 0.0 {
                    z[j] += step;
                    add_scaled(gradient, step, column);
                    moved += step * step * diagonal;
                }
                size += z[j] * z[j] * diagonal;
            }
            if moved <= 1e-12 * size {
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DIRECTIONS: usize = 24;
    const STRENGTH: f64 = 0.05;

    /// A form of `k` coefficients and two others from `rows` equations, which ask for sources below zero and above the bound as well.
    fn form(seed: u32, k: usize, rows: usize, projection: &DMatrix<f64>) -> NonNegative<'_> {
        let value = |i: usize, j: usize| libm::sin(f64::from(seed % 997) + (i * 37 + j * 11) as f64);
        let equations = DMatrix::from_fn(rows, k + 2, value);
        let wanted = DVector::from_fn(rows, |i, _| value(i, 91) + 0.4);
        NonNegative {
            gram: equations.transpose() * &equations / rows as f64,
            cross: equations.transpose() * wanted / rows as f64,
            projection,
            last_at_most: 0.3,
        }
    }

    proptest! {
        #[test]
        fn no_entry_can_be_moved_to_lower_the_form(seed: u32, k in 1usize..9, rows in 12usize..40) {
            let value = |i: usize, d: usize| libm::cos((i * 5 + d * (i + 2)) as f64);
            let projection = DMatrix::from_fn(k, DIRECTIONS, value);
            let form = form(seed, k, rows, &projection);
            let mut r = DVector::from_element(DIRECTIONS, 1.0);
            let z = form.solve(STRENGTH, &mut r, &DVector::zeros(k + 2));
            let gradient = &form.gram * &z - &form.cross;
            let strength = STRENGTH / DIRECTIONS as f64;
            for d in 0..DIRECTIONS {
                let products = (projection.transpose() * form.gram.view((0, 0), (k, k)) * &projection).diagonal();
                let least = MIN_OBSERVABILITY * products.max();
                let held = strength * (1.0 + least / products[d].max(1e-4 * least));
                let slope = projection.column(d).dot(&gradient.rows(0, k)) + held * (r[d] - r.mean());
                prop_assert!(slope > -1e-5 && (r[d] <= 0.0 || slope < 1e-5), "direction {d}: {} with {slope}", r[d]);
            }
            for (j, most) in [(k, f64::INFINITY), (k + 1, form.last_at_most)] {
                prop_assert!((0.0..=most).contains(&z[j]));
                prop_assert!(z[j] <= 0.0 || gradient[j] < 1e-5, "entry {j}: {} with {}", z[j], gradient[j]);
                prop_assert!(z[j] >= most || gradient[j] > -1e-5, "entry {j}: {} with {}", z[j], gradient[j]);
            }
        }
    }
}
