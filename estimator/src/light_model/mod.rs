//! Light that is not distant (N1): lit colours, segments and traced rays come in; the model of light that held-out surface
//! asks for, with its irradiance and albedo, comes out.
//!
//! `f(x) = a(x) [ Σ_k t_k(x) i_k + Σ_p P_p g_p(x) + Σ_e F_e(x) E_e + G(x) ]`

pub mod choose;
pub mod covered;
pub mod division;
mod emitters;
mod growth;
pub mod held_out;
pub mod lamps;
mod samples;
mod search;
mod secondary;
mod smooth_fallback;
mod solve;
mod sun;
mod visibility;

#[cfg(test)]
mod tests;
