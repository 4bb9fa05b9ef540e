//! Z-buffer of a mesh in a pinhole camera: the first triangle along the ray through every pixel's centre.

use glam::{DVec3, Vec3};
use recordings::types::{Intrinsics, Mesh, Pose};

/// Weights may be off by so much from rounding.
const SLACK: f64 = 1e-9;

/// Index of no triangle.
pub const MISS: u32 = u32::MAX;

/// A rendered view; arrays are row-major, `[height][width]`.
pub struct Raster {
    /// Pinhole camera.
    pub camera: Intrinsics,
    /// Index of the visible triangle, or [`MISS`].
    pub triangle: Vec<u32>,
    /// Depth along the optical axis in the mesh's units; infinite where no triangle is visible.
    pub depth: Vec<f32>,
}

/// The pinhole camera at `factor` times the resolution (pixel centres at integers).
pub fn scaled(camera: &Intrinsics, factor: f64) -> Intrinsics {
    Intrinsics {
        width: ((f64::from(camera.width) * factor).round() as u32).max(1),
        height: ((f64::from(camera.height) * factor).round() as u32).max(1),
        fx: camera.fx * factor,
        fy: camera.fy * factor,
        cx: (camera.cx + 0.5) * factor - 0.5,
        cy: (camera.cy + 0.5) * factor - 0.5,
    }
}

/// Vertices in the camera's frame (X right, Y down, Z forward), `[vertex]`.
pub fn camera_positions(mesh: &Mesh, world_from_camera: &Pose) -> Vec<DVec3> {
    let camera_from_world = world_from_camera.inverse();
    mesh.positions.iter().map(|p| camera_from_world.transform(p.as_dvec3())).collect()
}

impl Raster {
    /// Memory of a pixel.
    pub const PIXEL_BYTES: usize = size_of::<u32>() + size_of::<f32>();

