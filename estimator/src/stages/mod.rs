//! The stages of an estimate: a scan in, prepared data, a selected model and the parts of the result out. `estimate()` runs
//! each once; the sweep runs some of them many times.

mod background;
mod division;
mod first_answer;
mod gloss;
mod hand_over;
mod hidden;
mod local_light;
mod materials;
mod model;
mod prepare;
mod reference;
mod result;
mod run;
mod scale;
mod sharpen;
mod solve;
mod texture;
mod veil;
mod witnesses;

pub use first_answer::First;
pub use gloss::Answer;
pub use hand_over::hand_over;
pub use materials::name_materials;
pub use prepare::{Prepared, prepare};
pub use result::{FoundLight, check_distance, light, result, transfer_decision, transfer_level, unseen_light};
pub use run::Run;
pub use scale::{fix_scale, scale_rule};
pub use sharpen::sharpen;
pub use solve::{light_and_albedo, materials_and_gloss};
pub use texture::texture;
pub use witnesses::witnesses;
