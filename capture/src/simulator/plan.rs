//! The plan of a simulated Kinect (`--simulate`): its pictures and its faults.

use firmware_config::kinect_models::Model;
use std::path::PathBuf;
use std::time::Duration;

/// Pictures of a simulated Kinect.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Scenery {
    /// Tilted planes that differ from frame to frame.
    #[default]
    Pattern,
    /// A recording of frames.
    Recording(PathBuf),
}

/// Behaviour of a simulated Kinect. Probabilities are per packet; all faults follow from the seed.
#[derive(Debug, Clone, PartialEq)]
pub struct SimPlan {
    /// Its pictures.
    pub scenery: Scenery,
    /// Model.
    pub model: Model,
    /// Seed of every fault.
    pub seed: u64,
    /// Runs on a simulated clock, as fast as it is read, instead of in real time.
    pub fast: bool,
    /// With `fast`: pairs are dropped when fusion is busy, as in real time (key `hasty`).
    pub drop_when_slow: bool,
    /// Frames of each stream before it falls silent; 0 = unlimited.
    pub frames: u64,
    /// Frames that repeat the first picture of a recording.
    pub hold: u64,
    /// First time stamp of its 60 MHz clock.
    pub clock_start: u32,
    /// A packet is lost.
    pub loss: f64,
    /// A burst of lost packets starts.
    pub burst: f64,
    /// Packets per burst.
    pub burst_packets: u32,
    /// A packet is swapped with the next.
    pub reorder: f64,
    /// A packet is truncated.
    pub truncate: f64,
    /// A packet's header is overwritten.
    pub garbage: f64,
    /// The host controller flags a packet.
    pub bad_status: f64,
    /// Frames between two silences of both streams; 0 = none.
    pub stall_every: u64,
    /// Length of a silence in frames.
    pub stall_frames: u64,
    /// "Not ready" replies before each reply, alternately of 0 and 512 bytes.
    pub not_ready: u32,
    /// Replies of an earlier session that are still queued.
    pub stale: u32,
    /// Never answers a command.
    pub dead: bool,
    /// Always answers "not ready".
    pub never_ready: bool,
    /// Replies with a wrong magic.
    pub bad_magic: bool,
    /// No colour packets.
    pub no_color: bool,
    /// No depth packets.
    pub no_depth: bool,
    /// Has no LED and no accelerometer.
    pub no_motor: bool,
    /// Control transfer of a session at which the device is unplugged.
    pub unplug_at_control: Option<u32>,
    /// Frame of a session at which the device is unplugged.
    pub unplug_at_frame: Option<u64>,
    /// Number of times it is unplugged.
    pub unplugs: u32,
    /// Time after which it is plugged in again; `None` = never.
    pub replug_ms: Option<u64>,
    /// Sessions with faults, from the first; 0 = all (key `sick_sessions`).
    pub faulty_sessions: u32,
}

impl Default for SimPlan {
    fn default() -> Self {
        Self {
            scenery: Scenery::Pattern,
            model: Model::K1414,
            seed: 1,
            fast: false,
            drop_when_slow: false,
            frames: 0,
            hold: 0,
            clock_start: 0xfff0_0000,
            loss: 0.0,
            burst: 0.0,
            burst_packets: 20,
            reorder: 0.0,
            truncate: 0.0,
            garbage: 0.0,
            bad_status: 0.0,
            stall_every: 0,
            stall_frames: 30,
            not_ready: 0,
            stale: 0,
            dead: false,
            never_ready: false,
            bad_magic: false,
            no_color: false,
            no_depth: false,
            no_motor: false,
            unplug_at_control: None,
            unplug_at_frame: None,
            unplugs: 1,
            replug_ms: None,
            faulty_sessions: 0,
        }
    }
}

