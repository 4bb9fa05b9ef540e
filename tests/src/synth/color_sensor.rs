//! The colour camera: lens blur, vignetting, automatic gain and white balance, noise, 8 bits.

use super::environment::luminance;
use super::random::Rng;
use super::render::Image;
use glam::Vec3;
use recordings::types::RgbImage;

/// A colour camera's habits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColorSensor {
    /// Standard deviation of the point-spread function, in pixels.
    pub blur_px: f32,
    /// Electrons at full scale: the shot noise's variance is signal / this.
    pub full_well_e: f32,
    /// Standard deviation of the read noise, full scale = 1.
    pub read_noise: f32,
    /// Mean signal that the automatic exposure steers for.
    pub target_mean: f32,
    /// Share of the way to the wanted gain that a frame goes.
    pub response: f32,
    /// Size of the slow hunting of the gain, relative.
    pub hunting: f32,
    /// Size of the white balance's drift, relative.
    pub drift: f32,
    /// Bounds of the gain relative to the first frame's.
    pub relative_range: [f32; 2],
    /// How far the automatic white balance goes towards neutral: 0 leaves the colour of the light, 1 takes all of it.
    pub balancing: f32,
    /// Share of the picture that the automatic exposure lets clip.
    pub most_clipped: f32,
    /// Relative loss of light in the corners.
    pub vignetting: f32,
}

impl Default for ColorSensor {
    fn default() -> Self {
        Self {
            blur_px: 0.6,
            full_well_e: 6000.0,
            read_noise: 0.0012,
            target_mean: 0.20,
            response: 0.12,
            hunting: 0.14,
            drift: 0.025,
            relative_range: [0.6, 1.6],
            balancing: 0.0,
            most_clipped: 1.0,
            vignetting: 0.0,
        }
    }
}

/// What the camera set for one frame: signal = gain · white balance · radiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Gain, common to the channels.
    pub gain: f32,
    /// Relative gain of red, green and blue.
    pub white_balance: Vec3,
}

/// The state of the automatic exposure.
#[derive(Debug, Clone, Copy, Default)]
pub struct AutoExposure {
    base: Option<f32>,
    steered: f32,
    /// Logarithm of the white balance.
    balance: Option<Vec3>,
}

impl AutoExposure {
    /// Gain for a picture taken at `time_s`.
    pub fn next(&mut self, sensor: &ColorSensor, picture: &Image<Vec3>, time_s: f64, rng: &mut Rng) -> Gain {
        // The loop sees what the sensor sees: highlights count as full scale.
        let clipped = |gain: f32| {
            let sum: f64 = picture.data.iter().map(|&c| f64::from(luminance((c * gain).min(Vec3::ONE)))).sum();
            (sum / picture.data.len().max(1) as f64) as f32
        };
        let mut wanted = 1.0f32;
        for _ in 0..8 {
            wanted = (wanted * sensor.target_mean / clipped(wanted).max(1e-6)).clamp(1e-4, 1e4);
        }
        if sensor.most_clipped < 1.0 {
            let mut brightest: Vec<f32> = picture.data.iter().map(|c| c.max_element()).collect();
            brightest.sort_by(f32::total_cmp);
            let at = ((1.0 - sensor.most_clipped) * brightest.len() as f32) as usize;
            wanted = brightest.get(at).map_or(wanted, |b| wanted.min(1.0 / b.max(1e-4)));
        }
        let base = *self.base.get_or_insert(wanted);
        if self.steered == 0.0 {
            self.steered = wanted;
        }
        self.steered *= libm::powf(wanted / self.steered, sensor.response);
        let wave = |period_s: f64, phase: f64| libm::sin(std::f64::consts::TAU * time_s / period_s + phase) as f32;
        let hunting = sensor.hunting * (0.7 * wave(2.3, 0.4) + 0.5 * wave(0.9, 2.0)) + 0.01 * rng.normal();
        let [low, high] = sensor.relative_range;
        let gain = (self.steered * libm::expf(hunting)).clamp(low * base, high * base);
        let drift = Vec3::new(wave(7.0, 0.0), 0.0, wave(5.0, 2.5)) * sensor.drift;
        let neutral = neutral(picture, gain) * sensor.balancing;
        let balance = *self.balance.insert(match self.balance {
            Some(before) => before.lerp(neutral, 0.5 * sensor.response),
            None => neutral,
        });
        Gain { gain, white_balance: Vec3::from(balance.to_array().map(libm::expf)) * (Vec3::ONE + drift) }
    }
}

