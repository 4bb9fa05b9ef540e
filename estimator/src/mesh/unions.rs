//! Disjoint sets of vertices (union-find).

/// Vertices in sets; each set is named by its first vertex.
pub struct Unions {
    parent: Vec<u32>,
}

impl Unions {
    /// Every one of `count` vertices is a set of its own.
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The first vertex of the set of vertex `i`.
    pub fn first(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            self.parent[i as usize] = self.parent[self.parent[i as usize] as usize];
            i = self.parent[i as usize];
        }
        i
    }

    /// Makes the sets of two vertices one.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.first(a), self.first(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}
