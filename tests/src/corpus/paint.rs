//! Materials and what bodies are painted with.

use crate::synth::material::Material;
use crate::synth::random::Rng;
use crate::synth::texture::{check, clouds, mottled, oak, step};
use glam::{Vec2, Vec3};

/// A material of the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pigment {
    /// Mean base colour, linear RGB.
    pub color: Vec3,
    /// How it reflects.
    pub material: Material,
    /// Its pattern.
    pub pattern: Pattern,
}

/// What varies within a material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pattern {
    /// A little mottled, at most.
    Plain(f32),
    /// A print in a second colour with features of this size, metres.
    Print(Vec3, f32),
    /// A woven check with a second colour and this pitch, metres.
    Check(Vec3, f32),
    /// Planks.
    Wood,
}

/// Least and largest base colour of a channel.
const RANGE: [f32; 2] = [0.008, 0.95];

impl Pigment {
    /// A matte, nearly plain one.
    #[must_use]
    pub fn plain(color: Vec3) -> Self {
        Self { color, material: Material::MATTE, pattern: Pattern::Plain(0.02) }
    }

    /// Any: dark to white, plain to printed, matte to glossy.
    #[must_use]
    pub fn random(rng: &mut Rng) -> Self {
        let color = color(rng);
        let material = if rng.chance(0.35) {
            Material::glossy(rng.between(0.03, 0.13), rng.between(0.10, 0.35))
        } else {
            Material::MATTE
        };
        let pattern = match rng.below(8) {
            0 => Pattern::Print(other(rng, color), rng.between(0.008, 0.03)),
            1 => Pattern::Check(other(rng, color), rng.between(0.012, 0.03)),
            2 | 3 => Pattern::Plain(rng.between(0.08, 0.2)),
            _ => Pattern::Plain(rng.between(0.0, 0.05)),
        };
        Self { color, material, pattern }
    }

    /// Base colour at a position.
    #[must_use]
    pub fn at(&self, p: Vec3) -> Vec3 {
        let color = match self.pattern {
            Pattern::Plain(share) => mottled(self.color, p, 0.04, share),
            Pattern::Print(second, size) => {
                let blots = step(-0.08, 0.08, clouds(p / size) - 0.05);
                let fine = step(-0.1, 0.1, clouds(p / (0.45 * size) + 31.0) - 0.2);
                self.color.lerp(second, blots) * (1.0 - 0.35 * fine)
            }
            Pattern::Check(second, pitch) => {
                check(Vec2::new(p.x + 0.37 * p.z, p.y - 0.61 * p.z), pitch, self.color, second)
            }
            Pattern::Wood => oak(p) * (self.color / Vec3::new(0.43, 0.26, 0.13)),
        };
        color.clamp(Vec3::splat(RANGE[0]), Vec3::splat(RANGE[1]))
    }
}

/// From black velvet to white plaster, grey to saturated.
fn color(rng: &mut Rng) -> Vec3 {
    let value = match rng.below(10) {
        0 => rng.between(0.012, 0.04),
        1 => rng.between(0.80, 0.95),
        2 => rng.between(0.04, 0.12),
        _ => rng.between(0.15, 0.75),
    };
    let saturation = if rng.chance(0.3) { rng.between(0.0, 0.1) } else { rng.between(0.15, 0.85) };
    hue(rng.uniform(), saturation) * value
}

/// A colour with maximum 1.
fn hue(angle: f32, saturation: f32) -> Vec3 {
    let wave = |shift: f32| ((6.0 * (angle + shift)).rem_euclid(6.0) - 3.0).abs() - 1.0;
    let full = Vec3::new(wave(0.0), wave(2.0 / 3.0), wave(1.0 / 3.0)).clamp(Vec3::ZERO, Vec3::ONE);
    Vec3::ONE.lerp(full, saturation)
}

/// A colour clearly lighter or darker than one given, or of another hue.
fn other(rng: &mut Rng, than: Vec3) -> Vec3 {
    for _ in 0..20 {
        let found = color(rng);
        let ratio = (found + 0.02) / (than + 0.02);
        if ratio.max_element() > 1.8 || ratio.min_element() < 0.55 {
            return found;
        }
    }
    Vec3::splat(if than.max_element() > 0.4 { 0.1 } else { 0.7 })
}

/// Cloth, wood, plastic: what a table, board or floor is made of.
#[must_use]
pub fn ground(rng: &mut Rng) -> Pigment {
    match rng.below(6) {
        0 | 1 => {
            let tone = rng.between(0.5, 1.2);
            let material = if rng.chance(0.5) {
                Material::glossy(rng.between(0.02, 0.06), rng.between(0.15, 0.3))
            } else {
                Material::MATTE
            };
            Pigment { color: Vec3::new(0.43, 0.26, 0.13) * tone, material, pattern: Pattern::Wood }
        }
        2 => {
            let first = color(rng);
            Pigment {
                color: first,
                material: Material::MATTE,
                pattern: Pattern::Check(other(rng, first), rng.between(0.02, 0.05)),
            }
        }
        3 => Pigment::plain(Vec3::splat(rng.between(0.012, 0.03))),
        _ => Pigment { pattern: Pattern::Plain(rng.between(0.0, 0.08)), ..Pigment::random(rng) },
    }
}

/// A wall: white to mid, hardly coloured.
#[must_use]
pub fn wall(rng: &mut Rng) -> Pigment {
    let value = if rng.chance(0.4) { rng.between(0.80, 0.95) } else { rng.between(0.35, 0.8) };
    let tint = hue(rng.uniform(), rng.between(0.0, 0.25));
    Pigment { color: tint * value, material: Material::MATTE, pattern: Pattern::Plain(rng.between(0.0, 0.04)) }
}

/// A border between two paints: signed, wavy, about a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Border {
    /// A point of the plane, metres.
    pub through: Vec3,
    /// Its normal.
    pub normal: Vec3,
    /// Size of the waves, metres.
    pub wave: f32,
}

impl Border {
    /// True on the side of the second paint.
    #[must_use]
    pub fn beyond(&self, p: Vec3) -> bool {
        (p - self.through).dot(self.normal) + 0.6 * self.wave * clouds(p / (2.5 * self.wave)) > 0.0
    }
}
