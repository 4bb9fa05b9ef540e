//! `/api/scans`: the published scans of the device folder.

use crate::cli::QualityPoint;
use crate::device_folder::{manifest, retention};
use crate::serve::api::files::{folder_of, names};
use crate::serve::api::scan::name_in;
use crate::serve::context::Context;
use crate::serve::http::response::Response;
use crate::serve::jobs::Work;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;

/// A scan in the list.
#[derive(Serialize)]
struct Listed {
    id: String,
    name: Value,
    published: Value,
    bytes: u64,
    /// Each file with its size.
    files: Vec<(String, u64)>,
    vertices: Value,
    keyframes: Value,
    seconds: Value,
    /// `done`, `partial`, `failed` or `skipped`.
    outcome: Value,
    problem: Value,
    warnings: Value,
    cuts: Value,
}

/// The scans, newest first, and the work that is done on one of them.
pub fn list(context: &Context) -> Response {
    let mut ids = retention::published(&context.device);
    ids.reverse();
    let scans: Vec<Listed> = ids.into_iter().filter_map(|id| listed(&context.device, id)).collect();
    Response::json(&serde_json::json!({ "scans": scans, "job": context.jobs.now() }))
}

fn listed(device: &Path, id: String) -> Option<Listed> {
    let folder = folder_of(device, &id)?;
    let manifest = manifest::read(&folder).unwrap_or_default();
    let size = |name: &String| std::fs::metadata(folder.join(name)).map_or(0, |m| m.len());
    let files: Vec<(String, u64)> = names(&folder).into_iter().map(|name| (name.clone(), size(&name))).collect();
    let (capture, estimator) = (&manifest["capture"], &manifest["estimator"]);
    Some(Listed {
        name: match &manifest["name"] {
            Value::String(name) => name.clone().into(),
            _ => id.clone().into(),
        },
        published: manifest["published"].clone(),
        bytes: files.iter().map(|(_, n)| n).sum(),
        vertices: capture["vertices"].clone(),
        keyframes: capture["keyframes"].clone(),
        seconds: capture["stats"]["duration_s"].clone(),
        outcome: estimator["outcome"].clone(),
        problem: estimator["problem"].clone(),
        warnings: estimator["warnings"].clone(),
        cuts: estimator["cuts"].clone(),
        files,
        id,
    })
}

/// Removes a scan.
pub fn delete(context: &Context, id: &str) -> Response {
    let Some(folder) = folder_of(&context.device, id) else { return no_such_scan() };
    if context.jobs.works_on(id) {
        return busy();
    }
    retention::remove(&folder);
    if folder.exists() {
        return Response::error(500, "the scan cannot be removed; see the log");
    }
    Response::json(&serde_json::json!({ "ok": true }))
}

/// Gives a scan another name; answers with its new id.
pub fn rename(context: &Context, id: &str, body: &[u8]) -> Response {
    let Some(folder) = folder_of(&context.device, id) else { return no_such_scan() };
    let name = match name_in(body) {
        Ok(name) => name,
        Err(response) => return response,
    };
    if context.jobs.works_on(id) {
        return busy();
    }
    match retention::rename(&folder, &name) {
        Ok(id) => Response::json(&serde_json::json!({ "id": id })),
        Err(e) => Response::error(500, &e.to_string()),
    }
}

#[derive(Deserialize)]
struct Again {
    quality: String,
}

/// Estimates a scan again, at another quality.
pub fn estimate(context: &Context, id: &str, body: &[u8]) -> Response {
    let Some(folder) = folder_of(&context.device, id) else { return no_such_scan() };
    let point = serde_json::from_slice::<Again>(body).ok().and_then(|a| QualityPoint::from_str(&a.quality, true).ok());
    let Some(quality) = point else {
        return Response::error(400, "send {\"quality\": \"draft\"}, \"standard\" or \"best\"");
    };
    let state = context.board.get().state;
    if state.is_working() {
        return Response::error(409, &format!("the box is {state}; wait for it to be ready"));
    }
    let work = Work::Estimate(folder, quality, context.settings().daemon.budget_s);
    match context.jobs.start(id, || Ok(work)) {
        Ok(()) => Response::json(&serde_json::json!({ "ok": true })),
        Err(problem) => Response::error(409, &problem),
    }
}

fn no_such_scan() -> Response {
    Response::error(404, "there is no such scan")
}

fn busy() -> Response {
    Response::error(409, "the box works on this scan; wait until that is done")
}
