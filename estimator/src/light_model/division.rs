//! Segments that creases should have divided. Where a wall meets a table, light can make two paints look alike; lit colours alone do
//! not tell, held-out surface under a model of light does.

use crate::mesh::cells::facing;
use crate::segmentation::materials::{Paint, materials};
use firmware_config::tuning::SegmentationTuning;
use glam::Vec3;
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// Length of the mean normal of what is flat.
const FLAT: f64 = 0.95;

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
        Self::by(segment, |i| facing(mesh.normals[i]))
    }

    /// What is flat of every segment divided by the axis that it faces most, if that is more than `least` of what was seen. Where a
    /// surface bends, its light tells that it is one. `segment` and `lit_weight` are `[vertex]`.
    #[must_use]
    pub fn by_flat_parts(mesh: &Mesh, segment: &[u32], lit_weight: &[f32], least: f64) -> Self {
        let mut sums: BTreeMap<(u32, usize), (Vec3, f64)> = BTreeMap::new();
        for i in (0..segment.len()).filter(|&i| lit_weight[i] > 0.0) {
            let (normal, count) = sums.entry((segment[i], facing(mesh.normals[i]))).or_default();
            *normal += mesh.normals[i];
            *count += 1.0;
        }
        let all: f64 = sums.values().map(|s| s.1).sum();
        let is_flat = |(n, count): &(Vec3, f64)| *count > least * all && f64::from(n.length()) > FLAT * count;
        Self::by(segment, |i| {
            let facing = facing(mesh.normals[i]);
            sums.get(&(segment[i], facing)).is_some_and(is_flat).then_some(facing)
        })
    }

    /// Every segment divided by the `side` that its vertices are on, parts numbered in order of their first vertex.
    fn by<Side: Ord>(segment: &[u32], side: impl Fn(usize) -> Side) -> Self {
        let (mut parts, mut of) = (BTreeMap::new(), Vec::new());
        let part_of = |(i, segment): (usize, &u32)| {
            *parts.entry((*segment, side(i))).or_insert_with(|| {
                of.push(*segment);
                of.len() as u32 - 1
            })
        };
        Self { part: segment.iter().enumerate().map(part_of).collect(), of }
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

    #[test]
    fn flat_sides_are_parts_and_what_bends_is_one() {
        // Segment 0: a floor, a wall and one vertex that faces elsewhere; segment 1: an edge that is rounded.
        let bent =
            [Vec3::new(0.8, 0.0, 0.6), Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.8, 0.0, -0.6), Vec3::new(0.6, 0.0, 0.8)];
        let sides = [vec![Vec3::Z; 4], vec![Vec3::X; 4], vec![Vec3::Y]].concat();
        let normals: Vec<Vec3> = sides.into_iter().chain(bent).collect();
        let mesh = Mesh { positions: vec![Vec3::ZERO; normals.len()], normals, ..Mesh::default() };
        let segment = [[0; 9].as_slice(), &[1; 4]].concat();
        let flat = Division::by_flat_parts(&mesh, &segment, &[1.0; 13], 0.15);
        assert_eq!(flat, Division { part: vec![0, 0, 0, 0, 1, 1, 1, 1, 2, 3, 3, 3, 3], of: vec![0, 0, 0, 1] });
        // A wall that nobody saw is no part.
        let unseen: Vec<f32> = (0..13).map(|i| if (4..8).contains(&i) { 0.0 } else { 1.0 }).collect();
        let flat = Division::by_flat_parts(&mesh, &segment, &unseen, 0.15);
        assert_eq!(flat.part[..9], [0, 0, 0, 0, 1, 1, 1, 1, 1]);
    }
}
