//! Secondary light as it was observed (N3): what a ray hits radiates the lit colour that was seen there, no albedo and no
//! bounce series in it.

use crate::mesh::graph::Graph;
use crate::transfer::Traced;
use glam::Vec3;

/// Lit colours where they are `known`; elsewhere the mean of what is known around, ring by ring. What no path joins to a
/// known vertex takes the mean of all.
#[must_use]
pub fn filled(graph: &Graph, lit_color: &[Vec3], known: &[bool]) -> Vec<Vec3> {
    let mut colors: Vec<Option<Vec3>> = lit_color.iter().zip(known).map(|(f, k)| k.then_some(*f)).collect();
    let count = known.iter().filter(|k| **k).count().max(1) as f32;
    let mean = colors.iter().flatten().sum::<Vec3>() / count;
    let mut open: Vec<u32> = (0..colors.len() as u32).filter(|i| !known[*i as usize]).collect();
    loop {
        let reached: Vec<(u32, Vec3)> = open
            .iter()
            .filter_map(|&i| {
                let around = graph.neighbours(i as usize).iter().filter_map(|&j| colors[j as usize]);
                let (sum, count) = around.fold((Vec3::ZERO, 0.0), |(s, n), c| (s + c, n + 1.0));
                (count > 0.0).then(|| (i, sum / count))
            })
            .collect();
        if reached.is_empty() {
            break;
        }
        for &(i, color) in &reached {
            colors[i as usize] = Some(color);
        }
        open.retain(|&i| colors[i as usize].is_none());
    }
    colors.into_iter().map(|c| c.unwrap_or(mean)).collect()
}

/// G of (N3) at a vertex under these radiances of the surfaces, those of emitting pieces 0.
#[must_use]
pub fn secondary(traced: &Traced, radiance: &[Vec3], vertex: usize) -> Vec3 {
    let sum: Vec3 = traced.hits(vertex).iter().map(|&h| radiance[h as usize]).sum();
    sum / traced.hit_rays().max(1) as f32
}
