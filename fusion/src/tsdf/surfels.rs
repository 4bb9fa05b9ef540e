//! The surface while it grows, for display: surfels of the blocks that changed, a bounded number per call. Reading changes
//! nothing, so a scan is the same whether it is read or not.
//!
//! Surfels are the vertices of naive surface nets (Gibson 1998) on every second sample: one in each cell of 2 × 2 × 2 voxels
//! that the surface crosses.

use crate::tsdf::marching_cubes::Padded;
use crate::tsdf::volume::{BlockCoord, NOWHERE, Volume, WEIGHT_UNIT};
use glam::{IVec3, Vec3};

/// Cells along the edge of a block.
pub const CELLS: usize = 4;
/// Units of a surfel's position along the edge of a block.
const POSITION_UNITS: f32 = 255.0;
/// Steps of the stored weight per factor of two.
const WEIGHT_STEPS: f32 = 32.0;
/// Bit of [`Surfel::signs`]: the cell's lowest corner is behind the surface.
const BEHIND: u8 = 8;

/// A point of the surface.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Surfel {
    /// Its cell in the block, `(z · 4 + y) · 4 + x`.
    pub cell: u8,
    /// Bits 0 to 2: the surface crosses the cell's edge along x, y, z from its lowest corner; bit 3: that corner is behind
    /// the surface.
    pub signs: u8,
    /// Position in the block, x, y, z, in units of its edge / 255.
    pub position: [u8; 3],
    /// Normal, octahedral, from −127 to 127.
    pub normal: [i8; 2],
    /// Weight w in frames seen from 1 m, as 32 log2(1 + w).
    pub weight: u8,
}

/// The surfels of a block; none if it has no surface any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockSurface {
    /// Coordinates of the block, in units of its edge.
    pub coord: [i32; 3],
    /// Surfels in the order of their cells.
    pub surfels: Vec<Surfel>,
}

/// What has been read of a volume.
#[derive(Debug, Default)]
pub struct SurfaceReader {
    /// `[slot]`: frame of the last reading.
    read: Vec<u32>,
    /// `[slot]`: the block that was read.
    coords: Vec<BlockCoord>,
    next: usize,
    /// Edge length of a voxel, metres. When it changes, what was read before is void.
    voxel_m: f32,
}

impl SurfaceReader {
    /// Edge length of a voxel at the last reading, metres. Blocks read at another size are void.
    #[must_use]
    pub fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    /// Reads at most `limit` blocks that changed. `stamp` is `[slot]`: the last frame that updated the block.
    pub(crate) fn read(&mut self, volume: &Volume, stamp: &[u32], limit: usize, out: &mut Vec<BlockSurface>) {
        let slots = volume.high_water();
        if self.voxel_m != volume.voxel_m() {
            (self.read, self.coords, self.voxel_m) = (Vec::new(), Vec::new(), volume.voxel_m());
        }
        self.read.resize(slots, 0);
        self.coords.resize(slots, NOWHERE);
        let mut left = limit;
        for _ in 0..slots {
            if left == 0 {
                break;
            }
            self.next = (self.next + 1) % slots;
            let (slot, coord) = (self.next, volume.coord(self.next as u32));
            let known = self.coords[slot];
            if known != NOWHERE && known != coord {
                self.coords[slot] = NOWHERE;
                if volume.find(known).is_none() {
                    out.push(BlockSurface { coord: known.into(), surfels: Vec::new() });
                }
            }
            if coord != NOWHERE && (stamp[slot] > self.read[slot] || self.coords[slot] == NOWHERE) {
                (self.read[slot], self.coords[slot]) = (stamp[slot], coord);
                out.push(BlockSurface { coord: coord.into(), surfels: surfels(&Padded::gather(volume, coord)) });
                left -= 1;
            }
        }
    }
}

/// Corner `i` of a cell, by its bits x, y, z.
fn corner(i: usize) -> IVec3 {
    IVec3::new(i as i32 & 1, i as i32 >> 1 & 1, i as i32 >> 2)
}

fn surfels(samples: &Padded) -> Vec<Surfel> {
    let cells =
        (0..CELLS as i32).flat_map(|z| (0..CELLS as i32).flat_map(move |y| (0..CELLS as i32).map(move |x| (x, y, z))));
    cells.filter_map(|(x, y, z)| surfel(samples, IVec3::new(x, y, z))).collect()
}

