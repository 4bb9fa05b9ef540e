//! From a scan to light and materials (§3.1 second half – §3.4).

pub mod albedo;
pub mod association;
pub mod export;
pub mod exposure;
pub mod factorise;
mod graph;
pub mod inverse;
pub mod literal;
mod material;
mod picture;
pub mod plan;
pub mod pose;
pub mod preview;
pub mod random;
mod raster;
pub mod reality;
mod refit;
mod regions;
pub mod remesh;
mod response;
mod robust;
pub mod scene;
pub mod segmentation;
pub mod sh;
pub mod specular;
mod surface;
mod template;
pub mod thickness;
pub mod transfer;
mod trust;
pub mod witness;

use crate::factorise::{Colors, Factorised, Settings, factorise};
use crate::plan::Plan;
use crate::scene::Scene;
use crate::specular::Gloss;
use firmware_config::{EstimatorConfig, Switch, TransferChoice};
use glam::Vec3;
use recordings::result::{Decision, Estimate, Light, ResultKeyframe, Segment};
use recordings::scan::Scan;
use std::sync::Arc;
use std::time::Duration;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The scan holds nothing that could be estimated from.
    #[error("{0}")]
    Unusable(String),
}

/// What a run may spend.
#[derive(Debug, Clone)]
pub struct Options {
    /// Wall time from start to result.
    pub budget: Duration,
    /// Fixed number of ray rounds: replaces the clock, and the result is byte-identical.
    pub rounds: Option<u32>,
}

