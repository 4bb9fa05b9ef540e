//! Marching cubes (Lorensen, Cline 1987) over the blocks, with shared vertices.
//!
//! The case table is derived, not typed in: on each face of the cube the surface is cut so that inside corners are
//! separated, the cuts join to loops, the loops are fanned. Two cells that share a face cut it alike, so the surface has
//! no cracks. A vertex belongs to the voxel where its edge begins; a bitmap per block and its running count give it a
//! number, so blocks can be worked on in parallel and neighbours find each other's vertices.

use crate::tsdf::volume::{BlockCoord, Cursor, EDGE, SDF_ONE, VOXELS, Volume, WEIGHT_UNIT};
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Words of a block's edge bitmap: three axes × 512 voxels.
const WORDS: usize = 3 * VOXELS / 64;
/// Blocks whose weights are counted at a time.
const SLOTS_COUNTED: usize = 1024;
/// Samples along the edge of a block with its far neighbours' first layer.
const PAD: usize = EDGE + 1;

/// The edges of a cube: start corner and axis; corner bits are x, y, z.
const EDGES: [(usize, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0), //
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1), //
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// Corners of each face, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// For each sign pattern (bit = corner inside) the triangles as triples of edges.
fn case_table() -> Vec<Vec<[usize; 3]>> {
    let edge_between = |a: usize, b: usize| {
        let (start, axis) = (a & b, (a ^ b).trailing_zeros() as usize);
        EDGES.iter().position(|e| *e == (start, axis)).unwrap_or(0)
    };
    (0..256usize)
        .map(|case| {
            let inside = |c: usize| case >> c & 1 == 1;
            // next[e]: the edge to which the surface runs from edge e across a face.
            let mut next = [None; 12];
            for face in FACES {
                for i in 0..4 {
                    // A run of inside corners begins after corner i …
                    if inside(face[i]) || !inside(face[(i + 1) % 4]) {
                        continue;
                    }
                    let enter = edge_between(face[i], face[(i + 1) % 4]);
                    // … and ends before the next outside corner.
                    if let Some(k) = (2..=4).find(|k| !inside(face[(i + k) % 4])) {
                        let exit = edge_between(face[(i + k - 1) % 4], face[(i + k) % 4]);
                        next[enter] = Some(exit);
                    }
                }
            }
            let mut triangles = Vec::new();
            for first in 0..12 {
                let mut ring = Vec::new();
                let mut at = first;
                while let Some(to) = next[at].take() {
                    ring.push(at);
                    at = to;
                }
                for k in 2..ring.len() {
                    triangles.push([ring[0], ring[k - 1], ring[k]]);
                }
            }
            triangles
        })
        .collect()
}

/// Which edges of a block carry a vertex, and the number of its first.
struct BlockEdges {
    bits: [u64; WORDS],
    /// Vertices in the words before each.
    before: [u16; WORDS],
    first: u32,
}

impl BlockEdges {
    /// Number of the vertex on the edge that begins at voxel `at` of the block, if there is one.
    fn vertex(&self, at: usize, axis: usize) -> Option<u32> {
        let bit = axis * VOXELS + at;
        let (word, mask) = (bit / 64, 1u64 << (bit % 64));
        (self.bits[word] & mask != 0)
            .then(|| self.first + u32::from(self.before[word]) + (self.bits[word] & (mask - 1)).count_ones())
    }
}

/// A block's samples and those of the first layer beyond it: distance in units of truncation, and weight.
struct Padded {
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
    fn gather(volume: &Volume, coord: BlockCoord) -> Self {
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

    /// True if the surface lies between two samples.
    fn cut(&self, a: usize, b: usize) -> bool {
        (self.sdf[a] < 0.0) != (self.sdf[b] < 0.0)
    }
}

const STEPS: [usize; 3] = [1, PAD, PAD * PAD];

/// What of the volume becomes surface.
#[derive(Debug, Clone, Copy)]
pub struct Threshold {
    /// Voxels of a lower weight give no surface, in frames seen from 1 m …
    pub min_weight: f32,
    /// … nor do those of a lower weight than this share of [`typical_weight`].
    pub share: f32,
    /// Connected pieces of fewer triangles are dropped.
    pub min_triangles: usize,
}

/// Blocks of one z, with their edges.
struct Layer<'a> {
    slots: &'a [u32],
    edges: Vec<BlockEdges>,
}

