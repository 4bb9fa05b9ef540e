//! Where up is, in a scan whose sensor has no accelerometer: the normal of the largest plane whose front is within a cone about
//! image-up of the first picture, a desk or a floor. Where several planes are nearly as large, what stands at right angles to
//! one of them (walls, sides of boxes) decides.

use firmware_config::tuning::UprightTuning;
use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;
use recordings::types::Mesh;
use recordings::upright::{HorizontalPlane, ToldUp};
use std::f64::consts::PI;

/// Triangles that are looked at, evenly taken from all.
const MAX_TRIANGLES: usize = 20_000;
/// Directions over the sphere that are tried: 3.2° apart.
const DIRECTIONS: usize = 4000;
/// A plane that is tried in a direction is this many times as thick: the direction is not exact yet.
const COARSE: f64 = 3.0;
/// Planes that are compared, and the share of the largest that the others have at least.
const CANDIDATES: usize = 4;
const RIVAL_SHARE: f64 = 0.5;
/// Rounds of fitting a plane.
const ROUNDS: usize = 6;

/// A triangle: its middle, unit normal and area.
type Facet = (DVec3, DVec3, f64);

/// The upward direction of a mesh in the world of its first camera, whose image-up is +Z.
#[must_use]
pub fn tell_up(mesh: &Mesh, tuning: &UprightTuning) -> ToldUp {
    let facets = facets(mesh);
    let total: f64 = facets.iter().map(|f| f.2).sum();
    let found = candidates(&facets, tuning).into_iter().filter_map(|direction| {
        let (normal, area) = fitted(&facets, direction, tuning)?;
        let plane =
            HorizontalPlane { share: area / total, vertical_share: vertical_area(&facets, normal, tuning) / total };
        (plane.share >= tuning.min_share && normal.angle_between(DVec3::Z) <= tuning.max_tilt_rad)
            .then_some((normal, plane))
    });
    // Desk and wall stand at right angles to each other: of such a pair the larger is horizontal.
    let support = |p: &HorizontalPlane| p.share + 0.5 * p.vertical_share;
    match found.max_by(|a, b| support(&a.1).total_cmp(&support(&b.1))) {
        Some((normal, plane)) => ToldUp { direction: normal.to_array(), plane: Some(plane) },
        None => ToldUp { direction: DVec3::Z.to_array(), plane: None },
    }
}

fn facets(mesh: &Mesh) -> Vec<Facet> {
    let stride = mesh.triangles.len().div_ceil(MAX_TRIANGLES).max(1);
    let facet = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        let area = normal.length() / 2.0;
        (area > 0.0).then(|| ((a + b + c) / 3.0, normal / (2.0 * area), area))
    };
    mesh.triangles.iter().step_by(stride).filter_map(facet).collect()
}

/// Normals of the largest planes, the largest first; no two are nearly parallel.
fn candidates(facets: &[Facet], tuning: &UprightTuning) -> Vec<DVec3> {
    let cone = cone(tuning.max_tilt_rad);
    let areas: Vec<f64> = cone.par_iter().map(|d| fullest_slab(facets, *d, tuning).0).collect();
    let mut order: Vec<usize> = (0..cone.len()).collect();
    order.sort_by(|a, b| areas[*b].total_cmp(&areas[*a]));
    let mut chosen: Vec<usize> = Vec::new();
    for i in order {
        let first = chosen.first().map_or(areas[i], |c| areas[*c]);
        if chosen.len() == CANDIDATES || areas[i] <= RIVAL_SHARE * first {
            break;
        }
        if chosen.iter().all(|c| cone[*c].angle_between(cone[i]) > 2.0 * tuning.normal_rad) {
            chosen.push(i);
        }
    }
    chosen.into_iter().map(|i| cone[i]).collect()
}

/// Directions within an angle of +Z, evenly spread (Fibonacci spiral).
fn cone(angle: f64) -> Vec<DVec3> {
    let turn = PI * (1.0 + libm::sqrt(5.0));
    let direction = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (sin, cos) = libm::sincos(turn * (i as f64 + 0.5));
        DVec3::new(cos, sin, 0.0) * libm::sqrt(1.0 - z * z) + DVec3::Z * z
    };
    (0..DIRECTIONS).map(direction).take_while(|d| d.z >= libm::cos(angle)).collect()
}

/// The fullest slab at right angles to `direction`: the area of the surface in it, and its middle height.
fn fullest_slab(facets: &[Facet], direction: DVec3, tuning: &UprightTuning) -> (f64, f64) {
    let least = libm::cos(tuning.normal_rad);
    let parallel = facets.iter().filter(|f| f.1.dot(direction) >= least);
    let mut heights: Vec<(f64, f64)> = parallel.map(|f| (f.0.dot(direction), f.2)).collect();
    heights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let thickness = 2.0 * COARSE * tuning.thickness_m;
    let (mut low, mut area, mut fullest) = (0, 0.0, (0.0, 0.0));
    for (height, facet) in &heights {
        area += facet;
        while heights[low].0 < height - thickness {
            area -= heights[low].1;
            low += 1;
        }
        if area > fullest.0 {
            fullest = (area, (heights[low].0 + height) / 2.0);
        }
    }
    fullest
}

