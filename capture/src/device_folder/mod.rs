//! The device folder. In: a captured scan. Out: `<device>/scans/<utc>-<name>/`, which appears complete or not at all
//! ([`staging`]), described by its [`manifest`]. [`retention`] numbers scans and removes the oldest ones;
//! [`disk`] measures room and speed; [`files`] writes atomically.

pub mod disk;
pub mod files;
pub mod manifest;
pub mod naming;
pub mod retention;
pub mod staging;