/// Told about every stage as it goes.
pub trait Progress: Sync {
    /// `fraction` of stage `name` is done (0 at its start, 1 at its end).
    fn stage(&self, name: &'static str, fraction: f64);
}

/// Estimates light and materials. Reads like the paper's section list.
///
/// # Errors
/// The scan is unusable: no vertices, or no keyframe that can be read.
pub fn estimate(
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    let mut plan = Plan::new(options);
    let mut decisions = Vec::new();

    // §3.1: a regular mesh, and the keyframes' colours on it (Eqs. 2–5).
    progress.stage("mesh", 0.0);
    let mesh = remesh::regularise(&scan.mesh, config, scan.source);
    let scene = Scene::new(&mesh);
    usable(&mesh)?;
    let response = scan.sensor.response;
    let mut fields = association::associate(&mesh, &scene, &scan.keyframes, &response, config, progress);
    decisions.append(&mut fields.decisions);
    let (decision, doubt) = response::verify(&fields, &response);
    decisions.push(decision);
    if fields.lit_weight.iter().all(|w| *w <= 0.0) {
        return Err(EstimateError::Unusable("no keyframe shows any part of the mesh unclipped".into()));
    }

    // §3.2: segments (Eqs. 6–7).
    progress.stage("segmentation", 0.0);
    let segment = segmentation::segment(&mesh, &scene, &fields.lit_color, &fields.lit_weight, config);
    let segments = segment.iter().max().map_or(0, |s| *s as usize + 1);

    // §3.3: transfer (Eq. 8), then light and albedo (Eqs. 9–12).
    let rays = plan.rays(&mesh, &scene, config);
    let bands = if config.bands > 0 { config.bands as usize } else { sh::AUTO_BANDS };
    let traced = if config.transfer == TransferChoice::Diffuse {
        transfer::unoccluded(&mesh, bands)
    } else {
        transfer::trace(&mesh, &scene, bands, rays, config.seed, &|done| progress.stage("transfer", done))
    };
    let gi = match config.transfer {
        TransferChoice::Auto => traced.mean_blocked() > config.gi_from_blocked,
        choice => choice == TransferChoice::Gi,
    };
    progress.stage("factorisation", 0.0);
    let settings = Settings { gi, bands, bounces: config.bounces, solver: config.solver };
    let colors = Colors { lit_color: &fields.lit_color, lit_weight: &fields.lit_weight, segment: &segment, segments };
    let mut found = factorise(Arc::new(traced), &colors, &settings, None);

    // §3.4: specular weights (Eq. 13); lit colours without gloss are factorised once more.
    let lit_with_gloss = fields.lit_color.clone();
    let mut gloss = vec![Gloss::NONE; segments];
    if config.specular != Switch::Off {
        progress.stage("specular", 0.0);
        let decision;
        (found, gloss, decision) = refit::refit(&mesh, &scene, &mut fields, &segment, found, &settings);
        decisions.push(decision);
    }

    // Frames that no step used.
    progress.stage("witnesses", 0.0);
    let diffuse: Vec<Vec3> = found.detail.albedo.iter().zip(&found.irradiance).map(|(a, e)| *a * *e).collect();
    let model = witness::Model {
        reflection: refit::reflection(&mesh, &scene, &found),
        lit_color: &lit_with_gloss,
        lit_weight: &fields.lit_weight,
        diffuse: &diffuse,
        segment: &segment,
        gloss: &gloss,
    };
    let witnesses = scan.witnesses.iter().filter_map(|w| witness::compare(&model, w, &response)).collect();
    decisions.push(transfer_decision(&found, rays));

    let keyframes = scan.keyframes.iter().zip(&fields.views);
    let keyframes = keyframes.map(|(k, v)| ResultKeyframe {
        name: k.name.clone(),
        timestamp_ns: k.color.timestamp_ns,
        gain: v.gain,
        world_from_camera: v.world_from_camera,
        camera: k.camera,
        residual_px: v.residual_px,
    });
    let mut warnings = Vec::from_iter(doubt);
    if scan.keyframes.len() < 2 {
        warnings.push("one keyframe: exposure, pose and gloss cannot be told".to_owned());
    }
    progress.stage("done", 1.0);
    Ok(Estimate {
        name: scan.name.clone(),
        response,
        keyframes: keyframes.collect(),
        segments: segment_table(&segment, &found, &gloss),
        light: light(&found),
        mesh,
        segment,
        lit_color: fields.lit_color,
        albedo: found.detail.albedo,
        confidence: found.detail.confidence,
        transfer: match (config.transfer, gi) {
            (TransferChoice::Diffuse, _) => "diffuse",
            (_, true) => "gi",
            _ => "shade",
        }
        .into(),
        decisions,
        cuts: plan.cuts,
        warnings,
        albedo_scale_rule: factorise::SCALE_RULE.into(),
        witnesses,
    })
}

fn usable(mesh: &recordings::types::Mesh) -> Result<(), EstimateError> {
    if mesh.positions.is_empty() || mesh.triangles.is_empty() {
        return Err(EstimateError::Unusable("the mesh has no triangle".into()));
    }
    Ok(())
}

fn light(found: &Factorised) -> Light {
    Light {
        coefficients: found.solution.light.clone(),
        standard_deviation: found.solution.standard_deviation.clone(),
        directions: inverse::directions().iter().map(|d| d.as_vec3().to_array()).collect(),
        radiance: found.solution.radiance.iter().map(|r| r.map(|x| x as f32)).collect(),
    }
}

fn segment_table(segment: &[u32], found: &Factorised, gloss: &[Gloss]) -> Vec<Segment> {
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

fn transfer_decision(found: &Factorised, rays: u32) -> Decision {
    let traced = &found.transfer.traced;
    let blocked = traced.mean_blocked();
    let bounced = found.transfer.bounced.as_ref().map_or(String::new(), |b| {
        format!(
            "; {} bounces bring {:.1} % of the light, the last {:.2} %",
            b.bounces,
            100.0 * b.share,
            100.0 * b.last_share
        )
    });
    Decision {
        name: "transfer".into(),
        choice: if found.transfer.bounced.is_some() { "gi" } else { "shade" }.into(),
        evidence: format!(
            "{:.1} % of the rays are blocked{bounced}; {rays} rays a vertex, relative standard error {:.3}",
            100.0 * blocked,
            traced.relative_error()
        ),
        next_level: format!("twice the rays: relative standard error about {:.3}", 0.6 * traced.relative_error()),
    }
}
