//! Keyframes that show more glare than surface: a lamp or a window beside the surface, whose light the lens scatters over the
//! picture. Their veil is unknown, since what scatters is clipped, and it passes for exposure.

use crate::association::exposure_patches::Patch;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::observations::RefinedView;
use crate::association::veil::Veil;
use crate::numerics::channels::mean;
use crate::numerics::robust::weighted_median;
use recordings::decision::Decision;

/// A keyframe may be hazed where this share of its picture is clipped: a veil of what is not is known.
const LEAST_CLIPPED: f64 = 0.05;
/// It is where glare is this share of the light that its patches have, …
const MOSTLY: f64 = 0.5;
/// … and gain and veil leave at most this share of what a gain alone leaves.
const LEAVES: f64 = 0.6;
/// Patches that tell gain and veil apart.
const LEAST_PATCHES: usize = 30;
/// Relative error at which a patch counts half: of gloss, prints and poses, not of noise.
const TOLERANCE: f64 = 0.2;
/// Rounds of reweighting.
const ROUNDS: usize = 20;

/// A keyframe that shows more glare than surface.
#[derive(Debug, Clone, Copy)]
pub struct Hazed {
    /// Its index.
    pub keyframe: usize,
    /// Its gain by surface alone.
    pub gain: f64,
    /// Share of its light that is glare: median over the patches that it shows.
    pub glare: f64,
}

/// At most one of so many keyframes is left out: many of them are the scene.
const ONE_OF: usize = 3;

/// Keyframes that are left out of the observations, with their pictures.
#[derive(Default)]
pub struct LeftOut {
    keyframes: Vec<(Hazed, Option<KeyframeImage>)>,
}

impl LeftOut {
    /// Takes the pictures of hazed keyframes away, those with most glare first. `false` if none is.
    pub fn take(&mut self, mut hazed: Vec<Hazed>, images: &mut [Option<KeyframeImage>]) -> bool {
        hazed.sort_by(|a, b| b.glare.total_cmp(&a.glare));
        hazed.truncate((images.len() / ONE_OF).saturating_sub(self.keyframes.len()));
        self.keyframes.extend(hazed.iter().map(|h| (*h, images[h.keyframe].take())));
        !hazed.is_empty()
    }

    /// Puts the pictures back. The keyframes have the gains of what they show of the surface, and no veil that is known. `None` if
    /// there are none.
    pub fn give_back(
        self,
        images: &mut [Option<KeyframeImage>],
        views: &mut [RefinedView],
        veils: &mut [Option<Veil>],
    ) -> Option<Decision> {
        let glare: Vec<(u32, f64)> = self.keyframes.iter().map(|(h, _)| (h.keyframe as u32, h.glare)).collect();
        for (hazed, image) in self.keyframes {
            let j = hazed.keyframe;
            (images[j], views[j].gain, veils[j]) = (image, [hazed.gain; 3], None);
        }
        (!glare.is_empty()).then_some(Decision::Haze { glare })
    }
}

/// What a keyframe shows of a patch.
struct Shown {
    /// Image value c, mean of the channels.
    value: f64,
    /// Radiance by the other keyframes m, in the units of the gains.
    radiance: f64,
    /// Its veil at a share of 1, V.
    veil: f64,
    weight: f64,
}

/// The hazed ones of the keyframes, ascending: those of a picture with a clipped part in which c = g m + s V with g and s of the
/// keyframe holds over the patches where c = g m does not, and s V is most of c. `gains` are the logarithms of the gains found:
/// `[keyframe][channel]`; `clipped` is the clipped share of the pictures: `[keyframe]`.
pub fn hazed(patches: &[Patch], gains: &[[f64; 3]], clipped: &[f64]) -> Vec<Hazed> {
    let dazzled = (0..gains.len()).filter(|j| clipped[*j] >= LEAST_CLIPPED);
    dazzled.filter_map(|j| of_keyframe(j, patches, gains)).collect()
}

fn of_keyframe(j: usize, patches: &[Patch], gains: &[[f64; 3]]) -> Option<Hazed> {
    let shown: Vec<Shown> = patches.iter().filter_map(|p| Shown::of(p, j, gains)).collect();
    if shown.len() < LEAST_PATCHES {
        return None;
    }
    let plain = fit(&shown, false);
    let veiled = fit(&shown, true);
    let mut glare: Vec<(f64, f64)> = shown.iter().map(|s| (veiled.share * s.veil / s.value, s.weight)).collect();
    let glare = weighted_median(&mut glare)?.min(1.0);
    (glare > MOSTLY && veiled.left < LEAVES * plain.left).then_some(Hazed { keyframe: j, gain: veiled.gain, glare })
}

impl Shown {
    fn of(patch: &Patch, j: usize, gains: &[[f64; 3]]) -> Option<Self> {
        let own = patch.keyframes.iter().position(|k| usize::from(*k) == j)?;
        let others = (0..patch.keyframes.len()).filter(|k| *k != own);
        let log = |k: usize| mean(&patch.logs[k]) - mean(&gains[usize::from(patch.keyframes[k])]);
        let mut radiances: Vec<(f64, f64)> = others.map(|k| (log(k), patch.weights[k])).collect();
        let radiance = patch.level * libm::exp(weighted_median(&mut radiances)?);
        let value = patch.level * libm::exp(mean(&patch.logs[own]));
        (value > 0.0).then_some(Self { value, radiance, veil: patch.veils[own], weight: patch.known[own] })
    }
}

/// Gain g, share of the veil s, and the share of the patches' weight that they leave unexplained.
struct Fit {
    gain: f64,
    share: f64,
    left: f64,
}

