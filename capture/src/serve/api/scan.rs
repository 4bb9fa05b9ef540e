//! `POST /api/scan/…`: the scan in progress.

use crate::serve::context::Context;
use crate::serve::http::response::Response;
use crate::status::State;
use serde::Deserialize;

/// Characters of the longest name.
const NAME: usize = 48;

/// A body with a name.
#[derive(Deserialize)]
struct Named {
    name: String,
}

/// The name in a body.
///
/// # Errors
/// The answer that says what is wrong with it.
pub fn name_in(body: &[u8]) -> Result<String, Response> {
    let named: Named = serde_json::from_slice(body)
        .map_err(|_| Response::error(400, "send the name as JSON: {\"name\": \"kitchen\"}"))?;
    let name = named.name.trim().to_owned();
    let fits = !name.is_empty() && name.chars().count() <= NAME && !name.contains(char::is_control);
    if fits { Ok(name) } else { Err(Response::error(400, "a name has 1 to 48 characters")) }
}

/// Carries out an order, as far as the state allows it.
pub fn order(context: &Context, order: &str, body: &[u8]) -> Response {
    let state = context.board.get().state;
    let scanning = || match state {
        State::Scanning => Ok(()),
        _ => Err(format!("there is no scan in progress: the box is {state}")),
    };
    let outcome = match order {
        "start" => context.orders.start_in(state),
        "stop" => context.orders.stop_in(state),
        "pause" => scanning().map(|()| context.orders.pause(true)),
        "resume" => scanning().map(|()| context.orders.pause(false)),
        "discard" => scanning().map(|()| context.orders.discard()),
        "name" => match name_in(body) {
            Ok(name) => scanning().map(|()| context.orders.set_name(&name)),
            Err(response) => return response,
        },
        _ => return Response::error(404, "orders are start, pause, resume, stop, discard and name"),
    };
    match outcome {
        Ok(()) => Response::json(&serde_json::json!({ "ok": true })),
        Err(problem) => Response::error(409, &problem),
    }
}
