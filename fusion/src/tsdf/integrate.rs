//! TSDF integration: blocks near the measured surface are taken from the pool, and every block that the frame tells
//! something about is averaged with it (Curless, Levoy 1996).

use crate::camera::rig::{Pinhole, Rig, Rigid};
use crate::camera::rolling_shutter::Sweep;
use crate::isa::{Hot, Isa, dispatch};
use crate::tsdf::volume::{BlockCoord, EDGE, Refusal, SDF_ONE, VOXELS, Volume, WEIGHT_UNIT};
use firmware_config::FusionConfig;
use glam::{Mat3, Vec3};
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

/// Most pixels of a depth image with its border, so that their numbers are exact in an f32 that is added to 2²³.
pub const MOST_PIXELS: usize = 1 << 23;

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
    bordered: Vec<f32>,
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
            bordered: Vec::new(),
        }
    }

    /// Averages a depth image (metres, row-major, 0 = none) into the volume: its middle row is seen from
    /// `world_from_depth`, the others on the way of `sweep`.
    pub fn integrate(
        &mut self,
        volume: &mut Volume,
        rig: &Rig,
        depth: &[f32],
        world_from_depth: &Pose,
        sweep: &Sweep,
    ) -> Integrated {
        self.frame = self.frame.wrapping_add(1);
        self.recycle(volume);
        let refused = self.allocate(volume, &rig.depth, depth, world_from_depth, sweep);
        self.mark_free_space(volume, &rig.depth, depth, world_from_depth);
        add_border(&rig.depth, depth, &mut self.bordered);
        let kernel =
            Kernel::new(&rig.depth, &self.bordered, &world_from_depth.inverse(), sweep, volume, self.max_weight);
        let rolls = !sweep.is_still();
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

    /// To be told when the volume has been coarsened: the slots hold other blocks now.
    pub fn coarsened(&mut self) {
        self.measured.fill(self.frame);
    }

    /// Takes blocks along each ray from truncation before to truncation behind the measured depth.
    fn allocate(
        &mut self,
        volume: &mut Volume,
        camera: &Pinhole,
        depth: &[f32],
        world_from_depth: &Pose,
        sweep: &Sweep,
    ) -> u64 {
        let mu = volume.truncation_m();
        let mut refused = 0;
        for v in (0..camera.height).step_by(ALLOCATION_STEP) {
            let t = Rigid::from(&world_from_depth.compose(&sweep.middle_from_row(camera.row(v as f32))));
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
struct Kernel<'a> {
    /// Depth with a border of one pixel without depth, row-major.
    depth: &'a [f32],
    row: f32,
    /// Largest pixel coordinates, those of the border.
    last: (f32, f32),
    /// Homogeneous pixel coordinates (u·z, v·z, z; the border's corner is the origin) of the world's origin, of one voxel
    /// step along each axis, and of the voxels of a slice.
    origin: Vec3,
    step: [Vec3; 3],
    slice: [[f32; SLICE]; 3],
    /// The same of what moves these coordinates from the first row to the last.
    shift_origin: Vec3,
    shift_step: [Vec3; 3],
    shift_slice: [[f32; SLICE]; 3],
    per_mu: f32,
    noise_per_mu: f32,
    max_weight: f32,
}

/// The update of one block.
struct BlockUpdate<'a, const ROLLS: bool> {
    kernel: &'a Kernel<'a>,
    coord: BlockCoord,
    sdf: &'a mut [i16],
    weight: &'a mut [u16],
}

impl<const ROLLS: bool> Hot for BlockUpdate<'_, ROLLS> {
    #[inline(always)]
    fn run(self) {
        self.kernel.block::<ROLLS>(self.coord, self.sdf, self.weight);
    }
}

/// Voxels in a slice of a block.
const SLICE: usize = EDGE * EDGE;
/// Standard deviations of depth behind the surface from where on readings weigh less, …
const FADE_FROM: f32 = 3.0;
/// … and by how much, for each truncation distance.
const FADE: f32 = 1.25;
/// The largest weight stored.
const MOST_WEIGHT: f32 = 65535.0;

/// Adding this to a small f32 leaves its nearest integer in the low bits.
const MAGIC: f32 = 12_582_912.0;
const MAGIC_BITS: i32 = 0x4B40_0000;
/// The same for integers from 0 to [`MOST_PIXELS`].
const INDEX_MAGIC: f32 = 8_388_608.0;
const INDEX_MAGIC_BITS: u32 = 0x4B00_0000;

#[inline(always)]
fn round_to_int(x: f32) -> i32 {
    (x + MAGIC).to_bits() as i32 - MAGIC_BITS
}

/// Copies a depth image, with a border of one pixel without depth around it.
fn add_border(camera: &Pinhole, depth: &[f32], bordered: &mut Vec<f32>) {
    let row = camera.width + 2;
    bordered.resize(row * (camera.height + 2), 0.0);
    for (to, from) in bordered.chunks_exact_mut(row).skip(1).zip(depth.chunks_exact(camera.width)) {
        to[1..=camera.width].copy_from_slice(from);
    }
}

