//! Rejection of grazing and flying depth pixels.

use firmware_config::tuning::DepthNoise;
use isa::Hot;

/// Copies a depth image (metres, row-major, 0 = none) without the pixels whose neighbours on both sides differ by more than
/// a surface of the steepest accepted slope would.
pub struct RejectSteep<'a> {
    pub raw: &'a [f32],
    pub out: &'a mut [f32],
    pub width: usize,
    pub height: usize,
    /// Largest difference of the neighbours, as a share of the depth, …
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
            let (l, c, r) = (&here[..n], &here[1..=n], &here[2..]);
            let (u, d, target) = (&up[1..=n], &down[1..=n], &mut target[1..=n]);
            for i in 0..n {
                let z = c[i];
                let known = |q: f32| if q > 0.0 { q } else { z };
                let dx = (known(r[i]) - known(l[i])).abs();
                let dy = (known(d[i]) - known(u[i])).abs();
                let limit = slope * z + sigmas * noise.sigma_m(z);
                let alone = ((l[i] <= 0.0) & (r[i] <= 0.0)) | ((u[i] <= 0.0) & (d[i] <= 0.0));
                target[i] = if (dx < limit) & (dy < limit) & !alone { z } else { 0.0 };
            }
        }
    }
}
