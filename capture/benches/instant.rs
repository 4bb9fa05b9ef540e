//! What follows the last frame of a scan, stage by stage: `cargo bench --bench instant [-- RECORDING…]`.
//!
//! Replays every recording (a `.lrec` file or a TUM folder; without one the bundled table and, with `LUMISCAN_SHARED`, the desk and the
//! kitchen) with all threads and with one, and prints seconds of wall time from its manifest. With one thread they are processor
//! time, but for preview and viewer, which are processes of their own beside each other. The last rows: result and everything
//! published, counted from the last fused frame; processor time and peak memory of the estimator; processor time and page
//! faults of all processes from the first frame on.

use serde_json::Value;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    for recording in recordings() {
        let (all, one) = (rows(&recording, None)?, rows(&recording, Some("1"))?);
        println!("\n| {} | all threads | one thread |\n|---|---|---|", recording.display());
        for (name, value) in &all {
            let other = one.iter().find(|(n, _)| n == name).map_or("–".into(), |(_, v)| format!("{v:.2}"));
            println!("| {name} | {value:.2} | {other} |");
        }
    }
    Ok(())
}

/// Those that are asked for, or the usual ones.
fn recordings() -> Vec<PathBuf> {
    let asked: Vec<PathBuf> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).map(Into::into).collect();
    if !asked.is_empty() {
        return asked;
    }
    let mut usual = vec![PathBuf::from("recordings/data/tabletop.lrec")];
    if let Some(shared) = std::env::var_os("LUMISCAN_SHARED") {
        usual.extend(["data/tum_fr1_xyz_400", "data/redkitchen_300"].map(|name| Path::new(&shared).join(name)));
    }
    usual
}

/// The rows of one run.
fn rows(recording: &Path, threads: Option<&str>) -> Outcome<Vec<(String, f64)>> {
    let device = tempfile::tempdir()?;
    let before = of_children()?;
    // Benches start in their package's folder; recordings are named from the workspace's.
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumiscan"));
    command.current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    command.args(["--json", "replay"]).arg(recording).arg("--device").arg(device.path());
    command.args(threads.iter().flat_map(|n| ["--threads", *n]));
    let output = command.stderr(Stdio::null()).output()?;
    if !output.status.success() {
        return Err(format!("{}: {}", recording.display(), output.status).into());
    }
    let report: Value = serde_json::from_slice(&output.stdout)?;
    let manifest = &report["manifest"];
    let (capture, estimator) = (&manifest["capture"], &manifest["estimator"]);
    let seconds = |of: &Value| serde_json::from_value::<Vec<(String, f64)>>(of["seconds"].clone());
    let mut rows = seconds(capture)?;
    rows.retain(|(name, _)| name != "fusion");
    rows.extend(
        seconds(estimator)?.into_iter().map(|(n, s)| if n == "total" { ("estimator".into(), s) } else { (n, s) }),
    );
    for moment in ["result", "published"] {
        rows.push((
            format!("last frame → {moment}"),
            manifest["after_last_frame_s"][moment].as_f64().unwrap_or(f64::NAN),
        ));
    }
    rows.push(("estimator, processor".into(), estimator["cpu_seconds"].as_f64().unwrap_or(f64::NAN)));
    let peak = estimator["memory_peak_bytes"].as_f64().unwrap_or(f64::NAN) / f64::from(1 << 20);
    rows.push(("estimator, peak MiB".into(), peak));
    let after = of_children()?;
    rows.push(("all processes, processor".into(), after.0 - before.0));
    rows.push(("all processes, page faults".into(), after.1 - before.1));
    Ok(rows)
}

/// Processor time in seconds and page faults of the processes that were waited for, theirs included (`man 5 proc`; a tick is
/// 10 ms).
fn of_children() -> Outcome<(f64, f64)> {
    let text = std::fs::read_to_string("/proc/self/stat")?;
    // The name before the last bracket may hold anything.
    let fields: Vec<f64> = text
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .map(|field| field.parse().unwrap_or(f64::NAN))
        .collect();
    let field = |number: usize| fields.get(number - 3).copied().unwrap_or(f64::NAN);
    Ok(((field(16) + field(17)) / 100.0, field(11)))
}
