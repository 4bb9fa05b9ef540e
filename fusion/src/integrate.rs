//! TSDF integration: blocks near the measured surface are taken from the pool, and every block that the frame tells
//! something about is averaged with it (Curless, Levoy 1996).

use crate::camera::{Pinhole, Rig, Rigid};
use crate::isa::{Hot, Isa, dispatch};
use crate::volume::{BlockCoord, EDGE, Refusal, SDF_ONE, VOXELS, Volume, WEIGHT_UNIT};
use firmware_config::FusionConfig;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Pose;

/// Depth pixels per allocation ray, along each side.
const ALLOCATION_STEP: usize = 4;
/// Blocks that a rayon task handles.
const SLOTS_PER_TASK: usize = 256;
/// Blocks outside the band are asked every so many frames whether the frame sees them as free space.
const CARVE_PERIOD: usize = 8;
/// Every so many frames a block is asked whether it is worth its place.
const RECYCLE_PERIOD: usize = 64;
/// A block in which this many frames measured no surface goes back to the pool …
const FORGET_FRAMES: u32 = 300;
/// … unless something in it has this weight, in frames seen from 1 m.
const WORTH_WEIGHT: f32 = 0.5;

/// What integration needs to remember from frame to frame.
pub struct Integrator {
    isa: Isa,
    /// Per slot: number of the frame that touches it.
    stamp: Vec<u32>,
    /// Per slot: number of the frame that last measured a surface in it.
    measured: Vec<u32>,
    frame: u32,
    max_weight: f32,
    recent: Vec<BlockCoord>,
}

/// What integration did.
#[derive(Debug, Clone, Copy)]
pub struct Integrated {
    /// Blocks averaged with the frame.
    pub blocks: usize,
    /// Blocks that were wanted and not to be had.
    pub refused: u64,
}

impl Integrator {
    /// For a volume of `blocks` slots.
    pub fn new(config: &FusionConfig) -> Self {
        Self {
            isa: Isa::detect(),
            stamp: vec![0; config.pool_blocks as usize],
            measured: vec![0; config.pool_blocks as usize],
            frame: 0,
            max_weight: config.max_weight as f32 / WEIGHT_UNIT,
            recent: Vec::with_capacity(8),
        }
    }

    /// Averages a depth image (metres, row-major, 0 = none) seen from `world_from_depth` into the volume.
    pub fn integrate(&mut self, volume: &mut Volume, rig: &Rig, depth: &[f32], world_from_depth: &Pose) -> Integrated {
        self.frame = self.frame.wrapping_add(1);
        self.recycle(volume);
        let refused = self.allocate(volume, &rig.depth, depth, world_from_depth);
        self.mark_free_space(volume, &rig.depth, depth, world_from_depth);
        let kernel = Kernel::new(&rig.depth, &world_from_depth.inverse(), volume, self.max_weight);
        let (frame, isa, stamp) = (self.frame, self.isa, &self.stamp);
        let (sdf, weight, coords) = volume.pool_mut();
        let blocks = sdf
            .par_chunks_mut(SLOTS_PER_TASK * VOXELS)
            .zip(weight.par_chunks_mut(SLOTS_PER_TASK * VOXELS))
            .zip(stamp.par_chunks(SLOTS_PER_TASK).zip(coords.par_chunks(SLOTS_PER_TASK)))
            .map(|((sdf, weight), (stamp, coords))| {
                let mut blocks = 0;
                for (i, _) in stamp.iter().enumerate().filter(|(_, s)| **s == frame) {
                    let at = i * VOXELS..(i + 1) * VOXELS;
                    let (sdf, weight) = (&mut sdf[at.clone()], &mut weight[at]);
                    dispatch(isa, BlockUpdate { kernel: &kernel, depth, coord: coords[i], sdf, weight });
                    blocks += 1;
                }
                blocks
            })
            .sum();
        Integrated { blocks, refused }
    }

