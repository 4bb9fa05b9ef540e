//! `lumiscan manual FOLDER`: the manual pages and shell completions, from the command line's own description.

use crate::cli::{Cli, Manual};
use crate::failure::Failure;
use clap::CommandFactory;
use clap_complete::{Shell, generate_to};

/// Runs the command.
pub fn run(args: &Manual) -> Result<(), Failure> {
    let failed = |e: std::io::Error| Failure::Internal(format!("{}: {e}", args.folder.display()));
    std::fs::create_dir_all(&args.folder).map_err(failed)?;
    let mut command = Cli::command().disable_help_subcommand(true);
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        generate_to(shell, &mut command, "lumiscan", &args.folder).map_err(failed)?;
    }
    clap_mangen::generate_to(command, &args.folder).map_err(failed)
}
