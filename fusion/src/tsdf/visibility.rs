//! Which vertices of the mesh a view sees: in the picture, turned towards it, not hidden by the mesh.

use crate::camera::rig::{Pinhole, Rigid};
use crate::tsdf::marching_cubes::Pieces;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::{Mesh, Pose};

/// A vertex is seen if the angle between its normal and the direction to the camera has a greater cosine (c2, relaxed).
/// A little below what depth is accepted at (`fusion.max_slope`).
const SEEN_COS: f32 = 0.17;
/// Share of its depth by which a vertex may lie behind what hides it.
const SLACK: f32 = 0.005;
/// Triangles that nothing sees go from this many together on.
const LEAST_PATCH: u32 = 64;
/// Triangles nearer than this are not drawn, metres.
const NEAR_M: f32 = 0.05;

/// The mesh as it hides itself from one place.
pub struct View<'a> {
    camera: &'a Pinhole,
    camera_from_world: Rigid,
    centre: Vec3,
    /// Depth of the nearest vertex in each pixel.
    nearest: Vec<f32>,
}

impl<'a> View<'a> {
    /// Draws the mesh as `camera` sees it from there.
    pub fn new(mesh: &Mesh, world_from_camera: &Pose, camera: &'a Pinhole) -> Self {
        let camera_from_world = Rigid::from(&world_from_camera.inverse());
        let mut nearest = vec![f32::INFINITY; camera.width * camera.height];
        for t in &mesh.triangles {
            draw(camera, t.map(|i| camera_from_world.apply(mesh.positions[i as usize])), &mut nearest);
        }
        Self { camera, camera_from_world, centre: world_from_camera.translation.as_vec3(), nearest }
    }

    /// Cosine of the angle between the normal of a vertex and the direction to the camera, if it is seen.
    pub fn sees(&self, position: Vec3, normal: Vec3) -> Option<f32> {
        let cos = (self.centre - position).normalize_or_zero().dot(normal);
        let p = self.camera_from_world.apply(position);
        let pixel = self.camera.pixel(p).filter(|_| cos > SEEN_COS)?;
        // A slanted surface spans some depth between a pixel's middle and its corner.
        let slant = libm::sqrtf((1.0 - cos * cos).max(0.0)) / cos;
        let slack = p.z * (SLACK + libm::sqrtf(0.5) * slant / self.camera.fx);
        (p.z < self.nearest[pixel] + slack).then_some(cos)
    }
}

/// Depth of a triangle, in camera coordinates, at the middles of the pixels it covers. One that is nearly in the camera is
/// left out.
fn draw(camera: &Pinhole, corners: [Vec3; 3], nearest: &mut [f32]) {
    if corners.iter().any(|p| p.z < NEAR_M) {
        return;
    }
    // Inverse depth is linear in the picture.
    let [a, b, c] = corners.map(|p| {
        let w = 1.0 / p.z;
        Vec3::new(camera.fx * p.x * w + camera.cx, camera.fy * p.y * w + camera.cy, w)
    });
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let last = (camera.width as f32 - 1.0, camera.height as f32 - 1.0);
    let (x0, y0) = (low.x.max(0.0).ceil(), low.y.max(0.0).ceil());
    let (x1, y1) = (high.x.min(last.0).floor(), high.y.min(last.1).floor());
    if !(x0 <= x1 && y0 <= y1) {
        return;
    }
    let (ab, ac) = (b - a, c - a);
    let area = ab.x * ac.y - ab.y * ac.x;
    if area == 0.0 {
        return;
    }
    for y in y0 as usize..=y1 as usize {
        for x in x0 as usize..=x1 as usize {
            let (dx, dy) = (x as f32 - a.x, y as f32 - a.y);
            let (u, v) = ((dx * ac.y - dy * ac.x) / area, (ab.x * dy - ab.y * dx) / area);
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                let z = 1.0 / (a.z + u * ab.z + v * ac.z);
                let at = y * camera.width + x;
                nearest[at] = nearest[at].min(z);
            }
        }
    }
}

/// Drops patches of triangles of which none of the `poses` sees two corners. Where rays pass the rim of a thing, the room
/// behind its front that they did not reach ends against the room beside it that they saw free: a wall along the rays, as
/// deep as the truncation, which no camera faced and nothing measured. A few such triangles among others are noise in
/// their normals, and stay. Vertices stay.
pub fn drop_unseen(mesh: &mut Mesh, poses: impl Iterator<Item = Pose>, camera: &Pinhole) {
    let poses: Vec<Pose> = poses.collect();
    let mut seen = vec![false; mesh.positions.len()];
    // As many views at a time as there are threads.
    for poses in poses.chunks(rayon::current_num_threads()) {
        let views: Vec<View<'_>> = poses.par_iter().map(|pose| View::new(mesh, pose, camera)).collect();
        seen.par_iter_mut().zip(&mesh.positions).zip(&mesh.normals).for_each(|((seen, p), n)| {
            *seen = *seen || views.iter().any(|v| v.sees(*p, *n).is_some());
        });
    }
    let unseen = |t: &[u32; 3]| t.iter().filter(|v| !seen[**v as usize]).count() >= 2;
    let mut patches = Pieces::new(mesh.positions.len(), mesh.triangles.iter().filter(|t| unseen(t)));
    mesh.triangles.retain(|t| !unseen(t) || patches.triangles(t[0]) < LEAST_PATCH);
}
