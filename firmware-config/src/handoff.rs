//! Settings of the hand-off of finished scans to another machine.

use crate::settings::section;

section! {
    /// Where finished scans go, and how (`lumiscan handoff`).
    HandoffConfig = "handoff" {
        /// Folder that finished scans are copied to and results come back from, as rsync names it: user@host:folder. Empty: nowhere.
        destination: String = String::new(), [4096], "", "";
        /// Remote shell of rsync. It must not ask questions.
        ssh: String = "ssh -o BatchMode=yes -o ConnectTimeout=20 -o ServerAliveInterval=15".into(), [4096], "", "";
        /// Time without data after which a transfer is given up.
        timeout_s: u32 = 60, [1..=86400], "s", "";
        /// Largest rate of transfers. 0 = no limit.
        max_rate_kb: u32 = 0, [0..=10000000], "kB/s", "";
    }
}

impl HandoffConfig {
    /// True if scans are handed off.
    #[must_use]
    pub fn is_on(&self) -> bool {
        !self.destination.is_empty()
    }
}
