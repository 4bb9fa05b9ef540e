//! Random numbers: counter-seeded, so that every pixel, vertex and frame has its own stream whatever thread draws it.

/// A SplitMix64 stream (Steele, Lea, Flood 2014).
#[derive(Debug, Clone)]
pub struct Rng(u64);

impl Rng {
    /// The stream with number `stream` of the family `seed`.
    #[must_use]
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(mix(seed ^ mix(stream.wrapping_add(0x9e37_79b9_7f4a_7c15))))
    }

    /// A seed for a family of streams of its own.
    #[must_use]
    pub fn family(seed: u64, member: u64) -> u64 {
        Self::new(seed, member).next()
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f32 {
        (self.next() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `low..high`.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in `0..count` (0 for an empty range).
    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f32) as usize).min(count.saturating_sub(1))
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f32) -> bool {
        self.uniform() < probability
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f32 {
        let radius = (-2.0 * libm::logf(1.0 - self.uniform())).sqrt();
        radius * libm::cosf(std::f32::consts::TAU * self.uniform())
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Low-discrepancy points of the square: Roberts' R₂ (powers of the plastic number), shifted by a random offset.
#[derive(Debug, Clone)]
pub struct Stratified([f32; 2]);

impl Stratified {
    /// A sequence with its own random shift.
    pub fn new(rng: &mut Rng) -> Self {
        Self([rng.uniform(), rng.uniform()])
    }

    /// The next point of [0, 1)².
    pub fn point(&mut self) -> [f32; 2] {
        const STEP: [f32; 2] = [0.754_877_7, 0.569_840_3];
        for (x, step) in self.0.iter_mut().zip(STEP) {
            *x += step;
            *x -= x.floor();
        }
        self.0.map(|x| x.min(1.0 - f32::EPSILON))
    }
}