    /// To be told when the volume has been coarsened: the slots hold other blocks now.
    pub fn coarsened(&mut self) {
        self.measured.fill(self.frame);
    }

    /// Takes blocks along each ray from truncation before to truncation behind the measured depth.
    fn allocate(&mut self, volume: &mut Volume, camera: &Pinhole, depth: &[f32], world_from_depth: &Pose) -> u64 {
        let t = Rigid::from(world_from_depth);
        let mu = volume.truncation_m();
        let mut refused = 0;
        for v in (0..camera.height).step_by(ALLOCATION_STEP) {
            for u in (0..camera.width).step_by(ALLOCATION_STEP) {
                let z = depth[v * camera.width + u];
                if z <= 0.0 {
                    continue;
                }
                let ray = camera.ray(u as f32, v as f32);
                let direction = t.r * ray;
                self.recent.clear();
                for k in -2i32..=2 {
                    let c = volume.block_at(t.t + direction * (z + 0.5 * mu * k as f32));
                    if self.recent.contains(&c) {
                        continue;
                    }
                    self.recent.push(c);
                    match volume.allocate(c) {
                        Ok(slot) => {
                            self.stamp[slot as usize] = self.frame;
                            self.measured[slot as usize] = self.frame;
                        }
                        Err(Refusal::Full) => refused += 1,
                        Err(Refusal::Outside) => {}
                    }
                }
            }
        }
        refused
    }

    /// Gives back, of the blocks whose turn it is, those that hold free space and rare readings only: else a scan that goes
    /// on in one place would fill the pool with them.
    fn recycle(&self, volume: &mut Volume) {
        let worth = (WORTH_WEIGHT / WEIGHT_UNIT) as u16;
        for slot in (self.frame as usize % RECYCLE_PERIOD..volume.high_water()).step_by(RECYCLE_PERIOD) {
            if !volume.is_used(slot as u32) || self.frame.wrapping_sub(self.measured[slot]) < FORGET_FRAMES {
                continue;
            }
            let (sdf, weight) = volume.block(slot as u32);
            if !sdf.iter().zip(weight).any(|(s, w)| *w >= worth && f32::from(*s) < 0.95 * SDF_ONE) {
                volume.release(slot as u32);
            }
        }
    }

    /// Marks, of the blocks whose turn it is, those which the frame looks through.
    fn mark_free_space(&mut self, volume: &Volume, camera: &Pinhole, depth: &[f32], world_from_depth: &Pose) {
        let t = Rigid::from(&world_from_depth.inverse());
        let size = volume.voxel_m() * EDGE as f32;
        for slot in (self.frame as usize % CARVE_PERIOD..volume.high_water()).step_by(CARVE_PERIOD) {
            if self.stamp[slot] == self.frame || !volume.is_used(slot as u32) {
                continue;
            }
            let centre = t.apply((volume.coord(slot as u32).as_vec3() + 0.5) * size);
            let Some(pixel) = camera.pixel(centre) else { continue };
            if depth[pixel] > centre.z {
                self.stamp[slot] = self.frame;
            }
        }
    }
}

/// The update of one block with everything that is the same for all blocks of a frame.
struct Kernel {
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    width: f32,
    height: f32,
    row: i32,
    /// Camera coordinates of the world's origin and of one voxel step along each axis.
    origin: Vec3,
    step: [Vec3; 3],
    per_mu: f32,
    max_weight: f32,
}

/// The update of one block.
struct BlockUpdate<'a> {
    kernel: &'a Kernel,
    depth: &'a [f32],
    coord: BlockCoord,
    sdf: &'a mut [i16],
    weight: &'a mut [u16],
}

impl Hot for BlockUpdate<'_> {
    #[inline(always)]
    fn run(self) {
        self.kernel.block(self.depth, self.coord, self.sdf, self.weight);
    }
}

/// The largest weight stored.
const MOST_WEIGHT: f32 = 65535.0;

