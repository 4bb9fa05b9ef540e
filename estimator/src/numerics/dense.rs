//! Products of small dense matrices: the sums of `nalgebra`, in its order and so with its bits, but in registers. `nalgebra` is
//! fast only with kernels that depend on the CPU.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Rows and columns of a product that are summed in registers.
const TILE: usize = 4;
/// Columns of a product that one task takes, at least.
const TASK: usize = 80;
/// Partial sums of [`dot`].
const LANES: usize = 8;

/// `a · b`.
#[must_use]
pub fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    tiles(a, b, |_, _| true)
}

/// The upper triangle of `a · b` with the diagonal; what is below may be missing.
#[must_use]
pub fn upper_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    tiles(a, b, |row, column| row < column + TILE)
}

/// The tiles of `a · b` that are `wanted` by their first row and column.
fn tiles(a: &DMatrix<f64>, b: &DMatrix<f64>, wanted: impl Fn(usize, usize) -> bool + Sync) -> DMatrix<f64> {
    let (rows, columns) = (a.nrows(), b.ncols());
    if rows < TILE || columns < TILE {
        return a * b;
    }
    let mut out = DMatrix::zeros(rows, columns);
    let width = columns.div_ceil((columns / TASK).max(1));
    out.as_mut_slice().par_chunks_mut(rows * width).enumerate().for_each(|(task, out)| {
        for i in firsts(rows) {
            for j in firsts(out.len() / rows).filter(|j| wanted(i, task * width + j)) {
                for (c, sums) in tile(a, b, i, task * width + j).iter().enumerate() {
                    out[(j + c) * rows + i..][..TILE].copy_from_slice(sums);
                }
            }
        }
    });
    out
}

/// Where tiles begin; the last one overlaps with the one before.
fn firsts(size: usize) -> impl Iterator<Item = usize> {
    (0..size).step_by(TILE).map(move |first| first.min(size - TILE))
}

/// `[column][row]`, each summed upwards from its first product.
#[inline(always)]
fn tile(a: &DMatrix<f64>, b: &DMatrix<f64>, row: usize, column: usize) -> [[f64; TILE]; TILE] {
    let (inner, rows) = (b.nrows(), a.nrows());
    let a = &a.as_slice()[..rows * inner];
    let b: [&[f64]; TILE] = std::array::from_fn(|c| &b.as_slice()[(column + c) * inner..][..inner]);
    let mut sums = [[0.0; TILE]; TILE];
    for l in 0..inner {
        let Some(x) = a[l * rows + row..].first_chunk::<TILE>() else { break };
        for c in 0..TILE {
            let y = b[c][l];
            for r in 0..TILE {
                sums[c][r] = if l == 0 { x[r] * y } else { sums[c][r] + x[r] * y };
            }
        }
    }
    sums
}

/// `a · x`.
#[must_use]
pub fn times(a: &DMatrix<f64>, x: &DVector<f64>) -> DVector<f64> {
    let mut out = DVector::zeros(a.nrows());
    let y = out.as_mut_slice();
    let (rows, x) = (a.nrows().max(1), x.as_slice());
    let Some((first, x)) = x.split_first() else { return out };
    let (start, a) = a.as_slice().split_at(a.nrows());
    y.iter_mut().zip(start).for_each(|(y, a)| *y = a * first);
    let ((x, x_rest), columns) = (x.as_chunks::<TILE>(), a.chunks_exact(TILE * rows));
    let rest = columns.remainder().chunks_exact(rows);
    for (columns, [p, q, r, s]) in columns.zip(x) {
        let [a, b, c, d] = [0, 1, 2, 3].map(|n| &columns[n * rows..(n + 1) * rows]);
        for (i, y) in y.iter_mut().enumerate() {
            *y = *y + a[i] * p + b[i] * q + c[i] * r + d[i] * s;
        }
    }
    rest.zip(x_rest).for_each(|(column, x)| add_scaled(y, *x, column));
    out
}

/// `Σ a b`, in eight partial sums.
#[must_use]
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            lanes[i] += a[i] * b[i];
        }
    }
    let mut sum = 0.0;
    for i in 0..LANES / 2 {
        sum += lanes[i] + lanes[i + LANES / 2];
    }
    a_rest.iter().zip(b_rest).fold(sum, |sum, (a, b)| sum + a * b)
}

/// `y += scale · x`.
#[inline(always)]
pub fn add_scaled(y: &mut [f64], scale: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += scale * x);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bits(values: &[f64]) -> Vec<u64> {
        values.iter().map(|x| x.to_bits()).collect()
    }

    proptest! {
        #[test]
        fn products_have_the_bits_of_nalgebra(rows in 0usize..22, inner in 0usize..22, columns in prop_oneof![0usize..22, 150usize..180], seed: u32) {
            let value = |i: usize, j: usize| libm::sin(f64::from(seed % 1000) + (i * 31 + j * 7) as f64);
            let a = DMatrix::from_fn(rows, inner, value);
            let b = DMatrix::from_fn(inner, columns, |i, j| value(j + 3, i));
            let expected = &a * &b;
            prop_assert_eq!(bits(product(&a, &b).as_slice()), bits(expected.as_slice()));
            let upper = upper_product(&a, &b);
            for (i, j) in (0..rows).flat_map(|i| (i..columns).map(move |j| (i, j))) {
                prop_assert_eq!(upper[(i, j)].to_bits(), expected[(i, j)].to_bits());
            }
            let (x, mut y) = (DVector::from_fn(inner, value), DVector::from_fn(inner, |i, _| value(i, 5)));
            prop_assert_eq!(bits(times(&a, &x).as_slice()), bits((&a * &x).as_slice()));
            prop_assert_eq!(dot(x.as_slice(), y.as_slice()).to_bits(), x.dot(&y).to_bits());
            let mut added = y.clone();
            add_scaled(added.as_mut_slice(), 0.3, x.as_slice());
            y.axpy(0.3, &x, 1.0);
            prop_assert_eq!(bits(added.as_slice()), bits(y.as_slice()));
        }
    }
}
