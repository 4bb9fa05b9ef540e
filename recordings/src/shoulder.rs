//! The shoulder of a camera's tone curve: what is bright is compressed before it is encoded. Light x (1 + a x⁴) shows as x does in sRGB; a,
//! the strength, is one number of the camera. At a = 1 the largest value stands for twice the light that it has in sRGB, and three
//! quarters of the light of that for 1.3 times as much.

/// Largest strength that is read.
pub const MAX_STRENGTH: f64 = 8.0;

/// Steps of Newton's method; six are enough for the precision of f32 at any strength.
const STEPS: usize = 12;

/// Linear light of what sRGB would decode to `x`, 0 or more.
#[must_use]
pub fn expanded(x: f64, strength: f64) -> f64 {
    x * (1.0 + strength * x.powi(4))
}

/// Inverse of [`expanded`]: `light` is between 0 and 1 + strength.
#[must_use]
pub fn compressed(light: f64, strength: f64) -> f64 {
    if strength == 0.0 {
        return light;
    }
    // The curve is convex, so steps from above stay above.
    let mut x = light.min(1.0);
    for _ in 0..STEPS {
        let fourth = strength * x.powi(4);
        let step = (x * (1.0 + fourth) - light) / (1.0 + 5.0 * fourth);
        x -= step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    x
}

/// d ln [`expanded`] / d ln x.
#[must_use]
pub fn slope(x: f64, strength: f64) -> f64 {
    let fourth = strength * x.powi(4);
    (1.0 + 5.0 * fourth) / (1.0 + fourth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn at_a_strength_of_one_white_is_twice_as_bright() {
        assert_eq!(expanded(1.0, 1.0), 2.0);
        assert!((expanded(0.75, 1.0) / 0.75 - 1.316).abs() < 1e-3);
        assert_eq!((compressed(0.3, 0.0), compressed(0.0, 2.0)), (0.3, 0.0));
    }

    proptest! {
        #[test]
        fn light_comes_back(x in 0.0..=1.0, strength in 0.0..=MAX_STRENGTH) {
            prop_assert!((compressed(expanded(x, strength), strength) - x).abs() < 1e-9);
            let step = |x: f64| libm::log(expanded(x, strength));
            if x > 0.01 {
                let by_difference = (step(1.0001 * x) - step(x)) / libm::log(1.0001);
                prop_assert!((slope(x, strength) - by_difference).abs() < 2e-3);
            }
        }
    }
}
