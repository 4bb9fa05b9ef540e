//! Trilinear sampling of the signed distance.

use crate::tsdf::volume::{BlockCoord, EMPTY, SDF_ONE, VOXELS, Volume, index, key_of};
use glam::{IVec3, Vec3};

/// The block of the last look-up: neighbouring queries mostly fall into the same block.
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

/// Signed distance and its gradient at a point.
#[derive(Debug, Clone, Copy)]
pub struct TsdfSample {
    /// Signed distance as stored (projective, not exactly Euclidean), metres.
    pub distance: f32,
    /// Gradient of the distance, metres per metre: its length is 1 where the distance is Euclidean.
    pub gradient: Vec3,
}

impl Volume {
    /// Stored distance and weight of a voxel; weight 0 where there is no block.
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

    /// Trilinear signed distance with its gradient at a world point; `None` next to a voxel never observed.
    #[inline]
    pub fn sample(&self, p: Vec3, cursor: &mut Cursor) -> Option<TsdfSample> {
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
        Some(TsdfSample { distance: (y0 + f.z * dz) * unit, gradient: Vec3::new(dx, dy, dz) * (unit / self.voxel_m) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tsdf::volume::WEIGHT_UNIT;
    use firmware_config::FusionConfig;

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
}
