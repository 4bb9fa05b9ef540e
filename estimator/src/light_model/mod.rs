//! Light that is not distant (N1): lit colours, segments and traced rays come in; the model of light that held-out surface
//! asks for, with its irradiance and albedo, comes out.
//!
//! `f(x) = a(x) [ Σ_k t_k(x) i_k + Σ_p P_p g_p(x) + Σ_e F_e(x) E_e + G(x) ]`

pub mod choose;
mod emitters;
mod lamps;
mod samples;
mod search;
mod secondary;
mod smooth_fallback;
mod solve;

use crate::factorisation::scale;
use firmware_config::tuning::FactorisationTuning;
use recordings::local_light::LightModel;

/// The rule that fixes the free factor of albedo × light under each model, in words.
#[must_use]
pub fn scale_rule(model: LightModel, tuning: &FactorisationTuning) -> String {
    match model {
        LightModel::Distant => scale::rule(tuning),
        LightModel::Unexplained => format!("per channel, the brightest segment has albedo {}", choose::BRIGHTEST),
        _ => format!(
            "per channel, by the secondary light as it was observed; where there is little, by an albedo of {} of the \
             brightest large segment",
            solve::PRIOR_ALBEDO.0
        ),
    }
}

#[cfg(test)]
mod tests;
