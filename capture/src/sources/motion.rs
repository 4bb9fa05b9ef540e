//! Detects motion of the sensor from its images, to start and end scans without a keyboard.

use firmware_config::DaemonConfig;
use recordings::types::{ColorFrame, DepthFrame, TimestampNs};

/// Blocks across and down.
const GRID: (usize, usize) = (32, 24);

/// Compares block means of frames. A change of the overall brightness is not motion.
#[derive(Debug, Default)]
pub struct Motion {
    color: BlockImage,
    depth: BlockImage,
    /// Threshold on the mean relative change.
    threshold: f64,
    /// Minimum time between two frames that are compared.
    step_ns: i64,
    moved_at: Option<TimestampNs>,
    first: Option<TimestampNs>,
    newest: Option<TimestampNs>,
}

#[derive(Debug, Default)]
struct BlockImage {
    at: Option<TimestampNs>,
    blocks: Vec<f64>,
}

impl Motion {
    /// Motion is a mean relative change of more than `daemon.motion` within `supervision.motion_step_s`.
    #[must_use]
    pub fn new(config: &DaemonConfig) -> Self {
        let step_ns = (config.tuning.supervision.motion_step_s * 1e9) as i64;
        Self { threshold: config.motion, step_ns, ..Self::default() }
    }

    /// Takes a colour frame; returns its mean relative change since the last one compared, if enough time has passed.
    pub fn add_color(&mut self, frame: &ColorFrame) -> Option<f64> {
        let (width, height) = (frame.width as usize, frame.height as usize);
        // Lost packets would look like motion.
        if frame.missing_packets > 0
            || frame.bytes.len() != width * height
            || !due(&self.color, frame.timestamp_ns, self.step_ns)
        {
            return None;
        }
        let blocks = block_means(width, height, |i| f64::from(frame.bytes[i]));
        let change = change(&mut self.color, normalised(blocks), frame.timestamp_ns);
        self.judge(change, frame.timestamp_ns);
        change
    }

    /// The same for depth, over pixels with values in both frames.
    pub fn add_depth(&mut self, frame: &DepthFrame) -> Option<f64> {
        let (width, height) = (frame.width as usize, frame.height as usize);
        if frame.missing_packets > 0
            || frame.depth.len() != width * height
            || !due(&self.depth, frame.timestamp_ns, self.step_ns)
        {
            return None;
        }
        let blocks = block_means(width, height, |i| f64::from(frame.depth[i]));
        let change = change(&mut self.depth, blocks, frame.timestamp_ns);
        self.judge(change, frame.timestamp_ns);
        change
    }

    /// Seconds without motion before the newest frame.
    #[must_use]
    pub fn still_s(&self) -> f64 {
        let since = self.moved_at.or(self.first);
        since.zip(self.newest).map_or(0.0, |(since, newest)| newest.saturating_sub(since) as f64 * 1e-9)
    }

    /// True if the last comparison showed motion.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.moved_at.is_some() && self.moved_at == self.newest
    }

    fn judge(&mut self, change: Option<f64>, at: TimestampNs) {
        self.first.get_or_insert(at);
        if let Some(change) = change {
            self.newest = Some(self.newest.map_or(at, |n| n.max(at)));
            if change > self.threshold {
                self.moved_at = Some(self.moved_at.map_or(at, |m| m.max(at)));
            }
        }
    }
}

fn due(image: &BlockImage, at: TimestampNs, step_ns: i64) -> bool {
    // The clock of a new session may be behind.
    image.at.is_none_or(|t| at < t || at - t >= step_ns)
}

fn block_means(width: usize, height: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
    let (w, h) = (width / GRID.0, height / GRID.1);
    let mut blocks = Vec::with_capacity(GRID.0 * GRID.1);
    for block in 0..GRID.0 * GRID.1 {
        let (x0, y0) = (block % GRID.0 * w, block / GRID.0 * h);
        let (mut sum, mut count) = (0.0, 0u32);
        for y in y0..y0 + h {
            for x in x0..x0 + w {
                let v = value(y * width + x);
                sum += v;
                count += u32::from(v > 0.0);
            }
        }
        blocks.push(if count as usize * 2 > w * h { sum / f64::from(count) } else { 0.0 });
    }
    blocks
}

fn normalised(mut blocks: Vec<f64>) -> Vec<f64> {
    let mean = blocks.iter().sum::<f64>() / blocks.len().max(1) as f64;
    if mean > 0.0 {
        blocks.iter_mut().for_each(|b| *b /= mean);
    }
    blocks
}

/// Mean of |a − b| divided by the mean of (a + b) / 2, over blocks with values in both.
fn change(image: &mut BlockImage, blocks: Vec<f64>, at: TimestampNs) -> Option<f64> {
    let before = std::mem::replace(image, BlockImage { at: Some(at), blocks });
    let both = before.blocks.iter().zip(&image.blocks).filter(|(a, b)| **a > 0.0 && **b > 0.0);
    let (moved, level) = both.fold((0.0, 0.0), |(m, l), (a, b)| (m + (a - b).abs(), l + (a + b) / 2.0));
    (level > 0.0).then(|| moved / level)
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::types::ColorEncoding;

    /// A texture shifted by `shift` pixels, with noise and a gain.
    fn picture(shift: usize, gain: f64, frame: i64) -> ColorFrame {
        let noise = |i: usize| ((i as u64 ^ (frame as u64) << 32).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 61) as f64;
        let bytes = (0..640 * 480usize)
            .map(|i| {
                let (x, y) = ((i % 640 + shift) as f64, (i / 640) as f64);
                let texture = 110.0 + 40.0 * libm::sin(x / 13.0) + 30.0 * libm::sin(y / 17.0 + x / 40.0);
                (gain * texture + noise(i)) as u8
            })
            .collect();
        ColorFrame {
            timestamp_ns: frame * 33_333_333,
            width: 640,
            height: 480,
            encoding: ColorEncoding::BayerGrbg,
            bytes,
            missing_packets: 0,
        }
    }

    #[test]
    fn noise_and_flicker_are_still_and_a_slow_wave_moves() {
        let mut motion = Motion::new(&DaemonConfig::default());
        for frame in 0..90 {
            motion.add_color(&picture(0, if frame % 3 == 0 { 1.0 } else { 0.9 }, frame));
        }
        assert!(!motion.is_moving() && motion.still_s() > 2.5, "{} s", motion.still_s());
        for frame in 90..120 {
            motion.add_color(&picture((frame - 90) as usize, 1.0, frame));
        }
        assert!(motion.is_moving() && motion.still_s() == 0.0);
    }

    #[test]
    #[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
    fn a_real_camera_that_is_waved_moves_and_one_that_stands_does_not() {
        let shared = ::tests::shared();
        let folder = shared.join("data/tum_fr1_xyz_400");
        let reader = recordings::import::tum::TumReader::open(&folder).unwrap();
        let mut motion = Motion::new(&DaemonConfig::default());
        let (mut compared, mut moving) = (0, 0);
        for event in (0..400).map_while(|i| reader.event(i).unwrap()) {
            let change = match event {
                recordings::recording::Event::Depth(d) => motion.add_depth(&d),
                recordings::recording::Event::Color(c) => {
                    let rgb = c.decode().unwrap();
                    let bytes = rgb.data.chunks_exact(3).map(|p| p[1]).collect();
                    motion.add_color(&ColorFrame { bytes, ..c })
                }
                _ => None,
            };
            if change.is_some() {
                compared += 1;
                moving += u32::from(motion.is_moving());
            }
        }
        assert!(compared > 40 && moving * 10 > compared * 8, "{moving} of {compared}");
    }
}
