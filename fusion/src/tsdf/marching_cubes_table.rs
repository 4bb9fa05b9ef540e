//! The case table of marching cubes, derived instead of typed.
//!
//! On each face of the cube the surface is cut so that inside corners are separated; the cuts join to loops; the loops are
//! triangulated as fans. Two cells that share a face cut it alike, so the surface has no cracks.

/// The edges of a cube: start corner and axis; bits of a corner are x, y, z.
pub const EDGES: [(usize, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0), //
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1), //
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// Corners of each face, counter-clockwise as seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// `[sign pattern]` (bit = corner inside): triangles as triples of edges.
pub fn case_table() -> Vec<Vec<[usize; 3]>> {
    let edge_between = |a: usize, b: usize| {
        let (start, axis) = (a & b, (a ^ b).trailing_zeros() as usize);
        EDGES.iter().position(|e| *e == (start, axis)).unwrap_or(0)
    };
    (0..256usize)
        .map(|case| {
            let inside = |c: usize| case >> c & 1 == 1;
            // next[e]: the edge that the surface reaches from edge e across a face.
            let mut next = [None; 12];
            for face in FACES {
                for i in 0..4 {
                    // A run of inside corners begins after corner i …
                    if inside(face[i]) || !inside(face[(i + 1) % 4]) {
                        continue;
                    }
                    let enter = edge_between(face[i], face[(i + 1) % 4]);
                    // … and ends before the next outside corner.
                    if let Some(k) = (2..=4).find(|k| !inside(face[(i + k) % 4])) {
                        let exit = edge_between(face[(i + k - 1) % 4], face[(i + k) % 4]);
                        next[enter] = Some(exit);
                    }
                }
            }
            let mut triangles = Vec::new();
            for first in 0..12 {
                let mut ring = Vec::new();
                let mut at = first;
                while let Some(to) = next[at].take() {
                    ring.push(at);
                    at = to;
                }
                for k in 2..ring.len() {
                    triangles.push([ring[0], ring[k - 1], ring[k]]);
                }
            }
            triangles
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_closes_its_loops() {
        let table = case_table();
        assert!(table[0].is_empty() && table[255].is_empty());
        for (case, triangles) in table.iter().enumerate() {
            let crossed = EDGES.iter().filter(|(c, a)| (case >> c & 1) != (case >> (c | 1 << a) & 1)).count();
            let mut used: Vec<usize> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), crossed, "case {case}");
        }
    }
}
