//! A scene through the estimator, by either road, and judged.

use super::judge;
use super::report::Row;
use estimator::Options;
use firmware_config::EstimatorConfig;
use recordings::decision_text::Findings;
use recordings::import::photos::import_photos;
use recordings::result::Estimate;
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

type Fallible<T> = Result<T, Box<dyn Error>>;

/// Photographs with erroneous poses and a mesh, estimated in this process. The result folder is made.
///
/// # Errors
/// The scene cannot be read or estimated, or the result cannot be written.
pub fn photos(
    scene: &Path,
    result: &Path,
    config: &EstimatorConfig,
    budget: Duration,
    threads: usize,
) -> Fallible<Row> {
    let scan = import_photos(scene, None)?;
    let started = Instant::now();
    let options = Options { budget, rounds: None, reference: None, memory_mb: None };
    let estimate = estimator::estimate(&scan, config, &options, &())?;
    finish(&estimate, scene, result, false, started.elapsed(), threads)
}

/// The scene's recording through `lumiscan replay`; `program` is the executable, `settings` are given to it. Device folder and result folder are made,
/// the device folder goes away again.
///
/// # Errors
/// The program gives no result, or it cannot be written.
pub fn fused(
    program: &Path,
    settings: &[String],
    scene: &Path,
    device: &Path,
    result: &Path,
    budget: Duration,
    threads: usize,
) -> Fallible<Row> {
    let started = Instant::now();
    let done = Command::new(program)
        .arg("replay")
        .arg(scene.join("recording.lrec"))
        .arg("--device")
        .arg(device)
        .args(["--budget", &budget.as_secs_f64().to_string()])
        .args(settings.iter().flat_map(|s| ["--set", s]))
        .output()?;
    let elapsed = started.elapsed();
    let printed = String::from_utf8(done.stdout)?;
    let published = printed.lines().last().ok_or_else(|| String::from_utf8_lossy(&done.stderr).into_owned())?;
    let estimate = Estimate::read(&Path::new(published).join("result.lres"))?;
    let row = finish(&estimate, scene, result, true, elapsed, threads);
    std::fs::remove_dir_all(device)?;
    row
}

/// Exports, judges, and notes what was decided.
fn finish(
    estimate: &Estimate,
    scene: &Path,
    result: &Path,
    recorded: bool,
    elapsed: Duration,
    threads: usize,
) -> Fallible<Row> {
    std::fs::create_dir_all(result)?;
    estimator::export::folder::write(estimate, result)?;
    let mut row = judge::judge(scene, result, recorded, threads)?;
    row.insert("seconds".into(), json!((elapsed.as_secs_f64() * 10.0).round() / 10.0));
    let findings = Findings::new(&estimate.decisions, &estimate.cuts, &estimate.warnings);
    let decided = findings.decisions.into_iter().map(|d| (d.text.name, Value::String(d.text.choice)));
    row.insert("decisions".into(), Value::Object(decided.collect()));
    row.insert("warnings".into(), json!(findings.warnings));
    row.insert("cuts".into(), json!(findings.cuts));
    Ok(row)
}
