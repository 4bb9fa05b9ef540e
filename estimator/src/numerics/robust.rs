//! Robust statistics: medians, and the mean of samples with its standard error.

/// Standard deviation of a normal distribution whose median absolute deviation is 1.
pub const SIGMA_PER_MAD: f64 = 1.4826;

/// The upper median: the element at index n/2 of the n sorted `values`. `None` where there are no values.
///
/// The order is IEEE 754's total order, so NaN sorts to the ends and the result is the same on every machine.
pub fn median<T: Copy + Into<f64>>(values: impl IntoIterator<Item = T>) -> Option<T> {
    let mut values: Vec<T> = values.into_iter().collect();
    let middle = values.len() / 2;
    let order = |a: &T, b: &T| Into::<f64>::into(*a).total_cmp(&Into::<f64>::into(*b));
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, order).1)
}

/// The value that this share of the sorted `values` is below: the element at index `share · (n − 1)`, rounded down. `None`
/// where there are no values.
pub fn quantile<T: Copy + Into<f64>>(values: impl IntoIterator<Item = T>, share: f64) -> Option<T> {
    let mut values: Vec<T> = values.into_iter().collect();
    let at = (share.clamp(0.0, 1.0) * values.len().saturating_sub(1) as f64) as usize;
    let order = |a: &T, b: &T| Into::<f64>::into(*a).total_cmp(&Into::<f64>::into(*b));
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, order).1)
}

/// Standard deviation of a normal distribution with the median of these absolute `deviations`; 0 where there are none.
pub fn robust_sigma(deviations: impl IntoIterator<Item = f64>) -> f64 {
    SIGMA_PER_MAD * median(deviations).unwrap_or(0.0)
}

/// Weighted median per segment and channel of (segment, values, weight); 0 where a segment has no values.
pub fn segment_medians(segments: usize, values: impl Iterator<Item = (u32, [f64; 3], f64)>) -> Vec<[f64; 3]> {
    let mut of_segment: Vec<[Vec<(f64, f64)>; 3]> = vec![Default::default(); segments];
    for (segment, value, weight) in values {
        let channels = &mut of_segment[segment as usize];
        channels.iter_mut().zip(value).for_each(|(all, v)| all.push((v, weight)));
    }
    of_segment.into_iter().map(|mut of| [0, 1, 2].map(|c| weighted_median(&mut of[c]).unwrap_or(0.0))).collect()
}

/// The weighted median of (value, weight) pairs, which are sorted in place: the value at which the sum of weights passes
/// half of their total; the mean of two neighbours where it meets half exactly. `None` where there are no values.
pub fn weighted_median(values: &mut [(f64, f64)]) -> Option<f64> {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = values.iter().map(|v| v.1).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    for (i, v) in values.iter().enumerate() {
        sum += v.1;
        if sum > half {
            return Some(v.0);
        }
        if sum == half && i + 1 < values.len() {
            return Some(0.5 * (v.0 + values[i + 1].0));
        }
    }
    values.last().map(|v| v.0)
}

/// Mean of independent samples with its standard error.
#[derive(Debug, Clone, Copy)]
pub struct SampleMean {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean; infinite for fewer than two samples.
    pub error: f64,
}

impl SampleMean {
    /// Mean and standard error of `samples`; (0, ∞) for fewer than two.
    pub fn of(samples: &[f64]) -> Self {
        let n = samples.len() as f64;
        if n < 2.0 {
            return Self { mean: 0.0, error: f64::INFINITY };
        }
        let mean = samples.iter().sum::<f64>() / n;
        let variance = samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
        Self { mean, error: libm::sqrt(variance / n) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_nothing_odd_and_even() {
        assert_eq!(median::<f32>([]), None);
        assert_eq!(median([3.0_f64, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0_f32, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(quantile::<f32>([], 0.5), None);
        assert_eq!(quantile([4.0_f32, 1.0, 3.0, 2.0], 0.7), Some(3.0));
        assert_eq!(quantile([2.0_f64, 1.0], 1.0), Some(2.0));
        assert_eq!(weighted_median(&mut []), None);
        assert_eq!(weighted_median(&mut [(1.0, 1.0), (9.0, 1.0)]), Some(5.0));
        assert_eq!(weighted_median(&mut [(1.0, 3.0), (9.0, 1.0)]), Some(1.0));
    }
}
