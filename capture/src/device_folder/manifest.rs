//! `manifest.json`: the files of a published scan, how it was made, and the time that took. No other file of a scan holds clock
//! readings.

use crate::device_folder::dates::Dates;
use crate::device_folder::files::write_file;
use crate::failure::Failure;
use recordings::crc32_of_file;
use recordings::decision_text::Findings;
use recordings::result::{Estimate, Origin};
use recordings::scan::CaptureStats;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::Read;
use std::path::Path;
use std::time::Instant;

/// Name of the file.
pub const MANIFEST: &str = "manifest.json";
/// Version of the manifest's layout.
const FORMAT: u32 = 1;

/// The manifest; fields are written in this order.
#[derive(Debug, Serialize)]
pub struct Manifest {
    /// Version of this layout.
    pub format: u32,
    /// Name of the scan.
    pub name: String,
    /// When it was made.
    #[serde(flatten)]
    pub dates: Dates,
    /// Version of the program.
    pub lumiscan: &'static str,
    /// How long it took.
    pub after_last_frame_s: AfterLastFrame,
    /// Every other file of the folder.
    pub files: Vec<FileEntry>,
    /// The capture process.
    pub capture: CaptureEntry,
    /// The estimator process.
    pub estimator: EstimatorEntry,
}

/// Seconds of wall time from the last frame that was fused; `null` where a later run went on from the scan file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AfterLastFrame {
    /// To the folder with the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<Option<f64>>,
    /// To the folder with all its files; absent until they are there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub published: Option<Option<f64>>,
}

/// A file of the scan.
#[derive(Debug, Serialize)]
pub struct FileEntry {
    /// Its name in the folder.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// CRC-32 (IEEE) of its contents, eight hexadecimal digits.
    pub crc32: String,
}

/// What capture did.
#[derive(Debug, Serialize)]
pub struct CaptureEntry {
    /// Where the frames came from.
    pub source: String,
    /// Vertices of the scan's mesh.
    pub vertices: usize,
    /// Keyframes kept.
    pub keyframes: usize,
    /// Counters.
    pub stats: CaptureStats,
    /// Seconds of wall time by stage.
    pub seconds: Vec<(String, f64)>,
    /// Peak resident memory.
    pub memory_peak_bytes: Option<u64>,
    /// When its last frame was fused, if this process fused it.
    #[serde(skip)]
    pub last_frame: Option<Instant>,
}

/// How the estimator ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorOutcome {
    /// With a complete result.
    Done,
    /// The result was there already.
    Unchanged,
    /// It was not run.
    #[default]
    Skipped,
    /// With a result, and an error.
    Partial,
    /// Without a result.
    Failed,
}

/// What the estimator did.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct EstimatorEntry {
    /// How it ended.
    pub outcome: EstimatorOutcome,
    /// Its error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// What the result was made from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<Origin>,
    /// Vertices of the result's mesh.
    pub vertices: usize,
    /// What was decided, cut and warned of. A reader takes it from the result, where every figure is exact.
    #[serde(flatten, skip_deserializing)]
    pub findings: Findings,
    /// Seconds of wall time by stage.
    pub seconds: Vec<(String, f64)>,
    /// Seconds of processor time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_seconds: Option<f64>,
    /// Peak resident memory.
    pub memory_peak_bytes: Option<u64>,
}

/// The files of a folder, sorted by name, with their checksums.
///
/// # Errors
/// A file cannot be read back.
fn list(folder: &Path) -> Result<Vec<FileEntry>, Failure> {
    let unreadable = |e: std::io::Error| Failure::writing(folder, e);
    let mut names: Vec<std::ffi::OsString> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|e| e.map(|e| e.file_name())).collect())
        .map_err(unreadable)?;
    names.retain(|name| name != MANIFEST);
    names.sort();
    let mut files = Vec::new();
    for name in names {
        let path = folder.join(&name);
        let bytes = path.metadata().map_err(unreadable)?.len();
        let crc32 = crc32_of_file(&path).map_err(|e| Failure::Internal(e.to_string()))?;
        files.push(FileEntry { name: name.to_string_lossy().into_owned(), bytes, crc32: format!("{crc32:08x}") });
    }
    Ok(files)
}

