//! Factorisation (§3.3, Eqs. 9–12): lit colours f, segments and transfer in; light i and albedo a out, f_i = a_i Σ_k t_ik i_k.
//!
//! The solver and the transfer take turns, since the albedo changes interreflection (Eq. 8). One factor per channel is free
//! and is fixed by a stated rule. `robust_solver` is the default; `paper_solver` is the paper's literal update.

pub mod albedo;
pub mod distance_check;
pub mod drawn_light;
mod factorise;
pub mod held_out;
mod joint_solution;
mod light_form;
mod non_negative;
pub mod paint;
pub mod paper_solver;
mod posterior;
mod problem;
mod projection;
pub mod robust_solver;
pub mod scale;
mod scale_prior;
mod seen_background;
mod solution;
mod statistics;

pub(crate) use non_negative::{Center, NonNegative, held};

pub use factorise::{Factorised, Start, White, factorise, start_from};
pub use problem::{Colors, FactorisationOptions, KnownAlbedo, Observed};
pub use projection::Projection;
pub use seen_background::SeenBackground;
pub use solution::{Solution, directions};
