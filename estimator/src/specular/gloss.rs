//! Specular weights of a segment.

/// Widths of the lobes tried: band l of the light is damped by exp(−width · l), the Poisson kernel, whose long tail is that of
/// rough surfaces. 0 is the mirror of Eq. (13).
pub(super) const LOBES: [f64; 6] = [0.0, 0.15, 0.25, 0.4, 0.6, 0.8];

/// Weights of Eq. (13) for one segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gloss {
    /// Diffuse weight.
    pub w_d: f64,
    /// Specular weight for light in the mirror direction, ≥ 0.
    pub w_s: f64,
    /// Standard error of the specular weight; infinite where no observation determines it.
    pub error: f64,
    /// True if the weight exceeds its significance bound.
    pub significant: bool,
    /// Index in [`LOBES`] of the lobe that explains the changes between views best.
    pub(super) lobe: usize,
    /// Weight of that lobe. A rough surface blurs the light: a mirror in its place gets too small a weight.
    pub(super) lobe_weight: f64,
}

impl Gloss {
    /// Matte.
    pub const NONE: Self =
        Self { w_d: 1.0, w_s: 0.0, error: f64::INFINITY, significant: false, lobe: 0, lobe_weight: 0.0 };

    /// This share of the gloss.
    pub(super) fn shrunk(self, share: f64) -> Self {
        let w_d = 1.0 + share * (self.w_d - 1.0);
        Self { w_d, w_s: share * self.w_s, lobe_weight: share * self.lobe_weight, ..self }
    }

    /// The same reflection where the light is `1 / factor` times what it was.
    pub fn scale_specular(&mut self, factor: f64) {
        self.w_s *= factor;
        self.error *= factor;
        self.lobe_weight *= factor;
    }
}
