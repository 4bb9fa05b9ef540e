//! The TSDF: a fixed pool of 8³-voxel blocks, found by a hash of their coordinates.
//!
//! Voxel (i, j, k) is the sample at (i, j, k) · voxel size; block (a, b, c) holds voxels 8a … 8a+7 and so on. Distances
//! are stored as `i16` in units of truncation / 32767, positive in front of the surface; weights as `u16` in units of
//! [`WEIGHT_UNIT`] frames, 0 = never seen. Nothing here allocates after construction.

use firmware_config::FusionConfig;
use glam::{IVec3, Vec3};

/// Voxels along a block's edge.
pub const EDGE: usize = 8;
/// Voxels in a block.
pub const VOXELS: usize = EDGE * EDGE * EDGE;
/// One unit of a stored weight, in frames seen from 1 m.
pub const WEIGHT_UNIT: f32 = 1.0 / 32.0;
/// Stored distance of one truncation distance.
pub const SDF_ONE: f32 = 32767.0;
/// Blocks lie within ± this many blocks of the origin, so that a coordinate fits 20 bits.
const MAX_BLOCK: i32 = 1 << 19;
/// Longest probe sequence in the hash table.
const MAX_PROBES: usize = 256;
/// Marks an empty place of the hash table.
const EMPTY: u64 = u64::MAX;
/// Coordinates of a free slot.
const NOWHERE: BlockCoord = BlockCoord::MIN;

/// Coordinates of a block in units of blocks.
pub type BlockCoord = IVec3;

/// Why a block could not be had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The pool (or the probe sequence) is full.
    Full,
    /// The coordinates are outside the addressable world.
    Outside,
}

/// The block pool with its index.
pub struct Volume {
    sdf: Vec<i16>,
    weight: Vec<u16>,
    coords: Vec<BlockCoord>,
    free: Vec<u32>,
    keys: Vec<u64>,
    slots: Vec<u32>,
    used: usize,
    high_water: usize,
    voxel_m: f32,
    truncation_voxels: f32,
}

/// Remembers the block last looked up: neighbouring queries mostly fall into the same one.
#[derive(Debug, Clone, Copy)]
pub struct Cursor {
    key: u64,
    slot: Option<u32>,
}

impl Default for Cursor {
    fn default() -> Self {
        Self { key: EMPTY, slot: None }
    }
}

/// Signed distance and gradient at a point.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Signed distance in metres as stored (projective, so not exactly Euclidean).
    pub distance: f32,
    /// Its gradient (metres per metre): length near 1 where the distance is Euclidean.
    pub gradient: Vec3,
}

fn key_of(c: BlockCoord) -> Option<u64> {
    let bias = |x: i32| (-MAX_BLOCK..MAX_BLOCK).contains(&x).then(|| (x + MAX_BLOCK) as u64);
    Some((bias(c.z)? << 40) | (bias(c.y)? << 20) | bias(c.x)?)
}

impl Volume {
    /// A volume with all blocks free. Voxels are half as long as set, if they may be (`fine_blocks`).
    pub fn new(config: &FusionConfig) -> Self {
        let blocks = config.pool_blocks as usize;
        let table = (2 * blocks).next_power_of_two();
        Self {
            sdf: vec![0; blocks * VOXELS],
            weight: vec![0; blocks * VOXELS],
            coords: vec![NOWHERE; blocks],
            free: (0..blocks as u32).rev().collect(),
            keys: vec![EMPTY; table],
            slots: vec![0; table],
            used: 0,
            high_water: 0,
            voxel_m: config.voxel_size_m as f32 * if config.fine_blocks > 0 { 0.5 } else { 1.0 },
            truncation_voxels: config.truncation_voxels as f32,
        }
    }

    /// Edge length of a voxel in metres.
    pub fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    /// Truncation distance in metres.
    pub fn truncation_m(&self) -> f32 {
        self.voxel_m * self.truncation_voxels
    }

    /// Blocks in use.
    pub fn used(&self) -> usize {
        self.used
    }

    /// Blocks in the pool.
    pub fn capacity(&self) -> usize {
        self.coords.len()
    }

    /// No slot at or beyond this was ever used.
    pub fn high_water(&self) -> usize {
        self.high_water
    }

    /// True if the slot holds a block.
    pub fn is_used(&self, slot: u32) -> bool {
        self.coords[slot as usize] != NOWHERE
    }

