//! Coarsening of the volume in place.

use crate::tsdf::volume::{EDGE, EMPTY, NOWHERE, VOXELS, Volume, index, key_of};
use glam::IVec3;

impl Volume {
    /// Doubles the voxel size in place: every second lattice point stays, so the surface does not move, and eight blocks
    /// become one.
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
                            // The truncation distance doubles with the voxel size, so stored distances halve.
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
            // At least one block was freed above, so this fails only on an overlong probe sequence.
            if let Ok(slot) = self.allocate(parent) {
                let (s, w) = self.block_mut(slot);
                s.copy_from_slice(&sdf);
                w.copy_from_slice(&weight);
            }
        }
        self.voxel_m *= 2.0;
    }
}
