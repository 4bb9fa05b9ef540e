//! Charts: connected pieces of the mesh whose normals lie in a cone, seen along its axis.

use crate::mesh::raster::triangle_normals;
use glam::{Vec2, Vec3};
use recordings::types::Mesh;

/// Smallest cosine between a chart's axis and a triangle's own flat normal: beyond it a triangle of noise would be seen from the
/// side.
const FLAT_COSINE: f32 = 0.1;
/// No neighbour, or no chart.
const NONE: u32 = u32::MAX;

/// Limits of a chart.
#[derive(Debug, Clone, Copy)]
pub struct ChartLimits {
    /// Smallest cosine between the axis and a smoothed normal.
    pub min_cosine: f32,
    /// Longest side, in the mesh's units.
    pub side: f32,
}

/// A piece of the mesh and the directions along which its texture runs.
#[derive(Debug, Clone)]
pub struct Piece {
    /// Its triangles, from the seed outwards.
    pub triangles: Vec<u32>,
    /// Unit vectors along the columns and rows of its texture.
    pub axes: [Vec3; 2],
}

/// Cuts a mesh into pieces, one by one.
pub struct Cutter<'a> {
    mesh: &'a Mesh,
    smooth: Vec<Vec3>,
    flat: Vec<Vec3>,
    /// Triangles across the edges: `[triangle][edge]`.
    neighbours: Vec<[u32; 3]>,
    taken: Vec<bool>,
    next_seed: usize,
    /// The last growth that met it: `[triangle]`.
    met: Vec<u32>,
    growths: u32,
}

impl<'a> Cutter<'a> {
    /// Nothing is cut yet.
    #[must_use]
    pub fn new(mesh: &'a Mesh) -> Self {
        let flat = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        Self {
            mesh,
            smooth: triangle_normals(mesh),
            flat: mesh.triangles.iter().map(flat).collect(),
            neighbours: neighbours(mesh),
            taken: vec![false; mesh.triangles.len()],
            next_seed: 0,
            met: vec![0; mesh.triangles.len()],
            growths: 0,
        }
    }

    /// Starts again from the whole mesh.
    pub fn restart(&mut self) {
        self.taken.fill(false);
        self.next_seed = 0;
    }

    /// The next piece; `None` when every triangle is taken.
    pub fn next(&mut self, limits: &ChartLimits) -> Option<Piece> {
        while *self.taken.get(self.next_seed)? {
            self.next_seed += 1;
        }
        let seed = self.next_seed as u32;
        let mut axis = self.axis_of(seed);
        let mut triangles = self.grow(seed, axis, limits);
        // Once more along the mean normal: the seed's own is as good as its noise.
        if let Some(mean) = self.mean_normal(&triangles).filter(|m| self.fits(seed, *m, limits)) {
            axis = mean;
            triangles = self.grow(seed, axis, limits);
        }
        triangles.iter().for_each(|&t| self.taken[t as usize] = true);
        Some(Piece { axes: self.axes(&triangles, axis), triangles })
    }

    /// Gives triangles back, for later pieces.
    pub fn put_back(&mut self, triangles: &[u32]) {
        for &t in triangles {
            self.taken[t as usize] = false;
            self.next_seed = self.next_seed.min(t as usize);
        }
    }

    fn axis_of(&self, t: u32) -> Vec3 {
        let (smooth, flat) = (self.smooth[t as usize], self.flat[t as usize]);
        let axis = if flat == Vec3::ZERO || smooth.dot(flat) > FLAT_COSINE { smooth } else { flat };
        axis.try_normalize().unwrap_or(Vec3::Z)
    }

    fn fits(&self, t: u32, axis: Vec3, limits: &ChartLimits) -> bool {
        self.smooth[t as usize].dot(axis) > limits.min_cosine && self.flat[t as usize].dot(axis) > FLAT_COSINE
    }

