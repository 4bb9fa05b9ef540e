//! Where things stand: the surface that a pixel shows, or what lies below it where that is steep. What is below is told by the
//! scan: where no accelerometer did, the first picture's up is +Z, and a desk leans.

use crate::numerics::rotation::rotate;
use crate::numerics::sh::even_directions;
use crate::rays::RayScene;
use glam::{Quat, Vec3};
use recordings::types::Mesh;

/// Things stand on surfaces no steeper than this: cosine of 35°.
const LEAST_UP: f32 = 0.82;
/// Surface this far above or below the point that was meant still carries the thing, metres.
const REACH_M: f32 = 0.03;
/// Points that are looked at under the foot, along each side.
const GRID: i32 = 9;
/// Steep surfaces that are passed on the way down.
const MAX_STEPS: usize = 8;

/// Directions over the sphere that are tried for the scan's own up.
const DIRECTIONS: usize = 1000;
/// Cosine between the scan's own up and +Z: of 50°, and of 10°, within which the scan is upright.
const MAX_LEAN: f32 = 0.643;
const UPRIGHT: f32 = 0.985;
/// Surface whose normal is within 15° of a direction faces it: cosine.
const FACING: f32 = 0.966;
/// Smallest share of the surface that faces the scan's own up.
const LEAST_SHARE: f32 = 0.06;
/// Triangles that are looked at, evenly taken from all, and rounds of averaging their normals.
const MAX_TRIANGLES: usize = 20_000;
const ROUNDS: usize = 5;

/// The direction within 50° of +Z that most of the surface faces, a desk or a floor; +Z itself where that is within 10° or none
/// is large.
#[must_use]
pub fn own_up(mesh: &Mesh) -> Vec3 {
    let stride = mesh.triangles.len().div_ceil(MAX_TRIANGLES).max(1);
    // Length: twice the area.
    let normals: Vec<Vec3> = mesh.triangles.iter().step_by(stride).map(|t| normal(mesh, t)).collect();
    let total: f32 = normals.iter().map(|n| n.length()).sum();
    let facing = |d: Vec3| -> Vec3 { normals.iter().filter(|n| n.dot(d) >= FACING * n.length()).sum() };
    let tried = even_directions(DIRECTIONS).into_iter().map(|d| d.as_vec3()).filter(|d| d.z >= MAX_LEAN);
    let most = tried.map(|d| (facing(d).length(), d)).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((area, mut up)) = most.filter(|(area, _)| *area >= LEAST_SHARE * total && *area > 0.0) else {
        return Vec3::Z;
    };
    for _ in 0..ROUNDS {
        up = facing(up).try_normalize().unwrap_or(up);
    }
    tracing::debug!(share = area / total, ?up, "direction that most of the surface faces");
    if up.z >= UPRIGHT || up.z < MAX_LEAN { Vec3::Z } else { up }
}

/// The point on which a foot of half width `radius` (metres) stands, for a ray from `eye` along the unit `direction`: the middle of
/// its base, `up` the unit direction away from what carries it. `None` if the ray meets nothing.
#[must_use]
pub fn standing_point(
    mesh: &Mesh,
    scene: &RayScene,
    up: Vec3,
    (eye, direction): (Vec3, Vec3),
    radius: f32,
) -> Option<Vec3> {
    let hit = scene.closest_hit(eye, direction)?;
    let mut at = eye + direction * hit.distance;
    if upward(mesh, hit.triangle, up) < LEAST_UP {
        at = below(mesh, scene, at, up, direction, radius).unwrap_or(at);
    }
    let turn = Quat::from_rotation_arc(Vec3::Z, up);
    // Under the foot: bumps of the surface and the noise of its depth lift or sink no thing.
    let mut heights = Vec::new();
    for i in 0..GRID * GRID {
        let offset =
            Vec3::new((i % GRID) as f32, (i / GRID) as f32, 0.0) * (2.0 / (GRID - 1) as f32) - Vec3::new(1.0, 1.0, 0.0);
        let from = at + rotate(turn, offset * radius) + up * REACH_M;
        let Some(hit) = scene.closest_hit(from, -up).filter(|h| h.distance <= 2.0 * REACH_M) else { continue };
        if offset.length_squared() <= 1.0 && upward(mesh, hit.triangle, up) >= LEAST_UP {
            heights.push(REACH_M - hit.distance);
        }
    }
    heights.sort_by(f32::total_cmp);
    Some(at + up * heights.get(heights.len() / 2).copied().unwrap_or(0.0))
}

