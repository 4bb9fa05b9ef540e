//! Small scenes for tests: planes, a corner, a room to walk around in.

use super::environment::Environment;
use super::material::Material;
use super::path::look_at;
use super::scene::{Part, Scene};
use super::tabletop::living_room;
use super::texture::{check, mottled, oak, step};
use glam::{DVec3, Vec2, Vec3};
use recordings::types::{Mesh, Pose};

/// A rectangle from `corner` along two edges, in squares of about `cell` metres, seen from the side of `u` × `v`.
#[must_use]
pub fn rectangle(corner: Vec3, u: Vec3, v: Vec3, cell: f32) -> Mesh {
    let pieces = |edge: Vec3| ((edge.length() / cell).ceil() as u32).max(1);
    let (nu, nv) = (pieces(u), pieces(v));
    let normal = u.cross(v).normalize_or_zero();
    let mut mesh = Mesh::default();
    for j in 0..=nv {
        for i in 0..=nu {
            mesh.positions.push(corner + u * (i as f32 / nu as f32) + v * (j as f32 / nv as f32));
            mesh.normals.push(normal);
        }
    }
    for j in 0..nv {
        for i in 0..nu {
            let a = j * (nu + 1) + i;
            let b = a + nu + 1;
            mesh.triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
        }
    }
    mesh
}

/// The six faces of a box, seen from outside (`inwards`: from inside).
#[must_use]
pub fn cuboid(low: Vec3, high: Vec3, cell: f32, inwards: bool) -> Mesh {
    let d = high - low;
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let edge = |k: usize| Vec3::AXES[k % 3] * d[k % 3];
        let (u, v) = (edge(axis + 1), edge(axis + 2));
        for (corner, outwards) in [(low, false), (low + edge(axis), true)] {
            let face = if outwards == inwards { rectangle(corner, v, u, cell) } else { rectangle(corner, u, v, cell) };
            append(&mut mesh, face);
        }
    }
    mesh
}

/// Adds a mesh to another.
pub fn append(mesh: &mut Mesh, more: Mesh) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(more.positions);
    mesh.normals.extend(more.normals);
    mesh.triangles.extend(more.triangles.iter().map(|t| t.map(|i| i + first)));
}

/// A matte part of any colour.
#[must_use]
pub fn matte(name: &'static str, mesh: Mesh, color: impl Fn(Vec3) -> Vec3 + Send + Sync + 'static) -> Part {
    Part { name, material: Material::MATTE, texture: Box::new(color), mesh }
}

/// A wall of 4 × 3 m in the plane y = 0, centred on the origin, facing −Y; plain grey, or with a check of 6 cm.
#[must_use]
pub fn wall(textured: bool) -> Scene {
    let mesh = rectangle(Vec3::new(-2.0, 0.0, -1.5), Vec3::X * 4.0, Vec3::Z * 3.0, 0.25);
    let color = move |p: Vec3| {
        let pattern = check(Vec2::new(p.x, p.z), 0.06, Vec3::new(0.6, 0.55, 0.45), Vec3::new(0.15, 0.2, 0.35));
        if textured { mottled(pattern, p, 0.15, 0.2) } else { Vec3::splat(0.5) }
    };
    Scene::new(vec![matte("wall", mesh, color)], living_room())
}

/// Three white squares of 1 m that meet in the origin: a floor and two walls, open towards (1, 1, 1), meshed in cells of
/// 2 cm. A good part of its light is bounced.
#[must_use]
pub fn corner(albedo: f32, environment: Environment) -> Scene {
    let faces = [("floor", Vec3::X, Vec3::Y), ("wall x", Vec3::Y, Vec3::Z), ("wall y", Vec3::Z, Vec3::X)];
    let part = |(name, u, v)| matte(name, rectangle(Vec3::ZERO, u, v, 0.02), move |_| Vec3::splat(albedo));
    Scene::new(faces.map(part).into(), environment)
}

/// A closed room of 5 × 4 × 2.5 m (x, y, z; floor at z = 0, centred on the z axis) with furniture and patterned walls.
/// No light gets in: render it with [`Shading::Flat`](super::render::Shading::Flat).
#[must_use]
pub fn room() -> Scene {
    let half = Vec3::new(2.5, 2.0, 2.5);
    let shell = cuboid(Vec3::new(-half.x, -half.y, 0.0), half, 0.5, true);
    let paper = move |p: Vec3| {
        if p.z < 0.001 {
            return oak(p);
        }
        if p.z > half.z - 0.001 {
            return Vec3::splat(0.75);
        }
        let along = if p.x.abs() > half.x - 0.001 { p.y } else { p.x };
        let stripes = step(-0.15, 0.15, libm::sinf(along * 24.0)) * step(0.9, 0.95, p.z);
        let wall = Vec3::new(0.62, 0.56, 0.44).lerp(Vec3::new(0.45, 0.50, 0.46), stripes);
        let picture = Vec2::new((along * 0.9).rem_euclid(1.0) - 0.5, p.z - 1.5);
        let framed = picture.x.abs() < 0.28 && picture.y.abs() < 0.32;
        if framed { mottled(Vec3::new(0.35, 0.30, 0.28), p, 0.11, 0.9) } else { mottled(wall, p, 0.3, 0.12) }
    };
    // Name, two opposite corners, colour.
    let furniture = [
        ("table", [-0.6, 1.0, 0.70], [0.7, 1.7, 0.74], [0.45, 0.28, 0.14]),
        ("table leg", [-0.5, 1.3, 0.0], [-0.4, 1.4, 0.70], [0.40, 0.25, 0.13]),
        ("table leg", [0.5, 1.3, 0.0], [0.6, 1.4, 0.70], [0.40, 0.25, 0.13]),
        ("box", [-0.2, 1.2, 0.74], [0.1, 1.45, 0.92], [0.55, 0.12, 0.08]),
        ("cupboard", [-2.5, -1.2, 0.0], [-2.05, 0.3, 1.9], [0.55, 0.50, 0.42]),
        ("bench", [-0.9, -2.0, 0.0], [1.1, -1.55, 0.45], [0.14, 0.24, 0.40]),
        ("shelf", [2.15, -0.8, 0.0], [2.5, 0.9, 1.1], [0.35, 0.38, 0.20]),
        ("crate", [1.7, 1.3, 0.0], [2.2, 1.8, 0.5], [0.50, 0.42, 0.25]),
    ];
    let solid = |(name, low, high, color): (_, [f32; 3], [f32; 3], [f32; 3])| {
        matte(name, cuboid(low.into(), high.into(), 0.5, false), move |p| mottled(color.into(), p, 0.09, 0.5))
    };
    let mut parts = vec![matte("room", shell, paper)];
    parts.extend(furniture.map(solid));
    Scene::new(parts, Environment::uniform(Vec3::ZERO))
}

/// A walk in [`room`]: the camera turns once around in `duration_s`, looking outwards, a little up and down.
#[must_use]
pub fn room_tour(time_s: f64, duration_s: f64) -> Pose {
    let turn = std::f64::consts::TAU * time_s / duration_s;
    let (s, c) = libm::sincos(turn);
    let outwards = DVec3::new(s, c, 0.0);
    let position = DVec3::new(0.0, 0.0, 1.3) - 0.6 * outwards + DVec3::Z * (0.15 * libm::sin(2.0 * turn));
    let aim = position + outwards + DVec3::Z * (-0.25 + 0.12 * libm::sin(3.0 * turn));
    look_at(position, aim, 0.0)
}
