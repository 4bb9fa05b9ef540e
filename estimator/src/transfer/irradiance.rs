//! Transfer rows and irradiance: E_i = Σ_k t_ik i_k.

use crate::transfer::bounces::Bounced;
use crate::transfer::sun::Sun;
use crate::transfer::traced::Traced;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Transfer of every vertex: the traced part and, for gi, the bounced part.
#[derive(Debug)]
pub struct Transfer {
    /// Direct part.
    pub traced: Arc<Traced>,
    /// Interreflection, if it is modelled.
    pub bounced: Option<Bounced>,
}

impl Transfer {
    /// Coefficients of a row: bands².
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.traced.bands * self.traced.bands
    }

    /// Writes t_ik of one vertex and channel to `out`: `[k]`, at most bands² values; the sun's at the end, where there is one.
    pub fn row(&self, vertex: usize, channel: usize, out: &mut [f64]) {
        let k = self.coefficients();
        let (out, last) = out.split_at_mut(self.harmonics(out.len()));
        if let (Some(sun), Some(last)) = (&self.traced.sun, last.first_mut()) {
            *last = self.of_sun(sun, vertex, channel);
        }
        let direct = &self.traced.direct[vertex * k..(vertex + 1) * k];
        out.iter_mut().zip(direct).for_each(|(o, t)| *o = f64::from(*t));
        if let Some(bounced) = &self.bounced {
            out.iter_mut().zip(bounced.row(vertex, channel)).for_each(|(o, t)| *o += f64::from(*t));
        }
    }

    /// How many of so many coefficients are of harmonics: all but the sun's.
    fn harmonics(&self, coefficients: usize) -> usize {
        coefficients.saturating_sub(usize::from(self.traced.sun.is_some()))
    }

    /// The transfer of the sun, straight and by bounces.
    fn of_sun(&self, sun: &Sun, vertex: usize, channel: usize) -> f64 {
        let bounced = self.bounced.as_ref().map_or(0.0, |b| b.sun(vertex, channel));
        f64::from(sun.direct[vertex] + bounced)
    }

    /// Irradiance over π under `light`, linear RGB: `[vertex]`. `light` is `[k][channel]`, the sun's at the end, where there is one.
    #[must_use]
    pub fn irradiance(&self, light: &[[f64; 3]]) -> Vec<Vec3> {
        let k = self.coefficients();
        let (light, suns) = light.split_at(self.harmonics(light.len()));
        (0..self.traced.vertices())
            .into_par_iter()
            .map(|i| {
                let direct = &self.traced.direct[i * k..(i + 1) * k];
                let mut sum = [0.0f64; 3];
                for (t, l) in direct.iter().zip(light) {
                    for c in 0..3 {
                        sum[c] += f64::from(*t) * l[c];
                    }
                }
                if let Some(bounced) = &self.bounced {
                    for (c, sum) in sum.iter_mut().enumerate() {
                        *sum += bounced.row(i, c).iter().zip(light).map(|(t, l)| f64::from(*t) * l[c]).sum::<f64>();
                    }
                }
                if let (Some(sun), Some(power)) = (&self.traced.sun, suns.first()) {
                    for (c, sum) in sum.iter_mut().enumerate() {
                        *sum += self.of_sun(sun, i, c) * power[c];
                    }
                }
                Vec3::new(sum[0] as f32, sum[1] as f32, sum[2] as f32)
            })
            .collect()
    }
}
