//! Radiance of a texel from the views of it.

use crate::texture::views::ViewSample;
use glam::Vec3;

/// Difference of square roots of light, relative to the square root of the texel's, at which a view counts a quarter: far above
/// noise and gloss, below what a moving or misplaced thing makes.
const OUTLIER: f32 = 0.35;
/// Largest power that is taken by products, in halves.
const MOST_HALVES: u32 = 16;
/// Rounds of reweighting.
const ROUNDS: usize = 2;

/// Weighted mean of the views, linear RGB, without those that show something else; `None` without views. Clipped views count
/// where there are no others.
#[must_use]
pub fn blend(samples: &mut Vec<ViewSample>, power: f32) -> Option<Vec3> {
    if samples.iter().any(|s| !s.clipped) {
        samples.retain(|s| !s.clipped);
    }
    let most = samples.iter().map(|s| s.weight).fold(0.0, f32::max);
    if most <= 0.0 {
        return None;
    }
    // Relative to the best view: powers neither overflow nor vanish.
    samples.iter_mut().for_each(|s| s.weight = raised(s.weight / most, power));
    let mut color = mean(samples, |_| 1.0);
    // Of two views that differ none is known to be wrong.
    if samples.len() > 2 {
        for _ in 0..ROUNDS {
            let (center, scale) = (root(color), OUTLIER * root(color).length().max(1e-3));
            color = mean(samples, |s| {
                let x = (root(s.color) - center).length() / scale;
                1.0 / ((1.0 + x * x) * (1.0 + x * x))
            });
        }
    }
    Some(color)
}

/// x to a power: a small multiple of a half by products, which are many times as fast.
fn raised(x: f32, power: f32) -> f32 {
    let halves = (2.0 * power) as u32;
    if halves as f32 == 2.0 * power && halves <= MOST_HALVES {
        let root = if halves % 2 == 1 { x.sqrt() } else { 1.0 };
        (0..halves / 2).fold(root, |p, _| p * x)
    } else {
        libm::powf(x, power)
    }
}

fn root(color: Vec3) -> Vec3 {
    color.max(Vec3::ZERO).map(f32::sqrt)
}

fn mean(samples: &[ViewSample], factor: impl Fn(&ViewSample) -> f32) -> Vec3 {
    let weighted = samples.iter().map(|s| (s.color, s.weight * factor(s)));
    let (sum, total) = weighted.fold((Vec3::ZERO, 0.0f32), |(s, t), (c, w)| (s + c * w, t + w));
    if total > 0.0 { sum / total } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(value: f32, weight: f32, clipped: bool) -> ViewSample {
        ViewSample { color: Vec3::splat(value), weight, footprint: 1.0, clipped }
    }

    #[test]
    fn a_view_of_something_else_hardly_counts() {
        let mut samples = vec![view(0.5, 1.0, false), view(0.52, 0.9, false), view(0.01, 0.8, false)];
        let blended = blend(&mut samples, 1.0).unwrap().x;
        assert!((blended - 0.51).abs() < 0.03, "{blended}");
    }

    #[test]
    fn clipped_views_count_where_there_are_no_others() {
        assert_eq!(blend(&mut vec![view(1.0, 1.0, true)], 1.0), Some(Vec3::ONE));
        assert_eq!(blend(&mut vec![view(1.0, 1.0, true), view(0.5, 0.1, false)], 1.0), Some(Vec3::splat(0.5)));
        assert_eq!(blend(&mut vec![], 1.0), None);
    }

    #[test]
    fn high_powers_keep_the_best_view() {
        let samples = vec![view(0.5, 1.0, false), view(0.4, 0.5, false)];
        assert!((blend(&mut samples.clone(), 16.0).unwrap().x - 0.5).abs() < 1e-4);
        assert!(blend(&mut samples.clone(), 0.0).unwrap().x < 0.46);
    }
}
