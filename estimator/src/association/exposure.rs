//! Exposure gains of the keyframes (Eq. 5), jointly over the whole surface in the log domain.
//!
//! Gloss changes the colour of surfaces between keyframes smoothly and far more than noise does, so single vertices do not show
//! which of them are diffuse. Patches do: the vertices of a patch share their view dependence, and their noise averages out.
//! Each patch measures the differences between its keyframes; the gains are those on which most of the patches agree.

use crate::association::exposure_patches::{ExposureProblem, Known, Patch, patches};
use crate::association::haze::{Hazed, hazed};
use crate::association::light_field::LightField;
use crate::association::observations::{Lens, RefinedView};
use crate::association::veil::Veil;
use firmware_config::ExposureChoice;
use firmware_config::tuning::ExposureTuning;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use recordings::decision::{Decision, ExposureModel};
use recordings::types::Response;

/// A tolerance that no deviation exceeds.
const UNLIMITED: f64 = 1e12;
/// Groups of patches of similar chromaticity.
const COLOR_GROUPS: usize = 6;
/// Patches that one task takes, at least.
const PATCHES_TOGETHER: usize = 64;
/// Change of log gains below which the reweighting has converged.
const CONVERGED_LOG: f64 = 1e-5;

/// Log gains per keyframe and channel: `[keyframe][channel]`.
pub(super) type LogGains = Vec<[f64; 3]>;

/// What is known of the exposures.
pub struct Exposures {
    /// Gains g_j, `[keyframe][channel]`: image = gain · radiance, geometric mean 1.
    pub gains: Vec<[f64; 3]>,
    /// The evidence, if the model was chosen here, and that of the lens.
    pub decisions: Vec<Decision>,
    /// What the camera does to the pictures; gains are those without it.
    pub lens: Lens,
    /// Keyframes that show more glare than surface.
    pub hazed: Vec<Hazed>,
}

/// Exposures of the keyframes by what they saw of the surface.
pub fn solve(
    field: &LightField,
    problem: &ExposureProblem,
    views: &[RefinedView],
    choice: ExposureChoice,
) -> Exposures {
    let keyframes = problem.keyframes;
    let neutral = |lens, decisions| Exposures { gains: vec![[1.0; 3]; keyframes], decisions, lens, hazed: Vec::new() };
    let known = problem.lens.unwrap_or_default();
    if choice == ExposureChoice::None || keyframes < 2 {
        return neutral(known, Vec::new());
    }
    let mut patches = patches(field, problem, views);
    if patches.is_empty() {
        return neutral(known, Vec::new());
    }
    let solver = Solver { keyframes, tuning: problem.tuning };
    let start = if problem.known == Known::Gains {
        views.iter().map(|v| v.gain.map(libm::log)).collect()
    } else {
        solver.agreed(&patches.iter().collect::<Vec<_>>())
    };
    let (mut lens, mut decisions) = (known, Vec::new());
    if problem.lens.is_some() && problem.known == Known::Poses && is_srgb(known.response) {
        let (strength, decision) = solver.shoulder(&mut patches, &start, &known);
        lens.response = if strength > 0.0 { Response::Shoulder(strength) } else { Response::Srgb };
        decisions.push(decision);
    }
    if problem.lens.is_some() {
        let (vignetting, decision) = solver.vignetting(&mut patches, &start, known.vignetting);
        lens.vignetting = vignetting;
        decisions.push(decision);
    }
    let all: Vec<&Patch> = patches.iter().collect();
    let fit = |patches: &[&Patch], rgb: bool| solver.refine(patches, start.clone(), rgb);
    let logs = match choice {
        ExposureChoice::None => return neutral(lens, decisions),
        ExposureChoice::Scalar => fit(&all, false),
        ExposureChoice::Rgb => fit(&all, true),
        ExposureChoice::Auto => {
            // Gains from one half of the patches have to predict the other half.
            let (half, other): (Vec<_>, Vec<_>) = all.iter().enumerate().partition(|(i, _)| i.is_multiple_of(2));
            let [half, other] = [half, other].map(|h| h.into_iter().map(|p| *p.1).collect::<Vec<&Patch>>());
            let tolerance = solver.tolerance(&other, &start);
            let [none, scalar, rgb] = [solver.unit(), fit(&half, false), fit(&half, true)]
                .map(|gains| disagreement(&other, &gains, tolerance));
            let chosen = if rgb < problem.tuning.rgb_disagreement * scalar {
                ExposureModel::Rgb
            } else if none <= scalar {
                ExposureModel::None
            } else {
                ExposureModel::Scalar
            };
            decisions.insert(0, Decision::Exposure { chosen, none, scalar, rgb, patches: all.len() as u32 });
            if chosen == ExposureModel::None {
                return neutral(lens, decisions);
            }
            fit(&all, chosen == ExposureModel::Rgb)
        }
    };
    let clipped: Vec<f64> = problem.veils.iter().map(|v| v.as_ref().map_or(0.0, Veil::clipped)).collect();
    let hazed = hazed(&patches, &logs, &clipped);
    Exposures { gains: logs.iter().map(|l| l.map(libm::exp)).collect(), decisions, lens, hazed }
}

