//! Materials: segments that touch and have similar albedos, separated by a crease or a shadow only, share their gloss, unless
//! their own contradict each other.

use crate::mesh::graph::Graph;
use crate::numerics::cielab::lab;
use crate::specular::gloss::Gloss;
use firmware_config::tuning::SpecularTuning;
use glam::Vec3;

/// Weights pooled over the segments of each material, by their standard errors. `segment` is `[vertex]`, `albedo`
/// `[segment][channel]`, `gloss` and the result `[segment]`.
#[must_use]
pub fn pooled(
    graph: &Graph,
    segment: &[u32],
    albedo: &[[f64; 3]],
    gloss: &[Gloss],
    tuning: &SpecularTuning,
) -> Vec<Gloss> {
    let mut material: Vec<usize> = (0..gloss.len()).collect();
    let mut pools: Vec<Pool> = gloss.iter().map(Pool::of).collect();
    for [a, b] in touching(graph, segment, albedo, tuning.similar_albedo as f32) {
        let (low, high) = (material[a].min(material[b]), material[a].max(material[b]));
        if low < high && pools[low].agrees(&pools[high], tuning.min_significance) {
            material.iter_mut().filter(|m| **m == high).for_each(|m| *m = low);
            pools[low] = pools[low].and(&pools[high]);
        }
    }
    let pooled = |(g, &m): (&Gloss, &usize)| match pools[m].best {
        Some(best) if is_known(g) && best.error == g.error => *g,
        Some(best) => {
            let (w_s, error) = (pools[m].mean(), pools[m].error());
            let significant = best.significant && w_s > tuning.min_significance * error;
            Gloss { w_d: if significant { best.w_d } else { 1.0 }, w_s, error, significant, ..best }
        }
        None => *g,
    };
    gloss.iter().zip(&material).map(pooled).collect()
}

fn is_known(gloss: &Gloss) -> bool {
    gloss.error.is_finite() && gloss.error > 0.0
}

/// The specular weights of the segments of one material.
#[derive(Clone, Copy)]
struct Pool {
    /// Sum of 1 / error².
    precision: f64,
    /// Sum of w_s / error².
    weighted: f64,
    /// The one with the least error; `None` if no weight is known.
    best: Option<Gloss>,
}

impl Pool {
    fn of(gloss: &Gloss) -> Self {
        let precision = if is_known(gloss) { 1.0 / (gloss.error * gloss.error) } else { 0.0 };
        Self { precision, weighted: precision * gloss.w_s, best: is_known(gloss).then_some(*gloss) }
    }

    fn mean(&self) -> f64 {
        self.weighted / self.precision
    }

    fn error(&self) -> f64 {
        1.0 / libm::sqrt(self.precision)
    }

    /// False if the weights contradict each other: more than `significance` standard errors lie between them.
    fn agrees(&self, other: &Self, significance: f64) -> bool {
        let known = self.best.is_some() && other.best.is_some();
        !known || (self.mean() - other.mean()).abs() <= significance * libm::hypot(self.error(), other.error())
    }

    fn and(&self, other: &Self) -> Self {
        let best = match (self.best, other.best) {
            (Some(a), Some(b)) => Some(if b.error < a.error { b } else { a }),
            (a, b) => a.or(b),
        };
        Self { precision: self.precision + other.precision, weighted: self.weighted + other.weighted, best }
    }
}

/// Pairs of segments that touch and whose albedos are closer than `similar` (CIELAB).
fn touching(graph: &Graph, segment: &[u32], albedo: &[[f64; 3]], similar: f32) -> Vec<[usize; 2]> {
    let labs: Vec<Vec3> = albedo.iter().map(|a| lab(Vec3::from_array(a.map(|x| x as f32)).max(Vec3::ZERO))).collect();
    let mut touching: Vec<[usize; 2]> = (0..graph.vertices())
        .flat_map(|i| graph.neighbours(i).iter().map(move |&j| [segment[i], segment[j as usize]].map(|s| s as usize)))
        .filter(|&[a, b]| a < b && labs[a].distance(labs[b]) < similar)
        .collect();
    touching.sort_unstable();
    touching.dedup();
    touching
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::types::Mesh;

    /// A strip of four segments: two of one white, a red one, and a white one that touches only the red.
    fn pooled_on_a_strip(gloss: [Gloss; 4]) -> Vec<Gloss> {
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
        pooled(&Graph::of(&mesh), &segment, &albedo, &gloss, &SpecularTuning::default())
    }

    fn fitted(w_s: f64, error: f64, significant: bool) -> Gloss {
        Gloss { w_s, error, significant, ..Gloss::NONE }
    }

    #[test]
    fn touching_segments_of_similar_albedo_share_their_gloss() {
        let unsure = fitted(0.0, 0.02, false);
        let gloss = [fitted(0.05, 0.001, true), unsure, unsure, unsure];
        let pooled = pooled_on_a_strip(gloss);
        assert_eq!(pooled[0], gloss[0], "the best evidence stands");
        assert!(pooled[1].significant && (pooled[1].w_s - 0.0499).abs() < 1e-4, "{:?}", pooled[1]);
        assert!(!pooled[2].significant && !pooled[3].significant, "{pooled:?}");
    }

    /// A varnished table and a matte print on it in the same colour.
    #[test]
    fn segments_of_similar_albedo_whose_gloss_differs_keep_their_own() {
        let matte = fitted(0.001, 0.0005, false);
        let gloss = [fitted(0.05, 0.001, true), matte, matte, matte];
        assert_eq!(pooled_on_a_strip(gloss), gloss);
    }
}
