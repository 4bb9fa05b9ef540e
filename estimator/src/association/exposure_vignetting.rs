//! The vignetting that exposures leave: how much darker patches are where keyframes show them off the axis.

use crate::association::exposure::{LogGains, Solver, deviations, disagreement};
use crate::association::exposure_patches::Patch;
use crate::association::vignetting::Vignetting;
use crate::numerics::channels::mean;
use recordings::decision::Decision;

/// v is found when it moves by less.
const SETTLED: f64 = 5e-4;
/// Turns of v and gains.
const TURNS: usize = 16;
/// The lens of a Kinect has less; more is glare around a window in the middle of the pictures.
const MOST: f64 = 0.35;

impl Solver<'_> {
    /// The vignetting of `patches`, whose values are free of `known`, and its evidence: what one half of the patches tells has to explain
    /// the other half. Leaves the patches free of what was found. `start` are gains to start from.
    pub(super) fn vignetting(
        &self,
        patches: &mut [Patch],
        start: &LogGains,
        known: Vignetting,
    ) -> (Vignetting, Decision) {
        let fit = |patches: &mut [Patch], step: usize| {
            let (mut gains, mut strength) = (start.clone(), known.strength);
            for _ in 0..TURNS {
                let used: Vec<&Patch> = patches.iter().step_by(step).collect();
                gains = self.refine(&used, gains, false);
                let more = self.slope(&used, &gains);
                strength += more;
                brighten(patches, more);
                if more.abs() < SETTLED {
                    break;
                }
            }
            (gains, strength)
        };
        let (gains, strength) = fit(patches, 2);
        let judged = |patches: &[Patch], gains: &LogGains| {
            let other: Vec<&Patch> = patches.iter().skip(1).step_by(2).collect();
            disagreement(&other, gains, self.tolerance(&other, start))
        };
        let with = judged(patches, &gains);
        brighten(patches, -strength);
        let half: Vec<&Patch> = patches.iter().step_by(2).collect();
        let gains = self.refine(&half, start.clone(), false);
        let without = judged(patches, &gains);
        let is_told = |strength: f64| strength > 0.0 && strength < MOST;
        let mut found = Vignetting::default();
        if is_told(strength) && with < self.tuning.vignetting_disagreement * without {
            brighten(patches, known.strength);
            let (_, strength) = fit(patches, 1);
            if is_told(strength) {
                found = Vignetting { strength };
            } else {
                brighten(patches, -strength);
            }
        }
        let decision = Decision::Vignetting { strength: found.strength, without, with, patches: patches.len() as u32 };
        (found, decision)
    }

    /// v by weighted least squares of the deviations from `gains`, each patch's constant eliminated.
    fn slope(&self, patches: &[&Patch], gains: &[[f64; 3]]) -> f64 {
        let deviations = deviations(patches, gains);
        let tolerance = self.tolerance_of(patches, &deviations);
        let (mut cross, mut square) = (0.0, 0.0);
        for (p, deviations) in patches.iter().zip(&deviations) {
            let weights = p.robust_weights(deviations, tolerance);
            let total = weights.iter().sum::<f64>().max(1e-12);
            let rows = || p.off_axis.iter().zip(deviations).map(|(x, d)| (*x, mean(d))).zip(&weights);
            let (x, y) = rows().fold((0.0, 0.0), |(x, y), ((dx, dy), w)| (x + w * dx / total, y + w * dy / total));
            for ((dx, dy), w) in rows() {
                cross -= w * (dx - x) * (dy - y);
                square += w * (dx - x) * (dx - x);
            }
        }
        if square > 0.0 { cross / square } else { 0.0 }
    }
}

/// Undoes a vignetting of this strength.
fn brighten(patches: &mut [Patch], strength: f64) {
    for p in patches {
        for (logs, x) in p.logs.iter_mut().zip(&p.off_axis) {
            logs.iter_mut().for_each(|l| *l += strength * x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::exposure_patches::noise;
    use firmware_config::tuning::ExposureTuning;

    const KEYFRAMES: usize = 6;

    /// 120 patches that six keyframes show at different places of their pictures, with noise, gains, and a vignetting of which the
    /// values are not free.
    fn patches(strength: f64) -> Vec<Patch> {
        let mut random = noise();
        let patch = |_| {
            let (paint, off_axis) = (random(), (0..KEYFRAMES).map(|_| random()).collect::<Vec<_>>());
            let log = |(k, x): (usize, &f64)| [paint + 0.1 * k as f64 - strength * x + 0.04 * (random() - 0.5); 3];
            let logs = off_axis.iter().enumerate().map(log).collect();
            Patch { off_axis, ..Patch::made_up(0.1, (0..KEYFRAMES as u16).collect(), logs) }
        };
        (0..120).map(patch).collect()
    }

    fn found(patches: &mut [Patch], known: f64) -> f64 {
        let tuning = ExposureTuning::default();
        let solver = Solver { keyframes: KEYFRAMES, tuning: &tuning };
        let (found, decision) = solver.vignetting(patches, &solver.unit(), Vignetting { strength: known });
        let Decision::Vignetting { strength, .. } = decision else { panic!("{decision:?}") };
        assert_eq!(strength, found.strength);
        found.strength
    }

    #[test]
    fn vignetting_is_found_beside_gains_and_undone() {
        let mut seen = patches(0.2);
        let strength = found(&mut seen, 0.0);
        assert!((strength - 0.2).abs() < 0.01, "{strength}");
        for (freed, even) in seen.iter().zip(patches(0.0)) {
            let off = |k: usize| (freed.logs[k][0] - even.logs[k][0]).abs();
            assert!((0..KEYFRAMES).all(|k| off(k) < 0.01), "{:?}", freed.logs);
        }
        // What is free of it already still says how much it was.
        let again = found(&mut seen, strength);
        assert!((again - strength).abs() < 0.005, "{again}");
    }

    #[test]
    fn even_pictures_have_none_and_glare_in_the_middle_is_none() {
        assert_eq!(found(&mut patches(0.0), 0.0), 0.0);
        let mut dazzled = patches(0.6);
        assert_eq!(found(&mut dazzled, 0.0), 0.0);
        let off = |(a, b): (&Patch, &Patch)| (a.logs[3][0] - b.logs[3][0]).abs();
        assert!(dazzled.iter().zip(&patches(0.6)).map(off).fold(0.0, f64::max) < 1e-9);
    }
}
