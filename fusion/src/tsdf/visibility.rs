//! Visibility of mesh vertices from a pose: in the image, facing the camera, not occluded by the mesh.

use crate::camera::pinhole::{Pinhole, Rigid};
use crate::tsdf::components::Components;
use firmware_config::tuning::SurfaceCoverageTuning;
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use recordings::types::{Mesh, Pose};
use std::ops::Range;

/// Triangles closer than this are not drawn, metres.
const NEAR_M: f32 = 0.05;
/// Triangles of one run at most, and how far from the first of them one may be. Those of one block follow each other.
const MAX_RUN: usize = 256;
const REACH_M: f32 = 0.08;
/// Rounding moves a point by less than this share of the largest coordinate.
const ROUNDING: f32 = 1e-5;

/// A run of triangles of a mesh, that poses from which none of it is in the image pass over.
struct Run {
    triangles: Range<usize>,
    /// Sphere around its vertices, the radius with room for rounding.
    center: Vec3,
    radius: f32,
}

/// A mesh in runs of triangles.
pub struct Runs<'a> {
    pub mesh: &'a Mesh,
    runs: Vec<Run>,
}

impl<'a> Runs<'a> {
    /// Divides a mesh.
    pub fn new(mesh: &'a Mesh) -> Self {
        let at = |t: usize| mesh.positions[mesh.triangles[t][0] as usize];
        let (mut runs, mut start) = (Vec::new(), 0);
        for t in 1..=mesh.triangles.len() {
            if t == mesh.triangles.len() || t - start == MAX_RUN || at(t).distance(at(start)) > REACH_M {
                runs.push(Run::new(mesh, start..t));
                start = t;
            }
        }
        Self { mesh, runs }
    }
}

impl Run {
    fn new(mesh: &Mesh, triangles: Range<usize>) -> Self {
        let positions = || mesh.triangles[triangles.clone()].iter().flatten().map(|&v| mesh.positions[v as usize]);
        let (low, high) = positions().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        let center = 0.5 * (low + high);
        let radius = 0.5 * low.distance(high) + ROUNDING * (low.abs().max(high.abs()).max_element() + 1.0);
        Self { triangles, center, radius }
    }
}

/// Depth image of the mesh from one pose, for visibility tests.
pub struct VisibilityMap<'a> {
    camera: &'a Pinhole,
    camera_from_world: Rigid,
    centre: Vec3,
    /// `[pixel]`: depth of the nearest surface, metres; infinite without one.
    nearest: Vec<f32>,
    min_cos: f32,
    slack_share: f32,
}

impl<'a> VisibilityMap<'a> {
    /// Renders the depth of the mesh.
    pub fn new(
        Runs { mesh, runs }: &Runs,
        world_from_camera: &Pose,
        camera: &'a Pinhole,
        tuning: &SurfaceCoverageTuning,
    ) -> Self {
        let camera_from_world = Rigid::from(&world_from_camera.inverse());
        let project = |p: &Vec3| {
            let p = camera_from_world.apply(*p);
            if p.z < NEAR_M {
                return Vec3::ZERO;
            }
            let w = 1.0 / p.z;
            Vec3::new(camera.fx * p.x * w + camera.cx, camera.fy * p.y * w + camera.cy, w)
        };
        let planes = planes(camera);
        let projected: Vec<Vec3> = mesh.positions.iter().map(project).collect();
        let mut nearest = vec![f32::INFINITY; camera.width * camera.height];
        for run in runs {
            let center = camera_from_world.apply(run.center);
            if planes.iter().any(|p| p.truncate().dot(center) + p.w < -run.radius) {
                continue;
            }
            for t in &mesh.triangles[run.triangles.clone()] {
                draw(camera, t.map(|i| projected[i as usize]), &mut nearest);
            }
        }
        Self {
            camera,
            camera_from_world,
            centre: world_from_camera.translation.as_vec3(),
            nearest,
            min_cos: tuning.min_cos as f32,
            slack_share: tuning.depth_slack_share as f32,
        }
    }

    /// Cosine between the normal of a vertex and the direction to the camera; `None` if the vertex is not visible.
    pub fn visible_cos(&self, position: Vec3, normal: Vec3) -> Option<f32> {
        let cos = (self.centre - position).normalize_or_zero().dot(normal);
        let p = self.camera_from_world.apply(position);
        let pixel = self.camera.pixel(p).filter(|_| cos > self.min_cos)?;
        // The depth of a slanted surface varies between the centre and the corner of a pixel.
        let slant = libm::sqrtf((1.0 - cos * cos).max(0.0)) / cos;
        let slack = p.z * (self.slack_share + libm::sqrtf(0.5) * slant / self.camera.fx);
        (p.z < self.nearest[pixel] + slack).then_some(cos)
    }
}

/// Planes around what the camera sees from [`NEAR_M`] on: inside, n · p + w is not negative, with unit vectors n.
fn planes(camera: &Pinhole) -> [Vec4; 5] {
    let Pinhole { fx, fy, cx, cy, width, height } = *camera;
    let (right, bottom) = (width as f32 - 1.0, height as f32 - 1.0);
    let through_center = |n: Vec3| n.normalize().extend(0.0);
    [
        Vec3::Z.extend(-NEAR_M),
        through_center(Vec3::new(fx, 0.0, cx)),
        through_center(Vec3::new(-fx, 0.0, right - cx)),
        through_center(Vec3::new(0.0, fy, cy)),
        through_center(Vec3::new(0.0, -fy, bottom - cy)),
    ]
}

