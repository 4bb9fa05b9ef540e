//! Rejection of grazing and flying depth pixels, and of those beside a nearer surface.

use firmware_config::tuning::DepthNoise;
use isa::Hot;

/// Copies a depth image (metres, row-major, 0 = none) without the pixels that differ from a neighbour by more than a surface of
/// the steepest accepted slope would: those that have a nearer neighbour (of eight), and those that are nearer than both
/// neighbours in their row or column.
///
/// Matching windows shift outlines by up to a pixel, so a pixel beside a nearer surface may show either of the two. Taken for
/// the farther one, it tells the volume that the nearer surface's rim is free space.
pub struct RejectSteep<'a> {
    pub raw: &'a [f32],
    pub out: &'a mut [f32],
    pub width: usize,
    pub height: usize,
    /// Largest difference between neighbours, as a share of the depth, …
    pub slope: f32,
    /// … plus this many standard deviations of the noise.
    pub sigmas: f32,
    pub noise: DepthNoise,
}

impl Hot for RejectSteep<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { raw, out, width, height, slope, sigmas, noise } = self;
        for y in 0..height {
            let row = |r: usize| &raw[r * width..(r + 1) * width];
            let (up, here, down) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
            let target = &mut out[y * width..(y + 1) * width];
            if width < 3 {
                target.copy_from_slice(here);
                continue;
            }
            target[0] = 0.0;
            target[width - 1] = 0.0;
            let n = width - 2;
            let [(ul, u, ur), (l, c, r), (dl, d, dr)] = [up, here, down].map(|q| (&q[..n], &q[1..=n], &q[2..]));
            let target = &mut target[1..=n];
            for i in 0..n {
                let z = c[i];
                let known = |q: f32| if q > 0.0 { q } else { z };
                let either = |q: f32, other: f32| if q > 0.0 { q } else { known(other) };
                let nearer = |p: f32, q: f32| either(p, q).min(either(q, p));
                let (across, along) = (nearer(l[i], r[i]), nearer(u[i], d[i]));
                let corners = known(ul[i]).min(known(ur[i])).min(known(dl[i]).min(known(dr[i])));
                let nearest = across.min(along).min(corners);
                let limit = slope * z + sigmas * noise.sigma_m(z);
                let alone = ((l[i] <= 0.0) & (r[i] <= 0.0)) | ((u[i] <= 0.0) & (d[i] <= 0.0));
                target[i] = if (z - nearest < limit) & (across.max(along) - z < limit) & !alone { z } else { 0.0 };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::tuning::DepthNoiseTuning;
    use isa::{Isa, dispatch};

    /// `rows` of depth, filtered.
    fn filtered<const W: usize, const H: usize>(rows: [[f32; W]; H]) -> [[f32; W]; H] {
        let raw = rows.concat();
        let mut out = vec![0.0; raw.len()];
        let noise = DepthNoiseTuning::default().model();
        let (raw, target) = (&raw[..], &mut out[..]);
        dispatch(Isa::detect(), RejectSteep { raw, out: target, width: W, height: H, slope: 0.01, sigmas: 1.5, noise });
        std::array::from_fn(|y| std::array::from_fn(|x| out[y * W + x]))
    }

    #[test]
    fn the_rim_of_the_nearer_surface_stays_and_that_of_the_farther_one_goes() {
        let row = [1.0, 1.0, 1.0, 1.0, 1.5, 1.5, 1.5, 1.5];
        assert_eq!(filtered([row; 4])[1], [0.0, 1.0, 1.0, 1.0, 0.0, 1.5, 1.5, 0.0]);
        let out = filtered([[1.0; 5], [1.0; 5], [1.0; 5], [1.5; 5], [1.5; 5], [1.5; 5]]);
        assert_eq!(out.map(|row| row[2]), [1.0, 1.0, 1.0, 0.0, 1.5, 1.5]);
    }

    #[test]
    fn flying_pixels_go() {
        let row = [1.0, 1.0, 1.0, 1.25, 1.5, 1.5, 1.5, 1.5];
        assert_eq!(filtered([row; 4])[1], [0.0, 1.0, 1.0, 0.0, 0.0, 1.5, 1.5, 0.0]);
        let row = [1.5, 1.5, 1.5, 1.0, 1.5, 1.5, 1.5, 1.5];
        assert_eq!(filtered([row; 4])[1], [0.0, 1.5, 0.0, 0.0, 0.0, 1.5, 1.5, 0.0], "nearer than both neighbours");
    }

    #[test]
    fn slopes_stay_and_steeper_ones_go() {
        let of = |step: f32| filtered([std::array::from_fn::<f32, 8, _>(|x| 1.0 + step * x as f32); 4])[1];
        assert!(of(0.01)[1..7].iter().all(|z| *z > 0.0));
        assert!(of(0.03)[1..7].iter().all(|z| *z == 0.0));
    }
}
