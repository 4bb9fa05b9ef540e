//! `lumiscan handoff`: finished scans to another machine, results from there.

use crate::cli;
use crate::commands::output::{print, print_json};
use crate::commands::settings::load;
use crate::device_folder::files::write_file;
use crate::device_folder::handed_off::HANDOFF;
use crate::failure::Failure;
use crate::handoff::fetch::{Fetched, fetch};
use crate::handoff::push::{Pushed, push};
use crate::stop::Stop;
use recordings::codec::exclusive::open_exclusive;
use serde::Serialize;

/// What `status.json` of the hand-off tells.
#[derive(Serialize)]
struct Report {
    destination: String,
    pushed: Pushed,
    fetched: Fetched,
}

/// Runs the command.
pub fn run(args: &cli::Handoff, json: bool) -> Result<(), Failure> {
    let config = load(&args.settings)?.handoff;
    if !config.is_on() {
        return Err(Failure::Usage(
            "handoff.destination is not set; name a folder there, as in user@host:folder".into(),
        ));
    }
    let device = &args.device;
    if !device.join("scans").is_dir() {
        return Err(Failure::Usage(format!("{}: there is no device folder; name it with --device", device.display())));
    }
    let stop = Stop::on_signals()?;
    let folder = device.join(HANDOFF);
    std::fs::create_dir_all(&folder).map_err(|e| Failure::writing(&folder, e))?;
    let lock = open_exclusive(&folder.join("lock")).map_err(|e| Failure::writing(&folder, e))?;
    let Some(_lock) = lock else {
        return Err(Failure::Internal(format!("{}: another hand-off is running", device.display())));
    };

    let pushed = push(device, &config, &stop)?;
    let fetched = fetch(device, &config, &stop)?;
    let report = Report { destination: config.destination, pushed, fetched };
    let text = serde_json::to_string_pretty(&report).map_err(|e| Failure::Internal(e.to_string()))?;
    write_file(&folder.join("status.json"), (text + "\n").as_bytes())?;
    let Report { pushed, fetched, .. } = &report;
    if json {
        print_json(&report)?;
    } else {
        let (confirmed, waiting, replaced) = (pushed.confirmed, pushed.waiting, fetched.replaced.len());
        print(&format!("{confirmed} scans handed off, {waiting} waiting, {replaced} results replaced"))?;
    }
    let problems: Vec<&String> = pushed.problems.iter().chain(&fetched.problems).collect();
    match problems.as_slice() {
        [] => Ok(()),
        [first, ..] => {
            Err(Failure::Internal(format!("{first}; {} problems; nothing is lost, run it again", problems.len())))
        }
    }
}
