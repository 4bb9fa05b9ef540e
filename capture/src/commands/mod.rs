//! The commands of `lumiscan`, one file each. [`dispatch`] chooses; [`settings`] and [`output`] are shared by all.

mod capture;
mod check;
mod config;
pub mod dispatch;
mod estimate;
mod export;
mod frames;
mod import;
mod inspect;
mod list;
#[cfg(feature = "openni")]
mod openni;
mod output;
mod record;
pub mod render;
mod replay;
mod scan;
mod settings;
mod trade;
