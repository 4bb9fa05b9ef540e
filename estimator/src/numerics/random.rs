//! Hash-based random numbers, and cosine-distributed directions from scrambled Sobol points, seeded by vertex.

use glam::Vec3;
use std::f32::consts::TAU;

/// Scrambled point sets shared by the vertices; each vertex rotates its set about its normal by a random angle.
const SETS: usize = 32;

/// A hash of two words with good avalanche (the finaliser of MurmurHash3, twice).
#[must_use]
pub fn hash(a: u32, b: u32) -> u32 {
    mix(mix(a ^ 0x9e37_79b9).wrapping_add(b.wrapping_mul(0x85eb_ca6b)))
}

fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^= x >> 13;
    x = x.wrapping_mul(0xc2b2_ae35);
    x ^ (x >> 16)
}

/// A hash as a uniform number in [0, 1).
#[must_use]
pub fn unit(x: u32) -> f32 {
    (x >> 8) as f32 / 16_777_216.0
}

/// Owen scrambling by hashing (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020; constants by Vegdahl).
fn owen(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// Point `index` of the first two Sobol dimensions, scrambled.
fn sobol(index: u32, seed: u32) -> [u32; 2] {
    let first = index.reverse_bits();
    let mut second = 0;
    let (mut column, mut i) = (1u32 << 31, index);
    while i != 0 {
        if i & 1 == 1 {
            second ^= column;
        }
        column ^= column >> 1;
        i >>= 1;
    }
    [owen(first, hash(seed, 0)), owen(second, hash(seed, 1))]
}

/// A point of the unit disc lifted to the hemisphere: cosine-distributed about +Z.
#[derive(Debug, Clone, Copy)]
struct Lifted {
    x: f32,
    y: f32,
    z: f32,
}

/// Cosine-distributed directions for every vertex; every prefix of a vertex's sequence is well distributed.
#[derive(Debug)]
pub struct CosineDirections {
    sets: Vec<Vec<Lifted>>,
    seed: u32,
}

impl CosineDirections {
    /// Prepares up to `count` directions per vertex.
    #[must_use]
    pub fn new(count: u32, seed: u32) -> Self {
        let lifted = |index: u32, set: u32| {
            let [u, v] = sobol(index, hash(seed, set.wrapping_add(0x5eed)));
            let (radius2, angle) = ((u as f64 + 0.5) / 4_294_967_296.0, unit(v) * TAU);
            let (sin, cos) = libm::sincosf(angle);
            let radius = libm::sqrt(radius2) as f32;
            Lifted { x: radius * cos, y: radius * sin, z: libm::sqrt(1.0 - radius2) as f32 }
        };
        let sets = (0..SETS as u32).map(|s| (0..count).map(|i| lifted(i, s)).collect()).collect();
        Self { sets, seed }
    }

    /// Calls `visit(index, direction)` for directions `range` of `vertex` about the unit `normal`.
    #[inline(always)]
    pub fn about(&self, vertex: u32, normal: Vec3, range: std::ops::Range<usize>, mut visit: impl FnMut(usize, Vec3)) {
        let scramble = hash(vertex, self.seed);
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let (sin, cos) = libm::sincosf(unit(hash(scramble, 7)) * TAU);
        let (x, y) = (tangent * cos + bitangent * sin, bitangent * cos - tangent * sin);
        let set = &self.sets[scramble as usize % SETS];
        for index in range {
            let p = set[index];
            visit(index, x * p.x + y * p.y + normal * p.z);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosine_distributed_and_even() {
        let directions = CosineDirections::new(1024, 3);
        let normal = Vec3::new(0.36, 0.48, 0.8);
        let (mut mean, mut second) = (Vec3::ZERO, 0.0);
        directions.about(12, normal, 0..1024, |_, d| {
            assert!((d.length() - 1.0).abs() < 1e-5 && d.dot(normal) > 0.0);
            mean += d / 1024.0;
            second += d.dot(normal).powi(2) / 1024.0;
        });
        // E[d] = 2/3 n, E[(n·d)²] = 1/2; random points would be off by 1e-2.
        assert!((mean - normal * (2.0 / 3.0)).length() < 2e-3, "{mean}");
        assert!((second - 0.5).abs() < 1e-3, "{second}");
    }

    #[test]
    fn vertices_differ() {
        let directions = CosineDirections::new(4, 3);
        let mut seen = Vec::new();
        for vertex in 0..3 {
            directions.about(vertex, Vec3::Z, 0..1, |_, d| seen.push(d));
        }
        assert!(seen[0].distance(seen[1]) > 1e-3 && seen[1].distance(seen[2]) > 1e-3);
    }
}
