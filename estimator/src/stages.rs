//! The stages of an estimate, each on its own: `estimate()` runs them once, the trade runs some of them many times.

use crate::api::EstimateError;
use crate::api::Options;
use crate::api::Progress;
use crate::association::response;
use crate::association::{self, Association, AssociationContext, AssociationEffort};
use crate::budget::Plan;
use crate::budget::cost_model::Size;
use crate::factorisation::robust_solver;
use crate::factorisation::{Colors, Factorised, Settings, Start, factorise, narrowed};
use crate::mesh::graph::Graph;
use crate::mesh::regularise;
use crate::model_selection;
use crate::numerics::sh;
use crate::rays::RayScene;
use crate::segmentation;
use crate::specular::Gloss;
use crate::specular::refit;
use crate::transfer::{self, Traced};
use crate::validation;
use firmware_config::{EstimatorConfig, SolverChoice};
use glam::Vec3;
use recordings::decision::{BouncedLight, Cut, Decision, TransferLevel, TransferNext, Warning};
use recordings::result::{Light, ResultKeyframe, Segment, WitnessError};
use recordings::scan::{Scan, ScanSource};
use recordings::types::{Keyframe, Mesh};
use std::sync::Arc;

/// What §3.1 and §3.2 make of a scan.
pub struct Ready {
    /// Regular mesh.
    pub mesh: Mesh,
    /// The same for rays.
    pub scene: RayScene,
    /// Surface light field.
    pub fields: Association,
    /// Segment of every vertex.
    pub segment: Vec<u32>,
    /// Number of segments.
    pub segments: usize,
    /// What was decided so far.
    pub decisions: Vec<Decision>,
    /// What the user should know so far.
    pub warnings: Vec<Warning>,
}

impl Ready {
    /// What is to be factorised.
    #[must_use]
    pub fn colors(&self) -> Colors<'_> {
        Colors {
            lit_color: &self.fields.lit_color,
            lit_weight: &self.fields.lit_weight,
            segment: &self.segment,
            segments: self.segments,
        }
    }
}

/// How large a scan is.
#[must_use]
pub fn size(scan: &Scan, config: &EstimatorConfig) -> Size {
    let pixels = |k: &Keyframe| f64::from(k.camera.intrinsics.width) * f64::from(k.camera.intrinsics.height);
    let scanned = scan.mesh.positions.len() as f64;
    let remeshed = scan.source == ScanSource::Fusion && config.regularise > 0.0;
    Size {
        scanned,
        remeshed,
        vertices: if remeshed { scanned.min(f64::from(config.max_vertices)) } else { scanned },
        keyframes: scan.keyframes.len() as f64,
        pixels: scan.keyframes.first().map_or(0.0, pixels),
        witnesses: scan.witnesses.len() as f64,
    }
}

/// Mesh, association (Eqs. 2–5) and segments (Eqs. 6–7).
///
/// # Errors
/// The scan is unusable: no vertices, or no keyframe that can be read.
pub fn prepare(
    scan: &Scan,
    config: &EstimatorConfig,
    plan: &mut Plan,
    progress: &dyn Progress,
) -> Result<Ready, EstimateError> {
    progress.stage("mesh", 0.0);
    let mesh = if plan.shape().vertices < size(scan, config).vertices as usize {
        regularise::coarsened(&scan.mesh, plan.shape().vertices)
    } else {
        regularise::regularise(&scan.mesh, config, scan.source)
    };
    let scene = RayScene::new(&mesh);
    if mesh.positions.is_empty() || mesh.triangles.is_empty() {
        return Err(EstimateError::Unusable("the mesh has no triangle".into()));
    }
    plan.mesh_done(mesh.positions.len());
    let shape = plan.shape();
    let effort = AssociationEffort {
        rounds: plan.most_pose_rounds(),
        stride: shape.keyframe_stride,
        go_on: &mut |round| plan.pose_round(round),
    };
    let mut fields =
        association::associate_within(&mesh, &scene, &scan.keyframes, &scan.sensor.response, config, progress, effort);
    plan.association_done();
    let mut decisions = std::mem::take(&mut fields.decisions);
    let (decision, doubt) = response::verify(&fields, &scan.sensor.response, &config.tuning.response);
    decisions.push(decision);
    if fields.lit_weight.iter().all(|w| *w <= 0.0) {
        return Err(EstimateError::Unusable("no keyframe shows any part of the mesh unclipped".into()));
    }
    progress.stage("segmentation", 0.0);
    let segment = segmentation::segment(&mesh, &scene, &fields.lit_color, &fields.lit_weight, config);
    let segments = segment.iter().max().map_or(0, |s| *s as usize + 1);
    plan.segmentation_done();
    Ok(Ready { mesh, scene, fields, segment, segments, decisions, warnings: Vec::from_iter(doubt) })
}

