//! Gates: the tests that a pose must pass before its frame is fused.

use crate::tracking::align::Alignment;
use firmware_config::FusionConfig;
use nalgebra::Vector6;

/// Shortest time to which the speed limits apply, seconds.
const MIN_INTERVAL_S: f64 = 1.0 / 60.0;

/// True if a motion (twist: metres, radians) within `dt_s` is below the limits of speed and of the step between two frames.
pub fn is_plausible_motion(twist: &Vector6<f64>, dt_s: f64, config: &FusionConfig) -> bool {
    let dt = dt_s.max(MIN_INTERVAL_S);
    let (translation, rotation) = (twist.fixed_rows::<3>(0).norm(), twist.fixed_rows::<3>(3).norm());
    translation <= (config.max_speed_m_s * dt).min(config.max_step_m)
        && rotation <= (config.max_turn_rad_s * dt).min(config.max_step_rad)
}

/// True if enough of the frame agrees with the model (`fine`) or, where the model is incomplete, with the last frame
/// (`coarse`).
pub fn agrees_with_geometry(coarse: &Alignment, fine: &Alignment, config: &FusionConfig) -> bool {
    let (min_fit, tuning) = (config.min_fit as f32, &config.tuning.tracking);
    let agreement = fine.fit / fine.overlap.max(1e-3);
    fine.fit >= min_fit
        || (coarse.fit >= min_fit
            && agreement >= tuning.min_agreement as f32
            && fine.overlap >= tuning.min_overlap as f32)
}

/// True if the frame looks like one of its references (`ncc`: the correlations that could be computed). Round objects on a
/// round table have the same depth from all sides, so geometry alone is not enough.
pub fn agrees_with_images(ncc: &[f32], config: &FusionConfig) -> bool {
    let min_ncc = config.tuning.tracking.ncc_share as f32 * config.min_likeness as f32;
    ncc.is_empty() || ncc.iter().any(|c| *c >= min_ncc)
}

/// True if a relocalised pose may be fused: it needs more agreement than a tracked one. The images are compared by
/// correlation, since exposure and blur may differ from the anchor's.
pub fn accepts_relocalisation(found: &Alignment, ncc: f32, config: &FusionConfig) -> bool {
    let tuning = &config.tuning.relocalisation;
    let min_fit = (tuning.fit_factor as f32 * config.min_fit as f32).min(tuning.max_required_fit as f32);
    found.fit >= min_fit
        && found.fit >= tuning.min_agreement as f32 * found.overlap
        && found.photo_seen >= tuning.min_photometric_share as f32
        && ncc >= config.min_likeness as f32
}
