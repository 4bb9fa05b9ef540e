//! The surface seen so far, block by block, and what of it changed since a client last asked.

use fusion::{BlockSurface, Surfel};
use std::collections::BTreeMap;

/// Bytes of the longest answer; a client asks again for the rest.
const ANSWER_BYTES: usize = 256 << 10;
/// Blocks, empty ones included, beyond which the surface is read anew.
const MOST_BLOCKS: usize = 1 << 17;
/// A surfel that moved by less (1/255 of a block) and gained less weight (1/32 of a factor of two) has not changed.
const MOVED: u8 = 8;
const GAINED: u8 = 12;

/// Blocks by their coordinates, with their surfels.
pub type Blocks = Vec<([i32; 3], Vec<Surfel>)>;

struct Block {
    changed: u64,
    surfels: Box<[Surfel]>,
}

/// The blocks of a scan by their coordinates.
#[derive(Default)]
pub struct Surface {
    /// Counts the times that everything before became void.
    generation: u32,
    voxel_m: f32,
    /// Number of the last change.
    change: u64,
    blocks: BTreeMap<[i32; 3], Block>,
    /// Blocks by their last change.
    order: BTreeMap<u64, [i32; 3]>,
}

impl Surface {
    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self { generation: self.generation.wrapping_add(1), ..Self::default() };
    }

    /// True if so many blocks are known that the surface should be read anew.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.blocks.len() > MOST_BLOCKS
    }

    /// Takes blocks that were read at this voxel size; another size makes those before it void.
    pub fn update(&mut self, voxel_m: f32, blocks: Vec<BlockSurface>) {
        if voxel_m != self.voxel_m {
            self.clear();
            self.voxel_m = voxel_m;
        }
        for BlockSurface { coord, surfels } in blocks {
            let old = self.blocks.get(&coord);
            if old.map_or(surfels.is_empty(), |old| is_alike(&old.surfels, &surfels)) {
                continue;
            }
            if let Some(old) = old {
                self.order.remove(&old.changed);
            }
            self.change += 1;
            self.order.insert(self.change, coord);
            self.blocks.insert(coord, Block { changed: self.change, surfels: surfels.into() });
        }
    }

    /// The blocks with surface, and the edge length of a voxel in metres.
    #[must_use]
    pub fn blocks(&self) -> (Blocks, f32) {
        let all = self.blocks.iter().filter(|(_, b)| !b.surfels.is_empty());
        (all.map(|(c, b)| (*c, b.surfels.to_vec())).collect(), self.voxel_m)
    }

    /// The blocks that changed after `since`, oldest change first. Little endian: `LSRF`, generation u32, number of the last
    /// change that is included u64, voxel size f32 (metres), number of blocks u32; then for each block its coordinates
    /// 3 × i32, number of surfels u32, and 8 bytes a surfel ([`Surfel`]). A generation other than the client's own makes
    /// what it has void.
    #[must_use]
    pub fn since(&self, generation: u32, since: u64) -> Vec<u8> {
        let since = if generation == self.generation { since } else { 0 };
        let (mut body, mut count, mut last) = (Vec::new(), 0u32, since);
        for (change, coord) in self.order.range(since.saturating_add(1)..) {
            let Some(block) = self.blocks.get(coord) else { continue };
            if body.len() + 16 + 8 * block.surfels.len() > ANSWER_BYTES {
                break;
            }
            body.extend(coord.iter().flat_map(|c| c.to_le_bytes()));
            body.extend((block.surfels.len() as u32).to_le_bytes());
            for s in &block.surfels {
                let [nx, ny] = s.normal.map(|n| n.to_le_bytes()[0]);
                body.extend([s.cell, s.signs, s.position[0], s.position[1], s.position[2], nx, ny, s.weight]);
            }
            (count, last) = (count + 1, *change);
        }
        let mut all = b"LSRF".to_vec();
        all.extend(self.generation.to_le_bytes());
        all.extend(last.to_le_bytes());
        all.extend(self.voxel_m.to_le_bytes());
        all.extend(count.to_le_bytes());
        all.append(&mut body);
        all
    }
}

fn is_alike(old: &[Surfel], new: &[Surfel]) -> bool {
    old.len() == new.len()
        && old.iter().zip(new).all(|(a, b)| {
            let still = a.position.iter().zip(b.position).all(|(a, b)| a.abs_diff(b) < MOVED);
            a.cell == b.cell && a.signs == b.signs && still && a.weight.abs_diff(b.weight) < GAINED
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(x: i32, weights: &[u8]) -> BlockSurface {
        let surfel = |w: &u8| Surfel { cell: 0, signs: 1, position: [1, 2, 3], normal: [0, -1], weight: *w };
        BlockSurface { coord: [x, -1, 0], surfels: weights.iter().map(surfel).collect() }
    }

    fn numbers(answer: &[u8]) -> (u32, u64, u32) {
        let u32_at = |at: usize| u32::from_le_bytes(answer[at..at + 4].try_into().unwrap());
        (u32_at(4), u64::from_le_bytes(answer[8..16].try_into().unwrap()), u32_at(20))
    }

    #[test]
    fn a_client_gets_what_changed_since_it_asked() {
        let mut surface = Surface::default();
        surface.update(0.005, vec![block(0, &[10]), block(1, &[10, 10]), block(2, &[])]);
        let (generation, last, count) = numbers(&surface.since(0, 0));
        assert_eq!((last, count), (2, 2), "an empty block that was never seen is no news");
        surface.update(0.005, vec![block(0, &[11]), block(1, &[40, 40])]);
        let answer = surface.since(generation, last);
        assert_eq!(numbers(&answer), (generation, 3, 1), "a little more weight is no news either");
        assert_eq!(answer.len(), 24 + 16 + 16);
        assert_eq!(answer[24 + 16..24 + 24], [0, 1, 1, 2, 3, 0, 255, 40]);
        surface.update(0.005, vec![block(1, &[])]);
        assert_eq!(numbers(&surface.since(generation, 3)), (generation, 4, 1), "a block that is gone");
        surface.update(0.01, vec![block(7, &[1])]);
        let (other, _, count) = numbers(&surface.since(generation, 4));
        assert!(other != generation && count == 1, "another voxel size is a fresh start");
    }

    #[test]
    fn long_answers_come_in_parts() {
        let mut surface = Surface::default();
        surface.update(0.005, (0..2000).map(|x| block(x, &[9; 64])).collect());
        let (mut seen, mut since, mut answers) = (0, 0, 0);
        while seen < 2000 {
            let answer = surface.since(1, since);
            assert!(answer.len() <= ANSWER_BYTES + 24);
            let (_, last, count) = numbers(&answer);
            (seen, since, answers) = (seen + count, last, answers + 1);
        }
        assert!(answers > 3 && numbers(&surface.since(1, since)).2 == 0);
    }
}
