//! Medians, and what a difference over many parts says.

/// The middle value; 0 of nothing.
pub fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The value at which half the weight lies below; `values` are (value, weight) and are sorted in place.
pub fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = values.iter().map(|v| v.1).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    for (i, v) in values.iter().enumerate() {
        sum += v.1;
        if sum > half {
            return v.0;
        }
        if sum == half && i + 1 < values.len() {
            return 0.5 * (v.0 + values[i + 1].0);
        }
    }
    values.last().map_or(0.0, |v| v.0)
}

/// Mean of what many parts gain, with its standard error.
#[derive(Debug, Clone, Copy)]
pub struct Gain {
    /// Mean.
    pub mean: f64,
    /// Its standard error.
    pub error: f64,
}

impl Gain {
    /// From the gain of every part; fewer than two say nothing.
    pub fn of(gains: &[f64]) -> Self {
        let n = gains.len() as f64;
        if n < 2.0 {
            return Self { mean: 0.0, error: f64::INFINITY };
        }
        let mean = gains.iter().sum::<f64>() / n;
        let variance = gains.iter().map(|g| (g - mean) * (g - mean)).sum::<f64>() / (n - 1.0);
        Self { mean, error: libm::sqrt(variance / n) }
    }
}
