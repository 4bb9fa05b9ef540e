//! Continues colour and texture into a hole: a piece of the known surface beside the hole, moved along the
//! surface into it, its level fitted to the hole's border by a membrane (after Pérez, Gangnet and Blake, "Poisson Image
//! Editing", SIGGRAPH 2003, on ratios).

use crate::mesh::graph::Graph;
use crate::render::inpainting::membrane::inpaint;
use firmware_config::tuning::InpaintingTuning;
use glam::Vec3;
use recordings::types::Mesh;
use std::collections::BTreeMap;
use std::f32::consts::TAU;

/// Directions in which a piece is looked for, and distances in radii of the hole.
const DIRECTIONS: usize = 24;
const DISTANCES: [f32; 4] = [1.6, 2.1, 2.7, 3.5];
/// Vertices at which a piece is judged.
const PROBES: usize = 240;

/// The known vertices in a grid, found by position.
struct KnownSurface<'a> {
    mesh: &'a Mesh,
    values: Vec<Vec3>,
    cell: f32,
    /// Normals of one surface agree to this cosine.
    same_surface: f32,
    cells: BTreeMap<[i32; 3], Vec<u32>>,
}

impl<'a> KnownSurface<'a> {
    fn new(mesh: &'a Mesh, values: &[Vec3], known: &[bool], edge: f32, same_surface: f32) -> Self {
        let mut all = Self {
            mesh,
            values: values.to_vec(),
            cell: 1.5 * edge.max(f32::MIN_POSITIVE),
            same_surface,
            cells: BTreeMap::new(),
        };
        for v in (0..known.len()).filter(|&v| known[v]) {
            all.cells.entry(all.cell_of(mesh.positions[v])).or_default().push(v as u32);
        }
        all
    }

    fn cell_of(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell).floor().as_ivec3().to_array()
    }

    /// The value at a place on a surface with this normal, from the known vertices about it.
    fn at(&self, p: Vec3, normal: Vec3) -> Option<Vec3> {
        let [x, y, z] = self.cell_of(p);
        let (mut sum, mut weight) = (Vec3::ZERO, 0.0f32);
        for i in 0..27 {
            let key = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
            for &v in self.cells.get(&key).into_iter().flatten() {
                let distance = self.mesh.positions[v as usize].distance(p) / self.cell;
                if distance < 1.0 && self.mesh.normals[v as usize].dot(normal) > self.same_surface {
                    let w = (1.0 - distance) / (distance + 0.05);
                    (sum, weight) = (sum + self.values[v as usize] * w, weight + w);
                }
            }
        }
        (weight > 0.0).then(|| sum / weight)
    }
}

/// Fills `values` where they are not `known`: a membrane everywhere, texture where a piece of the surface beside fits.
/// `edge` is the mesh's median edge in metres. Returns where a piece was copied from, as a shift in metres: `[vertex]`.
pub fn continue_texture(
    values: &mut [Vec3],
    known: &[bool],
    mesh: &Mesh,
    graph: &Graph,
    edge: f32,
    tuning: &InpaintingTuning,
) -> Vec<Option<Vec3>> {
    let mut copied = vec![None; values.len()];
    let around = KnownSurface::new(mesh, values, known, edge, tuning.same_surface as f32);
    inpaint(values, known, graph);
    let mut done = known.to_vec();
    for start in 0..known.len() {
        if done[start] || graph.neighbours(start).is_empty() {
            continue;
        }
        let hole = graph.component(start, &mut done);
        if hole.len() >= tuning.smallest_hole as usize {
            let shift = clone_into(&hole, values, known, &around, graph, tuning);
            hole.iter().for_each(|v| copied[*v] = shift);
        }
    }
    copied
}

