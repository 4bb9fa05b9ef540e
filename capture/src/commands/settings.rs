//! The settings and the number of threads that a command runs with.

use crate::cli::Settings;
use crate::failure::Failure;
use firmware_config::{Config, ConfigError};

/// The defaults, overridden by the settings file, overridden by `--set`.
///
/// # Errors
/// The file cannot be read, or a key or value is wrong.
pub fn load(settings: &Settings) -> Result<Config, Failure> {
    let mut config = match &settings.config {
        None => Config::default(),
        Some(path) => {
            let shown = path.display();
            let text = std::fs::read_to_string(path).map_err(|e| {
                Failure::Usage(format!("{shown}: {e}; `lumiscan config > FILE` writes a settings file"))
            })?;
            Config::from_toml(&text).map_err(|e| Failure::Usage(format!("{shown}: {e}")))?
        }
    };
    for assignment in &settings.set {
        config.set(assignment).map_err(|e: ConfigError| Failure::Usage(format!("--set {assignment}: {e}")))?;
    }
    Ok(config)
}

/// Sets the number of worker threads; rayon's default is one per processor.
///
/// # Errors
/// The threads cannot be started.
pub fn use_threads(threads: Option<u16>) -> Result<(), Failure> {
    let Some(n) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(n))
        .build_global()
        .map_err(|e| Failure::Internal(format!("{n} threads could not be started: {e}; try a smaller --threads")))
}
