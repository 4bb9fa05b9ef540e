//! A grey, a silver and a mirror ball in the recovered light, seen as the keyframe sees: light at a glance. They stand in
//! the middle of the scene, where lamps shine on them.

use crate::numerics::rotation::rotate;
use crate::numerics::sh;
use crate::preview::keyframe_view::Panel;
use crate::preview::lamps::SeenLamp;
use crate::render::lighting::environment::Environment;
use crate::render::objects::material::Brdf;
use crate::render::sampling::{ggx_normal, point, smith};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::types::Pose;
use std::f32::consts::PI;

/// Albedo of the grey ball.
const GREY: f64 = 0.5;
/// GGX width of the silver ball.
const SILVER_ALPHA: f32 = 0.3;
/// Rays for its reflection.
const SILVER_RAYS: u32 = 256;
/// Bands of light that a diffuse surface responds to.
const DIFFUSE_BANDS: usize = 9;

/// The three balls side by side in a panel of `width` × `height`; `display` turns radiance into display values.
pub fn panel(
    (environment, lamps): (&Environment, &[SeenLamp]),
    world_from_camera: &Pose,
    (width, height): (u32, u32),
    display: impl Fn(Vec3) -> [f32; 3] + Sync,
) -> Panel {
    let coefficients = environment.project(DIFFUSE_BANDS);
    // Eq. (8) without a scene: irradiance over π.
    let soft: Vec<[f64; 3]> =
        coefficients.iter().enumerate().map(|(k, c)| c.map(|x| x * GREY * sh::cosine_factor(sh::band(k)))).collect();
    let radius = (width as f32 / 6.0).min(height as f32 / 2.0) * 0.92;
    let turn = world_from_camera.rotation.as_quat();
    let forward = rotate(turn, Vec3::Z);
    let pixels = (0..width * height).into_par_iter().map(|i| {
        let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let ball = (x * 3.0 / width as f32) as u32;
        let (dx, dy) = ((x - (ball as f32 + 0.5) * width as f32 / 3.0) / radius, (y - height as f32 / 2.0) / radius);
        let inside = 1.0 - dx * dx - dy * dy;
        if inside <= 0.0 {
            return ([0.0; 3], 0.0);
        }
        let normal = rotate(turn, Vec3::new(dx, dy, -inside.sqrt()));
        let shine = |of: &dyn Fn(&SeenLamp) -> Vec3| lamps.iter().map(of).sum::<Vec3>();
        let radiance = match ball {
            0 => {
                let far = Vec3::from(sh::radiance(&soft, DVec3::from(normal)).map(|c| c.max(0.0) as f32));
                far + shine(&|l| l.flux() * (GREY as f32 / PI * normal.dot(l.direction).max(0.0)))
            }
            1 => {
                let lobe = Brdf { diffuse: Vec3::ZERO, f0: Vec3::ONE, f90: 1.0, alpha: SILVER_ALPHA };
                silver(environment, normal, forward, i)
                    + shine(&|l| l.flux() * lobe.lobe(normal, -forward, l.direction))
            }
            _ => {
                let mirrored = (forward - normal * (2.0 * normal.dot(forward))).normalize();
                let lamp = lamps.iter().find(|l| l.angle(mirrored) < l.radius_rad);
                lamp.map_or_else(|| environment.radiance(mirrored), |l| l.radiance)
            }
        };
        (display(radiance), 1.0)
    });
    Panel { width, height, pixels: pixels.collect() }
}

/// Reflection of a rough metal of reflectance 1: GGX normals, Smith's masking.
fn silver(environment: &Environment, normal: Vec3, forward: Vec3, seed: u32) -> Vec3 {
    let view = -forward;
    let mut sum = Vec3::ZERO;
    for ray in 0..SILVER_RAYS {
        let m = ggx_normal(normal, SILVER_ALPHA, point(ray, seed));
        let vm = view.dot(m);
        let out = m * (2.0 * vm) - view;
        let (nv, no) = (normal.dot(view).max(1e-3), normal.dot(out));
        if no > 0.0 && vm > 0.0 {
            let weight = smith(nv, SILVER_ALPHA) * smith(no, SILVER_ALPHA) * vm / (nv * normal.dot(m).max(1e-3));
            sum += environment.radiance(out.normalize()) * weight;
        }
    }
    sum / SILVER_RAYS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn in_even_light_a_mirror_vanishes_and_grey_is_half_as_bright() {
        let even = Environment::from_fn(|_| Vec3::ONE);
        let pose = Pose::new(DQuat::IDENTITY, DVec3::ZERO);
        let panel = panel((&even, &[]), &pose, (90, 30), |v| v.to_array());
        let middle = |ball: usize| panel.pixels[15 * 90 + 15 + 30 * ball].0[1];
        assert!((middle(0) - 0.5).abs() < 0.01 && (middle(2) - 1.0).abs() < 1e-3, "{} {}", middle(0), middle(2));
        // Rough metal loses what masking takes: single scattering at α = 0.3 returns 0.88.
        assert!(middle(1) > 0.8 && middle(1) < 0.95, "{}", middle(1));
        assert_eq!(panel.pixels[0].1, 0.0);
    }
}