    /// Coordinates of the block in a slot.
    pub fn coord(&self, slot: u32) -> BlockCoord {
        self.coords[slot as usize]
    }

    /// Coordinates of the block that a world point (metres) lies in; saturates far outside.
    #[inline]
    pub fn block_at(&self, p: Vec3) -> BlockCoord {
        (p / (self.voxel_m * EDGE as f32)).floor().as_ivec3()
    }

    /// The slot of a block.
    #[inline]
    pub fn find(&self, c: BlockCoord) -> Option<u32> {
        key_of(c).and_then(|key| self.find_key(key))
    }

    #[inline]
    fn find_key(&self, key: u64) -> Option<u32> {
        let mask = self.keys.len() - 1;
        let mut at = hash(key) & mask;
        for _ in 0..MAX_PROBES {
            if self.keys[at] == key {
                return Some(self.slots[at]);
            }
            if self.keys[at] == EMPTY {
                return None;
            }
            at = (at + 1) & mask;
        }
        None
    }

    /// The slot of a block, taken from the pool if it is new.
    pub fn allocate(&mut self, c: BlockCoord) -> Result<u32, Refusal> {
        let key = key_of(c).ok_or(Refusal::Outside)?;
        let mask = self.keys.len() - 1;
        let mut at = hash(key) & mask;
        for _ in 0..MAX_PROBES {
            if self.keys[at] == key {
                return Ok(self.slots[at]);
            }
            if self.keys[at] == EMPTY {
                let slot = self.free.pop().ok_or(Refusal::Full)?;
                self.keys[at] = key;
                self.slots[at] = slot;
                self.coords[slot as usize] = c;
                self.used += 1;
                self.high_water = self.high_water.max(slot as usize + 1);
                return Ok(slot);
            }
            at = (at + 1) & mask;
        }
        Err(Refusal::Full)
    }

    /// Gives the block in a slot back to the pool; what was known of it is gone.
    pub fn release(&mut self, slot: u32) {
        let Some(key) = key_of(self.coords[slot as usize]) else { return };
        let mask = self.keys.len() - 1;
        let mut hole = hash(key) & mask;
        while self.keys[hole] != key {
            hole = (hole + 1) & mask;
        }
        // Those behind it that would no longer be found move up.
        let mut next = (hole + 1) & mask;
        while self.keys[next] != EMPTY {
            let home = hash(self.keys[next]) & mask;
            if (next.wrapping_sub(home) & mask) >= (next.wrapping_sub(hole) & mask) {
                (self.keys[hole], self.slots[hole]) = (self.keys[next], self.slots[next]);
                hole = next;
            }
            next = (next + 1) & mask;
        }
        self.keys[hole] = EMPTY;
        self.coords[slot as usize] = NOWHERE;
        self.free.push(slot);
        self.used -= 1;
        let (sdf, weight) = self.block_mut(slot);
        sdf.fill(0);
        weight.fill(0);
    }

    /// Distances and weights of a block, index `z·64 + y·8 + x`.
    #[inline]
    pub fn block(&self, slot: u32) -> (&[i16], &[u16]) {
        let at = slot as usize * VOXELS;
        (&self.sdf[at..at + VOXELS], &self.weight[at..at + VOXELS])
    }

    /// The same, to change.
    #[inline]
    pub fn block_mut(&mut self, slot: u32) -> (&mut [i16], &mut [u16]) {
        let at = slot as usize * VOXELS;
        (&mut self.sdf[at..at + VOXELS], &mut self.weight[at..at + VOXELS])
    }

    /// All distances and weights, slot after slot, with the coordinates of the slots.
    pub fn pool_mut(&mut self) -> (&mut [i16], &mut [u16], &[BlockCoord]) {
        (&mut self.sdf, &mut self.weight, &self.coords)
    }

    /// Slots in use, in the order of their coordinates (z, y, x).
    pub fn sorted_slots(&self) -> Vec<u32> {
        let mut slots: Vec<(u64, u32)> =
            self.keys.iter().zip(&self.slots).filter(|(k, _)| **k != EMPTY).map(|(k, s)| (*k, *s)).collect();
        slots.sort_unstable();
        slots.into_iter().map(|(_, s)| s).collect()
    }

    /// Stored distance and weight of a voxel; weight 0 where there is none.
    #[inline]
    pub fn voxel(&self, v: IVec3, cursor: &mut Cursor) -> (i16, u16) {
        let Some(slot) = self.seek(v >> 3, cursor) else { return (0, 0) };
        let at = slot as usize * VOXELS + index(v & 7);
        (self.sdf[at], self.weight[at])
    }

