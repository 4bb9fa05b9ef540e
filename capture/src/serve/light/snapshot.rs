//! A small scan of what has been seen so far: a coarse mesh and a few reduced pictures.

use crate::serve::live::pictures::Picture;
use firmware_config::{Config, Quality, Switch, TransferChoice};
use recordings::scan::{CaptureStats, Scan, ScanSource};
use recordings::types::{CameraModel, ColorEncoding, ColorFrame, Keyframe, Mesh, Sensor};
use std::sync::Arc;

/// SH bands and rays per vertex of the estimate.
const BANDS: u32 = 5;
const RAYS: u32 = 32;
const ROUNDS: u32 = 2;
/// Vertices that are asked for, of those that there may be: ragged meshes get up to a quarter more.
const ASKED: f64 = 0.75;
/// The estimator takes no smaller limit.
const FEWEST: u32 = 1000;

/// The scan of a mesh and the pictures of kept frames.
#[must_use]
pub fn scan_of(sensor: &Sensor, config: &Config, mesh: Mesh, pictures: &[Arc<Picture>]) -> Scan {
    let keyframes = pictures.iter().filter_map(|p| keyframe(sensor, p)).collect();
    Scan {
        name: "light so far".into(),
        source: ScanSource::Fusion,
        sensor: sensor.clone(),
        mesh,
        keyframes,
        witnesses: Vec::new(),
        config: coarse(config).to_toml(),
        stats: CaptureStats::default(),
    }
}

/// The settings with everything that costs time reduced.
fn coarse(config: &Config) -> Config {
    let mut config = config.clone();
    let most = ((ASKED * f64::from(config.serve.light_vertices)) as u32).max(FEWEST);
    let e = &mut config.estimator;
    (e.bands, e.rays, e.association_rounds, e.max_vertices) = (BANDS, RAYS, ROUNDS, most);
    (e.transfer, e.quality) = (TransferChoice::Shade, Quality::Draft);
    (e.refine_poses, e.specular) = (Switch::Off, Switch::Off);
    // So little is seen that the regularisation with the least held-out error is the one to take, by however little.
    e.tuning.factorisation.regularisation_min_gain = 0.0;
    e.tuning.factorisation.near_light = false;
    e.tuning.factorisation.veil = false;
    config
}

fn keyframe(sensor: &Sensor, picture: &Picture) -> Option<Keyframe> {
    let (width, height) = (u32::from(picture.size.0), u32::from(picture.size.1));
    let full = sensor.color.intrinsics;
    let step = f64::from(full.width / width.max(1));
    let mut intrinsics = full;
    (intrinsics.width, intrinsics.height) = (width, height);
    (intrinsics.fx, intrinsics.fy) = (full.fx / step, full.fy / step);
    // Pixel centres stand at integers.
    (intrinsics.cx, intrinsics.cy) = ((full.cx + 0.5) / step - 0.5, (full.cy + 0.5) / step - 0.5);
    let timestamp_ns = (picture.seconds * 1e9) as i64;
    Some(Keyframe {
        name: format!("{}", picture.number),
        world_from_camera: picture.pose?,
        camera: CameraModel { intrinsics, distortion: sensor.color.distortion },
        color: ColorFrame {
            timestamp_ns,
            width,
            height,
            encoding: ColorEncoding::Jpeg,
            bytes: picture.jpeg.to_vec(),
            missing_packets: 0,
        },
    })
}
