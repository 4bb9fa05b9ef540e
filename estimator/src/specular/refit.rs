//! Gloss found and removed: exposures, lit colours and factorisation once more without it (§3.4).

use crate::association::Association;
use crate::factorisation::KnownAlbedo;
use crate::factorisation::{Colors, FactorisationOptions, Factorised, factorise};
use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::specular::clean::clean;
use crate::specular::fit::fit;
use crate::specular::gloss::Gloss;
use crate::specular::material;
use crate::specular::mirror_rays::MirrorRays;
use crate::specular::prediction::{Materials, Prediction, predict};
use crate::specular::reflection::Reflection;
use firmware_config::tuning::SpecularTuning;
use glam::Vec3;
use recordings::decision::Decision;
use recordings::types::Mesh;
use std::sync::Arc;

/// Gloss that raises the error of the prediction by more than this share, whatever the bands, is none: errors of poses and light pass
/// for it.
const CONTRADICTED: f64 = 0.02;
/// A pass that lowers the error by a smaller share is the last.
const WORTHWHILE: f64 = 0.01;

/// Gloss on less than this share of the surface seen tells nothing of exposures, of light or of its bands: it is taken away, no more.
const LITTLE: f64 = 0.02;

/// The surface whose gloss is fitted.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Its edges.
    pub graph: &'a Graph,
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
    /// Number of segments.
    pub segments: usize,
    /// A surface whose albedo is known.
    pub known: Option<&'a KnownAlbedo>,
}

/// Light, albedo and gloss, and the decisions that led to them.
pub struct Refitted {
    /// The factorisation without gloss.
    pub found: Factorised,
    /// Specular weights: `[segment]`.
    pub gloss: Vec<Gloss>,
    /// Whether gloss was removed, and with how many bands.
    pub decisions: Vec<Decision>,
}

/// A factorisation with gloss removed from the lit colours.
struct Cleaned<'a> {
    found: Factorised,
    gloss: Vec<Gloss>,
    prediction: Prediction,
    options: FactorisationOptions<'a>,
}

/// Fits the gloss of every segment (Eq. 13). If any is significant, exposures are taken from matte segments, and lit colours are
/// cleaned of gloss and factorised again, repeatedly as long as that improves the prediction of the keyframes; `fields` then hold
/// the clean colours. More bands are tried too, since gloss may have hidden them.
#[must_use]
pub fn refit(
    surface: &Surface,
    fields: &mut Association,
    found: Factorised,
    options: &FactorisationOptions,
    tuning: &SpecularTuning,
) -> Refitted {
    let rays = MirrorRays::new(surface.mesh, surface.scene);
    let (found, gloss, exposure_change) = fit_and_expose(surface, &rays, fields, found, options, tuning);
    let glossy = gloss.iter().filter(|g| g.significant).count();
    let decision = |cleaned, without_gloss, with_gloss| Decision::Specular {
        cleaned,
        segments: surface.segments as u32,
        glossy: glossy as u32,
        exposure_change,
        without_gloss,
        with_gloss,
    };
    if glossy == 0 {
        return Refitted { found, gloss, decisions: vec![decision(false, None, Vec::new())] };
    }
    let refitter = Refitter { surface, rays: &rays, fields, tuning };
    // Significant weights that views bear out are the evidence: the prediction hangs on the error of the light more than on gloss,
    // so it does not decide whether gloss is there, but where it contradicts with all bands.
    let without = refitter.predict(&found, &vec![Gloss::NONE; surface.segments]).error();
    let most = without * (1.0 + CONTRADICTED);
    let mut best = refitter.cleaned(&found, &gloss, *options);
    let mut errors = vec![best.prediction.error()];
    let mut with_more_bands = Vec::new();
    if surface.share(&gloss, &fields.lit_weight) >= LITTLE {
        errors.extend(refitter.repeat(&mut best));
        best = refitter.more_bands(best, &mut with_more_bands);
    }
    if best.prediction.error() > most {
        let decisions = vec![decision(false, Some(without), errors)];
        return Refitted { found, gloss: vec![Gloss::NONE; surface.segments], decisions };
    }
    let decisions = std::iter::once(decision(true, Some(without), errors)).chain(with_more_bands).collect();
    let gloss = material::pooled(surface.graph, surface.segment, &best.found.solution.albedo, &best.gloss, tuning);
    // Once more: what is taken out is what the result has.
    let lit_color = clean(&surface.reflection(&best.found), &rays, fields, surface.segment, &gloss, tuning);
    best.found.detail_of(&surface.colors(&lit_color, fields), options.tuning);
    fields.lit_color = lit_color;
    Refitted { found: best.found, gloss, decisions }
}