/// True if the response is sRGB's but for highlights.
fn is_srgb(response: Response) -> bool {
    matches!(response, Response::Srgb | Response::Shoulder(_))
}

/// The estimate over patches with known number of keyframes and thresholds.
pub(super) struct Solver<'a> {
    pub(super) keyframes: usize,
    pub(super) tuning: &'a ExposureTuning,
}

impl Solver<'_> {
    /// No gains.
    pub(super) fn unit(&self) -> LogGains {
        vec![[0.0; 3]; self.keyframes]
    }

    /// The starting point: gains are estimated from groups of patches (all, of one colour, facing one way); those with which
    /// most patches agree win. A glossy table may be most of the scene, but its patches do not agree with each other.
    fn agreed(&self, patches: &[&Patch]) -> LogGains {
        let mut groups: Vec<Vec<&Patch>> = vec![patches.to_vec()];
        groups.extend((0..6).map(|f| patches.iter().copied().filter(|p| p.facing == f).collect()));
        groups.extend(color_groups(patches));
        let mut candidates: Vec<LogGains> = groups
            .par_iter()
            .filter(|g| !g.is_empty())
            .map(|g| self.refine(patches, self.refine(g, self.unit(), false), false))
            .collect();
        // Exposures far apart exceed any tolerance at the start; plain least squares uses every patch.
        let plain = reweighted(patches, &deviations(patches, &self.unit()), UNLIMITED, self.keyframes, false);
        candidates.push(self.refine(patches, plain, false));
        let scale = candidates.iter().map(|c| self.tolerance(patches, c)).fold(f64::INFINITY, f64::min);
        let scores: Vec<f64> = candidates.par_iter().map(|c| disagreement(patches, c, scale)).collect();
        let best = (0..candidates.len()).fold(0, |b, i| if scores[i] < scores[b] { i } else { b });
        candidates.into_iter().nth(best).unwrap_or_else(|| self.unit())
    }

    /// Mean square log deviation up to which a patch agrees: the deviation of a diffuse patch, or that of the better patches
    /// if theirs is larger.
    pub(super) fn tolerance(&self, patches: &[&Patch], gains: &[[f64; 3]]) -> f64 {
        self.tolerance_of(patches, &deviations(patches, gains))
    }

    /// The same of what the patches deviate by.
    pub(super) fn tolerance_of(&self, patches: &[&Patch], deviations: &[Vec<[f64; 3]>]) -> f64 {
        let least = self.tuning.diffuse_log * self.tuning.diffuse_log;
        let mut spreads: Vec<f64> = patches.iter().zip(deviations).map(|(p, d)| p.spread(d).0).collect();
        if spreads.is_empty() {
            return least;
        }
        let index = ((spreads.len() - 1) as f64 * self.tuning.better_share) as usize;
        spreads.select_nth_unstable_by(index, f64::total_cmp).1.max(least)
    }

    /// Log gains by iteratively reweighted least squares, each patch's constant eliminated. Eq. (5)
    pub(super) fn refine(&self, patches: &[&Patch], mut gains: LogGains, rgb: bool) -> LogGains {
        for _ in 0..self.tuning.rounds {
            let deviations = deviations(patches, &gains);
            let next = reweighted(patches, &deviations, self.tolerance_of(patches, &deviations), gains.len(), rgb);
            let moves = gains.iter().flatten().zip(next.iter().flatten()).map(|(a, b)| (a - b).abs());
            let moved = moves.fold(0.0, f64::max);
            gains = next;
            if moved < CONVERGED_LOG {
                break;
            }
        }
        gains
    }
}

