//! Spheres around objects: what a ray can meet, and what can shadow what.

use glam::Vec3;

/// A sphere around an object, or around a light source.
#[derive(Debug, Clone, Copy)]
pub struct BoundingSphere {
    /// Its middle.
    pub center: Vec3,
    /// Its radius in metres.
    pub radius: f32,
}

impl BoundingSphere {
    /// Around the middle of the bounding box of some points.
    #[must_use]
    pub fn around(points: impl Iterator<Item = Vec3> + Clone) -> Option<Self> {
        let (low, high) = points.clone().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        let center = (low + high) * 0.5;
        let radius = points.fold(0.0f32, |r, p| r.max(p.distance(center)));
        center.is_finite().then_some(Self { center, radius })
    }

    /// True if a ray along the unit `direction` meets it.
    #[must_use]
    pub fn is_met(&self, origin: Vec3, direction: Vec3) -> bool {
        let d = self.center - origin;
        let along = d.dot(direction);
        let r2 = self.radius * self.radius * 1.0001;
        d.length_squared() <= r2 || (along > 0.0 && d.length_squared() - along * along <= r2)
    }

    /// True if it may hide a part of `source` from a point.
    #[must_use]
    pub fn is_between(&self, point: Vec3, source: &Self) -> bool {
        let way = source.center - point;
        let to = self.center - point;
        let share = (to.dot(way) / way.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        // The beam from the point widens to the source.
        to.distance(way * share) <= self.radius + source.radius * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_shadows_what_is_behind_it() {
        let ball = BoundingSphere { center: Vec3::Z, radius: 0.1 };
        let lamp = |x: f32, radius: f32| BoundingSphere { center: Vec3::new(x, 0.0, 2.0), radius };
        assert!(ball.is_between(Vec3::ZERO, &lamp(0.0, 0.01)));
        assert!(!ball.is_between(Vec3::ZERO, &lamp(0.5, 0.01)));
        // A lamp as large as that has its rim behind the ball.
        assert!(ball.is_between(Vec3::ZERO, &lamp(0.5, 0.4)));
        assert!(!ball.is_between(Vec3::Z * 1.5, &lamp(0.0, 0.01)), "the ball is behind");
        assert!(ball.is_between(Vec3::Z, &lamp(5.0, 0.01)), "from within the ball");
    }
}
