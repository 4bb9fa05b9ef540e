//! The bowl of fruit on the table.

use super::material::Material;
use super::placement::{Place, part};
use super::scene::Part;
use super::solid::{self, Solid};
use super::texture::{clouds, mottled, noise, step};
use glam::{Quat, Vec2, Vec3};

pub(super) fn bowl_of_fruit(cell: f32) -> (Vec<Part>, Vec<Part>) {
    let place = Place::new(0.0, 0.035, 0.003, 0.0);
    let rim: [(f32, f32); 6] =
        [(0.0, 0.0045), (0.036, 0.0045), (0.058, 0.010), (0.088, 0.032), (0.108, 0.060), (0.115, 0.080)];
    let profile = solid::smooth_profile(&rim.map(Vec2::from), 6);
    let inside = profile.clone();
    let bowl_distance = move |p: Vec3| solid::turned_shell(place.local(p), &inside, 0.009);
    let glaze = |p: Vec3| {
        let rim = step(0.072, 0.076, p.z + 0.0015 * clouds(p / 0.02));
        mottled(Vec3::new(0.10, 0.33, 0.34).lerp(Vec3::new(0.30, 0.16, 0.08), rim), p, 0.012, 0.14)
    };
    let shell: Solid = Box::new(move |p| solid::turned_shell(p, &profile, 0.009));
    let bowl = part("bowl", Material::glossy(0.07, 0.14), place, 0.13, cell, shell, glaze);

    // The fruit lie as balls would that are lowered one after the other at these places.
    let balls: [(f32, f32, f32); 5] = [
        (-0.048, 0.010, 0.037),
        (0.030, -0.028, 0.036),
        (0.026, 0.050, 0.038),
        (-0.024, -0.052, 0.029),
        (0.006, 0.012, 0.034),
    ];
    let mut rest: Vec<(Vec3, f32)> = Vec::new();
    for (x, y, radius) in balls {
        let mut centre = place.at + Vec3::new(x, y, 0.25);
        let free = |c: Vec3| bowl_distance(c) > radius && rest.iter().all(|(o, r)| o.distance(c) > r + radius);
        while centre.z > 0.0 && free(centre - Vec3::Z * 0.0005) {
            centre.z -= 0.0005;
        }
        rest.push((centre, radius));
    }
    let at = |k: usize| Place { at: rest[k].0, turn: Quat::IDENTITY };
    let orange = |k: usize| {
        let radius = rest[k].1;
        let peel: Solid = Box::new(move |p| solid::sphere(p, radius) + 0.00035 * noise(p / 0.0022));
        let color = |p: Vec3| mottled(Vec3::new(0.80, 0.27, 0.025), p, 0.02, 0.10) * (1.0 + 0.10 * noise(p / 0.0022));
        part("orange", Material::glossy(0.04, 0.28), at(k), radius + 0.008, cell, peel, color)
    };
    let lemon_peel: Solid = Box::new(|p| {
        let tips = solid::sphere(p - Vec3::X * 0.036, 0.008).min(solid::sphere(p + Vec3::X * 0.036, 0.006));
        solid::blend(solid::ellipsoid(p, Vec3::new(0.040, 0.029, 0.029)), tips, 0.012) + 0.0003 * noise(p / 0.003)
    });
    let lemon_color = |p: Vec3| mottled(Vec3::new(0.82, 0.62, 0.06), p, 0.015, 0.08);
    let lemon = part(
        "lemon",
        Material::glossy(0.04, 0.25),
        at(3).tilted(Vec3::new(0.2, 0.3, 1.0), 25.0),
        0.056,
        cell,
        lemon_peel,
        lemon_color,
    );
    let fruit = vec![orange(0), apple(at(1), rest[1].1, cell), orange(2), lemon, apple(at(4), rest[4].1, cell)];
    (vec![bowl], fruit)
}

fn apple(place: Place, radius: f32, cell: f32) -> Part {
    let place = place.tilted(Vec3::new(1.0, -0.6, 0.0), 24.0);
    let skin: Solid = Box::new(move |p| {
        let polar = libm::atan2f(p.truncate().length(), p.z);
        let dip = |angle: f32, depth: f32| depth * libm::expf(-angle * angle / 0.16);
        let flesh = p.length() - radius * (1.03 - dip(polar, 0.30) - dip(std::f32::consts::PI - polar, 0.16));
        let stem = Vec2::new(p.x - 0.15 * (p.z - 0.02), p.y).length() - 0.0020;
        let stem = stem.max(p.z - radius * 1.12).max(0.01 - p.z);
        solid::blend(flesh, stem, 0.003)
    });
    let color = move |p: Vec3| {
        let green = step(-0.1, 0.75, clouds(p / 0.05) + 0.9 * (p.z / radius) + 0.5 * p.x / radius - 0.35);
        let streaks = clouds(Vec3::new(libm::atan2f(p.y, p.x) * 9.0, p.z * 30.0, 0.0));
        let skin = Vec3::new(0.48, 0.035, 0.025).lerp(Vec3::new(0.50, 0.44, 0.07), green) * (1.0 + 0.18 * streaks);
        let stem = step(0.0050, 0.0030, p.truncate().length()) * step(0.75 * radius, 0.85 * radius, p.z);
        skin.lerp(Vec3::new(0.10, 0.06, 0.03), stem)
    };
    part("apple", Material::glossy(0.05, 0.16), place, 1.25 * radius, cell, skin, color)
}

pub(super) fn pear(cell: f32) -> Part {
    let flesh: Solid = Box::new(|p| {
        let body = solid::sphere(p - Vec3::Z * 0.033, 0.034);
        let neck = solid::sphere(p - Vec3::new(0.002, 0.0, 0.074), 0.017);
        let stem = Vec2::new(p.x - 0.002 - 0.2 * (p.z - 0.085), p.y).length() - 0.0021;
        let stem = stem.max(p.z - 0.105).max(0.085 - p.z);
        solid::blend(solid::blend(body, neck, 0.050), stem, 0.003)
    });
    let color = |p: Vec3| {
        let blush = step(0.0, 0.9, clouds(p / 0.04) + p.x / 0.04);
        let freckles = step(0.45, 0.7, noise(p / 0.0026));
        let skin = Vec3::new(0.44, 0.48, 0.09).lerp(Vec3::new(0.58, 0.30, 0.09), blush) * (1.0 - 0.25 * freckles);
        skin.lerp(Vec3::new(0.12, 0.07, 0.03), step(0.0915, 0.0925, p.z))
    };
    let place = Place::new(0.165, -0.040, 0.003, 70.0);
    let mut pear = part("pear", Material::glossy(0.03, 0.30), place, 0.11, cell, flesh, color);
    pear.name = "pear";
    pear
}
