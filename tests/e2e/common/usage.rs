//! What a process uses, as `/proc` shows it.

/// Resident memory, open descriptors and threads of a process.
#[derive(Debug, Clone, Copy, Default)]
pub struct Usage {
    pub resident_kib: u64,
    pub descriptors: u64,
    pub threads: u64,
}

impl Usage {
    /// Of the process `pid`; `None` where it is gone.
    pub fn of(pid: u32) -> Option<Self> {
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
        let field = |name: &str| -> Option<u64> {
            status.lines().find_map(|l| l.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
        };
        let descriptors = std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count() as u64;
        Some(Self { resident_kib: field("VmRSS:")?, descriptors, threads: field("Threads:")? })
    }

    /// The higher of each figure.
    pub fn highest(self, other: Self) -> Self {
        self.each(other, u64::max)
    }

    /// The lower of each figure.
    pub fn lowest(self, other: Self) -> Self {
        self.each(other, u64::min)
    }

    fn each(self, other: Self, choose: fn(u64, u64) -> u64) -> Self {
        Self {
            resident_kib: choose(self.resident_kib, other.resident_kib),
            descriptors: choose(self.descriptors, other.descriptors),
            threads: choose(self.threads, other.threads),
        }
    }
}

/// Slope of the least-squares line through points `(x, y)`.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let mean = points.iter().fold((0.0, 0.0), |m, p| (m.0 + p.0 / n, m.1 + p.1 / n));
    let (mut xy, mut xx) = (0.0, 0.0);
    for (x, y) in points {
        xy += (x - mean.0) * (y - mean.1);
        xx += (x - mean.0) * (x - mean.0);
    }
    xy / xx
}

/// Processes with `text` in their command lines.
pub fn processes_with(text: &str) -> Vec<u32> {
    let pids = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = pids.filter_map(|e| e.file_name().to_str()?.parse().ok());
    pids.filter(|pid| command_line(*pid).is_some_and(|line| line.contains(text))).collect()
}

/// The command line of a process, its arguments separated by spaces.
pub fn command_line(pid: u32) -> Option<String> {
    let bytes = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    Some(String::from_utf8_lossy(&bytes).replace('\0', " "))
}
