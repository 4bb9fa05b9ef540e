//! What a seed stands for, before any geometry.

use crate::synth::random::Rng;

/// Kind of light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LightKind {
    /// A panorama at infinity.
    Distant,
    /// Lamps at 0.2–1.5 m over dim distant light.
    Lamps,
    /// A closed room.
    Room,
}

impl LightKind {
    /// As it stands in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Distant => "distant",
            Self::Lamps => "lamps",
            Self::Room => "room",
        }
    }
}

/// What carries the objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Support {
    /// A table top, free or before a wall.
    Table,
    /// Boards one over the other, with a back.
    Shelf,
    /// A floor with larger objects.
    Floor,
    /// A floor and two walls.
    Corner,
    /// A single plaster bust, nothing else.
    Bust,
    /// A furnished room.
    Room,
}

/// A seed's scene in outline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// The seed.
    pub seed: u64,
    /// Light.
    pub light: LightKind,
    /// Support.
    pub support: Support,
    /// True if there is a recording of it, too.
    pub recorded: bool,
}

/// How large and how fine a scene is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// Bounds of the number of vertices aimed at.
    pub vertices: [f32; 2],
    /// Bounds of the number of keyframes.
    pub keyframes: [usize; 2],
    /// Images are 640×480 divided by this.
    pub divide: u32,
    /// Rays kept per vertex.
    pub rays: usize,
    /// Rays per pixel of keyframes and held-out views.
    pub samples: usize,
    /// Frames of a recording; 0: none is made.
    pub frames: u32,
}

impl Detail {
    /// The corpus.
    pub const FULL: Self =
        Self { vertices: [11_000.0, 26_000.0], keyframes: [10, 14], divide: 2, rays: 320, samples: 12, frames: 60 };
    /// Small scenes for continuous integration.
    pub const SMALL: Self =
        Self { vertices: [4_000.0, 6_000.0], keyframes: [8, 8], divide: 4, rays: 128, samples: 8, frames: 0 };
}

impl Plan {
    /// Three scenes of five are lit from afar, one by lamps, one is a room, among even and odd seeds alike; one of four is
    /// also recorded.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let half = seed / 2;
        let turn = half + 2 * (seed % 2);
        let light = match turn % 5 {
            3 => LightKind::Lamps,
            4 => LightKind::Room,
            _ => LightKind::Distant,
        };
        let mut rng = Rng::new(seed, 1);
        let support = match light {
            LightKind::Room => Support::Room,
            LightKind::Distant if turn % 5 == 2 && (turn / 5).is_multiple_of(2) => Support::Bust,
            _ => match (rng.uniform() * 10.0) as u32 {
                0..=3 => Support::Table,
                4..=5 => Support::Shelf,
                6..=7 => Support::Floor,
                _ => Support::Corner,
            },
        };
        Self { seed, light, support, recorded: half.is_multiple_of(4) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_and_odd_seeds_have_the_same_mix() {
        for parity in 0..2 {
            let plans: Vec<Plan> = (0..40).map(|k| Plan::new(2 * k + parity)).collect();
            let count = |kind| plans.iter().filter(|p| p.light == kind).count();
            assert_eq!([LightKind::Distant, LightKind::Lamps, LightKind::Room].map(count), [24, 8, 8]);
            assert_eq!(plans.iter().filter(|p| p.recorded).count(), 10);
            assert!(plans.iter().any(|p| p.support == Support::Bust));
        }
    }
}
