//! The model of light that held-out surface asks for: distant light first, then secondary light as it was observed, emitting
//! surfaces, lamps beside the scene; a smooth function of position and normal where none of them explains more.

use crate::association::lampless_air::LamplessAir;
use crate::factorisation::albedo::{self, Detail, Evidence};
use crate::factorisation::held_out::mean;
use crate::factorisation::scale::{self, Fixed, Scaled};
use crate::factorisation::{Colors, FactorisationOptions, Factorised, SeenBackground, Solution};
use crate::light_model::division::Division;
use crate::light_model::emitters::{self, Piece};
use crate::light_model::held_out::{
    self, Blocks, CrossValidated, LEAST_GAIN, cross_validated, is_better, segment_albedo,
};
use crate::light_model::lamps::{self, Sphere};
use crate::light_model::samples::Samples;
use crate::light_model::secondary;
use crate::light_model::smooth_fallback::Smooth;
use crate::light_model::solve::{self, Rows, Solved};
use crate::rays::RayScene;
use crate::transfer::Traced;
use firmware_config::tuning::{FactorisationTuning, SegmentationTuning};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::decision::{Decision, LightRung};
use recordings::local_light::{Emitter, Lamp, LightModel, LocalLight};
use recordings::types::Mesh;
use std::sync::{Arc, Mutex, PoisonError};

/// Bands of the light beyond the scene in near models.
const BANDS: usize = 5;
/// Regularisation of the light beyond the scene while models are compared, and those that the chosen one is solved with.
pub(super) const REGULARISATION: f64 = 1e-2;
const REGULARISATIONS: [f64; 3] = [1e-1, 1e-2, 1e-3];
/// A weaker regularisation must lower the held-out error by this share.
pub(super) const WORTHWHILE: f64 = 0.01;
/// A near model must leave less than this share of what distant light leaves in the means of patches. Gloss, which depends on where
/// the camera is, can be explained by lamps in part; lamps explain more.
const NEAR_LEAVES: f64 = 0.73;
/// Once all else was tried, a near model stands beside a smooth function that explains more if it leaves less than this share of what
/// no model leaves. A smooth function interpolates: what differs from segment to segment it takes for light as well as for paint.
const LEAVES_OF_NONE: f64 = 0.35;
/// A model that leaves no more than this stands beside a smooth function that leaves less: what the function interpolates there is
/// glare and other errors that neighbours share.
const EXPLAINS: f64 = 0.08;
/// Distant light that leaves no more than this unexplained is not questioned: colours themselves err by about as much.
const UNQUESTIONED: f64 = 0.03;
/// Nor is it where it leaves less than this share of what a smooth function of position and normal leaves, …
const PLAIN: f64 = 0.35;
/// … nor another model where it leaves less than this share.
const CLEAR: f64 = 0.5;
/// A clipped piece beside other sources is a source if without it, reflecting what arrives there, this many times as much is unexplained.
/// What sources light most is clipped in every picture, and its light stands in for errors of theirs.
const REFLECTS: f64 = 1.2;
/// Light that is not secondary is not scaled by less than this where secondary light is nearly all there is.
const MIN_REST: f64 = 0.1;
/// What was not seen is taken to bring its whole radiance somewhere: hidden behind furniture, where hardly any of it arrives, it would
/// else be taken for a blinding light.
const LEAST_OF_UNSEEN: f64 = 1.0;
/// Samples that the mean albedo counts as where nobody saw a segment. Two vertices at an edge do not tell of a ceiling.
const MEAN_COUNTS: f64 = 4.0;
/// Times that radiance of what was not seen is taken from the model.
const FILLS: usize = 2;
/// A fill that multiplies the held-out error by this has run away: a lamp that nearly touches what was not seen makes it outshine
/// all. Smaller rises are none: held-out surface is often what the fill, though right, explains worse.
const RUN_AWAY: f64 = 2.0;

