//! Growth of a near model: emitting pieces and lamps are added, placed again and taken away while held-out surface asks for it.

use crate::factorisation::held_out::mean;
use crate::light_model::choose::{Choice, Model, REGULARISATION, WORTHWHILE};
use crate::light_model::held_out::is_better;
use crate::light_model::lamps::Sphere;
use crate::light_model::samples;
use crate::light_model::search::Search;
use crate::light_model::solve::Solved;
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::LightRung;

/// Bands while a lamp is looked for.
const SEARCH_BANDS: usize = 3;
/// Lamps at most.
const MAX_LAMPS: usize = 4;
/// A lamp in place of a piece is worth placing all lamps again if it leaves no more than this, relative to the piece.
const PROMISING: f64 = 1.1;
/// Times that every lamp is placed again at most.
const PLACINGS: usize = 5;
/// Radius of a lamp that was not seen, as a share of its distance from the scene's centre.
const LAMP_RADIUS: f32 = 0.05;
/// A lamp this many scene sizes away is at infinity.
const INFINITE: f32 = 1e3;

impl Choice<'_> {
    /// Lets what was not seen radiate more than what is around it, lights the lamps that are seen, then adds emitting pieces, puts a lamp
    /// in place of what was not seen where that explains more, and adds further lamps, all while held-out surface asks for them; takes away
    /// pieces at last that it does not miss, and puts lamps in place of pieces where they explain more.
    pub(super) fn grown(&self, ladder: &mut Vec<LightRung>) -> Model {
        let solved = |emitters: &[usize], lamps: &[Sphere]| self.solved(emitters, lamps, REGULARISATION);
        let mut note = |m: &Model| ladder.push(LightRung { model: m.kind(), held_out: mean(&m.blocks) });
        let mut best = solved(&[], &[]);
        note(&best);
        best = self.with_patches(best);
        if !self.scene.seen_lamps.is_empty() {
            let next = solved(&best.emitters, self.scene.seen_lamps);
            // Their places are told already: they need not explain much to be there.
            if mean(&next.blocks) < mean(&best.blocks) {
                best = next;
                note(&best);
            }
        }
        loop {
            let with = |p: usize| {
                let mut emitters = best.emitters.clone();
                emitters.push(p);
                solved(&emitters, &best.lamps)
            };
            let others: Vec<usize> = (0..self.unseen).filter(|p| !best.emitters.contains(p)).collect();
            let next = least_held_out(others.into_par_iter().map(with).collect());
            let Some(next) = next.filter(|n| is_better(&n.blocks, &best.blocks)) else { break };
            best = next;
        }
        if !best.emitters.is_empty() {
            note(&best);
        }
        if let Some(instead) = self.with_lamp_instead_of_patches(&best) {
            best = instead;
            note(&best);
        }
        while best.lamps.len() < MAX_LAMPS {
            let Some(next) = self.with_lamp(&best, best.lamps.len()) else { break };
            if !is_better(&next.blocks, &best.blocks) {
                break;
            }
            best = next;
            note(&best);
        }
        if best.lamps.is_empty() {
            return best;
        }
        // The first lamps were placed as if there were no others, which may stand for them.
        for l in (self.told(&best)..best.lamps.len()).rev() {
            if best.lamps.len() < 2 {
                break;
            }
            let mut lamps = best.lamps.clone();
            lamps.remove(l);
            let without = solved(&best.emitters, &lamps);
            if !is_better(&best.blocks, &without.blocks) {
                best = without;
                note(&best);
            }
        }
        // A lamp that was not there yet may have been taken for emission, …
        for p in self.seen(&best.emitters) {
            let without = solved(&best.emitters_without(p), &best.lamps);
            if !is_better(&best.blocks, &without.blocks) {
                best = without;
                note(&best);
            }
        }
        // … and one that another lamp, which then stood for both, left no place for.
        for p in self.seen(&best.emitters) {
            if let Some(instead) = self.with_lamp_instead(&best, p) {
                best = instead;
                note(&best);
            }
        }
        best
    }

    /// The model with patches that no picture shows, where held-out surface asks for them.
    fn with_patches(&self, model: Model) -> Model {
        if self.unseen == self.pieces.len() {
            return model;
        }
        let emitters: Vec<usize> = model.emitters.iter().copied().chain(self.unseen..self.pieces.len()).collect();
        let next = self.solved(&emitters, &model.lamps, REGULARISATION);
        if is_better(&next.blocks, &model.blocks) { self.without_idle(next) } else { model }
    }

    /// Takes away the patches that least is told of, as many as held-out surface does not miss: hidden ones take any radiance.
    fn without_idle(&self, full: Model) -> Model {
        let (seen, mut best, mut patches) = (self.seen(&full.emitters), full.clone(), self.patches(&full));
        let mut fewer = patches.len() / 2;
        while fewer > 0 {
            let kept = &patches[..patches.len() - fewer];
            let next = self.solved(&[&seen, kept].concat(), &full.lamps, REGULARISATION);
            if is_better(&full.blocks, &next.blocks) {
                fewer /= 2;
            } else {
                fewer = fewer.min(kept.len() / 2);
                patches = self.patches(&next);
                best = next;
            }
        }
        best
    }

    /// The patches of a model, those first whose radiance is the most standard deviations.
    fn patches(&self, model: &Model) -> Vec<usize> {
        let Solved { light, standard_deviation, .. } = &model.solved;
        let first = self.bands() * self.bands();
        let sum = |of: &[[f64; 3]], n: usize| of[first + n].iter().sum::<f64>();
        let told = |n: usize| sum(light, n) / sum(standard_deviation, n).max(f64::MIN_POSITIVE);
        let patches = model.emitters.iter().enumerate().filter(|(_, p)| **p >= self.unseen);
        let mut patches: Vec<(f64, usize)> = patches.map(|(n, p)| (told(n), *p)).collect();
        patches.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        patches.into_iter().map(|(_, p)| p).collect()
    }

    /// The model with a lamp in place of all patches, and with those that are missed then, if that explains more: patches stand in
    /// for a lamp that no picture shows.
    fn with_lamp_instead_of_patches(&self, model: &Model) -> Option<Model> {
        let seen = self.seen(&model.emitters);
        if seen.len() == model.emitters.len() {
            return None;
        }
        let found = self.with_patches(self.with_lamp_and(&seen, model)?);
        (mean(&found.blocks) < mean(&model.blocks)).then_some(found)
    }

    /// The model with one more lamp in place of a piece, all lamps placed again, if that explains more.
    fn with_lamp_instead(&self, model: &Model, piece: usize) -> Option<Model> {
        let instead = self.with_lamp_and(&model.emitters_without(piece), model)?;
        if mean(&instead.blocks) > PROMISING * mean(&model.blocks) {
            return None;
        }
        let placed = self.placed_again(instead);
        is_better(&placed.blocks, &model.blocks).then_some(placed)
    }

    /// One more lamp than the model has, beside these emitters instead of its own, if there may be one more.
    fn with_lamp_and(&self, emitters: &[usize], model: &Model) -> Option<Model> {
        if model.lamps.len() >= MAX_LAMPS {
            return None;
        }
        self.with_lamp(&self.solved(emitters, &model.lamps, REGULARISATION), model.lamps.len())
    }

    /// Lamps, the first ones, whose places pictures tell.
    fn told(&self, model: &Model) -> usize {
        if model.lamps.starts_with(self.scene.seen_lamps) { self.scene.seen_lamps.len() } else { 0 }
    }

    /// Looks for the place of each lamp that was not seen again, the others held, while that explains more: where there are several, the
    /// first ones were placed as if there were no others.
    fn placed_again(&self, mut best: Model) -> Model {
        let told = self.told(&best);
        // Lamps whose search would find what it found, since no other lamp has moved after it.
        let mut settled = 0;
        for _ in 0..PLACINGS {
            let before = mean(&best.blocks);
            for l in told..best.lamps.len() {
                if settled == best.lamps.len() - told {
                    return best;
                }
                let mut lamps = best.lamps.clone();
                lamps.remove(l);
                let without = self.solved(&best.emitters, &lamps, REGULARISATION);
                if let Some(again) = self.with_lamp(&without, l)
                    && mean(&again.blocks) < mean(&best.blocks)
                {
                    (best, settled) = (again, 1);
                } else {
                    settled += 1;
                }
            }
            if mean(&best.blocks) > before * (1.0 - WORTHWHILE) {
                break;
            }
        }
        best
    }

    /// The model with one more lamp, number `at`, where it fits best; `None` if it fits as well at infinity.
    fn with_lamp(&self, model: &Model, at: usize) -> Option<Model> {
        let is_possible = |place: &Vec3| !self.scene.lampless_air.has_no_lamp(self.scene.rays, *place);
        let places = self.search(&model.emitters, &model.lamps).best_places(is_possible);
        let (low, high) = samples::bounds(self.scene.mesh);
        let middle = 0.5 * (low + high);
        let solved = |sphere: Sphere| {
            let mut lamps = model.lamps.clone();
            lamps.insert(at, sphere);
            self.solved(&model.emitters, &lamps, REGULARISATION)
        };
        let near = |center: Vec3| solved(Sphere { center, radius: LAMP_RADIUS * center.distance(middle) });
        let near = least_held_out(places.into_par_iter().map(near).collect())?;
        let distant = solved(self.at_infinity((near.lamps[at].center - middle).normalize_or_zero()));
        is_better(&near.blocks, &distant.blocks).then_some(near)
    }

    /// The search for a lamp beside these sources.
    pub(super) fn search(&self, emitters: &[usize], lamps: &[Sphere]) -> Search<'_> {
        let columns = self.columns(SEARCH_BANDS.min(self.traced.bands), emitters, lamps);
        let is_first = lamps.len() <= self.scene.seen_lamps.len();
        Search::new(self.scene.mesh, self.scene.rays, &self.samples, &columns, is_first)
    }

    /// A lamp at infinity in this direction, a unit vector from the scene.
    pub(super) fn at_infinity(&self, direction: Vec3) -> Sphere {
        let (low, high) = samples::bounds(self.scene.mesh);
        let distance = INFINITE * low.distance(high);
        Sphere { center: 0.5 * (low + high) + direction * distance, radius: LAMP_RADIUS * distance }
    }
}

/// The model with the least held-out error.
pub(super) fn least_held_out(models: Vec<Model>) -> Option<Model> {
    models.into_iter().min_by(|a, b| mean(&a.blocks).total_cmp(&mean(&b.blocks)))
}
