//! Marching cubes (Lorensen, Cline 1987) over the blocks, with shared vertices.
//!
//! A vertex belongs to the voxel where its edge begins. A bitmap per block and its running count number the vertices, so
//! that blocks are processed in parallel and neighbours find each other's vertices.

use crate::tsdf::components::drop_small_components;
use crate::tsdf::marching_cubes_table::{EDGES, case_table};
use crate::tsdf::sampling::Cursor;
use crate::tsdf::volume::{BlockCoord, EDGE, SDF_ONE, VOXELS, Volume, WEIGHT_UNIT};
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Words of a block's edge bitmap: three axes × 512 voxels.
const WORDS: usize = 3 * VOXELS / 64;
/// Blocks whose weights are counted at once.
const SLOTS_COUNTED: usize = 1024;
/// Samples along the edge of a block with the first layer of its neighbour.
const PAD: usize = EDGE + 1;

/// The edges of a block with a vertex, and the number of its first vertex.
struct BlockEdges {
    bits: [u64; WORDS],
    /// `[word]`: vertices in the words before.
    before: [u16; WORDS],
    first: u32,
}

impl BlockEdges {
    /// Number of the vertex on the edge that begins at voxel `at` of the block; `None` without a vertex.
    fn vertex(&self, at: usize, axis: usize) -> Option<u32> {
        let bit = axis * VOXELS + at;
        let (word, mask) = (bit / 64, 1u64 << (bit % 64));
        (self.bits[word] & mask != 0)
            .then(|| self.first + u32::from(self.before[word]) + (self.bits[word] & (mask - 1)).count_ones())
    }
}

/// Samples of a block and of the first layer beyond it: distance in units of truncation, and weight.
pub(super) struct Padded {
    sdf: [f32; PAD * PAD * PAD],
    weight: [u16; PAD * PAD * PAD],
}

/// The neighbour in the direction of a corner of the block, by the corner's bits x, y, z.
fn octant(bits: usize) -> IVec3 {
    IVec3::new(bits as i32 & 1, bits as i32 >> 1 & 1, bits as i32 >> 2)
}

fn at(x: usize, y: usize, z: usize) -> usize {
    (z * PAD + y) * PAD + x
}

impl Padded {
    pub(super) fn gather(volume: &Volume, coord: BlockCoord) -> Self {
        let mut out = Self { sdf: [1.0; PAD * PAD * PAD], weight: [0; PAD * PAD * PAD] };
        for d in (0..8).map(octant) {
            let Some(slot) = volume.find(coord + d) else { continue };
            let (sdf, weight) = volume.block(slot);
            let range = |k: i32| if k == 0 { 0..EDGE } else { 0..1 };
            for z in range(d.z) {
                for y in range(d.y) {
                    for x in range(d.x) {
                        let from = (z * EDGE + y) * EDGE + x;
                        let to = at(x + EDGE * d.x as usize, y + EDGE * d.y as usize, z + EDGE * d.z as usize);
                        out.sdf[to] = f32::from(sdf[from]) / SDF_ONE;
                        out.weight[to] = weight[from];
                    }
                }
            }
        }
        out
    }

    /// Distance and weight of a sample, 0 to 8 along each axis.
    pub(super) fn sample(&self, v: IVec3) -> (f32, u16) {
        let i = at(v.x as usize, v.y as usize, v.z as usize);
        (self.sdf[i], self.weight[i])
    }

    /// True if the surface lies between two samples.
    fn cut(&self, a: usize, b: usize) -> bool {
        (self.sdf[a] < 0.0) != (self.sdf[b] < 0.0)
    }
}

const STEPS: [usize; 3] = [1, PAD, PAD * PAD];

/// Which part of the volume becomes surface.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceThreshold {
    /// Smallest weight of a voxel with surface, in frames from 1 m, …
    pub min_weight: f32,
    /// … and as a share of [`typical_weight`].
    pub share: f32,
    /// Connected components with fewer triangles are dropped.
    pub min_triangles: usize,
}

/// The blocks of one z, with their edges.
struct Layer<'a> {
    slots: &'a [u32],
    edges: Vec<BlockEdges>,
}

