//! Paint that the spread of a segment does not tell of: a patch that differs from its segment by more than light can explain, as a
//! blue book in the segment of its table.

use crate::factorisation::problem::{Colors, counted};
use crate::numerics::channels::mean_square;
use crate::numerics::robust::median;
use rayon::prelude::*;

/// Difference of a vertex's log albedo from its segment's, per channel; `None` where it was not seen or is unlit.
pub type Logs = Option<[f64; 3]>;

/// A patch reaches so many edges: strips beside outlines, which have colours of what is behind them, are narrower than half of it.
const REACH: usize = 3;
/// Vertices of a patch at most, whatever the mesh: a regular one has 37.
const MOST: usize = 64;
/// Lit colours that count less say nothing of paint: hardly seen surface under and behind things has the colours of those.
const LEAST_SEEN: f64 = 0.05;
/// A square is explained by so many variances of the error.
const EXPLAINED: f64 = 4.0;
/// Variance of paint over the square of one patch beyond what is explained: the tails of paint are long.
const WIDE: f64 = 4.0;
/// Where less than this share of a segment's vertices lies in such patches, they are errors as rare as that: a plain thing has
/// patches whose lit colour is wrong, as beside glare or in few pictures of wrong pose.
const LEAST_SHARE: f64 = 0.02;

/// Variance of the log albedo that is paint around each vertex whatever the segment's spread, 0 for what has none: `[vertex]`.
/// `logs` and the variance of their errors are `[vertex]`, too.
#[must_use]
pub fn of_patches(logs: &[Logs], variance: &[f64], colors: &Colors) -> Vec<f64> {
    let of_vertex = |i: usize| of_patch(i, logs, variance[i], colors);
    let mut patches: Vec<f64> = (0..logs.len()).into_par_iter().map(of_vertex).collect();
    // Vertices with an albedo, and those of them with paint: `[segment]`.
    let mut counts = vec![[0u32; 2]; colors.segments];
    let known = |i: &usize| logs[*i].is_some();
    for i in (0..logs.len()).filter(known) {
        if let Some([all, painted]) = counts.get_mut(colors.segment[i] as usize) {
            *all += 1;
            *painted += u32::from(patches[i] > 0.0);
        }
    }
    let is_rare = |&[all, painted]: &[u32; 2]| f64::from(painted) < LEAST_SHARE * f64::from(all);
    for (patch, segment) in patches.iter_mut().zip(colors.segment) {
        if counts.get(*segment as usize).is_some_and(is_rare) {
            *patch = 0.0;
        }
    }
    patches
}

/// Variance of the log albedo that is paint around vertex `i`: four times the square, mean over channels, of the patch's median
/// difference from its segment, less what an error of this `variance` explains. `logs`: `[vertex]`.
fn of_patch(i: usize, logs: &[Logs], variance: f64, colors: &Colors) -> f64 {
    let counts = |j: &usize| counted(colors.lit_weight, colors.reliability, *j) >= LEAST_SEEN;
    if !logs[i].is_some_and(|own| mean_square(&own) > variance) || !counts(&i) {
        return 0.0;
    }
    let patch = colors.graph.around(i, REACH, MOST, |j| colors.segment[j] == colors.segment[i]);
    let tell: Vec<[f64; 3]> = patch.iter().map(|&j| j as usize).filter(counts).filter_map(|j| logs[j]).collect();
    if 2 * tell.len() < patch.len() {
        return 0.0;
    }
    // Where most of a patch is within what an error explains, so is its median: nothing to sort.
    let explained = EXPLAINED * variance;
    let within = |c: usize| tell.iter().filter(|log| log[c] * log[c] <= explained).count();
    if (0..3).all(|c| within(c) > tell.len() / 2 + 1) {
        return 0.0;
    }
    let off = [0, 1, 2].map(|c| median(tell.iter().map(|log| log[c])).unwrap_or(0.0));
    WIDE * (mean_square(&off) - explained).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::graph::Graph;
    use glam::Vec3;

    /// Vertices along one side of a square grid.
    const SIDE: usize = 60;

    /// What `of` finds on a plain grid in one segment, whose vertices differ from it by what `off` says of their coordinates, and
    /// count as `weight` says.
    fn on_grid<T>(
        off: impl Fn(usize, usize) -> f64,
        weight: impl Fn(usize, usize) -> f32,
        of: impl Fn(&[Logs], &Colors) -> T,
    ) -> T {
        let quad = |q: usize| (q / (SIDE - 1) * SIDE + q % (SIDE - 1)) as u32;
        let triangles: Vec<[u32; 3]> = (0..(SIDE - 1) * (SIDE - 1))
            .flat_map(|q| {
                let (a, c) = (quad(q), quad(q) + SIDE as u32);
                [[a, a + 1, c], [a + 1, c + 1, c]]
            })
            .collect();
        let all = SIDE * SIDE;
        let graph = Graph::new(all, &triangles);
        let logs: Vec<Logs> = (0..all).map(|i| Some([off(i % SIDE, i / SIDE); 3])).collect();
        let lit_weight: Vec<f32> = (0..all).map(|i| weight(i % SIDE, i / SIDE)).collect();
        let colors = Colors {
            lit_color: &vec![Vec3::ONE; all],
            lit_weight: &lit_weight,
            reliability: &[],
            clipped: &vec![false; all],
            segment: &vec![0; all],
            segments: 1,
            graph: &graph,
            known: None,
        };
        of(&logs, &colors)
    }

    /// What is found at vertex (15, 15).
    fn found(off: impl Fn(usize, usize) -> f64, weight: impl Fn(usize, usize) -> f32) -> f64 {
        on_grid(off, weight, |logs, colors| of_patch(15 * SIDE + 15, logs, 0.01, colors))
    }

    fn within(x: usize, low: usize, high: usize) -> f64 {
        if (low..=high).contains(&x) { 0.5 } else { 0.0 }
    }

    #[test]
    fn a_patch_is_paint() {
        let patch = |x, y| within(x, 11, 19).min(within(y, 11, 19));
        assert!((found(patch, |_, _| 1.0) - 4.0 * (0.25 - 4.0 * 0.01)).abs() < 1e-9);
    }

    #[test]
    fn patches_that_are_rare_are_none() {
        let painted = |low, high| {
            let patch = move |x, y| within(x, low, high).min(within(y, low, high));
            let all = on_grid(patch, |_, _| 1.0, |logs, colors| of_patches(logs, &[0.01; SIDE * SIDE], colors));
            let own = found(patch, |_, _| 1.0);
            (own > 0.0, all.iter().filter(|p| **p > 0.0).count())
        };
        assert_eq!(painted(13, 17), (true, 0));
        assert!(painted(9, 21).1 > 72);
    }

    #[test]
    fn what_the_error_explains_is_none() {
        assert_eq!(found(|_, _| 0.19, |_, _| 1.0), 0.0);
    }

    #[test]
    fn a_strip_beside_an_outline_is_none() {
        assert_eq!(found(|x, _| within(x, 15, 16), |_, _| 1.0), 0.0);
    }

    #[test]
    fn what_was_hardly_seen_tells_of_none() {
        assert_eq!(found(|_, _| 0.5, |_, _| 0.01), 0.0);
        assert_eq!(found(|_, _| 0.5, |x, y| if (x, y) == (15, 15) { 1.0 } else { 0.01 }), 0.0);
    }
}
