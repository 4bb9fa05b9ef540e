//! Surface that nobody saw, in the distant answer. A vertex that was seen alone among unseen ones is a segment, whose albedo is that of
//! one dark corner or a wrong pose, and all around it would have it.

use crate::factorisation::albedo::{Detail, plausible};
use crate::factorisation::{Colors, Factorised};
use crate::segmentation::labels::{UNLABELLED, flood, sizes};
use crate::segmentation::segment::least_size;
use firmware_config::EstimatorConfig;
use glam::{DVec3, Vec3};

/// A segment of which less than this share was seen, and fewer vertices than a segment must have, is hidden.
const LEAST_SEEN: f64 = 0.1;

/// Gives hidden segments the albedo of the segments around them, and what no edge leads to the mean albedo of the seen surface. Light
/// has been solved for: it does not change.
pub fn continue_hidden(colors: &Colors, found: &mut Factorised, config: &EstimatorConfig) {
    let least = least_size(colors.segment.len(), config);
    continued(colors, least, &mut found.solution.albedo, &mut found.detail);
}

/// The same for the albedos of the segments, `[segment][channel]`, and of the vertices; `least` vertices make a segment.
fn continued(colors: &Colors, least: u32, of_segment: &mut [[f64; 3]], detail: &mut Detail) {
    let (segment, seen, mut all) = (colors.segment, colors.seen(), sizes(colors.segment));
    all.resize(seen.len(), 0);
    let is_hidden = |s: usize| seen[s] < f64::from(least) && seen[s] < LEAST_SEEN * f64::from(all[s]);
    let shown: Vec<usize> = (0..seen.len()).filter(|s| seen[*s] > 0.0 && !is_hidden(*s)).collect();
    let total: f64 = shown.iter().map(|s| seen[*s]).sum();
    if total <= 0.0 {
        return;
    }
    let vector = |albedo: [f64; 3]| plausible(DVec3::from_array(albedo).as_vec3());
    let mean: Vec3 = shown.iter().map(|s| vector(of_segment[*s]) * (seen[*s] / total) as f32).sum();
    let mut around: Vec<u32> = segment.iter().map(|s| if is_hidden(*s as usize) { UNLABELLED } else { *s }).collect();
    flood(colors.graph, &mut around);
    let mut sums = vec![Vec3::ZERO; seen.len()];
    for (i, s) in segment.iter().map(|s| *s as usize).enumerate().filter(|(_, s)| is_hidden(*s)) {
        detail.albedo[i] = if around[i] == UNLABELLED { mean } else { vector(of_segment[around[i] as usize]) };
        (detail.confidence[i], detail.painted[i]) = (0.0, 0.0);
        sums[s] += detail.albedo[i];
    }
    for s in (0..seen.len()).filter(|s| is_hidden(*s)) {
        of_segment[s] = (sums[s] / all[s] as f32).to_array().map(f64::from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::graph::Graph;

    /// Two strips: one of vertices 0 to 29, of which 0 to 11 (segment 0) and 20 (segment 1, which reaches from 12 to 29) were seen, one of 30
    /// to 39 (segment 2), which nobody saw.
    #[test]
    fn what_nobody_saw_takes_after_what_is_around_it_or_after_the_mean() {
        let strip = |first: u32, end: u32| (first..end - 2).map(|i| [i, i + 1, i + 2]);
        let graph = Graph::new(40, &strip(0, 30).chain(strip(30, 40)).collect::<Vec<_>>());
        let lit_weight: Vec<f32> = (0..40).map(|i| if i < 12 || i == 20 { 1.0 } else { 0.0 }).collect();
        let segment: Vec<u32> = (0..40).map(|i| u32::from(i >= 12) + u32::from(i >= 30)).collect();
        let colors = Colors {
            lit_color: &[Vec3::ONE; 40],
            lit_weight: &lit_weight,
            reliability: &[],
            clipped: &[false; 40],
            segment: &segment,
            segments: 3,
            graph: &graph,
            known: None,
        };
        let found = [[0.5, 0.25, 0.125], [1.0; 3], [1e-9; 3]];
        let answer = |least| {
            let mut of_segment = found;
            let albedo = segment.iter().map(|s| DVec3::from_array(found[*s as usize]).as_vec3()).collect();
            let mut detail = Detail { albedo, confidence: lit_weight.clone(), painted: vec![1.0; 40] };
            continued(&colors, least, &mut of_segment, &mut detail);
            (of_segment, detail)
        };
        let (of_segment, detail) = answer(8);
        assert!(detail.albedo.iter().all(|a| *a == Vec3::new(0.5, 0.25, 0.125)));
        assert!(of_segment.iter().flatten().zip(found[0].repeat(3)).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!((detail.confidence[5], detail.confidence[20]), (1.0, 0.0));
        // One vertex makes a segment: it stays, and counts for the mean of what nobody saw.
        let (of_segment, detail) = answer(1);
        assert_eq!(detail.albedo[25], Vec3::ONE);
        let mean = (12.0 * found[0][0] + 1.0) / 13.0;
        assert!((of_segment[2][0] - mean).abs() < 1e-6 && (f64::from(detail.albedo[35].x) - mean).abs() < 1e-6);
    }
}
