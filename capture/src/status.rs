//! The state of the box: counters shared by the daemon, the capture and the status file.

use crate::kinect::live::LiveStats;
use crate::lock::lock;
use recordings::scan::CaptureStats;
use serde::Serialize;
use std::fmt::{Display, Formatter};
use std::sync::Mutex;
use std::time::Instant;

/// What the box does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// No Kinect is plugged in.
    #[default]
    Waiting,
    /// A scan can be started.
    Ready,
    /// A scan is being captured.
    Scanning,
    /// The mesh is extracted and the scan written.
    Finishing,
    /// Light and materials are estimated.
    Estimating,
    /// A watched replay is over.
    Done,
}

impl State {
    /// True while a scan is made.
    #[must_use]
    pub fn is_working(self) -> bool {
        matches!(self, Self::Scanning | Self::Finishing | Self::Estimating)
    }
}

impl Display for State {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Waiting => "waiting",
            Self::Ready => "ready",
            Self::Scanning => "scanning",
            Self::Finishing => "finishing",
            Self::Estimating => "estimating",
            Self::Done => "done",
        })
    }
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
    /// Of these, pairs while tracking was lost.
    pub lost_pairs: u64,
    /// True while the camera is tracked.
    pub tracking: bool,
    /// Surface seen so far, by the voxel blocks in use.
    pub coverage_m2: f64,
    /// Frames kept for keyframes.
    pub kept_frames: u64,
}

/// Losses by cause, of the scan in progress or the last one.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// USB packets that did not arrive.
    pub missing_packets: u64,
    /// USB packets that the host controller flagged as bad.
    pub flagged_packets: u64,
    /// Frames that were turned away because the machine was too slow to decode them.
    pub dropped_frames: u64,
    /// Frames with missing packets.
    pub incomplete_frames: u64,
    /// Frames of which nothing usable arrived.
    pub lost_frames: u64,
    /// Colour frames without a depth frame near in time.
    pub unpaired_color: u64,
    /// Depth frames without a colour frame near in time.
    pub unpaired_depth: u64,
    /// Pairs dropped because fusion was busy.
    pub dropped_pairs: u64,
    /// Times the streams were restarted.
    pub restarts: u32,
}

/// `status.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Status {
    /// Version of this layout.
    pub format: u32,
    /// State.
    pub state: State,
    /// Model and serial number of the Kinect.
    pub sensor: Option<String>,
    /// True if motion starts scans.
    pub auto: bool,
    /// The scan in progress.
    pub scan: Option<ScanFigures>,
    /// Drops by cause.
    pub drops: Drops,
    /// Exposure time according to the sensor's register, in microseconds; not calibrated.
    pub exposure_us: Option<f64>,
    /// Resident memory of the capture process.
    pub memory_bytes: Option<u64>,
    /// Its peak.
    pub memory_peak_bytes: Option<u64>,
    /// Its planned upper bound.
    pub memory_plan_bytes: u64,
    /// Free bytes in the device folder.
    pub disk_free_bytes: Option<u64>,
    /// Scans finished since the start.
    pub finished_scans: u64,
    /// Folder of the newest one.
    pub last_scan: Option<String>,
    /// The last error.
    pub last_error: Option<String>,
}

/// The status, shared by the threads that know parts of it.
#[derive(Debug, Default)]
pub struct Board {
    status: Mutex<Status>,
    fused_since: Mutex<Option<Instant>>,
}

impl Board {
    /// A copy of the status.
    #[must_use]
    pub fn get(&self) -> Status {
        lock(&self.status).clone()
    }

    /// Changes the status.
    pub fn set(&self, change: impl FnOnce(&mut Status)) {
        change(&mut lock(&self.status));
    }

    /// Enters a state; states in which no scan is made clear its figures.
    pub fn enter(&self, state: State) {
        tracing::debug!("state: {state}");
        let mut s = lock(&self.status);
        s.state = state;
        if !state.is_working() {
            s.scan = None;
        }
    }

    /// Enters `Scanning` with fresh figures.
    pub fn begin_scan(&self, name: &str) {
        *lock(&self.fused_since) = Some(Instant::now());
        let mut s = lock(&self.status);
        s.state = State::Scanning;
        s.drops = Drops::default();
        s.scan = Some(ScanFigures { name: name.into(), tracking: true, ..ScanFigures::default() });
    }

    /// Takes the counters of the driver.
    pub fn driver(&self, stats: &LiveStats, exposure_us: Option<f64>) {
        let mut s = lock(&self.status);
        let (d, c) = (stats.streams.depth, stats.streams.color);
        s.exposure_us = exposure_us;
        s.drops.missing_packets = d.missing + c.missing;
        s.drops.flagged_packets = stats.queue.flagged;
        s.drops.dropped_frames = d.dropped_frames + c.dropped_frames;
        s.drops.incomplete_frames = d.incomplete_frames + c.incomplete_frames;
        s.drops.lost_frames = d.lost_frames + c.lost_frames;
        s.drops.restarts = stats.restarts;
    }

    /// Takes the counters of pairing.
    pub fn pairing(&self, stats: &CaptureStats) {
        let mut s = lock(&self.status);
        s.drops.unpaired_color = stats.unpaired_color;
        s.drops.unpaired_depth = stats.unpaired_depth;
        s.drops.dropped_pairs = stats.dropped_pairs;
        if let Some(scan) = &mut s.scan {
            scan.seconds = stats.duration_s;
        }
    }

    /// Counts a pair that fusion has taken.
    pub fn fused(&self, tracked: bool, kept: bool, blocks: u64, block_m: f64) {
        let since = *lock(&self.fused_since);
        let mut s = lock(&self.status);
        let Some(scan) = &mut s.scan else { return };
        scan.fused_pairs += 1;
        scan.lost_pairs += u64::from(!tracked);
        scan.kept_frames += u64::from(kept);
        scan.tracking = tracked;
        scan.coverage_m2 = blocks as f64 * block_m * block_m;
        scan.fps = since.map_or(0.0, |t| scan.fused_pairs as f64 / t.elapsed().as_secs_f64().max(1e-3));
    }

    /// Stores and logs an error.
    pub fn error(&self, problem: &str) {
        tracing::error!("{problem}");
        lock(&self.status).last_error = Some(problem.into());
    }
}
