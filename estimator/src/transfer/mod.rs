//! Radiance transfer (Eq. 8): a mesh in, the transfer coefficients t_ik of every vertex out.
//!
//! E_i = Σ_k t_ik i_k is the irradiance over π of vertex i under light with coefficients i_k; 1/π stands inside t, the
//! vertex's own albedo outside. *diffuse*: the cosine lobe in closed form (Ramamoorthi and Hanrahan, "An efficient
//! representation for irradiance environment maps", 2001). *shade*: the rays that escape, averaged over neighbours that agree. *gi*: bounces
//! as sparse products over the hits of the same rays (Sloan, Kautz and Snyder, "Precomputed radiance transfer", 2002).

mod bounces;
mod irradiance;
mod neighbours;
mod sun;
#[cfg(test)]
mod tests;
mod traced;
mod tracer;
mod vertex;

pub use bounces::{Bounced, bounce, bounce_light, bounce_on, bounce_scaled};
pub use irradiance::Transfer;
pub use sun::Sun;
pub use traced::{ERROR_OF_TWICE, Traced, unoccluded};
pub use tracer::Tracer;
