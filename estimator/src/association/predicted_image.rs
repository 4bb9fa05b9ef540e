//! A keyframe's image as the lit colours predict it, and the image itself, at a chosen resolution. Both hold square roots of
//! linear light, whose photon noise is the same at every brightness.

use crate::association::context::AssociationContext;
use crate::association::image_filters::{ROWS, binomial, dilated, min_filtered, push_pull};
use crate::association::keyframe_image::KeyframeImage;
use crate::association::observations::RefinedView;
use crate::mesh::raster::{MISS, Raster, camera_positions, scaled};
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Intrinsics;

/// Pixels around an outline that take the depth of the surface in front: an outline moves with that surface.
const OUTLINE_DEPTH_PX: usize = 2;

/// A keyframe's image at a pyramid level, smoothed; arrays are `[height][width]`, NaN where clipped.
pub struct ImageLevel {
    /// Pinhole camera at this resolution.
    pub camera: Intrinsics,
    /// Square roots of linear RGB.
    pub color: Vec<Vec3>,
    linear: Vec<Vec3>,
}

impl ImageLevel {
    /// Averages, freed of vignetting, `1/level × 1/level` pixels into one (`level` 1, 1/2 or 1/4).
    pub fn new(image: &KeyframeImage, context: &AssociationContext, level: f64) -> Self {
        let camera = scaled(&image.camera, level);
        let step = (1.0 / level).round() as usize;
        let (w, h) = (camera.width as usize, camera.height as usize);
        let (fw, fh) = (image.camera.width as usize, image.camera.height as usize);
        let light = |bytes: [u8; 3]| {
            let clipped = bytes.iter().any(|&v| v >= context.clipped);
            if clipped { Vec3::NAN } else { Vec3::from_array(bytes.map(|v| context.table[v as usize])) }
        };
        let mut linear = vec![Vec3::NAN; w * h];
        let pixel = |x: usize, y: usize| {
            let mut sum = Vec3::ZERO;
            for dy in 0..step {
                for dx in 0..step {
                    sum += light(image.bytes(x * step + dx, y * step + dy));
                }
            }
            let middle = |x: usize| (x * step) as f64 + 0.5 * (step - 1) as f64;
            let shade = image.vignetting.shade(&image.camera, middle(x), middle(y));
            sum / ((step * step) as f32 * shade)
        };
        linear.par_chunks_mut(w).enumerate().take(fh / step).with_min_len(ROWS).for_each(|(y, row)| {
            row.iter_mut().enumerate().take(fw / step).for_each(|(x, light)| *light = pixel(x, y));
        });
        let mut color = binomial(&linear, w, h);
        roots(&mut color, w);
        Self { camera, color, linear }
    }

    /// Bilinear sample; NaN if a neighbour is clipped, `None` outside the image.
    pub fn sample(&self, u: f64, v: f64) -> Option<Vec3> {
        let (w, h) = (self.camera.width as usize, self.camera.height as usize);
        if !(u >= 0.0 && v >= 0.0 && u < (w - 1) as f64 && v < (h - 1) as f64) {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let i = y * w + x;
        let top = self.color[i] * (1.0 - fx) + self.color[i + 1] * fx;
        let bottom = self.color[i + w] * (1.0 - fx) + self.color[i + w + 1] * fx;
        Some(top * (1.0 - fy) + bottom * fy)
    }
}

/// The mesh with lit colours rendered into a keyframe; arrays are `[height][width]`.
pub struct PredictedImage {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pinhole camera.
    pub camera: Intrinsics,
    /// Square roots of linear RGB; NaN where not known.
    pub color: Vec<Vec3>,
    /// Smallest depth within `OUTLINE_DEPTH_PX` pixels; infinite far from the mesh.
    pub depth: Vec<f32>,
}

impl PredictedImage {
    /// Renders lit `colors`, `[vertex]`, with the pose and exposure of `view` at the resolution of `level`. Beyond the mesh's
    /// outline the keyframe's own background is continued, so that outlines have a contrast.
    /// A z-buffer that is known is used if it has this resolution.
    pub fn new(
        context: &AssociationContext,
        level: &ImageLevel,
        (colors, known): (&[Vec3], Option<&Raster>),
        view: &RefinedView,
    ) -> Self {
        let camera = level.camera;
        let (w, h) = (camera.width as usize, camera.height as usize);
        let points = camera_positions(context.mesh, &view.world_from_camera);
        let drawn: Raster;
        let raster = match known.filter(|known| known.camera == camera) {
            Some(known) => known,
            None => {
                drawn = Raster::new(&points, &context.mesh.triangles, &camera, context.near);
                &drawn
            }
        };
        let gain = Vec3::from_array(view.gain.map(|g| g as f32));
        let mut linear = background(level, raster, context.config.tuning.pose.outline_px as usize);
        linear.par_chunks_mut(w).enumerate().with_min_len(ROWS).for_each(|(y, row)| {
            for (x, light) in row.iter_mut().enumerate() {
                let t = raster.triangle[y * w + x];
                if t != MISS {
                    let corners = context.mesh.triangles[t as usize];
                    let weights = raster.weights(x, y, corners.map(|c| points[c as usize]));
                    let color = (0..3).map(|k| colors[corners[k] as usize] * weights[k]).sum::<Vec3>();
                    *light = color * gain;
                }
            }
        });
        // Smoothed once for the lens and the pixel's area, once because the keyframe's image was smoothed.
        let mut color = binomial(&binomial(&linear, w, h), w, h);
        roots(&mut color, w);
        let depth = min_filtered(&raster.depth, w, h, OUTLINE_DEPTH_PX);
        Self { width: w, height: h, camera, color, depth }
    }
}

/// Takes square roots.
fn roots(color: &mut [Vec3], w: usize) {
    color.par_chunks_mut(w * ROWS).flatten_iter().for_each(|c| *c = c.map(f32::sqrt));
}

/// The image beyond the mesh's outline and `outline_px` around it, continued over all pixels.
fn background(level: &ImageLevel, raster: &Raster, outline_px: usize) -> Vec<Vec3> {
    let (w, h) = (level.camera.width as usize, level.camera.height as usize);
    let hit: Vec<bool> = raster.triangle.iter().map(|&t| t != MISS).collect();
    let near = dilated(&hit, w, h, outline_px);
    let known = (0..w * h).map(|i| (!near[i] && !level.linear[i].is_nan()).then_some(level.linear[i]));
    push_pull(known, w, h)
}