impl SimPlan {
    /// Reads `pattern` or the path of a recording, followed by any number of `,key=value` or `,flag`.
    ///
    /// # Errors
    /// The invalid part.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parts = text.split(',');
        let mut plan = Self::default();
        match parts.next().unwrap_or("") {
            "pattern" => {}
            "" => return Err("give `pattern` or a recording".into()),
            path => plan.scenery = Scenery::Recording(path.into()),
        }
        for part in parts {
            plan.set(part).ok_or_else(|| format!("`{part}` is not a valid fault (capture/README.md lists them)"))?;
        }
        Ok(plan)
    }

    fn set(&mut self, part: &str) -> Option<()> {
        let (key, value) = part.split_once('=').unwrap_or((part, "true"));
        let share = || value.parse::<f64>().ok().filter(|x| (0.0..=1.0).contains(x));
        match key {
            "model" => {
                self.model = match value {
                    "1414" => Model::K1414,
                    "1473" => Model::K1473,
                    "1517" => Model::K1517,
                    _ => return None,
                }
            }
            "seed" => self.seed = value.parse().ok()?,
            "fast" => self.fast = value.parse().ok()?,
            "hasty" => self.drop_when_slow = value.parse().ok()?,
            "frames" => self.frames = value.parse().ok()?,
            "hold" => self.hold = value.parse().ok()?,
            "clock_start" => self.clock_start = value.parse().ok()?,
            "loss" => self.loss = share()?,
            "burst" => self.burst = share()?,
            "burst_packets" => self.burst_packets = value.parse().ok()?,
            "reorder" => self.reorder = share()?,
            "truncate" => self.truncate = share()?,
            "garbage" => self.garbage = share()?,
            "bad_status" => self.bad_status = share()?,
            "stall_every" => self.stall_every = value.parse().ok()?,
            "stall_frames" => self.stall_frames = value.parse().ok()?,
            "not_ready" => self.not_ready = value.parse().ok()?,
            "stale" => self.stale = value.parse().ok()?,
            "dead" => self.dead = value.parse().ok()?,
            "never_ready" => self.never_ready = value.parse().ok()?,
            "bad_magic" => self.bad_magic = value.parse().ok()?,
            "no_color" => self.no_color = value.parse().ok()?,
            "no_depth" => self.no_depth = value.parse().ok()?,
            "no_motor" => self.no_motor = value.parse().ok()?,
            "unplug_at_control" => self.unplug_at_control = Some(value.parse().ok()?),
            "unplug_at_frame" => self.unplug_at_frame = Some(value.parse().ok()?),
            "unplugs" => self.unplugs = value.parse().ok()?,
            "replug_ms" => self.replug_ms = Some(value.parse().ok()?),
            "sick_sessions" => self.faulty_sessions = value.parse().ok()?,
            _ => return None,
        }
        Some(())
    }

    /// The plan of session number `session`, counted from 1.
    #[must_use]
    pub fn of_session(&self, session: u32) -> Self {
        if self.faulty_sessions == 0 || session <= self.faulty_sessions {
            return self.clone();
        }
        Self {
            scenery: self.scenery.clone(),
            model: self.model,
            seed: self.seed,
            fast: self.fast,
            drop_when_slow: self.drop_when_slow,
            frames: self.frames,
            hold: self.hold,
            clock_start: self.clock_start,
            ..Self::default()
        }
    }

    /// [`SimPlan::replug_ms`] as a duration.
    #[must_use]
    pub fn replug_after(&self) -> Option<Duration> {
        self.replug_ms.map(Duration::from_millis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_parsed_and_errors_named() {
        let plan = SimPlan::parse("pattern,fast,seed=7,loss=0.01,unplug_at_frame=30,model=1517").unwrap();
        assert_eq!(
            (plan.fast, plan.seed, plan.loss, plan.unplug_at_frame, plan.model),
            (true, 7, 0.01, Some(30), Model::K1517)
        );
        assert_eq!(SimPlan::parse("a/b.lrec").unwrap().scenery, Scenery::Recording("a/b.lrec".into()));
        for bad in ["", "pattern,loss=2", "pattern,lost=0.1", "pattern,seed", "pattern,"] {
            assert!(SimPlan::parse(bad).is_err(), "{bad}");
        }
    }
}
