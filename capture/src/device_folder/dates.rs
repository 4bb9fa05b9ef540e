//! When a scan was made: by the clock on the wall, or, while that is not set, by the clock that counts from the start of the system.

use crate::device_folder::naming::utc;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Stands in a scan's name where others have a time.
pub const UNDATED: &str = "undated";
/// A clock that shows an earlier time is not set: 1 January 2026, before the first version of this program, after the systems that
/// boxes run were built.
const EARLIEST_S: u64 = 1_767_225_600;

/// A moment on the clock that counts from the start of the system, suspension included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Which start.
    pub boot: String,
    /// Seconds since then.
    pub seconds: f64,
}

impl Moment {
    /// Now.
    #[must_use]
    pub fn now() -> Self {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let t = clock_gettime(ClockId::Boottime);
        Self { boot: boot.trim().into(), seconds: t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9 }
    }

    /// The time that it was; `None` if the clock is not set, or the system was started again since.
    #[must_use]
    pub fn time(&self) -> Option<SystemTime> {
        let (wall, now) = (set_clock()?, Self::now());
        let passed = Duration::try_from_secs_f64(now.seconds - self.seconds).ok()?;
        if now.boot == self.boot { wall.checked_sub(passed) } else { None }
    }
}

/// When a scan was made, as its manifest has it.
#[derive(Debug, Serialize)]
pub struct Dates {
    /// When it was begun (UTC); `None` while that is not known.
    pub began: Option<String>,
    /// When it was published.
    pub published: Option<String>,
    /// Both, while the clock is not set.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub undated: Option<[Moment; 2]>,
}

/// The time, if the clock is set.
pub fn set_clock() -> Option<SystemTime> {
    Some(SystemTime::now()).filter(|t| *t >= UNIX_EPOCH + Duration::from_secs(EARLIEST_S))
}

/// What stands before a scan's name: the time (UTC), or [`UNDATED`].
#[must_use]
pub fn stamp() -> String {
    set_clock().map_or_else(|| UNDATED.into(), utc)
}

/// The dates of a scan that is published now. `stamp` is what stands before its name, which changes if its time is known by now.
/// A scan that an interrupted run left, whose beginning is lost, counts from here.
#[must_use]
pub fn dates(stamp: &mut String, began: Option<&Moment>) -> Dates {
    let now = Moment::now();
    let began = began.unwrap_or(&now);
    if stamp == UNDATED {
        let Some(time) = began.time() else {
            return Dates { began: None, published: None, undated: Some([began.clone(), now]) };
        };
        *stamp = utc(time);
    }
    Dates { began: Some(stamp.clone()), published: set_clock().map(utc), undated: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_known_in_the_same_run_of_the_system_only() {
        let now = Moment::now();
        let ago = Moment { seconds: now.seconds - 100.0, ..now.clone() };
        let passed = SystemTime::now().duration_since(ago.time().unwrap()).unwrap().as_secs_f64();
        assert!((passed - 100.0).abs() < 5.0, "{passed}");
        assert_eq!(Moment { boot: "another".into(), ..now.clone() }.time(), None);
        assert_eq!(Moment { seconds: now.seconds + 100.0, ..now }.time(), None, "a moment to come");
    }
}