/// Patches of similar chromaticity, around seeds that are far apart.
fn color_groups<'a>(patches: &[&'a Patch]) -> Vec<Vec<&'a Patch>> {
    let chroma = |p: &Patch| Vec3::new(p.color.x - p.color.y, p.color.z - p.color.y, 0.0);
    let Some(first) = patches.first() else { return Vec::new() };
    let mut seeds = vec![chroma(first)];
    let nearest = |p: &Patch, seeds: &[Vec3]| {
        let distance = |s: &Vec3| chroma(p).distance(*s);
        (0..seeds.len()).fold(0, |b, i| if distance(&seeds[i]) < distance(&seeds[b]) { i } else { b })
    };
    for _ in 1..COLOR_GROUPS {
        let gap = |p: &Patch| chroma(p).distance(seeds[nearest(p, &seeds)]);
        let far = patches.iter().fold(patches[0], |b, p| if gap(p) > gap(b) { p } else { b });
        seeds.push(chroma(far));
    }
    let mut groups = vec![Vec::new(); seeds.len()];
    for p in patches {
        groups[nearest(p, &seeds)].push(*p);
    }
    groups
}

/// Share of the patches' weight that the gains do not explain at a tolerance, 0 to 1.
pub(super) fn disagreement(patches: &[&Patch], gains: &[[f64; 3]], tolerance: f64) -> f64 {
    unexplained(patches.iter().map(|p| p.spread(&p.deviations(gains))), tolerance)
}

/// The same of what the patches deviate by: mean square and weight of each.
pub(super) fn unexplained(spreads: impl Iterator<Item = (f64, f64)>, tolerance: f64) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (spread, weight) in spreads {
        sum += weight * spread / (spread + tolerance);
        total += weight;
    }
    sum / f64::max(total, 1e-12)
}

/// Deviations of every patch at these gains.
pub(super) fn deviations(patches: &[&Patch], gains: &[[f64; 3]]) -> Vec<Vec<[f64; 3]>> {
    patches.par_iter().with_min_len(PATCHES_TOGETHER).map(|p| p.deviations(gains)).collect()
}

/// One round of reweighted least squares for `n` keyframes, with weights from the deviations.
fn reweighted(patches: &[&Patch], deviations: &[Vec<[f64; 3]>], tolerance: f64, n: usize, rgb: bool) -> LogGains {
    let mut matrix = DMatrix::<f64>::zeros(n, n);
    let mut right: [DVector<f64>; 3] = std::array::from_fn(|_| DVector::zeros(n));
    for (p, deviations) in patches.iter().zip(deviations) {
        let weights = p.robust_weights(deviations, tolerance);
        let total: f64 = weights.iter().sum::<f64>().max(1e-12);
        let mean: [f64; 3] =
            std::array::from_fn(|c| p.logs.iter().zip(&weights).map(|(l, w)| w * l[c]).sum::<f64>() / total);
        for (a, (wa, log)) in p.keyframes.iter().zip(weights.iter().zip(&p.logs)) {
            let i = *a as usize;
            matrix[(i, i)] += wa;
            for ((r, l), m) in right.iter_mut().zip(log).zip(&mean) {
                r[i] += wa * (l - m);
            }
            for (b, wb) in p.keyframes.iter().zip(&weights) {
                matrix[(i, *b as usize)] -= wa * wb / total;
            }
        }
    }
    solve_centred(matrix, &right, rgb)
}