    /// Renders both sides of `triangles` over `points` in the camera's frame, clipped at the plane z = `near`.
    pub fn new(points: &[DVec3], triangles: &[[u32; 3]], camera: &Intrinsics, near: f64) -> Self {
        let pixels = camera.width as usize * camera.height as usize;
        let mut raster = Self { camera: *camera, triangle: vec![MISS; pixels], depth: Vec::new() };
        // Linear in the image, as depth is not.
        let mut inverse = vec![0.0; pixels];
        let project = |p: DVec3| {
            let over = 1.0 / p.z;
            (camera.fx * p.x * over + camera.cx, camera.fy * p.y * over + camera.cy, over)
        };
        let projected: Vec<(f64, f64, f64)> = points.iter().map(|p| project(*p)).collect();
        let pixels = points.iter().zip(&projected);
        let pixels: Vec<Pixels> =
            pixels.map(|(p, at)| if p.z > near { Pixels::of(*at) } else { Pixels::BEHIND }).collect();
        for (index, corners) in triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|i| pixels[i as usize]);
            if [a, b, c].iter().all(|p| p.first[0] != Pixels::BEHIND.first[0]) {
                // Most triangles are smaller than a pixel, or outside.
                if let Some(pixels) = Pixels::between([a, b, c], camera) {
                    raster.fill(&mut inverse, index as u32, corners.map(|i| projected[i as usize]), pixels);
                }
                continue;
            }
            let corners = corners.map(|i| points[i as usize]);
            if corners.iter().any(|p| p.z > near) {
                let polygon = clip_near(corners, near);
                for i in 2..polygon.len() {
                    let corners = [polygon[0], polygon[i - 1], polygon[i]].map(project);
                    if let Some(pixels) = Pixels::between(corners.map(Pixels::of), camera) {
                        raster.fill(&mut inverse, index as u32, corners, pixels);
                    }
                }
            }
        }
        raster.depth = inverse.into_iter().map(|x| 1.0 / x).collect();
        raster
    }

    /// Corners are (u, v, 1/depth), as are the values of `inverse`, which are 0 where there is nothing yet.
    fn fill(&mut self, inverse: &mut [f32], index: u32, [a, b, c]: [(f64, f64, f64); 3], pixels: Pixels) {
        let k = &self.camera;
        let area = (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        // Written so that NaN fails too.
        if !(area.abs() > 1e-12 && area.is_finite()) {
            return;
        }
        let width = k.width as usize;
        // Weights of b and c, and what they change by from column to column and from row to row.
        let ([bu, bv], [cu, cv]) = ([c.1 - a.1, a.0 - c.0].map(|x| x / area), [a.1 - b.1, b.0 - a.0].map(|x| x / area));
        let ([left, top], [right, bottom]) = (pixels.first.map(|p| p as usize), pixels.end.map(|p| p as usize));
        for y in top..bottom {
            let (u, v) = (left as f64 - a.0, y as f64 - a.1);
            let (mut wb, mut wc) = (u * bu + v * bv, u * cu + v * cv);
            let row = y * width + left..y * width + right;
            for (nearest, triangle) in inverse[row.clone()].iter_mut().zip(&mut self.triangle[row]) {
                // Inclusive, with slack for rounding, so that no pixel falls between two triangles.
                if wb >= -SLACK && wc >= -SLACK && wb + wc <= 1.0 + SLACK {
                    let here = (a.2 + wb * (b.2 - a.2) + wc * (c.2 - a.2)) as f32;
                    if here > *nearest {
                        (*nearest, *triangle) = (here, index);
                    }
                }
                wb += bu;
                wc += cu;
            }
        }
    }

    /// The visible point at a pixel in the camera's frame; `None` if no triangle is visible.
    pub fn point(&self, x: usize, y: usize) -> Option<DVec3> {
        let z = f64::from(self.depth[y * self.camera.width as usize + x]);
        let k = &self.camera;
        z.is_finite().then(|| DVec3::new((x as f64 - k.cx) / k.fx * z, (y as f64 - k.cy) / k.fy * z, z))
    }

    /// Barycentric weights of the visible point at a pixel in the triangle with these `corners` in the camera's frame.
    #[inline]
    pub fn weights(&self, x: usize, y: usize, corners: [DVec3; 3]) -> [f32; 3] {
        let k = &self.camera;
        let ray = DVec3::new((x as f64 - k.cx) / k.fx, (y as f64 - k.cy) / k.fy, 1.0);
        let [a, b, c] = corners;
        // Ratios of the volumes spanned by the ray and the edges: perspective-correct without a division by depth.
        let w = [ray.dot(b.cross(c)), ray.dot(c.cross(a)), ray.dot(a.cross(b))];
        let sum = w[0] + w[1] + w[2];
        if sum.abs() > 0.0 { w.map(|x| (x / sum).clamp(0.0, 1.0) as f32) } else { [1.0, 0.0, 0.0] }
    }
}

/// Pixels with centres between points, columns and rows.
#[derive(Debug, Clone, Copy)]
struct Pixels {
    first: [u32; 2],
    end: [u32; 2],
}

impl Pixels {
    /// Of a point that is not in front of the camera. One that is very far to the side may have the same.
    const BEHIND: Self = Self { first: [u32::MAX; 2], end: [0; 2] };

    /// Of one point (u, v, 1/depth).
    fn of((u, v, _): (f64, f64, f64)) -> Self {
        // Casts truncate and saturate, so values far outside the image are harmless; for positive values, ceil(x) is
        // trunc(x + 1 − tiny) and floor(x) is trunc(x).
        let first = |x: f64| (x + (1.0 - 1e-6)).max(0.0) as u32;
        let end = |x: f64| (x + (1.0 + 1e-6)).max(0.0) as u32;
        Self { first: [first(u), first(v)], end: [end(u), end(v)] }
    }

