//! How much of a picture's finest detail its rendering keeps.

/// Sums over blocks of 2 × 2 pixels of the energy in the upper octave: what differs from the block's mean.
#[derive(Debug, Clone, Copy, Default)]
pub struct OctaveEnergy {
    observed: f64,
    rendered: f64,
}

impl OctaveEnergy {
    /// Energies of one block, observed and rendered, in values of one scale.
    #[must_use]
    pub fn of(observed: [f64; 4], rendered: [f64; 4]) -> Self {
        let energy = |values: [f64; 4]| {
            let mean = values.iter().sum::<f64>() / 4.0;
            values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>()
        };
        Self { observed: energy(observed), rendered: energy(rendered) }
    }

    /// Both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { observed: self.observed + other.observed, rendered: self.rendered + other.rendered }
    }

    /// Rendered over observed energy; 0 where nothing is observed.
    #[must_use]
    pub fn kept(&self) -> f64 {
        if self.observed > 0.0 { self.rendered / self.observed } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_the_contrast_is_a_quarter_of_the_energy() {
        let (fine, flat) = ([0.4, 0.6, 0.6, 0.4], [0.5; 4]);
        let half = fine.map(|v| 0.5 + 0.5 * (v - 0.5));
        assert!((OctaveEnergy::of(fine, half).kept() - 0.25).abs() < 1e-12);
        assert!((OctaveEnergy::of(fine, fine).and(OctaveEnergy::of(fine, flat)).kept() - 0.5).abs() < 1e-12);
        assert_eq!(OctaveEnergy::of(flat, fine).kept(), 0.0);
    }
}
