//! The options that every command with settings takes.

use clap::Args;
use std::path::PathBuf;

/// Where settings come from.
#[derive(Debug, Args, Default)]
pub struct Settings {
    /// Settings file (TOML, as `lumiscan config` prints it).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One setting, as section.key=value; repeatable, wins over the file.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}
