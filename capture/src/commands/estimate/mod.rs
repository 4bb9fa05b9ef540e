//! `lumiscan estimate`: a scan to a result. [`here`] runs the estimator in this process; with `--if-changed`, [`if_changed`] runs it in
//! a child, and only where there is something to do. [`command`] prints how it ended.

pub mod answers;
pub mod command;
mod here;
mod if_changed;
mod inputs;
mod watchdog;
