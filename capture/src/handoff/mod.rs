//! The hand-off to another machine. In: finished scans of the device folder. Out: copies there, confirmed byte for byte ([`push`]);
//! results that were made there, in their scans' folders ([`fetch`]). [`rsync`] moves the bytes.

pub mod fetch;
pub mod push;
mod rsync;
