//! Whether the seams of a texture show: the gradient of the albedo across borders of charts over that beside them.

use estimator::texture::detail::Detail;
use glam::Vec3;
use recordings::result::Estimate;
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// Points along every border edge.
const POINTS: [f32; 3] = [0.25, 0.5, 0.75];

/// Gradients at the borders of charts, mean over points and channels, per metre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeamGradients {
    /// From one chart to the other.
    pub across: f64,
    /// Within the charts, as far from the border.
    pub beside: f64,
    /// Border edges.
    pub edges: usize,
}

impl SeamGradients {
    /// 1 where seams cannot be told from what is around them.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        self.across / self.beside.max(f64::MIN_POSITIVE)
    }
}

/// Measures the texture of a result; `None` without one, or without borders between its charts.
///
/// # Errors
/// The picture is damaged.
pub fn measure(result: &Estimate) -> Result<Option<SeamGradients>, String> {
    let Some(texture) = &result.texture else { return Ok(None) };
    let detail = Detail::new(texture, &result.mesh, &result.albedo)?;
    let step = texture.texel_m;
    let (mut across, mut beside, mut edges) = (0.0f64, 0.0f64, 0usize);
    let difference = |a: Vec3, b: Vec3| f64::from((a - b).abs().element_sum() / (3.0 * 2.0 * step));
    for ((a, b), [t, u]) in inner_edges(&result.mesh) {
        if texture.chart[t as usize] == texture.chart[u as usize] {
            continue;
        }
        let (Some(inward_t), Some(inward_u)) = (inward(&result.mesh, t, (a, b)), inward(&result.mesh, u, (a, b)))
        else {
            continue;
        };
        edges += 1;
        let ends = [a, b].map(|i| result.mesh.positions[i as usize]);
        for share in POINTS {
            let on = ends[0].lerp(ends[1], share);
            let at = |triangle: u32, direction: Vec3, texels: f32| {
                detail.albedo(triangle, weights(&result.mesh, triangle, on + direction * (texels * step)))
            };
            let near = [at(t, inward_t, 1.0), at(u, inward_u, 1.0)];
            let far = [at(t, inward_t, 3.0), at(u, inward_u, 3.0)];
            across += difference(near[0], near[1]);
            beside += 0.5 * (difference(near[0], far[0]) + difference(near[1], far[1]));
        }
    }
    let points = (edges * POINTS.len()) as f64;
    Ok((edges > 0).then(|| SeamGradients { across: across / points, beside: beside / points, edges }))
}

/// Edges of exactly two triangles.
fn inner_edges(mesh: &Mesh) -> impl Iterator<Item = ((u32, u32), [u32; 2])> {
    let mut of: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    for (t, &[a, b, c]) in (0u32..).zip(&mesh.triangles) {
        for (i, j) in [(a, b), (b, c), (c, a)] {
            of.entry((i.min(j), i.max(j))).or_default().push(t);
        }
    }
    of.into_iter().filter_map(|(edge, list)| Some((edge, list.try_into().ok()?)))
}

fn corners(mesh: &Mesh, triangle: u32) -> [Vec3; 3] {
    mesh.triangles[triangle as usize].map(|i| mesh.positions[i as usize])
}

/// Unit direction from an edge into a triangle, in its plane.
fn inward(mesh: &Mesh, triangle: u32, (a, b): (u32, u32)) -> Option<Vec3> {
    let third = mesh.triangles[triangle as usize].into_iter().find(|i| *i != a && *i != b)?;
    let [from, to, tip] = [a, b, third].map(|i| mesh.positions[i as usize]);
    let along = (to - from).try_normalize()?;
    let up = tip - from;
    (up - along * up.dot(along)).try_normalize()
}

/// Barycentric weights of a point in a triangle's plane.
fn weights(mesh: &Mesh, triangle: u32, p: Vec3) -> [f32; 3] {
    let [a, b, c] = corners(mesh, triangle);
    let (x, y, z) = (b - a, c - a, p - a);
    let (xx, xy, yy) = (x.dot(x), x.dot(y), y.dot(y));
    let scale = (xx * yy - xy * xy).max(f32::MIN_POSITIVE);
    let v = (yy * z.dot(x) - xy * z.dot(y)) / scale;
    let w = (xx * z.dot(y) - xy * z.dot(x)) / scale;
    [1.0 - v - w, v, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_of_the_point() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(0.2, 2.0, 0.0)],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
        };
        let p = mesh.positions[0] * 0.2 + mesh.positions[1] * 0.5 + mesh.positions[2] * 0.3;
        for (found, expected) in weights(&mesh, 0, p).iter().zip([0.2, 0.5, 0.3]) {
            assert!((found - expected).abs() < 1e-5);
        }
        assert_eq!(inward(&mesh, 0, (0, 1)), Some(Vec3::Y));
    }
}