/// Extracts the surface, with shared vertices and normals from the gradient of the distance. The order of vertices and
/// triangles depends on the content of the volume alone. Works layer by layer: only the edges of two layers are held.
pub fn extract(volume: &Volume, threshold: &SurfaceThreshold) -> Mesh {
    let slots = volume.sorted_slots();
    let counts = count_edges(volume, &slots);
    let least = threshold.min_weight.max(threshold.share * typical_weight(&counts));
    tracing::debug!(least, "smallest weight of the surface");
    let min_weight = (least / WEIGHT_UNIT).clamp(1.0, f32::from(u16::MAX)) as u16;

    let mut mesh = Mesh::default();
    let total = counts[usize::from(min_weight)..].iter().sum::<u64>() as usize;
    mesh.positions.reserve_exact(total);
    mesh.normals.reserve_exact(total);
    let table = case_table();
    // `[slot]`: index in its layer.
    let mut place = vec![0u32; volume.high_water()];
    let mut lower = Layer { slots: &[], edges: Vec::new() };
    for slots in slots.chunk_by(|a, b| volume.coord(*a).z == volume.coord(*b).z).chain([&[][..]]) {
        for (i, slot) in slots.iter().enumerate() {
            place[*slot as usize] = i as u32;
        }
        let upper = Layer { slots, edges: add_vertices(volume, slots, min_weight, &mut mesh) };
        add_triangles(volume, &lower, &upper, &place, min_weight, &table, &mut mesh);
        lower = upper;
    }
    drop_small_components(&mut mesh, threshold.min_triangles);
    mesh
}

/// `[weight]`: number of lattice edges that the surface cuts, by the smaller weight of their ends.
fn count_edges(volume: &Volume, slots: &[u32]) -> Vec<u64> {
    let mut counts = vec![0u64; usize::from(u16::MAX) + 1];
    // In groups of blocks, so that the lists of weights stay small.
    for slots in slots.chunks(SLOTS_COUNTED) {
        let weights: Vec<Vec<u16>> = slots.par_iter().map(|slot| cut_edges(volume, *slot)).collect();
        weights.iter().flatten().for_each(|w| counts[usize::from(*w)] += 1);
    }
    counts
}

fn cut_edges(volume: &Volume, slot: u32) -> Vec<u16> {
    let padded = Padded::gather(volume, volume.coord(slot));
    let mut weights = Vec::new();
    for a in (0..VOXELS).map(|v| at(v % EDGE, v / EDGE % EDGE, v / (EDGE * EDGE))) {
        for step in STEPS {
            let least = padded.weight[a].min(padded.weight[a + step]);
            if least > 0 && padded.cut(a, a + step) {
                weights.push(least);
            }
        }
    }
    weights
}

/// Weighted median, in frames, of the weights of the cut edges: half of all readings of the surface lie above it. It grows
/// with the length of a scan of one place, as the sum of rare readings does.
fn typical_weight(counts: &[u64]) -> f32 {
    let evidence = |w: usize| w as u64 * counts[w];
    let all: u64 = (0..counts.len()).map(evidence).sum();
    let mut above = 0;
    let typical = (0..counts.len()).rev().find(|w| {
        above += evidence(*w);
        2 * above >= all
    });
    typical.unwrap_or(0) as f32 * WEIGHT_UNIT
}

/// Adds the vertices of a layer of blocks and returns their edges.
fn add_vertices(volume: &Volume, slots: &[u32], min_weight: u16, mesh: &mut Mesh) -> Vec<BlockEdges> {
    let parts: Vec<_> = slots.par_iter().map(|slot| vertices(volume, volume.coord(*slot), min_weight)).collect();
    let mut layer = Vec::with_capacity(parts.len());
    for (mut edges, positions, normals) in parts {
        edges.first = mesh.positions.len() as u32;
        mesh.positions.extend(positions);
        mesh.normals.extend(normals);
        layer.push(edges);
    }
    layer
}

/// Adds the triangles of the lower of two layers; the vertices of both exist.
fn add_triangles(
    volume: &Volume,
    lower: &Layer<'_>,
    upper: &Layer<'_>,
    place: &[u32],
    min_weight: u16,
    table: &[Vec<[usize; 3]>],
    mesh: &mut Mesh,
) {
    let of_block = |slot: &u32| {
        let coord = volume.coord(*slot);
        let neighbours: [Option<&BlockEdges>; 8] = std::array::from_fn(|o| {
            let slot = volume.find(coord + octant(o))? as usize;
            (if o < 4 { lower } else { upper }).edges.get(place[slot] as usize)
        });
        triangles(&Padded::gather(volume, coord), min_weight, table, &neighbours)
    };
    let parts: Vec<Vec<[u32; 3]>> = lower.slots.par_iter().map(of_block).collect();
    parts.into_iter().for_each(|part| mesh.triangles.extend(part));
}

