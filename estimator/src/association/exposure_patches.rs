//! Patches of the surface, and how the keyframes differ over them.

use crate::association::light_field::LightField;
use crate::association::observations::{Lens, Observation, RefinedView};
use crate::association::veil::Veil;
use crate::association::vignetting::off_axis;
use crate::mesh::cells::{CellVertex, by_cell, groups};
use crate::numerics::channels::{mean, mean_square};
use crate::numerics::robust::{SIGMA_PER_MAD, median, weighted_median};
use firmware_config::tuning::ExposureTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::{Mesh, Pose};

/// Observations of less weight are not used.
const MIN_WEIGHT: f32 = 1e-3;
/// A value this many times as large as its veil may be tells of the exposure as if there were none.
const OUTSHINES: f64 = 3.0;
/// Rounds of the decomposition of a patch into vertex and keyframe terms; weights change after every second one.
const PATCH_ROUNDS: usize = 6;

/// What is nearly right of views.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Known {
    /// Neither poses nor gains.
    Nothing,
    /// Gains: no others are searched to start from.
    Gains,
    /// Poses: that patches disagree is not for their sake, so that a shoulder is looked for.
    Poses,
}

/// Inputs of the exposure estimate.
pub struct ExposureProblem<'a> {
    /// The surface.
    pub mesh: &'a Mesh,
    /// Its median edge.
    pub median_edge: f32,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Linear samples below this are not used.
    pub dark_below: f32,
    /// Veil of every keyframe: `[keyframe]`.
    pub veils: &'a [Option<Veil>],
    /// What the colours are free of; `None` where no more of it is asked for.
    pub lens: Option<Lens>,
    /// What is nearly right of the views.
    pub known: Known,
    /// Thresholds.
    pub tuning: &'a ExposureTuning,
}

/// Differences between the keyframes over a patch: log image values up to a constant.
pub struct Patch {
    /// Keyframes that see the patch.
    pub keyframes: Vec<u16>,
    /// `[keyframe of the patch][channel]`.
    pub logs: Vec<[f64; 3]>,
    /// How far they tell of the exposure: `[keyframe of the patch]`, 0 to 1.
    pub weights: Vec<f64>,
    /// How far they are known: `[keyframe of the patch]`, 0 to 1.
    pub known: Vec<f64>,
    /// Linear image value whose logarithm is 0 in `logs`.
    pub level: f64,
    /// The same of a channel, and its logarithm.
    pub levels: [f64; 3],
    /// Veil over the patch at a share of 1, mean of the channels: `[keyframe of the patch]`.
    pub veils: Vec<f64>,
    /// Squared distance from the axis of the lens, ρ²: `[keyframe of the patch]`.
    pub off_axis: Vec<f64>,
    /// Mean log colour.
    pub color: Vec3,
    /// Main direction of the normal: 2 · axis + (negative).
    pub facing: usize,
}

/// Surface patches: cubes of space, one per main direction of the normal. `views` has the keyframes' poses.
pub fn patches(field: &LightField, problem: &ExposureProblem, views: &[RefinedView]) -> Vec<Patch> {
    let cameras: Vec<Pose> = views.iter().map(|v| v.world_from_camera.inverse()).collect();
    let size = problem.median_edge * problem.tuning.patch_edges as f32;
    let vertices = by_cell(problem.mesh, size, |i| field.row(i).len() >= 2);
    let groups: Vec<&[CellVertex]> = groups(&vertices).collect();
    groups.par_iter().filter_map(|g| Patch::new(field, g, problem, &cameras)).collect()
}

/// A usable observation; vertex and keyframe are numbered within the patch.
struct Entry {
    vertex: usize,
    keyframe: usize,
    log: [f64; 3],
    /// Mean of the channels, linear.
    light: f64,
    weight: f64,
}

