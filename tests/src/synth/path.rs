//! How a hand carries the camera.

use glam::{DMat3, DQuat, DVec3};
use recordings::types::Pose;

/// A handheld arc around a target: smooth in all derivatives that a tracker notices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Point looked at, in metres.
    pub target: DVec3,
    /// Azimuth about +Z at the start and the end, degrees; 0 stands on the −Y side.
    pub azimuth_deg: [f64; 2],
    /// Mean elevation over the target and its swing, degrees.
    pub elevation_deg: [f64; 2],
    /// Mean distance from the target and its swing, metres.
    pub distance_m: [f64; 2],
    /// Size of the hand's tremor: position in metres, direction in degrees.
    pub tremor: [f64; 2],
    /// Duration in seconds.
    pub duration_s: f64,
}

impl Arc {
    /// World-from-camera pose at a time (may lie a little outside the duration).
    #[must_use]
    pub fn pose(&self, time_s: f64) -> Pose {
        let t = time_s / self.duration_s;
        // Nearly steady speed, a little slower at both ends.
        let along = t - 0.05 * libm::sin(std::f64::consts::TAU * t) / std::f64::consts::TAU;
        let [from, to] = self.azimuth_deg;
        let azimuth = (from + (to - from) * along).to_radians();
        let swing = libm::sin(std::f64::consts::TAU * (1.25 * t + 0.1));
        let elevation = (self.elevation_deg[0] + self.elevation_deg[1] * swing).to_radians();
        let distance = self.distance_m[0] + self.distance_m[1] * libm::cos(std::f64::consts::TAU * (0.9 * t + 0.05));
        let (sa, ca) = libm::sincos(azimuth);
        let (se, ce) = libm::sincos(elevation);
        let away = DVec3::new(sa * ce, -ca * ce, se);
        let position = self.target + away * distance + self.tremor[0] * wander(time_s, 0.0);
        let aim = self.target + distance * self.tremor[1].to_radians() * wander(time_s, 5.0) * 1.5;
        let roll = (self.tremor[1] * wander(time_s, 9.0).x).to_radians();
        look_at(position, aim, roll)
    }
}

/// World-from-camera pose at `position`, looking at `aim`, image-up towards +Z, turned by `roll_rad` about the axis.
#[must_use]
pub fn look_at(position: DVec3, aim: DVec3, roll_rad: f64) -> Pose {
    let forward = (aim - position).normalize_or(DVec3::Y);
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let down = forward.cross(right);
    let level = DQuat::from_mat3(&DMat3::from_cols(right, down, forward));
    Pose::new(level * DQuat::from_rotation_z(roll_rad), position)
}

/// Slow incommensurable waves, each component of RMS about 1.
fn wander(time_s: f64, phase: f64) -> DVec3 {
    let wave = |k: f64| {
        let sum = libm::sin(2.9 * time_s + 1.7 * k + phase)
            + 0.7 * libm::sin(5.3 * time_s + 4.1 * k + 2.0 * phase)
            + 0.35 * libm::sin(9.7 * time_s + 2.3 * k + 3.0 * phase);
        sum * 1.1
    };
    DVec3::new(wave(0.0), wave(1.0), wave(2.0))
}