    #[inline]
    fn seek(&self, c: BlockCoord, cursor: &mut Cursor) -> Option<u32> {
        let key = key_of(c)?;
        if cursor.key != key {
            *cursor = Cursor { key, slot: self.find_key(key) };
        }
        cursor.slot
    }

    /// Trilinear signed distance with its gradient at a world point; `None` next to voxels never seen.
    #[inline]
    pub fn sample(&self, p: Vec3, cursor: &mut Cursor) -> Option<Sample> {
        let g = p / self.voxel_m;
        let base = g.floor();
        let f = g - base;
        let v = base.as_ivec3();
        let mut s = [0.0f32; 8];
        let mut least = u16::MAX;
        let l = v & 7;
        if l.max_element() < 7 {
            let slot = self.seek(v >> 3, cursor)? as usize * VOXELS;
            let first = slot + index(l);
            let (sdf, weight) = (&self.sdf[first..first + 74], &self.weight[first..first + 74]);
            for (i, at) in [0, 1, 8, 9, 64, 65, 72, 73].into_iter().enumerate() {
                s[i] = f32::from(sdf[at]);
                least = least.min(weight[at]);
            }
        } else {
            for (i, s) in s.iter_mut().enumerate() {
                let corner = v + IVec3::new(i as i32 & 1, (i as i32 >> 1) & 1, i as i32 >> 2);
                let (d, w) = self.voxel(corner, cursor);
                *s = f32::from(d);
                least = least.min(w);
            }
        }
        if least == 0 {
            return None;
        }
        let (x0, x1, x2, x3) = (
            s[0] + f.x * (s[1] - s[0]),
            s[2] + f.x * (s[3] - s[2]),
            s[4] + f.x * (s[5] - s[4]),
            s[6] + f.x * (s[7] - s[6]),
        );
        let (y0, y1) = (x0 + f.y * (x1 - x0), x2 + f.y * (x3 - x2));
        let dx = (1.0 - f.z) * ((1.0 - f.y) * (s[1] - s[0]) + f.y * (s[3] - s[2]))
            + f.z * ((1.0 - f.y) * (s[5] - s[4]) + f.y * (s[7] - s[6]));
        let dy = (1.0 - f.z) * (x1 - x0) + f.z * (x3 - x2);
        let dz = y1 - y0;
        let unit = self.truncation_m() / SDF_ONE;
        Some(Sample { distance: (y0 + f.z * dz) * unit, gradient: Vec3::new(dx, dy, dz) * (unit / self.voxel_m) })
    }

    /// Doubles the voxel size in place: the new lattice is every second point of the old one, so the surface stays
    /// where it is, and eight blocks become one.
    pub fn coarsen(&mut self) {
        let mut parents: Vec<(u64, u32)> = self
            .sorted_slots()
            .into_iter()
            .filter_map(|slot| key_of(self.coords[slot as usize] >> 1).map(|key| (key, slot)))
            .collect();
        parents.sort_unstable();
        self.keys.fill(EMPTY);
        self.used = 0;
        let mut sdf = [0i16; VOXELS];
        let mut weight = [0u16; VOXELS];
        for family in parents.chunk_by(|a, b| a.0 == b.0) {
            sdf.fill(0);
            weight.fill(0);
            for &(_, slot) in family {
                let octant = (self.coords[slot as usize] & 1) * (EDGE as i32 / 2);
                let (s, w) = self.block_mut(slot);
                for z in 0..4 {
                    for y in 0..4 {
                        for x in 0..4 {
                            let from = index(IVec3::new(2 * x, 2 * y, 2 * z));
                            let to = index(octant + IVec3::new(x, y, z));
                            // The truncation distance doubles with the voxel, so stored distances halve.
                            sdf[to] = s[from] / 2;
                            weight[to] = w[from];
                        }
                    }
                }
                s.fill(0);
                w.fill(0);
            }
            let parent = self.coords[family[0].1 as usize] >> 1;
            for &(_, slot) in family.iter().rev() {
                self.coords[slot as usize] = NOWHERE;
                self.free.push(slot);
            }
            // At least one block was freed just now, so this only fails on an overlong probe sequence.
            if let Ok(slot) = self.allocate(parent) {
                let (s, w) = self.block_mut(slot);
                s.copy_from_slice(&sdf);
                w.copy_from_slice(&weight);
            }
        }
        self.voxel_m *= 2.0;
    }
}

