//! The stages of an estimate: a scan in, prepared data, a selected model and the parts of the result out. `estimate()` runs
//! each once; the sweep runs some of them many times.

mod background;
mod division;
mod first_answer;
mod gloss;
mod hand_over;
mod local_light;
mod materials;
mod model;
mod prepare;
mod reference;
mod result;
mod run;
mod scale;
mod texture;
mod veil;
mod witnesses;

pub use division::divide_segments;
pub use first_answer::first_answer;
pub use gloss::{Answer, remove_gloss};
pub use hand_over::hand_over;
pub use local_light::select_local_light;
pub use materials::{merge_materials, name_materials};
pub use model::{SelectedModel, refine, select_model, spend, trace};
pub use prepare::{Prepared, prepare};
pub use result::{FoundLight, check_distance, light, result, transfer_decision, transfer_level, unseen_light};
pub use run::Run;
pub use scale::{fix_scale, scale_rule};
pub use texture::texture;
pub use veil::remove_veil;
pub use witnesses::witnesses;
