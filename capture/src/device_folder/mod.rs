//! The device folder. In: a captured scan. Out: `<device>/scans/<utc>-<name>/`, which appears complete or not at all
//! ([`staging`]), described by its [`manifest`]. [`retention`] numbers scans and removes the oldest ones;
//! [`disk`] measures room and speed; [`files`] writes atomically. [`handed_off`] knows which scans are on another machine;
//! [`replace`] puts a result that comes from there in place. [`dates`] says when a scan was made, and [`undated`] dates what was made while the clock was not set.

pub mod dates;
pub mod disk;
pub mod files;
pub mod handed_off;
pub mod manifest;
pub mod naming;
pub mod replace;
pub mod retention;
pub mod staging;
pub mod undated;
