//! A small HTTP/1.1 server. In: bytes of strangers. Out: checked requests to a handler, and its answers.
//!
//! Everything is bounded: connections (in all and by address), bytes of a head and of a body, the time for a head, the time
//! between requests, the time in which a client takes nothing, and the bytes that wait for it. With a certificate of the
//! owner's, everything goes through TLS.

pub mod certificate;
pub mod connection;
pub mod link;
pub mod request;
pub mod response;
pub mod server;
mod slots;