/// What the choice is made from.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// Mesh.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub rays: &'a RayScene,
    /// Lit colours and segments.
    pub colors: Colors<'a>,
    /// What was not seen may radiate more than what is around it.
    pub unseen_radiates: bool,
    /// Lamps that the pictures show: only how bright they are is asked.
    pub seen_lamps: &'a [Sphere],
    /// Where they show that there is none.
    pub lampless_air: &'a LamplessAir,
    /// What pictures show beyond the scene.
    pub background: &'a SeenBackground,
    /// What tells paints apart; `None` where segments stay as they are.
    pub divided_by: Option<&'a SegmentationTuning>,
}

/// What takes the place of the distant answer.
pub struct Near {
    /// Light beyond the scene and segments' albedo.
    pub solution: Solution,
    /// Albedo per vertex.
    pub detail: Detail,
    /// Irradiance over π per vertex, of all light.
    pub irradiance: Vec<Vec3>,
    /// Lamps, emission, and the model.
    pub light: LocalLight,
    /// What fixed the scale of albedo and light.
    pub scale: Decision,
}

/// The model that held-out surface asks for.
pub struct Chosen {
    /// What takes the place of the distant answer; `None` where that is kept.
    pub near: Option<Near>,
    /// The distant answer with a sun, if that takes its place.
    pub sunny: Option<Factorised>,
    /// The choice and its evidence.
    pub decisions: Vec<Decision>,
    /// Times that richer models were tried.
    pub searches: u32,
    /// Where no model clearly explains the colours: parts of the segments with which one explains more, and that decision. The choice is
    /// to be made again with them.
    pub division: Option<(Division, Decision)>,
}

/// Chooses the model that held-out surface asks for, against the distant answer `found`. `may_search` is asked before richer
/// models are tried.
#[must_use]
pub fn choose(
    scene: &Scene,
    found: &Factorised,
    options: &FactorisationOptions,
    may_search: &mut dyn FnMut() -> bool,
) -> Chosen {
    let mut choice = Choice::new(scene, &found.transfer.traced, options.tuning);
    let given = choice.samples.irradiance(found);
    let distant = cross_validated(&choice.samples, |_| given.clone());
    let samples = choice.samples.len() as u32;
    let mut ladder = vec![LightRung { model: LightModel::Distant, held_out: mean(&distant.blocks) }];
    let (mut near, mut sunny, mut near_light, mut division) = (None, None, None, None);
    let flat = mean(&cross_validated(&choice.samples, |s| vec![[1.0; 3]; s.len()]).blocks);
    let smoothed = mean(&cross_validated(&choice.samples, |s| Smooth::fit(scene.mesh, s).at(scene.mesh, s)).blocks);
    let unexplained = smoothed.min(flat);
    ladder.push(LightRung { model: LightModel::Unexplained, held_out: unexplained });
    let questioned = mean(&distant.blocks) > UNQUESTIONED.max(PLAIN * unexplained) && distant.blocks.len() > 1;
    let mut searches = 0;
    if questioned && may_search() {
        searches += 1;
        choice.observe();
        let best = choice.regularised(&choice.grown(&mut ladder));
        let columns = choice.columns(choice.bands(), &best.emitters, &best.lamps);
        let solved = |s: &Samples| solve::solve(&columns.rows(s), best.regularisation);
        let of_best = cross_validated(&choice.samples, |s| solved(s).irradiance);
        // While it grew, one fold judged it.
        ladder.pop_if(|rung| rung.model == best.kind());
        ladder.push(LightRung { model: best.kind(), held_out: mean(&of_best.blocks) });
        let is_near;
        (is_near, near_light) = is_near_light(&of_best, unexplained, &distant);
        let is_distant = !is_near || best.kind() == LightModel::Secondary;
        let least = mean(if is_near { &of_best.blocks } else { &distant.blocks });
        let stands = scene.unseen_radiates && is_near && least < LEAVES_OF_NONE * flat;
        let is_unexplained = !stands && least > EXPLAINS && unexplained < least * (1.0 - LEAST_GAIN);
        // A near model that is clearly better than a smooth function has the segments right.
        if is_unexplained || is_near && least > CLEAR * unexplained {
            searches += u32::from(scene.divided_by.is_some());
            division = scene.divided_by.and_then(|paints| choice.divided(&best, paints));
        }
        // Segments are right before a sun is looked for: what they take for one paint passes for its shadows.
        let may_shine = is_distant && division.is_none() && !scene.unseen_radiates;
        if may_shine && let Some((answer, blocks)) = choice.sunny(found, options) {
            ladder.push(LightRung { model: LightModel::Lamps, held_out: mean(&blocks) });
            let explains = unexplained >= mean(&blocks) * (1.0 - LEAST_GAIN);
            let is_better = is_better(&blocks, &distant.blocks) && mean(&blocks) <= least;
            sunny = (explains && is_better).then_some(answer);
        }
        if sunny.is_some() {
            near_light = near_light.filter(|_| !is_near);
        } else if is_unexplained {
            let smooth = Smooth::fit(scene.mesh, &choice.samples);
            let smooth = |i: usize| if flat < smoothed { [1.0; 3] } else { smooth.irradiance(scene.mesh, i) };
            near = Some(choice.unexplained(smooth, found));
        } else if is_near && division.is_none() {
            near = Some(choice.finished(best, found));
        }
    }
    let distant = if sunny.is_some() { LightModel::Lamps } else { LightModel::Distant };
    let chosen = near.as_ref().map_or(distant, |n| n.light.model);
    let decisions = near_light.into_iter().chain([Decision::LightModel { chosen, ladder, samples }]).collect();
    Chosen { near, sunny, decisions, searches, division }
}

