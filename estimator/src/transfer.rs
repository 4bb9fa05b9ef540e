//! Radiance transfer (Eq. 8): how much of each coefficient of the light arrives at each vertex, 1/π inside, the vertex's
//! own albedo outside.

use crate::mesh::vertex_weight::vertex_weights;
use crate::numerics::random::{CosineDirections, hash, unit};
use crate::numerics::sh;
use crate::rays::RayScene;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;
use std::sync::Arc;

/// Bands of interreflected light: every bounce convolves with a cosine, what is above is lost in it.
pub const INDIRECT_BANDS: usize = 5;
const INDIRECT: usize = INDIRECT_BANDS * INDIRECT_BANDS;
/// One row of interreflection: `[channel][k]`.
const ROW: usize = 3 * INDIRECT;
/// Vertices that one task traces.
const BLOCK: usize = 256;
/// Hits that are held at most, 4 bytes each. Where all would be more, bounces use the first rays of every vertex alone.
const MOST_HITS: u64 = 1 << 25;
/// Norm of the error over half the difference of the two half sets, measured against reference transfers.
const HALVES_TO_WHOLE: f64 = 0.68;
/// Twice the rays of a scrambled Sobol set have this share of the error.
pub const ERROR_OF_TWICE: f64 = 0.6;
/// Bounces go on until they add less than this share of the light.
const BOUNCE_TOLERANCE: f64 = 1e-3;
/// Largest ratio of that series: albedos of 0.9995.
const MOST_RATIO: f64 = 0.9995;
/// Bounces that `auto` makes at most before the rest is taken as a geometric series.
const MOST_BOUNCES: u32 = 16;

/// What the rays of every vertex found. Traced once: light and albedo may change without another ray.
#[derive(Debug)]
pub struct Traced {
    /// Bands of `direct`.
    pub bands: usize,
    /// Transfer without interreflection: `[vertex][bands²]`.
    pub direct: Vec<f32>,
    /// Cosine-weighted share of the hemisphere that is blocked: `[vertex]`.
    pub blocked: Vec<f32>,
    /// Estimated error of the first five bands of `direct`, as a norm over them: `[vertex]`.
    pub error: Vec<f32>,
    /// Weight of the vertex in the light's equations: little where its normal is doubtful.
    pub vertex_weight: Vec<f32>,
    /// Rays per vertex.
    pub rays: u32,
    /// Hits: one corner of the triangle, drawn by its barycentric weight; those of vertex i are
    /// `corners[offsets[i]..offsets[i + 1]]`.
    offsets: Vec<u32>,
    corners: Vec<u32>,
    /// Rays per vertex whose hits these are.
    hit_rays: u32,
}

/// Interreflected light per vertex and channel for one set of albedos.
#[derive(Debug, Clone)]
pub struct Bounced {
    /// `[vertex][channel][INDIRECT_BANDS²]`.
    rows: Vec<f32>,
    /// Bounces made.
    pub bounces: u32,
    /// Share of all light that arrives by bounces.
    pub share: f64,
    /// Share that the last bounce added.
    pub last_share: f64,
}

/// Transfer of every vertex: what was traced and, for gi, what was bounced.
#[derive(Debug)]
pub struct Transfer {
    /// Direct part.
    pub traced: Arc<Traced>,
    /// Interreflection, if it is modelled.
    pub bounced: Option<Bounced>,
}

/// Transfer of the cosine alone, in closed form.
#[must_use]
pub fn unoccluded(mesh: &Mesh, bands: usize) -> Traced {
    let k = bands * bands;
    let mut direct = vec![0.0f32; mesh.positions.len() * k];
    direct.par_chunks_mut(k).zip(&mesh.normals).for_each(|(row, n)| cosine_lobe(*n, row));
    Traced {
        bands,
        direct,
        blocked: vec![0.0; mesh.positions.len()],
        error: vec![0.0; mesh.positions.len()],
        vertex_weight: vertex_weights(mesh),
        rays: 0,
        offsets: vec![0; mesh.positions.len() + 1],
        corners: Vec::new(),
        hit_rays: 0,
    }
}

