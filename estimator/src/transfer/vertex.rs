//! Transfer of one vertex: the cosine lobe in closed form, or by rays.

use crate::numerics::random::{CosineDirections, hash, unit};
use crate::numerics::sh;
use crate::rays::RayScene;
use glam::Vec3;
use isa::{Hot, Isa, dispatch};
use recordings::types::Mesh;
use std::ops::Range;

/// Bands of interreflected light: each bounce convolves with a cosine, whose bands above are nearly 0 (Ramamoorthi and
/// Hanrahan 2001). Errors are estimated over the same bands.
const INDIRECT_BANDS: usize = 5;
pub(super) const INDIRECT: usize = INDIRECT_BANDS * INDIRECT_BANDS;
/// Norm of the error over half the difference of the two half sets of rays. Measured against reference transfers.
const HALVES_TO_WHOLE: f64 = 0.68;

/// False for a normal that tells no direction.
pub(super) fn is_unit(normal: Vec3) -> bool {
    (normal.length_squared() - 1.0).abs() < 1e-2
}

/// Closed-form transfer of an unblocked vertex: A_l Y_k(n) / π, to `row`: `[k]`.
pub(super) fn cosine_lobe(normal: Vec3, row: &mut [f32]) {
    sh::eval_f32(normal, row);
    for (k, t) in row.iter_mut().enumerate() {
        *t *= sh::cosine_factor(sh::band(k)) as f32;
    }
}

/// Where the hits of a vertex are kept: those of its first `rays` rays.
pub(super) struct Hits<'a> {
    pub rays: usize,
    pub corners: &'a mut Vec<u32>,
}

/// Adds Y_k of these directions to `sum`: `[k]`.
#[inline(always)]
fn add(directions: &[Vec3], sum: &mut [f32]) {
    for some in directions.chunks(sh::LANES) {
        let (mut lanes, mut weight) = ([[0.0; sh::LANES]; 3], [0.0; sh::LANES]);
        for (i, d) in some.iter().enumerate() {
            (lanes[0][i], lanes[1][i], lanes[2][i], weight[i]) = (d.x, d.y, d.z, 1.0);
        }
        sh::add_lanes(&lanes, &weight, sum);
    }
}

/// Fills the direct transfer `row` of one vertex with the rays of a range, appends its hits, and returns the blocked share
/// and the estimated error.
pub(super) fn trace(
    target: (&Mesh, &RayScene),
    directions: &CosineDirections,
    vertex: usize,
    range: Range<u32>,
    row: &mut [f32],
    hits: &mut Hits,
) -> (f32, f32) {
    dispatch(Isa::detect(), Trace { target, directions, vertex, range, row, hits })
}

/// [`trace`] as a hot loop.
struct Trace<'a, 'h> {
    target: (&'a Mesh, &'a RayScene),
    directions: &'a CosineDirections,
    vertex: usize,
    range: Range<u32>,
    row: &'a mut [f32],
    hits: &'a mut Hits<'h>,
}

impl Hot for Trace<'_, '_> {
    type Output = (f32, f32);

    #[inline(always)]
    fn run(self) -> (f32, f32) {
        let Self { target: (mesh, scene), directions, vertex, range, row, hits } = self;
        let (position, normal) = (mesh.positions[vertex], mesh.normals[vertex]);
        let rays = range.end - range.start;
        if rays == 0 || !position.is_finite() || !is_unit(normal) {
            return (0.0, 0.0);
        }
        let origin = scene.offset_origin(position, normal);
        // Rays that escape and rays that hit, of either half of the point set: the difference of the halves estimates the error of the whole.
        let mut sides: [[Vec<Vec3>; 2]; 2] = Default::default();
        directions.about(vertex as u32, normal, range.start as usize..range.end as usize, |index, d| {
            let half = usize::from(2 * (index - range.start as usize) >= rays as usize);
            // What blocks a ray is asked only where its hit is kept.
            let keeps = index < hits.rays;
            let hit = if keeps { scene.closest_hit(origin, d) } else { None };
            let blocked = hit.is_some() || (!keeps && scene.occluded(origin, d));
            sides[usize::from(blocked)][half].push(d);
            if let Some(hit) = hit {
                let t = mesh.triangles[hit.triangle as usize];
                let [a, b, c] = t.map(|i| mesh.normals[i as usize]);
                let facing = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
                // A back face blocks, but its front's light is not seen there.
                if facing.dot(d) < 0.0 {
                    let draw = unit(hash(vertex as u32, index as u32 ^ 0x0c04_e500));
                    hits.corners.push(if draw < hit.u {
                        t[1]
                    } else if draw < hit.u + hit.v {
                        t[2]
                    } else {
                        t[0]
                    });
                }
            }
        });
        // Eq. (8): t = 1/N Σ over escaping rays. Where most rays escape, the closed form minus the hits estimates the same
        // integral with less variance.
        let [escaping, blocked] = &sides;
        let count = |side: &[Vec<Vec3>; 2]| side[0].len() + side[1].len();
        let subtract = count(blocked) <= count(escaping);
        let k = row.len();
        let mut sums = [[0.0f32; sh::MAX_COEFFICIENTS]; 2];
        let halves = if subtract { blocked } else { escaping };
        halves.iter().zip(&mut sums).for_each(|(half, sum)| add(half, &mut sum[..k]));
        let scale = 1.0 / rays as f32;
        if subtract {
            cosine_lobe(normal, row);
        }
        let mut difference = 0.0f64;
        for i in 0..k {
            let [a, b] = [sums[0][i], sums[1][i]];
            row[i] = if subtract { row[i] - (a + b) * scale } else { (a + b) * scale };
            if i < INDIRECT {
                difference += f64::from((a - b) * scale).powi(2);
            }
        }
        (count(blocked) as f32 * scale, (HALVES_TO_WHOLE * libm::sqrt(difference)) as f32)
    }
}
