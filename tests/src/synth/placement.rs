//! Solids in their own frames, placed in a scene.

use super::material::Material;
use super::scene::{Part, Texture};
use super::solid::{self, Solid};
use glam::{Quat, Vec3};

/// Pose of a solid in the scene: `turn` about its origin, then a shift to `at`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) at: Vec3,
    pub(super) turn: Quat,
}

impl Place {
    pub(super) fn new(x: f32, y: f32, z: f32, yaw_deg: f32) -> Self {
        Self { at: Vec3::new(x, y, z), turn: Quat::from_rotation_z(yaw_deg.to_radians()) }
    }

    pub(super) fn tilted(self, about: Vec3, deg: f32) -> Self {
        Self { turn: self.turn * Quat::from_axis_angle(about.normalize(), deg.to_radians()), ..self }
    }

    pub(super) fn local(self, p: Vec3) -> Vec3 {
        self.turn.inverse() * (p - self.at)
    }
}

/// The part that a solid of its own frame becomes: meshed within `reach` metres of its place with cells of `cell` metres.
pub(super) fn part(
    name: &'static str,
    material: Material,
    place: Place,
    reach: f32,
    cell: f32,
    solid: Solid,
    color: impl Fn(Vec3) -> Vec3 + Send + Sync + 'static,
) -> Part {
    let mesh = solid::mesh(&|p| solid(place.local(p)), place.at - reach, place.at + reach, cell);
    let texture: Texture = Box::new(move |p| color(place.local(p)).clamp(Vec3::splat(0.01), Vec3::splat(0.95)));
    Part { name, material, texture, mesh }
}
