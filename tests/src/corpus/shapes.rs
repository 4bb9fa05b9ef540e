//! Objects: turned, swept, boxes, blobs, faceted stones, rings, in a frame of their own. They rest on z = 0 around the z axis.

use crate::synth::random::Rng;
use crate::synth::scenes::cuboid;
use crate::synth::solid;
use crate::synth::texture::noise;
use glam::{Quat, Vec2, Vec3};
use recordings::types::Mesh;

/// Mesh of an object with cells of the size given, metres.
pub type Mesher = Box<dyn Fn(f32) -> Mesh + Send + Sync>;

/// An object.
pub struct Shape {
    /// What it is.
    pub name: &'static str,
    /// Its mesh.
    pub mesh: Mesher,
    /// Radius about the z axis, metres.
    pub radius: f32,
    /// Height, metres.
    pub height: f32,
    /// True if something can stand on it.
    pub flat: bool,
    /// Its surface in square metres, roughly.
    pub area: f32,
}

/// The least number of cells through the thickness of a shell.
const SHELL_CELLS: f32 = 1.9;

fn implicit(
    name: &'static str,
    radius: f32,
    height: f32,
    distance: impl Fn(Vec3, f32) -> f32 + Send + Sync + 'static,
) -> Shape {
    let mesh = move |cell: f32| {
        let margin = 2.0 * cell;
        let low = Vec3::new(-radius - margin, -radius - margin, -margin);
        let high = Vec3::new(radius + margin, radius + margin, height + margin);
        solid::mesh(&|p| distance(p, cell), low, high, cell)
    };
    let area = std::f32::consts::TAU * radius * (height + radius) * 0.8;
    Shape { name, mesh: Box::new(mesh), radius, height, flat: false, area }
}

/// A random object of about `size` metres.
#[must_use]
pub fn random(rng: &mut Rng, size: f32) -> Shape {
    match rng.below(9) {
        0 => vase(rng, size),
        1 => bowl(rng, size),
        2 => turned(rng, size),
        3 => swept(rng, size),
        4 | 5 => block(rng, size),
        6 => blob(rng, size),
        7 => stone(rng, size),
        _ => ring(rng, size),
    }
}

fn vase(rng: &mut Rng, size: f32) -> Shape {
    let height = size * rng.between(1.0, 1.7);
    let radius = size * rng.between(0.28, 0.45);
    let neck = rng.between(0.35, 0.9);
    let r = |share: f32| radius * share;
    let points = [
        Vec2::new(0.0, 0.03 * height),
        Vec2::new(r(rng.between(0.5, 0.8)), 0.03 * height),
        Vec2::new(r(rng.between(0.8, 1.0)), height * rng.between(0.2, 0.35)),
        Vec2::new(r(rng.between(0.7, 1.0)), height * rng.between(0.45, 0.6)),
        Vec2::new(r(neck), height * rng.between(0.72, 0.85)),
        Vec2::new(r(neck * rng.between(0.9, 1.3)).min(radius), 0.97 * height),
    ];
    shell("vase", &points, radius * 1.1, height, 0.007 + 0.02 * size)
}

fn bowl(rng: &mut Rng, size: f32) -> Shape {
    let (radius, height) = (size * rng.between(0.5, 0.8), size * rng.between(0.3, 0.6));
    let points = [
        Vec2::new(0.0, 0.12 * height),
        Vec2::new(0.4 * radius, 0.12 * height),
        Vec2::new(radius * rng.between(0.75, 0.9), height * rng.between(0.35, 0.55)),
        Vec2::new(0.95 * radius, 0.92 * height),
    ];
    shell("bowl", &points, radius, height, 0.006 + 0.02 * size)
}

fn shell(name: &'static str, points: &[Vec2], radius: f32, height: f32, thickness: f32) -> Shape {
    let profile = solid::smooth_profile(points, 6);
    let mut shape = implicit(name, radius, height, move |p, cell| {
        solid::turned_shell(p, &profile, thickness.max(SHELL_CELLS * cell))
    });
    shape.area *= 1.7;
    shape
}

/// A solid of revolution: its profile's polygon, closed at the axis.
fn turned(rng: &mut Rng, size: f32) -> Shape {
    let height = size * rng.between(0.8, 1.6);
    let radius = size * rng.between(0.25, 0.45);
    let count = 5 + rng.below(3);
    let mut points = vec![Vec2::new(0.0, 0.0), Vec2::new(radius * rng.between(0.6, 1.0), 0.0)];
    for k in 1..count {
        points.push(Vec2::new(radius * rng.between(0.35, 1.0), height * k as f32 / count as f32));
    }
    points.extend([Vec2::new(radius * rng.between(0.2, 0.5), 0.95 * height), Vec2::new(0.0, height)]);
    let mut profile = vec![points[0]];
    profile.extend(solid::smooth_profile(&points[1..], 6).into_iter().map(|p| p.max(Vec2::ZERO)));
    implicit("turned", radius, height, move |p, _| polygon(Vec2::new(p.truncate().length(), p.z), &profile))
}

