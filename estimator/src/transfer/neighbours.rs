//! Rays shared by neighbours: what the rays of a vertex say is averaged with what those of its neighbours say where both agree within
//! their errors.

use crate::mesh::graph::Graph;
use crate::numerics::sh;
use crate::transfer::vertex::{INDIRECT, cosine_lobe, is_unit};
use glam::Vec3;
use rayon::prelude::*;

/// A neighbour counts by the cosine between both normals to this power: what is blocked depends on the normal.
const SHARPNESS: i32 = 8;
/// Squared difference, over what the errors of both explain, up to which a neighbour agrees; its weight falls to 1/e over as much again.
const AGREED: f32 = 2.0;
/// Error of an average, over what the errors of its rays make it: neighbours that agree differ by a little. Measured.
const DIFFERENCE: f32 = 1.25;

/// Averages the blocked part of the transfer over every vertex and its neighbours, a neighbour by how well both agree (Buades, Coll and
/// Morel, "A non-local algorithm for image denoising", 2005). The unblocked part is known without rays. `direct` is
/// `[vertex][bands²]`, `error` `[vertex]`, as in [`crate::transfer::Traced`]; the averages take its place. Returns their error over what it
/// was, over all vertices.
pub(super) fn share(graph: &Graph, normals: &[Vec3], bands: usize, direct: &mut [f32], error: &[f32]) -> f64 {
    let k = bands * bands;
    let mut blocked = vec![0.0; direct.len()];
    blocked.par_chunks_mut(k).zip(direct.par_chunks(k)).zip(normals).for_each(|((row, all), n)| {
        row.copy_from_slice(all);
        add_lobe(row, *n, -1.0);
    });
    // The errors of single vertices are themselves uncertain.
    let around = |i: usize| graph.neighbours(i).iter().map(|&j| j as usize).chain([i]);
    let variance = |i: usize| around(i).map(|j| error[j] * error[j]).sum::<f32>() / around(i).count() as f32;
    let variance: Vec<f32> = (0..graph.vertices()).into_par_iter().map(variance).collect();
    let row = |v: usize| &blocked[v * k..][..k];
    let agreement = |i: usize, j: usize| {
        let square: f32 = row(i).iter().zip(row(j)).take(INDIRECT).map(|(a, b)| (a - b) * (a - b)).sum();
        let explained = variance[i] + variance[j];
        let excess = (square / explained / AGREED - 1.0).max(0.0);
        let facing = normals[i].dot(normals[j]).clamp(0.0, 1.0).powi(SHARPNESS);
        let weight = facing * libm::expf(-excess);
        if weight > 0.0 { weight } else { 0.0 }
    };
    let average = |(i, average): (usize, &mut [f32])| {
        // Rays that all escape or all are blocked leave nothing to average: no light at all stays none.
        if error[i] == 0.0 {
            return 0.0;
        }
        average.copy_from_slice(row(i));
        let (mut total, mut squares) = (1.0, variance[i]);
        for j in graph.neighbours(i).iter().map(|&j| j as usize) {
            let weight = agreement(i, j);
            average.iter_mut().zip(row(j)).for_each(|(sum, t)| *sum += weight * t);
            total += weight;
            squares += weight * weight * variance[j];
        }
        average.iter_mut().for_each(|sum| *sum /= total);
        add_lobe(average, normals[i], 1.0);
        f64::from(if total > 1.0 { DIFFERENCE * DIFFERENCE * squares / (total * total) } else { squares })
    };
    let left: Vec<f64> = direct.par_chunks_mut(k).enumerate().map(average).collect();
    let own: f64 = error.iter().map(|e| f64::from(*e).powi(2)).sum();
    if own > 0.0 { libm::sqrt(left.iter().sum::<f64>() / own) } else { 1.0 }
}

/// Adds the transfer of an unblocked vertex times a factor; nothing where the normal is none and no ray was traced.
fn add_lobe(row: &mut [f32], normal: Vec3, factor: f32) {
    if is_unit(normal) {
        let mut lobe = [0.0; sh::MAX_COEFFICIENTS];
        cosine_lobe(normal, &mut lobe[..row.len()]);
        row.iter_mut().zip(lobe).for_each(|(t, lobe)| *t += factor * lobe);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random::{hash, unit};

    const SIDE: u32 = 24;
    const BANDS: usize = 3;
    const NOISE: f32 = 0.03;

    /// Root mean square over the vertices of what `direct` is off, as a norm, for a flat square whose transfer is what `blocked` says of
    /// the column, with noise, before and after; and the error that is stated then.
    fn off(blocked: impl Fn(u32) -> f32, noise: f32) -> [f32; 3] {
        let count = SIDE * SIDE;
        let mut triangles = Vec::new();
        for i in (0..count - SIDE).filter(|i| i % SIDE + 1 < SIDE) {
            triangles.extend([[i, i + 1, i + SIDE], [i + 1, i + SIDE + 1, i + SIDE]]);
        }
        let (k, normals) = (BANDS * BANDS, vec![Vec3::Z; count as usize]);
        let mut lobe = [0.0; BANDS * BANDS];
        cosine_lobe(Vec3::Z, &mut lobe);
        let value = |i: usize| lobe[i % k] - blocked((i / k) as u32 % SIDE);
        // Uniform, with a standard deviation of `noise`.
        let draw = |i: usize| 12f32.sqrt() * noise * (unit(hash(i as u32, 5)) - 0.5);
        let mut direct: Vec<f32> = (0..count as usize * k).map(|i| value(i) + draw(i)).collect();
        let error = vec![noise * (k as f32).sqrt(); count as usize];
        let rms = |direct: &[f32]| {
            let square: f32 = direct.iter().enumerate().map(|(i, t)| (t - value(i)).powi(2)).sum();
            (square / count as f32).sqrt()
        };
        let before = rms(&direct);
        let left = share(&Graph::new(count as usize, &triangles), &normals, BANDS, &mut direct, &error);
        [before, rms(&direct), left as f32 * error[0]]
    }

    #[test]
    fn noise_is_averaged_and_the_error_says_how_much_is_left() {
        let [before, after, stated] = off(|_| 0.1, NOISE);
        assert!(after < 0.5 * before, "{before} {after}");
        assert!(stated > after && stated < 1.5 * after, "{after} {stated}");
    }

    #[test]
    fn what_rays_tell_apart_stays_apart() {
        let step = |column| if column < SIDE / 2 { 0.1 } else { 0.2 };
        let [before, after, _] = off(step, 0.01);
        assert!(after < before, "{before} {after}");
        assert!(off(step, 0.0)[1] < 1e-6, "without noise nothing changes");
    }
}
