//! Where pictures are taken.

use super::stage::Views;
use crate::synth::path::{Arc, look_at};
use crate::synth::random::Rng;
use glam::{DQuat, DVec3};
use recordings::types::Pose;

/// Seconds between photographs.
pub const PHOTO_PERIOD_S: f64 = 2.5;
/// Held-out views.
pub const HELD_OUT: usize = 3;
/// RMS error of given poses: metres and degrees.
const POSE_ERROR: [f64; 2] = [0.003, 0.3];

/// A smooth way of the camera.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    views: Views,
    duration_s: f64,
    /// Share of the whole way that is gone.
    share: [f64; 2],
    /// Shift of elevation (degrees) and relative shift of distance.
    shift: [f64; 2],
}

impl Way {
    /// Of `count` photographs.
    #[must_use]
    pub fn of_photos(views: Views, count: usize) -> Self {
        Self { views, duration_s: PHOTO_PERIOD_S * (count - 1) as f64, share: [0.0, 1.0], shift: [0.0; 2] }
    }

    /// Of a recording: at most about 85° of the way, at a hand's speed.
    #[must_use]
    pub fn of_recording(views: Views, duration_s: f64) -> Self {
        let whole = match views {
            Views::Orbit { azimuth_deg: [a, b], .. } => f64::from((b - a).abs()),
            Views::Tour { .. } => 360.0,
        };
        let share = (85.0 / whole).min(1.0);
        Self { views, duration_s, share: [0.5 - 0.5 * share, 0.5 + 0.5 * share], shift: [0.0; 2] }
    }

    /// The pose at a time (may lie a little outside the duration).
    #[must_use]
    pub fn pose(&self, time_s: f64) -> Pose {
        let along = self.share[0] + (self.share[1] - self.share[0]) * time_s / self.duration_s;
        match self.views {
            Views::Orbit { target, azimuth_deg, elevation_deg, distance_m } => {
                let half = |[a, b]: [f32; 2]| [0.5 * f64::from(a + b), 0.5 * f64::from(b - a)];
                let (elevation, distance) = (half(elevation_deg), half(distance_m));
                let arc = Arc {
                    target: target.as_dvec3(),
                    azimuth_deg: azimuth_deg.map(f64::from),
                    elevation_deg: [elevation[0] + self.shift[0], elevation[1]],
                    distance_m: [distance[0] * (1.0 + self.shift[1]), distance[1]],
                    tremor: [0.0; 2],
                    duration_s: 1.0,
                };
                let still = arc.pose(along);
                // The hand's tremor goes by time, not by the way.
                let shaken = Arc { tremor: [0.0015, 0.15], azimuth_deg: [0.0; 2], ..arc };
                let calm = Arc { tremor: [0.0; 2], ..shaken };
                let (a, b) = (shaken.pose(time_s), calm.pose(time_s));
                let turn = still.rotation * b.rotation.inverse();
                Pose::new(turn * a.rotation, still.translation + turn * (a.translation - b.translation))
            }
            Views::Tour { center, wander_m, start_deg } => {
                let yaw = (f64::from(start_deg) + 350.0 * along).to_radians();
                let (s, c) = libm::sincos(yaw);
                let outwards = DVec3::new(s, c, 0.0);
                let rise = 0.15 * libm::sin(2.3 * yaw);
                let position =
                    center.as_dvec3() - f64::from(wander_m) * (1.0 + self.shift[1]) * outwards + DVec3::Z * rise;
                let pitch = (-22.0 + 20.0 * libm::sin(4.7 * yaw) + self.shift[0]).to_radians();
                look_at(position, position + outwards + DVec3::Z * libm::tan(pitch), 0.0)
            }
        }
    }

    /// Held-out poses: between those of the photographs, from elsewhere.
    #[must_use]
    pub fn held_out(&self, rng: &mut Rng) -> Vec<Pose> {
        (0..HELD_OUT)
            .map(|k| {
                let at = (k as f64 + 0.2 + 0.6 * f64::from(rng.uniform())) / HELD_OUT as f64;
                let shift = [f64::from(rng.between(3.0, 8.0)), f64::from(rng.between(-0.06, 0.1))];
                Self { shift, ..*self }.pose(at * self.duration_s)
            })
            .collect()
    }
}

/// A pose as a tracker would have got it.
#[must_use]
pub fn with_error(pose: &Pose, rng: &mut Rng) -> Pose {
    let mut vector = |size: f64| {
        let size = size / 3f64.sqrt();
        DVec3::new(f64::from(rng.normal()), f64::from(rng.normal()), f64::from(rng.normal())) * size
    };
    let (shift, turn) = (vector(POSE_ERROR[0]), vector(POSE_ERROR[1].to_radians()));
    Pose::new(pose.rotation * DQuat::from_scaled_axis(turn), pose.translation + shift)
}
