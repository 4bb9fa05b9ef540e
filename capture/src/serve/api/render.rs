//! `/api/scans/ID/render` and `/api/render/…`: pictures of a finished scan with a change in it.

use crate::serve::api::files::folder_of;
use crate::serve::context::Context;
use crate::serve::http::request::Request;
use crate::serve::http::response::{Body, Response};
use crate::serve::jobs::Work;
use crate::serve::render::picture::Picture;

/// `POST /api/scans/ID/render`: begins a picture; `GET /api/scans` tells how far it is.
pub fn start(context: &Context, id: &str, body: &[u8]) -> Response {
    let result_of = |id: &str| folder_of(&context.device, id).map(|f| f.join("result.lres")).filter(|r| r.is_file());
    let Some(result) = result_of(id) else {
        return Response::error(404, "there is no such scan, or it has no result");
    };
    let picture: Picture = match serde_json::from_slice(body) {
        Ok(picture) => picture,
        Err(e) => return Response::error(400, &format!("{e}; capture/API.md describes a picture")),
    };
    let state = context.board.get().state;
    if state.is_working() {
        return Response::error(409, &format!("the box is {state}; wait for it to be ready"));
    }
    if let Some(refused) = busy(context) {
        return refused;
    }
    let prepare = || {
        context.desk.folder().map_err(|e| e.to_string())?;
        let mut arguments = picture.arguments(&result, &context.desk, result_of)?;
        let limit_mb = context.config.daemon.estimator_limit_mb;
        if limit_mb > 0 {
            arguments.extend(["--memory".into(), limit_mb.to_string().into()]);
        }
        // What is shown is never that of an earlier wish.
        let _ = std::fs::remove_file(context.desk.picture());
        Ok(Work::Render(arguments))
    };
    match context.jobs.start(id, prepare) {
        Ok(()) => Response::json(&serde_json::json!({ "ok": true })),
        Err(problem) => Response::error(400, &problem),
    }
}

/// `GET /api/render.png`: the newest picture.
pub fn picture(context: &Context) -> Response {
    match std::fs::read(context.desk.picture()) {
        Ok(png) if !context.jobs.is_busy() => Response::new(200, "image/png", Body::Bytes(png)),
        _ => Response::error(404, "there is no picture yet"),
    }
}

/// `POST /api/render/files/NAME?offset=N`: a piece of a file to insert or to light with.
pub fn upload(context: &Context, request: &Request, name: &str, body: &[u8]) -> Response {
    if let Some(refused) = busy(context) {
        return refused;
    }
    let Some(offset) = request.query.get("offset").map_or(Some(0), |n| n.parse().ok()) else {
        return Response::error(400, "offset is the number of bytes that were sent before");
    };
    match context.desk.take(name, offset, body) {
        Ok(bytes) => Response::json(&serde_json::json!({ "bytes": bytes })),
        Err((status, problem)) => Response::error(status, &problem),
    }
}

/// `DELETE /api/render/files`: removes every file that was sent.
pub fn clear(context: &Context) -> Response {
    if let Some(refused) = busy(context) {
        return refused;
    }
    context.desk.clear();
    Response::json(&serde_json::json!({ "ok": true }))
}

/// The answer while another job runs.
fn busy(context: &Context) -> Option<Response> {
    let problem = "the box is busy with a picture or an estimate; wait until that is done";
    context.jobs.is_busy().then(|| Response::error(409, problem))
}
