//! Segments that creases should have divided. Where a wall meets a table, light can make two paints look alike; lit colours alone do
//! not tell, held-out surface under a model of light does.

use crate::mesh::cells::facing;
use crate::segmentation::materials::{Paint, materials};
use firmware_config::tuning::SegmentationTuning;
use glam::Vec3;
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// Parts of segments.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Part of every vertex: `[vertex]`.
    pub part: Vec<u32>,
    /// The segment that each part is of: `[part]`.
    pub of: Vec<u32>,
}

impl Division {
    /// Every segment divided by the axis that its vertices face most. `segment` is `[vertex]`.
    #[must_use]
    pub fn by_facing(mesh: &Mesh, segment: &[u32]) -> Self {
        let mut parts = BTreeMap::new();
        let mut of = Vec::new();
        let part_of = |(segment, normal): (&u32, &Vec3)| {
            *parts.entry((*segment, facing(*normal))).or_insert_with(|| {
                of.push(*segment);
                of.len() as u32 - 1
            })
        };
        Self { part: segment.iter().zip(&mesh.normals).map(part_of).collect(), of }
    }

    /// Parts of one segment that have like albedo are one. `albedo` and `weight`, of what was seen, are `[part]`; a part that was not
    /// seen goes to the largest one of its segment.
    #[must_use]
    pub fn joined(&self, albedo: &[[f64; 3]], weight: &[f64], tuning: &SegmentationTuning) -> Self {
        let mut members: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        self.of.iter().enumerate().for_each(|(part, segment)| members.entry(*segment).or_default().push(part));
        let (mut joined, mut of) = (vec![0; self.of.len()], Vec::new());
        for (segment, parts) in members {
            let paints: Vec<Option<Paint>> =
                parts.iter().map(|p| Paint::known(albedo[*p], weight[*p], false)).collect();
            let labels = materials(&paints, tuning);
            let largest = (0..parts.len()).max_by(|a, b| weight[parts[*a]].total_cmp(&weight[parts[*b]])).unwrap_or(0);
            let mut names = BTreeMap::new();
            for ((&p, paint), label) in parts.iter().zip(&paints).zip(&labels) {
                let label = if paint.is_some() { *label } else { labels[largest] };
                joined[p] = *names.entry(label).or_insert_with(|| {
                    of.push(segment);
                    of.len() as u32 - 1
                });
            }
        }
        Self { part: self.part.iter().map(|p| joined[*p as usize]).collect(), of }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_like_albedo_are_joined_again_within_their_segment() {
        let normals = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::X, Vec3::NEG_Z, Vec3::Z].to_vec();
        let mesh = Mesh { positions: vec![Vec3::ZERO; 6], normals, ..Mesh::default() };
        let facing = Division::by_facing(&mesh, &[0, 0, 0, 1, 0, 1]);
        assert_eq!(facing, Division { part: vec![0, 1, 2, 3, 4, 5], of: vec![0, 0, 0, 1, 0, 1] });
        // Parts 0 and 2 are of one paint, 1 of another, 4 was not seen; 3 and 5 have the paint of 0, but are another segment.
        let albedo = [[0.5; 3], [0.1; 3], [0.55; 3], [0.5; 3], [0.0; 3], [0.52; 3]];
        let joined = facing.joined(&albedo, &[3.0, 1.0, 2.0, 1.0, 0.0, 1.0], &SegmentationTuning::default());
        assert_eq!(joined, Division { part: vec![0, 1, 0, 2, 0, 2], of: vec![0, 0, 1] });
    }
}