/// Solves for log gains with mean 0, one per keyframe or one per keyframe and channel.
fn solve_centred(mut matrix: DMatrix<f64>, right: &[DVector<f64>; 3], rgb: bool) -> LogGains {
    let n = matrix.nrows();
    let mean_diagonal = matrix.trace() / n as f64;
    // The common factor is free, and so is a keyframe without observations: a weak prior fixes both at gain 1.
    matrix += DMatrix::from_element(n, n, mean_diagonal / n as f64);
    matrix += DMatrix::identity(n, n) * (1e-6 * mean_diagonal + 1e-12);
    let mut logs = vec![[0.0; 3]; n];
    let Some(cholesky) = matrix.cholesky() else {
        return logs;
    };
    let x = if rgb {
        right.each_ref().map(|r| cholesky.solve(r))
    } else {
        let mean = cholesky.solve(&((&right[0] + &right[1] + &right[2]) / 3.0));
        [mean.clone(), mean.clone(), mean]
    };
    logs.iter_mut().enumerate().for_each(|(j, l)| *l = x.each_ref().map(|x| x[j]));
    let mean = logs.iter().flatten().sum::<f64>() / (3 * n) as f64;
    logs.iter_mut().flatten().for_each(|l| *l -= mean);
    logs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::observations::Observation;
    use recordings::types::{Mesh, Pose};

    /// A field of 80 × 80 vertices, seen by all keyframes. The left 70 % is glossy: it brightens smoothly from keyframe to
    /// keyframe, nearly the same over its whole area. The rest is matte and noisy.
    fn field(gains: &[f64]) -> (LightField, Mesh) {
        let mut observations = Vec::new();
        let mut offsets = vec![0];
        let mut mesh = Mesh::default();
        let mut state = 1_u32;
        for i in 0..6400_u32 {
            let (x, y) = (i % 80, i / 80);
            mesh.positions.push(Vec3::new(x as f32, y as f32, 0.0));
            mesh.normals.push(Vec3::Z);
            for (j, g) in gains.iter().enumerate() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = (f64::from(state >> 8) / f64::from(1 << 24) - 0.5) * 0.2;
                let bump = j as f64 - 3.0 - 0.05 * f64::from(y);
                let gloss = if x < 56 { 0.4 / (1.0 + bump * bump) } else { 0.0 };
                let base = if x < 56 { [0.1, 0.2, 0.15] } else { [0.3, 0.28, 0.25] };
                let color = base.map(|b| (b * g * (1.0 + gloss + noise)) as f32);
                observations.push(Observation { vertex: i, keyframe: j as u16, color, weight: 0.5, clipped: false });
            }
            offsets.push(observations.len() as u32);
        }
        (LightField { observations, offsets }, mesh)
    }

    fn solved(
        field: &LightField,
        mesh: &Mesh,
        keyframes: usize,
        choice: ExposureChoice,
        dark_below: f32,
    ) -> Vec<[f64; 3]> {
        let tuning = &ExposureTuning::default();
        let view = RefinedView { world_from_camera: Pose::IDENTITY, gain: [1.0; 3], residual_px: 0.0 };
        let (views, veils) = (vec![view; keyframes], vec![None; keyframes]);
        let problem = ExposureProblem {
            mesh,
            median_edge: 1.0,
            keyframes,
            dark_below,
            veils: &veils,
            lens: None,
            known: Known::Nothing,
            tuning,
        };
        solve(field, &problem, &views, choice).gains
    }

    fn worst_error(found: &[[f64; 3]], gains: &[f64]) -> f64 {
        let mean = gains.iter().map(|g| libm::log(*g)).sum::<f64>() / gains.len() as f64;
        let error = |(f, g): (&[f64; 3], &f64)| (libm::log(f[1]) - libm::log(*g) + mean).abs();
        found.iter().zip(gains).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn a_glossy_majority_does_not_set_the_gains() {
        let gains = [1.0, 1.2, 1.5, 0.7, 0.8, 1.1, 0.9, 1.0];
        let (field, mesh) = field(&gains);
        for choice in [ExposureChoice::Auto, ExposureChoice::Scalar] {
            let found = solved(&field, &mesh, gains.len(), choice, 0.004);
            assert!(worst_error(&found, &gains) < 0.01, "{choice:?}: {}", worst_error(&found, &gains));
        }
        let found = solved(&field, &mesh, gains.len(), ExposureChoice::None, 0.004);
        assert_eq!(found, vec![[1.0; 3]; gains.len()]);
    }

    #[test]
    fn gains_have_geometric_mean_one_and_one_thread_gives_the_same() {
        let gains = [10.0, 0.001, 3.0, 0.5];
        let (field, mesh) = field(&gains);
        let run = || solved(&field, &mesh, gains.len(), ExposureChoice::Rgb, 0.0);
        let sum: f64 = run().iter().flatten().map(|g| libm::log(*g)).sum();
        assert!(sum.abs() < 1e-9, "{sum}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(run), run());
    }
}
