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
    graph.fill(&mut colors, usize::MAX);
    colors.into_iter().map(|c| c.unwrap_or(mean)).collect()
}

/// G of (N3) at a vertex under these radiances of the surfaces, those of emitting pieces 0.
#[must_use]
pub fn secondary(traced: &Traced, radiance: &[Vec3], vertex: usize) -> Vec3 {
    let sum: Vec3 = traced.hits(vertex).iter().map(|&h| radiance[h as usize]).sum();
    sum / traced.hit_rays().max(1) as f32
}
