//! Surfaces that emit (N4): connected pieces that are clipped in every picture that shows them are the candidates,
//! and patches that no picture shows.

use crate::light_model::samples::bounds;
use crate::light_model::visibility::{sees, visible_share};
use crate::mesh::graph::Graph;
use crate::numerics::random::{hash, unit};
use crate::rays::RayScene;
use crate::transfer::Traced;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// Candidates at most, largest first.
const MAX_PIECES: usize = 8;
/// Vertices of a candidate at least.
const MIN_VERTICES: usize = 4;
/// A piece grows over its unseen side within so many of its radii …
const UNSEEN_RADII: f32 = 2.5;
/// … to so many times its own vertices at most: a lamp's back, not the wall behind.
const UNSEEN_RATIO: usize = 4;
/// Edge of a patch of unseen surface, as a share of the scene's size, and patches at most, largest first.
const PATCH: f32 = 0.1;
const MAX_PATCHES: usize = 40;
/// Points that stand for a piece at most.
const POINTS: usize = 256;
/// A point that brings this share of all light by itself is so near that those of the piece lie too far apart.
const COARSE: f32 = 0.3;

/// A piece of surface that may emit.
#[derive(Debug, Clone)]
pub struct Piece {
    /// Its vertices, ascending.
    pub vertices: Vec<u32>,
    /// Area up to and including each of them.
    cumulative_area: Vec<f32>,
}

impl Piece {
    fn new(vertices: Vec<u32>, area: &[f32]) -> Self {
        let mut sum = 0.0;
        let cumulative_area = vertices.iter().map(|&i| {
            sum += area[i as usize];
            sum
        });
        Self { cumulative_area: cumulative_area.collect(), vertices }
    }

    fn area(&self) -> f32 {
        self.cumulative_area.last().copied().unwrap_or(0.0)
    }

    /// Its vertices, or fewer that stand for equal areas.
    fn points(&self, mesh: &Mesh, scene: &RayScene) -> Vec<Point> {
        let point = |n: usize, area: f32| {
            let (at, normal) = (mesh.positions[self.vertices[n] as usize], mesh.normals[self.vertices[n] as usize]);
            Point { position: scene.offset_origin(at, normal), normal, area }
        };
        if self.vertices.len() <= POINTS {
            let before = |n: usize| if n == 0 { 0.0 } else { self.cumulative_area[n - 1] };
            return (0..self.vertices.len()).map(|n| point(n, self.cumulative_area[n] - before(n))).collect();
        }
        let share = self.area() / POINTS as f32;
        let drawn = |n: usize| {
            let index = self.cumulative_area.partition_point(|a| *a <= share * (n as f32 + 0.5));
            point(index.min(self.vertices.len() - 1), share)
        };
        (0..POINTS).map(drawn).collect()
    }
}

/// A point on a piece.
struct Point {
    /// Off the surface, as rays need it.
    position: Vec3,
    normal: Vec3,
    area: f32,
}

impl Point {
    /// Its part of F where nothing is between: that of a disc, which is finite however near it is.
    fn brings(&self, origin: Vec3, normal: Vec3) -> f32 {
        let to = self.position - origin;
        let square = to.length_squared();
        let (here, there) = (to.dot(normal), -to.dot(self.normal));
        // Written so that NaN fails too.
        if !(here > 0.0 && there > 0.0) {
            return 0.0;
        }
        self.area * here * there / (square * (std::f32::consts::PI * square + self.area))
    }
}

/// Candidates. `clipped`: seen, but clipped in every picture; `seen`: seen at all.
#[must_use]
pub fn candidates(mesh: &Mesh, graph: &Graph, clipped: &[bool], seen: &[bool]) -> Vec<Piece> {
    let area = vertex_areas(mesh);
    let mut taken = vec![false; clipped.len()];
    let mut pieces = Vec::new();
    for start in 0..clipped.len() {
        if !clipped[start] || taken[start] {
            continue;
        }
        let mut vertices = graph.grow(vec![start], &mut taken, |i| clipped[i]);
        if vertices.len() < MIN_VERTICES {
            continue;
        }
        let center = vertices.iter().map(|&i| mesh.positions[i]).sum::<Vec3>() / vertices.len() as f32;
        let distance = |i: usize| mesh.positions[i].distance(center);
        let reach = UNSEEN_RADII * vertices.iter().map(|&i| distance(i)).fold(0.0, f32::max);
        let mut grown_taken = taken.clone();
        let grown = graph.grow(vertices.clone(), &mut grown_taken, |i| !seen[i] && distance(i) < reach);
        if grown.len() <= UNSEEN_RATIO * vertices.len() {
            (vertices, taken) = (grown, grown_taken);
        }
        vertices.sort_unstable();
        pieces.push(Piece::new(vertices.into_iter().map(|i| i as u32).collect(), &area));
    }
    largest(pieces, MAX_PIECES)
}

