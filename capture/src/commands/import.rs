//! `lumiscan import`: foreign data to a recording or a scan.

use super::{check_parent, print};
use crate::cli::{self, ImportFrom};
use crate::failure::Failure;
use crate::report::{Reporter, Step};
use firmware_config::Config;
use recordings::photos::import_photos;
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::tum::TumReader;
use std::path::Path;

/// Runs the command.
pub fn run(args: &cli::Import, reporter: &Reporter) -> Result<(), Failure> {
    check_parent(&args.output)?;
    match args.from {
        ImportFrom::Tum if args.mesh.is_some() => {
            return Err(Failure::Usage("--mesh is for `import photos`; leave it out".into()));
        }
        ImportFrom::Tum => tum(&args.dir, &args.output, reporter)?,
        ImportFrom::Photos => {
            let mut scan = import_photos(&args.dir, args.mesh.as_deref())?;
            scan.config = Config::default().to_toml();
            scan.write(&args.output).map_err(|e| Failure::Internal(e.to_string()))?;
        }
    }
    print(&args.output.display().to_string())
}

fn tum(dir: &Path, output: &Path, reporter: &Reporter) -> Result<(), Failure> {
    let write_error = |e: recordings::Error| Failure::Internal(e.to_string());
    let mut reader = TumReader::open(dir)?;
    let mut writer = RecordingWriter::create(output, RecordingKind::Frames, reader.sensor()).map_err(write_error)?;
    let mut frames = 0u64;
    while let Some(event) = reader.next_event()? {
        writer.write(&event).map_err(write_error)?;
        frames += u64::from(matches!(event, Event::Color(_)));
        reporter.step(&Step { stage: "import".into(), fraction: None, detail: format!("{frames} colour frames") });
    }
    writer.finish().map_err(write_error)
}
