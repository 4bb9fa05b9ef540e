//! Results as people see them: +Z is up.
//!
//! A result keeps the world of its scan, whose +Z is up in the first picture where no accelerometer told more. Pictures, pages and
//! exports to other programs show it turned to where things stand upright ([`recordings::upright`]).

use crate::numerics::sh_rotation::rotated;
use glam::{DQuat, DVec3, Quat, Vec3};
use recordings::result::{Chart, Estimate};
use recordings::scan::Scan;
use recordings::types::Pose;
use recordings::upright::turn_to_upright;

/// The result in a world whose +Z is up.
#[must_use]
pub fn upright(mut result: Estimate) -> Estimate {
    let Some(turn) = turn_of(result.up) else { return result };
    let turned = turn.as_quat();
    for v in result.mesh.positions.iter_mut().chain(&mut result.mesh.normals) {
        *v = turned * *v;
    }
    let light = &mut result.light;
    light.coefficients = rotated(&light.coefficients, turn);
    // Variances of the turned coefficients, whose covariances are not stored, lie between those of a band.
    light.standard_deviation = by_band(&light.standard_deviation);
    turn_all(&mut light.directions, turned);
    for keyframe in &mut result.keyframes {
        keyframe.world_from_camera = turned_pose(&keyframe.world_from_camera, turn);
    }
    for lamp in &mut result.local_light.lamps {
        lamp.center = (turned * Vec3::from(lamp.center)).to_array();
    }
    for Chart { x_axis, y_axis, .. } in result.texture.iter_mut().flat_map(|t| &mut t.charts) {
        *x_axis = (turned * Vec3::from(*x_axis)).to_array();
        *y_axis = (turned * Vec3::from(*y_axis)).to_array();
    }
    result.up = DVec3::Z;
    result
}

/// The scan of a result in the same world; `up` is that of the result as it was stored.
#[must_use]
pub fn upright_scan(mut scan: Scan, up: DVec3) -> Scan {
    let Some(turn) = turn_of(up) else { return scan };
    let turned = turn.as_quat();
    for v in scan.mesh.positions.iter_mut().chain(&mut scan.mesh.normals) {
        *v = turned * *v;
    }
    for frame in scan.keyframes.iter_mut().chain(&mut scan.witnesses) {
        frame.world_from_camera = turned_pose(&frame.world_from_camera, turn);
    }
    scan.up = None;
    scan
}

fn turn_of(up: DVec3) -> Option<DQuat> {
    (up != DVec3::Z).then(|| turn_to_upright(up))
}

fn turned_pose(pose: &Pose, turn: DQuat) -> Pose {
    Pose::new(turn * pose.rotation, turn * pose.translation)
}

fn turn_all(directions: &mut [[f32; 3]], turn: Quat) {
    directions.iter_mut().for_each(|d| *d = (turn * Vec3::from(*d)).to_array());
}

/// Every coefficient's deviation replaced by the root mean square of its band's, which no rotation changes.
fn by_band(deviation: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let bands = deviation.len().isqrt();
    (0..bands)
        .flat_map(|l| {
            let band = &deviation[l * l..(l + 1) * (l + 1)];
            let mean = |c: usize| libm::sqrt(band.iter().map(|d| d[c] * d[c]).sum::<f64>() / band.len() as f64);
            vec![[mean(0), mean(1), mean(2)]; band.len()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::textured;
    use crate::numerics::sh;

    #[test]
    fn what_is_seen_stays_the_same_in_the_turned_world() {
        let mut leaning = textured();
        leaning.up = DVec3::new(0.1, -0.6, 0.7).normalize();
        leaning.light.coefficients = (0..16).map(|k| [1.0 / f64::from(1 + k), 0.1 * f64::from(k), 0.3]).collect();
        leaning.light.standard_deviation = (0..16).map(|k| [0.1 * f64::from(k); 3]).collect();
        let turn = turn_to_upright(leaning.up);
        let standing = upright(leaning.clone());
        assert_eq!(standing.up, DVec3::Z);
        // The light from where up was comes from +Z.
        let (from, to) = (leaning.up, DVec3::Z);
        let seen = |e: &Estimate, d: DVec3| sh::radiance(&e.light.coefficients, d);
        for c in 0..3 {
            assert!((seen(&leaning, from)[c] - seen(&standing, to)[c]).abs() < 1e-9);
        }
        // Surface, its camera pixel and its texel stay together.
        let (before, after) = (leaning.texture.as_ref().unwrap(), standing.texture.as_ref().unwrap());
        for (p, q) in leaning.mesh.positions.iter().zip(&standing.mesh.positions) {
            assert!((turn.as_quat() * *p - *q).length() < 1e-6);
            let camera = |e: &Estimate, p: Vec3| e.keyframes[1].world_from_camera.inverse().transform(p.as_dvec3());
            assert!((camera(&leaning, *p) - camera(&standing, *q)).length() < 1e-6);
            assert!((before.charts[0].texel(*p) - after.charts[0].texel(*q)).length() < 1e-4);
        }
        let total = |e: &Estimate| e.light.standard_deviation.iter().map(|d| d[0] * d[0]).sum::<f64>();
        assert!((total(&leaning) - total(&standing)).abs() < 1e-9);
        // A result that stands is left alone, to the bit.
        assert_eq!(upright(standing.clone()), standing);
    }
}