impl Patch {
    fn new(field: &LightField, members: &[CellVertex], problem: &ExposureProblem, cameras: &[Pose]) -> Option<Self> {
        let usable = |o: &&Observation| o.weight > MIN_WEIGHT && o.color.iter().all(|&c| c > problem.dark_below);
        let mut keyframes: Vec<u16> = Vec::new();
        for m in members {
            keyframes.extend(field.row(m.vertex).iter().filter(usable).map(|o| o.keyframe));
        }
        keyframes.sort_unstable();
        keyframes.dedup();
        if keyframes.len() < 2 {
            return None;
        }
        let mut entries = Vec::new();
        let mut color = Vec3::ZERO;
        for (vertex, m) in members.iter().enumerate() {
            for o in field.row(m.vertex).iter().filter(usable) {
                let log = o.color.map(|c| libm::log(f64::from(c)));
                let keyframe = keyframes.partition_point(|&k| k < o.keyframe);
                color += Vec3::from_array(log.map(|l| l as f32));
                let light = o.color.map(f64::from).iter().sum::<f64>() / 3.0;
                entries.push(Entry { vertex, keyframe, log, light, weight: f64::from(o.weight) });
            }
        }
        let color = color / entries.len() as f32;
        let (logs, weights) = two_way(&entries, members.len(), keyframes.len());
        let center: Vec3 =
            members.iter().map(|m| problem.mesh.positions[m.vertex]).sum::<Vec3>() / members.len() as f32;
        let lights = brightness(&entries, keyframes.len());
        let seen = |k: &u16| {
            let at = |v: &Veil| {
                let (x, y) = v.camera.project(cameras[usize::from(*k)].transform(center.as_dvec3()));
                (f64::from(v.at(x, y).element_sum()) / 3.0, off_axis(&v.camera, x, y))
            };
            problem.veils[usize::from(*k)].as_ref().map_or((0.0, 0.0), at)
        };
        let (veils, off_axis): (Vec<f64>, Vec<f64>) = keyframes.iter().map(seen).unzip();
        let known: Vec<f64> = weights.into_iter().map(|w| w / (w + problem.tuning.half_weight)).collect();
        // A veil of unknown share adds to the picture: its logarithm tells as much less as the veil is more.
        let weight = |((known, light), veil): ((&f64, &f64), &f64)| {
            let own = (light / (OUTSHINES * problem.tuning.veil_share * veil).max(1e-12)).min(1.0);
            known * own * own
        };
        let weights = known.iter().zip(&lights).zip(&veils).map(weight).collect();
        let level = lights.iter().zip(&logs).map(|(light, log)| libm::log(light.max(1e-12)) - mean(log)).sum::<f64>();
        let level = libm::exp(level / keyframes.len() as f64);
        let levels = levels(&entries, &logs);
        Some(Self { keyframes, logs, weights, known, level, levels, veils, off_axis, color, facing: members[0].facing })
    }

    /// Log deviation of every keyframe of the patch from `gains`, about the patch's weighted median.
    pub fn deviations(&self, gains: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let relative: Vec<[f64; 3]> = self
            .keyframes
            .iter()
            .zip(&self.logs)
            .map(|(&k, l)| std::array::from_fn(|c| l[c] - gains[k as usize][c]))
            .collect();
        let centre: [f64; 3] = std::array::from_fn(|c| {
            let mut values: Vec<(f64, f64)> = relative.iter().zip(&self.weights).map(|(r, &w)| (r[c], w)).collect();
            weighted_median(&mut values).unwrap_or(0.0)
        });
        relative.iter().map(|r| std::array::from_fn(|c| r[c] - centre[c])).collect()
    }

    /// Weights of the keyframes by how far their `deviations` agree. A patch whose keyframes disagree (gloss, wrong pose) is unreliable
    /// in all of them.
    pub fn robust_weights(&self, deviations: &[[f64; 3]], tolerance: f64) -> Vec<f64> {
        let agreement = tolerance / (tolerance + self.spread(deviations).0);
        let weight = |(w, d): (&f64, &[f64; 3])| {
            let x = tolerance / (tolerance + mean_square(d));
            w * agreement * agreement * x * x
        };
        self.weights.iter().zip(deviations).map(weight).collect()
    }

    /// Weighted mean square of the deviations, and the patch's weight.
    pub fn spread(&self, deviations: &[[f64; 3]]) -> (f64, f64) {
        let total: f64 = self.weights.iter().sum();
        let sum: f64 = deviations.iter().zip(&self.weights).map(|(d, w)| w * mean_square(d)).sum();
        (sum / total.max(1e-12), total * (1.0 - 1.0 / self.keyframes.len() as f64))
    }
}

