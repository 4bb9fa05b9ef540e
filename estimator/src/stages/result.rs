//! The parts of the result.

use crate::factorisation::drawn_light::Drawn;
use crate::factorisation::{Factorised, White, directions, distance_check, drawn_light};
use crate::model_selection;
use crate::numerics::sh;
use crate::specular::Gloss;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use crate::stages::scale::scale_rule;
use crate::transfer::{self, Transfer};
use firmware_config::{EstimatorConfig, SolverChoice};
use recordings::decision::{BouncedLight, Decision, TransferLevel, TransferNext, Warning};
use recordings::local_light::{Lamp, LightModel, LocalLight};
use recordings::result::{Estimate, Light, ResultKeyframe, Segment};
use recordings::scan::Scan;

/// The result without texture and validation frames, and the transfer behind it. Takes mesh, segments and lit colours out of `prepared`.
#[must_use]
pub fn result(
    scan: &Scan,
    prepared: &mut Prepared,
    answer: Answer,
    local_light: LocalLight,
    light: FoundLight,
    run: &Run,
) -> (Estimate, Transfer) {
    let mut decisions = prepared.decisions.clone();
    decisions.push(transfer_decision(&answer.found, run.config));
    let one_keyframe = (scan.keyframes.len() < 2).then_some(Warning::OneKeyframe);
    let FoundLight { light, drawn, sun, unseen } = light;
    let sunny = |lamp| LocalLight { model: LightModel::Lamps, lamps: vec![lamp], ..LocalLight::default() };
    let local_light = sun.map_or(local_light, sunny);
    let (chroma, background) = drawn.map_or((None, None), |d| (Some(d.chroma), d.background));
    decisions.extend(chroma.map(|c| Decision::LightChroma { weight: c.weight, held_out: c.held_out }));
    decisions.push(prepared.background.likeness(&light, background));
    let estimate = Estimate {
        name: scan.name.clone(),
        response: prepared.fields.lens.response,
        keyframes: keyframes(scan, prepared),
        segments: segments(&prepared.segment, &answer.found, &answer.gloss),
        light,
        transfer: transfer_level(&answer.found),
        mesh: std::mem::take(&mut prepared.mesh),
        segment: std::mem::take(&mut prepared.segment),
        lit_color: std::mem::take(&mut prepared.fields.lit_color),
        albedo: answer.found.detail.albedo,
        confidence: answer.found.detail.confidence,
        albedo_scale_rule: scale_rule(&decisions),
        decisions,
        cuts: run.plan.cuts(),
        warnings: prepared.warnings.iter().cloned().chain(one_keyframe).chain(unseen).collect(),
        witnesses: Vec::new(),
        local_light,
        texture: None,
    };
    (estimate, answer.found.transfer)
}

/// Keyframes with refined poses and exposures.
fn keyframes(scan: &Scan, prepared: &Prepared) -> Vec<ResultKeyframe> {
    let keyframes = scan.keyframes.iter().zip(&prepared.fields.views);
    let keyframes = keyframes.map(|(k, v)| ResultKeyframe {
        name: k.name.clone(),
        timestamp_ns: k.color.timestamp_ns,
        gain: v.gain,
        world_from_camera: v.world_from_camera,
        camera: k.camera,
        residual_px: v.residual_px,
    });
    keyframes.collect()
}

/// The light of a result, and what it was drawn to.
#[derive(Clone)]
pub struct FoundLight {
    light: Light,
    drawn: Option<Drawn>,
    /// The lamp at infinity beside it.
    sun: Option<Lamp>,
    /// A warning where surfaces do not tell most of it.
    unseen: Option<Warning>,
}