/// Normal of the plane that fits the surface near the fullest slab of a direction, and the area in it.
fn fitted(facets: &[Facet], direction: DVec3, tuning: &UprightTuning) -> Option<(DVec3, f64)> {
    let least = libm::cos(tuning.normal_rad);
    let (mut normal, mut half) = (direction, COARSE * tuning.thickness_m);
    let mut height = fullest_slab(facets, direction, tuning).1;
    let mut area = 0.0;
    for _ in 0..ROUNDS {
        let inside = |f: &&Facet| f.1.dot(normal) >= least && (f.0.dot(normal) - height).abs() <= half;
        let (sum, weight) = facets.iter().filter(inside).fold((DVec3::ZERO, 0.0), |(s, w), f| (s + f.0 * f.2, w + f.2));
        if weight <= 0.0 {
            return None;
        }
        let middle = sum / weight;
        let mut spread = Matrix3::<f64>::zeros();
        for f in facets.iter().filter(inside) {
            let d = f.0 - middle;
            let d = nalgebra::Vector3::new(d.x, d.y, d.z);
            spread += d * d.transpose() * f.2;
        }
        let eigen = SymmetricEigen::new(spread);
        let thin = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let fit = DVec3::new(thin[0], thin[1], thin[2]);
        normal = if fit.dot(direction) < 0.0 { -fit } else { fit };
        (height, area) = (middle.dot(normal), weight);
        half = (half * 0.7).max(tuning.thickness_m);
    }
    Some((normal, area))
}

fn vertical_area(facets: &[Facet], up: DVec3, tuning: &UprightTuning) -> f64 {
    let most = libm::sin(tuning.normal_rad);
    facets.iter().filter(|f| f.1.dot(up).abs() <= most).map(|f| f.2).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, Vec3};

    /// A square patch of small triangles: its middle, its two sides (their cross product is its front), rough to `noise` metres.
    fn patch(mesh: &mut Mesh, middle: DVec3, x: DVec3, y: DVec3, noise: f64) {
        const N: u32 = 30;
        let first = mesh.positions.len() as u32;
        for i in 0..N * N {
            let (u, v) = (f64::from(i % N) / f64::from(N - 1) - 0.5, f64::from(i / N) / f64::from(N - 1) - 0.5);
            let rough = (f64::from(i.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5) * noise;
            mesh.positions.push((middle + x * u + y * v + x.cross(y).normalize() * rough).as_vec3());
        }
        for i in (0..N * N).filter(|i| i % N + 1 < N && i / N + 1 < N) {
            let i = first + i;
            mesh.triangles.extend([[i, i + 1, i + N + 1], [i, i + N + 1, i + N]]);
        }
    }

    /// A desk, a wall behind it and a slanted lid on it, all leaning with `turn`.
    fn scene(turn: DQuat, lid: f64, wall: f64) -> Mesh {
        let mut mesh = Mesh::default();
        let mut add = |middle: DVec3, x: DVec3, y: DVec3| patch(&mut mesh, turn * middle, turn * x, turn * y, 0.001);
        add(DVec3::ZERO, DVec3::X * 1.2, DVec3::Y * 0.8);
        add(DVec3::new(0.0, 0.4, 0.4), DVec3::X * wall, DVec3::Z * wall);
        let slope = DVec3::new(0.0, 0.766, 0.643);
        add(DVec3::new(0.0, 0.1, 0.3), DVec3::X * lid, slope * lid);
        mesh.normals = vec![Vec3::Z; mesh.positions.len()];
        mesh
    }

    #[test]
    fn a_desk_tells_up_though_the_first_picture_leans() {
        let up = |turn: DQuat| turn * DVec3::Z;
        for tilt in [0.0, 0.3, 0.7, -0.7] {
            let turn = DQuat::from_rotation_x(tilt) * DQuat::from_rotation_y(0.2 * tilt);
            let told = tell_up(&scene(turn, 0.3, 0.8), &UprightTuning::default());
            let error = DVec3::from(told.direction).angle_between(up(turn));
            assert!(error < 0.005, "leaning by {tilt}: {error}");
            let plane = told.plane.expect("a plane");
            assert!(plane.share > 0.4 && plane.vertical_share > 0.2, "{plane:?}");
        }
    }

    #[test]
    fn a_wall_decides_between_planes_of_like_size() {
        // The slanted plane is larger than the desk, and nothing stands at right angles to it.
        let turn = DQuat::from_rotation_x(-0.4);
        let told = tell_up(&scene(turn, 1.02, 0.9), &UprightTuning::default());
        assert!(DVec3::from(told.direction).angle_between(turn * DVec3::Z) < 0.005, "{told:?}");
    }

    #[test]
    fn without_a_plane_in_reach_the_first_picture_tells() {
        let tuning = UprightTuning::default();
        let told = tell_up(&scene(DQuat::from_rotation_x(1.2), 0.1, 0.1), &tuning);
        assert_eq!(told, ToldUp { direction: [0.0, 0.0, 1.0], plane: None });
        assert_eq!(tell_up(&Mesh::default(), &tuning).plane, None);
    }
}
