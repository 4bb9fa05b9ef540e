//! Materials: segments that touch and have similar albedos, separated by a crease or a shadow only, share their gloss.

use crate::mesh::graph::Graph;
use crate::numerics::cielab::lab;
use crate::specular::gloss::Gloss;
use firmware_config::tuning::SpecularTuning;
use glam::Vec3;
use recordings::types::Mesh;

/// Weights pooled over the segments of each material, by their standard errors. `segment` is `[vertex]`, `albedo`
/// `[segment][channel]`, `gloss` and the result `[segment]`.
#[must_use]
pub fn pooled(
    mesh: &Mesh,
    segment: &[u32],
    albedo: &[[f64; 3]],
    gloss: &[Gloss],
    tuning: &SpecularTuning,
) -> Vec<Gloss> {
    let material = materials(mesh, segment, albedo, tuning.similar_albedo as f32);
    let known = |g: &Gloss| g.error.is_finite() && g.error > 0.0;
    let mut sums = vec![[0.0f64; 2]; gloss.len()];
    let mut best: Vec<Option<Gloss>> = vec![None; gloss.len()];
    for (g, &m) in gloss.iter().zip(&material).filter(|(g, _)| known(g)) {
        let precision = 1.0 / (g.error * g.error);
        sums[m][0] += precision;
        sums[m][1] += precision * g.w_s;
        if best[m].is_none_or(|b| g.error < b.error) {
            best[m] = Some(*g);
        }
    }
    let pool = |(g, &m): (&Gloss, &usize)| match best[m] {
        Some(best) if known(g) && best.error == g.error => *g,
        Some(best) => {
            let (w_s, error) = (sums[m][1] / sums[m][0], 1.0 / libm::sqrt(sums[m][0]));
            let significant = best.significant && w_s > tuning.min_significance * error;
            Gloss { w_d: if significant { best.w_d } else { 1.0 }, w_s, error, significant, ..best }
        }
        None => *g,
    };
    gloss.iter().zip(&material).map(pool).collect()
}

/// The material of every segment, named by its lowest segment: `[segment]`. Albedos closer than `similar` (CIELAB) match.
fn materials(mesh: &Mesh, segment: &[u32], albedo: &[[f64; 3]], similar: f32) -> Vec<usize> {
    let labs: Vec<Vec3> = albedo.iter().map(|a| lab(Vec3::from_array(a.map(|x| x as f32)).max(Vec3::ZERO))).collect();
    let graph = Graph::of(mesh);
    let mut touching: Vec<[u32; 2]> = (0..graph.vertices())
        .flat_map(|i| graph.neighbours(i).iter().map(move |&j| [segment[i], segment[j as usize]]))
        .filter(|[a, b]| a < b)
        .collect();
    touching.sort_unstable();
    touching.dedup();
    let mut material: Vec<usize> = (0..albedo.len()).collect();
    for [a, b] in touching {
        let (a, b) = (a as usize, b as usize);
        if labs[a].distance(labs[b]) < similar {
            let (low, high) = (material[a].min(material[b]), material[a].max(material[b]));
            material.iter_mut().filter(|m| **m == high).for_each(|m| *m = low);
        }
    }
    material
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of four segments: two of one white, a red one, and a white one that touches only the red.
    #[test]
    fn touching_segments_of_similar_albedo_share_their_gloss() {
        let mut mesh = Mesh::default();
        for i in 0..16_u32 {
            mesh.positions.push(Vec3::new((i / 2) as f32, (i % 2) as f32, 0.0));
            mesh.normals.push(Vec3::Z);
            if i < 14 {
                mesh.triangles.push([i, i + 1, i + 2]);
            }
        }
        let segment: Vec<u32> = (0..16).map(|i| i / 4).collect();
        let albedo = [[0.7, 0.7, 0.7], [0.68, 0.7, 0.72], [0.5, 0.1, 0.1], [0.7, 0.7, 0.7]];
        let fitted = |w_s, error, significant| Gloss { w_s, error, significant, ..Gloss::NONE };
        let gloss =
            [fitted(0.05, 0.001, true), fitted(0.0, 0.01, false), fitted(0.0, 0.01, false), fitted(0.0, 0.01, false)];
        let pooled = pooled(&mesh, &segment, &albedo, &gloss, &SpecularTuning::default());
        assert_eq!(pooled[0], gloss[0], "the best evidence stands");
        assert!(pooled[1].significant && (pooled[1].w_s - 0.0495).abs() < 1e-3, "{:?}", pooled[1]);
        assert!(!pooled[2].significant && !pooled[3].significant, "{pooled:?}");
    }
}