/// Fits the gloss; if any is significant, takes exposures from matte segments and, if they changed, factorises and fits again.
/// Returns the RMS change of the log gains besides.
fn fit_and_expose(
    surface: &Surface,
    rays: &MirrorRays,
    fields: &mut Association,
    found: Factorised,
    options: &FactorisationOptions,
    tuning: &SpecularTuning,
) -> (Factorised, Vec<Gloss>, Option<f64>) {
    let fit = |found: &Factorised, fields: &Association| {
        fit(&surface.reflection(found), rays, fields, surface.segment, surface.segments, tuning)
    };
    let gloss = fit(&found, fields);
    if surface.share(&gloss, &fields.lit_weight) < LITTLE {
        return (found, gloss, None);
    }
    let is_matte: Vec<bool> = surface.segment.iter().map(|s| !gloss[*s as usize].significant).collect();
    let change = fields.expose_by(&is_matte, surface.mesh, surface.scene.median_edge());
    if !change.is_some_and(|moved| moved > tuning.min_gain_change) {
        return (found, gloss, change);
    }
    let colors = surface.colors(&fields.lit_color, fields);
    let found = factorise(Arc::clone(&found.transfer.traced), &colors, options, Some(found.start()));
    let gloss = fit(&found, fields);
    (found, gloss, change)
}

impl Surface<'_> {
    fn colors<'a>(&'a self, lit_color: &'a [Vec3], fields: &'a Association) -> Colors<'a> {
        let Surface { segment, segments, graph, known, .. } = *self;
        Colors {
            lit_color,
            lit_weight: &fields.lit_weight,
            reliability: &fields.reliability,
            clipped: &fields.clipped,
            segment,
            segments,
            graph,
            known,
        }
    }

    /// Share of the vertices seen whose segments are glossy.
    fn share(&self, gloss: &[Gloss], lit_weight: &[f32]) -> f64 {
        let seen = || self.segment.iter().zip(lit_weight).filter(|(_, w)| **w > 0.0);
        let glossy = seen().filter(|(s, _)| gloss[**s as usize].significant).count();
        glossy as f64 / seen().count().max(1) as f64
    }

    fn reflection<'a>(&'a self, found: &'a Factorised) -> Reflection<'a> {
        Reflection::new(self.mesh, self.scene, found)
    }
}

struct Refitter<'a> {
    surface: &'a Surface<'a>,
    rays: &'a MirrorRays<'a>,
    fields: &'a Association,
    tuning: &'a SpecularTuning,
}

impl Refitter<'_> {
    fn predict(&self, found: &Factorised, gloss: &[Gloss]) -> Prediction {
        let materials = Materials { segment: self.surface.segment, albedo: &found.solution.albedo, gloss };
        predict(&self.surface.reflection(found), self.rays, self.fields, materials, self.tuning)
    }

    /// Lit colours without gloss, and light and gloss from them.
    fn cleaned<'o>(&self, from: &Factorised, gloss: &[Gloss], options: FactorisationOptions<'o>) -> Cleaned<'o> {
        let Self { surface, rays, fields, tuning } = *self;
        let lit_color = clean(&surface.reflection(from), rays, fields, surface.segment, gloss, tuning);
        // With more bands than choose it the regularisation weight stays.
        let bands = from.solution.bands();
        let is_chosen = bands == options.bands || bands >= options.tuning.regularisation_bands as usize;
        let start = is_chosen.then(|| from.start());
        let colors = surface.colors(&lit_color, fields);
        let found = factorise(Arc::clone(&from.transfer.traced), &colors, &options, start);
        let gloss = fit(&surface.reflection(&found), rays, fields, surface.segment, surface.segments, tuning);
        let prediction = self.predict(&found, &gloss);
        Cleaned { found, gloss, prediction, options }
    }

    /// Cleans and factorises again while the prediction improves. A first pass that contradicts gloss has a second one too, which may bear it
    /// out. Returns the error of each trial.
    fn repeat(&self, best: &mut Cleaned) -> Vec<f64> {
        let mut errors = Vec::new();
        for _ in 1..self.tuning.max_passes {
            let trial = self.cleaned(&best.found, &best.gloss, best.options);
            errors.push(trial.prediction.error());
            let (before, after) = (best.prediction.error(), trial.prediction.error());
            if after < before {
                *best = trial;
            }
            if after > before * (1.0 - WORTHWHILE) {
                break;
            }
        }
        errors
    }

    /// Tries two bands more, up to the maximum, while they improve the prediction significantly.
    fn more_bands<'o>(&self, mut best: Cleaned<'o>, decisions: &mut Vec<Decision>) -> Cleaned<'o> {
        let first = best.options.bands;
        while best.options.bands + 2 <= best.options.max_bands {
            let before = best.options.bands;
            let error_before = best.prediction.error();
            let options = FactorisationOptions { bands: before + 2, ..best.options };
            let mut trial = self.cleaned(&best.found, &best.gloss, options);
            let mut errors = vec![trial.prediction.error()];
            errors.extend(self.repeat(&mut trial));
            let better = trial.prediction.gain_over(&best.prediction) > self.tuning.min_prediction_gain;
            if better {
                best = trial;
            }
            decisions.push(Decision::BandsWithoutGloss {
                chosen: best.options.bands as u32,
                first: first as u32,
                before: before as u32,
                tried: options.bands as u32,
                error_before,
                errors,
            });
            if !better {
                break;
            }
        }
        best
    }
}
