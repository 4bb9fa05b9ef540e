//! Products of small dense matrices: the sums of `nalgebra`, in its order and so with its bits, but in registers, and compiled for
//! several instruction sets. `nalgebra` is fast only with kernels whose bits depend on the CPU.

use isa::{Hot, Isa, dispatch};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Rows and columns of a product that are summed in registers, as many as each instruction set has room for.
const TILE: usize = 4;
const TALL: usize = 8;
/// Columns of a product that one task takes, at least.
const TASK: usize = 80;
/// Partial sums of [`dot`].
const LANES: usize = 8;

/// `a · b`.
#[must_use]
pub fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    some(a, b, false)
}

/// The upper triangle of `a · b` with the diagonal; what is below may be missing.
#[must_use]
pub fn upper_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    some(a, b, true)
}

/// `a · b`, or its `upper` triangle alone.
fn some(a: &DMatrix<f64>, b: &DMatrix<f64>, upper: bool) -> DMatrix<f64> {
    let isa = Isa::detect();
    let fit = |rows: usize, columns: usize| a.nrows() >= rows && b.ncols() >= columns;
    match isa {
        Isa::Avx512 if fit(TALL, TALL) => tiles::<TALL, TALL>(isa, a, b, upper),
        Isa::Avx2 | Isa::Avx512 if fit(TALL, TILE) => tiles::<TALL, TILE>(isa, a, b, upper),
        _ if fit(TILE, TILE) => tiles::<TILE, TILE>(isa, a, b, upper),
        _ => a * b,
    }
}

/// The tiles of `a · b`, or of its `upper` triangle alone.
fn tiles<const R: usize, const C: usize>(isa: Isa, a: &DMatrix<f64>, b: &DMatrix<f64>, upper: bool) -> DMatrix<f64> {
    let (rows, columns) = (a.nrows(), b.ncols());
    let mut out = DMatrix::zeros(rows, columns);
    let width = columns.div_ceil((columns / TASK).max(1));
    out.as_mut_slice()
        .par_chunks_mut(rows * width)
        .enumerate()
        .for_each(|(task, out)| dispatch(isa, Tiles::<R, C> { a, b, first: task * width, out, upper }));
    out
}

/// The tiles of some columns.
struct Tiles<'a, const R: usize, const C: usize> {
    a: &'a DMatrix<f64>,
    b: &'a DMatrix<f64>,
    /// The first column.
    first: usize,
    out: &'a mut [f64],
    upper: bool,
}

impl<const R: usize, const C: usize> Hot for Tiles<'_, R, C> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { a, b, first, out, upper } = self;
        let rows = a.nrows();
        for i in firsts(rows, R) {
            for j in firsts(out.len() / rows, C) {
                if upper && i >= first + j + C {
                    continue;
                }
                for (c, sums) in tile::<R, C>(a, b, i, first + j).iter().enumerate() {
                    out[(j + c) * rows + i..][..R].copy_from_slice(sums);
                }
            }
        }
    }
}

/// Where tiles of this `side` begin; the last one overlaps with the one before.
fn firsts(size: usize, side: usize) -> impl Iterator<Item = usize> {
    (0..size).step_by(side).map(move |first| first.min(size - side))
}

/// `[column][row]`, each summed upwards from its first product.
#[inline(always)]
fn tile<const R: usize, const C: usize>(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    row: usize,
    column: usize,
) -> [[f64; R]; C] {
    let (inner, rows) = (b.nrows(), a.nrows());
    let a = &a.as_slice()[..rows * inner];
    let b: [&[f64]; C] = std::array::from_fn(|c| &b.as_slice()[(column + c) * inner..][..inner]);
    let mut sums = [[0.0; R]; C];
    for l in 0..inner {
        let Some(x) = a[l * rows + row..].first_chunk::<R>() else { break };
        for c in 0..C {
            let y = b[c][l];
            for r in 0..R {
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
    dispatch(Isa::detect(), Times { a, x: x.as_slice(), out: out.as_mut_slice() });
    out
}

struct Times<'a> {
    a: &'a DMatrix<f64>,
    x: &'a [f64],
    out: &'a mut [f64],
}

impl Hot for Times<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { a, x, out: y } = self;
        let rows = a.nrows().max(1);
        let Some((first, x)) = x.split_first() else { return };
        let (start, a) = a.as_slice().split_at(a.nrows());
        for (y, a) in y.iter_mut().zip(start) {
            *y = a * first;
        }
        let ((x, x_rest), columns) = (x.as_chunks::<TILE>(), a.chunks_exact(TILE * rows));
        let rest = columns.remainder().chunks_exact(rows);
        for (columns, [p, q, r, s]) in columns.zip(x) {
            let (a, columns) = columns.split_at(rows);
            let (b, columns) = columns.split_at(rows);
            let (c, d) = columns.split_at(rows);
            for (i, y) in y.iter_mut().enumerate() {
                *y = *y + a[i] * p + b[i] * q + c[i] * r + d[i] * s;
            }
        }
        for (column, x) in rest.zip(x_rest) {
            add_scaled(y, *x, column);
        }
    }
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
    for (y, x) in y.iter_mut().zip(x) {
        *y += scale * x;
    }
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
