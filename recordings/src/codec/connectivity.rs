//! Compact triangle lists: the mesh is traversed from triangle to triangle across shared edges, vertices are numbered
//! as they are first met, and each triangle costs one code, the distance of its third vertex from an end of the edge
//! (in the spirit of Touma and Gotsman, *Triangle Mesh Compression*, 1998). Vertex order is kept through a table of
//! numbers; triangles come back in traversal order, with their orientation. Triangles that share a directed edge with
//! another, or a corner with themselves, are listed in full, so that any list of triangles comes back.

use crate::codec::pack::{Input, put_varint};
use foldhash::{HashMap, HashMapExt, HashSet};
use std::collections::VecDeque;

/// The edge has no further triangle.
const NONE: u32 = 0;
/// The third vertex is met for the first time.
const NEW: u32 = 1;
/// From here on: 2 + zigzag of the third vertex' number minus the edge's first vertex' number.
const KNOWN: u32 = 2;

/// Triangles coded, the original index of each vertex by its number, and that of each triangle by its place.
pub(crate) struct Traversal {
    pub codes: Vec<u8>,
    pub order: Vec<u32>,
    pub triangles: Vec<u32>,
}

type Edge = (u32, u32);

fn edges([a, b, c]: [u32; 3]) -> [Edge; 3] {
    [(a, b), (b, c), (c, a)]
}

/// One word is hashed faster than two.
fn key((a, b): Edge) -> u64 {
    u64::from(a) << 32 | u64::from(b)
}

fn zigzag(difference: i64) -> u32 {
    ((difference << 1) ^ (difference >> 63)) as u32
}

fn unzigzag(code: u32) -> i64 {
    i64::from(code >> 1) ^ -i64::from(code & 1)
}

/// Codes triangles whose indices are below `vertices`.
pub(crate) fn encode(triangles: &[[u32; 3]], vertices: usize) -> Traversal {
    let mut regular: HashMap<u64, u32> = HashMap::with_capacity(3 * triangles.len());
    let mut is_regular = vec![false; triangles.len()];
    for (index, t) in triangles.iter().enumerate() {
        let distinct = t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        if distinct && edges(*t).iter().all(|e| !regular.contains_key(&key(*e))) {
            is_regular[index] = true;
            regular.extend(edges(*t).map(|e| (key(e), index as u32)));
        }
    }

    let mut numbering = Numbering { number: vec![u32::MAX; vertices], order: Vec::with_capacity(vertices) };
    let mut visited = vec![false; triangles.len()];
    let (mut codes, mut seeds, mut seed_count) = (Vec::new(), Vec::new(), 0u32);
    let mut listed = Vec::with_capacity(triangles.len());
    for seed in 0..triangles.len() {
        if visited[seed] || !is_regular[seed] {
            continue;
        }
        seed_count += 1;
        visited[seed] = true;
        listed.push(seed as u32);
        triangles[seed].iter().for_each(|v| numbering.put(*v, &mut seeds));
        let mut front: VecDeque<Edge> = edges(triangles[seed]).into();
        while let Some((a, b)) = front.pop_front() {
            // The neighbour runs along the edge the other way.
            let Some(next) = regular.get(&key((b, a))).copied() else {
                put_varint(&mut codes, NONE);
                continue;
            };
            if visited[next as usize] {
                continue;
            }
            visited[next as usize] = true;
            listed.push(next);
            let third = triangles[next as usize].into_iter().find(|v| *v != a && *v != b).unwrap_or(a);
            match numbering.get(third) {
                None => {
                    put_varint(&mut codes, NEW);
                    numbering.add(third);
                }
                Some(number) => {
                    let from = numbering.get(a).unwrap_or(0);
                    put_varint(&mut codes, KNOWN + zigzag(i64::from(number) - i64::from(from)));
                }
            }
            front.extend([(a, third), (third, b)]);
        }
    }
    let mut extras = Vec::new();
    let irregular = (0..triangles.len()).filter(|t| !is_regular[*t]);
    irregular.clone().for_each(|t| triangles[t].iter().for_each(|v| numbering.put(*v, &mut extras)));
    listed.extend(irregular.clone().map(|t| t as u32));
    for vertex in 0..vertices as u32 {
        if numbering.get(vertex).is_none() {
            numbering.add(vertex);
        }
    }

    let mut out = Vec::new();
    put_varint(&mut out, seed_count);
    put_varint(&mut out, irregular.count() as u32);
    for part in [&seeds, &extras, &codes] {
        put_varint(&mut out, part.len() as u32);
        out.extend(part);
    }
    Traversal { codes: out, order: numbering.order, triangles: listed }
}

/// Numbers of vertices in the order in which they are met.
struct Numbering {
    number: Vec<u32>,
    order: Vec<u32>,
}

impl Numbering {
    fn get(&self, vertex: u32) -> Option<u32> {
        self.number.get(vertex as usize).copied().filter(|n| *n != u32::MAX)
    }

    fn add(&mut self, vertex: u32) {
        self.number[vertex as usize] = self.order.len() as u32;
        self.order.push(vertex);
    }

    /// Writes how far back a vertex was met, 0 for a new one.
    fn put(&mut self, vertex: u32, out: &mut Vec<u8>) {
        match self.get(vertex) {
            Some(number) => put_varint(out, self.order.len() as u32 - number),
            None => {
                put_varint(out, 0);
                self.add(vertex);
            }
        }
    }
}