/// Mean light of the entries of every keyframe.
fn brightness(entries: &[Entry], keyframes: usize) -> Vec<f64> {
    let mut sums = vec![(0.0, 1e-12); keyframes];
    for e in entries {
        let sum = &mut sums[e.keyframe];
        sum.0 += e.weight * e.light;
        sum.1 += e.weight;
    }
    sums.into_iter().map(|(sum, weight)| sum / weight).collect()
}

/// Mean of the entries' logs over the keyframe terms.
fn levels(entries: &[Entry], by_keyframe: &[[f64; 3]]) -> [f64; 3] {
    let total: f64 = entries.iter().map(|e| e.weight).sum();
    let of_channel = |c: usize| entries.iter().map(|e| e.weight * (e.log[c] - by_keyframe[e.keyframe][c])).sum::<f64>();
    [0, 1, 2].map(|c| of_channel(c) / total.max(1e-12))
}

/// Decomposes the logs into vertex + keyframe terms by alternating weighted means with Huber weights. Returns the keyframe
/// terms and their sums of weights.
fn two_way(entries: &[Entry], vertices: usize, keyframes: usize) -> (Vec<[f64; 3]>, Vec<f64>) {
    let mut by_keyframe = vec![[0.0; 3]; keyframes];
    let mut weights = vec![0.0; keyframes];
    let mut robust: Vec<f64> = entries.iter().map(|e| e.weight).collect();
    let mut by_vertex = vec![[0.0; 3]; vertices];
    for round in 0..PATCH_ROUNDS {
        average(entries, &robust, &mut by_vertex, |e| e.vertex, |e| by_keyframe[e.keyframe]);
        average(entries, &robust, &mut by_keyframe, |e| e.keyframe, |e| by_vertex[e.vertex]);
        if round % 2 == 1 {
            let residual = |e: &Entry| {
                let (v, k) = (by_vertex[e.vertex], by_keyframe[e.keyframe]);
                mean_square(&std::array::from_fn(|c| e.log[c] - v[c] - k[c])).sqrt()
            };
            let residuals: Vec<f64> = entries.iter().map(residual).collect();
            let bound = 1.5 * SIGMA_PER_MAD * median(residuals.iter().copied()).unwrap_or(0.0).max(1e-4);
            for ((w, e), r) in robust.iter_mut().zip(entries).zip(residuals) {
                *w = e.weight * (bound / r.max(bound));
            }
        }
    }
    for (e, w) in entries.iter().zip(&robust) {
        weights[e.keyframe] += w;
    }
    (by_keyframe, weights)
}

/// Weighted means of log − `other` over the entries of every index.
fn average(
    entries: &[Entry],
    weights: &[f64],
    into: &mut [[f64; 3]],
    index: impl Fn(&Entry) -> usize,
    other: impl Fn(&Entry) -> [f64; 3],
) {
    let mut sums = vec![([0.0; 3], 0.0); into.len()];
    for (e, &w) in entries.iter().zip(weights) {
        let o = other(e);
        let sum = &mut sums[index(e)];
        for ((s, log), o) in sum.0.iter_mut().zip(&e.log).zip(&o) {
            *s += w * (log - o);
        }
        sum.1 += w;
    }
    for (to, (sum, weight)) in into.iter_mut().zip(sums) {
        if weight > 0.0 {
            *to = sum.map(|s| s / weight);
        }
    }
}

#[cfg(test)]
impl Patch {
    /// A grey patch without veils on the axis of the lens, which its keyframes show alike well.
    pub fn made_up(level: f64, keyframes: Vec<u16>, logs: Vec<[f64; 3]>) -> Self {
        let n = keyframes.len();
        Self {
            keyframes,
            logs,
            weights: vec![1.0; n],
            known: vec![1.0; n],
            level,
            levels: [libm::log(level); 3],
            veils: vec![0.0; n],
            off_axis: vec![0.0; n],
            color: Vec3::ZERO,
            facing: 0,
        }
    }
}

/// Numbers between 0 and 1, the same for every test.
#[cfg(test)]
pub fn noise() -> impl FnMut() -> f64 {
    let mut state = 7_u32;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    }
}