/// Transfer (Eq. 8) with the rays that are set, or with a few, by which [`settle`] sees whether more are required.
pub fn transfer(
    ready: &Ready,
    config: &EstimatorConfig,
    options: &Options,
    plan: &mut Plan,
    progress: &dyn Progress,
) -> Arc<Traced> {
    let bands = plan.shape().bands;
    let pilot = model_selection::pilot(&ready.mesh, &ready.scene, config.seed);
    if model_selection::is_open(config, pilot.blocked) {
        return Arc::new(transfer::unoccluded(&ready.mesh, bands));
    }
    let most = plan.shape().rays;
    let explicit = config.rays > 0 || options.rounds.is_some();
    let rays = if explicit { most } else { most.min(model_selection::PILOT_RAYS) };
    trace(ready, config, rays, None, plan, progress)
        .unwrap_or_else(|| Arc::new(transfer::unoccluded(&ready.mesh, plan.shape().bands)))
}

/// Rays beyond those that one has, fewer if they are not there in time; `None` if those would be no more.
fn trace(
    ready: &Ready,
    config: &EstimatorConfig,
    mut rays: u32,
    have: Option<&Traced>,
    plan: &mut Plan,
    progress: &dyn Progress,
) -> Option<Arc<Traced>> {
    let bands = plan.shape().bands;
    loop {
        let first = have.map_or(0, |h| h.rays);
        let watch = plan.watch_rays(rays - first);
        let go_on = |share| {
            progress.stage("transfer", share);
            watch(share)
        };
        let traced = transfer::trace_while(&ready.mesh, &ready.scene, bands, rays, have, config.seed, &go_on);
        drop(watch);
        if let Some(traced) = traced {
            plan.rays_done(rays - first);
            return Some(Arc::new(traced));
        }
        rays = plan.fewer_rays(rays, first)?;
    }
}

/// The model that the scene requires.
pub struct Settled {
    /// Transfer with as many rays as are required.
    pub traced: Arc<Traced>,
    /// Transfer level, bounces and bands.
    pub settings: Settings,
    /// Where the factorisation may start from.
    pub start: Option<Start>,
}

/// Bounces, bands and rays, by evidence within what the plan allows.
pub fn settle(
    ready: &mut Ready,
    traced: Arc<Traced>,
    config: &EstimatorConfig,
    options: &Options,
    plan: &mut Plan,
    progress: &dyn Progress,
) -> Settled {
    progress.stage("factorisation", 0.0);
    let (bounces, most) = plan.light(traced.mean_blocked());
    let gi = model_selection::interreflects(config, &traced);
    let settings = Settings { gi, bands: most, most_bands: most, bounces, solver: config.solver };
    if config.solver != SolverChoice::Robust {
        return Settled { traced, settings, start: None };
    }
    let least = if config.bands > 0 { most } else { 1 };
    let selected = model_selection::bands(&traced, &ready.colors(), gi, bounces, least..=most);
    ready.decisions.push(selected.decision);
    let mut settled =
        Settled { traced, settings: Settings { bands: selected.bands, ..settings }, start: Some(selected.start) };
    let (have, blocked) = (settled.traced.rays, settled.traced.mean_blocked());
    if config.rays == 0 && options.rounds.is_none() && have > 0 {
        let wanted = model_selection::rays(&settled.traced, selected.held_out);
        let rays = plan.more_rays(wanted, have, blocked, selected.bands);
        settled.settings.bounces = plan.shape().bounces;
        if rays > have
            && let Some(better) = trace(ready, config, rays, Some(&settled.traced), plan, progress)
        {
            settled.traced = better;
        }
    }
    settled
}

/// More rays where the error that they may have was that of gloss, which is taken out by now.
pub fn refine(
    ready: &mut Ready,
    found: Factorised,
    settings: &Settings,
    config: &EstimatorConfig,
    options: &Options,
    plan: &mut Plan,
    progress: &dyn Progress,
) -> Factorised {
    let traced = Arc::clone(&found.transfer.traced);
    if config.rays > 0 || options.rounds.is_some() || config.solver != SolverChoice::Robust || traced.rays == 0 {
        return found;
    }
    let held_out = model_selection::held_out(&found, &ready.colors());
    let bands = found.solution.light.len().isqrt();
    let rays = plan.more_rays(model_selection::rays(&traced, held_out), traced.rays, traced.mean_blocked(), bands);
    if rays <= traced.rays {
        return found;
    }
    let Some(better) = trace(ready, config, rays, Some(&traced), plan, progress) else { return found };
    ready.decisions.push(Decision::RaysWithoutGloss {
        chosen: better.rays,
        before: traced.rays,
        held_out,
        error_before: traced.relative_error(),
        error: better.relative_error(),
        vertices: better.vertices() as u32,
    });
    let settings = Settings { bands, bounces: plan.shape().bounces, ..*settings };
    factorise(better, &ready.colors(), &settings, Some(found.into()))
}

