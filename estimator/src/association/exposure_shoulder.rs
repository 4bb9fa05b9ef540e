//! The shoulder of the camera's tone curve that exposures leave: how much more light than sRGB says the brighter keyframes have where a
//! patch is bright.
//!
//! Deviations are judged in what the pictures show, not in light: a curve that stretches bright values would stretch their deviations too.

use crate::association::exposure::{LogGains, Solver, unexplained};
use crate::association::exposure_patches::Patch;
use crate::association::observations::Lens;
use recordings::decision::Decision;
use recordings::shoulder::{compressed, expanded, slope};
use recordings::types::Response;

/// Least strength that is tried.
const LEAST: f64 = 0.1;
/// Largest strength that is tried; a curve that is still too weak then is none.
const MOST: f64 = 3.2;
/// Strengths are tried by this factor.
const STEP: f64 = 2.0;
/// Least value that is taken for one; less is noise.
const DARKEST: f64 = 1e-4;

/// Patches under other strengths than that of which their values are free.
struct Bending<'a> {
    solver: &'a Solver<'a>,
    start: &'a LogGains,
    /// What sRGB decodes: `[patch][keyframe of the patch][channel]`.
    decoded: Vec<Vec<[f64; 3]>>,
    vignetting: f64,
    /// Gains are found by every second patch from here on, the others are held out.
    first: usize,
    /// Tolerance of the held-out ones, as in sRGB.
    tolerance: f64,
}

/// How the patches disagree with the gains that one half of them tells.
#[derive(Clone, Copy)]
struct Disagreement {
    strength: f64,
    /// That half.
    own: f64,
    /// The other one.
    held_out: f64,
}

impl Solver<'_> {
    /// The strength of the shoulder of `patches`, whose values are free of `known`, and its evidence: what either half of the patches tells
    /// has to explain the other one. Leaves the patches free of what was found. `start` are gains to start from.
    pub(super) fn shoulder(&self, patches: &mut [Patch], start: &LogGains, known: &Lens) -> (f64, Decision) {
        let given = if let Response::Shoulder(strength) = known.response { strength } else { 0.0 };
        let unbent: Vec<Vec<[f64; 3]>> = patches.iter().map(|p| p.logs.clone()).collect();
        let mut bending = Bending::new(self, patches, start, given, known.vignetting.strength);
        let [one, other] = [0, 1].map(|first| {
            bending.hold_out(patches, first);
            let straight = bending.disagreement(patches, 0.0);
            (straight, bending.best(patches, &straight))
        });
        let is_told = |(straight, best): &(Disagreement, Disagreement)| {
            best.strength > 0.0 && best.held_out < self.tuning.shoulder_disagreement * straight.held_out
        };
        let found = if is_told(&one) && is_told(&other) { (one.1.strength * other.1.strength).sqrt() } else { 0.0 };
        if found == given {
            patches.iter_mut().zip(unbent).for_each(|(p, logs)| p.logs = logs);
        } else {
            bending.bend(patches, found);
        }
        let [without, with] =
            [one.0.held_out + other.0.held_out, one.1.held_out + other.1.held_out].map(|sum| 0.5 * sum);
        (found, Decision::Shoulder { strength: found, without, with, patches: patches.len() as u32 })
    }
}

impl<'a> Bending<'a> {
    /// Of patches that are free of a shoulder of this strength and this vignetting.
    fn new(solver: &'a Solver, patches: &[Patch], start: &'a LogGains, strength: f64, vignetting: f64) -> Self {
        let of_patch = |p: &Patch| {
            let value = |(logs, x): (&[f64; 3], &f64)| {
                std::array::from_fn(|c| {
                    let light = libm::exp(logs[c] + p.levels[c] - vignetting * x);
                    compressed(light, strength).max(DARKEST)
                })
            };
            p.logs.iter().zip(&p.off_axis).map(value).collect()
        };
        let decoded = patches.iter().map(of_patch).collect();
        Self { solver, start, decoded, vignetting, first: 0, tolerance: 0.0 }
    }

    /// Frees the patches of a shoulder of this strength.
    fn bend(&self, patches: &mut [Patch], strength: f64) {
        for (p, decoded) in patches.iter_mut().zip(&self.decoded) {
            for ((logs, decoded), x) in p.logs.iter_mut().zip(decoded).zip(&p.off_axis) {
                for c in 0..3 {
                    logs[c] = libm::log(expanded(decoded[c], strength)) + self.vignetting * x - p.levels[c];
                }
            }
        }
    }

    /// Gains are found by every second patch from `first` on, from now on.
    fn hold_out(&mut self, patches: &mut [Patch], first: usize) {
        self.first = first;
        self.bend(patches, 0.0);
        let others: Vec<&Patch> = patches.iter().skip(1 - first).step_by(2).collect();
        self.tolerance = self.solver.tolerance(&others, self.start);
    }

