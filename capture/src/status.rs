//! The state of the box: counters shared by the daemon, the capture and the status file.

use crate::kinect::live::LiveStats;
use recordings::scan::CaptureStats;
use serde::Serialize;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// What the box is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// No Kinect is there.
    #[default]
    Waiting,
    /// A scan can be started.
    Ready,
    /// A scan is being captured.
    Scanning,
    /// The mesh is made, the scan written.
    Finishing,
    /// Light and materials are estimated.
    Estimating,
}

/// The scan in progress.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ScanFigures {
    /// Its name.
    pub name: String,
    /// Seconds on the sensor's clock.
    pub seconds: f64,
    /// Pairs fused a second.
    pub fps: f64,
    /// Pairs fused.
    pub fused_pairs: u64,
    /// Pairs of them while tracking was lost.
    pub lost_pairs: u64,
    /// True while the camera is followed.
    pub tracking: bool,
    /// Surface seen so far, by the voxel blocks in use.
    pub coverage_m2: f64,
    /// Frames kept for keyframes.
    pub kept_frames: u64,
}

/// Drops by cause, of the scan in progress or the last one.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// USB packets that did not come.
    pub missing_packets: u64,
    /// USB packets that the host controller flagged.
    pub flagged_packets: u64,
    /// USB packets that found the ring full.
    pub ring_packets: u64,
    /// Frames with missing packets.
    pub incomplete_frames: u64,
    /// Frames of which nothing of use came.
    pub lost_frames: u64,
    /// Colour frames without a depth frame near in time.
    pub unpaired_color: u64,
    /// Depth frames without a colour frame near in time.
    pub unpaired_depth: u64,
    /// Pairs that gave way because fusion was busy.
    pub dropped_pairs: u64,
    /// Times the streams were started anew.
    pub restarts: u32,
}

/// `status.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Status {
    /// Version of this layout.
    pub format: u32,
    /// State.
    pub state: State,
    /// The Kinect, model and serial number.
    pub sensor: Option<String>,
    /// True if scans start by themselves.
    pub auto: bool,
    /// The scan in progress.
    pub scan: Option<ScanFigures>,
    /// Drops by cause.
    pub drops: Drops,
    /// Exposure time by the sensor's register: a hint.
    pub exposure_us: Option<f64>,
    /// Resident memory of the capture process.
    pub memory_bytes: Option<u64>,
    /// Its peak.
    pub memory_peak_bytes: Option<u64>,
    /// What the memory plan allows it.
    pub memory_plan_bytes: u64,
    /// Free bytes in the device folder.
    pub disk_free_bytes: Option<u64>,
    /// Scans finished since the start.
    pub finished_scans: u64,
    /// Folder of the newest one.
    pub last_scan: Option<String>,
    /// What went wrong last.
    pub last_error: Option<String>,
}

/// The status, shared by everything that knows a part of it.
#[derive(Debug, Default)]
pub struct Board {
    status: Mutex<Status>,
    fused_since: Mutex<Option<Instant>>,
}

impl Board {
    /// A copy.
    #[must_use]
    pub fn get(&self) -> Status {
        self.lock().clone()
    }

    /// Changes it.
    pub fn set(&self, change: impl FnOnce(&mut Status)) {
        change(&mut self.lock());
    }

    /// Enters a state; leaving a scan takes its figures away.
    pub fn enter(&self, state: State) {
        tracing::debug!("state: {state:?}");
        let mut s = self.lock();
        s.state = state;
        if matches!(state, State::Waiting | State::Ready) {
            s.scan = None;
        }
    }

    /// Begins the figures of a scan.
    pub fn begin_scan(&self, name: &str) {
        *self.fused_since.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let mut s = self.lock();
        s.state = State::Scanning;
        s.drops = Drops::default();
        s.scan = Some(ScanFigures { name: name.into(), tracking: true, ..ScanFigures::default() });
    }

    /// Counters of the driver.
    pub fn driver(&self, stats: &LiveStats, exposure_us: Option<f64>) {
        let mut s = self.lock();
        let (d, c) = (stats.streams.depth, stats.streams.color);
        s.exposure_us = exposure_us;
        s.drops.missing_packets = d.missing + c.missing;
        s.drops.flagged_packets = stats.ring.bad_status;
        s.drops.ring_packets = stats.ring.dropped;
        s.drops.incomplete_frames = d.incomplete_frames + c.incomplete_frames;
        s.drops.lost_frames = d.lost_frames + c.lost_frames;
        s.drops.restarts = stats.restarts;
    }

    /// Counters of pairing.
    pub fn pairing(&self, stats: &CaptureStats) {
        let mut s = self.lock();
        s.drops.unpaired_color = stats.unpaired_color;
        s.drops.unpaired_depth = stats.unpaired_depth;
        s.drops.dropped_pairs = stats.dropped_pairs;
        if let Some(scan) = &mut s.scan {
            scan.seconds = stats.duration_s;
        }
    }

    /// One more pair went through fusion.
    pub fn fused(&self, tracked: bool, kept: bool, blocks: u64, block_m: f64) {
        let since = *self.fused_since.lock().unwrap_or_else(PoisonError::into_inner);
        let mut s = self.lock();
        let Some(scan) = &mut s.scan else { return };
        scan.fused_pairs += 1;
        scan.lost_pairs += u64::from(!tracked);
        scan.kept_frames += u64::from(kept);
        scan.tracking = tracked;
        scan.coverage_m2 = blocks as f64 * block_m * block_m;
        scan.fps = since.map_or(0.0, |t| scan.fused_pairs as f64 / t.elapsed().as_secs_f64().max(1e-3));
    }

    /// Remembers what went wrong, and says it.
    pub fn error(&self, problem: &str) {
        tracing::error!("{problem}");
        self.lock().last_error = Some(problem.into());
    }

    fn lock(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
