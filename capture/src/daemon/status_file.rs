//! `status.json` in the device folder, and the reports to the service manager.

use crate::daemon::notify::Notifier;
use crate::device_folder::disk::free_bytes;
use crate::device_folder::files::replace_unsynced;
use crate::memory;
use crate::status::{Board, State, Status};
use crate::stop::Stop;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between two versions of `status.json` when nothing but figures changed.
const INTERVAL: Duration = Duration::from_secs(1);
/// Work that shows no sign of life for so long is not reported as alive any more.
const STUCK: Duration = Duration::from_secs(45);

/// Writes `status.json` and keeps the service manager informed until `done` is set; the body of a thread.
pub fn publish(board: &Board, device: &Path, life: &Stop, done: &AtomicBool) {
    let notifier = Notifier::from_environment();
    let path = device.join("status.json");
    let (mut written, mut last): (Option<Instant>, Option<State>) = (None, None);
    while !done.load(Ordering::Relaxed) {
        let mut status = board.get();
        if last != Some(status.state) || written.is_none_or(|t| t.elapsed() >= INTERVAL) {
            if last != Some(status.state) {
                notifier.send(&format!("STATUS={}", line(&status)));
            }
            (written, last) = (Some(Instant::now()), Some(status.state));
            status.format = 1;
            status.memory_bytes = memory::resident_bytes();
            status.memory_peak_bytes = memory::peak_bytes();
            status.disk_free_bytes = free_bytes(device).ok();
            // A disk that is full today may have room tomorrow.
            let replaced = serde_json::to_vec_pretty(&status)
                .map_err(std::io::Error::from)
                .and_then(|text| replace_unsynced(&path, &text));
            if let Err(e) = replaced {
                tracing::debug!("{}: {e}", path.display());
            }
            if life.last_sign() < STUCK {
                notifier.send("WATCHDOG=1");
            }
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// One line for people.
#[must_use]
pub fn line(s: &Status) -> String {
    let mut text = format!("{:?}", s.state).to_lowercase();
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
