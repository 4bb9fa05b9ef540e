//! The light of a result in glTF's terms (EXT_lights_image_based): irradiance coefficients of its
//! harmonics, and a cube map of the light as it is completed.

use crate::export::glb::buffer::Buffer;
use crate::numerics::sh;
use crate::render::lighting::environment::Environment;
use glam::{DVec3, Vec3};
use recordings::result::Estimate;
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::io::Result;

/// Side of the first mip level of the cube map, in texels.
const CUBE_SIDE: u32 = 64;

/// The light of a result: irradiance coefficients (bands 0..2 of what a diffuse surface gets) and a cube map of the radiance
/// of `completed`, RGBD coded as the extension asks (alpha divides).
pub fn light(result: &Estimate, completed: &Environment, buffer: &mut Buffer) -> Result<(Vec<Value>, Value)> {
    let radiance = |d: DVec3| completed.radiance(DVec3::new(d.x, -d.z, d.y).as_vec3());
    // A texel is the mean of four: those of the next level, or of the light at twice the first one's resolution.
    let fine = 2 * CUBE_SIDE;
    let mut cube: Vec<Vec<Vec3>> = (0..6)
        .map(|face| (0..fine * fine).map(|i| radiance(cube_direction(face, i % fine, i / fine, fine))).collect())
        .collect();
    let levels = CUBE_SIDE.ilog2() + 1;
    let (mut images, mut mips) = (Vec::new(), Vec::new());
    for level in 0..levels {
        let side = CUBE_SIDE >> level;
        let mut faces = Vec::new();
        for face in &mut cube {
            *face = halved(face, side as usize);
            let pixels: Vec<u8> = face.iter().flat_map(|r| rgbd(r.as_dvec3().to_array())).collect();
            let bytes = crate::export::picture::encode_rgba(side, side, &pixels)?;
            let view = buffer.add(&bytes, None);
            images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
            faces.push(images.len() - 1);
        }
        mips.push(json!(faces));
    }
    let light = json!({
        "name": "recovered", "rotation": [0.0, 0.0, 0.0, 1.0], "intensity": 1.0,
        "irradianceCoefficients": irradiance_coefficients(result), "specularImageSize": CUBE_SIDE, "specularImages": mips,
    });
    Ok((images, light))
}

/// A square of twice the side at half its resolution.
fn halved(square: &[Vec3], side: usize) -> Vec<Vec3> {
    let at = |x: usize, y: usize| square[y * 2 * side + x];
    let mean = |x: usize, y: usize| (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) * 0.25;
    (0..side * side).map(|i| mean(2 * (i % side), 2 * (i / side))).collect()
}

/// Irradiance in glTF's axes, bands 0 to 2: coefficients `[9][rgb]`, by projection of the light as seen in our axes.
fn irradiance_coefficients(result: &Estimate) -> Vec<[f64; 3]> {
    let coefficient = |k: usize| result.light.coefficients.get(k).copied().unwrap_or([0.0; 3]);
    let mut irradiance = vec![[0.0f64; 3]; 9];
    let directions = sh::even_directions(4096);
    let rows: Vec<[f64; 3]> = (0..9)
        .map(|k| {
            let factor = sh::cosine_factor(sh::band(k)) * PI;
            coefficient(k).map(|c| c * factor)
        })
        .collect();
    for d in &directions {
        let ours = DVec3::new(d.x, -d.z, d.y);
        let value = sh::radiance(&rows, ours);
        let mut y = [0.0; 9];
        sh::eval(*d, &mut y);
        for (sum, y) in irradiance.iter_mut().zip(y) {
            *sum = std::array::from_fn(|c| sum[c] + value[c] * y * 4.0 * PI / directions.len() as f64);
        }
    }
    irradiance
}

/// Direction of a cube map's texel in OpenGL's order: +X −X +Y −Y +Z −Z.
fn cube_direction(face: usize, x: u32, y: u32, side: u32) -> DVec3 {
    let (s, t) =
        ((2.0 * f64::from(x) + 1.0) / f64::from(side) - 1.0, (2.0 * f64::from(y) + 1.0) / f64::from(side) - 1.0);
    match face {
        0 => DVec3::new(1.0, -t, -s),
        1 => DVec3::new(-1.0, -t, s),
        2 => DVec3::new(s, 1.0, t),
        3 => DVec3::new(s, -1.0, -t),
        4 => DVec3::new(s, -t, 1.0),
        _ => DVec3::new(-s, -t, -1.0),
    }
    .normalize()
}

/// Colour times alpha⁻¹: bright light is kept in 8 bits.
fn rgbd(color: [f64; 3]) -> [u8; 4] {
    let most = color.iter().fold(1.0f64, |m, c| m.max(*c)).min(255.0);
    let d = (255.0 / most).floor().clamp(1.0, 255.0);
    let byte = |c: f64| (c * d).round().clamp(0.0, 255.0) as u8;
    [byte(color[0]), byte(color[1]), byte(color[2]), d as u8]
}
