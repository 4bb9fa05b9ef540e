//! `status.json` in the device folder, and the reports to the service manager.

use crate::daemon::notify::Notifier;
use crate::device_folder::disk::free_bytes;
use crate::device_folder::files::replace_unsynced;
use crate::memory;
use crate::status::{Board, State, Status};
use crate::stop::Stop;
use firmware_config::tuning::SupervisionTuning;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Writes `status.json` and reports to the service manager until `done` is set; the body of a thread.
pub fn publish(board: &Board, device: &Path, stop: &Stop, done: &AtomicBool, tuning: &SupervisionTuning) {
    let notifier = Notifier::from_environment();
    let path = device.join("status.json");
    let (mut written, mut last): (Option<Instant>, Option<State>) = (None, None);
    while !done.load(Ordering::Relaxed) {
        let mut status = board.get();
        if last != Some(status.state)
            || written.is_none_or(|t| t.elapsed() >= Duration::from_secs_f64(tuning.status_interval_s))
        {
            if last != Some(status.state) {
                notifier.send(&format!("STATUS={}", line(&status)));
            }
            (written, last) = (Some(Instant::now()), Some(status.state));
            status.format = 1;
            status.memory_bytes = memory::resident_bytes();
            status.memory_peak_bytes = memory::peak_bytes();
            status.disk_free_bytes = free_bytes(device).ok();
            // A full disk may have room again later.
            let replaced = serde_json::to_vec_pretty(&status)
                .map_err(std::io::Error::from)
                .and_then(|text| replace_unsynced(&path, &text));
            if let Err(e) = replaced {
                tracing::debug!("{}: {e}", path.display());
            }
            if stop.since_heartbeat() < Duration::from_secs_f64(tuning.watchdog_s) {
                notifier.send("WATCHDOG=1");
            }
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The status in one line.
#[must_use]
pub fn line(s: &Status) -> String {
    let mut text = s.state.to_string();
    if let Some(scan) = &s.scan {
        text += &format!(
            " {} · {:.0} s · {:.1} fps · {} dropped",
            scan.name, scan.seconds, scan.fps, s.drops.dropped_pairs
        );
    }
    if let Some(sensor) = &s.sensor {
        text += &format!(" · {sensor}");
    }
    text
}
