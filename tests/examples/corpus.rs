//! Renders scenes with known truth, estimates them, and reports: `cargo run --release -p tests --example corpus -- --seeds 0..32`.
//!
//! Rendered scenes are kept in `target/corpus/<seed>-<version>`. `--out DIR` leaves `DIR/<seed>/scene` and
//! `DIR/<seed>/result` (and `result_fused` where the seed has a recording), `--json FILE` all figures. `--even`, `--odd` and
//! `--light distant|lamps|room` choose among the seeds, `--render` stops after rendering, `--photos` leaves recordings out,
//! `--small` makes the scenes that continuous integration uses.

use estimator::Options;
use firmware_config::EstimatorConfig;
use recordings::decision_text::Findings;
use recordings::import::photos::import_photos;
use recordings::result::Estimate;
use serde_json::{Value, json};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use tests::corpus::plan::{Detail, Plan};
use tests::corpus::report::{self, Row};
use tests::corpus::{files, judge, produce};

type Fallible<T> = Result<T, Box<dyn Error>>;

struct Arguments {
    seeds: Vec<u64>,
    out: Option<PathBuf>,
    json: Option<PathBuf>,
    cache: PathBuf,
    detail: Detail,
    render_only: bool,
    fused: bool,
    budget_s: f64,
}

const USAGE: &str = "usage: corpus --seeds FROM..TO [--even|--odd] [--light distant|lamps|room] [--out DIR] [--json FILE] \
[--cache DIR] [--budget SECONDS] [--render] [--photos] [--small]";

impl Arguments {
    fn parse() -> Fallible<Self> {
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut own = Self {
            seeds: Vec::new(),
            out: None,
            json: None,
            cache: workspace.join("target/corpus"),
            detail: Detail::FULL,
            render_only: false,
            fused: true,
            // Enough for the budget not to bind: figures are to be the same on any machine.
            budget_s: 900.0,
        };
        let (mut parity, mut light) = (None, None);
        let mut arguments = std::env::args().skip(1);
        while let Some(name) = arguments.next() {
            let mut value = || arguments.next().ok_or(USAGE);
            match name.as_str() {
                "--seeds" => {
                    let text = value()?;
                    let (from, to) = text.split_once("..").ok_or(USAGE)?;
                    own.seeds = (from.parse()?..to.parse()?).collect();
                }
                "--out" => own.out = Some(value()?.into()),
                "--json" => own.json = Some(value()?.into()),
                "--cache" => own.cache = value()?.into(),
                "--budget" => own.budget_s = value()?.parse()?,
                "--light" => light = Some(value()?),
                "--even" => parity = Some(0),
                "--odd" => parity = Some(1),
                "--render" => own.render_only = true,
                "--photos" => own.fused = false,
                "--small" => own.detail = Detail::SMALL,
                _ => return Err(USAGE.into()),
            }
        }
        own.seeds.retain(|s| parity.is_none_or(|p| s % 2 == p));
        own.seeds.retain(|s| light.as_ref().is_none_or(|l| Plan::new(*s).light.name() == l));
        if own.seeds.is_empty() { Err(USAGE.into()) } else { Ok(own) }
    }
}

