//! Means over the three channels of a colour.

/// Mean.
#[must_use]
pub fn mean(of: &[f64; 3]) -> f64 {
    (of[0] + of[1] + of[2]) / 3.0
}

/// Mean of the squares.
#[must_use]
pub fn mean_square(of: &[f64; 3]) -> f64 {
    (of[0] * of[0] + of[1] * of[1] + of[2] * of[2]) / 3.0
}