/// Decodes triangles in the vertices' traversal numbers; `vertices` and `triangles` bound what is believed.
pub(crate) fn decode(bytes: &[u8], vertices: u32, triangles: usize) -> Result<Vec<[u32; 3]>, String> {
    let mut input = Input(bytes);
    let (seed_count, extra_count) = (input.varint()?, input.varint()?);
    let mut part = || -> Result<Input, String> {
        let length = input.varint()? as usize;
        Ok(Input(input.take(length)?))
    };
    let (mut seeds, mut extras, mut codes) = (part()?, part()?, part()?);
    let mut met = 0u32;
    let mut out: Vec<[u32; 3]> = Vec::new();
    let mut taken: HashSet<u64> = HashSet::default();
    for _ in 0..seed_count {
        let seed = corners(&mut seeds, &mut met)?;
        out.push(seed);
        let mut front: VecDeque<Edge> = edges(seed).into();
        taken.extend(edges(seed).map(key));
        while let Some((a, b)) = front.pop_front() {
            if taken.contains(&key((b, a))) {
                continue;
            }
            let third = match codes.varint()? {
                NONE => continue,
                NEW => {
                    met += 1;
                    met - 1
                }
                known => u32::try_from(i64::from(a) + unzigzag(known - KNOWN))
                    .ok()
                    .filter(|v| *v < met)
                    .ok_or("a triangle of vertices not yet met")?,
            };
            out.push([b, a, third]);
            taken.extend(edges([b, a, third]).map(key));
            front.extend([(a, third), (third, b)]);
            if out.len() > triangles || met > vertices {
                return Err("more triangles than announced".into());
            }
        }
        if out.len() > triangles || met > vertices {
            return Err("more triangles than announced".into());
        }
    }
    for _ in 0..extra_count {
        out.push(corners(&mut extras, &mut met)?);
    }
    if out.len() != triangles || met > vertices {
        return Err("not as many triangles as announced".into());
    }
    Ok(out)
}

fn corners(input: &mut Input, met: &mut u32) -> Result<[u32; 3], String> {
    let mut corner = || match input.varint()? {
        0 => {
            *met += 1;
            Ok::<u32, String>(*met - 1)
        }
        back => Ok(met.checked_sub(back).ok_or("a triangle of vertices not yet met")?),
    };
    Ok([corner()?, corner()?, corner()?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Triangles with their smallest index in front, sorted: the same for lists that differ in order only.
    fn canonical(triangles: impl IntoIterator<Item = [u32; 3]>) -> Vec<[u32; 3]> {
        let turn = |t: [u32; 3]| (0..3).map(|k| [t[k], t[(k + 1) % 3], t[(k + 2) % 3]]).min().unwrap_or(t);
        let mut sorted: Vec<_> = triangles.into_iter().map(turn).collect();
        sorted.sort_unstable();
        sorted
    }

    fn round_trip(triangles: &[[u32; 3]], vertices: u32) -> usize {
        let Traversal { codes, order, triangles: listed } = encode(triangles, vertices as usize);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..vertices).collect::<Vec<_>>());
        let back = decode(&codes, vertices, triangles.len()).unwrap();
        let back: Vec<_> = back.into_iter().map(|t| t.map(|v| order[v as usize])).collect();
        for (t, original) in back.iter().zip(&listed) {
            assert_eq!(canonical([*t]), canonical([triangles[*original as usize]]));
        }
        assert_eq!(canonical(back), canonical(triangles.iter().copied()));
        codes.len()
    }

    fn grid(n: u32) -> Vec<[u32; 3]> {
        let at = |x, y| y * n + x;
        (0..n - 1)
            .flat_map(|y| (0..n - 1).map(move |x| (x, y)))
            .flat_map(|(x, y)| [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]])
            .collect()
    }

    #[test]
    fn odd_meshes_come_back() {
        round_trip(&[], 0);
        round_trip(&[], 3);
        round_trip(&[[0, 1, 2]], 5);
        round_trip(&[[0, 0, 0], [1, 1, 2], [2, 1, 0], [2, 1, 0], [0, 2, 1]], 3);
        round_trip(&[[0, 1, 2], [0, 2, 1]], 3);
        round_trip(&[[0, 1, 2], [1, 0, 3], [0, 1, 4], [5, 6, 7], [1, 0, 2]], 8);
        round_trip(&[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], 4);
    }

    #[test]
    fn a_regular_mesh_takes_few_bytes_a_vertex() {
        let n = 120;
        assert!(round_trip(&grid(n), n * n) <= 4 * (n * n) as usize);
    }

    proptest! {
        #[test]
        fn any_triangles_come_back(
            triangles in proptest::collection::vec([0u32..12, 0u32..12, 0u32..12], 0..40),
        ) {
            round_trip(&triangles, 12);
        }

        #[test]
        fn damage_never_panics(at in any::<usize>(), value in any::<u8>(), cut in any::<usize>()) {
            let mut codes = encode(&grid(6), 36).codes;
            prop_assert!(decode(&codes[..cut % codes.len()], 36, 50).is_err());
            let at = at % codes.len();
            codes[at] = value;
            if let Ok(triangles) = decode(&codes, 36, 50) {
                prop_assert!(triangles.iter().flatten().all(|v| *v < 36));
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100)) {
            let _ = decode(&bytes, 20, 30);
        }
    }
}
