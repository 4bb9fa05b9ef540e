//! Segmentation into materials (Eqs. 6–7): DBSCAN over mesh neighbourhoods, then neighbouring regions without a border
//! of colour between them are joined.

pub mod regions;
pub mod shape_diameter;

use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use firmware_config::EstimatorConfig;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;

/// Lightness against chromaticity in the colour distance: shading changes the one far more than the other.
const LIGHTNESS_SHARE: f32 = 0.25;
/// Concavity of a smooth surface, in radians: below it the robust scale of Eq. (6) does not fall.
const LEAST_CONCAVITY: f32 = 0.05;
/// The same for colour differences (CIELAB).
const LEAST_COLOR: f32 = 0.25;
/// The same for relative differences of the shape diameter.
const LEAST_THICKNESS: f32 = 0.05;
/// ε of DBSCAN in median k-distances, rising: a glossy apple is that much noisier than the table that sets the median.
const EPSILONS: [f32; 9] = [2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0];
/// Passes of the edge-sharpening filter.
const SHARPENINGS: usize = 3;
/// Vertex without a segment.
pub const NONE: u32 = u32::MAX;

/// Segment of every vertex, numbered from 0 in order of their first vertex. `lit_color` may be any linear colour per
/// vertex; vertices of weight 0 take the segment of the nearest vertex of their component that has one.
#[must_use]
pub fn segment(
    mesh: &Mesh,
    scene: &RayScene,
    lit_color: &[Vec3],
    lit_weight: &[f32],
    config: &EstimatorConfig,
) -> Vec<u32> {
    let graph = Graph::of(mesh);
    let seen: Vec<bool> = lit_weight.iter().zip(lit_color).map(|(&w, c)| w > 0.0 && c.is_finite()).collect();
    let features = median_filtered(&graph, &features(lit_color, &seen), &seen);
    let mut sharp = sharpened(&graph, &features, &seen);
    for _ in 1..SHARPENINGS {
        sharp = sharpened(&graph, &sharp, &seen);
    }
    let thickness = if config.segment_thickness > 0.0 {
        shape_diameter::shape_diameter(mesh, &graph, scene, config.seed)
    } else {
        vec![None; mesh.positions.len()]
    };
    let edges = Edges::new(mesh, &graph, &sharp, &thickness, &seen, config);
    let least = (config.segment_min_share * mesh.positions.len() as f64).ceil().max(8.0) as u32;
    let mut labels = dbscan(&graph, &edges, &seen, config.segment_min_points as usize, least);
    regions::grow(&graph, &edges.distance, &seen, &mut labels);
    regions::merge(mesh, &graph, &features, &edges.concavity, config.segment_merge as f32, least, &mut labels);
    regions::spread(&graph, &mut labels);
    regions::renumber(&mut labels);
    labels
}

/// (lightness, a, b): CIELAB with a and b taken at one lightness, so that shading moves only the first.
fn features(color: &[Vec3], seen: &[bool]) -> Vec<Vec3> {
    let mut luminances: Vec<f32> =
        color.iter().zip(seen).filter(|(_, s)| **s).map(|(c, _)| luminance(*c)).filter(|&y| y > 0.0).collect();
    if luminances.is_empty() {
        return vec![Vec3::ZERO; color.len()];
    }
    let middle = luminances.len() / 2;
    let typical = *luminances.select_nth_unstable_by(middle, f32::total_cmp).1;
    color
        .iter()
        .map(|&c| {
            let c = c.max(Vec3::ZERO) / typical;
            // Very dark colours have no chromaticity worth the name: they are drawn towards grey.
            let y = luminance(c);
            let level = 0.4 / (y + 0.02);
            let grey = Vec3::splat((0.4 - y * level).max(0.0));
            let lab = lab(c * level + grey);
            Vec3::new(LIGHTNESS_SHARE * lightness(0.2 * y), lab.y, lab.z)
        })
        .collect()
}

fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

fn lightness(y: f32) -> f32 {
    116.0 * lab_curve(y) - 16.0
}

fn lab_curve(t: f32) -> f32 {
    if t > 0.008_856 { libm::cbrtf(t) } else { 7.787 * t + 16.0 / 116.0 }
}

/// CIELAB (D65) of linear Rec. 709.
pub(crate) fn lab(c: Vec3) -> Vec3 {
    let x = c.dot(Vec3::new(0.4124, 0.3576, 0.1805)) / 0.9505;
    let y = luminance(c);
    let z = c.dot(Vec3::new(0.0193, 0.1192, 0.9505)) / 1.089;
    let (fx, fy, fz) = (lab_curve(x), lab_curve(y), lab_curve(z));
    Vec3::new(116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz))
}

/// Median over each vertex and its neighbours: takes noise, keeps borders.
fn median_filtered(graph: &Graph, features: &[Vec3], seen: &[bool]) -> Vec<Vec3> {
    (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            if !seen[i] {
                return features[i];
            }
            let mut row: Vec<Vec3> = vec![features[i]];
            row.extend(graph.neighbours(i).iter().filter(|&&j| seen[j as usize]).map(|&j| features[j as usize]));
            Vec3::from_array(std::array::from_fn(|c| {
                let middle = row.len() / 2;
                row.select_nth_unstable_by(middle, |a, b| a[c].total_cmp(&b[c])).1[c]
            }))
        })
        .collect()
}

