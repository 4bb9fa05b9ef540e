//! Lamps of a result in the preview: as they are seen from the middle of the scene.

use crate::export::hdr;
use crate::numerics::robust::median;
use crate::preview::color::display;
use crate::preview::keyframe_view::Panel;
use glam::Vec3;
use recordings::local_light::Lamp;
use recordings::result::Estimate;
use std::f32::consts::TAU;

/// Half width of the ring around a lamp, and its radius at least, in radian.
const RING_HALF_WIDTH: f32 = 0.012;
const RING_RADIUS: f32 = 0.07;
/// Colour of the ring: that of no lamp.
const RING: [f32; 3] = [0.2, 0.9, 0.75];
/// Sine of a lamp's radius at most: the middle of the scene may lie within it.
const WIDEST: f32 = 0.9;

/// A lamp as a disc of directions.
#[derive(Debug, Clone, Copy)]
pub struct SeenLamp {
    /// Unit direction of its centre.
    pub direction: Vec3,
    /// Angle from there to its rim.
    pub radius_rad: f32,
    /// Radiance.
    pub radiance: Vec3,
}

impl SeenLamp {
    fn new(lamp: &Lamp, from: Vec3) -> Self {
        let to = Vec3::from_array(lamp.center) - from;
        let sine = (lamp.radius_m / to.length().max(f32::MIN_POSITIVE)).min(WIDEST);
        let radiance = Vec3::from_array(lamp.radiance.map(|x| x as f32));
        Self { direction: to.normalize_or(Vec3::Z), radius_rad: libm::asinf(sine), radiance }
    }

    /// Radiance times solid angle.
    #[must_use]
    pub fn flux(&self) -> Vec3 {
        self.radiance * (TAU * (1.0 - libm::cosf(self.radius_rad)))
    }

    /// Angle to a unit direction.
    #[must_use]
    pub fn angle(&self, direction: Vec3) -> f32 {
        libm::acosf(self.direction.dot(direction).clamp(-1.0, 1.0))
    }
}

/// The lamps seen from the median of all vertices.
#[must_use]
pub fn seen(result: &Estimate) -> Vec<SeenLamp> {
    let middle = |axis: usize| median(result.mesh.positions.iter().map(|p| p[axis])).unwrap_or(0.0);
    let from = Vec3::new(middle(0), middle(1), middle(2));
    result.local_light.lamps.iter().map(|l| SeenLamp::new(l, from)).collect()
}

/// Draws lamps and rings around them into a panorama of the light.
pub fn mark(panorama: &mut Panel, lamps: &[SeenLamp]) {
    let size = (panorama.width as usize, panorama.height as usize);
    for (i, (rgb, _)) in panorama.pixels.iter_mut().enumerate() {
        let direction = hdr::direction(i % size.0, i / size.0, size).as_vec3();
        for lamp in lamps {
            let angle = lamp.angle(direction);
            let ring = lamp.radius_rad.max(RING_RADIUS) + RING_HALF_WIDTH;
            if (angle - ring).abs() < RING_HALF_WIDTH {
                *rgb = RING;
            } else if angle < lamp.radius_rad {
                *rgb = display(lamp.radiance / lamp.radiance.max_element().max(f32::MIN_POSITIVE));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn a_lamp_is_marked_where_it_stands() {
        let mut result = tiny();
        // The median of the triangle's corners is (0, −0.2, 0): the lamp stands 1 m along +Y of it.
        result.local_light.lamps = vec![Lamp { center: [0.0, 0.8, 0.0], radius_m: 0.3, radiance: [4.0, 2.0, 0.0] }];
        let lamps = seen(&result);
        assert!((lamps[0].direction - Vec3::Y).length() < 1e-5);
        assert!((lamps[0].flux().x - 4.0 * TAU * (1.0 - 0.91f32.sqrt())).abs() < 1e-4);
        let mut panel = Panel { width: 240, height: 120, pixels: vec![([0.0; 3], 1.0); 240 * 120] };
        mark(&mut panel, &lamps);
        // +Y is the left edge, half way down.
        let at = |x: usize| panel.pixels[60 * 240 + x].0;
        assert_eq!((at(0)[0], at(0)[2]), (1.0, 0.0));
        assert!((5..20).any(|x| at(x) == RING) && at(60) == [0.0; 3]);
    }
}
