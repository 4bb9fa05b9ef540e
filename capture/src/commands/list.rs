//! `lumiscan list`: the sensors that are plugged in.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::failure::Failure;
use crate::kinect::transport::UsbError;
use crate::sources::sensor;
use serde_json::json;

/// Runs the command.
pub fn run(args: &cli::List, as_json: bool) -> Result<(), Failure> {
    let found = sensor::bus(args.simulate.as_ref())?.list().map_err(sensor::failure)?;
    if found.is_empty() {
        return Err(sensor::failure(UsbError::NoDevice));
    }
    if as_json {
        let all: Vec<_> = found
            .iter()
            .map(|f| {
                json!({ "model": f.model.name(), "serial": f.serial, "bus": f.bus, "path": f.path,
                        "address": f.address, "accessible": f.accessible })
            })
            .collect();
        return print_json(&all);
    }
    for f in &found {
        let serial = if f.serial.is_empty() { "without serial number" } else { &f.serial };
        let note = if f.accessible { "" } else { " · this user may not open it; install the udev rule" };
        print(&format!("{} · {serial} · bus {} path {} address {}{note}", f.model.name(), f.bus, f.path, f.address))?;
    }
    Ok(())
}