/// Rays per vertex whose hits are held so that `most` hits suffice wherever they lead: all, or a power of two of them,
/// which are as evenly spread.
fn held_rays(vertices: usize, rays: u32, most: u64) -> u32 {
    let fitting = (most / vertices.max(1) as u64).max(1);
    if u64::from(rays) <= fitting { rays } else { 1 << fitting.ilog2() }
}

/// Traces `rays` cosine-distributed rays from every vertex; `report` is told the share done.
#[must_use]
pub fn trace(
    mesh: &Mesh,
    scene: &RayScene,
    bands: usize,
    rays: u32,
    seed: u32,
    report: &(dyn Fn(f64) + Sync),
) -> Traced {
    let go_on = |share: f64| {
        report(share);
        true
    };
    trace_while(mesh, scene, bands, rays, None, seed, &go_on).unwrap_or_else(|| unoccluded(mesh, bands))
}

/// The same as long as `go_on`, which is told the share done, says so; `None` once it does not. Where the first of the
/// rays are traced already, with the same seed and bands, only the others are.
#[must_use]
pub fn trace_while(
    mesh: &Mesh,
    scene: &RayScene,
    bands: usize,
    rays: u32,
    have: Option<&Traced>,
    seed: u32,
    go_on: &(dyn Fn(f64) -> bool + Sync),
) -> Option<Traced> {
    let hit_rays = held_rays(mesh.positions.len(), rays, MOST_HITS);
    let have = have.filter(|h| h.bands == bands && h.rays > 0 && h.rays < rays && h.hit_rays <= hit_rays);
    let first = have.map_or(0, |h| h.rays);
    let more = trace_holding(mesh, scene, bands, first..rays, hit_rays, seed, go_on)?;
    Some(match have {
        Some(have) => have.and(more, rays),
        None => more,
    })
}

/// A range of the rays of every vertex, with the hits of the first `hit_rays` of all.
fn trace_holding(
    mesh: &Mesh,
    scene: &RayScene,
    bands: usize,
    range: std::ops::Range<u32>,
    hit_rays: u32,
    seed: u32,
    go_on: &(dyn Fn(f64) -> bool + Sync),
) -> Option<Traced> {
    let k = bands * bands;
    let count = mesh.positions.len();
    let directions = CosineDirections::new(range.end, seed);
    let mut direct = vec![0.0f32; count * k];
    let mut blocked = vec![0.0f32; count];
    let mut error = vec![0.0f32; count];
    let done = std::sync::atomic::AtomicUsize::new(0);
    let ended = std::sync::atomic::AtomicBool::new(false);
    let hits: Vec<(Vec<u32>, Vec<u32>)> = direct
        .par_chunks_mut(BLOCK * k)
        .zip(blocked.par_chunks_mut(BLOCK))
        .zip(error.par_chunks_mut(BLOCK))
        .enumerate()
        .map(|(block, ((direct, blocked), error))| {
            let (mut ends, mut corners) = (Vec::with_capacity(blocked.len()), Vec::new());
            if ended.load(std::sync::atomic::Ordering::Relaxed) {
                return (ends, corners);
            }
            for (j, row) in direct.chunks_mut(k).enumerate() {
                let vertex = block * BLOCK + j;
                let mut hits = Hits { rays: hit_rays as usize, corners: &mut corners };
                (blocked[j], error[j]) = trace_vertex(mesh, scene, &directions, vertex, range.clone(), row, &mut hits);
                ends.push(corners.len() as u32);
            }
            let before = done.fetch_add(blocked.len(), std::sync::atomic::Ordering::Relaxed);
            if !go_on((before + blocked.len()) as f64 / count as f64) {
                ended.store(true, std::sync::atomic::Ordering::Relaxed);
            }
            (ends, corners)
        })
        .collect();
    if ended.into_inner() {
        return None;
    }
    let mut offsets = Vec::with_capacity(count + 1);
    offsets.push(0);
    let mut corners = Vec::with_capacity(hits.iter().map(|(_, c)| c.len()).sum());
    for (ends, block) in hits {
        let start = corners.len() as u32;
        offsets.extend(ends.iter().map(|e| start + e));
        corners.extend(block);
    }
    let rays = range.end - range.start;
    Some(Traced {
        bands,
        direct,
        blocked,
        error,
        vertex_weight: vertex_weights(mesh),
        rays,
        offsets,
        corners,
        hit_rays,
    })
}