/// Extracts the surface: vertices welded, normals from the gradient of the distance. The order depends on the volume's
/// content alone. Goes layer by layer: beside the mesh it holds the edges of the two layers that share vertices.
pub fn extract(volume: &Volume, threshold: &Threshold) -> Mesh {
    let slots = volume.sorted_slots();
    let counts = count_edges(volume, &slots);
    let least = threshold.min_weight.max(threshold.share * typical_weight(&counts));
    tracing::debug!(least, "surface from this weight on");
    let min_weight = (least / WEIGHT_UNIT).clamp(1.0, f32::from(u16::MAX)) as u16;

    let mut mesh = Mesh::default();
    let total = counts[usize::from(min_weight)..].iter().sum::<u64>() as usize;
    mesh.positions.reserve_exact(total);
    mesh.normals.reserve_exact(total);
    let table = case_table();
    // Where each slot stands in its layer.
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
    drop_specks(&mut mesh, threshold.min_triangles);
    mesh
}

/// How many lattice edges the surface cuts, by the lesser weight of their ends.
fn count_edges(volume: &Volume, slots: &[u32]) -> Vec<u64> {
    let mut counts = vec![0u64; usize::from(u16::MAX) + 1];
    // Few blocks at a time, so that their weights need little room.
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

/// The weight, in frames, that half of all that was measured of the surface exceeds: the weighted median over the edges
/// cut. It grows with the length of a scan of one place, as what rare readings add up to does.
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

/// Adds the triangles of the lower of two layers whose vertices are there.
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

/// Gradient of the stored distance at a voxel, by central differences where both neighbours are known.
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

/// Triangles in pieces that share vertices (union-find).
pub struct Pieces {
    parent: Vec<u32>,
    /// Triangles of the piece, at its root.
    triangles: Vec<u32>,
}

impl Pieces {
    /// Of a mesh with so many vertices.
    pub fn new<'a>(vertices: usize, triangles: impl Iterator<Item = &'a [u32; 3]> + Clone) -> Self {
        let mut pieces = Self { parent: (0..vertices as u32).collect(), triangles: vec![0; vertices] };
        for t in triangles.clone() {
            for (a, b) in [(t[0], t[1]), (t[1], t[2])] {
                let (a, b) = (pieces.root(a), pieces.root(b));
                pieces.parent[a.max(b) as usize] = a.min(b);
            }
        }
        for t in triangles {
            let root = pieces.root(t[0]);
            pieces.triangles[root as usize] += 1;
        }
        pieces
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.parent[v as usize] != v {
            self.parent[v as usize] = self.parent[self.parent[v as usize] as usize];
            v = self.parent[v as usize];
        }
        v
    }

    /// Triangles of the piece that a vertex belongs to.
    pub fn triangles(&mut self, v: u32) -> u32 {
        let root = self.root(v);
        self.triangles[root as usize]
    }
}

/// Drops small pieces and vertices that no triangle uses.
pub fn drop_specks(mesh: &mut Mesh, min_triangles: usize) {
    let vertices = mesh.positions.len();
    let mut pieces = Pieces::new(vertices, mesh.triangles.iter());
    let least = min_triangles.max(1) as u32;
    mesh.triangles.retain(|t| pieces.triangles(t[0]) >= least);
    let keep: Vec<bool> = (0..vertices as u32).map(|v| pieces.triangles(v) >= least).collect();
    let mut number = pieces.parent;
    let mut next = 0;
    for (n, k) in number.iter_mut().zip(&keep) {
        *n = next;
        next += u32::from(*k);
    }
    for t in &mut mesh.triangles {
        *t = t.map(|v| number[v as usize]);
    }
    let mut kept = keep.iter();
    mesh.positions.retain(|_| *kept.next().unwrap_or(&false));
    let mut kept = keep.iter();
    mesh.normals.retain(|_| *kept.next().unwrap_or(&false));
    // A vertex without gradient gets the normal of its triangles.
    let missing: Vec<bool> = mesh.normals.iter().map(|n| *n == Vec3::ZERO).collect();
    if missing.contains(&true) {
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            for v in t.iter().filter(|v| missing[**v as usize]) {
                mesh.normals[*v as usize] += (b - a).cross(c - a);
            }
        }
        for (n, m) in mesh.normals.iter_mut().zip(missing) {
            *n = if m { n.normalize_or(Vec3::Z) } else { *n };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::FusionConfig;
    use std::collections::HashMap;

    #[test]
    fn every_case_closes_its_loops() {
        let table = case_table();
        assert!(table[0].is_empty() && table[255].is_empty());
        for (case, triangles) in table.iter().enumerate() {
            let crossed = EDGES.iter().filter(|(c, a)| (case >> c & 1) != (case >> (c | 1 << a) & 1)).count();
            let mut used: Vec<usize> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), crossed, "case {case}");
        }
    }

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
        let mesh = extract(&volume, &Threshold { min_weight: 3.0, share: 0.01, min_triangles: 10 });
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
