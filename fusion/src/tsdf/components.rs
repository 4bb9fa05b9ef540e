//! Connected components of the mesh.

use glam::Vec3;
use recordings::types::Mesh;

/// Connected components of triangles that share vertices (union-find).
pub struct Components {
    parent: Vec<u32>,
    /// `[root]`: number of triangles of the component.
    triangles: Vec<u32>,
}

impl Components {
    /// The components of a mesh with `vertices` vertices.
    pub fn new<'a>(vertices: usize, triangles: impl Iterator<Item = &'a [u32; 3]> + Clone) -> Self {
        let mut components = Self { parent: (0..vertices as u32).collect(), triangles: vec![0; vertices] };
        for t in triangles.clone() {
            for (a, b) in [(t[0], t[1]), (t[1], t[2])] {
                let (a, b) = (components.root(a), components.root(b));
                components.parent[a.max(b) as usize] = a.min(b);
            }
        }
        for t in triangles {
            let root = components.root(t[0]);
            components.triangles[root as usize] += 1;
        }
        components
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.parent[v as usize] != v {
            self.parent[v as usize] = self.parent[self.parent[v as usize] as usize];
            v = self.parent[v as usize];
        }
        v
    }

    /// Number of triangles of the component of a vertex.
    pub fn triangles(&mut self, v: u32) -> u32 {
        let root = self.root(v);
        self.triangles[root as usize]
    }
}

/// Drops components with fewer than `min_triangles` triangles, and vertices without triangles.
pub fn drop_small_components(mesh: &mut Mesh, min_triangles: usize) {
    let vertices = mesh.positions.len();
    let mut components = Components::new(vertices, mesh.triangles.iter());
    let least = min_triangles.max(1) as u32;
    mesh.triangles.retain(|t| components.triangles(t[0]) >= least);
    let keep: Vec<bool> = (0..vertices as u32).map(|v| components.triangles(v) >= least).collect();
    let mut number = components.parent;
    let mut next = 0;
    for (n, k) in number.iter_mut().zip(&keep) {
        *n = next;
        next += u32::from(*k);
    }
    for t in &mut mesh.triangles {
        *t = t.map(|v| number[v as usize]);
    }
    let mut kept = keep.iter();
    mesh.positions.retain(|_| *kept.next().unwrap_or(&false));
    let mut kept = keep.iter();
    mesh.normals.retain(|_| *kept.next().unwrap_or(&false));
    // A vertex without gradient takes the normal of its triangles.
    let missing: Vec<bool> = mesh.normals.iter().map(|n| *n == Vec3::ZERO).collect();
    if missing.contains(&true) {
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            for v in t.iter().filter(|v| missing[**v as usize]) {
                mesh.normals[*v as usize] += (b - a).cross(c - a);
            }
        }
        for (n, m) in mesh.normals.iter_mut().zip(missing) {
            *n = if m { n.normalize_or(Vec3::Z) } else { *n };
        }
    }
}