/// The manifest of a published folder, brought up to date after its result was replaced.
///
/// # Errors
/// A file cannot be read.
pub fn updated(published: &Path, folder: &Path, estimator: &EstimatorEntry) -> Result<String, Failure> {
    let path = published.join(MANIFEST);
    let unreadable = |e: &dyn std::fmt::Display| Failure::Input(format!("{}: {e}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|e| unreadable(&e))?;
    let mut manifest: serde_json::Map<String, serde_json::Value> =
        serde_json::from_str(&text).map_err(|e| unreadable(&e))?;
    let internal = |e: serde_json::Error| Failure::Internal(e.to_string());
    manifest.insert("files".into(), serde_json::to_value(list(folder)?).map_err(internal)?);
    manifest.insert("estimator".into(), serde_json::to_value(estimator).map_err(internal)?);
    serde_json::to_string_pretty(&manifest).map(|t| t + "\n").map_err(internal)
}

impl EstimatorEntry {
    /// True if there is a result, complete or not.
    #[must_use]
    pub fn has_result(&self) -> bool {
        !matches!(self.outcome, EstimatorOutcome::Skipped | EstimatorOutcome::Failed)
    }

    /// Takes over what the result tells.
    pub fn describe(&mut self, result: &Estimate) {
        self.vertices = result.mesh.positions.len();
        self.findings = Findings::new(&result.decisions, &result.cuts, &result.warnings);
    }
}

impl Manifest {
    /// Lists the files of `folder`, sorted by name, with their checksums.
    ///
    /// # Errors
    /// A file cannot be read back.
    pub fn new(
        folder: &Path,
        name: String,
        dates: Dates,
        capture: CaptureEntry,
        estimator: EstimatorEntry,
    ) -> Result<Self, Failure> {
        let files = list(folder)?;
        let after = capture.last_frame.map(|t| t.elapsed().as_secs_f64());
        let after_last_frame_s = if estimator.has_result() {
            AfterLastFrame { result: Some(after), published: None }
        } else {
            AfterLastFrame { result: None, published: Some(after) }
        };
        let lumiscan = env!("CARGO_PKG_VERSION");
        Ok(Self { format: FORMAT, name, dates, lumiscan, after_last_frame_s, files, capture, estimator })
    }

    /// Takes over the files that followed the result, with the seconds that each took.
    ///
    /// # Errors
    /// A file cannot be read back.
    pub fn complete(&mut self, folder: &Path, seconds: Vec<(String, f64)>) -> Result<(), Failure> {
        self.files = list(folder)?;
        self.estimator.seconds.extend(seconds);
        self.after_last_frame_s.published = Some(self.capture.last_frame.map(|t| t.elapsed().as_secs_f64()));
        Ok(())
    }

    /// As JSON.
    ///
    /// # Errors
    /// The manifest cannot be serialised, which does not happen.
    pub fn to_json(&self) -> Result<String, Failure> {
        serde_json::to_string_pretty(self).map(|t| t + "\n").map_err(|e| Failure::Internal(e.to_string()))
    }
}

/// Bytes of the longest manifest that is read.
const MOST_BYTES: u64 = 4 << 20;

/// The manifest of a published scan; `None` if there is none that can be read.
#[must_use]
pub fn read(folder: &Path) -> Option<Value> {
    let file = std::fs::File::open(folder.join(MANIFEST)).ok()?;
    serde_json::from_reader(file.take(MOST_BYTES)).ok()
}

/// True if the process that published the result ended before the files that follow it were there.
#[must_use]
pub fn is_incomplete(folder: &Path) -> bool {
    let after = read(folder).map(|m| m["after_last_frame_s"].clone());
    after.is_some_and(|a| a.as_object().is_some_and(|a| !a.contains_key("published")))
}

/// Takes over the files that followed the result in a later run.
///
/// # Errors
/// A file cannot be read, or the disk is full or gone.
pub fn complete_later(folder: &Path) -> Result<(), Failure> {
    let files = serde_json::to_value(list(folder)?).map_err(|e| Failure::Internal(e.to_string()))?;
    let mut after = read(folder).unwrap_or_default()["after_last_frame_s"].clone();
    after["published"] = Value::Null;
    change(folder, vec![("files", files), ("after_last_frame_s", after)])
}

/// Replaces fields of the manifest of a published scan.
///
/// # Errors
/// The disk is full or gone.
pub fn change(folder: &Path, changes: Vec<(&str, Value)>) -> Result<(), Failure> {
    let mut manifest = read(folder).unwrap_or_else(|| Value::Object(serde_json::Map::new()));
    for (field, value) in changes {
        manifest[field] = value;
    }
    let text = serde_json::to_string_pretty(&manifest).map_err(|e| Failure::Internal(e.to_string()))?;
    write_file(&folder.join(MANIFEST), (text + "\n").as_bytes())
}
