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

/// `min ½ zᵀ H z − gᵀ z + ½ Σ_d s_d (r_d − c_d)²` where the first entries of z are `projection · r` with r ≥ 0 and the others, the extras,
/// are ≥ 0.
pub(crate) struct NonNegative<'a> {
    /// H: `[dim][dim]`.
    pub gram: DMatrix<f64>,
    /// g: `[dim]`.
    pub cross: DVector<f64>,
    /// `[coefficient][direction]`.
    pub projection: &'a DMatrix<f64>,
    /// c.
    pub center: Center<'a>,
    /// Upper bound of the last entry, if it is an extra.
    pub last_at_most: f64,
}

/// What radiance is drawn to.
#[derive(Clone, Copy)]
pub(crate) enum Center<'a> {
    /// The mean of all directions. It counts as given: no derivative is taken of it.
    Mean,
    /// `[direction]`.
    At(&'a DVector<f64>),
}

/// Observability, the diagonal of Pᵀ H P, and s of every direction: `strength`, and more where the observability is below the share
/// `min_observability` of the largest, since what few vertices see would fit their errors. `gram` is H, of which the first entries are
/// coefficients, `projection` P. None where the light has no coefficients.
pub(crate) fn held(
    gram: &DMatrix<f64>,
    projection: &DMatrix<f64>,
    min_observability: f64,
    strength: impl Fn(usize) -> f64,
) -> Vec<(f64, f64)> {
    let k = projection.nrows();
    if k == 0 {
        return Vec::new();
    }
    let products = dense::product(&gram.view((0, 0), (k, k)).into_owned(), projection);
    let columns = projection.as_slice().chunks_exact(k).zip(products.as_slice().chunks_exact(k));
    let observed: Vec<f64> = columns.map(|(column, product)| dot(column, product).max(0.0)).collect();
    let least = min_observability * observed.iter().copied().fold(0.0, f64::max);
    let more = |o: f64| 1.0 + least / o.max(1e-4 * least);
    observed.iter().enumerate().map(|(d, &o)| (o, strength(d) * more(o))).collect()
}

impl NonNegative<'_> {
    /// z, and its radiance in `r`, which is where the search starts, with the extras of `start`. The s_d are those of [`held`].
    pub fn solve(&self, held: &[(f64, f64)], r: &mut DVector<f64>, start: &DVector<f64>) -> DVector<f64> {
        let k = self.projection.nrows();
        let mut z = start.clone();
        z.rows_mut(0, k).copy_from(&dense::times(self.projection, r));
        let mut products: Option<DMatrix<f64>> = None;
        for _ in 0..ATTEMPTS {
            if let Some((light, radiance)) = self.newton(held, r, &z) {
                *r = radiance;
                return light;
            }
            let products =
                products.get_or_insert_with(|| dense::product(&self.gram.columns(0, k).into_owned(), self.projection));
            let mut gradient = dense::times(&self.gram, &z) - &self.cross;
            let (gradient, entries) = (gradient.as_mut_slice(), z.as_mut_slice());
            let descent = Descent { form: self, products: products.as_slice(), held, gradient, r, z: entries };
            let has_converged = dispatch(Isa::detect(), descent);
            z.rows_mut(0, k).copy_from(&dense::times(self.projection, r));
            if has_converged {
                break;
            }
        }
        z
    }

    /// Newton's method on what holds at the minimum, r_d = max(0, m c_d − p_dᵀ y / s_d) with the gradient y, and with m = 1 or, where the mean
    /// is the center, m the mean and c = 1: linear in z and m once it is known which entries are free (a primal-dual active set method). z
    /// and r; `None` if the free ones have not settled.
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
            let radiance = DVector::from_fn(held.len(), |d, _| mean * self.center(d) - slope(d) / held[d].1);
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

    /// z and m where only these entries are free.
    fn with_free(&self, free: &Free, held: &[(f64, f64)]) -> Option<(DVector<f64>, f64)> {
        let (k, dim) = (self.projection.nrows(), self.gram.nrows());
        let numbers = (0..held.len()).filter(|d| free.radiances[*d]);
        let count = numbers.clone().count();
        let columns = numbers.map(|d| (self.direction(d), self.center(d), held[d].1));
        let Sums { squares, plain, divided } = dispatch(Isa::detect(), Summed { k, columns });
        let (form, known) = (self.gram.rows(0, k).into_owned(), self.cross.rows(0, k).into_owned());
        let (mut system, mut right) = (DMatrix::zeros(dim + 1, dim + 1), DVector::zeros(dim + 1));
        // The coefficients are those of the free radiances, Σ p (m c − pᵀ y / s), …
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
        match self.center {
            // … and m is the mean over all directions.
            Center::Mean => {
                system.view_mut((dim, 0), (1, dim)).copy_from(&(divided.transpose() * &form));
                system[(dim, dim)] = held.len() as f64 - count as f64;
                right[dim] = divided.dot(&known);
            }
            Center::At(_) => (system[(dim, dim)], right[dim]) = (1.0, 1.0),
        }
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

    /// c of a direction; 1 where the mean takes its place.
    fn center(&self, d: usize) -> f64 {
        match self.center {
            Center::Mean => 1.0,
            Center::At(center) => center[d],
        }
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
    /// Σ p c: `[k]`.
    plain: DVector<f64>,
    /// Σ p / s: `[k]`.
    divided: DVector<f64>,
}

/// Adds up columns of the projection, `[k]`, each with its c and s.
struct Summed<C> {
    k: usize,
    columns: C,
}

impl<'c, C: Iterator<Item = (&'c [f64], f64, f64)>> Hot for Summed<C> {
    type Output = Sums;

