//! The model of a scan: the volume, its integration and its resolution.

use crate::camera::rig::Rig;
use crate::frame::preprocess::Frame;
use crate::tsdf::integrate::Integrator;
use crate::tsdf::surfels::{BlockSurface, SurfaceReader};
use crate::tsdf::volume::Volume;
use firmware_config::FusionConfig;
use recordings::types::Pose;

/// The TSDF volume with the state of its integration.
pub struct Model {
    pub volume: Volume,
    integrator: Integrator,
    /// Blocks updated by the last frame.
    pub updated_blocks: usize,
    /// Blocks that could not be allocated so far.
    pub refused_blocks: u64,
    /// Times that the voxel size was doubled because the pool was full.
    pub coarsenings: u32,
}

impl Model {
    /// An empty volume; allocates everything whose size is fixed.
    pub fn new(config: &FusionConfig) -> Self {
        Self {
            volume: Volume::new(config),
            integrator: Integrator::new(config),
            updated_blocks: 0,
            refused_blocks: 0,
            coarsenings: 0,
        }
    }

    /// Integrates a frame seen from `pose` and adapts the voxel size; true if the pool was full and the voxel size is now
    /// doubled.
    pub fn fuse(&mut self, frame: &Frame, pose: &Pose, rig: &Rig, config: &FusionConfig) -> bool {
        self.integrate(frame, pose, rig, config);
        if self.leave_fine_voxels(frame.median_depth, rig, config) {
            // Once more: the truncation distance has doubled.
            self.integrate(frame, pose, rig, config);
        }
        self.coarsen_full_pool(config)
    }

    /// Surface that changed, see [`SurfaceReader`].
    pub fn read_surface(&self, reader: &mut SurfaceReader, limit: usize, out: &mut Vec<BlockSurface>) {
        reader.read(&self.volume, self.integrator.stamps(), limit, out);
    }

    /// The volume alone; frees the state of integration.
    pub fn into_volume(self) -> Volume {
        self.volume
    }

    fn integrate(&mut self, frame: &Frame, pose: &Pose, rig: &Rig, config: &FusionConfig) {
        let world_from_depth = pose.compose(&frame.motion.color_from_row(0.0)).compose(&rig.color_from_depth);
        let shutter = frame.motion.of_depth(rig);
        let integrated = tracing::debug_span!("integrate").in_scope(|| {
            self.integrator.integrate(&mut self.volume, rig, &frame.depth, &world_from_depth, &shutter, config)
        });
        self.refused_blocks += integrated.refused;
        self.updated_blocks = integrated.blocks;
        tracing::trace!(blocks = integrated.blocks, "integrated");
    }

    /// Coarsens fine voxels once they exceed the block budget or out-resolve the depth noise or the depth pixels.
    fn leave_fine_voxels(&mut self, median_depth_m: f32, rig: &Rig, config: &FusionConfig) -> bool {
        let tuning = &config.tuning.volume;
        let voxel_m = self.volume.voxel_m();
        // Fine voxels have half the length of the setting; 0.75 allows for rounding.
        let fine = f64::from(voxel_m) < 0.75 * config.voxel_size_m;
        let noisy = tuning.fine_sigmas as f32 * rig.noise.sigma_m(median_depth_m) > self.volume.truncation_m();
        let sparse = median_depth_m > tuning.fine_pixel_voxels as f32 * voxel_m * rig.depth.fx;
        let costly = self.updated_blocks > config.fine_blocks as usize;
        if !fine || !(noisy || sparse || costly || self.is_nearly_full(config)) {
            return false;
        }
        self.coarsen();
        tracing::info!(voxel_m = self.volume.voxel_m(), noisy, sparse, costly, "voxels are no longer fine");
        true
    }

    /// Coarsens the volume when the pool is nearly full and a larger voxel is allowed.
    fn coarsen_full_pool(&mut self, config: &FusionConfig) -> bool {
        let doubled_m = f64::from(self.volume.voxel_m()) * 2.0;
        if !self.is_nearly_full(config) || doubled_m > config.max_voxel_size_m * 1.001 {
            return false;
        }
        self.coarsen();
        self.coarsenings += 1;
        true
    }

    fn is_nearly_full(&self, config: &FusionConfig) -> bool {
        self.volume.used() as f64 >= config.coarsen_at * self.volume.capacity() as f64
    }

    fn coarsen(&mut self) {
        self.volume.coarsen();
        self.integrator.reset_slots();
    }
}
