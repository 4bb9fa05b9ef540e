//! Procedural base colours, linear RGB.

use glam::{Vec2, Vec3};

/// Smooth value noise in [−1, 1], period-free, feature size 1.
#[must_use]
pub fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * (3.0 - 2.0 * f);
    let at = |x: f32, y: f32, z: f32| lattice(cell + Vec3::new(x, y, z));
    let line = |y: f32, z: f32| at(0.0, y, z) + (at(1.0, y, z) - at(0.0, y, z)) * w.x;
    let plane = |z: f32| line(0.0, z) + (line(1.0, z) - line(0.0, z)) * w.y;
    plane(0.0) + (plane(1.0) - plane(0.0)) * w.z
}

fn lattice(p: Vec3) -> f32 {
    let [x, y, z] = p.to_array().map(|x| x as i32 as u32);
    let mut h = x.wrapping_mul(0x8da6_b343) ^ y.wrapping_mul(0xd816_3841) ^ z.wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    h as f32 * (2.0 / u32::MAX as f32) - 1.0
}

/// Four octaves of [`noise`], about [−1, 1].
#[must_use]
pub fn clouds(p: Vec3) -> f32 {
    let octave = |k: i32| noise(p * (1 << k) as f32 + 17.3 * k as f32) / (1 << k) as f32;
    (0..4).map(octave).sum::<f32>() / 1.5
}

/// 0 below `low`, 1 above `high`, smooth between.
#[must_use]
pub fn step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Planks of oak along x: growth lines, pores, joints.
#[must_use]
pub fn oak(p: Vec3) -> Vec3 {
    const PLANK_M: f32 = 0.092;
    let plank = (p.y / PLANK_M).floor();
    let across = p.y / PLANK_M - plank;
    let own = lattice(Vec3::new(plank, 3.0, 7.0));
    let along = p.x + 0.6 * own;
    let wander = 0.012 * clouds(Vec3::new(along * 5.0, p.y * 9.0, 11.0 * own));
    let rings = (p.y + wander + 0.03 * own) * 190.0 + 2.0 * clouds(Vec3::new(along * 3.0, p.y * 30.0, 5.0 * own));
    let ring = 0.5 + 0.5 * libm::sinf(rings * (1.0 + 0.15 * own));
    let pores = step(0.35, 0.8, noise(Vec3::new(along * 60.0, p.y * 1500.0, own * 9.0)));
    let color = Vec3::new(0.50, 0.315, 0.165).lerp(Vec3::new(0.36, 0.205, 0.095), 0.75 * ring * ring);
    let joint = step(0.0, 0.016, across.min(1.0 - across));
    color * (1.0 + 0.16 * own) * (1.0 - 0.25 * pores) * (0.35 + 0.65 * joint)
}

/// A woven check of two yarns, `pitch` metres a stripe.
#[must_use]
pub fn check(p: Vec2, pitch: f32, ground: Vec3, yarn: Vec3) -> Vec3 {
    let band = |x: f32| {
        let t = (x / pitch).rem_euclid(2.0);
        step(0.0, 0.04, t) * (1.0 - step(1.0, 1.04, t))
    };
    let both = 0.5 * (band(p.x) + band(p.y));
    let thread = libm::sinf(p.x * 2600.0) * libm::sinf(p.y * 2600.0);
    let slub = clouds(Vec3::new(p.x * 300.0, p.y * 60.0, 0.0)) + clouds(Vec3::new(p.x * 60.0, p.y * 300.0, 5.0));
    ground.lerp(yarn, both) * (1.0 + 0.06 * thread + 0.08 * slub)
}

/// A colour that varies a little.
#[must_use]
pub fn mottled(color: Vec3, p: Vec3, size_m: f32, share: f32) -> Vec3 {
    color * (1.0 + share * clouds(p / size_m))
}
