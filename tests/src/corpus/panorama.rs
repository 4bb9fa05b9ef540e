//! Procedural panoramas of distant light, mean luminance 1.

use crate::synth::environment::Environment;
use crate::synth::random::Rng;
use crate::synth::texture::{clouds, step};
use glam::Vec3;

/// Kinds of panorama.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Panorama {
    /// A room with one to three windows.
    Windows,
    /// Sky and sun.
    Sky,
    /// A hall with lamps.
    Lamps,
    /// Screens in a dim room.
    Monitors,
    /// Two or three strong colours.
    Coloured,
    /// Nearly the same from everywhere.
    Even,
}

/// Rows of the map.
const ROWS: usize = 128;
/// No direction is brighter than this, with mean 1.
const BRIGHTEST: f32 = 180.0;

/// A kind, the usual ones more often.
#[must_use]
pub fn kind(rng: &mut Rng) -> Panorama {
    match rng.below(12) {
        0..=3 => Panorama::Windows,
        4..=6 => Panorama::Sky,
        7 | 8 => Panorama::Lamps,
        9 => Panorama::Monitors,
        10 => Panorama::Coloured,
        _ => Panorama::Even,
    }
}

/// Another kind than one given.
#[must_use]
pub fn other_kind(rng: &mut Rng, than: Panorama) -> Panorama {
    loop {
        let found = kind(rng);
        if found != than && found != Panorama::Even {
            return found;
        }
    }
}

type Part = Box<dyn Fn(Vec3) -> Vec3>;

/// Makes one.
#[must_use]
pub fn panorama(rng: &mut Rng, kind: Panorama) -> Environment {
    let mut parts: Vec<Part> = Vec::new();
    let base = azimuth(rng);
    match kind {
        Panorama::Windows => {
            parts.push(interior(rng, 0.25));
            let count = 1 + rng.below(3);
            for k in 0..count {
                let bars = rng.chance(0.5);
                let half = [rng.between(10.0, 24.0), rng.between(13.0, 26.0)];
                let strength = rng.between(9.0, 26.0) / (1.0 + k as f32);
                let color = Vec3::new(rng.between(0.85, 1.0), 1.0, rng.between(1.0, 1.25)) * strength;
                let at = [base + k as f32 * rng.between(40.0, 110.0), rng.between(8.0, 38.0)];
                parts.push(pane(at, half, color, bars));
            }
        }
        Panorama::Sky => {
            let (zenith, overcast) = (Vec3::new(0.35, 0.55, 1.0), rng.between(0.0, 1.0));
            let horizon = Vec3::new(1.1, 1.15, 1.2);
            let ground = Vec3::new(rng.between(0.15, 0.35), rng.between(0.18, 0.3), 0.18);
            let shift = rng.between(0.0, 50.0);
            parts.push(Box::new(move |d| {
                let sky = horizon.lerp(zenith, d.z.max(0.0).sqrt());
                let cloud = step(0.0, 0.5, clouds(d * 3.0 + shift) + overcast - 0.5);
                ground.lerp(sky.lerp(Vec3::splat(1.3), 0.8 * cloud), step(-0.06, 0.04, d.z))
            }));
            let sun = towards(base, rng.between(18.0, 65.0));
            let width_deg = rng.between(2.5, 6.0);
            let share = rng.between(0.8, 3.5) * (1.0 - 0.7 * overcast);
            parts.push(spot(sun, width_deg, Vec3::new(1.0, 0.92, 0.78) * share));
        }
        Panorama::Lamps => {
            parts.push(interior(rng, 0.35));
            let warmth = rng.between(0.5, 0.95);
            for k in 0..2 + rng.below(5) {
                let at = towards(base + k as f32 * rng.between(30.0, 120.0), rng.between(20.0, 80.0));
                let color = Vec3::new(1.0, 0.5 + 0.5 * warmth, warmth) * rng.between(0.15, 0.75);
                parts.push(spot(at, rng.between(3.0, 9.0), color));
            }
        }
        Panorama::Monitors => {
            parts.push(interior(rng, 0.16));
            for k in 0..2 + rng.below(2) {
                let color = Vec3::new(rng.between(2.0, 8.0), rng.between(3.0, 8.0), rng.between(3.0, 10.0));
                let half = [rng.between(16.0, 28.0), rng.between(10.0, 17.0)];
                let at = [base + k as f32 * rng.between(55.0, 120.0), rng.between(5.0, 25.0)];
                parts.push(pane(at, half, color, false));
            }
        }
        Panorama::Coloured => {
            parts.push(Box::new(|_| Vec3::splat(0.25)));
            for k in 0..3 {
                let weights = Vec3::new(rng.between(0.1, 1.0), rng.between(0.1, 1.0), rng.between(0.1, 1.0));
                let at = towards(base + 120.0 * k as f32 + rng.between(-30.0, 30.0), rng.between(0.0, 60.0));
                parts.push(spot(at, rng.between(16.0, 32.0), weights * rng.between(0.8, 1.8)));
            }
        }
        Panorama::Even => {
            let axis = towards(base, rng.between(20.0, 90.0));
            let slope = rng.between(0.1, 0.45);
            let tint = Vec3::new(rng.between(0.85, 1.1), 1.0, rng.between(0.85, 1.15));
            parts.push(Box::new(move |d| tint * (1.0 + slope * d.dot(axis))));
        }
    }
    limited(&|d| parts.iter().map(|part| part(d)).sum())
}