/// Copies the piece that fits best, if one does; returns the shift to it.
fn clone_into(
    hole: &[usize],
    values: &mut [Vec3],
    known: &[bool],
    around: &KnownSurface,
    graph: &Graph,
    tuning: &InpaintingTuning,
) -> Option<Vec3> {
    let mesh = around.mesh;
    let sum: Vec3 = hole.iter().map(|&v| mesh.normals[v]).sum();
    let normal = sum / hole.len() as f32;
    if normal.length() < tuning.same_surface as f32 {
        return None;
    }
    let normal = normal.normalize();
    let mut border: Vec<usize> =
        hole.iter().flat_map(|&v| graph.neighbours(v)).map(|&v| v as usize).filter(|&v| known[v]).collect();
    border.sort_unstable();
    border.dedup();
    if border.len() < 8 {
        return None;
    }
    let middle = hole.iter().map(|&v| mesh.positions[v]).sum::<Vec3>() / hole.len() as f32;
    let radius = hole.iter().fold(0.0f32, |r, &v| r.max(mesh.positions[v].distance(middle)));
    let some = |list: &[usize]| -> Vec<usize> { list.iter().step_by(list.len().div_ceil(PROBES)).copied().collect() };
    let (inside, rim) = (some(hole), some(&border));
    let (t, b) = normal.any_orthonormal_pair();
    let mut best: Option<(f32, Vec3)> = None;
    for i in 0..DIRECTIONS * DISTANCES.len() {
        let (s, c) = libm::sincosf(TAU * (i % DIRECTIONS) as f32 / DIRECTIONS as f32);
        let shift = (t * c + b * s) * (radius * DISTANCES[i / DIRECTIONS]);
        let source = |v: usize| around.at(mesh.positions[v] + shift, normal);
        let covered = inside.iter().chain(&rim).filter(|&&v| source(v).is_some()).count();
        if (covered as f32) < tuning.coverage as f32 * (inside.len() + rim.len()) as f32 {
            continue;
        }
        let logs: Vec<f32> = rim.iter().filter_map(|&v| Some(log_ratio(values[v], source(v)?))).collect();
        let mean = logs.iter().sum::<f32>() / logs.len().max(1) as f32;
        let spread = (logs.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / logs.len().max(1) as f32).sqrt();
        // Another material is another level, too.
        let cost = spread + 0.5 * mean.abs();
        if cost < tuning.largest_spread as f32 && best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, shift));
        }
    }
    let (_, shift) = best?;
    let mut level = vec![Vec3::ONE; values.len()];
    let mut fixed = vec![true; values.len()];
    hole.iter().for_each(|&v| fixed[v] = false);
    for &v in &border {
        if let Some(source) = around.at(mesh.positions[v] + shift, normal) {
            level[v] = (values[v] / source.max(Vec3::splat(1e-6))).clamp(Vec3::splat(0.25), Vec3::splat(4.0));
        }
    }
    inpaint(&mut level, &fixed, graph);
    for &v in hole {
        if let Some(source) = around.at(mesh.positions[v] + shift, normal) {
            values[v] = source * level[v];
        }
    }
    Some(shift)
}

fn log_ratio(a: Vec3, b: Vec3) -> f32 {
    libm::logf(a.element_sum().max(1e-6) / b.element_sum().max(1e-6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stripes_go_on_across_a_hole() {
        const N: usize = 81;
        let mut mesh = Mesh::default();
        for i in 0..N * N {
            mesh.positions.push(Vec3::new((i % N) as f32, (i / N) as f32, 0.0));
            mesh.normals.push(Vec3::Z);
        }
        for y in 0..N - 1 {
            for x in 0..N - 1 {
                let (a, n) = ((y * N + x) as u32, N as u32);
                mesh.triangles.extend([[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]);
            }
        }
        let stripes = |p: &Vec3| Vec3::splat(0.5 + 0.2 * libm::sinf(p.y * 0.8)) * (1.0 + 0.003 * p.x);
        let truth: Vec<Vec3> = mesh.positions.iter().map(stripes).collect();
        let known: Vec<bool> = mesh.positions.iter().map(|p| p.distance(Vec3::new(40.0, 40.0, 0.0)) > 9.0).collect();
        let graph = Graph::of(&mesh);
        let blank: Vec<Vec3> = truth.iter().zip(&known).map(|(t, k)| if *k { *t } else { Vec3::ZERO }).collect();
        let error = |values: &[Vec3]| -> f32 {
            let inside = (0..N * N).filter(|&v| !known[v]);
            let sum: f32 = inside.map(|v| (values[v] - truth[v]).length_squared()).sum();
            (sum / known.iter().filter(|k| !**k).count() as f32).sqrt()
        };
        let (mut smooth, mut textured) = (blank.clone(), blank);
        inpaint(&mut smooth, &known, &graph);
        continue_texture(&mut textured, &known, &mesh, &graph, 1.0, &InpaintingTuning::default());
        assert!(error(&textured) < 0.4 * error(&smooth), "{} {}", error(&textured), error(&smooth));
    }
}
