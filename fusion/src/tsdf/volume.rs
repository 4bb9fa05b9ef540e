//! The block pool: a fixed number of 8³-voxel blocks, found by a hash of their coordinates (Nießner et al. 2013).
//!
//! Voxel (i, j, k) is the sample at (i, j, k) · voxel size; block (a, b, c) holds voxels 8a … 8a+7 and so on. Distances are
//! stored as `i16` in units of truncation / 32767, positive before the surface; weights as `u16` in units of
//! [`WEIGHT_UNIT`] frames, 0 = never observed. Nothing is allocated after construction.

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
/// Coordinates lie within ± this many blocks of the origin, so that one fits 20 bits.
const MAX_BLOCK: i32 = 1 << 19;
/// Longest probe sequence in the hash table.
const MAX_PROBES: usize = 256;
/// Marks an empty entry of the hash table.
pub(super) const EMPTY: u64 = u64::MAX;
/// Coordinates of a free slot.
pub(super) const NOWHERE: BlockCoord = BlockCoord::MIN;

/// Coordinates of a block in units of blocks.
pub type BlockCoord = IVec3;

/// Why a block was not allocated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The pool (or the probe sequence) is full.
    Full,
    /// The coordinates are outside the addressable range.
    Outside,
}

/// The block pool with its hash table.
pub struct Volume {
    /// `[slot][voxel]`.
    pub(super) sdf: Vec<i16>,
    /// `[slot][voxel]`.
    pub(super) weight: Vec<u16>,
    /// `[slot]`.
    pub(super) coords: Vec<BlockCoord>,
    /// Free slots.
    pub(super) free: Vec<u32>,
    /// The hash table: keys, …
    pub(super) keys: Vec<u64>,
    /// … and slots.
    slots: Vec<u32>,
    pub(super) used: usize,
    high_water: usize,
    pub(super) voxel_m: f32,
    truncation_voxels: f32,
}

/// Key of a block in the hash table; `None` outside the addressable range.
pub(super) fn key_of(c: BlockCoord) -> Option<u64> {
    let bias = |x: i32| (-MAX_BLOCK..MAX_BLOCK).contains(&x).then(|| (x + MAX_BLOCK) as u64);
    Some((bias(c.z)? << 40) | (bias(c.y)? << 20) | bias(c.x)?)
}

impl Volume {
    /// A volume with all blocks free. Voxels have half the length of the setting if `fusion.fine_blocks` allows it.
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

    /// All slots used so far are below this one.
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

    /// Coordinates of the block that contains a world point (metres); saturates far outside.
    #[inline]
    pub fn block_at(&self, p: Vec3) -> BlockCoord {
        (p / (self.voxel_m * EDGE as f32)).floor().as_ivec3()
    }

    /// The slot of a block, if it is allocated.
    #[inline]
    pub fn find(&self, c: BlockCoord) -> Option<u32> {
        key_of(c).and_then(|key| self.find_key(key))
    }

    #[inline]
    pub(super) fn find_key(&self, key: u64) -> Option<u32> {
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

    /// The slot of a block; a new block is taken from the pool.
    ///
    /// # Errors
    /// The pool is full, or the coordinates are outside the addressable range.
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

    /// Returns the block in a slot to the pool and clears it.
    pub fn release(&mut self, slot: u32) {
        let Some(key) = key_of(self.coords[slot as usize]) else { return };
        let mask = self.keys.len() - 1;
        let mut hole = hash(key) & mask;
        while self.keys[hole] != key {
            hole = (hole + 1) & mask;
        }
        // Entries behind it that would no longer be found move up.
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

    /// Mutable distances and weights of a block.
    #[inline]
    pub fn block_mut(&mut self, slot: u32) -> (&mut [i16], &mut [u16]) {
        let at = slot as usize * VOXELS;
        (&mut self.sdf[at..at + VOXELS], &mut self.weight[at..at + VOXELS])
    }

    /// All distances and weights, `[slot][voxel]`, with the coordinates of the slots.
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
}

/// Index of a voxel in its block.
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

    /// Blocks are allocated and released in random order: allocated ones are found and hold their values.
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
