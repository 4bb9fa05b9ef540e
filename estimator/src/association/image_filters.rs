//! Filters on row-major images of `w` × `h` pixels.

use glam::Vec3;

/// Grows a mask by `radius` pixels along both axes.
pub fn dilated(mask: &[bool], w: usize, h: usize, radius: usize) -> Vec<bool> {
    separable(mask, w, h, radius, |window| window.iter().any(|&m| m))
}

/// Smallest value within `radius` pixels along both axes.
pub fn min_filtered(image: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    separable(image, w, h, radius, |window| window.iter().copied().fold(f32::INFINITY, f32::min))
}

/// Applies `filter` to the window of `radius` pixels around every pixel, along rows, then along columns. Windows end at the
/// border.
fn separable<T: Copy>(image: &[T], w: usize, h: usize, radius: usize, filter: impl Fn(&[T]) -> T) -> Vec<T> {
    let mut out = image.to_vec();
    let mut pass = |start: usize, stride: usize, n: usize| {
        let line: Vec<T> = (0..n).map(|k| out[start + k * stride]).collect();
        for k in 0..n {
            out[start + k * stride] = filter(&line[k.saturating_sub(radius)..(k + radius + 1).min(n)]);
        }
    };
    (0..h).for_each(|y| pass(y * w, 1, w));
    (0..w).for_each(|x| pass(x, w, h));
    out
}

/// Binomial 3 × 3 mean; NaN spreads to the neighbours, and the border is NaN.
pub fn binomial(image: &[Vec3], w: usize, h: usize) -> Vec<Vec3> {
    let mut rows = vec![Vec3::NAN; w * h];
    for y in 0..h {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            rows[i] = 0.25 * (image[i - 1] + image[i + 1]) + 0.5 * image[i];
        }
    }
    let mut out = vec![Vec3::NAN; w * h];
    for y in 1..h.saturating_sub(1) {
        for x in 0..w {
            let i = y * w + x;
            out[i] = 0.25 * (rows[i - w] + rows[i + w]) + 0.5 * rows[i];
        }
    }
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