/// What a few rays from about `samples` of the vertices tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pilot {
    /// Cosine-weighted share of blocked rays.
    pub blocked: f64,
    /// Relative standard error of the first five bands with so many rays.
    pub relative_error: f64,
}

/// Traces `rays` rays from evenly strided vertices.
#[must_use]
pub fn pilot(mesh: &Mesh, scene: &RayScene, samples: usize, rays: u32, seed: u32) -> Pilot {
    let directions = CosineDirections::new(rays, seed);
    let stride = mesh.positions.len().div_ceil(samples.max(1)).max(1);
    let vertices: Vec<usize> = (0..mesh.positions.len()).step_by(stride).collect();
    let found: Vec<[f64; 3]> = vertices
        .par_iter()
        .map(|&vertex| {
            let mut row = [0.0f32; INDIRECT];
            let mut hits = Hits { rays: 0, corners: &mut Vec::new() };
            let (blocked, error) = trace_vertex(mesh, scene, &directions, vertex, 0..rays, &mut row, &mut hits);
            let size: f64 = row.iter().map(|t| f64::from(*t).powi(2)).sum();
            [f64::from(blocked), f64::from(error).powi(2), size]
        })
        .collect();
    let [blocked, error, size] = found.iter().fold([0.0; 3], |s, f| std::array::from_fn(|i| s[i] + f[i]));
    Pilot {
        blocked: blocked / vertices.len().max(1) as f64,
        relative_error: if size > 0.0 { libm::sqrt(error / size) } else { 0.0 },
    }
}

/// Directions gathered until there are enough for the fast path.
struct Lanes {
    directions: [[f32; sh::LANES]; 3],
    weight: [f32; sh::LANES],
    filled: usize,
}

impl Lanes {
    fn new() -> Self {
        Self { directions: [[0.0; sh::LANES]; 3], weight: [0.0; sh::LANES], filled: 0 }
    }

    #[inline(always)]
    fn push(&mut self, d: Vec3, sum: &mut [f32]) {
        let i = self.filled;
        (self.directions[0][i], self.directions[1][i], self.directions[2][i]) = (d.x, d.y, d.z);
        self.weight[i] = 1.0;
        self.filled += 1;
        if self.filled == sh::LANES {
            self.flush(sum);
        }
    }

    fn flush(&mut self, sum: &mut [f32]) {
        if self.filled > 0 {
            self.weight[self.filled..].fill(0.0);
            sh::add_lanes(&self.directions, &self.weight, sum);
            self.filled = 0;
        }
    }
}

/// Where hits are held, and of how many of the vertex's first rays.
struct Hits<'a> {
    rays: usize,
    corners: &'a mut Vec<u32>,
}

