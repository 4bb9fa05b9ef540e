//! `GET /api/status` and `/api/events`: the state of the box.

use crate::device_folder::disk::free_bytes;
use crate::memory;
use crate::report::Step;
use crate::serve::context::Context;
use crate::serve::http::response::{Body, Response};
use crate::serve::live::hub::Live;
use crate::status::Status;
use serde::Serialize;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

/// Time between two events.
const EVENTS: Duration = Duration::from_millis(250);

/// `status.json`, and what only clients of the page need.
#[derive(Serialize)]
struct Full {
    #[serde(flatten)]
    status: Status,
    /// The scan in progress.
    live: Live,
    /// Name that the user gave to it.
    name: Option<String>,
    /// Longest duration of a scan that begins now, seconds.
    max_scan_s: f64,
    /// What the estimator does.
    step: Option<Step>,
    /// Version of the program.
    lumiscan: &'static str,
}

fn full(context: &Context) -> Full {
    let mut status = context.board.get();
    status.format = 1;
    status.memory_bytes = memory::resident_bytes();
    status.memory_peak_bytes = memory::peak_bytes();
    status.disk_free_bytes = free_bytes(&context.device).ok();
    Full {
        status,
        live: context.hub.live(),
        name: context.orders.name(),
        max_scan_s: context.settings().daemon.max_scan_s,
        step: context.reporter.current(),
        lumiscan: env!("CARGO_PKG_VERSION"),
    }
}

/// The state now.
pub fn status(context: &Context) -> Response {
    Response::json(&full(context))
}

/// The state four times a second, as server-sent events.
pub fn events(context: &Arc<Context>) -> Response {
    let context = Arc::clone(context);
    let streamer = Body::Stream(Box::new(move |stream| {
        loop {
            context.hub.watch();
            let text = serde_json::to_string(&full(&context))?;
            stream.write_all(format!("event: status\ndata: {text}\n\n").as_bytes())?;
            std::thread::sleep(EVENTS);
        }
    }));
    Response::new(200, "text/event-stream", streamer)
}
