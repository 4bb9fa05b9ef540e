//! Specular weights, and the factorisation without gloss (§3.4).

use crate::factorisation::{FactorisationOptions, Factorised};
use crate::specular::Gloss;
use crate::specular::refit::{Refitted, refit};
use crate::stages::model::refine;
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use firmware_config::Switch;

/// Light, albedo and gloss.
pub struct Answer {
    /// Light and albedo.
    pub found: Factorised,
    /// Specular weights: `[segment]`.
    pub gloss: Vec<Gloss>,
}

/// Fits gloss (Eq. 13), if it is asked for and fits the budget, and factorises once more without it.
pub fn remove_gloss(
    prepared: &mut Prepared,
    found: Factorised,
    options: &FactorisationOptions,
    run: &mut Run,
) -> Answer {
    if run.config.specular == Switch::Off || !run.plan.specular(options.bands) {
        return Answer { found, gloss: vec![Gloss::NONE; prepared.segments] };
    }
    run.progress.stage("specular", 0.0);
    let (surface, fields) = prepared.surface();
    let Refitted { mut found, gloss, decisions } = refit(&surface, fields, found, options, &run.config.tuning.specular);
    prepared.decisions.extend(decisions);
    run.plan.specular_done(options.bands);
    if gloss.iter().any(|g| g.significant) {
        found = refine(prepared, found, options, run);
    }
    Answer { found, gloss }
}
