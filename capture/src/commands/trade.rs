//! `lumiscan trade`: speed against accuracy, measured on scenes with known truth.

use crate::cli;
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::commands::settings::use_threads;
use crate::device_folder::files::write_file;
use crate::failure::Failure;
use crate::memory::cpu_seconds;
use crate::report::Reporter;
use estimator::budget::Machine;
use estimator::sweep::plot;
use estimator::sweep::point::{CSV_HEAD, Point, margins, to_csv};
use estimator::sweep::run::{SETTINGS, sweep};
use estimator::sweep::truth::Truth;
use firmware_config::Config;
use recordings::import::photos::import_photos;
use recordings::scan::Scan;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// The bundled scene.
const BUNDLED: &str = "recordings/data/tabletop.lrec";

/// Processor seconds of all threads: what else the machine does is no matter of a setting's.
struct ProcessorTime;

impl Machine for ProcessorTime {
    fn now(&self) -> f64 {
        cpu_seconds()
    }
}

/// Runs the command.
pub fn run(args: &cli::Trade, reporter: &Reporter) -> Result<(), Failure> {
    check_parent(&args.output)?;
    use_threads(args.threads)?;
    let bundled = [PathBuf::from(BUNDLED)];
    let scenes = if args.scenes.is_empty() { bundled.as_slice() } else { &args.scenes };
    let config = Config::default();
    let mut swept: Vec<(String, Vec<Point>)> = Vec::new();
    let mut csv = CSV_HEAD.to_owned();
    for scene in scenes {
        let shown = scene.display();
        let name = scene.file_stem().map_or("scene".into(), |n| n.to_string_lossy().into_owned());
        let (scan, truth) = open(scene)?;
        let limit = Duration::from_secs_f64(args.limit);
        let points = sweep(&scan, &truth, &config.estimator, &ProcessorTime, limit, reporter)
            .map_err(|e| Failure::estimating(shown, e))?;
        reporter.clear();
        csv += &to_csv(&name, &points);
        report(&name, &points)?;
        swept.push((name, points));
    }
    write_file(&args.output, csv.as_bytes())?;
    let (png, svg) = (args.output.with_extension("png"), args.output.with_extension("svg"));
    write_file(&png, &plot::png(&swept).map_err(Failure::Internal)?)?;
    write_file(&svg, plot::svg(&swept).map_err(Failure::Internal)?.as_bytes())?;
    [&args.output, &png, &svg].into_iter().try_for_each(|path| print(&path.display().to_string()))
}

/// A photo scene with its `truth` folder, or a recording with `<stem>_truth` beside it.
fn open(scene: &Path) -> Result<(Scan, Truth), Failure> {
    if scene.is_dir() {
        let scan = import_photos(scene, None)?;
        return Ok((scan, Truth::of_photos(scene).map_err(Failure::Input)?));
    }
    let stem = scene.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let truth = Truth::of_recording(&scene.with_file_name(format!("{stem}_truth"))).map_err(Failure::Input)?;
    Ok((fuse(scene)?, truth))
}

/// The scan of a recording, made by this executable in a folder that goes again.
fn fuse(recording: &Path) -> Result<Scan, Failure> {
    let cannot = |e: std::io::Error| Failure::Internal(format!("{} could not be fused: {e}", recording.display()));
    let folder = std::env::temp_dir().join(format!("lumiscan-trade-{}", std::process::id()));
    let mut command = Command::new(std::env::current_exe().map_err(cannot)?);
    command.arg("replay").arg(recording).arg("--no-estimate").arg("--device").arg(&folder);
    let answer = command.stderr(std::process::Stdio::inherit()).output().map_err(cannot)?;
    let text = String::from_utf8_lossy(&answer.stdout);
    let scan = match text.lines().last() {
        Some(published) if answer.status.success() => Scan::read(&Path::new(published).join("scan.lscan"))?,
        _ => return Err(Failure::Unusable(format!("{}: it could not be fused", recording.display()))),
    };
    std::fs::remove_dir_all(&folder).map_err(cannot)?;
    Ok(scan)
}

/// What stands out of a sweep, and how `auto` fares.
fn report(name: &str, points: &[Point]) -> Result<(), Failure> {
    let mut shown: Vec<&Point> = points.iter().filter(|p| p.pareto || p.name != "grid").collect();
    shown.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    print(&format!("{name}: {} settings", points.len()))?;
    print("| setting | bands | transfer | rays | processor s | albedo | irradiance | error | front |")?;
    print("|---|---|---|---|---|---|---|---|---|")?;
    for p in shown {
        let (a, i, e) = (p.albedo_error, p.irradiance_error, p.error());
        let front = if p.pareto { "yes" } else { "" };
        print(&format!(
            "| {} | {} | {} | {} | {:.1} | {a:.4} | {i:.4} | {e:.4} | {front} |",
            p.name, p.bands, p.transfer, p.rays, p.seconds
        ))?;
    }
    let Some(margins) = margins(points) else { return Ok(()) };
    if points.len() < SETTINGS {
        return print(&format!(
            "{name}: no verdict on the rule: {} of {} settings were measured in time; raise --limit",
            points.len(),
            SETTINGS
        ));
    }
    let kept = if margins.hold() { "keeps" } else { "breaks" };
    print(&format!(
        "{name}: auto {kept} the rule: error {:.2} × the best (at most 1.1), time {:.2} × the cheapest that comes near (at \
         most 2)",
        margins.error, margins.seconds
    ))
}