impl<'a> Kernel<'a> {
    fn new(
        camera: &Pinhole,
        depth: &'a [f32],
        depth_from_world: &Pose,
        sweep: &Sweep,
        volume: &Volume,
        max_weight: f32,
    ) -> Self {
        let t = Rigid::from(depth_from_world);
        let m = volume.voxel_m();
        let to_pixel = Mat3::from_cols(
            Vec3::new(camera.fx, 0.0, 0.0),
            Vec3::new(0.0, camera.fy, 0.0),
            Vec3::new(camera.cx + 1.0, camera.cy + 1.0, 1.0),
        );
        let step = [t.r.x_axis, t.r.y_axis, t.r.z_axis].map(|axis| to_pixel * (axis * m));
        let shift_step = [t.r.x_axis, t.r.y_axis, t.r.z_axis].map(|axis| to_pixel * sweep.turn.cross(axis * m));
        let slice = |step: &[Vec3; 3]| {
            let within = |i: usize| step[0] * (i % EDGE) as f32 + step[1] * (i / EDGE) as f32;
            std::array::from_fn(|axis| std::array::from_fn(|i| within(i)[axis]))
        };
        Self {
            depth,
            row: (camera.width + 2) as f32,
            last: ((camera.width + 1) as f32, (camera.height + 1) as f32),
            origin: to_pixel * t.t,
            step,
            slice: slice(&step),
            shift_origin: to_pixel * sweep.shift(t.t),
            shift_step,
            shift_slice: slice(&shift_step),
            per_mu: 1.0 / volume.truncation_m(),
            noise_per_mu: FADE_FROM / volume.truncation_m(),
            max_weight,
        }
    }

    /// Updates one block, slice by slice (8 × 8 voxels): project, look up, average. The first and last step hold no
    /// branch, so that the compiler vectorises them, and as few divisions as there can be: they are what costs.
    #[inline(always)]
    fn block<const ROLLS: bool>(&self, coord: BlockCoord, sdf: &mut [i16], weight: &mut [u16]) {
        let base = (coord * EDGE as i32).as_vec3();
        let corner = self.origin + self.step[0] * base.x + self.step[1] * base.y + self.step[2] * base.z;
        let shift_corner =
            self.shift_origin + self.shift_step[0] * base.x + self.shift_step[1] * base.y + self.shift_step[2] * base.z;
        // A row v of the bordered image is seen at the instant a v + b.
        let a = 1.0 / (self.last.1 - 1.0);
        let b = -0.5 * a - 0.5;
        let mut pixel = [0u32; SLICE];
        let mut voxel_z = [0.0f32; SLICE];
        let mut measured = [0.0f32; SLICE];
        for (k, (sdf, weight)) in sdf.chunks_exact_mut(SLICE).zip(weight.chunks_exact_mut(SLICE)).enumerate() {
            let first = corner + self.step[2] * k as f32;
            let shift = shift_corner + self.shift_step[2] * k as f32;
            // When about the slice is seen.
            let about = a * (first.y + self.slice[1][SLICE / 2]) / (first.z + self.slice[2][SLICE / 2]) + b;
            for i in 0..SLICE {
                let (mut x, mut y) = (first.x + self.slice[0][i], first.y + self.slice[1][i]);
                let mut z = first.z + self.slice[2][i];
                if ROLLS {
                    // As in `Sweep::project`.
                    let dx = shift.x + self.shift_slice[0][i];
                    let dy = shift.y + self.shift_slice[1][i];
                    let dz = shift.z + self.shift_slice[2][i];
                    let s = a * ((y - b * dy) / (z - about * dz + a * dy)) + b;
                    (x, y, z) = (x - s * dx, y - s * dy, z - s * dz);
                }
                // What is behind the camera falls on the border, as does what is beside the image.
                let w = if z > 0.05 { 1.0 / z } else { f32::NAN };
                let (u, v) = (x * w, y * w);
                let u = if u > 0.0 { u } else { 0.0 };
                let v = if v > 0.0 { v } else { 0.0 };
                let u = if u < self.last.0 { u } else { self.last.0 };
                let v = if v < self.last.1 { v } else { self.last.1 };
                let at = ((v + INDEX_MAGIC) - INDEX_MAGIC) * self.row + u;
                pixel[i] = (at + INDEX_MAGIC).to_bits().wrapping_sub(INDEX_MAGIC_BITS);
                voxel_z[i] = z;
            }
            for i in 0..SLICE {
                measured[i] = self.depth.get(pixel[i] as usize).copied().unwrap_or(0.0);
            }
            for i in 0..SLICE {
                let d = measured[i];
                let s = (d - voxel_z[i]) * self.per_mu;
                let seen = (d > 0.0) & (s > -1.0);
                let s = if s < 1.0 { s } else { 1.0 };
                // One frame from 1 m weighs ONE; further away less (ONE · σ(1 m) / σ(d)), as the noise grows, but at least 1.
                const ONE_SIGMA: f32 = 0.001884 / WEIGHT_UNIT;
                let far = d - 0.4;
                let sigma = 0.0012 + 0.0019 * far * far;
                // Deeper behind the surface than noise reaches, what is told gives way to free space that others see
                // there: thin things stay thin. Any nearer, the surface would move backwards.
                let told = 1.0 + FADE * (s + sigma * self.noise_per_mu);
                let fresh = ONE_SIGMA * if told < 1.0 { told } else { 1.0 };
                let fresh = if fresh > sigma { fresh } else { sigma };
                // The weight tells how much was seen; what is new counts at least its share of `max_weight`.
                let all = f32::from(weight[i]);
                let old = (if all < self.max_weight { all } else { self.max_weight }) * sigma;
                // new = fresh / sigma and mean = (sdf · old + s · new) / (old + new), with one division.
                let both = old + fresh;
                let r = 1.0 / (sigma * both);
                let mean = (f32::from(sdf[i]) * old + s * (SDF_ONE * fresh)) * (sigma * r);
                let sum = all + fresh * (both * r);
                let sum = if sum < MOST_WEIGHT { sum } else { MOST_WEIGHT };
                sdf[i] = if seen { round_to_int(mean) as i16 } else { sdf[i] };
                weight[i] = if seen { round_to_int(sum) as u16 } else { weight[i] };
            }
        }
    }
}
