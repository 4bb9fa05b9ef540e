//! Segments that creases should have divided, under distant light.

use crate::factorisation::held_out::mean;
use crate::factorisation::{FactorisationOptions, Factorised, Solution, robust_solver};
use crate::light_model::division::Division;
use crate::light_model::held_out::{Blocks, is_better};
use crate::model_selection::held_out_errors;
use crate::stages::materials::{albedos, factorised_again};
use crate::stages::prepare::Prepared;
use firmware_config::EstimatorConfig;
use firmware_config::tuning::SegmentationTuning;
use recordings::decision::Decision;

/// Parts hold at least this share of what was seen.
const LEAST: f64 = 0.01;
/// Parts of one paint differ by less in the level and chroma of their log albedo: light errs most between what faces different ways.
const LEVEL: f64 = 0.4;
const CHROMA: f64 = 0.25;

/// Divides segments where they turn, as a wall from its table, if an albedo for each part explains held-out surface better. Parts that
/// come out alike are one again.
pub fn divide_segments(
    prepared: &mut Prepared,
    found: Factorised,
    options: &FactorisationOptions,
    config: &EstimatorConfig,
) -> Factorised {
    let (segment, segments) = (prepared.segment.clone(), prepared.segments);
    let flat = Division::by_flat_parts(&prepared.mesh, &segment, &prepared.fields.lit_weight, LEAST);
    if flat.of.len() == segments {
        return found;
    }
    let before = held_out_errors(&found.solution.albedo, &found.irradiance, &prepared.colors(), &config.tuning);
    let (solution, _) = tried(prepared, &flat, &found, config);
    let one_paint =
        SegmentationTuning { material_level: LEVEL, material_chroma: CHROMA, ..config.tuning.segmentation.clone() };
    let division = flat.joined(&solution.albedo, &prepared.colors().seen(), &one_paint);
    if division.of.len() > segments {
        let (_, after) = tried(prepared, &division, &found, config);
        if is_better(&after, &before) {
            prepared.decisions.push(Decision::Division {
                segments: segments as u32,
                parts: prepared.segments as u32,
                held_out_segments: mean(&before),
                held_out: mean(&after),
            });
            return factorised_again(prepared, &found, options);
        }
    }
    (prepared.segment, prepared.segments) = (segment, segments);
    found
}

/// The parts in place of the segments, light and albedo with them under the transfer of `found`, and what they leave unexplained of
/// held-out surface.
fn tried(
    prepared: &mut Prepared,
    division: &Division,
    found: &Factorised,
    config: &EstimatorConfig,
) -> (Solution, Blocks) {
    (prepared.segment, prepared.segments) = (division.part.clone(), division.of.len());
    let (colors, tuning) = (prepared.colors(), &config.tuning);
    let albedo = albedos(prepared, &found.irradiance, &tuning.factorisation);
    let start = Solution { albedo, ..found.solution.clone() };
    let bands = start.bands();
    let observed = colors.under(&found.transfer);
    let solution = robust_solver::solve(&observed, bands, Some(&start), &tuning.factorisation);
    let irradiance = found.transfer.irradiance(&solution.light);
    let errors = held_out_errors(&solution.albedo, &irradiance, &colors, tuning);
    (solution, errors)
}
