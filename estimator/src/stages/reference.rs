//! The surface whose albedo the user states: a pixel of a keyframe to vertices of the mesh.

use crate::api::{EstimateError, Reference};
use crate::association::Association;
use crate::factorisation::KnownAlbedo;
use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use glam::Vec3;
use recordings::scan::Scan;
use recordings::types::Mesh;

/// Rings of vertices around the triangle that the pixel shows.
const RINGS: usize = 2;

/// The surface that pixels show.
pub struct Shown<'a> {
    /// Regular mesh.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Its edges.
    pub graph: &'a Graph,
    /// Lit colours and refined poses.
    pub fields: &'a Association,
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
}

/// The vertices around the surface that the pixel shows from the refined pose, of that surface's segment and seen unclipped.
///
/// # Errors
/// There is no such keyframe or pixel, or it shows nothing of the mesh, or nothing that was seen.
pub fn reference(reference: &Reference, shown: &Shown, scan: &Scan) -> Result<KnownAlbedo, EstimateError> {
    let Reference { keyframe, pixel: [x, y], albedo } = *reference;
    let wrong = |why: String| EstimateError::NoReference(why);
    let (Some(picture), Some(view)) = (scan.keyframes.get(keyframe), shown.fields.views.get(keyframe)) else {
        let count = scan.keyframes.len();
        return Err(wrong(format!("there is no keyframe {keyframe}: the scan has {count}, from 0")));
    };
    let intrinsics = &picture.camera.intrinsics;
    let inside = |at: f64, size: u32| at >= -0.5 && at <= f64::from(size) - 0.5;
    if !(inside(x, intrinsics.width) && inside(y, intrinsics.height)) {
        let size = format!("{} × {}", intrinsics.width, intrinsics.height);
        return Err(wrong(format!("pixel {x},{y} is outside keyframe {keyframe}, which has {size} pixels")));
    }
    let pose = &view.world_from_camera;
    let direction = (pose.rotation * picture.camera.unproject(x, y)).as_vec3().normalize_or_zero();
    let hit = shown.scene.closest_hit(pose.translation.as_vec3(), direction);
    let triangle = hit.and_then(|h| shown.mesh.triangles.get(h.triangle as usize));
    let Some(triangle) = triangle else {
        return Err(wrong(format!("pixel {x},{y} of keyframe {keyframe} shows nothing of the mesh")));
    };
    let vertices = around(triangle, shown);
    if vertices.is_empty() {
        let why = "shows a surface that no picture shows unclipped";
        return Err(wrong(format!("pixel {x},{y} of keyframe {keyframe} {why}")));
    }
    Ok(KnownAlbedo { vertices, albedo })
}

/// Vertices of a triangle and of the rings around it, seen, of the segment that most of the corners have; ascending.
fn around(triangle: &[u32; 3], shown: &Shown) -> Vec<u32> {
    let &Shown { graph, fields, segment, .. } = shown;
    let [a, b, c] = triangle.map(|i| segment[i as usize]);
    let of = if b == c { b } else { a };
    let mut vertices: Vec<u32> = triangle.to_vec();
    for _ in 0..RINGS {
        let ring: Vec<u32> = vertices.iter().flat_map(|i| graph.neighbours(*i as usize)).copied().collect();
        vertices.extend(ring);
        vertices.sort_unstable();
        vertices.dedup();
    }
    let usable = |i: &u32| {
        let (i, color) = (*i as usize, fields.lit_color[*i as usize]);
        segment[i] == of && fields.lit_weight[i] > 0.0 && color.is_finite() && color.cmpgt(Vec3::ZERO).all()
    };
    vertices.retain(usable);
    vertices
}
