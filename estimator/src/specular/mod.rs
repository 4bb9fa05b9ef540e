//! Specular reflection (§3.4, Eq. 13): observations and light in, specular weights per segment and lit colours without gloss
//! out.
//!
//! f_i of Eq. (2) is a median over views and holds some gloss itself. So w_s is fitted to what changes between the views of
//! one vertex, e_j f~_ij − f_i = w_s (f_s,ij − median over j of f_s,ij): the diffuse part cancels whatever its albedo, and f
//! and f_s cannot be collinear. w_d then follows from Eq. (13) as it stands.

mod agreement;
mod clean;
mod fit;
mod gloss;
pub mod material;
mod mirror_rays;
mod observations;
mod prediction;
pub mod refit;
mod reflection;

pub use gloss::Gloss;
pub use reflection::Reflection;
