//! The TSDF update of one voxel block: project, look up, average.

use crate::camera::pinhole::{Pinhole, Rigid};
use crate::camera::rig::{MAX_DEPTH_PIXELS, Rig};
use crate::camera::rolling_shutter::RollingShutter;
use crate::tsdf::volume::{BlockCoord, EDGE, SDF_ONE, Volume, WEIGHT_UNIT};
use firmware_config::FusionConfig;
use firmware_config::tuning::DepthNoise;
use glam::{Mat3, Vec3};
use isa::Hot;
use recordings::types::Pose;

/// Voxels in a slice of a block.
const SLICE: usize = EDGE * EDGE;
/// The largest stored weight.
const MAX_STORED_WEIGHT: f32 = 65535.0;

/// Adding this to a small f32 leaves its nearest integer in the low bits.
const MAGIC: f32 = 12_582_912.0;
const MAGIC_BITS: i32 = 0x4B40_0000;
/// The same for integers from 0 to [`MAX_DEPTH_PIXELS`].
const INDEX_MAGIC: f32 = MAX_DEPTH_PIXELS as f32;
const INDEX_MAGIC_BITS: u32 = 0x4B00_0000;

/// What the update of a block needs and all blocks of a frame share.
pub struct Kernel<'a> {
    /// Depth with a border of one pixel without depth, row-major; negative on rims.
    depth: &'a [f32],
    /// Length of a row, pixels.
    row: f32,
    /// Largest pixel coordinates: those of the border.
    last: (f32, f32),
    /// Homogeneous pixel coordinates (u·z, v·z, z; origin at the corner of the border) of the world's origin, of one voxel
    /// step along each axis, and of the voxels of a slice, `[axis][voxel]`.
    origin: Vec3,
    step: [Vec3; 3],
    slice: [[f32; SLICE]; 3],
    /// The same for the motion of these coordinates from the first row to the last row.
    shift_origin: Vec3,
    shift_step: [Vec3; 3],
    shift_slice: [[f32; SLICE]; 3],
    /// 1 / truncation distance.
    per_mu: f32,
    /// Standard deviations behind the surface from which weights fall, per truncation distance, and their slope.
    fade_per_mu: f32,
    fade_slope: f32,
    /// How far behind the surface a reading on a rim counts, in truncation distances.
    rim_behind: f32,
    noise: DepthNoise,
    /// Upper bound of the old weight in the mean, in units of the stored weight.
    max_weight: f32,
}

/// The update of one block; `ROLLS` if the rolling shutter is compensated.
pub struct BlockUpdate<'a, const ROLLS: bool> {
    pub kernel: &'a Kernel<'a>,
    pub coord: BlockCoord,
    /// `[voxel]`, index z·64 + y·8 + x.
    pub sdf: &'a mut [i16],
    /// `[voxel]`.
    pub weight: &'a mut [u16],
}

impl<const ROLLS: bool> Hot for BlockUpdate<'_, ROLLS> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.kernel.block::<ROLLS>(self.coord, self.sdf, self.weight);
    }
}

#[inline(always)]
fn round_to_int(x: f32) -> i32 {
    (x + MAGIC).to_bits() as i32 - MAGIC_BITS
}

/// Copies a depth image and adds a border of one pixel without depth. A pixel beside one without depth is negative: it is on
/// the rim of what was seen.
pub fn add_border(camera: &Pinhole, depth: &[f32], bordered: &mut Vec<f32>) {
    let (width, height) = (camera.width, camera.height);
    let row = width + 2;
    bordered.resize(row * (height + 2), 0.0);
    for (y, to) in bordered.chunks_exact_mut(row).skip(1).take(height).enumerate() {
        let from = |y: usize| &depth[y * width..(y + 1) * width];
        let (up, here, down) = (from(y.saturating_sub(1)), from(y), from((y + 1).min(height - 1)));
        to[1..=width].copy_from_slice(here);
        if width < 3 {
            continue;
        }
        let n = width - 2;
        let (l, c, r) = (&here[..n], &here[1..=n], &here[2..]);
        let (u, d, to) = (&up[1..=n], &down[1..=n], &mut to[2..2 + n]);
        for i in 0..n {
            let least = l[i].min(r[i]).min(u[i].min(d[i]));
            to[i] = if least > 0.0 { c[i] } else { -c[i] };
        }
    }
}