/// The first surface to stand on below a point of a steep one, as far before it as the foot is wide.
fn below(mesh: &Mesh, scene: &RayScene, at: Vec3, up: Vec3, direction: Vec3, radius: f32) -> Option<Vec3> {
    let towards_viewer = -(direction - up * direction.dot(up)).normalize_or_zero();
    let mut from = at + towards_viewer * radius;
    for _ in 0..MAX_STEPS {
        let hit = scene.closest_hit(from, -up)?;
        let point = from - up * hit.distance;
        if upward(mesh, hit.triangle, up) >= LEAST_UP {
            return Some(point);
        }
        from = scene.offset_origin(point, -up);
    }
    None
}

/// Cosine between a triangle's front and up.
fn upward(mesh: &Mesh, triangle: u32, up: Vec3) -> f32 {
    normal(mesh, &mesh.triangles[triangle as usize]).normalize_or_zero().dot(up)
}

/// Towards a triangle's front, as long as twice its area.
fn normal(mesh: &Mesh, triangle: &[u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bumpy floor of 2 m with a wall that faces −Y at y = 0.5, up to 1 m.
    fn room() -> Mesh {
        const N: u32 = 101;
        let mut mesh = Mesh::default();
        for i in 0..N * N {
            let (x, y) = ((i % N) as f32 * 0.02 - 1.0, (i / N) as f32 * 0.02 - 1.0);
            let bump = 0.003 * libm::sinf(40.0 * x) * libm::sinf(37.0 * y);
            mesh.positions.push(Vec3::new(x, y, 0.1 + bump));
        }
        for i in (0..N * N).filter(|i| i % N + 1 < N && i / N + 1 < N) {
            mesh.triangles.extend([[i, i + 1, i + N + 1], [i, i + N + 1, i + N]]);
        }
        let first = N * N;
        let corners = [(-1.0, 0.0), (1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)];
        mesh.positions.extend(corners.map(|(x, z)| Vec3::new(x, 0.5, z)));
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        mesh.normals = vec![Vec3::Z; mesh.positions.len()];
        mesh
    }

    fn stand(at: Vec3, radius: f32) -> Option<Vec3> {
        let mesh = room();
        let eye = Vec3::new(0.0, -1.5, 1.2);
        standing_point(&mesh, &RayScene::new(&mesh), Vec3::Z, (eye, (at - eye).normalize()), radius)
    }

    #[test]
    fn a_thing_stands_on_the_floor_that_the_pixel_shows() {
        let found = stand(Vec3::new(0.2, 0.0, 0.1), 0.15).unwrap();
        assert!((found - Vec3::new(0.2, 0.0, 0.1)).length() < 0.01, "{found}");
        assert!((found.z - 0.1).abs() < 0.0015, "bumps of 3 mm moved it to {found}");
    }

    #[test]
    fn before_a_wall_it_stands_on_the_floor_below() {
        let found = stand(Vec3::new(0.3, 0.5, 0.7), 0.1).unwrap();
        assert!((found.z - 0.1).abs() < 0.002 && found.y < 0.5 && found.y > 0.35, "{found}");
        assert_eq!(stand(Vec3::new(0.0, -1.0, 3.0), 0.1), None);
    }

    /// The room turned about the x axis.
    fn leaning(degrees: f32) -> (Mesh, Quat) {
        let (mut mesh, turn) = (room(), Quat::from_rotation_x(degrees.to_radians()));
        mesh.positions.iter_mut().for_each(|p| *p = turn * *p);
        (mesh, turn)
    }

    #[test]
    fn the_floor_tells_up_unless_the_scan_is_upright() {
        for degrees in [0.0, 4.0, -8.0] {
            assert_eq!(own_up(&leaning(degrees).0), Vec3::Z, "{degrees}");
        }
        for degrees in [20.0, 40.0, -40.0] {
            let (mesh, turn) = leaning(degrees);
            let off = own_up(&mesh).angle_between(turn * Vec3::Z).to_degrees();
            assert!(off < 1.0, "{degrees}: {off} degrees off");
        }
        assert_eq!(own_up(&leaning(70.0).0), Vec3::Z);
        assert_eq!(own_up(&Mesh::default()), Vec3::Z);
    }

    #[test]
    fn on_a_floor_that_leans_a_thing_stands_as_on_a_level_one() {
        let (mesh, turn) = leaning(40.0);
        for at in [Vec3::new(0.2, 0.0, 0.1), Vec3::new(0.3, 0.5, 0.7)] {
            let (eye, level) = (Vec3::new(0.0, -1.5, 1.2), stand(at, 0.1).unwrap());
            let ray = (turn * eye, turn * (at - eye).normalize());
            let found = standing_point(&mesh, &RayScene::new(&mesh), own_up(&mesh), ray, 0.1).unwrap();
            assert!(found.distance(turn * level) < 0.01, "{found}, not {}", turn * level);
        }
    }
}
