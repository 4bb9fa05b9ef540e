//! What follows the last frame of a scan, stage by stage: `cargo run --release -p tests --example instant -- LUMISCAN RECORDING…`.
//!
//! Replays every recording (a `.lrec` file or a TUM folder) with all threads and with one, and prints seconds of wall time from its manifest. With one thread
//! they are processor time, but for preview and viewer, which are processes of their own beside each other. The last rows: result and
//! everything published, counted from the last fused frame; processor time and peak memory of the estimator.

use serde_json::Value;
use std::error::Error;
use std::process::{Command, Stdio};

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let lumiscan = arguments.next().ok_or("usage: instant LUMISCAN RECORDING…")?;
    for recording in arguments {
        let runs = [None, Some("1")].map(|threads| rows(&lumiscan, &recording, threads));
        let [all, one] = runs;
        let (all, one) = (all?, one?);
        println!("\n| {recording} | all threads | one thread |\n|---|---|---|");
        for (name, value) in &all {
            let other = one.iter().find(|(n, _)| n == name).map_or("–".into(), |(_, v)| format!("{v:.2}"));
            println!("| {name} | {value:.2} | {other} |");
        }
    }
    Ok(())
}

/// The rows of one run.
fn rows(lumiscan: &str, recording: &str, threads: Option<&str>) -> Outcome<Vec<(String, f64)>> {
    let device = tempfile::tempdir()?;
    let mut command = Command::new(lumiscan);
    command.args(["--json", "replay", recording, "--device"]).arg(device.path());
    command.args(threads.iter().flat_map(|n| ["--threads", *n]));
    let output = command.stderr(Stdio::null()).output()?;
    if !output.status.success() {
        return Err(format!("{recording}: {}", output.status).into());
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
    Ok(rows)
}