/// Patches of surface that no picture shows: cells of a lattice, apart by the axis that they face.
#[must_use]
pub fn unseen_patches(mesh: &Mesh, seen: &[bool]) -> Vec<Piece> {
    let area = vertex_areas(mesh);
    let (low, high) = bounds(mesh);
    let edge = (PATCH * low.distance(high)).max(f32::MIN_POSITIVE);
    let mut cells: BTreeMap<([i32; 3], usize, bool), Vec<usize>> = BTreeMap::new();
    for i in (0..seen.len()).filter(|i| !seen[*i]) {
        let (cell, normal) = (((mesh.positions[i] - low) / edge).floor().as_ivec3(), mesh.normals[i]);
        let axis = normal.abs().max_position();
        cells.entry((cell.to_array(), axis, normal[axis] > 0.0)).or_default().push(i);
    }
    let piece = |cell: Vec<usize>| Piece::new(cell.into_iter().map(|i| i as u32).collect(), &area);
    largest(cells.into_values().filter(|c| c.len() >= MIN_VERTICES).map(piece).collect(), MAX_PATCHES)
}

/// The largest pieces, at most so many.
fn largest(mut pieces: Vec<Piece>, most: usize) -> Vec<Piece> {
    pieces.sort_by(|a, b| b.area().total_cmp(&a.area()).then(a.vertices[0].cmp(&b.vertices[0])));
    pieces.truncate(most);
    pieces
}

fn vertex_areas(mesh: &Mesh) -> Vec<f32> {
    let mut area = vec![0.0; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        let third = (b - a).cross(c - a).length() / 6.0;
        t.iter().for_each(|&i| area[i as usize] += if third.is_finite() { third } else { 0.0 });
    }
    area
}

/// F of (N4) at many vertices: the integral of cosines over squared distance by points on the piece, of which rays tell the visible
/// share, drawn by what each point brings; the share of the vertex's rays that hit the front of the piece where the points lie
/// too far apart for that. Noise of F counts as error of a model that is right: it must stay well below that of lit colours.
#[must_use]
pub fn form_factors(mesh: &Mesh, scene: &RayScene, traced: &Traced, piece: &Piece, vertices: &[u32]) -> Vec<f32> {
    let points = piece.points(mesh, scene);
    let factor = |brings: &mut Vec<f32>, &vertex: &u32| {
        let (position, normal) = (mesh.positions[vertex as usize], mesh.normals[vertex as usize]);
        let origin = scene.offset_origin(position, normal);
        let (mut total, mut most) = (0.0, 0.0f32);
        brings.clear();
        for point in &points {
            let one = point.brings(origin, normal);
            total += one;
            most = most.max(one);
            brings.push(total);
        }
        if total <= 0.0 {
            return 0.0;
        }
        if most > COARSE && traced.hit_rays() > 0 {
            let hits = traced.hits(vertex as usize).iter().filter(|h| piece.vertices.binary_search(h).is_ok()).count();
            return hits as f32 / traced.hit_rays() as f32;
        }
        let shift = unit(hash(vertex, 0xe317));
        let visible = visible_share(|ray, of| {
            let drawn = total * (ray as f32 + shift) / of as f32;
            let point = &points[brings.partition_point(|b| *b <= drawn).min(points.len() - 1)];
            sees(scene, origin, point.position)
        });
        (total * visible).min(1.0)
    };
    vertices.par_iter().map_init(Vec::new, factor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light_model::tests::square;
    use crate::transfer::unoccluded;

    #[test]
    fn a_lamp_that_a_screen_hides_in_part_brings_the_part_that_is_seen() {
        let mut mesh = Mesh::default();
        let receivers: Vec<f32> = (0..9).map(|k| 0.04 * (k as f32 - 4.0)).collect();
        mesh.positions.extend(receivers.iter().map(|x| Vec3::new(*x, 0.0, 0.0)));
        mesh.normals.resize(receivers.len(), Vec3::Z);
        // Both face down.
        let mut add = |corner: Vec3, edge: f32, cells: u32| {
            let first = mesh.positions.len() as u32;
            square(&mut mesh, &mut Vec::new(), 0, [corner, Vec3::X * edge, Vec3::NEG_Y * edge], cells);
            (first..mesh.positions.len() as u32).collect()
        };
        let lamp = add(Vec3::new(-0.2, 0.2, 1.0), 0.4, 60);
        // Hides what lies below x = 0, half way up.
        let _screen: Vec<u32> = add(Vec3::new(-2.0, 1.0, 0.5), 2.0, 1);
        let piece = Piece::new(lamp, &vertex_areas(&mesh));
        let of: Vec<u32> = (0..receivers.len() as u32).collect();
        let found = form_factors(&mesh, &RayScene::new(&mesh), &unoccluded(&mesh, 1), &piece, &of);
        for (from, found) in receivers.into_iter().zip(found) {
            let (mut whole, mut seen, n) = (0.0, 0.0, 400);
            for k in 0..n * n {
                let [x, y] = [k / n, k % n].map(|i| 0.4 * ((i as f32 + 0.5) / n as f32 - 0.5));
                let square = (x - from) * (x - from) + y * y + 1.0;
                let one = 0.16 / (n * n) as f32 / (std::f32::consts::PI * square * square);
                whole += one;
                seen += if x > -from { one } else { 0.0 };
            }
            assert!((found - seen).abs() < 0.025 * whole, "at {from}: {found} instead of {seen} of {whole}");
        }
    }
}
