//! Renders scenes with known truth, estimates them, and reports: `cargo run --release -p tests --example corpus -- --seeds 0..32`.
//!
//! Rendered scenes are kept in `target/corpus/<seed>-<version>`. `--out DIR` leaves `DIR/<seed>/scene` and
//! `DIR/<seed>/result` (and `result_fused` where the seed has a recording), `--json FILE` all figures. `--even`, `--odd` and
//! `--light distant|lamps|room` choose among the seeds, `--render` stops after rendering, `--photos` leaves recordings out, `--recordings` photographs,
//! `--small` makes the scenes that continuous integration uses; `--lumiscan` names the
//! program that replays recordings (by default it is built), `--judge` a folder like `--out` whose
//! results are judged as they are. `--set` changes a setting. Plots go to `report.png` and `report.svg` beside the kept scenes.

use firmware_config::Config;
use serde_json::json;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use tests::corpus::plan::{Detail, Plan};
use tests::corpus::report::{self, Row};
use tests::corpus::{files, judge, plots, produce, run};

type Fallible<T> = Result<T, Box<dyn Error>>;

struct Arguments {
    seeds: Vec<u64>,
    out: Option<PathBuf>,
    json: Option<PathBuf>,
    cache: PathBuf,
    detail: Detail,
    render_only: bool,
    photos: bool,
    fused: bool,
    program: Option<PathBuf>,
    judged: Option<PathBuf>,
    budget: Duration,
    settings: Vec<String>,
}

const USAGE: &str = "usage: corpus --seeds FROM..TO [--even|--odd] [--light distant|lamps|room] [--out DIR] [--json FILE] \
[--cache DIR] [--lumiscan PROGRAM] [--judge DIR] [--budget SECONDS] [--set SECTION.KEY=VALUE] [--render] [--photos|--recordings] [--small]";

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
            photos: true,
            fused: true,
            program: None,
            judged: None,
            // Enough for the budget not to bind: figures are to be the same on any machine.
            budget: Duration::from_secs(900),
            settings: Vec::new(),
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
                "--lumiscan" => own.program = Some(value()?.into()),
                "--judge" => own.judged = Some(value()?.into()),
                "--budget" => own.budget = Duration::from_secs_f64(value()?.parse()?),
                "--set" => own.settings.push(value()?),
                "--light" => light = Some(value()?),
                "--even" => parity = Some(0),
                "--odd" => parity = Some(1),
                "--render" => own.render_only = true,
                "--photos" => own.fused = false,
                "--recordings" => own.photos = false,
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
    let mut config = Config::default();
    arguments.settings.iter().try_for_each(|setting| config.set(setting))?;
    let mut rows: Vec<Row> = Vec::new();
    for &seed in &arguments.seeds {
        let started = Instant::now();
        let scene = produce::scene_folder(&arguments.cache, seed, &arguments.detail, threads)?;
        eprintln!("seed {seed}: scene in {:.1} s", started.elapsed().as_secs_f64());
        if arguments.render_only {
            continue;
        }
        if let Some(results) = &arguments.judged {
            let results = results.join(seed.to_string());
            for (name, recorded) in [("result", false), ("result_fused", true)] {
                let result = results.join(name);
                if result.is_dir() {
                    rows.push(judge::judge(&scene, &result, recorded, threads)?);
                }
            }
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
        if arguments.photos {
            let result = folder.join("result");
            rows.push(run::photos(&scene, &result, &config.estimator, arguments.budget, threads)?);
        }
        if arguments.fused && scene.join("recording.lrec").is_file() {
            let program = arguments.program.clone().map_or_else(lumiscan, Ok)?;
            let (device, result) = (folder.join("device"), folder.join("result_fused"));
            let settings = &arguments.settings;
            match run::fused(&program, settings, &scene, &device, &result, arguments.budget, threads) {
                Ok(row) => rows.push(row),
                Err(e) => eprintln!("seed {seed}: the recording gave no result: {e}"),
            }
        }
        if let Some(path) = &arguments.json {
            files::write_json(path, &json!({ "scenes": rows }))?;
        }
        eprint!("{}", report::scenes(&rows).lines().last().map_or(String::new(), |l| format!("{l}\n")));
    }
    if let Some(path) = &arguments.json {
        files::write_json(path, &json!({ "scenes": rows }))?;
    }
    if !rows.is_empty() {
        println!("{}{}{}", report::scenes(&rows), report::quantiles(&rows), report::decisions(&rows),);
        for (name, file) in [("report.png", plots::png(&rows)?), ("report.svg", plots::svg(&rows)?.into_bytes())] {
            let path = arguments.cache.join(name);
            std::fs::write(&path, file)?;
            println!("{}", path.display());
        }
    }
    Ok(())
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
