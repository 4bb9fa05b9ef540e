//! The tabletop: what the bundled recording shows.

use super::environment::Environment;
use super::fruit;
use super::material::Material;
use super::path::Arc;
use super::placement::{Place, part};
use super::scene::{Part, Scene};
use super::solid::{self, Solid};
use super::texture::{check, clouds, mottled, noise, oak, step};
use glam::{DVec3, Quat, Vec2, Vec3};

/// Builds the tabletop with cells of `cell_m` metres on the objects (half as fine again on the table).
#[must_use]
pub fn tabletop(cell_m: f32) -> Scene {
    let (mut parts, fruit) = fruit::bowl_of_fruit(cell_m);
    parts.extend(fruit);
    parts.extend([
        table(1.5 * cell_m),
        mat(cell_m),
        vase(cell_m),
        mug(cell_m),
        rings(cell_m),
        bear(cell_m),
        fruit::pear(cell_m),
    ]);
    parts.push(ball(cell_m));
    parts.extend(blocks(cell_m));
    Scene::new(parts, living_room())
}

/// Frames of the bundled recording.
pub const FRAMES: u32 = 84;

/// How the camera goes round the table in the bundled recording, at 15 frames a second.
#[must_use]
pub fn arc() -> Arc {
    Arc {
        target: DVec3::new(0.0, -0.03, 0.035),
        azimuth_deg: [-66.0, 66.0],
        elevation_deg: [37.0, 6.0],
        distance_m: [0.83, 0.05],
        tremor: [0.0015, 0.15],
        duration_s: f64::from(FRAMES) / 15.0,
    }
}

/// A room as light from far away: bright window on the left, a smaller one in front, a warm lamp behind.
#[must_use]
pub fn living_room() -> Environment {
    let pane = |d: Vec3, azimuth_deg: f32, elevation_deg: f32, half: [f32; 2]| {
        let azimuth = libm::atan2f(d.x, d.y).to_degrees() - azimuth_deg;
        let azimuth = azimuth - 360.0 * (azimuth / 360.0).round();
        let elevation = libm::asinf(d.z.clamp(-1.0, 1.0)).to_degrees() - elevation_deg;
        let soft = |x: f32, half: f32| 1.0 - step(half - 4.0, half + 4.0, x.abs());
        let bars = 0.35 + 0.65 * step(0.4, 2.2, azimuth.abs()) * step(0.4, 2.2, (elevation - 2.0).abs());
        soft(azimuth, half[0]) * soft(elevation, half[1]) * bars
    };
    let lamp = Vec3::new(0.50, 0.29, 0.82).normalize();
    Environment::new(128, move |d| {
        let height = d.z;
        let wall = Vec3::new(0.150, 0.136, 0.120) * (1.0 + 0.25 * d.y);
        let ceiling = Vec3::new(0.19, 0.186, 0.175);
        let floor = Vec3::new(0.085, 0.060, 0.042) * (1.0 + 0.35 * noise(d * 5.0));
        let mut light = floor.lerp(wall, step(-0.42, -0.34, height)).lerp(ceiling, step(0.62, 0.76, height));
        light += Vec3::new(23.0, 24.6, 26.6) * pane(d, -78.0, 37.0, [18.0, 15.0]);
        light += Vec3::new(3.4, 3.9, 4.6) * pane(d, 158.0, 24.0, [15.0, 16.0]);
        let away = libm::acosf(d.dot(lamp).clamp(-1.0, 1.0)).to_degrees() / 8.0;
        light + Vec3::new(15.0, 10.0, 5.6) * libm::expf(-0.5 * away * away)
    })
    .normalised()
}

fn table(cell: f32) -> Part {
    const RADIUS_M: f32 = 0.50;
    let slab = |p: Vec3| {
        let q = Vec2::new(p.truncate().length() - RADIUS_M + 0.010, (p.z + 0.014).abs() - 0.004);
        q.max(Vec2::ZERO).length() + q.max_element().min(0.0) - 0.010
    };
    let low = Vec3::new(-0.52, -0.52, -0.021);
    let mesh = solid::mesh(&slab, low, Vec3::new(0.52, 0.52, 0.01), cell);
    let color = |p: Vec3| oak(Quat::from_rotation_z(0.35) * p);
    Part { name: "table", material: Material::glossy(0.03, 0.25), texture: Box::new(color), mesh }
}