/// The light of a result, which `answer` has from then on. With gloss it has no more than the bands that mirrors show
/// ([`sh::MIRRORED_BANDS`]).
#[must_use]
pub fn light(prepared: &Prepared, answer: &mut Answer, model: LightModel, config: &EstimatorConfig) -> FoundLight {
    let Answer { found, gloss } = answer;
    let (colors, tuning) = (prepared.colors(), &config.tuning.factorisation);
    let is_mirrored = gloss.iter().any(|g| g.significant);
    let white = White::new(found.irradiance.len());
    let white = white.under(found, &colors);
    let is_narrowed = is_mirrored && found.solution.bands() > sh::MIRRORED_BANDS;
    let mut solution = if is_narrowed {
        drawn_light::narrowed(&white, &found.solution, sh::MIRRORED_BANDS, tuning)
    } else {
        found.solution.clone()
    };
    // Eq. (9) holds for these colours where all light is distant.
    let is_told = model == LightModel::Distant && config.solver == SolverChoice::Robust;
    let seen = &prepared.background.evidence;
    let drawn = is_told.then(|| drawn_light::draw(&white, &mut solution, seen, tuning)).flatten();
    let harmonics = solution.harmonics().len();
    let suns = found.transfer.traced.sun.as_ref().zip(solution.sun());
    let sun =
        suns.map(|(sun, times)| Lamp { radiance: [0, 1, 2].map(|c| sun.lamp.radiance[c] * times[c]), ..sun.lamp });
    let directions: Vec<[f32; 3]> = directions().iter().map(|d| d.as_vec3().to_array()).collect();
    let light = Light {
        coefficients: solution.harmonics().to_vec(),
        standard_deviation: solution.standard_deviation[..harmonics].to_vec(),
        radiance: solution.radiance.iter().take(directions.len()).map(|r| r.map(|x| x as f32)).collect(),
        directions,
    };
    // Of the light that was solved: its deviations are none of what it is drawn to.
    let unseen = unseen_light(found, config);
    if is_narrowed || drawn.is_some() {
        found.exchange(solution);
    }
    FoundLight { light, drawn, sun, unseen }
}

/// The segments. `segment` is `[vertex]`, `gloss` `[segment]`.
fn segments(segment: &[u32], found: &Factorised, gloss: &[Gloss]) -> Vec<Segment> {
    let mut vertices = vec![0u32; gloss.len()];
    for s in segment {
        vertices[*s as usize] += 1;
    }
    let rows = vertices.into_iter().zip(&found.solution.albedo).zip(gloss);
    rows.map(|((vertices, albedo), g)| Segment {
        vertices,
        albedo: *albedo,
        w_d: if g.significant { g.w_d } else { 1.0 },
        w_s: if g.significant { g.w_s } else { 0.0 },
        w_s_error: g.error,
    })
    .collect()
}

/// Checks the assumption of distant light.
pub fn check_distance(prepared: &mut Prepared, found: &Factorised, config: &EstimatorConfig) {
    let Prepared { mesh, fields, segment, .. } = prepared;
    let (decision, warning) = distance_check::check(mesh, fields, segment, found, &config.tuning.distance_check);
    prepared.decisions.push(decision);
    prepared.warnings.extend(warning);
}

/// The level of a transfer.
#[must_use]
pub fn transfer_level(found: &Factorised) -> TransferLevel {
    match (found.transfer.traced.rays, &found.transfer.bounced) {
        (0, _) => TransferLevel::Diffuse,
        (_, Some(_)) => TransferLevel::Gi,
        _ => TransferLevel::Shade,
    }
}

/// A warning where the surfaces do not determine most of the light.
#[must_use]
pub fn unseen_light(found: &Factorised, config: &EstimatorConfig) -> Option<Warning> {
    let solution = &found.solution;
    let level = solution.light.first().map_or(0.0, |c| c.iter().sum::<f64>() / 3.0);
    let share = config.tuning.model_selection.undetermined_share;
    // The linear band has three coefficients; a wall determines one of them at most.
    let is_undetermined = |k: usize| {
        let deviation = solution.standard_deviation.get(k).map_or(f64::INFINITY, |d| d.iter().sum::<f64>() / 3.0);
        deviation > share * level
    };
    let directions = (1..4).filter(|k| is_undetermined(*k)).count() as u32;
    (directions > 0 && solution.light.len() < sh::MAX_COEFFICIENTS).then_some(Warning::UnseenLight { directions })
}

/// The level of the transfer, and its evidence.
#[must_use]
pub fn transfer_decision(found: &Factorised, config: &EstimatorConfig) -> Decision {
    let traced = &found.transfer.traced;
    let (chosen, relative_error) = (transfer_level(found), traced.relative_error());
    let bounced = found.transfer.bounced.as_ref();
    Decision::Transfer {
        chosen,
        vertices: traced.vertices() as u32,
        rays: traced.rays,
        blocked: traced.mean_blocked(),
        relative_error,
        bounced: bounced.map(|b| BouncedLight { bounces: b.bounces, share: b.share, last_share: b.last_share }),
        next: match chosen {
            TransferLevel::Diffuse => TransferNext::Visibility,
            TransferLevel::Shade => TransferNext::GreyBounce { share: model_selection::grey_bounce(traced, config) },
            TransferLevel::Gi => TransferNext::TwiceRays { relative_error: transfer::ERROR_OF_TWICE * relative_error },
        },
    }
}