/// Signed distance to a closed polygon (Quilez).
fn polygon(p: Vec2, corners: &[Vec2]) -> f32 {
    let mut squared = f32::INFINITY;
    let mut sign = 1.0;
    for (k, &a) in corners.iter().enumerate() {
        let b = corners[(k + 1) % corners.len()];
        let (e, w) = (b - a, p - a);
        // The axis is no border: a solid of revolution goes on beyond it.
        if a.x > 0.0 || b.x > 0.0 {
            let t = (w.dot(e) / e.length_squared().max(1e-12)).clamp(0.0, 1.0);
            squared = squared.min((w - e * t).length_squared());
        }
        let c = [p.y >= a.y, p.y < b.y, e.x * w.y > e.y * w.x];
        if c == [true; 3] || c == [false; 3] {
            sign = -sign;
        }
    }
    sign * squared.sqrt()
}

/// A tube along a curve that lies on the ground, or winds upwards.
fn swept(rng: &mut Rng, size: f32) -> Shape {
    const PIECES: usize = 40;
    let thick = size * rng.between(0.10, 0.18);
    let turns = rng.between(0.3, 1.6);
    let rise = if rng.chance(0.5) { size * rng.between(0.3, 0.9) } else { 0.0 };
    let wave = rng.between(0.0, 0.35);
    let reach = size * rng.between(0.35, 0.6);
    let tip = rng.between(0.4, 1.0);
    let curve: Vec<(Vec3, f32)> = (0..=PIECES)
        .map(|k| {
            let t = k as f32 / PIECES as f32;
            let (s, c) = libm::sincosf(std::f32::consts::TAU * turns * t);
            let radius = (reach - thick) * (1.0 - wave * t);
            (Vec3::new(radius * c, radius * s, thick + rise * t), thick * (1.0 - (1.0 - tip) * t))
        })
        .collect();
    implicit("tube", reach, 2.0 * thick + rise, move |p, _| {
        let piece = |w: &[(Vec3, f32)]| {
            let (e, q) = (w[1].0 - w[0].0, p - w[0].0);
            let t = (q.dot(e) / e.length_squared()).clamp(0.0, 1.0);
            (q - e * t).length() - (w[0].1 + (w[1].1 - w[0].1) * t)
        };
        curve.windows(2).map(piece).fold(f32::INFINITY, f32::min)
    })
}

/// A box: with sharp edges (faces apart) or rounded.
fn block(rng: &mut Rng, size: f32) -> Shape {
    let half = Vec3::new(rng.between(0.25, 0.55), rng.between(0.2, 0.45), rng.between(0.08, 0.6)) * size;
    let (radius, height) = (half.truncate().length(), 2.0 * half.z);
    let turn = Quat::from_rotation_z(rng.between(0.0, 1.5));
    let rounding = size * rng.between(0.02, 0.12);
    let mut shape = if rng.chance(0.3) {
        let mesh = move |cell: f32| {
            let mut mesh = cuboid(Vec3::new(-half.x, -half.y, 0.0), Vec3::new(half.x, half.y, height), cell, false);
            mesh.positions.iter_mut().for_each(|p| *p = turn * *p);
            mesh.normals.iter_mut().for_each(|n| *n = turn * *n);
            mesh
        };
        Shape { name: "box", mesh: Box::new(mesh), radius, height, flat: true, area: 0.0 }
    } else {
        implicit("rounded box", radius, height, move |p, cell| {
            let p = turn.inverse() * (p - Vec3::Z * half.z);
            solid::rounded_box(p, half, rounding.max(0.9 * cell).min(0.9 * half.min_element()))
        })
    };
    shape.area = 8.0 * (half.x * half.y + half.y * half.z + half.z * half.x);
    shape.flat = true;
    shape
}

/// Ellipsoids that flow into each other, a little uneven.
fn blob(rng: &mut Rng, size: f32) -> Shape {
    let height = size * rng.between(0.7, 1.2);
    let radius = 0.5 * size;
    let trunk = (Vec3::new(0.0, 0.0, 0.4 * height), Vec3::new(0.6 * radius, 0.55 * radius, 0.4 * height));
    let mut balls = vec![trunk];
    for _ in 0..3 + rng.below(5) {
        let r = radius * rng.between(0.2, 0.42);
        let (s, c) = libm::sincosf(rng.between(0.0, std::f32::consts::TAU));
        let out = (radius - r) * rng.between(0.4, 1.0);
        let z = rng.between(r, height - r);
        let shape = Vec3::new(rng.between(0.7, 1.0), rng.between(0.7, 1.0), rng.between(0.7, 1.0));
        balls.push((Vec3::new(out * c, out * s, z), shape * r));
    }
    let (uneven, grain, fillet) = (size * rng.between(0.0, 0.012), size * 0.1, 0.12 * size);
    implicit("figure", radius, height, move |p, _| {
        let joined = balls.iter().map(|(c, r)| solid::ellipsoid(p - *c, *r)).reduce(|a, b| solid::blend(a, b, fillet));
        joined.unwrap_or(f32::INFINITY) + uneven * noise(p / grain)
    })
}