fn mat(cell: f32) -> Part {
    let place = Place::new(0.02, 0.02, 0.0, 12.0);
    let solid = |p: Vec3| solid::rounded_box(p, Vec3::new(0.225, 0.165, 0.0035), 0.003);
    let mesh =
        solid::mesh(&|p| solid(place.local(p)), Vec3::new(-0.29, -0.26, -0.008), Vec3::new(0.33, 0.30, 0.008), cell);
    let color = move |p: Vec3| {
        check(place.local(p).truncate(), 0.021, Vec3::new(0.62, 0.58, 0.48), Vec3::new(0.10, 0.17, 0.33))
    };
    Part { name: "mat", material: Material::MATTE, texture: Box::new(color), mesh }
}

fn vase(cell: f32) -> Part {
    let line = [
        (0.0, 0.006),
        (0.030, 0.006),
        (0.048, 0.032),
        (0.053, 0.062),
        (0.042, 0.105),
        (0.024, 0.140),
        (0.022, 0.160),
        (0.032, 0.182),
    ];
    let profile = solid::smooth_profile(&line.map(Vec2::from), 6);
    let shell: Solid = Box::new(move |p| solid::turned_shell(p, &profile, 0.009));
    let color = |p: Vec3| {
        let drip = p.z + 0.010 * clouds(Vec3::new(libm::atan2f(p.y, p.x) * 1.6, 0.0, 3.0)) + 0.003 * clouds(p / 0.01);
        let lower = mottled(Vec3::new(0.50, 0.36, 0.22), p, 0.004, 0.12);
        lower.lerp(mottled(Vec3::new(0.045, 0.075, 0.19), p, 0.03, 0.12), step(0.062, 0.066, drip))
    };
    part("vase", Material::glossy(0.12, 0.12), Place::new(-0.27, 0.15, -0.0005, 0.0), 0.195, cell, shell, color)
}

fn mug(cell: f32) -> Part {
    let line = [(0.0, 0.005), (0.027, 0.005), (0.036, 0.010), (0.039, 0.030), (0.040, 0.060), (0.0405, 0.088)];
    let profile = solid::smooth_profile(&line.map(Vec2::from), 6);
    let shell: Solid = Box::new(move |p| {
        let handle =
            solid::torus(Vec3::new(p.x - 0.044, p.z - 0.046, p.y), 0.025, 0.0055).max(0.040 - p.truncate().length());
        solid::blend(solid::turned_shell(p, &profile, 0.008), handle, 0.006)
    });
    let color = |p: Vec3| {
        let white = mottled(Vec3::new(0.74, 0.71, 0.64), p, 0.006, 0.05);
        let band =
            step(0.054, 0.055, p.z) * step(0.076, 0.075, p.z) + step(0.046, 0.047, p.z) * step(0.050, 0.049, p.z);
        let outside = step(0.036, 0.038, p.truncate().length()) * step(0.0485, 0.0475, p.truncate().length());
        white.lerp(Vec3::new(0.62, 0.10, 0.06), band * outside)
    };
    part("mug", Material::glossy(0.05, 0.10), Place::new(0.255, 0.120, -0.0005, -35.0), 0.10, cell, shell, color)
}

/// (height, major, minor, colour) of the rings, bottom to top.
const RINGS: [(f32, f32, f32, [f32; 3]); 4] = [
    (0.0135, 0.036, 0.0140, [0.05, 0.20, 0.48]),
    (0.0385, 0.030, 0.0125, [0.09, 0.42, 0.12]),
    (0.0600, 0.024, 0.0110, [0.78, 0.55, 0.04]),
    (0.0790, 0.018, 0.0100, [0.66, 0.06, 0.04]),
];

fn rings(cell: f32) -> Part {
    let tower: Solid = Box::new(|p| {
        let ball = solid::sphere(p - Vec3::Z * 0.101, 0.015);
        RINGS.iter().map(|&(z, major, minor, _)| solid::torus(p - Vec3::Z * z, major, minor)).fold(ball, f32::min)
    });
    let color = |p: Vec3| {
        let ring = RINGS.iter().find(|&&(z, _, minor, _)| p.z < z + minor);
        ring.map_or(Vec3::new(0.55, 0.50, 0.42), |r| Vec3::from(r.3))
    };
    part("rings", Material::glossy(0.05, 0.18), Place::new(-0.055, -0.265, 0.0, 0.0), 0.12, cell, tower, color)
}