/// True if a near model takes the place of distant light, with its evidence where that is asked for: it explains more than a smooth function
/// that would replace distant light, or means of patches far better than distant light.
fn is_near_light(near: &CrossValidated, unexplained: f64, distant: &CrossValidated) -> (bool, Option<Decision>) {
    let replaced = unexplained < mean(&distant.blocks) * (1.0 - LEAST_GAIN);
    if replaced && mean(&near.blocks) < unexplained {
        return (true, None);
    }
    if !is_better(&near.blocks, &distant.blocks) {
        return (false, None);
    }
    let (of_distant, of_near) = (mean(&distant.patches), mean(&near.patches));
    let accepted = of_near < NEAR_LEAVES * of_distant;
    (accepted, Some(Decision::NearLight { accepted, distant: of_distant, near: of_near, most: NEAR_LEAVES }))
}

/// A model of light: lamps, emitting pieces, and what they were solved to.
#[derive(Clone)]
pub(super) struct Model {
    /// Lamps.
    pub lamps: Vec<Sphere>,
    /// Emitting pieces, by number.
    pub emitters: Vec<usize>,
    /// Weight of the regularisation towards the mean radiance.
    pub regularisation: f64,
    /// Light and albedos.
    pub solved: Solved,
    /// Errors of held-out blocks.
    pub blocks: Blocks,
}

impl Model {
    pub fn kind(&self) -> LightModel {
        match (self.lamps.is_empty(), self.emitters.is_empty()) {
            (true, true) => LightModel::Secondary,
            (false, true) => LightModel::Lamps,
            (true, false) => LightModel::Emitters,
            (false, false) => LightModel::LampsAndEmitters,
        }
    }

    /// Its emitting pieces but for one.
    pub fn emitters_without(&self, piece: usize) -> Vec<usize> {
        self.emitters.iter().copied().filter(|p| *p != piece).collect()
    }
}

/// A model at every vertex.
struct Filled {
    model: Model,
    /// Over π: `[vertex]`.
    irradiance: Vec<Vec3>,
    /// Its secondary part.
    secondary: Vec<Vec3>,
}

/// A model without a piece that may reflect.
struct Trial<'a> {
    filled: Filled,
    /// Form factors of its sources: `[source][vertex]`.
    columns: Vec<&'a [f32]>,
    /// What every surface radiates by it: `[vertex]`.
    radiance: Vec<Vec3>,
}

