//! `lumiscan replay`: a recording to a published scan.

use crate::cli;
use crate::commands::output::{print, print_json};
use crate::commands::settings::load;
use crate::commands::settings::use_threads;
use crate::commands::watch::Watched;
use crate::device_folder::files::write_file;
use crate::device_folder::staging::Staging;
use crate::failure::Failure;
use crate::pipeline::{self, Captured, Job};
use crate::publish::{self, Published};
use crate::report::Reporter;
use crate::sources::pairs::Pairs;
use crate::status::State;
use crate::stop::Stop;
use recordings::import::trajectory::format_trajectory;
use std::path::Path;

/// Runs the command.
pub fn run(args: &cli::Replay, json: bool, reporter: &Reporter) -> Result<(), Failure> {
    let config = load(&args.settings)?;
    use_threads(args.effort.threads)?;
    let pairs = Pairs::open(&args.source, args.loops, &config.capture)?;
    let name = name_of(&args.source);
    let stop = Stop::on_signals()?;
    let mut staging = Staging::create(&args.device, &name)?;
    let scan_path = staging.folder().join("scan.lscan");
    let watched = Watched::start(args, &config, &stop, reporter)?;
    let watched = watched.as_ref();
    if let Some(watched) = watched {
        watched.wait_for_page(&config.serve, &stop)?;
        watched.board.begin_scan(&name);
    }

    let job = Job {
        name: &name,
        source: &args.source,
        scan: &scan_path,
        config: &config,
        board: watched.map(|w| &*w.board),
        orders: watched.map(|w| &w.orders),
        hub: watched.map(|w| w.page.hub()),
        paced: watched.is_some(),
    };
    let captured = pipeline::run(pairs, &job, &stop, reporter);
    if watched.is_some_and(|w| w.orders.is_discarded()) {
        tracing::info!("{name} is discarded");
        drop(staging);
        watched.inspect(|w| w.end(args.keep, None, &stop));
        return Ok(());
    }
    let captured = captured?;
    let given = watched.and_then(|w| w.orders.name());
    if let Some(given) = &given {
        staging.set_name(given);
    }
    write_file(&staging.folder().join("trajectory.txt"), format_trajectory(&captured.trajectory).as_bytes())?;
    log_summary(&captured);

    if let Some(watched) = watched {
        watched.board.enter(State::Estimating);
    }
    let effort = (!args.no_estimate).then_some(&args.effort);
    let entry = publish::capture_entry(&args.source, captured);
    let name = given.unwrap_or(name);
    let Published { folder, manifest, failure } = publish::publish(staging, name, entry, effort, &stop, reporter)?;
    reporter.clear();
    if json {
        print_json(&serde_json::json!({ "folder": folder, "manifest": manifest }))?;
    } else {
        print(&folder.display().to_string())?;
    }
    if let Some(watched) = watched {
        watched.end(args.keep, Some(&folder), &stop);
    }
    failure.map_or(Ok(()), Err)
}

/// Logs the capture in one line.
fn log_summary(c: &Captured) {
    let per_frame = c.fusion.as_secs_f64() * 1e3 / (c.stats.pairs.max(1) as f64);
    tracing::info!(
        "{} of {} pairs tracked, {per_frame:.1} ms per frame · {} vertices, {} triangles, {} keyframes",
        c.trajectory.len(),
        c.stats.pairs,
        c.vertices,
        c.triangles,
        c.keyframes
    );
}

/// The folder's name, or the recording's without its extension.
fn name_of(source: &Path) -> String {
    let full = source.canonicalize().unwrap_or_else(|_| source.to_path_buf());
    let name = if full.is_dir() { full.file_name() } else { full.file_stem() };
    name.map_or("scan".into(), |n| n.to_string_lossy().into_owned())
}
