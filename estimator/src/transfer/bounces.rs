//! Interreflection (Eq. 8): t(b+1)_ik = t(0)_ik + 1/N Σ over hits h of albedo(h) · t(b)_k(h), one sparse product a bounce.

use crate::transfer::traced::Traced;
use crate::transfer::vertex::INDIRECT;
use glam::Vec3;
use isa::{Hot, Isa, dispatch};
use rayon::prelude::*;

/// Coefficients of a vertex: `[channel][k]`.
const ROW: usize = 3 * INDIRECT;
/// Vertices of one parallel task.
const BLOCK: usize = 256;
/// The series has converged once a bounce adds less than this share of the light.
const BOUNCE_TOLERANCE: f64 = 1e-3;
/// Maximum ratio of the geometric rest of the series, that of albedos of 0.9995.
const MAX_RATIO: f64 = 0.9995;
/// Maximum number of bounces before the rest of the series is taken as geometric.
const MAX_BOUNCES: u32 = 16;

/// Interreflected light for one set of albedos.
#[derive(Debug, Clone)]
pub struct Bounced {
    /// `[vertex][channel][INDIRECT]`.
    rows: Vec<f32>,
    /// What arrives of the sun by bounces, where it is beside the harmonics: `[vertex]`.
    sun: Vec<Vec3>,
    /// Bounces made.
    pub bounces: u32,
    /// Share of all bounces in the light.
    pub share: f64,
    /// Share that the last bounce added.
    pub last_share: f64,
}

impl Bounced {
    /// Interreflection of one vertex and channel: `[k]`, the first five bands.
    pub(super) fn row(&self, vertex: usize, channel: usize) -> &[f32] {
        &self.rows[vertex * ROW + channel * INDIRECT..][..INDIRECT]
    }

    /// The same of the sun; 0 without one.
    pub(super) fn sun(&self, vertex: usize, channel: usize) -> f32 {
        self.sun.get(vertex).map_or(0.0, |s| s[channel])
    }
}

/// Bounces light between the vertices. `albedo` is `[vertex]`, linear RGB; `bounces` = 0 goes on until convergence and takes
/// the rest of the series as geometric.
#[must_use]
pub fn bounce(traced: &Traced, albedo: &[Vec3], bounces: u32) -> Bounced {
    let mut rows = vec![0.0f32; traced.vertices() * ROW];
    let limit = if bounces == 0 { MAX_BOUNCES } else { bounces };
    let Series { bounces, share, last_share } = series::<INDIRECT>(traced, albedo, &mut rows, limit, bounces == 0);
    Bounced { rows, sun: bounced_sun(traced, albedo), bounces, share, last_share }
}

/// Bounces until convergence, starting from the bounces `from` for other albedos or rays: the fixed point is the same, and
/// fewer bounces reach it.
#[must_use]
pub fn bounce_on(traced: &Traced, albedo: &[Vec3], mut from: Bounced) -> Bounced {
    let Series { bounces, share, last_share } = series::<INDIRECT>(traced, albedo, &mut from.rows, MAX_BOUNCES, true);
    let (sun, bounces) = (bounced_sun(traced, albedo), from.bounces.max(bounces));
    Bounced { rows: from.rows, sun, bounces, share, last_share }
}

/// Makes `bounces` bounces and scales each vertex and channel by the ratio of the converged series to them under a uniform
/// sky. That ratio needs one coefficient only, so it is cheap. Like [`bounce`] for `bounces` = 0.
#[must_use]
pub fn bounce_scaled(traced: &Traced, albedo: &[Vec3], bounces: u32) -> Bounced {
    let mut bounced = bounce(traced, albedo, bounces);
    if bounces > 0 {
        let first: Vec<f32> = bounced.rows.iter().step_by(INDIRECT).copied().collect();
        let mut all = first.clone();
        bounced.share = series::<1>(traced, albedo, &mut all, MAX_BOUNCES, true).share;
        for ((row, first), all) in bounced.rows.chunks_mut(INDIRECT).zip(first).zip(all) {
            if first > 0.0 {
                row.iter_mut().for_each(|t| *t *= all / first);
            }
        }
    }
    bounced
}

/// Irradiance over π with all bounces, for light that spherical harmonics do not tell: `direct` is what arrives straight,
/// `[vertex]`.
#[must_use]
pub fn bounce_light(traced: &Traced, albedo: &[Vec3], direct: &[Vec3]) -> Vec<Vec3> {
    let scale = 1.0 / traced.hit_rays.max(1) as f32;
    let size = |of: &[Vec3]| libm::sqrt(of.iter().map(|e| f64::from(e.length_squared())).sum::<f64>());
    let (mut last, mut total) = (direct.to_vec(), direct.to_vec());
    let mut before = size(direct);
    for bounce in 1..=MAX_BOUNCES {
        let radiosity: Vec<Vec3> = last.par_iter().zip(albedo).map(|(e, a)| *e * *a).collect();
        let arriving = |v: usize| traced.hits(v).iter().map(|&h| radiosity[h as usize]).sum::<Vec3>() * scale;
        last = (0..total.len()).into_par_iter().map(arriving).collect();
        let now = size(&last);
        let ratio = if before > 0.0 { (now / before).min(MAX_RATIO) } else { 0.0 };
        // The last bounce stands for the geometric rest of the series.
        let end = bounce == MAX_BOUNCES || now <= BOUNCE_TOLERANCE * size(direct);
        let weight = if end { (1.0 / (1.0 - ratio)) as f32 } else { 1.0 };
        total.iter_mut().zip(&last).for_each(|(t, e)| *t += *e * weight);
        if end {
            break;
        }
        before = now;
    }
    total
}

