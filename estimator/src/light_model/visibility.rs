//! How much of a source a vertex sees.

use crate::rays::RayScene;
use glam::Vec3;

/// Rays to a source, and where it is seen in part.
const RAYS: u32 = 16;
const PENUMBRA_RAYS: u32 = 64;

/// True if nothing is between two points.
pub fn sees(scene: &RayScene, from: Vec3, point: Vec3) -> bool {
    let to = point - from;
    let distance = to.length();
    !scene.occluded_within(from, to / distance, distance)
}

/// Share of the rays to a source that are free, by `is_free(ray, rays)`, ray `ray` of `rays`. Where a source is seen in part, few
/// rays make more noise than there is in lit colours, and a source that is right is held for wrong.
pub fn visible_share(is_free: impl Fn(u32, u32) -> bool) -> f32 {
    let share = |rays: u32| (0..rays).filter(|ray| is_free(*ray, rays)).count() as f32 / rays as f32;
    let few = share(RAYS);
    if few > 0.0 && few < 1.0 { share(PENUMBRA_RAYS) } else { few }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_rays_go_where_a_source_is_seen_in_part() {
        let rays = std::cell::Cell::new(0);
        let share_of = |edge: f32| {
            rays.set(0);
            let share = visible_share(|ray, of| {
                rays.set(rays.get() + 1);
                (ray as f32 + 0.5) / (of as f32) < edge
            });
            (share, rays.get())
        };
        assert_eq!([share_of(0.0), share_of(1.0)], [(0.0, RAYS), (1.0, RAYS)]);
        let (share, rays) = share_of(0.3);
        assert!((share - 0.3).abs() < 0.5 / PENUMBRA_RAYS as f32 + 1e-6, "{share}");
        assert_eq!(rays, RAYS + PENUMBRA_RAYS);
    }
}