/// A bust's room: dim, one tall window.
#[must_use]
pub fn daylight(rng: &mut Rng) -> Environment {
    let base = azimuth(rng);
    let room = interior(rng, 0.5);
    let window = pane([base, 18.0], [rng.between(15.0, 24.0), 30.0], Vec3::new(15.0, 16.0, 18.0), true);
    limited(&|d| room(d) + window(d))
}

/// Mean luminance 1, nothing brighter than [`BRIGHTEST`].
fn limited(radiance: &dyn Fn(Vec3) -> Vec3) -> Environment {
    let first = Environment::new(ROWS, radiance).normalised();
    let clipped = Environment::new(ROWS, |d| first.radiance(d).min(Vec3::splat(BRIGHTEST)));
    clipped.normalised()
}

fn azimuth(rng: &mut Rng) -> f32 {
    rng.between(0.0, 360.0)
}

fn towards(azimuth_deg: f32, elevation_deg: f32) -> Vec3 {
    let (sa, ca) = libm::sincosf(azimuth_deg.to_radians());
    let (se, ce) = libm::sincosf(elevation_deg.to_radians());
    Vec3::new(sa * ce, ca * ce, se)
}

/// Walls, ceiling and floor of a room, uneven.
fn interior(rng: &mut Rng, level: f32) -> Part {
    let mut tone = |low: f32, high: f32| {
        let tint = Vec3::new(rng.between(0.85, 1.15), rng.between(0.9, 1.05), rng.between(0.75, 1.1));
        tint * (level * rng.between(low, high))
    };
    let (wall, ceiling, floor) = (tone(0.6, 1.2), tone(0.9, 1.6), tone(0.25, 0.7));
    let lean = towards(azimuth(rng), 0.0) * 0.3;
    let shift = rng.between(0.0, 90.0);
    Box::new(move |d| {
        let uneven = 1.0 + 0.3 * clouds(d * 2.5 + shift) + d.dot(lean);
        floor.lerp(wall, step(-0.42, -0.3, d.z)).lerp(ceiling, step(0.6, 0.76, d.z)) * uneven.max(0.1)
    })
}

/// A lit rectangle in azimuth and elevation (degrees), with or without glazing bars.
fn pane(at: [f32; 2], half: [f32; 2], color: Vec3, bars: bool) -> Part {
    Box::new(move |d| {
        let azimuth = libm::atan2f(d.x, d.y).to_degrees() - at[0];
        let azimuth = azimuth - 360.0 * (azimuth / 360.0).round();
        let elevation = libm::asinf(d.z.clamp(-1.0, 1.0)).to_degrees() - at[1];
        let soft = |x: f32, half: f32| 1.0 - step(half - 2.0, half + 2.0, x.abs());
        let bar = if bars {
            0.2 + 0.8 * step(0.6, 2.6, azimuth.abs()) * step(0.6, 2.6, (elevation - 3.0).abs())
        } else {
            1.0
        };
        let height = 1.0 + 0.4 * (elevation / half[1]);
        color * (soft(azimuth, half[0]) * soft(elevation, half[1]) * bar * height)
    })
}

/// A round light of this width (standard deviation, degrees) that adds `power` to the mean over the sphere.
fn spot(at: Vec3, width_deg: f32, power: Vec3) -> Part {
    let width = width_deg.to_radians();
    // ∫ exp(−θ²/2σ²) dω ≈ 2πσ².
    let peak = power * (2.0 / (width * width));
    Box::new(move |d| {
        let angle = libm::acosf(d.dot(at).clamp(-1.0, 1.0));
        peak * libm::expf(-0.5 * angle * angle / (width * width))
    })
}
