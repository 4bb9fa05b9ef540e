//! What noise of the normals alone adds to the geometric system. A bare wall whose normals scatter seems to hold the camera along
//! the wall, and the steps of quantised depth, which move with the camera, even pull it.

use crate::tracking::geometric::{Association, residual};
use crate::tracking::normal_equations::{CHUNK, System};
use firmware_config::tuning::DepthNoise;
use nalgebra::{Matrix3, Matrix6};
use rayon::prelude::*;
use recordings::types::Pose;

/// The lower quartile of the squared sine between two normals of one surface, over the variance of a component of either across it:
/// of the sum of two squared normal deviates, each of twice the variance. Edges and clutter hardly move the quartile.
const QUARTILE_OF_TWO: f64 = 4.0 * 0.287_682_072;

/// Variance of a normal's components across it, from the squared sines of the angles between the normals of two frames, which are
/// put into another order; 0 without any.
pub fn normal_variance(tilts: &mut [f32]) -> f64 {
    if tilts.is_empty() {
        return 0.0;
    }
    let quarter = tilts.len() / 4;
    f64::from(*tilts.select_nth_unstable_by(quarter, f32::total_cmp).1) / QUARTILE_OF_TWO
}

/// What normals that err by a variance of 1 on both axes across them add to the matrix of [`geometric`](super::geometric::geometric):
/// Σ w J Jᵀ over three axes, less `along`, which has the normals' own part. Metres and radians, camera axes.
pub fn of_tilted_normals(
    associations: &[Association],
    world_from_camera: &Pose,
    cut: f32,
    noise: &DepthNoise,
    along: &System,
) -> Matrix6<f64> {
    let residual = residual(world_from_camera, cut, noise);
    let sums = |associations: &[Association]| {
        associations.iter().fold([0.0; 10], |sums: [f64; 10], a| {
            let w = f64::from(residual(a).weight);
            let [x, y, z] = a.p.as_dvec3().to_array();
            let terms = [1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            std::array::from_fn(|k| sums[k] + w * terms[k])
        })
    };
    let parts: Vec<[f64; 10]> = associations.par_chunks(CHUNK).map(sums).collect();
    let add = |sum: [f64; 10], part: &[f64; 10]| std::array::from_fn(|k| sum[k] + part[k]);
    let [n, x, y, z, xx, xy, xz, yy, yz, zz] = parts.iter().fold([0.0; 10], add);
    // The derivatives along an axis e are (e, p × e).
    let cross = Matrix3::new(0.0, -z, y, z, 0.0, -x, -y, x, 0.0);
    let inertia = Matrix3::new(yy + zz, -xy, -xz, -xy, xx + zz, -yz, -xz, -yz, xx + yy);
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(n);
    all.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross);
    all.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross.transpose());
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(&inertia);
    all - Matrix6::from_fn(|a, c| along.symmetric(a, c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::geometric::geometric;
    use glam::{Vec2, Vec3};

    /// A wall at two metres, of which frame and reference measure normals that scatter by `deviation` on both axes.
    fn wall(deviation: f32) -> (Vec<Association>, Vec<f32>) {
        let mut state = 1u32;
        let mut deviate = || {
            let sum: f32 = (0..12)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 8) as f32 / (1 << 24) as f32
                })
                .sum();
            (sum - 6.0) * deviation
        };
        let point = |i: usize| Vec3::new((i % 100) as f32 * 0.02 - 1.0, (i / 100) as f32 * 0.02 - 1.0, 2.0);
        (0..10_000)
            .map(|i| {
                let (own, of_reference) = (Vec2::new(deviate(), deviate()), Vec2::new(deviate(), deviate()));
                let n = of_reference.extend(-1.0).normalize();
                let p = point(i);
                let tilt = 1.0 - n.dot(own.extend(-1.0).normalize()).powi(2);
                (Association { p, n, d: n.dot(p) }, tilt)
            })
            .unzip()
    }

    #[test]
    fn scattered_normals_of_a_wall_seem_to_hold_it_by_what_is_predicted() {
        let noise = firmware_config::tuning::DepthNoiseTuning::default().model();
        for deviation in [0.02f32, 0.08] {
            let (wall, mut tilts) = wall(deviation);
            let variance = normal_variance(&mut tilts);
            assert!((variance.sqrt() / f64::from(deviation) - 1.0).abs() < 0.05, "{variance} of {deviation}²");
            let along = geometric(&wall, &Pose::IDENTITY, 6.0, &noise, |j, _| j);
            let tilted = of_tilted_normals(&wall, &Pose::IDENTITY, 6.0, &noise, &along) * variance;
            // Along the wall, and the turn about its normal: nothing but noise. Towards it: hardly any.
            for k in [0, 1, 5] {
                let share = tilted[(k, k)] / along.symmetric(k, k);
                assert!((share - 1.0).abs() < 0.15, "unknown {k}: {share}");
            }
            assert!(tilted[(2, 2)] < 0.05 * along.symmetric(2, 2), "{}", tilted[(2, 2)] / along.symmetric(2, 2));
        }
    }

    #[test]
    fn no_associations_tell_nothing() {
        let noise = firmware_config::tuning::DepthNoiseTuning::default().model();
        assert_eq!(normal_variance(&mut []), 0.0);
        assert_eq!(of_tilted_normals(&[], &Pose::IDENTITY, 6.0, &noise, &System::ZERO), Matrix6::zeros());
    }
}
