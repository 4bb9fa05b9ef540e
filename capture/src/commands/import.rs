//! `lumiscan import`: foreign data to a recording or a scan.

use crate::cli::{self, ImportFrom};
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::failure::Failure;
use firmware_config::Config;
use recordings::import::photos::import_photos;
use recordings::import::tum::import_tum;

/// Runs the command.
pub fn run(args: &cli::Import) -> Result<(), Failure> {
    check_parent(&args.output)?;
    match args.from {
        ImportFrom::Tum if args.mesh.is_some() => {
            return Err(Failure::Usage("--mesh is for `import photos`; omit it".into()));
        }
        ImportFrom::Tum => import_tum(&args.dir, &args.output)?,
        ImportFrom::Photos => {
            let mut scan = import_photos(&args.dir, args.mesh.as_deref())?;
            scan.config = Config::default().to_toml();
            scan.write(&args.output).map_err(|e| Failure::Internal(e.to_string()))?;
        }
    }
    print(&args.output.display().to_string())
}
