//! Mesh, association and segmentation (§3.1 and §3.2).

use crate::api::EstimateError;
use crate::association::response;
use crate::association::{self, Association, AssociationContext, AssociationEffort};
use crate::factorisation::{Colors, KnownAlbedo};
use crate::mesh::graph::Graph;
use crate::mesh::{clustering, regularise};
use crate::rays::RayScene;
use crate::segmentation;
use crate::specular::refit::Surface;
use crate::stages::background::Background;
use crate::stages::reference::{Shown, reference};
use crate::stages::run::Run;
use firmware_config::EstimatorConfig;
use recordings::decision::{Decision, Warning};
use recordings::scan::{Scan, ScanSource};
use recordings::types::Mesh;

/// A mesh with fewer than one of so many vertices is sketched: care for thin things would keep far more than were planned.
const SKETCHED: usize = 20;

/// A scan, ready for the factorisation.
pub struct Prepared {
    /// Regular mesh with unit normals.
    pub mesh: Mesh,
    /// The same for rays.
    pub scene: RayScene,
    /// Its edges.
    pub graph: Graph,
    /// Surface light field.
    pub fields: Association,
    /// Segment index: `[vertex]`.
    pub segment: Vec<u32>,
    /// Number of segments.
    pub segments: usize,
    /// What keyframes saw beyond the mesh.
    pub background: Background,
    /// A surface whose albedo the user stated.
    pub known: Option<KnownAlbedo>,
    /// Decisions so far.
    pub decisions: Vec<Decision>,
    /// Warnings so far.
    pub warnings: Vec<Warning>,
}

impl Prepared {
    /// What is factorised.
    #[must_use]
    pub fn colors(&self) -> Colors<'_> {
        Colors {
            lit_color: &self.fields.lit_color,
            lit_weight: &self.fields.lit_weight,
            reliability: &self.fields.reliability,
            clipped: &self.fields.clipped,
            segment: &self.segment,
            segments: self.segments,
            graph: &self.graph,
            known: self.known.as_ref(),
        }
    }

    /// The surface whose gloss is fitted, and its light field.
    pub fn surface(&mut self) -> (Surface<'_>, &mut Association) {
        let Self { mesh, scene, graph, fields, segment, segments, known, .. } = self;
        (Surface { mesh, scene, graph, segment, segments: *segments, known: known.as_ref() }, fields)
    }
}

/// Mesh, association (Eqs. 2–5) and segments (Eqs. 6–7). Half of the making of the mesh leaves threads idle: `beside` is done beside it, and
/// returns its reference seconds.
///
/// # Errors
/// The scan is unusable: no triangle, or no keyframe that shows any of it; the reference shows no surface.
pub fn prepare(scan: &Scan, beside: impl FnOnce() -> f64 + Send, run: &mut Run) -> Result<Prepared, EstimateError> {
    run.progress.stage("mesh", 0.0);
    let (config, vertices) = (run.config, run.plan.workload().vertices);
    let (mesh, reference_seconds) = rayon::join(|| mesh(scan, config, vertices), beside);
    run.plan.worked(reference_seconds);
    prepare_on(mesh, scan, run)
}

/// The mesh of a scan with about so many vertices.
fn mesh(scan: &Scan, config: &EstimatorConfig, vertices: usize) -> Mesh {
    if vertices >= Run::size(scan, config).vertices as usize {
        regularise::regularise(&scan.mesh, config, scan.source)
    } else if vertices >= scan.mesh.positions.len() / SKETCHED {
        clustering::coarsened(&scan.mesh, vertices)
    } else {
        clustering::sketched(&scan.mesh, vertices)
    }
}

/// Association (Eqs. 2–5) and segments (Eqs. 6–7) on a mesh that stands for the scan's.
///
/// # Errors
/// As [`prepare`].
pub(super) fn prepare_on(mesh: Mesh, scan: &Scan, run: &mut Run) -> Result<Prepared, EstimateError> {
    let (config, progress, plan) = (run.config, run.progress, &mut run.plan);
    let scene = RayScene::new(&mesh);
    if mesh.positions.is_empty() || mesh.triangles.is_empty() {
        return Err(EstimateError::Unusable("the mesh has no triangle".into()));
    }
    plan.mesh_done(mesh.positions.len());
    let mut context = AssociationContext::new(&mesh, &scene, &scan.sensor.response, config);
    context.poses_are_tracked = scan.source == ScanSource::Fusion;
    let stride = plan.workload().keyframe_stride;
    let effort =
        AssociationEffort { rounds: plan.max_pose_rounds(), stride, go_on: &mut |round| plan.pose_round(round) };
    let mut fields = association::associate_within(&mut context, &scan.keyframes, progress, effort);
    let background = Background::observe(scan, &fields, &scene);
    plan.association_done();
    let mut decisions = std::mem::take(&mut fields.decisions);
    let (decision, mismatch) = response::verify(&fields, &fields.lens.response, &config.tuning.response);
    decisions.push(decision);
    if fields.lit_weight.iter().all(|w| *w <= 0.0) {
        return Err(EstimateError::Unusable("no keyframe shows any part of the mesh unclipped".into()));
    }
    progress.stage("segmentation", 0.0);
    let segment = segmentation::segment(&mesh, &context.graph, &scene, &fields.lit_color, &fields.lit_weight, config);
    let segments = segment.iter().max().map_or(0, |s| *s as usize + 1);
    plan.segmentation_done();
    let graph = context.graph;
    let warnings = Vec::from_iter(mismatch);
    let shown = Shown { mesh: &mesh, scene: &scene, graph: &graph, fields: &fields, segment: &segment };
    let known = run.options.reference.map(|stated| reference(&stated, &shown, scan)).transpose()?;
    Ok(Prepared { mesh, scene, graph, fields, segment, segments, background, known, decisions, warnings })
}
