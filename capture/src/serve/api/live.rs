//! Pictures and surface of the scan in progress.

use crate::serve::context::Context;
use crate::serve::http::request::Request;
use crate::serve::http::response::{Body, Response};
use crate::serve::live::pictures::Picture;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

/// Longest wait for a new picture.
const WAIT: Duration = Duration::from_secs(5);
/// Separates the pictures of a stream.
const BOUNDARY: &str = "lumiscan-picture";

/// A number in the query; 0 where there is none.
fn number<T: std::str::FromStr + Default>(request: &Request, name: &str) -> T {
    request.query.get(name).and_then(|v| v.parse().ok()).unwrap_or_default()
}

/// `GET /api/live.jpg?after=N`: the newest picture, as soon as there is one with a number above N. Number, time and pose
/// are in headers.
pub fn newest(context: &Context, request: &Request) -> Response {
    match context.hub.newer_picture(number(request, "after"), WAIT) {
        Some(picture) => described(&picture),
        None => Response::empty(),
    }
}

/// `GET /api/kept/N.jpg`: a picture of a kept frame, with its pose.
pub fn kept(context: &Context, name: &str) -> Response {
    let number = name.strip_suffix(".jpg").and_then(|n| n.parse().ok());
    match number.and_then(|n| context.hub.pictures.kept(n)) {
        Some(picture) => described(&picture),
        None => Response::error(404, "there is no such picture any more"),
    }
}

fn described(picture: &Picture) -> Response {
    Response::new(200, "image/jpeg", Body::Shared(Arc::clone(&picture.jpeg)))
        .with("X-Number", picture.number.to_string())
        .with("X-Seconds", format!("{:.3}", picture.seconds))
        .with("X-Pose", pose_text(picture))
}

/// `world_from_camera`, rows, separated by spaces; empty when lost.
fn pose_text(picture: &Picture) -> String {
    let rows = picture.pose.map(|p| p.to_rows()).into_iter().flatten().flatten();
    rows.map(|x| format!("{x:.6}")).collect::<Vec<_>>().join(" ")
}

/// `GET /api/live.mjpeg`: pictures without end. A client that reads slowly misses some.
pub fn stream(context: &Arc<Context>) -> Response {
    let context = Arc::clone(context);
    let streamer = Body::Stream(Box::new(move |stream| {
        let mut last = 0;
        loop {
            let Some(picture) = context.hub.newer_picture(last, WAIT) else {
                // Nothing is shown between scans; a line feed finds out whether the client is still there.
                stream.write_all(b"\r\n")?;
                continue;
            };
            last = picture.number;
            let head = format!(
                "--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\nX-Number: {last}\r\nX-Pose: {}\r\n\r\n",
                picture.jpeg.len(),
                pose_text(&picture)
            );
            stream.write_all(&[head.as_bytes(), &picture.jpeg, b"\r\n"].concat())?;
        }
    }));
    Response::new(200, &format!("multipart/x-mixed-replace; boundary={BOUNDARY}"), streamer)
}

/// `GET /api/surface?generation=G&since=N`: the surface that changed.
pub fn surface(context: &Context, request: &Request) -> Response {
    let changes = context.hub.surface_since(number(request, "generation"), number(request, "since"));
    Response::new(200, "application/octet-stream", Body::Bytes(changes))
}

/// `GET /api/light`: the light found so far.
pub fn light(context: &Context) -> Response {
    match context.hub.light() {
        Some(light) => Response::json(&light),
        None => Response::error(404, "the light is not known yet; watch a scan for a few seconds"),
    }
}