fn ball(cell: f32) -> Part {
    let color = |p: Vec3| {
        let star = libm::sinf(libm::atan2f(p.y, p.x) * 5.0) * 0.004;
        let band = step(0.010, 0.009, (p.z + star).abs());
        Vec3::new(0.42, 0.27, 0.07).lerp(Vec3::new(0.50, 0.08, 0.10), band)
    };
    let place = Place::new(0.085, -0.225, 0.0325, 0.0).tilted(Vec3::new(1.0, 0.5, 0.0), 40.0);
    part("ball", Material::glossy(0.35, 0.17), place, 0.04, cell, Box::new(|p| solid::sphere(p, 0.033)), color)
}

fn blocks(cell: f32) -> [Part; 3] {
    const HALF: f32 = 0.024;
    let block = |name, place: Place, paint: Vec3| {
        let solid: Solid = Box::new(|p| solid::rounded_box(p, Vec3::splat(HALF), 0.003));
        let color = move |p: Vec3| {
            let q = p.abs() / HALF;
            // Each face: bare wood frame, painted field, a bare disc.
            let mut order = q.to_array();
            order.sort_by(f32::total_cmp);
            let field = step(0.80, 0.77, order[1]);
            let disc = step(0.40, 0.37, (order[0] * order[0] + order[1] * order[1]).sqrt());
            let wood = mottled(Vec3::new(0.56, 0.40, 0.22), p * Vec3::new(1.0, 6.0, 6.0), 0.02, 0.15);
            wood.lerp(mottled(paint, p, 0.01, 0.06), field * (1.0 - disc))
        };
        part(name, Material::MATTE, place, 0.045, cell, solid, color)
    };
    [
        block("block red", Place::new(0.250, -0.115, HALF - 0.0003, 20.0), Vec3::new(0.60, 0.05, 0.035)),
        block("block green", Place::new(0.238, -0.172, HALF - 0.0003, 52.0), Vec3::new(0.08, 0.36, 0.10)),
        block("block yellow", Place::new(0.247, -0.138, 3.0 * HALF - 0.0006, -8.0), Vec3::new(0.78, 0.56, 0.06)),
    ]
}

fn bear(cell: f32) -> Part {
    let mirrored = |p: Vec3| Vec3::new(p.x.abs(), p.y, p.z);
    let figure: Solid = Box::new(move |p| {
        let q = mirrored(p);
        let body = solid::ellipsoid(p - Vec3::new(0.0, 0.0, 0.046), Vec3::new(0.037, 0.033, 0.045));
        let head = solid::ellipsoid(p - Vec3::new(0.0, -0.005, 0.110), Vec3::new(0.034, 0.031, 0.031));
        let ear = solid::ellipsoid(q - Vec3::new(0.027, -0.002, 0.137), Vec3::new(0.0125, 0.0080, 0.0125));
        let snout = solid::ellipsoid(p - Vec3::new(0.0, -0.032, 0.102), Vec3::new(0.0145, 0.0125, 0.0115));
        let arm = solid::ellipsoid(
            Quat::from_rotation_y(0.5) * (q - Vec3::new(0.037, -0.014, 0.058)),
            Vec3::new(0.0125, 0.0150, 0.0250),
        );
        let leg = solid::ellipsoid(
            Quat::from_rotation_z(0.35) * (q - Vec3::new(0.026, -0.034, 0.0165)),
            Vec3::new(0.0155, 0.0240, 0.0165),
        );
        let limbs = [head, arm, leg].into_iter().fold(body, |a, b| solid::blend(a, b, 0.009));
        let all = solid::blend(solid::blend(limbs, ear, 0.006), snout, 0.005);
        all + 0.0011 * clouds(p / 0.0085)
    });
    let color = move |p: Vec3| {
        let q = mirrored(p);
        let spot = |c: Vec3, r: f32| step(r + 0.0012, r - 0.0012, q.distance(c));
        let light = spot(Vec3::new(0.0, -0.036, 0.101), 0.0155)
            + spot(Vec3::new(0.0, -0.036, 0.047), 0.023)
            + spot(Vec3::new(0.027, -0.012, 0.138), 0.0085)
            + spot(Vec3::new(0.034, -0.057, 0.0165), 0.0105);
        let dark = spot(Vec3::new(0.0, -0.0455, 0.106), 0.0058) + spot(Vec3::new(0.0125, -0.0335, 0.1165), 0.0040);
        let plush = mottled(Vec3::new(0.36, 0.185, 0.085), p, 0.005, 0.22);
        plush
            .lerp(mottled(Vec3::new(0.62, 0.45, 0.28), p, 0.004, 0.12), light.min(1.0))
            .lerp(Vec3::splat(0.02), dark.min(1.0))
    };
    part("bear", Material::MATTE, Place::new(-0.225, -0.120, 0.0005, 24.0), 0.16, cell, figure, color)
}