/// Fills the direct transfer of one vertex, appends its hits, and returns the blocked share and the estimated error.
fn trace_vertex(
    mesh: &Mesh,
    scene: &RayScene,
    directions: &CosineDirections,
    vertex: usize,
    range: std::ops::Range<u32>,
    row: &mut [f32],
    hits: &mut Hits,
) -> (f32, f32) {
    let (position, normal) = (mesh.positions[vertex], mesh.normals[vertex]);
    let rays = range.end - range.start;
    if rays == 0 || !position.is_finite() || !(normal.length_squared() - 1.0).abs().lt(&1e-2) {
        return (0.0, 0.0);
    }
    let origin = scene.offset_origin(position, normal);
    // Halves of the point set: their difference tells the error of the whole. Two sums each: what escapes, what is hit.
    let mut sums = [[[0.0f32; sh::MAX_COEFFICIENTS]; 2]; 2];
    let mut lanes = [[Lanes::new(), Lanes::new()], [Lanes::new(), Lanes::new()]];
    let mut count = [0u32; 2];
    let k = row.len();
    directions.about(vertex as u32, normal, range.start as usize..range.end as usize, |index, d| {
        let half = usize::from(2 * (index - range.start as usize) >= rays as usize);
        let hit = scene.closest_hit(origin, d);
        let side = usize::from(hit.is_some());
        count[side] += 1;
        lanes[half][side].push(d, &mut sums[half][side][..k]);
        if let Some(hit) = hit.filter(|_| index < hits.rays) {
            let t = mesh.triangles[hit.triangle as usize];
            let [a, b, c] = t.map(|i| mesh.normals[i as usize]);
            let facing = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
            // The back of a surface blocks but is not lit: what lights it is not what lights its front.
            if facing.dot(d) < 0.0 {
                let draw = unit(hash(vertex as u32, index as u32 ^ 0x0c04_e500));
                hits.corners.push(if draw < hit.u {
                    t[1]
                } else if draw < hit.u + hit.v {
                    t[2]
                } else {
                    t[0]
                });
            }
        }
    });
    for half in 0..2 {
        for side in 0..2 {
            lanes[half][side].flush(&mut sums[half][side][..k]);
        }
    }
    // Eq. (8): t = 1/N Σ over escaping rays; where most escape, the closed form minus what is blocked is the better
    // estimate of the same integral.
    let subtract = count[1] <= count[0];
    let side = usize::from(subtract);
    let scale = 1.0 / rays as f32;
    if subtract {
        cosine_lobe(normal, row);
    }
    let mut difference = 0.0f64;
    for i in 0..k {
        let [a, b] = [sums[0][side][i], sums[1][side][i]];
        row[i] = if subtract { row[i] - (a + b) * scale } else { (a + b) * scale };
        if i < INDIRECT {
            difference += f64::from((a - b) * scale).powi(2);
        }
    }
    (count[1] as f32 * scale, (HALVES_TO_WHOLE * libm::sqrt(difference)) as f32)
}

/// Closed-form transfer of an unblocked vertex.
fn cosine_lobe(normal: Vec3, row: &mut [f32]) {
    sh::eval_f32(normal, row);
    for (k, t) in row.iter_mut().enumerate() {
        *t *= sh::cosine_factor(sh::band(k)) as f32;
    }
}

/// Bounces light between the vertices: `t(b+1) = t(0) + 1/N Σ over hits of albedo(hit) · t(b)(hit)`, Eq. (8), a sparse
/// product per bounce. `bounces` = 0 goes on until a bounce no longer matters; the rest of the series is taken as
/// geometric.
#[must_use]
pub fn bounce(traced: &Traced, albedo: &[Vec3], bounces: u32) -> Bounced {
    let mut rows = vec![0.0f32; traced.vertices() * ROW];
    let most = if bounces == 0 { MOST_BOUNCES } else { bounces };
    let Series { bounces, share, last_share } = series::<INDIRECT>(traced, albedo, &mut rows, most, bounces == 0);
    Bounced { rows, bounces, share, last_share }
}

