//! The box itself: its diagnosis, its settings, and how another browser is paired.

use crate::live_config::CHANGEABLE;
use crate::serve::context::Context;
use crate::serve::http::request::Request;
use crate::serve::http::response::Response;
use crate::serve::qr;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Longest time that `lumiscan check` may take.
const CHECK_TIME: Duration = Duration::from_secs(60);

/// `GET /api/check`: what `lumiscan check` says, as a process of its own.
pub fn check(context: &Context) -> Response {
    let state = context.board.get().state;
    if state.is_working() {
        return Response::error(409, &format!("the box is {state}; check it when it is ready"));
    }
    match checked(context) {
        Ok(report) => Response::json(&report),
        Err(e) => Response::error(500, &format!("the check failed: {e}")),
    }
}

fn checked(context: &Context) -> std::io::Result<serde_json::Value> {
    let mut child = Command::new(std::env::current_exe()?)
        .args(["--json", "check", "--device"])
        .arg(&context.device)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let began = Instant::now();
    // Its report is far smaller than a pipe holds.
    while child.try_wait()?.is_none() {
        if began.elapsed() > CHECK_TIME {
            child.kill()?;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let output = child.wait_with_output()?;
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// `GET /api/settings`: every setting, and which of them may change while the box runs.
pub fn settings(context: &Context) -> Response {
    let live = context.live_config.as_ref();
    let all: Vec<_> = context
        .settings()
        .settings()
        .into_iter()
        .filter(|s| !s.tuning)
        .map(|s| {
            let changes = live.is_some() && CHANGEABLE.contains(&s.key.as_ref());
            serde_json::json!({
                "key": s.key, "value": s.value, "unit": s.unit, "range": s.range, "doc": s.doc, "changes": changes,
            })
        })
        .collect();
    Response::json(&serde_json::json!({ "auto": context.orders.is_auto(), "settings": all }))
}

/// What is to change.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Changes {
    /// Motion starts scans, stillness ends them.
    auto: Option<bool>,
    /// Values by their keys.
    #[serde(default)]
    settings: BTreeMap<String, Value>,
}

/// `POST /api/settings`: changes what may change; it holds until the box restarts.
pub fn change_settings(context: &Context, body: &[u8]) -> Response {
    let Ok(Changes { auto, settings }) = serde_json::from_slice(body) else {
        return Response::error(400, "send {\"auto\": true} or {\"settings\": {\"daemon.budget_s\": 60}}");
    };
    let text = |v: &Value| v.as_str().map_or_else(|| v.to_string(), ToOwned::to_owned);
    let changed = match &context.live_config {
        Some(live) => live.change(settings.iter().map(|(k, v)| (k.as_str(), text(v)))),
        None if settings.is_empty() => Ok(()),
        None => Err("the settings of a replay do not change".into()),
    };
    if let Err(problem) = changed {
        return Response::error(400, &problem);
    }
    if let Some(auto) = auto {
        context.orders.set_auto(auto);
        context.board.set(|s| s.auto = auto);
    }
    Response::json(&serde_json::json!({ "ok": true }))
}

/// `POST /api/pair`: an address that pairs one more browser, and its QR code as SVG.
pub fn pair(context: &Context, request: &Request) -> Response {
    let Some(host) = request.header("host") else { return Response::error(400, "there is no Host header") };
    match context.access.new_code() {
        Ok(code) => {
            let url = format!("{}://{host}/?code={code}", context.scheme);
            Response::json(&serde_json::json!({ "qr": qr::svg(&url), "url": url }))
        }
        Err(e) => Response::error(500, &e.to_string()),
    }
}
