//! The web page: a scan while it is made, and the scans of the device folder, in any browser. In: what the pipeline leaves in
//! the [`live`] hub, the state of the box, the device folder. Out: pages, pictures, events, files; the user's requests to
//! [`crate::orders`].
//!
//! ```text
//! bytes ─▶ http ─▶ routes (access: who, from where) ─▶ api ─▶ live, device folder, orders
//! ```
//!
//! `capture/API.md` describes the interface. The page uses nothing else.

mod access;
pub mod announcement;
pub mod api;
mod context;
mod guesses;
pub mod http;
mod jobs;
mod light;
pub mod live;
mod qr;
mod render;
mod routes;
pub mod service;