/// Kuwahara's filter: every vertex takes the mean of the most uniform neighbourhood it belongs to. Takes noise and makes
/// steps of blurred borders.
fn sharpened(graph: &Graph, features: &[Vec3], seen: &[bool]) -> Vec<Vec3> {
    let around: Vec<(Vec3, f32)> = (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let (mut sum, mut squares, mut count) = (features[i], features[i].length_squared(), 1.0);
            for &j in graph.neighbours(i).iter().filter(|&&j| seen[j as usize]) {
                sum += features[j as usize];
                squares += features[j as usize].length_squared();
                count += 1.0;
            }
            let mean = sum / count;
            (mean, if count > 2.0 { squares / count - mean.length_squared() } else { f32::INFINITY })
        })
        .collect();
    (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let own = if seen[i] { around[i] } else { (features[i], f32::NEG_INFINITY) };
            let ring = graph.neighbours(i).iter().filter(|&&j| seen[j as usize]).map(|&j| around[j as usize]);
            ring.fold(own, |best, a| if a.1 < best.1 { a } else { best }).0
        })
        .collect()
}

/// Distances along the graph's edges, in the order of its targets.
struct Edges {
    /// Eq. (6); infinite towards vertices that nobody saw.
    distance: Vec<f32>,
    /// Eq. (7), made symmetric, in radians.
    concavity: Vec<f32>,
}

impl Edges {
    fn new(
        mesh: &Mesh,
        graph: &Graph,
        features: &[Vec3],
        thickness: &[Option<f32>],
        seen: &[bool],
        config: &EstimatorConfig,
    ) -> Self {
        let rows: Vec<Vec<[f32; 3]>> = (0..graph.vertices())
            .into_par_iter()
            .map(|i| {
                graph
                    .neighbours(i)
                    .iter()
                    .map(|&j| {
                        let j = j as usize;
                        let thick = match (thickness[i], thickness[j]) {
                            (Some(a), Some(b)) => (a - b).abs() / (0.5 * (a + b)).max(f32::MIN_POSITIVE),
                            _ => f32::NAN,
                        };
                        [features[i].distance(features[j]), concavity(mesh, i, j).max(concavity(mesh, j, i)), thick]
                    })
                    .collect()
            })
            .collect();
        let terms: Vec<[f32; 3]> = rows.concat();
        let valid: Vec<bool> = (0..graph.vertices())
            .flat_map(|i| graph.neighbours(i).iter().map(move |&j| seen[i] && seen[j as usize]))
            .collect();
        let scale = |term: usize, least: f32| {
            let mut values: Vec<f32> =
                terms.iter().zip(&valid).filter(|(t, v)| **v && !t[term].is_nan()).map(|(t, _)| t[term]).collect();
            if values.is_empty() {
                return least;
            }
            let middle = values.len() / 2;
            (1.4826 * *values.select_nth_unstable_by(middle, f32::total_cmp).1).max(least)
        };
        let weights = [
            config.segment_color as f32 / scale(0, LEAST_COLOR),
            config.segment_concavity as f32 / scale(1, LEAST_CONCAVITY),
            config.segment_thickness as f32 / scale(2, LEAST_THICKNESS),
        ];
        let distance = terms
            .iter()
            .zip(&valid)
            .map(|(t, &valid)| {
                if !valid {
                    return f32::INFINITY;
                }
                // Eq. (6)
                let thick = if t[2].is_nan() { 0.0 } else { weights[2] * t[2] };
                weights[0] * t[0] + weights[1] * t[1] + thick
            })
            .collect();
        Self { distance, concavity: terms.iter().map(|t| t[1]).collect() }
    }
}

/// Eq. (7): how far b stands above a's tangent plane, as an angle; 0 if planar or convex.
/// The direction is from a to b, so b above the plane makes a positive dot product: max(0, π/2 − acos(…)).
fn concavity(mesh: &Mesh, a: usize, b: usize) -> f32 {
    let d = (mesh.positions[b] - mesh.positions[a]).normalize_or_zero().dot(mesh.normals[a]);
    libm::asinf(d.clamp(0.0, 1.0))
}

/// DBSCAN with ε rising from quiet to noisy surfaces: each ε clusters what the smaller ones left. [`NONE`] for noise and
/// for clusters of fewer than `least` vertices.
fn dbscan(graph: &Graph, edges: &Edges, seen: &[bool], min_points: usize, least: u32) -> Vec<u32> {
    let k_distance: Vec<f32> = (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let mut d = edges.distance[graph.offsets[i] as usize..graph.offsets[i + 1] as usize].to_vec();
            d.sort_unstable_by(f32::total_cmp);
            d.get(min_points.min(d.len()).saturating_sub(1)).copied().unwrap_or(f32::INFINITY)
        })
        .collect();
    let typical = typical(&k_distance);
    let mut labels = vec![NONE; graph.vertices()];
    let mut next = 0;
    let mut stack = Vec::new();
    for factor in EPSILONS {
        let epsilon = factor * typical;
        let core = |i: usize| seen[i] && k_distance[i] <= epsilon;
        let first = next;
        for start in 0..graph.vertices() {
            if labels[start] != NONE || !core(start) {
                continue;
            }
            labels[start] = next;
            stack.push(start);
            while let Some(i) = stack.pop() {
                for (e, j) in graph.edges(i) {
                    if edges.distance[e] <= epsilon && labels[j] == NONE {
                        labels[j] = next;
                        if core(j) {
                            stack.push(j);
                        }
                    }
                }
            }
            next += 1;
        }
        regions::drop_crumbs(&mut labels, first, least);
    }
    labels
}

/// Median of the finite values.
fn typical(k_distance: &[f32]) -> f32 {
    let mut finite: Vec<f32> = k_distance.iter().copied().filter(|d| d.is_finite()).collect();
    if finite.is_empty() {
        return 0.0;
    }
    let middle = finite.len() / 2;
    finite.select_nth_unstable_by(middle, f32::total_cmp).1.max(f32::MIN_POSITIVE)
}
