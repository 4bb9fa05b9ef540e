//! The commands of `lumiscan`, one file each. [`dispatch`] chooses; [`files`], [`output`] and [`settings`] are shared by all.

mod capture;
mod check;
mod config;
pub mod dispatch;
pub mod estimate;
mod export;
mod files;
mod handoff;
mod import;
mod inspect;
mod list;
mod manual;
#[cfg(feature = "openni")]
mod openni;
mod output;
mod record;
mod render;
mod replay;
mod scan;
mod settings;
mod trade;
mod watch;