/// What arrives of the sun by bounces, `[vertex]`; empty without one.
fn bounced_sun(traced: &Traced, albedo: &[Vec3]) -> Vec<Vec3> {
    let Some(sun) = &traced.sun else { return Vec::new() };
    let direct: Vec<Vec3> = sun.direct.iter().map(|e| Vec3::splat(*e)).collect();
    let mut arriving = bounce_light(traced, albedo, &direct);
    arriving.iter_mut().zip(&direct).for_each(|(all, direct)| *all -= *direct);
    arriving
}

/// Summary of a series of bounces.
struct Series {
    bounces: u32,
    share: f64,
    last_share: f64,
}

/// Bounces the first `K` coefficients, starting from `rows`: `[vertex][channel][K]`, at most `limit` times. With `converge`,
/// stops at convergence, and adds the geometric rest at the last bounce.
fn series<const K: usize>(traced: &Traced, albedo: &[Vec3], rows: &mut [f32], limit: u32, converge: bool) -> Series {
    let count = traced.vertices();
    let k = traced.bands * traced.bands;
    let direct = |i: usize| &traced.direct[i * k..i * k + k.min(K)];
    let scale = 1.0 / traced.hit_rays.max(1) as f32;
    let direct_norm =
        libm::sqrt((0..count).map(|i| f64::from(direct(i).first().copied().unwrap_or(0.0)).powi(2)).sum());
    let (mut bounces, mut share, mut last, mut before) = (0, 0.0, 0.0, 0.0);
    if traced.corners.is_empty() || direct_norm == 0.0 {
        return Series { bounces, share, last_share: last };
    }
    let mut radiosity = vec![0.0f32; count * 3 * K];
    let isa = Isa::detect();
    while bounces < limit {
        // Radiosity of every vertex: its albedo times all light that arrives so far.
        radiosity.par_chunks_mut(3 * K).zip(rows.par_chunks(3 * K)).enumerate().for_each(|(i, (out, row))| {
            let direct = direct(i);
            for c in 0..3 {
                let a = albedo[i][c];
                for j in 0..direct.len() {
                    out[c * K + j] = a * (direct[j] + row[c * K + j]);
                }
            }
        });
        // A closed white room would need thousands of bounces: by the last one the series is geometric.
        let ratio: f64 = if before > 0.0 { (last / before).min(MAX_RATIO) } else { 0.0 };
        let rest = if converge && bounces + 1 == limit { (ratio / (1.0 - ratio)) as f32 } else { 0.0 };
        let changes: Vec<[f64; 2]> = rows
            .par_chunks_mut(3 * K * BLOCK)
            .enumerate()
            .map(|(block, rows)| {
                let first = block * BLOCK;
                dispatch(isa, Bounce::<K> { traced, radiosity: &radiosity, first, rows, scale, rest })
            })
            .collect();
        let [change, size] = changes.iter().fold([0.0; 2], |s, c| [s[0] + c[0], s[1] + c[1]]).map(libm::sqrt);
        bounces += 1;
        before = last;
        last = change / direct_norm;
        share = size / direct_norm;
        if converge && last < BOUNCE_TOLERANCE {
            break;
        }
    }
    Series { bounces, share, last_share: last }
}

/// One bounce to some vertices.
struct Bounce<'a, const K: usize> {
    traced: &'a Traced,
    /// `[vertex][channel][K]`.
    radiosity: &'a [f32],
    /// The first vertex.
    first: usize,
    /// `[vertex][channel][K]`.
    rows: &'a mut [f32],
    /// One over the rays of a vertex.
    scale: f32,
    /// What the change is multiplied by for the bounces to come.
    rest: f32,
}

impl<const K: usize> Hot for Bounce<'_, K> {
    /// Σ of the squares of what changed, and of what arrives, in the first coefficients.
    type Output = [f64; 2];

    #[inline(always)]
    fn run(self) -> [f64; 2] {
        let Self { traced, radiosity, first, rows, scale, rest } = self;
        let mut change = [0.0; 2];
        for (j, row) in rows.chunks_mut(3 * K).enumerate() {
            let mut sums = [[0.0f32; K]; 3];
            let sum = sums.as_flattened_mut();
            for &corner in traced.hits(first + j) {
                let from = &radiosity[corner as usize * 3 * K..][..3 * K];
                for (s, x) in sum.iter_mut().zip(from) {
                    *s += x;
                }
            }
            for (c, old) in row.iter().step_by(K).enumerate() {
                let new = f64::from(sum[c * K] * scale);
                change[0] += (new - f64::from(*old)).powi(2) / 3.0;
                change[1] += new.powi(2) / 3.0;
            }
            for (r, s) in row.iter_mut().zip(sum) {
                *r = *s * scale + (*s * scale - *r) * rest;
            }
        }
        change
    }
}