fn surfel(samples: &Padded, cell: IVec3) -> Option<Surfel> {
    let corners: [(f32, u16); 8] = std::array::from_fn(|i| samples.sample(2 * (cell + corner(i))));
    let behind = corners.iter().filter(|(d, _)| *d < 0.0).count();
    let least = corners.iter().map(|c| c.1).min().unwrap_or(0);
    if behind == 0 || behind == 8 || least == 0 {
        return None;
    }
    let (mut sum, mut count, mut signs) = (Vec3::ZERO, 0.0, 0);
    let mut gradient = Vec3::ZERO;
    for (axis, along) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().enumerate() {
        for i in (0..8).filter(|i| i >> axis & 1 == 0) {
            let (a, b) = (corners[i].0, corners[i | 1 << axis].0);
            gradient[axis] += b - a;
            if (a < 0.0) != (b < 0.0) {
                sum += corner(i).as_vec3() + along * (a / (a - b));
                count += 1.0;
                signs |= u8::from(i == 0) << axis;
            }
        }
    }
    let position = (cell.as_vec3() + sum / count) * (POSITION_UNITS / CELLS as f32);
    Some(Surfel {
        cell: ((cell.z * 4 + cell.y) * 4 + cell.x) as u8,
        signs: signs | if corners[0].0 < 0.0 { BEHIND } else { 0 },
        position: position.round().to_array().map(|x| x as u8),
        normal: octahedral(gradient),
        weight: (WEIGHT_STEPS * libm::log2f(1.0 + f32::from(least) * WEIGHT_UNIT)).round() as u8,
    })
}

/// The direction of a vector on the octahedron (Meyer et al. 2010).
fn octahedral(v: Vec3) -> [i8; 2] {
    let v = v / v.abs().element_sum().max(1e-12);
    let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
    let (x, y) = if v.z >= 0.0 { (v.x, v.y) } else { ((1.0 - v.y.abs()) * sign(v.x), (1.0 - v.x.abs()) * sign(v.y)) };
    [x, y].map(|x| (127.0 * x).round() as i8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tsdf::volume::{SDF_ONE, VOXELS};
    use firmware_config::FusionConfig;

    /// A plane z = 0.043 in a volume of 4³ blocks.
    fn plane() -> Volume {
        let config = FusionConfig { pool_blocks: 256, fine_blocks: 0, ..FusionConfig::default() };
        let mut volume = Volume::new(&config);
        for i in 0..64 {
            let coord = IVec3::new(i & 3, i >> 2 & 3, i >> 4);
            let slot = volume.allocate(coord).unwrap();
            let (voxel_m, mu) = (volume.voxel_m(), volume.truncation_m());
            let (sdf, weight) = volume.block_mut(slot);
            for k in 0..VOXELS {
                let z = (8 * coord.z + (k >> 6) as i32) as f32 * voxel_m;
                sdf[k] = (((z - 0.043) / mu).clamp(-1.0, 1.0) * SDF_ONE) as i16;
                weight[k] = (7.0 / WEIGHT_UNIT) as u16;
            }
        }
        volume
    }

    #[test]
    fn surfels_lie_on_the_surface_and_only_changes_are_read() {
        let volume = plane();
        let mut stamp = vec![1; 256];
        let (mut reader, mut out) = (SurfaceReader::default(), Vec::new());
        for _ in 0..10 {
            reader.read(&volume, &stamp, 10, &mut out);
        }
        assert_eq!(out.len(), 64, "each block once");
        let edge = 8.0 * volume.voxel_m();
        let all: Vec<(Vec3, Surfel)> = out
            .iter()
            .flat_map(|b| {
                let at = IVec3::from(b.coord).as_vec3();
                b.surfels.iter().map(move |s| ((at + Vec3::from(s.position.map(f32::from)) / 255.0) * edge, *s))
            })
            .collect();
        // The last layer of cells borders on blocks that do not exist.
        assert_eq!(all.len(), 15 * 15);
        for (p, s) in all {
            assert!((p.z - 0.043).abs() < 2e-4 && s.normal == [0, 0] && s.weight == 96, "{p} {s:?}");
            assert_eq!(s.signs, 0b1100, "the surface crosses the edge along z");
        }
        out.clear();
        stamp[3] = 2;
        reader.read(&volume, &stamp, 10, &mut out);
        assert_eq!(out.len(), 1);
    }

    #[test]
    fn a_block_that_was_released_is_read_as_empty_and_a_coarser_volume_anew() {
        let mut volume = plane();
        let stamp = vec![1; 256];
        let (mut reader, mut out) = (SurfaceReader::default(), Vec::new());
        reader.read(&volume, &stamp, 100, &mut out);
        let slot = volume.find(IVec3::new(1, 2, 1)).unwrap();
        volume.release(slot);
        out.clear();
        reader.read(&volume, &stamp, 100, &mut out);
        assert_eq!(out, [BlockSurface { coord: [1, 2, 1], surfels: Vec::new() }]);
        volume.coarsen();
        out.clear();
        reader.read(&volume, &stamp, 100, &mut out);
        assert!(out.len() == volume.used() && reader.voxel_m() == volume.voxel_m());
    }

    #[test]
    fn normals_keep_their_direction() {
        assert_eq!(
            [octahedral(Vec3::X), octahedral(-Vec3::Y), octahedral(-Vec3::Z)],
            [[127, 0], [0, -127], [127, 127]]
        );
    }
}