/// A convex stone with flat facets.
fn stone(rng: &mut Rng, size: f32) -> Shape {
    let (radius, height) = (size * rng.between(0.3, 0.5), size * rng.between(0.4, 0.8));
    let facets: Vec<(Vec3, f32)> = (0..9 + rng.below(10))
        .map(|_| {
            let n = Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(Vec3::Z);
            (n, rng.between(0.72, 0.95))
        })
        .collect();
    let stretch = Vec3::new(radius, radius, 0.5 * height);
    implicit("stone", radius, height, move |p, cell| {
        let q = (p - Vec3::Z * 0.5 * height) / stretch;
        let deepest = facets.iter().map(|(n, d)| n.dot(q) - d).fold(q.length() - 1.0, f32::max);
        (deepest * stretch.min_element()).max(0.6 * cell - p.z)
    })
}

fn ring(rng: &mut Rng, size: f32) -> Shape {
    let minor = size * rng.between(0.08, 0.16);
    let major = 0.5 * size - minor;
    let knots = if rng.chance(0.5) { rng.between(3.0, 7.0).floor() } else { 0.0 };
    let depth = 0.35 * minor;
    implicit("ring", 0.5 * size, 2.0 * minor + depth, move |p, _| {
        let bulge = depth * 0.5 * libm::sinf(knots * libm::atan2f(p.y, p.x));
        solid::torus(p - Vec3::Z * (minor + 0.5 * depth), major, minor + bulge)
    })
}

/// Head and shoulders on a foot.
#[must_use]
pub fn bust(rng: &mut Rng, size: f32) -> Shape {
    let s = size / 0.36;
    let broad = rng.between(0.9, 1.1);
    let turn = Quat::from_rotation_z(rng.between(-0.3, 0.3));
    let jut = rng.between(0.8, 1.2);
    let curls = rng.between(0.002, 0.005);
    implicit("bust", 0.40 * size, size, move |p, _| {
        let p = p / s;
        let h = turn.inverse() * (p - Vec3::new(0.0, -0.005, 0.285)) / broad;
        let side = Vec3::new(h.x.abs(), h.y, h.z);
        let at = |q: Vec3, c: [f32; 3], r: [f32; 3]| solid::ellipsoid(q - Vec3::from(c), Vec3::from(r));
        let skull =
            at(h, [0.0, 0.008, 0.012], [0.047, 0.056, 0.058]) + curls * noise(h / 0.012) * h.y.clamp(0.0, 0.04) * 25.0;
        let jaw = at(h, [0.0, -0.018, -0.032], [0.033, 0.036, 0.034]);
        let nose = at(h, [0.0, -0.052 * jut, -0.006], [0.008, 0.013, 0.017]);
        let brow = at(side, [0.017, -0.043, 0.014], [0.016, 0.010, 0.007]);
        let socket = at(side, [0.017, -0.053, 0.001], [0.010, 0.010, 0.008]);
        let lips = at(h, [0.0, -0.050, -0.030], [0.014, 0.008, 0.007]);
        let ear = at(side, [0.047, 0.008, -0.004], [0.007, 0.013, 0.018]);
        let neck = at(p, [0.0, 0.006, 0.205], [0.032, 0.034, 0.075]);
        let shoulders = at(p, [0.0, 0.014, 0.140], [0.125, 0.048, 0.050]);
        let chest = at(p, [0.0, -0.002, 0.118], [0.085, 0.050, 0.055]);
        let foot = solid::rounded_box(p - Vec3::Z * 0.028, Vec3::new(0.058, 0.058, 0.027), 0.008);
        let stem = at(p, [0.0, 0.0, 0.07], [0.030, 0.030, 0.060]);
        let face = [jaw, nose, brow, lips, ear].into_iter().fold(skull, |a, b| solid::blend(a, b, 0.010));
        let face = -solid::blend(-face, socket, 0.006);
        let body = solid::blend(solid::blend(shoulders, chest, 0.03), neck, 0.03);
        let figure = solid::blend(solid::blend(face, body, 0.018), solid::blend(stem, foot, 0.01), 0.02);
        figure * s
    })
}
