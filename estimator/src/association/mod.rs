//! Data association (§3.1, Eqs. 2–5). In: mesh, keyframes with poses. Out: [`Association`], a surface light field with one
//! robust lit colour per vertex, exposures and refined poses ([`alternation`] runs the steps in turn).
//!
//! Eligible samples, Eqs. (3) and (4): [`eligibility`], [`sampling`]; lit colours, Eq. (2): [`lit_color`], how far they can be trusted:
//! [`reliability`]; exposures, Eq. (5): [`exposure`] from [`exposure_patches`], again from matte surfaces in [`re_exposure`], without keyframes that show more glare than surface, [`haze`]; poses, by Lucas–Kanade against the predicted image: [`pose`],
//! [`alignment`], [`predicted_image`]. [`response`] tests the camera's response. [`seen_lamps`] are what pictures show in the air, [`lampless_air`] is where
//! they show that there is none. [`veil`] is the
//! lens's glare in a picture, [`veil_removal`] takes it out of the observations. [`vignetting`] is what the corners lack.
//! What highlights lack is a matter of the response: exposures tell it, too.

pub mod alignment;
pub mod alternation;
pub mod context;
pub mod eligibility;
pub mod exposure;
pub mod exposure_patches;
mod exposure_shoulder;
mod exposure_vignetting;
pub mod haze;
pub mod image_filters;
pub mod keyframe_image;
pub mod lampless_air;
pub mod light_field;
pub mod lit_color;
pub mod moving_camera;
pub mod observations;
pub mod pose;
pub mod predicted_image;
pub mod re_exposure;
pub mod reliability;
pub mod response;
pub mod sampling;
pub mod seen_lamps;
pub mod sharpening;
pub mod veil;
pub mod veil_removal;
pub mod vignetting;

pub use alternation::{AssociationEffort, associate, associate_within};
pub use context::AssociationContext;
pub use observations::{Association, Lens, Observation, RefinedView};