fn main() -> Fallible<()> {
    let arguments = Arguments::parse()?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::fs::create_dir_all(&arguments.cache)?;
    let kept = arguments.out.clone().unwrap_or_else(|| arguments.cache.join("results"));
    let mut rows: Vec<Row> = Vec::new();
    for &seed in &arguments.seeds {
        let started = Instant::now();
        let scene = produce::scene_folder(&arguments.cache, seed, &arguments.detail, threads)?;
        eprintln!("seed {seed}: scene in {:.1} s", started.elapsed().as_secs_f64());
        if arguments.render_only {
            continue;
        }
        let folder = kept.join(seed.to_string());
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::create_dir_all(&folder)?;
        if arguments.out.is_some() {
            copy(&scene, &folder.join("scene"))?;
        }
        rows.push(photos(&arguments, &scene, &folder.join("result"), threads)?);
        if arguments.fused && scene.join("recording.lrec").is_file() {
            match fused(&arguments, &scene, &folder, threads) {
                Ok(row) => rows.push(row),
                Err(e) => eprintln!("seed {seed}: the recording gave no result: {e}"),
            }
        }
        if let Some(path) = &arguments.json {
            files::write_json(path, &json!({ "scenes": rows }))?;
        }
        eprint!("{}", report::scenes(&rows).lines().last().map_or(String::new(), |l| format!("{l}\n")));
    }
    if !rows.is_empty() {
        println!(
            "{}{}{}\n{}",
            report::scenes(&rows),
            report::quantiles(&rows),
            report::decisions(&rows),
            report::plot(&rows)
        );
    }
    Ok(())
}

/// Photographs with erroneous poses and a mesh, estimated in this process.
fn photos(arguments: &Arguments, scene: &Path, result: &Path, threads: usize) -> Fallible<Row> {
    let scan = import_photos(scene, None)?;
    let started = Instant::now();
    let options = Options { budget: Duration::from_secs_f64(arguments.budget_s), rounds: None };
    let estimate = estimator::estimate(&scan, &EstimatorConfig::default(), &options, &())?;
    finish(&estimate, scene, result, false, started.elapsed().as_secs_f64(), threads)
}

/// The recording through `lumiscan replay`.
fn fused(arguments: &Arguments, scene: &Path, folder: &Path, threads: usize) -> Fallible<Row> {
    let program = lumiscan()?;
    let device = folder.join("device");
    let started = Instant::now();
    let done = Command::new(program)
        .arg("replay")
        .arg(scene.join("recording.lrec"))
        .arg("--device")
        .arg(&device)
        .args(["--budget", &arguments.budget_s.to_string()])
        .output()?;
    let seconds = started.elapsed().as_secs_f64();
    let printed = String::from_utf8(done.stdout)?;
    let published = printed.lines().last().ok_or_else(|| String::from_utf8_lossy(&done.stderr).into_owned())?;
    let estimate = Estimate::read(&Path::new(published).join("result.lres"))?;
    let row = finish(&estimate, scene, &folder.join("result_fused"), true, seconds, threads);
    std::fs::remove_dir_all(&device)?;
    row
}

/// The program of this build, made if it is not there.
fn lumiscan() -> Fallible<PathBuf> {
    let beside = std::env::current_exe()?;
    let folder = beside.parent().and_then(Path::parent).ok_or("no target folder")?;
    let program = folder.join("lumiscan");
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut build = Command::new(cargo);
    build.args(["build", "--locked", "-p", "capture", "--bin", "lumiscan"]);
    if folder.ends_with("release") {
        build.arg("--release");
    }
    let built = build.current_dir(env!("CARGO_MANIFEST_DIR")).output()?;
    if built.status.success() { Ok(program) } else { Err(String::from_utf8_lossy(&built.stderr).into_owned().into()) }
}

/// Exports, judges, and notes what was decided.
fn finish(
    estimate: &Estimate,
    scene: &Path,
    result: &Path,
    recorded: bool,
    seconds: f64,
    threads: usize,
) -> Fallible<Row> {
    std::fs::create_dir_all(result)?;
    estimator::export::folder::write(estimate, result)?;
    let mut row = judge::judge(scene, result, recorded, threads)?;
    row.insert("seconds".into(), json!((seconds * 10.0).round() / 10.0));
    let findings = Findings::new(&estimate.decisions, &estimate.cuts, &estimate.warnings);
    let decided = findings.decisions.into_iter().map(|d| (d.text.name, Value::String(d.text.choice)));
    row.insert("decisions".into(), Value::Object(decided.collect()));
    row.insert("warnings".into(), json!(findings.warnings));
    row.insert("cuts".into(), json!(findings.cuts));
    Ok(row)
}

fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            std::fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}
