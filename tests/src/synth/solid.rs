//! Solids as signed distance functions, and their meshing by surface nets.

use glam::{Vec2, Vec3};
use recordings::types::Mesh;

/// Signed distance in metres (negative inside); need not be exact, only smooth near the surface.
pub type Solid = Box<dyn Fn(Vec3) -> f32 + Send + Sync>;

/// A ball.
#[must_use]
pub fn sphere(p: Vec3, radius: f32) -> f32 {
    p.length() - radius
}

/// An ellipsoid (first-order distance).
#[must_use]
pub fn ellipsoid(p: Vec3, radii: Vec3) -> f32 {
    let k = (p / radii).length();
    let g = (p / (radii * radii)).length().max(1e-9);
    k * (k - 1.0) / g
}

/// A box with rounded edges; `half` includes the rounding.
#[must_use]
pub fn rounded_box(p: Vec3, half: Vec3, rounding: f32) -> f32 {
    let q = p.abs() - (half - rounding);
    q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - rounding
}

/// A ring around the z axis.
#[must_use]
pub fn torus(p: Vec3, major: f32, minor: f32) -> f32 {
    Vec2::new(p.truncate().length() - major, p.z).length() - minor
}

/// A shell turned on the z axis: distance to the open profile (r, z) less half the thickness.
#[must_use]
pub fn turned_shell(p: Vec3, profile: &[Vec2], thickness: f32) -> f32 {
    let q = Vec2::new(p.truncate().length(), p.z);
    let nearest = profile.windows(2).map(|w| {
        let (pa, ba) = (q - w[0], w[1] - w[0]);
        (pa - ba * (pa.dot(ba) / ba.length_squared()).clamp(0.0, 1.0)).length_squared()
    });
    nearest.fold(f32::INFINITY, f32::min).sqrt() - 0.5 * thickness
}

/// Smooth union: a fillet of about `radius`.
#[must_use]
pub fn blend(a: f32, b: f32, radius: f32) -> f32 {
    let h = (radius - (a - b).abs()).max(0.0) / radius;
    a.min(b) - h * h * radius * 0.25
}

/// A smooth curve through profile points (Catmull–Rom), `steps` pieces a span.
#[must_use]
pub fn smooth_profile(points: &[Vec2], steps: usize) -> Vec<Vec2> {
    let at = |k: isize| points[k.clamp(0, points.len() as isize - 1) as usize];
    let mut out = Vec::new();
    for k in 0..points.len().saturating_sub(1) as isize {
        let (a, b, c, d) = (at(k - 1), at(k), at(k + 1), at(k + 2));
        for s in 0..steps {
            let t = s as f32 / steps as f32;
            out.push(
                0.5 * (2.0 * b
                    + (c - a) * t
                    + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t
                    + (3.0 * b - a - 3.0 * c + d) * t * t * t),
            );
        }
    }
    out.extend(points.last());
    out
}

/// Meshes the zero level within the box `low..high` on a grid of `cell` metres; vertices are drawn onto the surface and
/// have its normals. Triangles are counter-clockwise seen from outside.
#[must_use]
pub fn mesh(solid: &dyn Fn(Vec3) -> f32, low: Vec3, high: Vec3, cell: f32) -> Mesh {
    let n = ((high - low) / cell).ceil().as_uvec3().to_array().map(|x| x as usize + 1);
    let index = |i: usize, j: usize, k: usize| (k * n[1] + j) * n[0] + i;
    let corner = |i: usize, j: usize, k: usize| low + cell * Vec3::new(i as f32, j as f32, k as f32);
    let mut values = vec![0.0f32; n[0] * n[1] * n[2]];
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                values[index(i, j, k)] = solid(corner(i, j, k));
            }
        }
    }
    let mut out = Mesh::default();
    let mut vertex = vec![u32::MAX; values.len()];
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                if let Some(p) = crossing_centre(&values, |c| index(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))) {
                    let (p, normal) = onto_surface(solid, corner(i, j, k) + p * cell, cell);
                    vertex[index(i, j, k)] = out.positions.len() as u32;
                    out.positions.push(p);
                    out.normals.push(normal);
                }
            }
        }
    }
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                let here = values[index(i, j, k)] < 0.0;
                let at = [i, j, k];
                for axis in 0..3 {
                    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                    let step = |from: [usize; 3], axis: usize, by: isize| {
                        let mut to = from;
                        to[axis] = to[axis].wrapping_add_signed(by);
                        to
                    };
                    let [x, y, z] = step(at, axis, 1);
                    if at[b] == 0 || at[c] == 0 || here == (values[index(x, y, z)] < 0.0) {
                        continue;
                    }
                    let back = step(at, b, -1);
                    let quad = [back, at, step(at, c, -1), step(back, c, -1)].map(|q| vertex[index(q[0], q[1], q[2])]);
                    push_quad(&mut out, if here { [quad[2], quad[1], quad[0], quad[3]] } else { quad });
                }
            }
        }
    }
    out
}

/// Mean of the edge crossings of a cell, in cell units; `None` if the surface does not pass.
fn crossing_centre(values: &[f32], index: impl Fn(usize) -> usize) -> Option<Vec3> {
    let v: [f32; 8] = std::array::from_fn(|c| values[index(c)]);
    let at = |c: usize| Vec3::new((c & 1) as f32, (c >> 1 & 1) as f32, (c >> 2) as f32);
    let (mut sum, mut count) = (Vec3::ZERO, 0);
    for a in 0..8 {
        for bit in [1, 2, 4] {
            let b = a | bit;
            if a != b && (v[a] < 0.0) != (v[b] < 0.0) {
                sum += at(a).lerp(at(b), v[a] / (v[a] - v[b]));
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / count as f32)
}

/// Newton steps along the gradient (never further than a cell), and the unit gradient there.
fn onto_surface(solid: &dyn Fn(Vec3) -> f32, start: Vec3, cell: f32) -> (Vec3, Vec3) {
    let h = 0.05 * cell;
    let gradient = |p: Vec3| {
        Vec3::from_array([Vec3::X, Vec3::Y, Vec3::Z].map(|e| (solid(p + e * h) - solid(p - e * h)) / (2.0 * h)))
    };
    let mut p = start;
    for _ in 0..4 {
        let g = gradient(p);
        p -= (g * (solid(p) / g.length_squared().max(0.01))).clamp_length_max(0.3 * cell);
    }
    let p = start + (p - start).clamp_length_max(cell);
    (p, gradient(p).normalize_or_zero())
}

/// Two triangles over the shorter diagonal.
fn push_quad(mesh: &mut Mesh, q: [u32; 4]) {
    let p = q.map(|i| mesh.positions[i as usize]);
    if p[0].distance_squared(p[2]) <= p[1].distance_squared(p[3]) {
        mesh.triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
    } else {
        mesh.triangles.extend([[q[1], q[2], q[3]], [q[1], q[3], q[0]]]);
    }
}
