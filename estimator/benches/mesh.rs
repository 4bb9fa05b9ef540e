//! The stage that regularises a fused mesh: its time, and what it does to the surface.
//!
//! `cargo bench -p estimator --bench mesh -- SCAN.lscan…` with scans of `lumiscan replay --no-estimate`; `RAYON_NUM_THREADS=1` for one thread.
//! Distances are in multiples of the median edge of the result.

#![allow(clippy::expect_used)]

mod usage;

use estimator::mesh::regularise;
use firmware_config::EstimatorConfig;
use glam::{IVec3, Vec3};
use recordings::scan::Scan;
use recordings::types::Mesh;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::time::Instant;
use usage::{peak_mib, processor_s};

fn main() {
    println!(
        "| scan | vertices | wall s | processor s | peak MiB | edges 2 % … 98 % | outside 0.5 … 1.5 | input to result: median / 99 % / > 2 | result to input: median / 99 % | border | non-manifold edges | components |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for path in std::env::args().skip(1).filter(|a| !a.starts_with("--")) {
        let scan = Scan::read(Path::new(&path)).expect("a scan");
        let config = EstimatorConfig::default();
        let (start, before) = (Instant::now(), processor_s());
        let mesh = regularise::regularise(&scan.mesh, &config, scan.source);
        let (wall, processor, peak) = (start.elapsed().as_secs_f64(), processor_s() - before, peak_mib());
        let lengths =
            sorted(sides(&mesh).map(|(a, b)| mesh.positions[a as usize].distance(mesh.positions[b as usize])));
        let edge = at(&lengths, 0.5);
        let outside =
            lengths.iter().filter(|l| !(0.5 * edge..=1.5 * edge).contains(*l)).count() as f32 / lengths.len() as f32;
        let there = sorted(distances(&scan.mesh.positions, &mesh, edge));
        let back = sorted(distances(&mesh.positions, &scan.mesh, edge));
        let far = there.iter().filter(|d| **d > 2.0).count() as f32 / there.len() as f32;
        let mut uses = BTreeMap::new();
        sides(&mesh).for_each(|(a, b)| *uses.entry((a.min(b), a.max(b))).or_insert(0) += 1);
        let border = uses.values().filter(|n| **n == 1).count();
        let bad = uses.values().filter(|n| **n > 2).count();
        println!(
            "| {path} | {} → {} | {wall:.2} | {processor:.2} | {peak:.0} | {:.3} … {:.3} of {:.2} mm | {:.2} % | {:.4} / {:.3} / {:.3} % | {:.4} / {:.3} | {border} | {bad} | {} |",
            scan.mesh.positions.len(),
            mesh.positions.len(),
            at(&lengths, 0.02) / edge,
            at(&lengths, 0.98) / edge,
            1000.0 * edge,
            100.0 * outside,
            at(&there, 0.5),
            at(&there, 0.99),
            100.0 * far,
            at(&back, 0.5),
            at(&back, 0.99),
            components(&mesh)
        );
    }
}

fn components(mesh: &Mesh) -> usize {
    let graph = estimator::mesh::graph::Graph::of(mesh);
    let mut visited = vec![false; mesh.positions.len()];
    (0..mesh.positions.len())
        .filter(|&i| {
            !visited[i] && {
                graph.component(i, &mut visited);
                true
            }
        })
        .count()
}

fn sides(mesh: &Mesh) -> impl Iterator<Item = (u32, u32)> + '_ {
    mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
}

fn sorted(values: impl IntoIterator<Item = f32>) -> Vec<f32> {
    let mut values: Vec<f32> = values.into_iter().collect();
    values.sort_by(f32::total_cmp);
    values
}

fn at(sorted: &[f32], share: f32) -> f32 {
    sorted[((sorted.len() - 1) as f32 * share) as usize]
}

/// Distance of every tenth point to the mesh in multiples of `edge`, at most 10.
fn distances(points: &[Vec3], mesh: &Mesh, edge: f32) -> Vec<f32> {
    let cell = |p: Vec3| (p / edge).floor().as_ivec3();
    let mut grid: HashMap<IVec3, Vec<u32>> = HashMap::new();
    for (t, c) in mesh.triangles.iter().enumerate() {
        let p = c.map(|i| mesh.positions[i as usize]);
        let (low, high) = (cell(p[0].min(p[1]).min(p[2])), cell(p[0].max(p[1]).max(p[2])));
        if (high - low).max_element() > 20 {
            continue;
        }
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    grid.entry(IVec3::new(x, y, z)).or_default().push(t as u32);
                }
            }
        }
    }
    points
        .iter()
        .step_by(10)
        .map(|&p| {
            let c = cell(p);
            let mut best = f32::INFINITY;
            for reach in 0..=3i32 {
                for x in -reach..=reach {
                    for y in -reach..=reach {
                        for z in -reach..=reach {
                            if x.abs().max(y.abs()).max(z.abs()) != reach {
                                continue;
                            }
                            for &t in grid.get(&(c + IVec3::new(x, y, z))).into_iter().flatten() {
                                best = best.min(to_triangle(
                                    p,
                                    mesh.triangles[t as usize].map(|i| mesh.positions[i as usize]),
                                ));
                            }
                        }
                    }
                }
                if best <= reach as f32 * edge {
                    break;
                }
            }
            (best / edge).min(10.0)
        })
        .collect()
}

fn to_triangle(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
    let n = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(u, v)| (*v - *u).cross(p - *u).dot(n) >= 0.0);
    if inside {
        return (p - a).dot(n.normalize_or_zero()).abs();
    }
    [(a, b), (b, c), (c, a)]
        .iter()
        .map(|(u, v)| {
            let d = *v - *u;
            let t = ((p - *u).dot(d) / d.length_squared()).clamp(0.0, 1.0);
            p.distance(*u + t * d)
        })
        .fold(f32::INFINITY, f32::min)
}