    /// Those of a picture that lie between three points; `None` if there are none.
    fn between([a, b, c]: [Self; 3], camera: &Intrinsics) -> Option<Self> {
        let first = [0, 1].map(|axis| a.first[axis].min(b.first[axis]).min(c.first[axis]));
        let end = [0, 1].map(|axis| a.end[axis].max(b.end[axis]).max(c.end[axis]));
        let end = [end[0].min(camera.width), end[1].min(camera.height)];
        (first[0] < end[0] && first[1] < end[1]).then_some(Self { first, end })
    }
}

fn clip_near(corners: [DVec3; 3], near: f64) -> Vec<DVec3> {
    let mut polygon = Vec::with_capacity(4);
    for i in 0..3 {
        let (p, q) = (corners[i], corners[(i + 1) % 3]);
        if p.z > near {
            polygon.push(p);
        }
        if (p.z > near) != (q.z > near) {
            polygon.push(p + (q - p) * ((near - p.z) / (q.z - p.z)));
        }
    }
    polygon
}

/// Unit normal of every triangle as the mean of its vertices' normals; the flat normal where these cancel.
pub fn triangle_normals(mesh: &Mesh) -> Vec<Vec3> {
    let flat = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    mesh.triangles
        .iter()
        .map(|t| {
            let mean = t.iter().map(|&i| mesh.normals[i as usize]).sum::<Vec3>();
            if mean.length_squared() > 0.1 { mean.normalize() } else { flat(t) }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Intrinsics = Intrinsics { width: 64, height: 48, fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5 };

    #[test]
    fn a_wall_covers_every_pixel_at_its_depth() {
        let points = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)].map(|(x, y)| DVec3::new(x, y, 2.0));
        let raster = Raster::new(&points, &[[0, 1, 2], [0, 2, 3]], &CAMERA, 1e-3);
        assert!(raster.depth.iter().all(|&d| (d - 2.0).abs() < 1e-6));
    }

    #[test]
    fn a_floor_below_the_camera_is_clipped_at_the_near_plane() {
        // One huge triangle that reaches behind the camera.
        let points = [DVec3::new(-1e4, 1.0, -50.0), DVec3::new(1e4, 1.0, -50.0), DVec3::new(0.0, 1.0, 1e4)];
        let raster = Raster::new(&points, &[[0, 1, 2]], &CAMERA, 1e-3);
        let z = raster.depth[47 * 64 + 32];
        assert!((f64::from(z) - 50.0 / (47.0 - 23.5)).abs() < 1e-4, "{z}");
        assert!(raster.depth[32].is_infinite());
    }

    #[test]
    fn the_nearer_triangle_wins_in_any_order() {
        let quad = |z: f64| [DVec3::new(-9.0, -9.0, z), DVec3::new(9.0, -9.0, z), DVec3::new(0.0, 9.0, z)];
        let points = [quad(3.0), quad(2.0)].concat();
        for (order, near) in [([[0, 1, 2], [3, 4, 5]], 1), ([[3, 4, 5], [0, 1, 2]], 0)] {
            assert_eq!(Raster::new(&points, &order, &CAMERA, 1e-3).triangle[23 * 64 + 31], near);
        }
    }

    #[test]
    fn weights_reproduce_the_point() {
        let corners = [DVec3::new(-1.0, -1.0, 1.5), DVec3::new(1.0, -0.5, 2.5), DVec3::new(0.0, 1.5, 2.0)];
        let raster = Raster::new(&corners, &[[0, 1, 2]], &CAMERA, 1e-3);
        let w = raster.weights(32, 24, corners);
        let p = corners[0] * f64::from(w[0]) + corners[1] * f64::from(w[1]) + corners[2] * f64::from(w[2]);
        assert!(p.distance(raster.point(32, 24).unwrap()) < 1e-5);
    }

    #[test]
    fn corners_that_are_not_finite_do_not_panic() {
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            let points = [DVec3::new(bad, 0.0, 1.0), DVec3::new(1.0, bad, 1.0), DVec3::new(0.0, 1.0, 1.0)];
            Raster::new(&points, &[[0, 1, 2], [0, 0, 0]], &CAMERA, 1e-3);
        }
    }
}
