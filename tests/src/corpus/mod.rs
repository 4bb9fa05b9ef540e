//! A corpus of generated scenes with known truth, and the report on what the estimator makes of them.
//!
//! A seed decides everything: [`plan`] what kind of scene it is, [`stage`] builds it from [`shapes`], [`paint`] and
//! [`panorama`], [`cameras`] says where pictures are taken, [`produce`] renders it by the project's own path tracer
//! ([`crate::synth`]) and writes it in the layout of the shared truth scenes. [`run`] estimates it, [`judge`] compares the exported result folder
//! with such a scene; [`report`] makes tables and [`plots`] plots of many.

pub mod cameras;
pub mod files;
pub mod judge;
pub mod paint;
pub mod panorama;
pub mod plan;
pub mod plots;
pub mod produce;
pub mod report;
pub mod rerender;
pub mod run;
pub mod shapes;
pub mod stage;
