//! Coarse-to-fine schedules of an alignment.

/// The geometric term of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Geometry {
    /// Frame to frame: the reference's points.
    Reference,
    /// Frame to model: the volume, with every `stride`-th grid point.
    Volume {
        /// Grid points per point used.
        stride: usize,
    },
}

/// One stage of a schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// Pyramid level of the photometric term.
    pub level: usize,
    /// Geometric term.
    pub geometry: Geometry,
    /// Associations, each followed by two Gauss–Newton iterations.
    pub rounds: usize,
    /// Standard deviations at which a geometric residual has no weight any more.
    pub cut: f32,
}

/// Frame to frame.
pub const fn reference(level: usize, rounds: usize, cut: f32) -> Stage {
    Stage { level, geometry: Geometry::Reference, rounds, cut }
}

/// Frame to model.
pub const fn volume(level: usize, stride: usize, rounds: usize, cut: f32) -> Stage {
    Stage { level, geometry: Geometry::Volume { stride }, rounds, cut }
}
