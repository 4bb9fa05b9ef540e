//! How well frames that no step used are predicted: the model re-rendered into their view.

use crate::picture::{Picture, linear_table};
use crate::raster::{MISS, Raster, camera_positions};
use crate::specular::{Gloss, Reflection};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::result::WitnessError;
use recordings::types::{Keyframe, Response};

/// Pixels of a frame that are looked at, along each side: every so manieth.
const STRIDE: usize = 2;

/// What is re-rendered.
#[derive(Clone, Copy)]
pub struct Model<'a> {
    /// Mesh, rays and light.
    pub reflection: Reflection<'a>,
    /// Lit colours.
    pub lit_color: &'a [Vec3],
    /// Weight behind them; 0 = never seen.
    pub lit_weight: &'a [f32],
    /// Albedo × irradiance.
    pub diffuse: &'a [Vec3],
    /// Segment of every vertex.
    pub segment: &'a [u32],
    /// Specular weights per segment.
    pub gloss: &'a [Gloss],
}

/// One pixel: the picture's linear colour, the lit colour, the model's colour.
type Triple = [[f64; 3]; 3];

/// PSNR of one witness frame; `None` if its picture cannot be read.
#[must_use]
pub fn compare(model: &Model, frame: &Keyframe, response: &Response) -> Option<WitnessError> {
    let picture = Picture::new(&frame.color, &frame.camera)?;
    let table = linear_table(response);
    let mesh = model.reflection.mesh;
    let points = camera_positions(mesh, &frame.world_from_camera);
    let near = f64::from(model.reflection.scene.median_edge()) * 0.1;
    let raster = Raster::new(&points, &mesh.triangles, &picture.camera, near);
    let camera = frame.world_from_camera.translation;
    let (width, height) = (picture.camera.width as usize, picture.camera.height as usize);
    let rows: Vec<usize> = (0..height).step_by(STRIDE).collect();
    let pixels: Vec<Triple> = rows
        .par_iter()
        .flat_map_iter(|&y| (0..width).step_by(STRIDE).map(move |x| (x, y)))
        .filter_map(|(x, y)| {
            let triangle = raster.triangle[y * width + x];
            if triangle == MISS {
                return None;
            }
            let corners = mesh.triangles[triangle as usize];
            let weights = raster.weights(x, y, corners.map(|i| points[i as usize]));
            let seen = picture.bytes(x, y).map(|b| f64::from(table[b as usize]));
            shade(model, corners, weights, camera).map(|[lit, modelled]| [seen, lit, modelled])
        })
        .collect();
    let looked_at = rows.len() * width.div_ceil(STRIDE);
    Some(WitnessError {
        name: frame.name.clone(),
        lit_psnr_db: psnr(&pixels, 1),
        model_psnr_db: psnr(&pixels, 2),
        coverage: if looked_at > 0 { pixels.len() as f64 / looked_at as f64 } else { 0.0 },
    })
}

/// Lit colour and model colour of a surface point; `None` where a corner was never seen.
fn shade(model: &Model, corners: [u32; 3], weights: [f32; 3], camera: DVec3) -> Option<[[f64; 3]; 2]> {
    if corners.iter().any(|&i| model.lit_weight[i as usize] <= 0.0) {
        return None;
    }
    let mix = |values: &[Vec3]| corners.iter().zip(weights).map(|(&i, w)| values[i as usize] * w).sum::<Vec3>();
    let lit = mix(model.lit_color).to_array().map(f64::from);
    let mut modelled = mix(model.diffuse).to_array().map(f64::from);
    let (w_d, w_s) = corners.iter().zip(weights).fold((0.0, 0.0), |(d, s), (&i, w)| {
        let gloss = model.gloss[model.segment[i as usize] as usize];
        let (w_d, w_s) = if gloss.significant { (gloss.w_d, gloss.w_s) } else { (1.0, 0.0) };
        (d + w_d * f64::from(w), s + w_s * f64::from(w))
    });
    if w_s > 0.0 {
        let position = mix(&model.reflection.mesh.positions);
        let normal = mix(&model.reflection.mesh.normals).normalize_or_zero();
        let to_camera = (camera - position.as_dvec3()).normalize_or(DVec3::Z).as_vec3();
        let mirror = model.reflection.at(position, normal, to_camera).unwrap_or([0.0; 3]);
        for c in 0..3 {
            modelled[c] = w_d * modelled[c] + w_s * mirror[c]; // Eq. (13)
        }
    }
    Some([lit, modelled])
}

/// PSNR in 8-bit sRGB after one fitted exposure gain per channel.
fn psnr(pixels: &[Triple], which: usize) -> f64 {
    if pixels.is_empty() {
        return 0.0;
    }
    let gain = [0, 1, 2].map(|c| {
        let mut ratios: Vec<f64> = pixels
            .iter()
            .filter(|p| p[which][c] > 1e-6 && p[0][c] > 0.004 && p[0][c] < 0.95)
            .map(|p| p[0][c] / p[which][c])
            .collect();
        let middle = ratios.len() / 2;
        if ratios.is_empty() { 1.0 } else { *ratios.select_nth_unstable_by(middle, f64::total_cmp).1 }
    });
    let square: f64 =
        pixels.iter().flat_map(|p| [0, 1, 2].map(|c| (srgb(gain[c] * p[which][c]) - srgb(p[0][c])).powi(2))).sum();
    let mean = square / (3 * pixels.len()) as f64;
    // A rounding error of half a level is the most that 8 bits can tell.
    -10.0 * libm::log10(mean.max(1.0 / (12.0 * 255.0 * 255.0)))
}

fn srgb(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055 }
}
