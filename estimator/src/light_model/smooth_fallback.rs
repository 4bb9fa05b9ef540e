//! What a smooth function of position and normal explains of lit colours: the least that a model of light must do.

use crate::light_model::samples::Samples;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use recordings::types::Mesh;

/// Terms: linear and quadratic in normal and position, and their products.
const TERMS: usize = 3 + 5 + 3 + 6 + 9;
/// Ridge, as a share of the mean diagonal.
const RIDGE: f64 = 1e-4;
/// Log light that is reached at most, beyond the terms' mean.
const MAX_LOG: f64 = 2.5;

/// log E = Σ c φ(x, n), least squares of log f within segments.
#[derive(Debug, Clone)]
pub struct Smooth {
    center: Vec3,
    size: f32,
    mean: [f64; TERMS],
    coefficients: [[f64; TERMS]; 3],
}

impl Smooth {
    /// Fits what is not held out.
    #[must_use]
    pub fn fit(mesh: &Mesh, samples: &Samples) -> Self {
        let count = samples.len().max(1) as f32;
        let position = |n: usize| mesh.positions[samples.vertex[n] as usize];
        let center = (0..samples.len()).map(position).sum::<Vec3>() / count;
        let spread = (0..samples.len()).map(|n| position(n).distance_squared(center)).sum::<f32>() / count;
        let mut fit = Self {
            center,
            size: spread.sqrt().max(f32::MIN_POSITIVE),
            mean: [0.0; TERMS],
            coefficients: [[0.0; TERMS]; 3],
        };
        let fitted: Vec<usize> = samples.fitted().collect();
        let rows: Vec<[f64; TERMS]> = fitted.iter().map(|&n| fit.terms(mesh, samples.vertex[n] as usize)).collect();
        let mut weight = vec![0.0; samples.segments];
        let mut means = vec![[0.0; TERMS + 3]; samples.segments];
        let brightest: [f64; 3] = [0, 1, 2].map(|c| samples.medians.iter().map(|m| m[c]).fold(0.0, f64::max));
        let log = |n: usize| [0, 1, 2].map(|c| libm::log(samples.color[n][c].max(1e-4 * brightest[c]).max(1e-30)));
        for (&n, row) in fitted.iter().zip(&rows) {
            let (s, w) = (samples.segment[n] as usize, samples.weight[n]);
            weight[s] += w;
            means[s].iter_mut().zip(row.iter().chain(&log(n))).for_each(|(m, x)| *m += w * x);
        }
        means.iter_mut().zip(&weight).for_each(|(m, w)| m.iter_mut().for_each(|x| *x /= w.max(1e-30)));
        let total: f64 = weight.iter().sum::<f64>().max(1e-30);
        for (m, w) in means.iter().zip(&weight) {
            fit.mean.iter_mut().zip(m).for_each(|(all, x)| *all += w * x / total);
        }
        let mut gram = DMatrix::<f64>::zeros(TERMS, TERMS);
        let mut cross = [DVector::zeros(TERMS), DVector::zeros(TERMS), DVector::zeros(TERMS)];
        for (&n, row) in fitted.iter().zip(&rows) {
            let (m, w) = (&means[samples.segment[n] as usize], samples.weight[n]);
            let centered = DVector::from_fn(TERMS, |k, _| row[k] - m[k]);
            gram.ger(w, &centered, &centered, 1.0);
            let log = log(n);
            for ((cross, log), mean) in cross.iter_mut().zip(log).zip(&m[TERMS..]) {
                cross.axpy(w * (log - mean), &centered, 1.0);
            }
        }
        let ridge = RIDGE * gram.trace() / TERMS as f64;
        (0..TERMS).for_each(|k| gram[(k, k)] += ridge.max(f64::MIN_POSITIVE));
        if let Some(factor) = gram.cholesky() {
            for (coefficients, cross) in fit.coefficients.iter_mut().zip(&cross) {
                coefficients.iter_mut().zip(factor.solve(cross).iter()).for_each(|(k, x)| *k = *x);
            }
        }
        fit
    }

    /// E over π at a vertex, per channel, up to one factor.
    #[must_use]
    pub fn irradiance(&self, mesh: &Mesh, vertex: usize) -> [f64; 3] {
        let terms = self.terms(mesh, vertex);
        self.coefficients.map(|k| {
            let log: f64 = k.iter().zip(terms.iter().zip(&self.mean)).map(|(k, (t, m))| k * (t - m)).sum();
            libm::exp(log.clamp(-MAX_LOG, MAX_LOG))
        })
    }

    /// The same at the samples: `[sample][channel]`.
    #[must_use]
    pub fn at(&self, mesh: &Mesh, samples: &Samples) -> Vec<[f64; 3]> {
        samples.vertex.iter().map(|i| self.irradiance(mesh, *i as usize)).collect()
    }

    fn terms(&self, mesh: &Mesh, vertex: usize) -> [f64; TERMS] {
        let n = mesh.normals[vertex].to_array().map(f64::from);
        let p = ((mesh.positions[vertex] - self.center) / self.size).to_array().map(f64::from);
        let quadratic = |v: [f64; 3]| [v[0] * v[1], v[1] * v[2], v[0] * v[2], v[0] * v[0], v[1] * v[1], v[2] * v[2]];
        let mut terms = [0.0; TERMS];
        terms[..3].copy_from_slice(&n);
        // A unit normal's squares sum to one: two of them suffice.
        terms[3..8].copy_from_slice(&quadratic(n)[..5]);
        terms[8..11].copy_from_slice(&p);
        terms[11..17].copy_from_slice(&quadratic(p));
        for i in 0..9 {
            terms[17 + i] = n[i / 3] * p[i % 3];
        }
        terms
    }
}
