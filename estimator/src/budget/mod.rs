//! The time budget (§7 of the design): machine speed, sizes and settings in; a workload that fits, and what was cut, out.
//!
//! The machine is measured, all stages are planned to fit, and the plan is revised as stages end. Bounces are cut before rays,
//! rays before surplus vertices, those before refinements, and these before further vertices.

pub mod cost_model;
mod first_answer;
mod machine;
mod memory;
mod plan;
mod probe;
mod quality;
mod workload;

pub use first_answer::{Done, FirstAnswer};
pub use machine::{Machine, WallClock};
pub use plan::{Plan, is_ample};
pub use quality::at_quality;
pub use workload::Workload;
