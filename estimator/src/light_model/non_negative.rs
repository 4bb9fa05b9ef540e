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

/// `min ½ zᵀ H z − gᵀ z + ½ Σ_d s_d (r_d − mean r)²` where the first entries of z are `projection · r` with r ≥ 0 and the `extras` others
/// are ≥ 0. The mean counts as given: no derivative is taken of it.
pub(super) struct NonNegative<'a> {
    /// H: `[dim][dim]`.
    pub gram: DMatrix<f64>,
    /// g: `[dim]`.
    pub cross: DVector<f64>,
    /// `[coefficient][direction]`.
    pub projection: &'a DMatrix<f64>,
    /// Entries of z that are no coefficients of radiance.
    pub extras: usize,
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
        let (p, columns) = (self.projection.as_slice(), self.projection.ncols());
        let of = |d: usize| dot(&p[d * k..][..k], &products[d * dim..][..k]).max(0.0);
        // None where the light has no coefficients.
        let observed: Vec<f64> = if k > 0 { (0..columns).map(of).collect() } else { Vec::new() };
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
    /// once it is known which radiances and which of the others are free (a primal-dual active set method). z and r; `None` if the free
    /// ones have not settled. `held` is that of [`Descent`].
    fn newton(
        &self,
        held: &[(f64, f64)],
        r: &DVector<f64>,
        start: &DVector<f64>,
    ) -> Option<(DVector<f64>, DVector<f64>)> {
        let (k, dim, directions) = (self.projection.nrows(), self.gram.nrows(), held.len());
        if directions == 0 || held.iter().any(|(_, strength)| *strength <= 0.0) {
            return None;
        }
        let column = |d: usize| &self.projection.as_slice()[d * k..][..k];
        let most = |j: usize| if j + 1 == dim { self.last_at_most } else { f64::INFINITY };
        let mut free: Vec<bool> = r.iter().map(|r| *r > 0.0).collect();
        // Of the others, those at a bound, and which.
        let at = |x: f64, j: usize| [0.0, most(j)].into_iter().find(|bound| x == *bound);
        let mut bound: Vec<Option<f64>> = (k..dim).map(|j| at(start[j], j)).collect();
        for _ in 0..STEPS {
            // Over the free directions: Σ p pᵀ / s, Σ p and Σ p / s.
            let mut sums = Sums { k, squares: vec![0.0; k * k], plain: vec![0.0; k], divided: vec![0.0; k] };
            let columns = free.iter().zip(held).enumerate().filter(|(_, (free, _))| **free);
            dispatch(Isa::detect(), Summed { sums: &mut sums, columns: columns.map(|(d, (_, h))| (column(d), h.1)) });
            let squares = DMatrix::from_fn(k, k, |i, j| sums.squares[i.max(j) * k + i.min(j)]);
            let divided = DVector::from_column_slice(&sums.divided);
            let (form, known) = (self.gram.rows(0, k).into_owned(), self.cross.rows(0, k).into_owned());
            let mut system = DMatrix::zeros(dim + 1, dim + 1);
            let mut right = DVector::zeros(dim + 1);
            system.view_mut((0, 0), (k, dim)).copy_from(&dense::product(&squares, &form));
            (0..k).for_each(|i| {
                system[(i, i)] += 1.0;
                system[(i, dim)] = -sums.plain[i];
            });
            right.rows_mut(0, k).copy_from(&(&squares * &known));
            for (j, bound) in (k..dim).zip(&bound) {
                match bound {
                    Some(value) => (system[(j, j)], right[j]) = (1.0, *value),
                    None => {
                        system.view_mut((j, 0), (1, dim)).copy_from(&self.gram.row(j));
                        right[j] = self.cross[j];
                    }
                }
            }
            system.view_mut((dim, 0), (1, dim)).copy_from(&(divided.transpose() * &form));
            system[(dim, dim)] = directions as f64 - free.iter().filter(|f| **f).count() as f64;
            right[dim] = divided.dot(&known);
            let found = system.lu().solve(&right)?;
            let (z, mean) = (found.rows(0, dim).into_owned(), found[dim]);
            let gradient = dense::times(&self.gram, &z) - &self.cross;
            let radiance = |d: usize| mean - dot(column(d), &gradient.as_slice()[..k]) / held[d].1;
            let radiance = DVector::from_fn(directions, |d, _| radiance(d));
            if !radiance.iter().chain(z.iter()).all(|x| x.is_finite()) {
                return None;
            }
            let next_free: Vec<bool> = radiance.iter().map(|r| *r > 0.0).collect();
            // What rounding makes of nothing frees no entry.
            let rises = |j: usize, value: f64| {
                let slope = if value <= 0.0 { gradient[j] } else { -gradient[j] };
                slope >= -FLAT * self.cross[j].abs()
            };
            let next_bound = (k..dim).zip(&bound).map(|(j, bound)| match *bound {
                // Stays at the bound while the form rises from it.
                Some(value) if rises(j, value) => Some(value),
                Some(_) => None,
                None if z[j] < 0.0 => Some(0.0),
                None if z[j] > most(j) => Some(most(j)),
                None => None,
            });
            let next_bound: Vec<Option<f64>> = next_bound.collect();
            if next_free == free && next_bound == bound {
                return Some((z, radiance.map(|r| r.max(0.0))));
            }
            (free, bound) = (next_free, next_bound);
        }
        None
    }
}

/// Sums over directions.
struct Sums {
    k: usize,
    /// Σ p pᵀ / s by columns, down to the diagonal: `[k][k]`.
    squares: Vec<f64>,
    /// Σ p: `[k]`.
    plain: Vec<f64>,
    /// Σ p / s: `[k]`.
    divided: Vec<f64>,
}

/// Adds columns of the projection, each with its s.
struct Summed<'a, C> {
    sums: &'a mut Sums,
    columns: C,
}

impl<'c, C: Iterator<Item = (&'c [f64], f64)>> Hot for Summed<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Sums { k, squares, plain, divided } = self.sums;
        for (column, strength) in self.columns {
            add_scaled(plain, 1.0, column);
            add_scaled(divided, 1.0 / strength, column);
            for (j, (sums, p)) in squares.chunks_exact_mut(*k).zip(column).enumerate() {
                add_scaled(&mut sums[..=j], p / strength, &column[..=j]);
            }
        }
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
                let column = &form.projection.as_slice()[d * k..][..k];
                let slope = dot(column, &gradient[..k]) + strength * (r[d] - mean);
                let step = (r[d] - slope / diagonal).max(0.0) - r[d];
                if step != 0.0 {
                    r[d] += step;
                    add_scaled(gradient, step, &products[d * dim..][..dim]);
                    moved += step * step * observed;
                }
                size += r[d] * r[d] * observed;
            }
            for j in dim - form.extras..dim {
                let column = &gram[j * dim..][..dim];
                let diagonal = column[j];
                if diagonal <= 0.0 {
                    continue;
                }
                let most = if j + 1 == dim { form.last_at_most } else { f64::INFINITY };
                let step = (z[j] - gradient[j] / diagonal).clamp(0.0, most) - z[j];
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
            extras: 2,
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