/// Frames that no step used, as far as there is time.
pub fn witnesses(
    ready: &mut Ready,
    scan: &Scan,
    found: &Factorised,
    gloss: &[Gloss],
    lit_with_gloss: &[Vec3],
    config: &EstimatorConfig,
    plan: &mut Plan,
) -> Vec<WitnessError> {
    let diffuse: Vec<Vec3> = found.detail.albedo.iter().zip(&found.irradiance).map(|(a, e)| *a * *e).collect();
    let model = validation::Model {
        reflection: refit::reflection(&ready.mesh, &ready.scene, found),
        lit_color: lit_with_gloss,
        lit_weight: &ready.fields.lit_weight,
        diffuse: &diffuse,
        segment: &ready.segment,
        gloss,
    };
    let graph = Graph::of(&ready.mesh);
    let context = AssociationContext::new(&ready.mesh, &graph, &ready.scene, &scan.sensor.response, config);
    let mut compared = Vec::new();
    for (i, frame) in scan.witnesses.iter().enumerate() {
        if !plan.witness() {
            plan.leave_out(Cut::Witnesses { predicted: i as u32, of: scan.witnesses.len() as u32 });
            break;
        }
        compared.extend(validation::compare(&model, &context, frame, config));
    }
    ready.decisions.extend(validation::decision(&compared, config));
    compared.into_iter().map(|c| c.error).collect()
}

/// Keyframes as they are left.
#[must_use]
pub fn keyframes(scan: &Scan, ready: &Ready) -> Vec<ResultKeyframe> {
    let keyframes = scan.keyframes.iter().zip(&ready.fields.views);
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

/// The light found. Where there is gloss, it has the bands that weights mirror ([`sh::MIRRORED_BANDS`]) at most, though albedo
/// and irradiance were told with more.
#[must_use]
pub fn light(ready: &Ready, found: &Factorised, gloss: &[Gloss]) -> Light {
    let mirrored = gloss.iter().any(|g| g.significant);
    let solution = if mirrored && found.solution.light.len() > sh::MIRRORED_BANDS * sh::MIRRORED_BANDS {
        &narrowed(found, &ready.colors(), sh::MIRRORED_BANDS)
    } else {
        &found.solution
    };
    Light {
        coefficients: solution.light.clone(),
        standard_deviation: solution.standard_deviation.clone(),
        directions: robust_solver::directions().iter().map(|d| d.as_vec3().to_array()).collect(),
        radiance: solution.radiance.iter().map(|r| r.map(|x| x as f32)).collect(),
    }
}

/// The segments found.
#[must_use]
pub fn segment_table(segment: &[u32], found: &Factorised, gloss: &[Gloss]) -> Vec<Segment> {
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

/// The level that the transfer has.
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
pub fn unseen_light(found: &Factorised) -> Option<Warning> {
    let solution = &found.solution;
    let level = solution.light.first().map_or(0.0, |c| c.iter().sum::<f64>() / 3.0);
    // The linear band is three coefficients; a wall tells one of them at best.
    let vague = |k: usize| {
        let deviation = solution.standard_deviation.get(k).map_or(f64::INFINITY, |d| d.iter().sum::<f64>() / 3.0);
        deviation > UNTOLD * level
    };
    let directions = (1..4).filter(|k| vague(*k)).count() as u32;
    (directions > 0 && solution.light.len() < sh::MAX_COEFFICIENTS).then_some(Warning::UnseenLight { directions })
}

/// A coefficient of the first band is untold if its deviation exceeds this share of the mean light's coefficient.
const UNTOLD: f64 = 0.25;

/// What transfer was chosen, and on what evidence.
#[must_use]
pub fn transfer_decision(found: &Factorised) -> Decision {
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
            TransferLevel::Shade => TransferNext::GreyBounce { share: model_selection::grey_bounce(traced) },
            TransferLevel::Gi => TransferNext::TwiceRays { relative_error: transfer::ERROR_OF_TWICE * relative_error },
        },
    }
}