    /// The strength under which the half that gains are found by disagrees least; 0 where none is better.
    fn best(&self, patches: &mut [Patch], straight: &Disagreement) -> Disagreement {
        let mut tried = vec![self.disagreement(patches, LEAST)];
        while is_falling(straight, &tried) && tried[tried.len() - 1].strength < MOST {
            let next = tried[tried.len() - 1].strength * STEP;
            tried.push(self.disagreement(patches, next));
        }
        match tried[..] {
            // Between its neighbours, where a parabola through the three is least.
            [.., low, middle, high] if high.own >= middle.own => {
                let (rise, fall) = (high.own - middle.own, low.own - middle.own);
                let shift = 0.5 * (fall - rise) / (fall + rise).max(1e-12);
                let between = self.disagreement(patches, middle.strength * libm::pow(STEP, shift));
                if between.own < middle.own { between } else { middle }
            }
            [weak, strong] if strong.own >= weak.own => weak,
            _ => *straight,
        }
    }

    fn disagreement(&self, patches: &mut [Patch], strength: f64) -> Disagreement {
        self.bend(patches, strength);
        let half: Vec<&Patch> = patches.iter().skip(self.first).step_by(2).collect();
        let gains = self.solver.refine(&half, self.start.clone(), false);
        // Deviations of what the pictures show.
        let shown = |(p, decoded): (&Patch, &Vec<[f64; 3]>)| {
            let mut deviations = p.deviations(&gains);
            for (d, x) in deviations.iter_mut().flatten().zip(decoded.iter().flatten()) {
                *d /= slope(*x, strength);
            }
            p.spread(&deviations)
        };
        let of_half = |first: usize| {
            let half = patches.iter().zip(&self.decoded).skip(first).step_by(2);
            unexplained(half.map(shown), self.tolerance)
        };
        Disagreement { strength, own: of_half(self.first), held_out: of_half(1 - self.first) }
    }
}

/// True if the last that was tried disagrees less than the one before it.
fn is_falling(straight: &Disagreement, tried: &[Disagreement]) -> bool {
    let before = tried.len().checked_sub(2).map_or(straight, |i| &tried[i]);
    tried.last().is_some_and(|last| last.own < before.own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::exposure_patches::noise;
    use firmware_config::tuning::ExposureTuning;

    const KEYFRAMES: usize = 6;
    const LEVEL: f64 = 0.2;

    /// 200 coloured patches that six keyframes of other exposures show with noise, decoded as sRGB; clipped ones are left out.
    fn patches(strength: f64) -> Vec<Patch> {
        let mut random = noise();
        let patch = |_| {
            let paint: [f64; 3] = std::array::from_fn(|_| 0.05 + 0.6 * random());
            let shown = |k: usize, noise: f64| {
                paint.map(|p| compressed(p * GAINS[k] * libm::exp(0.06 * (noise - 0.5)), strength))
            };
            let all = (0..KEYFRAMES).map(|k| (k as u16, shown(k, random())));
            let seen = all.filter(|(_, x)| x.iter().all(|x| *x < 0.95));
            let (keyframes, logs) = seen.map(|(k, x)| (k, x.map(|x| libm::log(x / LEVEL)))).unzip();
            Patch::made_up(LEVEL, keyframes, logs)
        };
        (0..200).map(patch).collect()
    }

    const GAINS: [f64; KEYFRAMES] = [0.5, 0.7, 1.0, 1.4, 2.0, 2.4];

    fn found(patches: &mut [Patch], known: f64) -> f64 {
        let tuning = ExposureTuning::default();
        let solver = Solver { keyframes: KEYFRAMES, tuning: &tuning };
        let known = Lens { response: Response::Shoulder(known), ..Lens::default() };
        let (found, decision) = solver.shoulder(patches, &solver.unit(), &known);
        let Decision::Shoulder { strength, .. } = decision else { panic!("{decision:?}") };
        assert_eq!(strength, found);
        found
    }

    #[test]
    fn a_shoulder_is_found_beside_gains_and_undone() {
        let mut seen = patches(0.9);
        let strength = found(&mut seen, 0.0);
        assert!((strength - 0.9).abs() < 0.15, "{strength}");
        for (freed, even) in seen.iter().zip(patches(0.9)) {
            for (freed, shown) in freed.logs.iter().flatten().zip(even.logs.iter().flatten()) {
                let light = expanded(LEVEL * libm::exp(*shown), strength);
                assert!((libm::log(light / LEVEL) - freed).abs() < 1e-9, "{freed}");
            }
        }
        // What is free of it already still says how much it was.
        let again = found(&mut seen, strength);
        assert!((again - strength).abs() < 1e-6, "{again}");
    }

    #[test]
    fn srgb_has_none_and_stays_as_it_is() {
        let mut seen = patches(0.0);
        assert_eq!(found(&mut seen, 0.0), 0.0);
        assert!(seen.iter().zip(patches(0.0)).all(|(a, b)| a.logs == b.logs));
    }
}
