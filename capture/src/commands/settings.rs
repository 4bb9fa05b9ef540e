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

/// Starts the worker threads; one per processor by default.
///
/// # Errors
/// The threads cannot be started.
pub fn use_threads(threads: Option<u16>) -> Result<(), Failure> {
    rayon::ThreadPoolBuilder::new()
        // 0 is the default.
        .num_threads(threads.map_or(0, usize::from))
        .build_global()
        .map_err(|e| Failure::Memory(format!("the threads could not be started: {e}; try a smaller --threads")))
}