/// Logarithm of the gains (green 0) that make a picture neutral: its unclipped pixels' colours, the bright ones counting
/// more (shades of grey, Finlayson and Trezzi 2004, p = 5).
fn neutral(picture: &Image<Vec3>, gain: f32) -> Vec3 {
    const P: f32 = 5.0;
    const LIMIT: f32 = 0.6;
    let unclipped = picture.data.iter().map(|&c| c * gain).filter(|c| c.max_element() < 1.0);
    let sum: glam::DVec3 = unclipped.map(|c| Vec3::from(c.to_array().map(|x| libm::powf(x, P))).as_dvec3()).sum();
    let level = sum.to_array().map(|x| libm::log(x.max(1e-12)) as f32 / P);
    Vec3::from(level.map(|x| (level[1] - x).clamp(-LIMIT, LIMIT)))
}

impl ColorSensor {
    /// The 8-bit sRGB picture, noise and all.
    #[must_use]
    pub fn expose(&self, picture: &Image<Vec3>, gain: Gain, seed: u64) -> RgbImage {
        let blurred = blur(picture, self.blur_px);
        let mut data = Vec::with_capacity(3 * blurred.len());
        let [width, height] = [picture.width, picture.height].map(|n| n as f32);
        for (k, radiance) in blurred.iter().enumerate() {
            let mut rng = Rng::new(seed, k as u64);
            let (x, y) =
                ((k as u32 % picture.width) as f32 - 0.5 * width, (k as u32 / picture.width) as f32 - 0.5 * height);
            let shade = 1.0 - self.vignetting * 4.0 * (x * x + y * y) / (width * width + height * height);
            for signal in (*radiance * (gain.gain * shade) * gain.white_balance).to_array() {
                let deviation = (signal.max(0.0) / self.full_well_e + self.read_noise * self.read_noise).sqrt();
                data.push(encode(signal + deviation * rng.normal()));
            }
        }
        RgbImage { width: picture.width, height: picture.height, data }
    }
}

/// Linear light to 8-bit sRGB (IEC 61966-2-1).
#[must_use]
pub fn encode(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let s = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::powf(x, 1.0 / 2.4) - 0.055 };
    (255.0 * s).round() as u8
}

/// Separable Gaussian with mirrored borders.
fn blur(picture: &Image<Vec3>, sigma: f32) -> Vec<Vec3> {
    if sigma <= 0.0 {
        return picture.data.clone();
    }
    let (width, height) = (picture.width as usize, picture.height as usize);
    let radius = (3.0 * sigma).ceil() as isize;
    let raw: Vec<f32> =
        (-radius..=radius).map(|i| libm::expf(-0.5 * (i as f32 / sigma) * (i as f32 / sigma))).collect();
    let sum: f32 = raw.iter().sum();
    let pass = |data: &[Vec3], length: usize, stride: usize, position: &dyn Fn(usize) -> usize| -> Vec<Vec3> {
        (0..data.len())
            .map(|k| {
                let at = position(k) as isize;
                let tap = |(i, w): (usize, &f32)| {
                    let to = (at + i as isize - radius).clamp(0, length as isize - 1);
                    data[k.wrapping_add_signed((to - at) * stride as isize)] * (w / sum)
                };
                raw.iter().enumerate().map(tap).sum()
            })
            .collect()
    };
    let rows = pass(&picture.data, width, 1, &|k| k % width);
    pass(&rows, height, width, &|k| k / width)
}