/// c = g m + s V by reweighted least squares of relative errors (Geman and McClure's weights); s = 0 unless `with_veil`.
fn fit(shown: &[Shown], with_veil: bool) -> Fit {
    let tolerance = TOLERANCE * TOLERANCE;
    let mut ratios: Vec<(f64, f64)> = shown.iter().map(|s| (s.value / s.radiance.max(1e-12), s.weight)).collect();
    let (mut gain, mut share) = (weighted_median(&mut ratios).unwrap_or(1.0), 0.0);
    let square = |s: &Shown, gain: f64, share: f64| (1.0 - (gain * s.radiance + share * s.veil) / s.value).powi(2);
    for round in 0..ROUNDS {
        // [m m, m V, V V, m c, V c], all over c².
        let mut sums = [0.0; 5];
        for s in shown {
            // The first round is without weights: the start may be far off.
            let x = if round == 0 && with_veil { 1.0 } else { tolerance / (tolerance + square(s, gain, share)) };
            let (m, v, w) = (s.radiance / s.value, s.veil / s.value, s.weight * x * x);
            [m * m, m * v, v * v, m, v].iter().zip(&mut sums).for_each(|(term, sum)| *sum += w * term);
        }
        let [mm, mv, vv, mc, vc] = sums;
        let determinant = mm * vv - mv * mv;
        let both = ((mc * vv - vc * mv) / determinant, (mm * vc - mv * mc) / determinant);
        let is_valid = with_veil && determinant > 1e-9 * mm * vv && both.0 > 0.0 && both.1 > 0.0;
        (gain, share) = if is_valid { both } else { (mc / mm.max(1e-12), 0.0) };
    }
    let (left, total) = shown.iter().fold((0.0, 0.0), |(left, total), s| {
        let square = square(s, gain, share);
        (left + s.weight * square / (square + tolerance), total + s.weight)
    });
    Fit { gain, share, left: left / f64::max(total, 1e-12) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the last of eight keyframes shows of 60 patches of many colours, by the radiance and number of the patch; the others show the
    /// radiance itself.
    fn patches(last: impl Fn(f64, usize) -> f64) -> Vec<Patch> {
        let patch = |p: usize| {
            let radiance = 0.02 * libm::exp(0.35 * (p % 10) as f64);
            let value = |k: u16| if k == 7 { last(radiance, p) } else { radiance };
            let logs = (0..8).map(|k| [libm::log(value(k) / 0.1); 3]).collect();
            let veils = (0..8).map(|k| if k == 7 { 0.3 + 0.01 * (p / 10) as f64 } else { 0.0 }).collect();
            Patch { veils, ..Patch::made_up(0.1, (0..8).collect(), logs) }
        };
        (0..60).map(patch).collect()
    }

    /// The last picture has a lamp in it.
    const DAZZLED: [f64; 8] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2];

    #[test]
    fn without_clipped_light_there_is_no_haze() {
        let patches = patches(|radiance, _| 0.3 * radiance + 0.15);
        let gains = [[0.0; 3]; 8];
        assert_eq!(hazed(&patches, &gains, &DAZZLED).len(), 1);
        assert!(hazed(&patches, &gains, &[0.01; 8]).is_empty());
    }

    #[test]
    fn a_keyframe_of_mostly_glare_is_found_with_its_own_gain() {
        let patches = patches(|radiance, p| 0.3 * radiance + 0.5 * (0.3 + 0.01 * (p / 10) as f64));
        let gains = vec![[0.0; 3]; 8];
        let [found] = hazed(&patches, &gains, &DAZZLED)[..] else { panic!("{:?}", hazed(&patches, &gains, &DAZZLED)) };
        assert_eq!(found.keyframe, 7);
        assert!((found.gain - 0.3).abs() < 0.01 && found.glare > 0.7, "{found:?}");
    }

    #[test]
    fn another_exposure_and_some_glare_are_no_haze() {
        assert!(hazed(&patches(|radiance, _| 4.0 * radiance), &[[0.0; 3]; 8], &DAZZLED).is_empty());
        assert!(hazed(&patches(|radiance, _| radiance + 0.02 * 0.3), &[[0.0; 3]; 8], &DAZZLED).is_empty());
    }

    #[test]
    fn gloss_on_half_of_the_surface_is_no_haze() {
        let gloss = |radiance, p: usize| if p.is_multiple_of(2) { radiance } else { radiance + 0.2 };
        assert!(hazed(&patches(gloss), &[[0.0; 3]; 8], &DAZZLED).is_empty());
    }

    #[test]
    fn most_keyframes_stay() {
        let one = |keyframe| Hazed { keyframe, gain: 1.0, glare: 0.5 + 0.05 * keyframe as f64 };
        let mut images: Vec<Option<KeyframeImage>> = (0..7).map(|_| None).collect();
        let mut left_out = LeftOut::default();
        assert!(left_out.take((0..5).map(one).collect(), &mut images));
        assert!(!left_out.take(vec![one(5)], &mut images));
        let view =
            RefinedView { world_from_camera: recordings::types::Pose::IDENTITY, gain: [2.0; 3], residual_px: 0.0 };
        let mut views = vec![view; 7];
        let decision = left_out.give_back(&mut images, &mut views, &mut vec![None; 7]);
        let Some(Decision::Haze { glare }) = decision else { panic!("{decision:?}") };
        assert_eq!(glare.iter().map(|g| g.0).collect::<Vec<_>>(), [4, 3]);
        assert_eq!((views[4].gain, views[0].gain), ([1.0; 3], [2.0; 3]));
    }
}