/// The values of [`Rows`].
pub(super) struct Columns {
    coefficients: usize,
    columns: usize,
    shared: Vec<f32>,
    secondary: Vec<[f64; 3]>,
    least_brought: Vec<f64>,
}

impl Columns {
    /// Rows of these samples.
    pub fn rows<'a>(&'a self, samples: &'a Samples) -> Rows<'a> {
        let Self { coefficients, columns, ref shared, ref secondary, ref least_brought } = *self;
        Rows { samples, coefficients, columns, shared, secondary, least_brought }
    }

    /// Rows of some samples, by number.
    pub fn chosen(&self, numbers: &[usize]) -> Self {
        let of = |n: &usize| &self.shared[n * self.columns..][..self.columns];
        Self {
            shared: numbers.iter().flat_map(of).copied().collect(),
            secondary: numbers.iter().map(|n| self.secondary[*n]).collect(),
            least_brought: self.least_brought.clone(),
            ..*self
        }
    }
}

/// Form factors of lamps at the samples.
type LampColumns = Arc<Mutex<Vec<(Sphere, Arc<Vec<f32>>)>>>;

/// A choice that is being made.
pub(super) struct Choice<'a> {
    pub scene: &'a Scene<'a>,
    pub traced: &'a Traced,
    tuning: &'a FactorisationTuning,
    pub samples: Samples,
    pub pieces: Vec<Piece>,
    /// Pieces from this one on were not seen: they radiate besides what is taken from around them.
    pub unseen: usize,
    /// Form factors of the pieces: `[piece][sample]`.
    piece_columns: Vec<Vec<f32>>,
    /// Form factors of lamps that were in a model: `[sample]`. Models are tried by the dozen around the same lamps.
    lamp_columns: LampColumns,
    /// What every surface radiates, as observed or from around: `[vertex]`.
    radiance: Vec<Vec3>,
}

impl<'a> Choice<'a> {
    fn new(scene: &'a Scene<'a>, traced: &'a Traced, tuning: &'a FactorisationTuning) -> Self {
        let samples = Samples::new(scene.mesh, &scene.colors, &traced.vertex_weight);
        Self {
            scene,
            traced,
            tuning,
            samples,
            pieces: Vec::new(),
            unseen: 0,
            piece_columns: Vec::new(),
            lamp_columns: LampColumns::default(),
            radiance: Vec::new(),
        }
    }

    /// Finds what may emit, and what surfaces radiate.
    fn observe(&mut self) {
        let Scene { mesh, rays, colors, unseen_radiates, .. } = *self.scene;
        let graph = colors.graph;
        let seen: Vec<bool> = colors.lit_weight.iter().map(|w| *w > 0.0).collect();
        self.radiance = secondary::filled(graph, colors.lit_color, &seen);
        self.pieces = emitters::candidates(mesh, graph, colors.clipped, &seen);
        self.unseen = self.pieces.len();
        if unseen_radiates {
            self.pieces.extend(emitters::unseen_patches(mesh, &seen));
        }
        let column = |piece: &Piece| emitters::form_factors(mesh, rays, self.traced, piece, &self.samples.vertex);
        self.piece_columns = self.pieces.iter().map(column).collect();
    }

    /// Those of some pieces that pictures show.
    pub fn seen(&self, pieces: &[usize]) -> Vec<usize> {
        pieces.iter().copied().filter(|p| *p < self.unseen).collect()
    }

    /// Radiance of all surfaces but those that emit.
    fn radiance_without(&self, emitters: &[usize]) -> Vec<Vec3> {
        let mut radiance = self.radiance.clone();
        for &i in self.seen(emitters).iter().flat_map(|p| &self.pieces[*p].vertices) {
            radiance[i as usize] = Vec3::ZERO;
        }
        radiance
    }

