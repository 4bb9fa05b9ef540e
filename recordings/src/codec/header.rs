//! Header structs as postcard.

use serde::{Deserialize, Serialize};

/// Postcard of a header struct. Fails only where memory does, which is not reported as an error on any system we run on.
pub(crate) fn to_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>, String> {
    postcard::to_allocvec(value).map_err(|e| e.to_string())
}

/// Reads a header struct; the rest of the bytes follows.
pub(crate) fn from_bytes<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<(T, &'a [u8]), String> {
    postcard::take_from_bytes(bytes).map_err(|e| format!("unreadable header: {e}"))
}
