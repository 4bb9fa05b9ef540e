//! TSDF integration: allocation of blocks near the measured surface, update of every block that the frame observes, recycling
//! (Curless, Levoy 1996).

use crate::camera::pinhole::{Pinhole, Rigid};
use crate::camera::rig::Rig;
use crate::camera::rolling_shutter::RollingShutter;
use crate::tsdf::kernel::{BlockUpdate, Kernel, add_border};
use crate::tsdf::volume::{BlockCoord, EDGE, Refusal, SDF_ONE, VOXELS, Volume, WEIGHT_UNIT};
use firmware_config::FusionConfig;
use isa::{Isa, dispatch};
use rayon::prelude::*;
use recordings::types::Pose;

/// Depth pixels per allocation ray, along each side.
const ALLOCATION_STEP: usize = 4;
/// Blocks per rayon task.
const SLOTS_PER_TASK: usize = 256;
/// Stored distances below this are near the surface, not free space.
const NEAR_SURFACE: f32 = 0.95 * SDF_ONE;

/// State of integration from frame to frame.
pub struct Integrator {
    isa: Isa,
    /// `[slot]`: number of the last frame that updates the block.
    stamp: Vec<u32>,
    /// `[slot]`: number of the last frame that measured a surface in the block.
    measured: Vec<u32>,
    frame: u32,
    /// Blocks of the current ray.
    recent: Vec<BlockCoord>,
    /// Depth with border.
    bordered: Vec<f32>,
}

/// Result of an integration.
#[derive(Debug, Clone, Copy)]
pub struct Integrated {
    /// Number of updated blocks.
    pub blocks: usize,
    /// Number of blocks that could not be allocated.
    pub refused: u64,
}

impl Integrator {
    /// For a volume of `fusion.pool_blocks` slots.
    pub fn new(config: &FusionConfig) -> Self {
        Self {
            isa: Isa::detect(),
            stamp: vec![0; config.pool_blocks as usize],
            measured: vec![0; config.pool_blocks as usize],
            frame: 0,
            recent: Vec::with_capacity(8),
            bordered: Vec::new(),
        }
    }

    /// Integrates a depth image (metres, row-major, 0 = none). `world_from_depth` is the pose of its middle row; `shutter`
    /// gives the poses of the other rows.
    pub fn integrate(
        &mut self,
        volume: &mut Volume,
        rig: &Rig,
        depth: &[f32],
        world_from_depth: &Pose,
        shutter: &RollingShutter,
        config: &FusionConfig,
    ) -> Integrated {
        self.frame = self.frame.wrapping_add(1);
        self.recycle(volume, config);
        let refused = self.allocate(volume, &rig.depth, depth, world_from_depth, shutter);
        let carve_period = config.tuning.volume.carve_period as usize;
        self.mark_free_space(volume, &rig.depth, depth, world_from_depth, carve_period);
        add_border(&rig.depth, depth, &mut self.bordered);
        let kernel = Kernel::new(rig, &self.bordered, &world_from_depth.inverse(), shutter, volume, config);
        let rolls = !shutter.is_still();
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
                    let (kernel, coord) = (&kernel, coords[i]);
                    if rolls {
                        dispatch(isa, BlockUpdate::<true> { kernel, coord, sdf, weight });
                    } else {
                        dispatch(isa, BlockUpdate::<false> { kernel, coord, sdf, weight });
                    }
                    blocks += 1;
                }
                blocks
            })
            .sum();
        Integrated { blocks, refused }
    }

    /// `[slot]`: number of the last frame that updated the block.
    pub fn stamps(&self) -> &[u32] {
        &self.stamp
    }

    /// Must be called after `Volume::coarsen`: the slots hold other blocks.
    pub fn reset_slots(&mut self) {
        self.measured.fill(self.frame);
    }

    /// Allocates the blocks along each ray, within the truncation distance before and behind the measured depth; returns the
    /// number of blocks refused.
    fn allocate(
        &mut self,
        volume: &mut Volume,
        camera: &Pinhole,
        depth: &[f32],
        world_from_depth: &Pose,
        shutter: &RollingShutter,
    ) -> u64 {
        let mu = volume.truncation_m();
        let mut refused = 0;
        for v in (0..camera.height).step_by(ALLOCATION_STEP) {
            let t = Rigid::from(&world_from_depth.compose(&shutter.middle_from_row(camera.row(v as f32))));
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

    /// Returns blocks with nothing but free space and rare readings to the pool: a long scan of one place would fill the pool
    /// with them. Each frame tests one of every `volume.recycle_period` blocks.
    fn recycle(&self, volume: &mut Volume, config: &FusionConfig) {
        let tuning = &config.tuning.volume;
        let worth = (tuning.recycle_below_weight as f32 / WEIGHT_UNIT) as u16;
        let period = tuning.recycle_period as usize;
        for slot in (self.frame as usize % period..volume.high_water()).step_by(period) {
            let unmeasured = self.frame.wrapping_sub(self.measured[slot]);
            if !volume.is_used(slot as u32) || unmeasured < tuning.recycle_after_frames {
                continue;
            }
            let (sdf, weight) = volume.block(slot as u32);
            if !sdf.iter().zip(weight).any(|(s, w)| *w >= worth && f32::from(*s) < NEAR_SURFACE) {
                volume.release(slot as u32);
            }
        }
    }

    /// Marks for update the blocks in free space before the measured surface. Each frame tests one of every `period` blocks.
    fn mark_free_space(
        &mut self,
        volume: &Volume,
        camera: &Pinhole,
        depth: &[f32],
        world_from_depth: &Pose,
        period: usize,
    ) {
        let t = Rigid::from(&world_from_depth.inverse());
        let size = volume.voxel_m() * EDGE as f32;
        for slot in (self.frame as usize % period..volume.high_water()).step_by(period) {
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
