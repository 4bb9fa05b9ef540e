//! What follows the last frame of a scan, stage by stage: `cargo bench --bench instant [-- RECORDING…]`.
//!
//! Replays every recording (a `.lrec` file or a TUM folder; without one the bundled table and, with `LUMISCAN_SHARED`, the desk and the
//! kitchen) with all threads and with one, and prints seconds of wall time from its manifest. With one thread they are processor
//! time, but for preview and viewer, which are processes of their own beside each other. The last rows: result and everything
//! published, counted from the last fused frame; processor time and peak memory of the estimator; processor time and page
//! faults of all processes from the first frame on.
//!
//! The last column is what one core needs at least, by what a stage cannot do without: rays at Embree's rate
//! (`docs/experiments/rays.md`), everything else at the rate at which this machine's memory is read. Mesh: the fused vertices
//! with their triangles, once. Association, validation frames: the pixels of every picture, once. Texture: its texels in every keyframe, once.

use serde_json::Value;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Rays a second and core of Embree, any hit, on a mesh in the open.
const EMBREE: f64 = 7.7e6;
/// Bytes of a Kinect's colour picture.
const PICTURE: f64 = 640.0 * 480.0 * 3.0;
/// Bytes of a vertex (position, normal, colour) and its two triangles.
const VERTEX: f64 = 36.0 + 24.0;
/// Bytes of a texel.
const TEXEL: f64 = 3.0;

fn main() -> Outcome<()> {
    for recording in recordings() {
        let ((all, manifest), (one, _)) = (rows(&recording, None)?, rows(&recording, Some("1"))?);
        let bounds = bounds(&manifest, bandwidth());
        println!("\n| {} | all threads | one thread | one core at least |\n|---|---|---|---|", recording.display());
        for (name, value) in &all {
            let of = |rows: &[(String, f64)]| rows.iter().find(|(n, _)| n == name).map(|(_, v)| *v);
            let other = of(&one).map_or("–".into(), |v| format!("{v:.2}"));
            let bound = of(&bounds).map_or("–".into(), |v| format!("{v:.4}"));
            println!("| {name} | {value:.2} | {other} | {bound} |");
        }
    }
    Ok(())
}

/// Bytes a second that one core reads from memory: the best of five passes over more than caches hold.
fn bandwidth() -> f64 {
    let words = vec![1u64; 1 << 25];
    let pass = || {
        let began = Instant::now();
        std::hint::black_box(words.iter().fold(0u64, |sum, w| sum.wrapping_add(*w)));
        size_of_val(&words[..]) as f64 / began.elapsed().as_secs_f64()
    };
    (0..5).map(|_| pass()).fold(0.0, f64::max)
}

/// Least seconds of one core by stage, from what the manifest counts.
fn bounds(manifest: &Value, bandwidth: f64) -> Vec<(String, f64)> {
    let number = |of: &Value| of.as_f64().unwrap_or(f64::NAN);
    let decisions = manifest["estimator"]["decisions"].as_array();
    let counts = |name: &str| -> &Value {
        let found = decisions.and_then(|all| all.iter().find(|d| d["name"] == name));
        found.map_or(&Value::Null, |d| &d["evidence_values"][name])
    };
    let (transfer, texture) = (counts("transfer"), &counts("texture")["atlas"]);
    let keyframes = number(&manifest["capture"]["keyframes"]);
    [
        ("mesh", number(&manifest["capture"]["vertices"]) * VERTEX / bandwidth),
        ("association", keyframes * PICTURE / bandwidth),
        ("transfer", number(&transfer["vertices"]) * number(&transfer["rays"]) / EMBREE),
        ("texture", number(&texture["texels"]) * keyframes * TEXEL / bandwidth),
        ("witnesses", number(&counts("witnesses")["frames"]) * PICTURE / bandwidth),
    ]
    .into_iter()
    .filter(|(_, seconds)| seconds.is_finite())
    .map(|(name, seconds)| (name.into(), seconds))
    .collect()
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

/// The rows of one run, and its manifest.
fn rows(recording: &Path, threads: Option<&str>) -> Outcome<(Vec<(String, f64)>, Value)> {
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
    Ok((rows, manifest.clone()))
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