impl<'a> Kernel<'a> {
    /// For a depth image with border, seen from `depth_from_world` at its middle row.
    pub fn new(
        rig: &Rig,
        depth: &'a [f32],
        depth_from_world: &Pose,
        shutter: &RollingShutter,
        volume: &Volume,
        config: &FusionConfig,
    ) -> Self {
        let camera = &rig.depth;
        let t = Rigid::from(depth_from_world);
        let m = volume.voxel_m();
        let to_pixel = Mat3::from_cols(
            Vec3::new(camera.fx, 0.0, 0.0),
            Vec3::new(0.0, camera.fy, 0.0),
            Vec3::new(camera.cx + 1.0, camera.cy + 1.0, 1.0),
        );
        let step = [t.r.x_axis, t.r.y_axis, t.r.z_axis].map(|axis| to_pixel * (axis * m));
        let shift_step = [t.r.x_axis, t.r.y_axis, t.r.z_axis].map(|axis| to_pixel * shutter.rotation.cross(axis * m));
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
            shift_origin: to_pixel * shutter.shift(t.t),
            shift_step,
            shift_slice: slice(&shift_step),
            per_mu: 1.0 / volume.truncation_m(),
            fade_per_mu: config.tuning.volume.fade_sigmas as f32 / volume.truncation_m(),
            fade_slope: config.tuning.volume.fade_slope as f32,
            rim_behind: config.tuning.volume.rim_behind as f32,
            noise: rig.noise,
            max_weight: config.max_weight as f32 / WEIGHT_UNIT,
        }
    }

    /// Updates one block, slice by slice (8 × 8 voxels): project, look up, average. The first and the last loop have no branch,
    /// so that the compiler vectorises them, and as few divisions as possible, which dominate the cost.
    #[inline(always)]
    fn block<const ROLLS: bool>(&self, coord: BlockCoord, sdf: &mut [i16], weight: &mut [u16]) {
        let base = (coord * EDGE as i32).as_vec3();
        let corner = self.origin + self.step[0] * base.x + self.step[1] * base.y + self.step[2] * base.z;
        let shift_corner =
            self.shift_origin + self.shift_step[0] * base.x + self.shift_step[1] * base.y + self.shift_step[2] * base.z;
        // Row v of the bordered image is read at the instant a v + b.
        let a = 1.0 / (self.last.1 - 1.0);
        let b = -0.5 * a - 0.5;
        // One reading from 1 m has the weight 1; a farther one σ(1 m) / σ(d).
        let one_sigma = self.noise.at_1m / WEIGHT_UNIT;
        let mut pixel = [0u32; SLICE];
        let mut voxel_z = [0.0f32; SLICE];
        let mut measured = [0.0f32; SLICE];
        for (k, (sdf, weight)) in sdf.chunks_exact_mut(SLICE).zip(weight.chunks_exact_mut(SLICE)).enumerate() {
            let first = corner + self.step[2] * k as f32;
            let shift = shift_corner + self.shift_step[2] * k as f32;
            // Approximate instant of the slice.
            let about = a * (first.y + self.slice[1][SLICE / 2]) / (first.z + self.slice[2][SLICE / 2]) + b;
            for i in 0..SLICE {
                let (mut x, mut y) = (first.x + self.slice[0][i], first.y + self.slice[1][i]);
                let mut z = first.z + self.slice[2][i];
                if ROLLS {
                    // As in `RollingShutter::project`.
                    let dx = shift.x + self.shift_slice[0][i];
                    let dy = shift.y + self.shift_slice[1][i];
                    let dz = shift.z + self.shift_slice[2][i];
                    let s = a * ((y - b * dy) / (z - about * dz + a * dy)) + b;
                    (x, y, z) = (x - s * dx, y - s * dy, z - s * dz);
                }
                // Voxels behind the camera and outside the image fall on the border.
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
                let d = measured[i].abs();
                let s = (d - voxel_z[i]) * self.per_mu;
                let sigma = self.noise.sigma_m(d);
                let behind = if measured[i] > 0.0 { 1.0 } else { self.rim_behind };
                let seen = (d > 0.0) & (s > -behind);
                let s = if s < 1.0 { s } else { 1.0 };
                // Deeper behind the surface than the noise reaches, a reading weighs less than free space seen from
                // elsewhere: thin objects stay thin. Closer to the surface this would move the surface backwards.
                let fade = 1.0 + self.fade_slope * (s + sigma * self.fade_per_mu);
                let fresh = one_sigma * if fade < 1.0 { fade } else { 1.0 };
                let fresh = if fresh > sigma { fresh } else { sigma };
                // The stored weight counts all readings; in the mean it is bounded by `max_weight`.
                let all = f32::from(weight[i]);
                let old = (if all < self.max_weight { all } else { self.max_weight }) * sigma;
                // With w_k = fresh / sigma, mean = (sdf · w + s · w_k) / (w + w_k), in one division.
                let both = old + fresh;
                let r = 1.0 / (sigma * both);
                let mean = (f32::from(sdf[i]) * old + s * (SDF_ONE * fresh)) * (sigma * r);
                let sum = all + fresh * (both * r);
                let sum = if sum < MAX_STORED_WEIGHT { sum } else { MAX_STORED_WEIGHT };
                sdf[i] = if seen { round_to_int(mean) as i16 } else { sdf[i] };
                weight[i] = if seen { round_to_int(sum) as u16 } else { weight[i] };
            }
        }
    }
}
