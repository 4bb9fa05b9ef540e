//! Samples of a keyframe's image at the vertices that it may observe.

use crate::association::context::AssociationContext;
use crate::association::eligibility::{EligibilityRules, ProjectedVertex};
use crate::association::keyframe_image::KeyframeImage;
use crate::association::observations::Observation;
use crate::mesh::raster::{Raster, camera_positions};
use crate::numerics::rotation::rotate;
use glam::Vec3;
use recordings::types::Pose;

/// Half width of the sampling window in vertex spacings, foreshortened by at least [`MIN_FORESHORTENING`].
const WINDOW_SPACINGS: f32 = 0.75;
const MIN_FORESHORTENING: f32 = 0.3;
/// Smallest and largest half width of the sampling window in pixels.
const WINDOW_PX: (f32, f32) = (1.0, 4.0);
/// Independent pixels at which a sample has half its weight.
const HALF_WEIGHT_PIXELS: f32 = 4.0;

/// The observations of one keyframe before exposure, ascending by vertex.
#[derive(Default)]
pub struct KeyframeObservations {
    /// Eligible and unclipped.
    pub good: Vec<Observation>,
    /// Clipped, or eligible as a last resort only: for vertices without good observations.
    pub poor: Vec<Observation>,
}

/// All observations of one keyframe (Eqs. 3 and 4), and its z-buffer; `last_resort` adds poor ones.
pub fn observe(
    context: &AssociationContext,
    image: &KeyframeImage,
    pose: &Pose,
    keyframe: u16,
    rules: &EligibilityRules,
    last_resort: Option<EligibilityRules>,
) -> (KeyframeObservations, Raster) {
    let mesh = context.mesh;
    let k = &image.camera;
    let points = camera_positions(mesh, pose);
    let raster = Raster::new(&points, &mesh.triangles, k, context.near);
    let camera_from_world = pose.rotation.conjugate().as_quat();
    let focal = k.focal();
    let poor_weight = context.config.tuning.association.poor_weight as f32;
    let mut out = KeyframeObservations::default();
    for (i, p) in points.iter().enumerate() {
        if !(p.z > context.near && p.is_finite()) {
            continue;
        }
        let (u, v) = k.project(*p);
        if !(u > 0.0 && v > 0.0 && u < f64::from(k.width) && v < f64::from(k.height)) {
            continue;
        }
        let normal = rotate(camera_from_world, mesh.normals[i]);
        let cosine = -normal.dot(p.as_vec3().normalize_or_zero());
        let footprint = (p.z / focal) as f32;
        let spacing = context.spacing[i];
        let vertex = ProjectedVertex { u, v, point: p.as_vec3(), normal, footprint, cosine, spacing };
        let is_eligible = |rules: &EligibilityRules| vertex.is_eligible(context, &raster, &camera_from_world, rules);
        let eligible = is_eligible(rules);
        if !eligible && !last_resort.is_some_and(|r| is_eligible(&r)) {
            continue;
        }
        // The window covers the vertex's own surface, foreshortened.
        let spacing_px = spacing / footprint;
        let radius = (WINDOW_SPACINGS * spacing_px * cosine.max(MIN_FORESHORTENING)).clamp(WINDOW_PX.0, WINDOW_PX.1);
        let Some(sample) = image.sample(&context.table, u, v, f64::from(radius)) else {
            continue;
        };
        // At few pixels per vertex the sample includes its neighbours.
        let resolution = (spacing_px * cosine).min(1.0);
        let angle = (cosine - 0.5 * rules.min_cosine).max(0.1 * cosine) / (1.0 - 0.5 * rules.min_cosine);
        let pixels = sample.pixels / (sample.pixels + HALF_WEIGHT_PIXELS);
        let clipped = sample.brightest >= context.clipped;
        let good = eligible && !clipped;
        let weight = angle * resolution * pixels * if good { 1.0 } else { poor_weight };
        let observation = Observation { vertex: i as u32, keyframe, color: sample.color, weight, clipped };
        if good { out.good.push(observation) } else { out.poor.push(observation) }
    }
    (out, raster)
}

/// Linear colours and weights, `[vertex]`, from a single image; weight 0 for vertices that it does not show.
#[must_use]
pub fn colors_of_image(context: &AssociationContext, image: &KeyframeImage, pose: &Pose) -> (Vec<Vec3>, Vec<f32>) {
    let rules = EligibilityRules::new(context.config, 1.0);
    let (observed, _) = observe(context, image, pose, 0, &rules, Some(rules.last_resort()));
    let mut colors = vec![Vec3::ZERO; context.mesh.positions.len()];
    let mut weights = vec![0.0; colors.len()];
    for o in observed.poor.iter().chain(&observed.good) {
        colors[o.vertex as usize] = Vec3::from_array(o.color);
        weights[o.vertex as usize] = o.weight;
    }
    (colors, weights)
}
