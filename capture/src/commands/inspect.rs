//! `lumiscan inspect`: the contents of a file.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::failure::Failure;
use recordings::codec::chunk::kind_of;
use recordings::decision_text::Findings;
use recordings::local_light::Emitter;
use recordings::recording::{RecordingKind, RecordingReader, RecordingSummary};
use recordings::result::{Estimate, Origin};
use recordings::scan::{Scan, ScanSource};
use serde_json::{Value, json};
use std::path::Path;

const RECORDING: [u8; 4] = *b"LREC";
const SCAN: [u8; 4] = *b"SCAN";
const RESULT: [u8; 4] = *b"LRES";

/// Runs the command.
pub fn run(args: &cli::Inspect, as_json: bool) -> Result<(), Failure> {
    let summary = match kind_of(&args.file)? {
        Some(RECORDING) => recording(&args.file)?,
        Some(SCAN) => scan(&Scan::read(&args.file)?),
        Some(RESULT) => result(&Estimate::read(&args.file)?, Origin::read(&args.file)?.as_ref()),
        _ => {
            let shown = args.file.display();
            return Err(Failure::Input(format!("{shown}: not a Lumiscan file; give an .lrec, .lscan or .lres")));
        }
    };
    if as_json { print_json(&summary) } else { print(lines(&summary, 0).trim_end()) }
}

fn recording(path: &Path) -> Result<Value, Failure> {
    let sensor = RecordingReader::open(path)?.sensor().clone();
    let summary = RecordingSummary::read(path)?;
    Ok(json!({
        "kind": "recording",
        "content": match summary.kind { RecordingKind::Frames => "frames", RecordingKind::Packets => "packets" },
        "duration_s": summary.duration_s,
        "depth": summary.depth,
        "color": summary.color,
        "accelerometer": summary.accelerometer,
        "packets": summary.packets,
        "sensor": sensor,
    }))
}

fn scan(s: &Scan) -> Value {
    json!({
        "kind": "scan",
        "name": s.name,
        "source": match s.source { ScanSource::Fusion => "fusion", ScanSource::Photos => "photos" },
        "vertices": s.mesh.positions.len(),
        "triangles": s.mesh.triangles.len(),
        "keyframes": s.keyframes.len(),
        "witnesses": s.witnesses.len(),
        "stats": s.stats,
        "sensor": s.sensor,
    })
}

fn result(r: &Estimate, origin: Option<&Origin>) -> Value {
    let findings = Findings::new(&r.decisions, &r.cuts, &r.warnings);
    json!({
        "kind": "result",
        "name": r.name,
        "vertices": r.mesh.positions.len(),
        "triangles": r.mesh.triangles.len(),
        "segments": r.segments.len(),
        "bands": r.light.bands(),
        "transfer": r.transfer,
        "decisions": findings.decisions,
        "cuts": findings.cuts,
        "cut_values": findings.cut_values,
        "warnings": findings.warnings,
        "warning_values": findings.warning_values,
        "keyframes": r.keyframes.len(),
        "witnesses": r.witnesses,
        "albedo_scale_rule": r.albedo_scale_rule,
        "origin": origin,
        "light_model": r.local_light.model.name(),
        "lamps": r.local_light.lamps,
        "emitters": r.local_light.emitters.iter().map(emitter).collect::<Vec<_>>(),
        "light": r.light.coefficients,
        "light_standard_deviation": r.light.standard_deviation,
        "materials": r.segments,
    })
}

fn emitter(e: &Emitter) -> Value {
    json!({ "vertices": e.vertices.len(), "radiance": e.radiance })
}

/// The same as text: one line per field, nested fields indented, long lists only counted.
fn lines(value: &Value, depth: usize) -> String {
    const LONGEST: usize = 12;
    let indent = "  ".repeat(depth);
    let Value::Object(fields) = value else { return format!("{indent}{}\n", leaf(value)) };
    let width = fields.keys().map(String::len).max().unwrap_or(0);
    let mut text = String::new();
    for (key, value) in fields.iter().filter(in_text) {
        match value {
            Value::Object(inner) if inner.len() > 3 => {
                text += &format!("{indent}{key}\n{}", lines(value, depth + 1));
            }
            Value::Array(items) if items.iter().any(Value::is_object) && items.len() <= LONGEST => {
                text += &format!("{indent}{key}\n");
                for item in items {
                    text += &format!("{indent}  {}\n", leaf(item));
                }
            }
            Value::Array(items) if items.len() > LONGEST => {
                text += &format!("{indent}{key:width$}  {} entries (see --json)\n", items.len());
            }
            _ => text += &format!("{indent}{key:width$}  {}\n", leaf(value)),
        }
    }
    text
}

/// False for values that a sentence beside them repeats.
fn in_text((key, _): &(&String, &Value)) -> bool {
    !key.ends_with("_values")
}

fn leaf(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => format!("{:.4}", n.as_f64().unwrap_or(f64::NAN)),
        Value::Object(fields) => {
            let fields = fields.iter().filter(in_text).map(|(k, v)| format!("{k} {}", leaf(v)));
            fields.collect::<Vec<_>>().join(" · ")
        }
        Value::Array(items) if items.is_empty() => "none".into(),
        Value::Array(items) => items.iter().map(leaf).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
    }
}