    /// Columns of (N5) with these sources, in `bands` bands.
    pub fn columns(&self, bands: usize, emitters: &[usize], lamps: &[Sphere]) -> Columns {
        let lamps: Vec<Arc<Vec<f32>>> = lamps.iter().map(|lamp| self.lamp_column(lamp)).collect();
        let (all, coefficients) = (self.traced.bands * self.traced.bands, bands * bands);
        let columns = coefficients + emitters.len() + lamps.len();
        let radiance = self.radiance_without(emitters);
        let mut shared = Vec::with_capacity(self.samples.len() * columns);
        for (n, &i) in self.samples.vertex.iter().enumerate() {
            shared.extend_from_slice(&self.traced.direct[i as usize * all..][..coefficients]);
            shared.extend(emitters.iter().map(|p| self.piece_columns[*p][n]));
            shared.extend(lamps.iter().map(|l| l[n]));
        }
        let secondary = |i: &u32| secondary::secondary(self.traced, &radiance, *i as usize);
        let secondary = self.samples.vertex.par_iter().map(secondary).map(|g| g.to_array().map(f64::from)).collect();
        let least = |p: &usize| if *p < self.unseen { 0.0 } else { LEAST_OF_UNSEEN };
        let least_brought = emitters.iter().map(least).collect();
        Columns { coefficients, columns, shared, secondary, least_brought }
    }