fn vertices(volume: &Volume, coord: BlockCoord, min_weight: u16) -> (BlockEdges, Vec<Vec3>, Vec<Vec3>) {
    let padded = Padded::gather(volume, coord);
    let mut edges = BlockEdges { bits: [0; WORDS], before: [0; WORDS], first: 0 };
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    let mut cursor = Cursor::default();
    for axis in 0..3 {
        for v in 0..VOXELS {
            let (x, y, z) = (v % EDGE, v / EDGE % EDGE, v / (EDGE * EDGE));
            let (a, b) = (at(x, y, z), at(x, y, z) + STEPS[axis]);
            let (sa, sb) = (padded.sdf[a], padded.sdf[b]);
            if padded.weight[a].min(padded.weight[b]) < min_weight || !padded.cut(a, b) {
                continue;
            }
            let bit = axis * VOXELS + v;
            edges.bits[bit / 64] |= 1 << (bit % 64);
            let f = sa / (sa - sb);
            let voxel = coord * EDGE as i32 + IVec3::new(x as i32, y as i32, z as i32);
            let mut step = [0, 0, 0];
            step[axis] = 1;
            let g0 = gradient(volume, voxel, min_weight, &mut cursor);
            let g1 = gradient(volume, voxel + IVec3::from(step), min_weight, &mut cursor);
            let mut p = voxel.as_vec3();
            p[axis] += f;
            positions.push(p * volume.voxel_m());
            normals.push(g0.lerp(g1, f).normalize_or_zero());
        }
    }
    let mut total = 0;
    for w in 0..WORDS {
        edges.before[w] = total;
        total += edges.bits[w].count_ones() as u16;
    }
    (edges, positions, normals)
}

/// Gradient of the stored distance at a voxel: central differences, one-sided where only one neighbour is known.
fn gradient(volume: &Volume, v: IVec3, min_weight: u16, cursor: &mut Cursor) -> Vec3 {
    let here = volume.voxel(v, cursor).0;
    Vec3::from([IVec3::X, IVec3::Y, IVec3::Z].map(|d| {
        let side = |q: IVec3, cursor: &mut Cursor| {
            let (s, w) = volume.voxel(q, cursor);
            (w >= min_weight).then_some(s)
        };
        match (side(v - d, cursor), side(v + d, cursor)) {
            (Some(a), Some(b)) => 0.5 * (f32::from(b) - f32::from(a)),
            (Some(a), None) => f32::from(here) - f32::from(a),
            (None, Some(b)) => f32::from(b) - f32::from(here),
            (None, None) => 0.0,
        }
    }))
}

fn triangles(
    padded: &Padded,
    min_weight: u16,
    table: &[Vec<[usize; 3]>],
    neighbours: &[Option<&BlockEdges>; 8],
) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    for v in 0..VOXELS {
        let (x, y, z) = (v % EDGE, v / EDGE % EDGE, v / (EDGE * EDGE));
        let base = at(x, y, z);
        let mut case = 0;
        let mut known = true;
        for c in 0..8 {
            let i = base + (c & 1) * STEPS[0] + (c >> 1 & 1) * STEPS[1] + (c >> 2) * STEPS[2];
            known &= padded.weight[i] >= min_weight;
            case |= usize::from(padded.sdf[i] < 0.0) << c;
        }
        if !known {
            continue;
        }
        let vertex = |edge: usize| {
            let (c, axis) = EDGES[edge];
            let (x, y, z) = (x + (c & 1), y + (c >> 1 & 1), z + (c >> 2));
            let octant = (x / EDGE) | ((y / EDGE) << 1) | ((z / EDGE) << 2);
            let inner = ((z % EDGE) * EDGE + y % EDGE) * EDGE + x % EDGE;
            neighbours[octant].and_then(|b| b.vertex(inner, axis))
        };
        for t in &table[case] {
            if let (Some(a), Some(b), Some(c)) = (vertex(t[0]), vertex(t[1]), vertex(t[2])) {
                out.push([a, b, c]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::FusionConfig;
    use std::collections::HashMap;

    #[test]
    fn a_sphere_comes_out_closed_round_and_facing_outwards() {
        let mut volume = Volume::new(&FusionConfig { pool_blocks: 1024, fine_blocks: 0, ..FusionConfig::default() });
        let (radius, mu, m) = (0.1f32, volume.truncation_m(), volume.voxel_m());
        let centre = Vec3::new(0.011, -0.007, 0.003);
        for z in -4..4 {
            for y in -4..4 {
                for x in -4..4 {
                    let slot = volume.allocate(IVec3::new(x, y, z)).unwrap();
                    let (sdf, weight) = volume.block_mut(slot);
                    for i in 0..VOXELS {
                        let v = IVec3::new(i as i32 & 7, i as i32 >> 3 & 7, i as i32 >> 6) + 8 * IVec3::new(x, y, z);
                        let d = (v.as_vec3() * m - centre).length() - radius;
                        sdf[i] = ((d / mu).clamp(-1.0, 1.0) * SDF_ONE) as i16;
                        weight[i] = (10.0 / WEIGHT_UNIT) as u16;
                    }
                }
            }
        }
        let mesh = extract(&volume, &SurfaceThreshold { min_weight: 3.0, share: 0.01, min_triangles: 10 });
        assert!(mesh.triangles.len() > 5000);
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for t in &mesh.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            let n = (b - a).cross(c - a);
            assert!(n.dot(a - centre) >= -1e-9, "a triangle faces inwards");
        }
        assert!(edges.values().all(|n| *n == 0), "the surface is not closed");
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!(((p - centre).length() - radius).abs() < 2e-4);
            assert!(n.dot((p - centre).normalize()) > 0.99);
        }
    }
}
