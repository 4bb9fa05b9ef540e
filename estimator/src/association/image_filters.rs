//! Filters on row-major images of `w` × `h` pixels.

use glam::Vec3;
use rayon::prelude::*;

/// Rows of one parallel task.
pub const ROWS: usize = 32;

/// Grows a mask by `radius` pixels along both axes.
pub fn dilated(mask: &[bool], w: usize, h: usize, radius: usize) -> Vec<bool> {
    separable(mask, w, h, radius, |a, b| a | b)
}

/// Smallest value within `radius` pixels along both axes.
pub fn min_filtered(image: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    separable(image, w, h, radius, f32::min)
}

/// Joins the pixels within `radius` of every pixel, along rows, then along columns, by what does not mind how often it meets one.
/// Windows end at the border.
fn separable<T: Copy>(image: &[T], w: usize, h: usize, radius: usize, join: impl Fn(T, T) -> T) -> Vec<T> {
    let join_all = |out: &mut [T], other: &[T]| out.iter_mut().zip(other).for_each(|(o, x)| *o = join(*o, *x));
    let mut rows = image.to_vec();
    for (row, source) in rows.chunks_exact_mut(w).zip(image.chunks_exact(w)) {
        for shift in 1..(radius + 1).min(w) {
            join_all(&mut row[shift..], source);
            join_all(&mut *row, &source[shift..]);
        }
    }
    let mut out = rows.clone();
    for shift in 1..(radius + 1).min(h) {
        join_all(&mut out[shift * w..], &rows);
        join_all(&mut out, &rows[shift * w..]);
    }
    out
}

/// Binomial 3 × 3 mean; NaN spreads to the neighbours, and the border is NaN.
pub fn binomial(image: &[Vec3], w: usize, h: usize) -> Vec<Vec3> {
    let mut out = vec![Vec3::NAN; w * h];
    if w < 3 || h < 3 {
        return out;
    }
    let mean = |out: &mut [Vec3], before: &[Vec3], middle: &[Vec3], after: &[Vec3]| {
        let [before, middle, after]: [&[f32]; 3] = [before, middle, after].map(bytemuck::cast_slice);
        let out: &mut [f32] = bytemuck::cast_slice_mut(out);
        for (((o, a), b), c) in out.iter_mut().zip(before).zip(middle).zip(after) {
            *o = 0.25 * (a + c) + 0.5 * b;
        }
    };
    out.par_chunks_mut(w * ROWS).enumerate().for_each(|(task, out)| {
        // Means along these rows and their neighbours.
        let first = (task * ROWS).saturating_sub(1);
        let last = (task * ROWS + out.len() / w).min(h - 1);
        let mut rows = vec![Vec3::NAN; w * (last + 1 - first)];
        for (mean_row, row) in rows.chunks_exact_mut(w).zip(image[first * w..].chunks_exact(w)) {
            mean(&mut mean_row[1..w - 1], row, &row[1..], &row[2..]);
        }
        for (y, out) in (task * ROWS..).zip(out.chunks_exact_mut(w)).filter(|(y, _)| (1..h - 1).contains(y)) {
            let around = &rows[(y - 1 - first) * w..];
            mean(out, &around[..w], &around[w..], &around[2 * w..]);
        }
    });
    out
}

/// Extends an image over its unknown pixels (`None`) by averages on ever coarser grids (push–pull); NaN if all are unknown.
pub fn push_pull(image: impl Iterator<Item = Option<Vec3>>, w: usize, h: usize) -> Vec<Vec3> {
    let cells = image.map(|c| c.map_or((Vec3::ZERO, 0.0), |c| (c, 1.0))).collect();
    let mut levels = vec![Grid { w, h, cells }];
    while let Some(last) = levels.last().filter(|l| l.w > 1 || l.h > 1) {
        levels.push(last.halved());
    }
    // From coarse to fine: coarse cells fill what finer ones lack.
    let Some(mut current) = levels.pop() else { return Vec::new() };
    while let Some(mut finer) = levels.pop() {
        for y in 0..finer.h {
            for x in 0..finer.w {
                let (coarse, known) = current.cells[(y / 2) * current.w + x / 2];
                let cell = &mut finer.cells[y * finer.w + x];
                if cell.1 < 1.0 && known > 0.0 {
                    *cell = ((cell.0 * cell.1 + coarse * (1.0 - cell.1)), 1.0);
                }
            }
        }
        current = finer;
    }
    current.cells.iter().map(|&(c, known)| if known > 0.0 { c } else { Vec3::NAN }).collect()
}

/// Mean colours with their weights (0 to 1).
struct Grid {
    w: usize,
    h: usize,
    cells: Vec<(Vec3, f32)>,
}

impl Grid {
    fn halved(&self) -> Self {
        let (w, h) = (self.w.div_ceil(2), self.h.div_ceil(2));
        let mut cells = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut known) = (Vec3::ZERO, 0.0);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (px, py) = (2 * x + dx, 2 * y + dy);
                    if px < self.w && py < self.h {
                        let (c, k) = self.cells[py * self.w + px];
                        sum += c * k;
                        known += k;
                    }
                }
                cells.push(if known > 0.0 { (sum / known, known.min(1.0)) } else { (Vec3::ZERO, 0.0) });
            }
        }
        Self { w, h, cells }
    }
}