    /// Triangles connected to the seed that fit the axis, breadth first.
    fn grow(&mut self, seed: u32, axis: Vec3, limits: &ChartLimits) -> Vec<u32> {
        self.growths += 1;
        let origin = self.mesh.positions[self.mesh.triangles[seed as usize][0] as usize];
        let [x, y] = perpendicular(axis);
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let bounds = |t: u32, low: Vec2, high: Vec2| {
            let corners = self.mesh.triangles[t as usize].map(|i| self.mesh.positions[i as usize] - origin);
            corners.iter().fold((low, high), |(l, h), p| {
                let q = Vec2::new(x.dot(*p), y.dot(*p));
                (l.min(q), h.max(q))
            })
        };
        (low, high) = bounds(seed, low, high);
        let mut met = std::mem::take(&mut self.met);
        met[seed as usize] = self.growths;
        // Breadth first: the list is the front as well.
        let (mut list, mut next) = (vec![seed], 0);
        while let Some(&t) = list.get(next) {
            next += 1;
            for n in self.neighbours[t as usize] {
                let is_new = |n: u32| met[n as usize] != self.growths && !self.taken[n as usize];
                if n == NONE || !is_new(n) || !self.fits(n, axis, limits) {
                    continue;
                }
                met[n as usize] = self.growths;
                let (l, h) = bounds(n, low, high);
                if (h - l).max_element() <= limits.side {
                    (low, high) = (l, h);
                    list.push(n);
                }
            }
        }
        self.met = met;
        list
    }

    /// Mean normal by area.
    fn mean_normal(&self, triangles: &[u32]) -> Option<Vec3> {
        let area = |t: u32| {
            let [a, b, c] = self.mesh.triangles[t as usize].map(|i| self.mesh.positions[i as usize]);
            (b - a).cross(c - a).length()
        };
        triangles.iter().map(|&t| self.smooth[t as usize] * area(t)).sum::<Vec3>().try_normalize()
    }

    /// Axes along which a piece is longest and shortest: slim rectangles pack tighter than oblique ones.
    fn axes(&self, triangles: &[u32], axis: Vec3) -> [Vec3; 2] {
        let [x, y] = perpendicular(axis);
        let corners = triangles.iter().flat_map(|&t| self.mesh.triangles[t as usize]);
        let flat = |i: u32| {
            let p = self.mesh.positions[i as usize];
            Vec2::new(x.dot(p), y.dot(p))
        };
        let (sum, count) = corners.clone().fold((Vec2::ZERO, 0.0f32), |(s, n), i| (s + flat(i), n + 1.0));
        let mean = sum / count.max(1.0);
        let (xx, xy, yy) = corners
            .map(|i| flat(i) - mean)
            .fold((0.0f32, 0.0f32, 0.0f32), |(xx, xy, yy), d| (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y));
        let angle = 0.5 * libm::atan2f(2.0 * xy, xx - yy);
        let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
        [x * cos + y * sin, y * cos - x * sin]
    }
}

/// Two unit vectors perpendicular to a unit vector; with it they are right-handed.
fn perpendicular(axis: Vec3) -> [Vec3; 2] {
    let x = axis.any_orthonormal_vector();
    [x, axis.cross(x)]
}

/// Triangles across the edges of each triangle; none across edges of one triangle, of more than two, or of opposite orientation.
fn neighbours(mesh: &Mesh) -> Vec<[u32; 3]> {
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * mesh.triangles.len());
    for (index, t) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), (3 * index + k) as u32));
        }
    }
    edges.sort_unstable();
    let mut out = vec![[NONE; 3]; mesh.triangles.len()];
    for group in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let &[(low, high, one), (_, _, other)] = group {
            let start = |e: u32| mesh.triangles[e as usize / 3][e as usize % 3];
            if low != high && start(one) != start(other) {
                out[one as usize / 3][one as usize % 3] = other / 3;
                out[other as usize / 3][other as usize % 3] = one / 3;
            }
        }
    }
    out
}