    /// Form factors of a lamp: `[sample]`.
    fn lamp_column(&self, lamp: &Sphere) -> Arc<Vec<f32>> {
        let columns = || self.lamp_columns.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, column)) = columns().iter().find(|(l, _)| l == lamp) {
            return Arc::clone(column);
        }
        // Not under the lock: whoever waits for it may hold the rays that this one waits for.
        let column = Arc::new(lamps::form_factors(self.scene.mesh, self.scene.rays, &self.samples.vertex, lamp));
        columns().push((*lamp, column.clone()));
        column
    }

    /// SH bands of near models.
    pub fn bands(&self) -> usize {
        BANDS.min(self.traced.bands)
    }

    /// The model with these sources.
    pub fn solved(&self, emitters: &[usize], lamps: &[Sphere], regularisation: f64) -> Model {
        let solved = solve::solve(&self.columns(self.bands(), emitters, lamps).rows(&self.samples), regularisation);
        let blocks = held_out::errors(&self.samples, |n| solved.irradiance[n]);
        Model { lamps: lamps.to_vec(), emitters: emitters.to_vec(), regularisation, solved, blocks }
    }

    /// The same choice with other segments.
    fn in_segments(&self, division: &Division) -> Self {
        let samples = self.samples.in_segments(&division.part, division.of.len());
        let (pieces, piece_columns, radiance) =
            (self.pieces.clone(), self.piece_columns.clone(), self.radiance.clone());
        // Of the same vertices.
        let lamp_columns = Arc::clone(&self.lamp_columns);
        Self { samples, pieces, piece_columns, lamp_columns, radiance, ..*self }
    }

    /// Parts of the segments with which a model explains held-out surface better than `best` does: all that faces one way is a part,
    /// and those that come out alike under `best` are one again.
    fn divided(&self, best: &Model, paints: &SegmentationTuning) -> Option<(Division, Decision)> {
        let facing = Division::by_facing(self.scene.mesh, self.scene.colors.segment);
        let finest = self.in_segments(&facing);
        let albedo = finest.regularised(best).solved.albedo;
        let division = facing.joined(&albedo, &finest.samples.surface(|_| true), paints);
        let divided = self.in_segments(&division);
        let found = divided.regularised(&divided.grown(&mut Vec::new()));
        let decision = Decision::Division {
            segments: self.samples.segments as u32,
            parts: division.of.len() as u32,
            held_out_segments: mean(&best.blocks),
            held_out: mean(&found.blocks),
        };
        is_better(&found.blocks, &best.blocks).then_some((division, decision))
    }

    /// The model with the strongest regularisation that a weaker one does not beat.
    fn regularised(&self, model: &Model) -> Model {
        let tried: Vec<Model> =
            REGULARISATIONS.par_iter().map(|r| self.solved(&model.emitters, &model.lamps, *r)).collect();
        let kept = tried.into_iter().reduce(|best, next| {
            if mean(&next.blocks) < mean(&best.blocks) * (1.0 - WORTHWHILE) { next } else { best }
        });
        kept.unwrap_or_else(|| model.clone())
    }

    /// Irradiance over π of all vertices but for secondary light.
    fn direct_light(&self, model: &Model, columns: &[&[f32]]) -> Vec<[f64; 3]> {
        let (all, used) = (self.traced.bands * self.traced.bands, self.bands() * self.bands());
        let light = &model.solved.light;
        let at = |i: usize| {
            let transfer = self.traced.direct[i * all..].iter().copied().take(used);
            let values = transfer.chain(columns.iter().map(|c| c[i]));
            values.zip(light).fold([0.0; 3], |sum: [f64; 3], (t, l)| [0, 1, 2].map(|c| sum[c] + f64::from(t) * l[c]))
        };
        (0..self.traced.vertices()).into_par_iter().map(at).collect()
    }

    /// The chosen model at every vertex, what was not seen and what is clipped radiating as the model says.
    fn finished(&mut self, model: Model, found: &Factorised) -> Near {
        let Scene { mesh, rays, .. } = *self.scene;
        let every: Vec<u32> = (0..self.traced.vertices() as u32).collect();
        let emitter = |p: &usize| emitters::form_factors(mesh, rays, self.traced, &self.pieces[*p], &every);
        let lamp = |l: &Sphere| lamps::form_factors(mesh, rays, &every, l);
        let columns: Vec<Vec<f32>> = model.emitters.iter().map(emitter).chain(model.lamps.iter().map(lamp)).collect();
        let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
        let filled = self.filled(model, &columns);
        let Filled { model, irradiance, secondary } = self.without_reflecting(filled, columns);
        let used = self.bands() * self.bands();
        let mut local = LocalLight { model: model.kind(), ..LocalLight::default() };
        for (p, radiance) in model.emitters.iter().zip(&model.solved.light[used..]) {
            if radiance.iter().any(|r| *r > 0.0) {
                local.emitters.push(Emitter { vertices: self.pieces[*p].vertices.clone(), radiance: *radiance });
            }
        }
        for (l, power) in model.lamps.iter().zip(&model.solved.light[used + model.emitters.len()..]) {
            let area = f64::from(l.radius).powi(2);
            let radiance = power.map(|p| p / area);
            local.lamps.push(Lamp { center: l.center.to_array(), radius_m: l.radius, radiance });
        }
        let solution = Solution {
            light: model.solved.light[..used].to_vec(),
            standard_deviation: model.solved.standard_deviation[..used].to_vec(),
            radiance: model.solved.radiance,
            albedo: model.solved.albedo,
            ..found.solution.clone()
        };
        self.near(solution, irradiance, &secondary, model.solved.scale_deviation, local)
    }

    /// Lets clipped pieces reflect that other sources make shine: the one that is missed least first. `columns` are the form factors of
    /// emitting pieces and lamps, `[source][vertex]`.
    fn without_reflecting(&mut self, mut best: Filled, mut columns: Vec<&[f32]>) -> Filled {
        loop {
            let pieces = best.model.emitters.iter().copied().enumerate().filter(|(_, p)| *p < self.unseen);
            let pieces: Vec<(usize, usize)> = pieces.collect();
            if pieces.len() + best.model.lamps.len() < 2 {
                return best;
            }
            let most = REFLECTS * mean(&best.model.blocks);
            let before = self.radiance.clone();
            let mut least: Option<Trial> = None;
            for (at, p) in pieces {
                let mut columns = columns.clone();
                columns.remove(at);
                let without = Model { emitters: best.model.emitters_without(p), ..best.model.clone() };
                let filled = self.filled(self.regularised(&without), &columns);
                let radiance = std::mem::replace(&mut self.radiance, before.clone());
                if mean(&filled.model.blocks) <= least.as_ref().map_or(most, |l| mean(&l.filled.model.blocks)) {
                    least = Some(Trial { filled, columns, radiance });
                }
            }
            let Some(trial) = least else { return best };
            (best, columns, self.radiance) = (trial.filled, trial.columns, trial.radiance);
        }
    }

    /// Takes the radiance of what was not seen and of what is clipped from the model, and solves it again with that. `columns` as above.
    fn filled(&mut self, mut model: Model, columns: &[&[f32]]) -> Filled {
        let (mut irradiance, mut secondary) = self.arriving(&model, columns);
        let colors = self.scene.colors;
        for _ in 0..FILLS {
            for (i, (radiance, irradiance)) in self.radiance.iter_mut().zip(&irradiance).enumerate() {
                let albedo = model.solved.albedo[colors.segment[i] as usize].map(|a| a.clamp(0.0, 1.0) as f32);
                let reflected = Vec3::from_array(albedo) * *irradiance;
                if colors.lit_weight[i] <= 0.0 {
                    *radiance = reflected;
                } else if colors.clipped[i] {
                    *radiance = colors.lit_color[i].max(reflected);
                }
            }
            let next = self.regularised(&model);
            if mean(&next.blocks) > RUN_AWAY * mean(&model.blocks) {
                break;
            }
            model = next;
            (irradiance, secondary) = self.arriving(&model, columns);
        }
        Filled { model, irradiance, secondary }
    }

    /// Irradiance over π and its secondary part: `[vertex]`.
    fn arriving(&self, model: &Model, columns: &[&[f32]]) -> (Vec<Vec3>, Vec<Vec3>) {
        let direct = self.direct_light(model, columns);
        let radiance = self.radiance_without(&model.emitters);
        let reflected = |i: usize| secondary::secondary(self.traced, &radiance, i);
        let secondary: Vec<Vec3> = (0..self.traced.vertices()).into_par_iter().map(reflected).collect();
        let total = |(d, s): (&[f64; 3], &Vec3)| (Vec3::from_array(d.map(|x| x as f32)) + *s).max(Vec3::ZERO);
        (direct.iter().zip(&secondary).map(total).collect(), secondary)
    }

    /// Light as a smooth function of position and normal; what is exported as light is its mean.
    fn unexplained(&self, irradiance: impl Fn(usize) -> [f64; 3], found: &Factorised) -> Near {
        let at = |n: usize| irradiance(self.samples.vertex[n] as usize);
        let albedo = segment_albedo(&self.samples, &at);
        let vector = |i: usize| Vec3::from_array(irradiance(i).map(|e| e as f32));
        let all: Vec<Vec3> = (0..self.traced.vertices()).map(vector).collect();
        let level = all.iter().map(|e| e.as_dvec3()).sum::<glam::DVec3>() / all.len().max(1) as f64;
        // Uniform radiance L is L √(4π) times the first harmonic, and makes an irradiance over π of L.
        let first = libm::sqrt(4.0 * std::f64::consts::PI);
        let count = found.solution.radiance.len();
        let solution = Solution {
            light: vec![(level * first).to_array()],
            standard_deviation: vec![(level * first).to_array()],
            radiance: vec![level.to_array(); count],
            albedo,
            ..found.solution.clone()
        };
        let light = LocalLight { model: LightModel::Unexplained, ..LocalLight::default() };
        self.near(solution, all, &[], scale::UNKNOWN, light)
    }

    /// Albedo in detail under the new irradiance, of which `secondary` is known in units of f, and the scale of both.
    fn near(
        &self,
        mut solution: Solution,
        mut irradiance: Vec<Vec3>,
        secondary: &[Vec3],
        deviation: [f64; 3],
        mut light: LocalLight,
    ) -> Near {
        let unseen = self.fill_unseen(&mut solution.albedo);
        let transfer_error = self.traced.relative_errors();
        let evidence = Evidence::new(&self.scene.colors, &irradiance, &transfer_error);
        let evidence = if light.model == LightModel::Unexplained { evidence.unexplained() } else { evidence };
        let mut detail = albedo::detail(&evidence, &solution.albedo, self.tuning);
        let Colors { lit_weight, segment, .. } = self.scene.colors;
        for (i, albedo) in detail.albedo.iter_mut().enumerate().filter(|(i, _)| lit_weight[*i] <= 0.0) {
            *albedo = DVec3::from_array(unseen[segment[i] as usize]).as_vec3();
        }
        let emitting = || light.emitters.iter().flat_map(|e| &e.vertices);
        emitting().for_each(|i| detail.confidence[*i as usize] = 0.0);
        let answer = Scaled { solution: &mut solution, detail: &mut detail, irradiance: &mut irradiance, deviation };
        let Fixed { factor, decision } = scale::fix(answer, &self.scene.colors, self.tuning);
        // What was seen of a source shows no albedo; what was not is surface like the rest.
        let shows_none = emitting().filter(|i| lit_weight[**i as usize] > 0.0);
        shows_none.for_each(|i| detail.albedo[*i as usize] = Vec3::splat(self.tuning.initial_albedo as f32));
        // Secondary light stays as observed: what else arrives makes up for it.
        let rest = self.rest(&irradiance, secondary, factor);
        solution.scale(DVec3::ONE, rest);
        let scaled = |radiance: &mut [f64; 3]| *radiance = (DVec3::from_array(*radiance) * rest / factor).to_array();
        light.emitters.iter_mut().for_each(|e| scaled(&mut e.radiance));
        light.lamps.iter_mut().for_each(|l| scaled(&mut l.radiance));
        Near { solution, detail, irradiance, light, scale: decision }
    }

    /// Gives segments that no sample tells of the mean albedo of the surface seen. Returns the albedo of what nobody saw: its
    /// segment's, mixed with the mean as if that were [`MEAN_COUNTS`] samples more, `[segment]`.
    fn fill_unseen(&self, albedo: &mut [[f64; 3]]) -> Vec<[f64; 3]> {
        let Samples { segment, weight, .. } = &self.samples;
        let (seen, mut count) = (self.samples.surface(|_| true), vec![0.0; albedo.len()]);
        let samples = segment.iter().zip(weight).filter(|(_, w)| **w > 0.0);
        samples.for_each(|(s, _)| count[*s as usize] += 1.0);
        let total: f64 = seen.iter().sum();
        if total <= 0.0 {
            return albedo.to_vec();
        }
        let mean = [0, 1, 2].map(|c| albedo.iter().zip(&seen).map(|(a, w)| w * a[c]).sum::<f64>() / total);
        albedo.iter_mut().zip(&seen).filter(|(_, w)| **w <= 0.0).for_each(|(a, _)| *a = mean);
        let mixed =
            |(a, n): (&[f64; 3], &f64)| [0, 1, 2].map(|c| (n * a[c] + MEAN_COUNTS * mean[c]) / (n + MEAN_COUNTS));
        albedo.iter().zip(&count).map(mixed).collect()
    }

    /// What the light that is not secondary has to be multiplied by, per channel, so that the surfaces get this irradiance on
    /// the whole, if the model had it `factor` times as high.
    fn rest(&self, irradiance: &[Vec3], secondary: &[Vec3], factor: DVec3) -> DVec3 {
        let seen = |i: &u32| self.scene.colors.lit_weight[*i as usize] > 0.0 && (*i as usize) < secondary.len();
        let sum =
            |of: &[Vec3]| self.samples.vertex.iter().filter(|i| seen(i)).map(|i| of[*i as usize].as_dvec3()).sum();
        let (all, reflected): (DVec3, DVec3) = (sum(irradiance), sum(secondary));
        let [wanted, had] = [(all - reflected) * factor, all * factor - reflected];
        let ratio = |c: usize| if had[c] > 0.0 { (wanted[c] / had[c]).max(MIN_REST) } else { 1.0 };
        DVec3::new(ratio(0), ratio(1), ratio(2))
    }
}