/// Adding this to a small f32 leaves its nearest integer in the low bits.
const MAGIC: f32 = 12_582_912.0;
const MAGIC_BITS: i32 = 0x4B40_0000;

#[inline(always)]
fn round_to_int(x: f32) -> i32 {
    (x + MAGIC).to_bits() as i32 - MAGIC_BITS
}

impl Kernel {
    fn new(camera: &Pinhole, depth_from_world: &Pose, volume: &Volume, max_weight: f32) -> Self {
        let t = Rigid::from(depth_from_world);
        let m = volume.voxel_m();
        Self {
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            width: camera.width as f32 - 0.5,
            height: camera.height as f32 - 0.5,
            row: camera.width as i32,
            origin: t.t,
            step: [t.r.x_axis * m, t.r.y_axis * m, t.r.z_axis * m],
            per_mu: 1.0 / volume.truncation_m(),
            max_weight,
        }
    }

    /// Updates one block, slice by slice (8 × 8 voxels): project, look up, average. The first and last step hold no
    /// branch, so that the compiler vectorises them.
    #[inline(always)]
    fn block(&self, depth: &[f32], coord: BlockCoord, sdf: &mut [i16], weight: &mut [u16]) {
        const SLICE: usize = EDGE * EDGE;
        let base = (coord * EDGE as i32).as_vec3();
        let corner = self.origin + self.step[0] * base.x + self.step[1] * base.y + self.step[2] * base.z;
        let mut pixel = [0i32; SLICE];
        let mut voxel_z = [0.0f32; SLICE];
        let mut measured = [0.0f32; SLICE];
        for (k, (sdf, weight)) in sdf.chunks_exact_mut(SLICE).zip(weight.chunks_exact_mut(SLICE)).enumerate() {
            let first = corner + self.step[2] * k as f32;
            for i in 0..SLICE {
                let (x, y) = ((i % EDGE) as f32, (i / EDGE) as f32);
                let px = first.x + self.step[1].x * y + self.step[0].x * x;
                let py = first.y + self.step[1].y * y + self.step[0].y * x;
                let pz = first.z + self.step[1].z * y + self.step[0].z * x;
                let front = pz > 0.05;
                let w = 1.0 / if front { pz } else { 1.0 };
                let u = self.fx * px * w + self.cx;
                let v = self.fy * py * w + self.cy;
                let inside = front & (u > -0.5) & (v > -0.5) & (u < self.width) & (v < self.height);
                let (u, v) = (if inside { u } else { 0.0 }, if inside { v } else { 0.0 });
                let at = round_to_int(v) * self.row + round_to_int(u);
                pixel[i] = if inside { at } else { -1 };
                voxel_z[i] = pz;
            }
            for i in 0..SLICE {
                // −1 is beyond any image.
                measured[i] = depth.get(pixel[i] as u32 as usize).copied().unwrap_or(0.0);
            }
            for i in 0..SLICE {
                let d = measured[i];
                let s = (d - voxel_z[i]) * self.per_mu;
                let seen = (d > 0.0) & (s > -1.0);
                let s = if s < 1.0 { s } else { 1.0 };
                // One frame from 1 m weighs 1; further away less, as the noise grows.
                let far = d - 0.4;
                let new = (0.001884 / WEIGHT_UNIT) / (0.0012 + 0.0019 * far * far);
                let new = if new > 1.0 { new } else { 1.0 };
                // The weight tells how much was seen; what is new counts at least its share of `max_weight`.
                let all = f32::from(weight[i]);
                let old = if all < self.max_weight { all } else { self.max_weight };
                let mean = (f32::from(sdf[i]) * old + s * SDF_ONE * new) / (old + new);
                let sum = if all + new < MOST_WEIGHT { all + new } else { MOST_WEIGHT };
                sdf[i] = if seen { round_to_int(mean) as i16 } else { sdf[i] };
                weight[i] = if seen { round_to_int(sum) as u16 } else { weight[i] };
            }
        }
    }
}