/// All bounces that matter, on from those for other albedos or rays: whatever the series starts from, it ends at the light
/// that reproduces itself, and from near by it takes fewer bounces to.
#[must_use]
pub fn bounce_on(traced: &Traced, albedo: &[Vec3], mut from: Bounced) -> Bounced {
    let Series { bounces, share, last_share } = series::<INDIRECT>(traced, albedo, &mut from.rows, MOST_BOUNCES, true);
    Bounced { rows: from.rows, bounces: from.bounces.max(bounces), share, last_share }
}

/// The same where `bounces` are fewer than matter: how much more light all of them bring under a uniform sky, vertex by
/// vertex, costs little, since it has one coefficient, and the others are taken to grow with it.
#[must_use]
pub fn bounce_and_rest(traced: &Traced, albedo: &[Vec3], bounces: u32) -> Bounced {
    let mut bounced = bounce(traced, albedo, bounces);
    if bounces > 0 {
        let first: Vec<f32> = bounced.rows.iter().step_by(INDIRECT).copied().collect();
        let mut all = first.clone();
        bounced.share = series::<1>(traced, albedo, &mut all, MOST_BOUNCES, true).share;
        for ((row, first), all) in bounced.rows.chunks_mut(INDIRECT).zip(first).zip(all) {
            if first > 0.0 {
                row.iter_mut().for_each(|t| *t *= all / first);
            }
        }
    }
    bounced
}

/// What a series of bounces came to.
struct Series {
    bounces: u32,
    share: f64,
    last_share: f64,
}

/// Bounces the first `K` coefficients on from what stands in `rows`: `[vertex][channel][K]`. `ends` once a bounce no
/// longer matters, or at the last one with the rest of the series.
fn series<const K: usize>(traced: &Traced, albedo: &[Vec3], rows: &mut [f32], most: u32, ends: bool) -> Series {
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
    while bounces < most {
        // Radiosity of every vertex: its albedo times all that arrives so far.
        radiosity.par_chunks_mut(3 * K).zip(rows.par_chunks(3 * K)).enumerate().for_each(|(i, (out, row))| {
            let direct = direct(i);
            for c in 0..3 {
                let a = albedo[i][c];
                for j in 0..direct.len() {
                    out[c * K + j] = a * (direct[j] + row[c * K + j]);
                }
            }
        });
        // The last bounce takes the rest of the series with it, which by then is geometric: what is reflected in a closed
        // white room would need thousands.
        let ratio: f64 = if before > 0.0 { (last / before).min(MOST_RATIO) } else { 0.0 };
        let rest = if ends && bounces + 1 == most { (ratio / (1.0 - ratio)) as f32 } else { 0.0 };
        let changes: Vec<[f64; 2]> = rows
            .par_chunks_mut(3 * K * BLOCK)
            .enumerate()
            .map(|(block, rows)| {
                let mut change = [0.0; 2];
                for (j, row) in rows.chunks_mut(3 * K).enumerate() {
                    let i = block * BLOCK + j;
                    let mut sums = [[0.0f32; K]; 3];
                    let sum = sums.as_flattened_mut();
                    for &corner in &traced.corners[traced.offsets[i] as usize..traced.offsets[i + 1] as usize] {
                        let from = &radiosity[corner as usize * 3 * K..][..3 * K];
                        sum.iter_mut().zip(from).for_each(|(s, x)| *s += x);
                    }
                    for (c, old) in row.iter().step_by(K).enumerate() {
                        let new = f64::from(sum[c * K] * scale);
                        change[0] += (new - f64::from(*old)).powi(2) / 3.0;
                        change[1] += new.powi(2) / 3.0;
                    }
                    row.iter_mut().zip(sum).for_each(|(r, s)| *r = *s * scale + (*s * scale - *r) * rest);
                }
                change
            })
            .collect();
        let [change, size] = changes.iter().fold([0.0; 2], |s, c| [s[0] + c[0], s[1] + c[1]]).map(libm::sqrt);
        bounces += 1;
        before = last;
        last = change / direct_norm;
        share = size / direct_norm;
        if ends && last < BOUNCE_TOLERANCE {
            break;
        }
    }
    Series { bounces, share, last_share: last }
}

