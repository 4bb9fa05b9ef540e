//! Which way is up in a scan whose sensor did not measure it.
//!
//! The world frame of such a scan is that of its first picture, whose image-up is +Z. What is shown to people is turned by
//! [`turn_to_upright`].

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// The upward direction, told by the surface. Stored as postcard: a field is never moved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ToldUp {
    /// Unit vector, world axes.
    pub direction: [f64; 3],
    /// The plane that it is the normal of; `None` where no plane is large enough: then it is image-up of the first picture.
    pub plane: Option<HorizontalPlane>,
}

/// A plane that is taken for horizontal: a desk, a floor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HorizontalPlane {
    /// Share of the surface that lies in it.
    pub share: f64,
    /// Share of the surface that stands on it at a right angle: walls, sides of boxes.
    pub vertical_share: f64,
}

impl ToldUp {
    /// Its angle to image-up of the first picture, radian.
    #[must_use]
    pub fn tilt_rad(&self) -> f64 {
        DVec3::from(self.direction).angle_between(DVec3::Z)
    }

    /// What is wrong with its numbers, if anything.
    pub(crate) fn check(&self) -> Result<(), String> {
        let finite = self.plane.is_none_or(|p| p.share.is_finite() && p.vertical_share.is_finite());
        if finite { check_up(DVec3::from(self.direction)) } else { Err("a horizontal plane of NaN or infinity".into()) }
    }
}

/// Checks that `up` is a unit vector.
pub(crate) fn check_up(up: DVec3) -> Result<(), String> {
    let unit = up.is_finite() && (up.length() - 1.0).abs() < 1e-3;
    if unit { Ok(()) } else { Err("an upward direction that is no unit vector".into()) }
}

/// The rotation of the world that turns `up` to +Z and leaves +Y, the first view direction, as close to +Y as possible.
#[must_use]
pub fn turn_to_upright(up: DVec3) -> DQuat {
    let z = up.normalize_or(DVec3::Z);
    // A vertical view direction has no horizontal part: image-up takes its place.
    let forward = [DVec3::Y, DVec3::Z].into_iter().map(|f| f - z * z.dot(f)).find(|f| f.length() > 0.1);
    let y = forward.unwrap_or(DVec3::X).normalize();
    DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).inverse()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_becomes_z_and_the_view_stays_ahead() {
        for up in [DVec3::new(0.3, -0.5, 0.9), DVec3::new(0.0, 0.6, 0.8), DVec3::Y, DVec3::NEG_Y, DVec3::Z] {
            let turn = turn_to_upright(up);
            assert!((turn * up.normalize() - DVec3::Z).length() < 1e-12, "{up}");
            let ahead = turn * DVec3::Y;
            assert!(ahead.x.abs() < 1e-12 && ahead.y > -1e-12, "{up}: {ahead}");
        }
        assert!(turn_to_upright(DVec3::Z).angle_between(DQuat::IDENTITY) < 1e-12);
    }

    #[test]
    fn nonsense_is_refused() {
        let told = |direction| ToldUp { direction, plane: None };
        assert!(told([0.0, 0.6, 0.8]).check().is_ok());
        assert!(told([0.0; 3]).check().is_err() && told([0.0, f64::NAN, 1.0]).check().is_err());
        let plane = Some(HorizontalPlane { share: f64::NAN, vertical_share: 0.0 });
        assert!(ToldUp { direction: [0.0, 0.0, 1.0], plane }.check().is_err());
    }
}
