//! The box itself: its diagnosis, its settings, and how another browser is paired.

use crate::serve::context::Context;
use crate::serve::http::request::Request;
use crate::serve::http::response::Response;
use crate::serve::qr;
use serde::Deserialize;
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

/// `GET /api/settings`: every setting, and what may change while the box runs.
pub fn settings(context: &Context) -> Response {
    let all: Vec<_> = context
        .config
        .settings()
        .into_iter()
        .filter(|s| !s.tuning)
        .map(|s| serde_json::json!({ "key": s.key, "value": s.value, "unit": s.unit, "range": s.range, "doc": s.doc }))
        .collect();
    Response::json(&serde_json::json!({ "auto": context.orders.is_auto(), "settings": all }))
}

/// What may change while the box runs.
#[derive(Deserialize)]
struct Changes {
    /// Motion starts scans, stillness ends them.
    auto: bool,
}

/// `POST /api/settings`: changes what may change; it holds until the box restarts.
pub fn change_settings(context: &Context, body: &[u8]) -> Response {
    let Ok(Changes { auto }) = serde_json::from_slice(body) else {
        return Response::error(400, "send {\"auto\": true} or {\"auto\": false}");
    };
    context.orders.set_auto(auto);
    context.board.set(|s| s.auto = auto);
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
