//! Where the pipeline leaves what clients may see. It never waits for them, and fusion never depends on them.

use crate::lock::lock;
use crate::serve::light::so_far::LightSoFar;
use crate::serve::live::advice::{Observed, advice, least};
use crate::serve::live::pictures::{Picture, Pictures};
use crate::serve::live::surface::{Blocks, Surface};
use firmware_config::ServeConfig;
use fusion::{FrameReport, Fusion, Margin, SurfaceReader, Tracking};
use glam::DVec3;
use recordings::types::{CameraModel, Pose, RgbdFrame, Sensor, TimestampNs};
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A client that asked for a picture or the surface counts as watching for so long.
const WATCHING: Duration = Duration::from_secs(3);
/// Largest growth of the shown margin per frame, so that a short dip is seen.
const RECOVERY: f32 = 0.08;
/// Positions of kept frames that are shown.
const SHOWN_KEYFRAMES: usize = 512;

/// A camera path and state, as clients see it.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Live {
    /// `tracked`, `lost`, or `none` before the first frame.
    pub tracking: &'static str,
    /// How far tracking is from being lost, 0 to 1; falls before it is lost.
    pub margin: f32,
    /// Its parts.
    pub parts: Option<Parts>,
    /// What the user should do.
    pub advice: Option<&'static str>,
    /// `world_from_camera`, rows; the last one known.
    pub pose: Option<[[f64; 4]; 4]>,
    /// Number of the picture to go back to (`/api/kept/N.jpg`), when lost.
    pub way_back: Option<u64>,
    /// The colour camera.
    pub camera: Option<CameraModel>,
    /// Edge length of a voxel, metres.
    pub voxel_size_m: f64,
    /// Voxel blocks in use and in the pool.
    pub blocks: [u64; 2],
    /// True while the scan is paused.
    pub paused: bool,
    /// Times that tracking was lost.
    pub losses: u64,
    /// Weight from which surface counts as seen well, in frames from 1 m.
    pub good_weight: f64,
    /// Number of the newest estimate of the light (`/api/light`); 0 before the first.
    pub light: u64,
}

/// Parts of the margin, 0 to 1.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Parts {
    /// Agreement of the depth with the model.
    pub fit: f32,
    /// Correlation of the image with its references.
    pub likeness: f32,
    /// Distance to the largest step between two frames.
    pub motion: f32,
    /// Shape or texture that fixes the pose.
    pub structure: f32,
    /// Share of the image with depth.
    pub depth: f32,
}

impl From<Margin> for Parts {
    fn from(m: Margin) -> Self {
        Self { fit: m.fit, likeness: m.likeness, motion: m.motion, structure: m.structure, depth: m.depth }
    }
}

#[derive(Default)]
struct State {
    live: Live,
    keyframes: Vec<[f32; 3]>,
    reader: SurfaceReader,
    number: u64,
    first: Option<TimestampNs>,
    last: Option<(TimestampNs, Pose)>,
    pictured: Option<Instant>,
    /// The sensor, while a scan is in progress.
    sensor: Option<Sensor>,
    light: Option<LightSoFar>,
    /// Counts scans.
    scan: u64,
}

/// What has been seen so far.
pub struct Seen {
    /// Counts scans.
    pub scan: u64,
    /// Time of the scan, seconds.
    pub seconds: f64,
    /// The sensor.
    pub sensor: Sensor,
    /// The surface.
    pub blocks: Blocks,
    /// Edge length of a voxel, metres.
    pub voxel_m: f32,
    /// Pictures of kept frames.
    pub pictures: Vec<Arc<Picture>>,
}

/// What clients see of the scan in progress.
pub struct Hub {
    config: ServeConfig,
    /// Pictures.
    pub pictures: Pictures,
    surface: Mutex<Surface>,
    state: Mutex<State>,
    began: Instant,
    /// Milliseconds after `began` until which someone watches.
    watched_until: AtomicU64,
}

impl Hub {
    /// Nothing to see yet.
    #[must_use]
    pub fn new(config: &ServeConfig) -> Self {
        Self {
            config: config.clone(),
            pictures: Pictures::start(config.picture_width as usize, config.picture_quality as u8),
            surface: Mutex::default(),
            state: Mutex::default(),
            began: Instant::now(),
            watched_until: AtomicU64::new(0),
        }
    }

    /// Notes that a client watches.
    pub fn watch(&self) {
        let until = (self.began.elapsed() + WATCHING).as_millis() as u64;
        self.watched_until.fetch_max(until, Ordering::Relaxed);
    }