    #[inline(always)]
    fn run(self) -> Sums {
        let Self { k, columns } = self;
        let (mut squares, mut plain, mut divided) = (DMatrix::zeros(k, k), DVector::zeros(k), DVector::zeros(k));
        for (column, center, strength) in columns {
            add_scaled(plain.as_mut_slice(), center, column);
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
            let mean = match form.center {
                Center::Mean => r.mean(),
                Center::At(_) => 1.0,
            };
            let r = r.as_mut_slice();
            for (d, &(observed, strength)) in held.iter().enumerate() {
                let diagonal = observed + strength;
                if diagonal <= 0.0 {
                    continue;
                }
                let slope = dot(form.direction(d), &gradient[..k]) + strength * (r[d] - mean * form.center(d));
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
    const MIN_OBSERVABILITY: f64 = 5e-3;

    /// A form of `k` coefficients and two others from `rows` equations, which ask for sources below zero and above the bound as well.
    fn form(seed: u32, k: usize, rows: usize, projection: &DMatrix<f64>) -> NonNegative<'_> {
        let value = |i: usize, j: usize| libm::sin(f64::from(seed % 997) + (i * 37 + j * 11) as f64);
        let equations = DMatrix::from_fn(rows, k + 2, value);
        let wanted = DVector::from_fn(rows, |i, _| value(i, 91) + 0.4);
        NonNegative {
            gram: equations.transpose() * &equations / rows as f64,
            cross: equations.transpose() * wanted / rows as f64,
            projection,
            center: Center::Mean,
            last_at_most: 0.3,
        }
    }

    proptest! {
        #[test]
        fn no_entry_can_be_moved_to_lower_the_form(seed: u32, k in 1usize..9, rows in 12usize..40, at_mean: bool) {
            let value = |i: usize, d: usize| libm::cos((i * 5 + d * (i + 2)) as f64);
            let projection = DMatrix::from_fn(k, DIRECTIONS, value);
            let given = DVector::from_fn(DIRECTIONS, |d, _| 1.0 + value(k, d));
            let center = if at_mean { Center::Mean } else { Center::At(&given) };
            let form = NonNegative { center, ..form(seed, k, rows, &projection) };
            let mut r = DVector::from_element(DIRECTIONS, 1.0);
            let held = held(&form.gram, &projection, MIN_OBSERVABILITY, |_| STRENGTH / DIRECTIONS as f64);
            let z = form.solve(&held, &mut r, &DVector::zeros(k + 2));
            let gradient = &form.gram * &z - &form.cross;
            let products = (projection.transpose() * form.gram.view((0, 0), (k, k)) * &projection).diagonal();
            for d in 0..DIRECTIONS {
                let least = MIN_OBSERVABILITY * products.max();
                let held = STRENGTH / DIRECTIONS as f64 * (1.0 + least / products[d].max(1e-4 * least));
                let center = if at_mean { r.mean() } else { given[d] };
                let slope = projection.column(d).dot(&gradient.rows(0, k)) + held * (r[d] - center);
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
