//! From a request to its answer: first who asks and from where, then what.

use crate::serve::access::{Access, Pairing};
use crate::serve::api::{device, files, live, render, scan, scans, status};
use crate::serve::context::Context;
use crate::serve::guesses::TooMany;
use crate::serve::http::connection::Asked;
use crate::serve::http::request::Method;
use crate::serve::http::response::{Body, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// The page that a stranger sees: no script, nothing of the box.
const PAIRING_PAGE: &str = include_str!("page/pair.html");
const PAIRING_POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'";

/// Files of the pages: path, type, contents.
const PAGES: &[(&str, &str, &str)] = &[
    ("", "text/html; charset=utf-8", include_str!("page/live.html")),
    ("scans", "text/html; charset=utf-8", include_str!("page/scans.html")),
    ("render", "text/html; charset=utf-8", include_str!("page/render.html")),
    ("render.js", "text/javascript; charset=utf-8", include_str!("page/render.js")),
    ("ball.js", "text/javascript; charset=utf-8", include_str!("page/ball.js")),
    ("icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("live.js", "text/javascript; charset=utf-8", include_str!("page/live.js")),
    ("surface.js", "text/javascript; charset=utf-8", include_str!("page/surface.js")),
    ("map.js", "text/javascript; charset=utf-8", include_str!("page/map.js")),
    ("light.js", "text/javascript; charset=utf-8", include_str!("page/light.js")),
    ("object.js", "text/javascript; charset=utf-8", include_str!("page/object.js")),
    ("scans.js", "text/javascript; charset=utf-8", include_str!("page/scans.js")),
    ("common.js", "text/javascript; charset=utf-8", include_str!("page/common.js")),
];

/// Answers a request.
pub fn answer(context: &Arc<Context>, asked: Asked) -> Response {
    let Asked { request, body, peer } = asked;
    if !context.access.is_own_host(&request) {
        return Response::error(421, "this box has another name; add it to serve.names");
    }
    if request.path.is_empty()
        && request.method == Method::Get
        && let Some(code) = request.query.get("code")
    {
        return pair(context, code, peer);
    }
    let stranger = |status, told| match request.method {
        Method::Get if request.path.is_empty() => pairing_page(status),
        _ => Response::error(status, told),
    };
    let standing = match context.access.standing(&request, peer) {
        Ok(Some(standing)) => standing,
        Ok(None) => return stranger(401, "not paired; open the address with the pairing code, or send the token"),
        Err(TooMany) => {
            return later(stranger(429, "too many wrong codes and tokens; try again in a moment"));
        }
    };
    if !Access::may_change(&request, standing) {
        return Response::error(403, "changes are taken from the box's own pages and from programs with the token");
    }
    let segments = request.segments();
    match (request.method, segments.as_slice()) {
        (Method::Get | Method::Head, ["api", "status"]) => status::status(context),
        (Method::Get, ["api", "events"]) => status::events(context),
        (Method::Get | Method::Head, ["api", "keyframes"]) => Response::json(&context.hub.keyframes()),
        (Method::Get, ["api", "live.mjpeg"]) => live::stream(context),
        (Method::Get, ["api", "live.jpg"]) => live::newest(context, &request),
        (Method::Get, ["api", "kept", name]) => live::kept(context, name),
        (Method::Get, ["api", "surface"]) => live::surface(context, &request),
        (Method::Get | Method::Head, ["api", "light"]) => live::light(context),
        (Method::Post, ["api", "scan", order]) => scan::order(context, order, &body),
        (Method::Get | Method::Head, ["api", "scans"]) => scans::list(context),
        (Method::Delete, ["api", "scans", id]) => scans::delete(context, id),
        (Method::Post, ["api", "scans", id, "name"]) => scans::rename(context, id, &body),
        (Method::Post, ["api", "scans", id, "estimate"]) => scans::estimate(context, id, &body),
        (Method::Post, ["api", "scans", id, "render"]) => render::start(context, id, &body),
        (Method::Get | Method::Head, ["api", "render.png"]) => render::picture(context),
        (Method::Post, ["api", "render", "files", name]) => render::upload(context, &request, name, &body),
        (Method::Delete, ["api", "render", "files"]) => render::clear(context),
        (Method::Get | Method::Head, ["api", "log"]) => Response::json(&context.reporter.log()),
        (Method::Get, ["api", "check"]) => device::check(context),
        (Method::Get | Method::Head, ["api", "settings"]) => device::settings(context),
        (Method::Post, ["api", "settings"]) => device::change_settings(context, &body),
        (Method::Post, ["api", "pair"]) => device::pair(context, &request),
        (Method::Get | Method::Head, ["scans", archive]) if archive.ends_with(".tar") => {
            files::archive(context, &request, archive.trim_end_matches(".tar"))
        }
        (Method::Get | Method::Head, ["scans", id, name]) => files::file(context, &request, id, name),
        (Method::Get | Method::Head, [] | [_]) => page(segments.first().copied().unwrap_or_default()),
        _ => Response::error(404, "there is no such thing here; capture/API.md lists what there is"),
    }
}

fn page(name: &str) -> Response {
    PAGES.iter().find(|(path, ..)| *path == name).map_or_else(
        || Response::error(404, "there is no such page"),
        |(_, content_type, text)| Response::new(200, content_type, Body::Bytes(text.as_bytes().to_vec())),
    )
}

fn pair(context: &Context, code: &str, peer: IpAddr) -> Response {
    match context.access.pair(code, peer) {
        Ok(Pairing::Paired(cookie)) => {
            // Never sent in clear, where it need not be.
            let secure = if context.scheme == "https" { "; Secure" } else { "" };
            Response::redirect("/").with("Set-Cookie", format!("{cookie}{secure}"))
        }
        Ok(Pairing::Wrong) => pairing_page(403),
        Ok(Pairing::TooMany) => later(pairing_page(429)),
        Err(e) => Response::error(500, &e.to_string()),
    }
}

/// Says when to try again, in seconds.
fn later(refusal: Response) -> Response {
    refusal.with("Retry-After", "2")
}

fn pairing_page(status: u16) -> Response {
    let told = match status {
        403 => "That code is wrong or was used before.",
        429 => "Too many wrong codes are waiting for their answer. Try again in a moment.",
        _ => "",
    };
    let page = PAIRING_PAGE.replace("{told}", told);
    Response::text(status, "text/html; charset=utf-8", page).with("Content-Security-Policy", PAIRING_POLICY)
}