impl Traced {
    /// The same with the rays of `more`, which make them `rays` in all.
    fn and(&self, more: Self, rays: u32) -> Self {
        let share = self.rays as f32 / rays as f32;
        let mean = |old: &[f32], new: &[f32]| -> Vec<f32> {
            old.iter().zip(new).map(|(a, b)| share * a + (1.0 - share) * b).collect()
        };
        // Twice the rays have 0.6 of the error; that of `more` was estimated from its own halves.
        let shrunk = libm::pow(f64::from(1.0 - share), -libm::log2(ERROR_OF_TWICE)) as f32;
        let (mut offsets, mut corners) = (vec![0], Vec::with_capacity(self.corners.len() + more.corners.len()));
        for i in 0..self.vertices() {
            for t in [self, &more] {
                corners.extend_from_slice(&t.corners[t.offsets[i] as usize..t.offsets[i + 1] as usize]);
            }
            offsets.push(corners.len() as u32);
        }
        Self {
            direct: mean(&self.direct, &more.direct),
            blocked: mean(&self.blocked, &more.blocked),
            error: more.error.iter().map(|e| shrunk * e).collect(),
            rays,
            offsets,
            corners,
            ..more
        }
    }

    /// Vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.blocked.len()
    }

    /// Cosine-weighted share of blocked rays, over all vertices.
    #[must_use]
    pub fn mean_blocked(&self) -> f64 {
        self.blocked.iter().map(|b| f64::from(*b)).sum::<f64>() / self.vertices().max(1) as f64
    }

    /// Relative standard error of the first five bands over all vertices: ‖error‖ / ‖transfer‖.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        let k = self.bands * self.bands;
        let error: f64 = self.error.iter().map(|e| f64::from(*e).powi(2)).sum();
        let size: f64 = self
            .direct
            .chunks(k)
            .map(|row| row.iter().take(INDIRECT).map(|t| f64::from(*t).powi(2)).sum::<f64>())
            .sum();
        if size > 0.0 { libm::sqrt(error / size) } else { 0.0 }
    }
}

