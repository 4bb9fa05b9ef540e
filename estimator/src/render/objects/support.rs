//! Where things stand: the surface that a pixel shows, or what lies below it where that is steep.

use crate::rays::RayScene;
use glam::Vec3;
use recordings::types::Mesh;

/// Things stand on surfaces no steeper than this: cosine of 35°.
const LEAST_UP: f32 = 0.82;
/// Surface this far above or below the point that was meant still carries the thing, metres.
const REACH_M: f32 = 0.03;
/// Points that are looked at under the foot, along each side.
const GRID: i32 = 9;
/// Steep surfaces that are passed on the way down.
const MAX_STEPS: usize = 8;

/// The point on which a foot of half width `radius` (metres) stands, for a ray from `eye` along the unit `direction`: the middle of
/// its base, +Z up. `None` if the ray meets nothing.
#[must_use]
pub fn standing_point(mesh: &Mesh, scene: &RayScene, (eye, direction): (Vec3, Vec3), radius: f32) -> Option<Vec3> {
    let hit = scene.closest_hit(eye, direction)?;
    let mut at = eye + direction * hit.distance;
    if upward(mesh, hit.triangle) < LEAST_UP {
        at = below(mesh, scene, at, direction, radius).unwrap_or(at);
    }
    // Under the foot: bumps of the surface and the noise of its depth lift or sink no thing.
    let mut heights = Vec::new();
    for i in 0..GRID * GRID {
        let offset =
            Vec3::new((i % GRID) as f32, (i / GRID) as f32, 0.0) * (2.0 / (GRID - 1) as f32) - Vec3::new(1.0, 1.0, 0.0);
        let from = at + offset * radius + Vec3::Z * REACH_M;
        let Some(hit) = scene.closest_hit(from, Vec3::NEG_Z).filter(|h| h.distance <= 2.0 * REACH_M) else { continue };
        if offset.length_squared() <= 1.0 && upward(mesh, hit.triangle) >= LEAST_UP {
            heights.push(from.z - hit.distance);
        }
    }
    heights.sort_by(f32::total_cmp);
    Some(heights.get(heights.len() / 2).map_or(at, |z| Vec3::new(at.x, at.y, *z)))
}

/// The first surface to stand on below a point of a steep one, as far before it as the foot is wide.
fn below(mesh: &Mesh, scene: &RayScene, at: Vec3, direction: Vec3, radius: f32) -> Option<Vec3> {
    let towards_viewer = -Vec3::new(direction.x, direction.y, 0.0).normalize_or_zero();
    let mut from = at + towards_viewer * radius;
    for _ in 0..MAX_STEPS {
        let hit = scene.closest_hit(from, Vec3::NEG_Z)?;
        let point = from - Vec3::Z * hit.distance;
        if upward(mesh, hit.triangle) >= LEAST_UP {
            return Some(point);
        }
        from = scene.offset_origin(point, Vec3::NEG_Z);
    }
    None
}

/// Cosine between a triangle's front and +Z.
fn upward(mesh: &Mesh, triangle: u32) -> f32 {
    let [a, b, c] = mesh.triangles[triangle as usize].map(|i| mesh.positions[i as usize]);
    (b - a).cross(c - a).normalize_or_zero().z
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
        standing_point(&mesh, &RayScene::new(&mesh), (eye, (at - eye).normalize()), radius)
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
}
