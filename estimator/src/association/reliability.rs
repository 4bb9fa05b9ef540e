//! How far lit colours can be trusted beside brighter surface: windows, lens and errors of poses put light of it into them. Few dark
//! vertices hold much of it, and what they tell of light is that there are no shadows.

use crate::association::context::AssociationContext;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::light_field::LightField;
use crate::association::lit_color::LitColors;
use crate::association::observations::RefinedView;
use crate::association::sharpening::BLURRED;
use crate::mesh::graph::Graph;
use crate::numerics::robust::median;
use rayon::prelude::*;

/// Relative standard deviation of a lit colour among others like it.
const ERROR: f32 = 0.07;
/// Standard deviation of the surroundings that a lit colour is compared with, in pixels.
const AROUND_PX: f64 = 2.0;
/// Turns at most: a mesh that is far finer than the pictures costs no more.
const MOST_TURNS: f64 = 16.0;
/// Observations that tell how large the mesh's edges are in the pictures.
const OBSERVATIONS: usize = 4000;

/// Share of its weight that a lit colour keeps, 0 to 1: ε² / (ε² + β² x²), where the surface around is brighter by x of it, ε is its
/// error among others like it, and β the share of a difference from its surroundings that blur takes: `[vertex]`. The surroundings are
/// means of neighbours taken in `turns`.
#[must_use]
pub fn reliability(lit: &LitColors, graph: &Graph, turns: usize) -> Vec<f32> {
    let own: Vec<f32> = lit.color.iter().map(|c| c.element_sum()).collect();
    let mut around = own.clone();
    for _ in 0..turns {
        let mean = |i: usize| {
            let seen = graph.neighbours(i).iter().map(|k| *k as usize).filter(|k| lit.weight[*k] > 0.0);
            let (sum, count) = seen.fold((0.0, 0.0), |(s, n), k| (s + around[k], n + 1.0));
            if count > 0.0 { sum / count } else { around[i] }
        };
        around = (0..own.len()).into_par_iter().map(mean).collect();
    }
    let share = |(own, around): (&f32, &f32)| {
        let (least, error) = (ERROR * own, BLURRED * (around - own).max(0.0));
        if least > 0.0 { least * least / (least * least + error * error) } else { 1.0 }
    };
    own.iter().zip(&around).map(share).collect()
}

/// Turns of [`reliability`] that reach as far in the pictures as a lit colour's surroundings: a mean of neighbours at distance d has a
/// variance of d²/2 along each axis, and means in turn have theirs added up.
#[must_use]
pub fn turns(
    context: &AssociationContext,
    images: &[Option<KeyframeImage>],
    field: &LightField,
    views: &[RefinedView],
) -> usize {
    let stride = field.observations.len().div_ceil(OBSERVATIONS).max(1);
    let edge_px = field.observations.iter().step_by(stride).filter_map(|o| {
        let (i, k) = (o.vertex as usize, o.keyframe as usize);
        let camera = &images[k].as_ref()?.camera;
        let distance = views[k].world_from_camera.translation.distance(context.mesh.positions[i].as_dvec3());
        Some(f64::from(context.spacing[i]) * camera.focal() / distance)
    });
    let edge = median(edge_px).unwrap_or(1.0);
    (2.0 * (AROUND_PX / edge).powi(2)).round().clamp(1.0, MOST_TURNS) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn what_is_dark_beside_what_is_bright_hardly_counts() {
        // A strip of triangles: three dark vertices, three bright ones, and one that was not seen.
        let graph = Graph::new(7, &[[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5, 6]]);
        let color = [0.1, 0.1, 0.1, 0.5, 0.5, 0.5, 9.0].map(Vec3::splat).to_vec();
        let lit = LitColors { color, weight: vec![2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 0.0], used: Vec::new() };
        let share = reliability(&lit, &graph, 1);
        assert!(share[0] == 1.0 && share[3] == 1.0 && share[5] == 1.0, "{share:?}");
        // Half of vertex 2's neighbours are five times as bright: x = 2, β x = 0.5.
        assert!((share[2] - 0.0049 / (0.0049 + 0.25)).abs() < 1e-6 && share[1] < 0.2, "{share:?}");
        assert!(reliability(&lit, &graph, 2)[0] < 0.5, "the second turn reaches the first vertex");
    }

    #[test]
    fn the_exposure_does_not_matter() {
        let graph = Graph::new(3, &[[0, 1, 2]]);
        let of = |scale: f32| {
            let color = [0.1, 0.2, 0.3].map(|c| Vec3::splat(scale * c)).to_vec();
            reliability(&LitColors { color, weight: vec![1.0; 3], used: Vec::new() }, &graph, 1)
        };
        assert!(of(1.0).iter().zip(of(1e-4)).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", of(1.0));
    }
}