    /// True if a client watches, or did a moment ago.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        (self.began.elapsed().as_millis() as u64) < self.watched_until.load(Ordering::Relaxed)
    }

    /// A scan begins.
    pub fn begin(&self, sensor: &Sensor, pool_blocks: u32) {
        self.pictures.clear();
        lock(&self.surface).clear();
        let mut state = lock(&self.state);
        let live = Live {
            tracking: "none",
            camera: Some(sensor.color),
            blocks: [0, u64::from(pool_blocks)],
            good_weight: self.config.good_weight,
            ..Live::default()
        };
        // Pictures are numbered on, so that a client that waits for the next one gets it.
        let (number, scan, sensor) = (state.number, state.scan + 1, Some(sensor.clone()));
        *state = State { live, number, scan, sensor, ..State::default() };
    }

    /// The last frame was fused.
    pub fn end(&self) {
        lock(&self.state).sensor = None;
    }

    /// True from the first frame to the last.
    #[must_use]
    pub fn is_scanning(&self) -> bool {
        lock(&self.state).sensor.is_some()
    }

    /// What has been seen so far, with at most so many pictures; `None` between scans.
    #[must_use]
    pub fn seen(&self, pictures: usize) -> Option<Seen> {
        let (scan, sensor, seconds) = {
            let state = lock(&self.state);
            let seconds = state.last.as_ref().zip(state.first).map_or(0.0, |((t, _), first)| (t - first) as f64 * 1e-9);
            (state.scan, state.sensor.clone()?, seconds)
        };
        let (blocks, voxel_m) = lock(&self.surface).blocks();
        Some(Seen { scan, seconds, sensor, blocks, voxel_m, pictures: self.pictures.spread(pictures) })
    }

    /// Shows the light that was found in the scan of this count; `new` gets the number of the estimate.
    pub fn set_light(&self, new: impl FnOnce(u64) -> LightSoFar, scan: u64) {
        let mut state = lock(&self.state);
        if state.scan == scan {
            state.live.light += 1;
            state.light = Some(new(state.live.light));
        }
    }

    /// The light found so far.
    #[must_use]
    pub fn light(&self) -> Option<LightSoFar> {
        lock(&self.state).light.clone()
    }

    /// A frame was fused.
    pub fn observe(&self, fusion: &Fusion, frame: &RgbdFrame, report: &FrameReport, paused: bool) {
        let stamp = frame.color.timestamp_ns;
        let mut state = lock(&self.state);
        state.number += 1;
        let seconds = stamp.saturating_sub(*state.first.get_or_insert(stamp)) as f64 * 1e-9;
        let way_back = self.note(&mut state, stamp, report, paused);
        state.live.way_back = way_back;
        let kept = report.keep.is_some();
        let due = state.pictured.is_none_or(|t| t.elapsed().as_secs_f64() >= 0.9 / f64::from(self.config.picture_hz));
        let watched = self.is_watched();
        if kept || (watched && due) {
            state.pictured = Some(Instant::now());
            let number = state.number;
            self.pictures.offer(number, seconds, report.world_from_camera, &frame.rgb, kept);
        }
        // While clients read it, a frame passes by: the next one brings what this one changed.
        if let (true, Ok(mut surface)) = (watched, self.surface.try_lock()) {
            if surface.is_full() {
                surface.clear();
                state.reader = SurfaceReader::default();
            }
            let mut blocks = Vec::new();
            fusion.read_surface(&mut state.reader, self.config.surface_blocks as usize, &mut blocks);
            surface.update(state.reader.voxel_m(), blocks);
        }
    }

    /// Updates the figures; returns the number of the picture to go back to, if tracking is lost.
    fn note(&self, state: &mut State, stamp: TimestampNs, report: &FrameReport, paused: bool) -> Option<u64> {
        let tracked = report.tracking == Tracking::Tracked;
        let (speed_m_s, turn_rad_s) = match (&state.last, &report.world_from_camera) {
            (Some((then, before)), Some(now)) => {
                let dt = (stamp.saturating_sub(*then) as f64 * 1e-9).max(1e-3);
                let turn = before.rotation.angle_between(now.rotation);
                ((now.translation - before.translation).length() / dt, turn / dt)
            }
            _ => (0.0, 0.0),
        };
        let observed =
            Observed { margin: report.margin, tracked, speed_m_s, turn_rad_s, median_depth_m: report.median_depth_m };
        let live = &mut state.live;
        live.losses += u64::from(!tracked && live.tracking == "tracked");
        live.tracking = if tracked { "tracked" } else { "lost" };
        // A frame that was not tracked from the last one says little.
        let now = if tracked { report.margin.map_or(0.5, |m| least(&m)) } else { 0.0 };
        live.margin = now.min(live.margin + RECOVERY);
        live.parts = report.margin.map(Parts::from);
        live.advice = advice(&observed);
        live.voxel_size_m = report.voxel_size_m;
        live.blocks[0] = report.blocks_used;
        live.paused = paused;
        if let Some(pose) = report.world_from_camera {
            live.pose = Some(pose.to_rows());
            state.last = Some((stamp, pose));
            if report.keep.is_some() && state.keyframes.len() < SHOWN_KEYFRAMES {
                state.keyframes.push(position(pose.translation));
            }
            return None;
        }
        let last = state.last.as_ref()?;
        self.pictures.nearest(&last.1).map(|p| p.number)
    }

    /// The figures.
    #[must_use]
    pub fn live(&self) -> Live {
        lock(&self.state).live.clone()
    }

    /// Positions of the kept frames, world, metres.
    #[must_use]
    pub fn keyframes(&self) -> Vec<[f32; 3]> {
        lock(&self.state).keyframes.clone()
    }

    /// What of the surface changed, see [`Surface::since`].
    #[must_use]
    pub fn surface_since(&self, generation: u32, since: u64) -> Vec<u8> {
        self.watch();
        lock(&self.surface).since(generation, since)
    }

    /// The newest picture with a number above `after`.
    #[must_use]
    pub fn newer_picture(&self, after: u64, wait: Duration) -> Option<Arc<Picture>> {
        self.watch();
        self.pictures.newer(after, wait)
    }
}

fn position(p: DVec3) -> [f32; 3] {
    p.as_vec3().to_array()
}