/// Index of a voxel within its block.
#[inline(always)]
pub fn index(v: IVec3) -> usize {
    (v.z << 6 | v.y << 3 | v.x) as usize & (VOXELS - 1)
}

#[inline]
fn hash(key: u64) -> usize {
    let h = key.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (h ^ (h >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) as usize >> 20
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(blocks: u32, radius: f32) -> Volume {
        let config = FusionConfig { pool_blocks: blocks, fine_blocks: 0, ..FusionConfig::default() };
        let mut volume = Volume::new(&config);
        let n = (radius / (volume.voxel_m() * 8.0)).ceil() as i32 + 1;
        for z in -n..n {
            for y in -n..n {
                for x in -n..n {
                    let slot = volume.allocate(IVec3::new(x, y, z)).unwrap();
                    let (voxel_m, mu) = (volume.voxel_m(), volume.truncation_m());
                    let (sdf, weight) = volume.block_mut(slot);
                    for i in 0..VOXELS {
                        let v = IVec3::new(i as i32 & 7, (i as i32 >> 3) & 7, i as i32 >> 6) + 8 * IVec3::new(x, y, z);
                        let d = (v.as_vec3() * voxel_m).length() - radius;
                        sdf[i] = ((d / mu).clamp(-1.0, 1.0) * SDF_ONE) as i16;
                        weight[i] = (10.0 / WEIGHT_UNIT) as u16;
                    }
                }
            }
        }
        volume
    }

    #[test]
    fn samples_the_distance_to_a_sphere_also_after_coarsening() {
        let mut volume = sphere(1000, 0.1);
        for coarsened in [false, true] {
            if coarsened {
                let before = volume.used();
                volume.coarsen();
                assert!(volume.used() <= before.div_ceil(8) + 1 && (volume.voxel_m() - 0.01).abs() < 1e-6);
            }
            let mut cursor = Cursor::default();
            for i in 0..200 {
                let d = Vec3::new((i % 7) as f32 - 3.0, (i % 5) as f32 - 2.0, (i % 11) as f32 - 5.1).normalize();
                let s = volume.sample(d * 0.104, &mut cursor).unwrap();
                assert!((s.distance - 0.004).abs() < 6e-4, "{} {coarsened}", s.distance);
                assert!(s.gradient.normalize().dot(d) > 0.98);
            }
        }
    }

    /// Blocks that come and go in an order of chance: those that are there are found, and hold what was written.
    #[test]
    fn released_blocks_are_gone_and_the_others_are_found() {
        let mut volume = Volume::new(&FusionConfig { pool_blocks: 256, ..FusionConfig::default() });
        let coord = |n: u64| IVec3::new((n % 7) as i32 - 3, (n / 7 % 7) as i32, (n / 49 % 7) as i32);
        let mut there = std::collections::BTreeMap::new();
        for step in 0..20_000u64 {
            let n = hash(step) as u64 % 343;
            match there.remove(&n) {
                Some(slot) => volume.release(slot),
                None if there.len() < 256 => {
                    let slot = volume.allocate(coord(n)).unwrap();
                    assert!(volume.block(slot).1.iter().all(|w| *w == 0), "not empty");
                    volume.block_mut(slot).1.fill(n as u16 + 1);
                    there.insert(n, slot);
                }
                None => {}
            }
            assert_eq!(volume.used(), there.len());
            let n = hash(step ^ 0xABCD) as u64 % 343;
            assert_eq!(volume.find(coord(n)), there.get(&n).copied());
        }
        assert!(there.iter().all(|(n, slot)| volume.block(*slot).1[5] == *n as u16 + 1));
    }

    #[test]
    fn a_full_pool_refuses_and_nothing_else_happens() {
        let mut volume = Volume::new(&FusionConfig { pool_blocks: 256, ..FusionConfig::default() });
        for i in 0..256 {
            assert!(volume.allocate(IVec3::new(i, -i, 3)).is_ok());
        }
        assert_eq!(volume.allocate(IVec3::new(-1, 0, 0)), Err(Refusal::Full));
        assert!(volume.allocate(IVec3::new(5, -5, 3)).is_ok());
        assert_eq!(volume.allocate(IVec3::new(i32::MAX, 0, 0)), Err(Refusal::Outside));
        assert_eq!(volume.used(), 256);
    }
}
