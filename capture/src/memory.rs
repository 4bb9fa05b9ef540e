//! Memory and processor time of this process: measured, planned and limited.

use crate::failure::{Failure, MEMORY_RAN_OUT};
use firmware_config::{Config, memory_plan};
use std::sync::atomic::Ordering;

/// Memory is scarce where less than this fraction of the limit is left.
const SCARCE: usize = 4;

/// Peak resident memory of this process in bytes; `None` where the system does not report it.
#[must_use]
pub fn peak_bytes() -> Option<u64> {
    field("VmHWM:")
}

/// Resident memory of this process in bytes.
#[must_use]
pub fn resident_bytes() -> Option<u64> {
    field("VmRSS:")
}

/// Processes that the system has killed for want of memory since it started; `None` where it does not report it.
#[must_use]
pub fn out_of_memory_kills() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/vmstat").ok()?;
    text.lines().find_map(|l| l.strip_prefix("oom_kill "))?.trim().parse().ok()
}

/// Processor time of this process so far, in seconds.
#[must_use]
pub fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Blocks from this size on go back to the system as soon as they are freed: about a picture, where what scans need begins.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const RETURNED_BYTES: i32 = 1 << 20;

/// Has large blocks returned to the system when they are freed. Without it, the C library takes the largest block that was ever freed for a
/// size that comes again, keeps all that is smaller, apart for every few threads, and a process grows for a dozen scans.
pub fn return_large_blocks() {
    // SAFETY: `mallopt` only sets a parameter of the allocator.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(unsafe_code)]
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, RETURNED_BYTES);
    }
}

/// Gives free memory back to the system: what the threads of a scan leave behind is kept for threads to come. The estimator has
/// what this process does not.
pub fn give_back() {
    // SAFETY: `malloc_trim` locks what it looks at, and touches no memory that is in use.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(unsafe_code)]
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Makes this process the first victim of the out-of-memory killer, and limits its data to `mb`: the last resort, where the plan of the
/// estimator was wrong.
///
/// # Errors
/// The system refuses the limit.
pub fn limit(mb: Option<u32>) -> Result<(), Failure> {
    // A process may always raise its own score on Linux; other systems have none.
    let _ = std::fs::write("/proc/self/oom_score_adj", "800");
    let Some(mb) = mb else { return Ok(()) };
    let bytes = Some(u64::from(mb) * 1_000_000);
    tell_panics_for_memory(mb as usize * 1_000_000 / SCARCE);
    let old = rustix::process::getrlimit(rustix::process::Resource::Data);
    let new = rustix::process::Rlimit { current: bytes, maximum: old.maximum };
    rustix::process::setrlimit(rustix::process::Resource::Data, new)
        .map_err(|e| Failure::Usage(format!("--memory {mb}: {e}; the system has set a lower limit")))
}

/// Notes panics that begin where less than `scarce` bytes can be had.
fn tell_panics_for_memory(scarce: usize) {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if Vec::<u8>::new().try_reserve_exact(scarce).is_err() {
            MEMORY_RAN_OUT.store(true, Ordering::Relaxed);
        }
        tell(panic);
    }));
}

/// Upper bound of the capture process's memory with these settings, in bytes.
///
/// # Errors
/// The plan exceeds `daemon.memory_limit_mb`.
pub fn planned(config: &Config) -> Result<u64, Failure> {
    let total = memory_plan(config).iter().map(|p| p.bytes).sum();
    let limit = u64::from(config.daemon.memory_limit_mb) * 1_000_000;
    if total <= limit {
        return Ok(total);
    }
    Err(Failure::Usage(format!(
        "the memory plan comes to {} MB, daemon.memory_limit_mb allows {}; lower fusion.pool_blocks, or raise the limit \
         (`lumiscan check` shows the plan)",
        total / 1_000_000,
        config.daemon.memory_limit_mb
    )))
}

/// Memory of the machine in bytes.
#[must_use]
pub fn machine_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let kib: u64 =
        text.lines().find_map(|l| l.strip_prefix("MemTotal:"))?.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

fn field(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn peak_follows_what_was_touched() {
        let before = super::peak_bytes().unwrap();
        let touched = std::hint::black_box(vec![1u8; 64 << 20]);
        assert!(super::peak_bytes().unwrap() >= before.max(touched.len() as u64));
    }
}
