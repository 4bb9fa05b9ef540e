//! `lumiscan config`: every setting, as a settings file.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::failure::Failure;
use serde_json::{Value, json};

/// Runs the command.
pub fn run(args: &cli::Config, json: bool) -> Result<(), Failure> {
    let config = load(&args.settings)?;
    if !json {
        return print(config.to_commented_toml().trim_end());
    }
    let settings: Vec<_> = config
        .settings()
        .iter()
        .map(|s| {
            json!({ "key": s.key, "value": plain(&s.value), "default": plain(&s.default), "unit": s.unit, "range": s.range,
                    "symbol": s.symbol, "description": s.doc })
        })
        .collect();
    print_json(&settings)
}

/// Numbers, strings and truth values are the same in TOML and JSON.
fn plain(toml: &str) -> Value {
    serde_json::from_str(toml).unwrap_or_else(|_| Value::String(toml.to_owned()))
}
