//! Cost of the stages in reference seconds: seconds of an idle machine of two cores. The planner divides by the speed that it
//! measures, so only the proportions matter.

/// One round of association with one step of every pose, per pixel and per vertex of every keyframe.
const PER_PIXEL: f64 = 4.7e-8;
const PER_SIGHTING: f64 = 4.5e-7;
/// Decoding a picture, per pixel.
const PER_PIXEL_DECODED: f64 = 6.0e-8;
/// Reading the mesh and building the BVH, per vertex.
const PER_VERTEX_READ: f64 = 2.0e-6;
/// Coarsening a mesh, per vertex of the fine one.
const PER_VERTEX_COARSENED: f64 = 1.0e-6;
/// Regularising a mesh, per vertex.
const PER_VERTEX_REMESHED: f64 = 1.2e-5;
/// Segmentation, per vertex.
const PER_VERTEX_SEGMENTED: f64 = 6.0e-6;
/// One ray with its spherical harmonics.
const PER_RAY: f64 = 3.0e-7;
/// One hit in one bounce.
const PER_HIT: f64 = 5.0e-9;
/// One solution with nine bands: the part that grows with the bands, and the rest.
const SOLVED_BANDS: f64 = 0.35;
const SOLVED: f64 = 0.05;
/// Gloss fitted, and lit colours cleaned of it, per observation of a vertex.
const PER_OBSERVATION: f64 = 5.0e-7;
/// Passes of cleaning and factorising again.
const PASSES: f64 = 3.0;
/// Looking for lamps and emitting surfaces: a search over places, and the light of what was found at every vertex.
const LAMP_SEARCH: f64 = 1.0;
const PER_VERTEX_LIT: f64 = 2.0e-5;
/// One validation frame, per pixel.
const PER_WITNESS_PIXEL: f64 = 3.0e-6;
/// The atlas, its texels without the views, and its compression.
const ATLAS: f64 = 0.6;
/// The texels of one keyframe.
const PER_TEXTURED_VIEW: f64 = 0.12;
/// Writing the result, per vertex.
const PER_VERTEX_WRITTEN: f64 = 1.0e-6;
/// Bounces until convergence, typically.
const LIKELY_BOUNCES: f64 = 8.0;
/// Series of bounces in a run: for model selection, the first albedo, the last albedo, and again without gloss.
pub const BOUNCED: f64 = 4.0;

/// Factorisations that tell glare and materials: trials of the share, one without glare, two with materials.
pub const AGAIN: f64 = 4.0;

/// Size of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Vertices of the scan's mesh.
    pub scanned: f64,
    /// That mesh is regularised first.
    pub remeshed: bool,
    /// Vertices that the estimator works on.
    pub vertices: f64,
    /// Keyframes.
    pub keyframes: f64,
    /// Pixels of a keyframe.
    pub pixels: f64,
    /// Validation frames.
    pub witnesses: f64,
}

/// Reading the mesh, and regularising or coarsening it.
#[must_use]
pub fn mesh(size: &Size, coarser: bool) -> f64 {
    let each = match (coarser, size.remeshed) {
        (true, _) => PER_VERTEX_COARSENED,
        (false, true) => PER_VERTEX_REMESHED,
        _ => 0.0,
    };
    (PER_VERTEX_READ + each) * size.scanned
}

/// Decoding the keyframes.
#[must_use]
pub fn pictures(size: &Size) -> f64 {
    PER_PIXEL_DECODED * size.pixels * size.keyframes
}

/// One round of association.
#[must_use]
pub fn association(size: &Size) -> f64 {
    size.keyframes * (PER_PIXEL * size.pixels + PER_SIGHTING * size.vertices)
}

/// Segmentation.
#[must_use]
pub fn segmentation(size: &Size) -> f64 {
    PER_VERTEX_SEGMENTED * size.vertices
}

/// Tracing `rays` rays per vertex.
#[must_use]
pub fn rays(vertices: f64, rays: u32) -> f64 {
    PER_RAY * vertices * f64::from(rays)
}

/// One series of bounces, 0 = until convergence; `blocked` is the share of rays that hit.
#[must_use]
pub fn bounces(vertices: f64, rays: u32, blocked: f64, bounces: u32) -> f64 {
    let count = if bounces == 0 { LIKELY_BOUNCES } else { f64::from(bounces) };
    PER_HIT * vertices * f64::from(rays) * blocked * count
}

/// One solution for the light.
#[must_use]
pub fn solution(bands: usize) -> f64 {
    let share = (bands * bands) as f64 / 81.0;
    SOLVED + SOLVED_BANDS * share * share
}

/// Gloss, and the factorisation once more without it.
#[must_use]
pub fn specular(size: &Size, bands: usize) -> f64 {
    // About a third of the keyframes see any one vertex.
    PASSES * (PER_OBSERVATION * size.vertices * size.keyframes / 3.0 + solution(bands))
}

/// Looking for lamps and emitting surfaces.
#[must_use]
pub fn local_light(size: &Size) -> f64 {
    LAMP_SEARCH + PER_VERTEX_LIT * size.vertices
}

/// The texture.
#[must_use]
pub fn texture(size: &Size) -> f64 {
    ATLAS + PER_TEXTURED_VIEW * size.keyframes
}

/// Predicting one validation frame.
#[must_use]
pub fn witness(size: &Size) -> f64 {
    PER_WITNESS_PIXEL * size.pixels
}

/// Writing the result.
#[must_use]
pub fn output(size: &Size) -> f64 {
    PER_VERTEX_WRITTEN * size.vertices
}
