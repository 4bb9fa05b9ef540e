//! The world frame of a scan: metres, right-handed, +Z up.

use glam::DVec3;
use recordings::types::Pose;

/// `world_from_camera` of the first frame without gravity: image-up is +Z, the view direction is +Y.
pub fn world_from_first_camera() -> Pose {
    level_world(DVec3::NEG_Y)
}

/// `world_from_camera` for which `up` (camera axes) is +Z and the view direction is as close to +Y as possible.
pub fn level_world(up: DVec3) -> Pose {
    let z = up.normalize_or(DVec3::NEG_Y);
    // A vertical view direction has no horizontal part: image-up (or image-down) takes its place.
    let forward = [DVec3::Z, DVec3::NEG_Y].into_iter().map(|f| f - z * z.dot(f)).find(|f| f.length() > 0.1);
    let y = forward.unwrap_or(DVec3::X).normalize();
    let x = y.cross(z);
    let rows = [[x.x, x.y, x.z, 0.0], [y.x, y.y, y.z, 0.0], [z.x, z.y, z.z, 0.0], [0.0, 0.0, 0.0, 1.0]];
    Pose::from_rows(&rows).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_camera_stands_upright() {
        let w = world_from_first_camera();
        assert!((w.transform(DVec3::NEG_Y) - DVec3::Z).length() < 1e-12);
        assert!((w.transform(DVec3::Z) - DVec3::Y).length() < 1e-12);
        assert!((w.transform(DVec3::X) - DVec3::X).length() < 1e-12);
    }

    #[test]
    fn gravity_is_levelled_also_looking_down() {
        for up in [DVec3::new(0.1, -0.9, -0.4), DVec3::NEG_Z, DVec3::Z] {
            let w = level_world(up);
            assert!((w.transform(up.normalize()) - DVec3::Z).length() < 1e-9, "{up}");
        }
    }
}