/// Renders the depth of a triangle at the centres of the pixels that it covers. Corners are (u, v, 1/depth), since inverse depth is linear
/// in the image; the last is 0 for corners closer than [`NEAR_M`], whose triangles are left out.
fn draw(camera: &Pinhole, [a, b, c]: [Vec3; 3], nearest: &mut [f32]) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    if low.z == 0.0 || high.x < 0.0 || high.y < 0.0 {
        return;
    }
    let last = (camera.width as f32 - 1.0, camera.height as f32 - 1.0);
    // Most triangles have no pixel between their corners. Casts truncate, which is cheaper than to round.
    let first = |x: f32| x as usize + usize::from((x as usize as f32) < x);
    let (x0, y0) = (first(low.x.max(0.0)), first(low.y.max(0.0)));
    let (x1, y1) = (high.x.min(last.0) as usize, high.y.min(last.1) as usize);
    if x0 > x1 || y0 > y1 {
        return;
    }
    let (ab, ac) = (b - a, c - a);
    let area = ab.x * ac.y - ab.y * ac.x;
    if area == 0.0 {
        return;
    }
    for y in y0..=y1 {
        for x in x0..=x1 {
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

/// Drops patches of triangles of which no pose sees two corners. Behind the rim of an object, unobserved space borders on
/// space observed as free: marching cubes puts a wall there, along the rays and as deep as the truncation, that no camera
/// faced and no reading measured. Patches of fewer than `surface_coverage.min_unseen_triangles` are noise in the normals and
/// stay. Vertices stay.
pub fn drop_unseen(
    mesh: &mut Mesh,
    poses: impl Iterator<Item = Pose>,
    camera: &Pinhole,
    tuning: &SurfaceCoverageTuning,
) {
    let poses: Vec<Pose> = poses.collect();
    let mut seen = vec![false; mesh.positions.len()];
    let runs = Runs::new(mesh);
    // As many poses at once as there are threads.
    for poses in poses.chunks(rayon::current_num_threads()) {
        let maps: Vec<VisibilityMap<'_>> =
            poses.par_iter().map(|pose| VisibilityMap::new(&runs, pose, camera, tuning)).collect();
        seen.par_iter_mut().zip(&mesh.positions).zip(&mesh.normals).for_each(|((seen, p), n)| {
            *seen = *seen || maps.iter().any(|m| m.visible_cos(*p, *n).is_some());
        });
    }
    let unseen = |t: &[u32; 3]| t.iter().filter(|v| !seen[**v as usize]).count() >= 2;
    let mut patches = Components::new(mesh.positions.len(), mesh.triangles.iter().filter(|t| unseen(t)));
    mesh.triangles.retain(|t| !unseen(t) || patches.triangles(t[0]) < tuning.min_unseen_triangles);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use recordings::types::vertex_normals;

    /// Quads along a side of the floor, and along a side of a block of it.
    const SIDE: u32 = 64;
    const BLOCK: u32 = 8;

    /// A wavy floor of 6.4 m, its blocks in no order.
    fn floor() -> Mesh {
        let at = |i: u32| 0.1 * i as f32 - 3.2;
        let height = |x: u32, y: u32| 0.2 * libm::sinf(0.4 * x as f32) * libm::cosf(0.3 * y as f32);
        let corners = (0..=SIDE).flat_map(|y| (0..=SIDE).map(move |x| (x, y)));
        let positions: Vec<Vec3> = corners.map(|(x, y)| Vec3::new(at(x), at(y), height(x, y))).collect();
        let blocks = SIDE / BLOCK;
        let quads = (0..blocks * blocks).map(|n| n * 37 % (blocks * blocks)).flat_map(|block| {
            let (left, top) = (block % blocks * BLOCK, block / blocks * BLOCK);
            (0..BLOCK * BLOCK).map(move |q| (left + q % BLOCK, top + q / BLOCK))
        });
        let corner = |x: u32, y: u32| y * (SIDE + 1) + x;
        let triangles: Vec<[u32; 3]> = quads
            .flat_map(|(x, y)| {
                let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        Mesh { normals: vertex_normals(&positions, &triangles), positions, triangles }
    }

    #[test]
    fn what_is_passed_over_is_in_no_picture() {
        let mesh = floor();
        let camera = Pinhole { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };
        let tuning = firmware_config::FusionConfig::default().tuning.surface_coverage;
        let whole = Run { triangles: 0..mesh.triangles.len(), center: Vec3::ZERO, radius: f32::INFINITY };
        let (runs, whole) = (Runs::new(&mesh), Runs { mesh: &mesh, runs: vec![whole] });
        let mut drawn = Vec::new();
        for n in 0..12 {
            // Down, along the floor, and up, from above, from within and from beside.
            let rotation = DQuat::from_rotation_z(f64::from(n)) * DQuat::from_rotation_x(0.5 * f64::from(n % 7));
            let pose = Pose::new(rotation, DVec3::new(0.4 * f64::from(n) - 2.0, 0.3, 0.15 * f64::from(n) - 0.3));
            let [some, all] = [&runs, &whole].map(|r| VisibilityMap::new(r, &pose, &camera, &tuning).nearest);
            assert_eq!(some, all, "pose {n}");
            drawn.push(all.iter().filter(|z| z.is_finite()).count());
        }
        assert!(drawn.iter().filter(|n| **n > 1000).count() > 3 && drawn.contains(&0), "{drawn:?}");
    }
}
