//! The daemon of `lumiscan capture`. In: a Kinect ([`crate::kinect`]) and orders from the [`control_socket`]. Out: published
//! scans ([`scan_loop`]), `status.json` ([`status_file`]) and reports to systemd ([`notify`]).

pub mod control_socket;
pub mod notify;
pub mod scan_loop;
pub mod status_file;