impl Transfer {
    /// Coefficients a row has.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.traced.bands * self.traced.bands
    }

    /// Transfer of one vertex and channel in f64.
    pub fn row(&self, vertex: usize, channel: usize, out: &mut [f64]) {
        let k = self.coefficients();
        let direct = &self.traced.direct[vertex * k..(vertex + 1) * k];
        out.iter_mut().zip(direct).for_each(|(o, t)| *o = f64::from(*t));
        if let Some(bounced) = &self.bounced {
            let start = vertex * ROW + channel * INDIRECT;
            let indirect = &bounced.rows[start..start + INDIRECT];
            out.iter_mut().zip(indirect).for_each(|(o, t)| *o += f64::from(*t));
        }
    }

    /// Irradiance over π of every vertex under `light`: E_i = Σ_k t_ik i_k, per channel.
    #[must_use]
    pub fn irradiance(&self, light: &[[f64; 3]]) -> Vec<Vec3> {
        let k = self.coefficients();
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
                        let row = &bounced.rows[i * ROW + c * INDIRECT..][..INDIRECT];
                        *sum += row.iter().zip(light).map(|(t, l)| f64::from(*t) * l[c]).sum::<f64>();
                    }
                }
                Vec3::new(sum[0] as f32, sum[1] as f32, sum[2] as f32)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor and a wall of `n` × `n` squares that meet along an edge.
    fn corner(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for wall in [false, true] {
            let first = mesh.positions.len() as u32;
            for i in 0..=n {
                for j in 0..=n {
                    let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
                    mesh.positions.push(if wall { Vec3::new(0.0, y, x) } else { Vec3::new(x, y, 0.0) });
                    mesh.normals.push(if wall { Vec3::X } else { Vec3::Z });
                }
            }
            for i in 0..n {
                for j in 0..n {
                    let a = first + i * (n + 1) + j;
                    mesh.triangles.extend([[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]);
                }
            }
        }
        mesh
    }

    #[test]
    fn hits_stay_within_their_budget_and_bounces_stay_what_they_are() {
        assert_eq!(held_rays(1000, 128, 128_000), 128);
        assert_eq!(held_rays(1000, 128, 127_999), 64);
        assert_eq!(held_rays(2_000_000, 65_536, MOST_HITS), 16);
        assert_eq!(held_rays(usize::MAX, 128, MOST_HITS), 1);
        let mesh = corner(24);
        let scene = RayScene::new(&mesh);
        let bounced = |held| {
            let traced = trace_holding(&mesh, &scene, 5, 0..512, held, 1, &|_| true).expect("traced");
            assert!(traced.corners.len() <= held as usize * mesh.positions.len());
            let blocked = traced.mean_blocked();
            (bounce(&traced, &vec![Vec3::splat(0.5); mesh.positions.len()], 0).share, blocked)
        };
        let (all, few) = (bounced(512), bounced(32));
        assert!(all.0 > 0.05 && (few.0 / all.0 - 1.0).abs() < 0.02, "{all:?} {few:?}");
        assert_eq!(all.1, few.1, "what is blocked does not hang on what is held");
    }

    #[test]
    fn more_rays_go_on_where_the_first_ended() {
        let mesh = corner(12);
        let scene = RayScene::new(&mesh);
        let traced = |rays, have| trace_while(&mesh, &scene, 5, rays, have, 1, &|_| true).expect("traced");
        let (all, more) = (traced(512, None), traced(512, Some(&traced(128, None))));
        assert_eq!((all.rays, &all.offsets, &all.corners), (more.rays, &more.offsets, &more.corners));
        let worst = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst(&all.blocked, &more.blocked) < 1e-6);
        // Where few rays tell another side to be the better one, it is another estimate of the same.
        let (error, size) = (all.relative_error(), more.relative_error());
        assert!(worst(&all.direct, &more.direct) < 0.02, "{}", worst(&all.direct, &more.direct));
        assert!((0.6..1.6).contains(&(error / size)), "{error} {size}");
    }

    #[test]
    fn one_bounce_and_the_rest_come_near_all_of_them() {
        let mesh = corner(24);
        let traced = Arc::new(trace(&mesh, &RayScene::new(&mesh), 5, 128, 1, &|_| ()));
        let albedo: Vec<Vec3> = mesh.normals.iter().map(|n| Vec3::new(0.9, 0.6, 0.3) * n.abs().x.max(0.7)).collect();
        let light = [[0.8; 3], [0.1; 3], [0.5; 3], [-0.2; 3], [0.0; 3], [0.2; 3], [-0.1; 3], [0.1; 3], [0.3; 3]];
        let arriving = |bounced| Transfer { traced: Arc::clone(&traced), bounced: Some(bounced) }.irradiance(&light);
        let all = arriving(bounce(&traced, &albedo, 0));
        let off = |some: Vec<Vec3>| {
            let worst = all.iter().zip(&some).map(|(a, s)| ((*s - *a) / *a).abs().max_element());
            worst.fold(0.0, f32::max)
        };
        let one = off(arriving(bounce(&traced, &albedo, 1)));
        let rest = off(arriving(bounce_and_rest(&traced, &albedo, 1)));
        assert!(one > 0.03, "later bounces matter here: {one}");
        assert!(rest < 0.3 * one, "{rest} instead of {one}");
        let grey = bounce(&traced, &vec![Vec3::splat(0.4); albedo.len()], 0);
        let (before, on) = (off(arriving(grey.clone())), off(arriving(bounce_on(&traced, &albedo, grey))));
        assert!(before > 0.03 && on < 3e-3, "on from other albedos: {on}, which were {before} off");
    }
}
