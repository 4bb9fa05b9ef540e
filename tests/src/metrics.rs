//! The figures that results are judged by.

use glam::{DVec2, DVec3, Vec3};
use recordings::types::{Intrinsics, Pose};
use std::collections::BTreeMap;

/// Relative error of albedos after one factor per channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlbedoError {
    /// Median over vertices and channels.
    pub median: f64,
    /// 90th percentile.
    pub p90: f64,
    /// Robust standard deviation of the log ratio within a material: shading left in the albedo.
    pub within: f64,
}

/// Median; NaN for nothing.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    percentile(values, 0.5)
}

/// Percentile `p` (0..1) with linear interpolation; NaN for nothing.
#[must_use]
pub fn percentile(values: &[f64], p: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = p * last as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(last);
    sorted[low] + (sorted[high] - sorted[low]) * (at - low as f64)
}

/// RMS difference from the median; NaN for nothing.
#[must_use]
pub fn rms_about_median(values: &[f64]) -> f64 {
    let middle = median(values);
    f64::sqrt(values.iter().map(|v| (v - middle) * (v - middle)).sum::<f64>() / values.len() as f64)
}

/// How far wrong poses shift the image of a surface: per pose the median over every `step`-th of the points that the true
/// pose shows, pixels; NaN where it shows none.
#[must_use]
pub fn pixel_shifts(camera: &Intrinsics, points: &[Vec3], step: usize, found: &[Pose], truth: &[Pose]) -> Vec<f64> {
    let project = |pose: &Pose, p: DVec3| {
        let q = pose.inverse().transform(p);
        (q.z > 0.1).then(|| DVec2::new(q.x / q.z * camera.fx, q.y / q.z * camera.fy))
    };
    let half = DVec2::new(f64::from(camera.width), f64::from(camera.height)) / 2.0;
    let of_pose = |(found, truth): (&Pose, &Pose)| {
        let pairs = points.iter().step_by(step).filter_map(|p| {
            let p = p.as_dvec3();
            Some((project(found, p)?, project(truth, p)?))
        });
        let visible = pairs.filter(|(_, b)| b.abs().cmplt(half).all());
        median(&visible.map(|(a, b)| a.distance(b)).collect::<Vec<_>>())
    };
    found.iter().zip(truth).map(of_pose).collect()
}

/// Compares albedos at the vertices where `used` holds.
#[must_use]
pub fn albedo(
    estimate: &[[f64; 3]],
    truth: &[[f64; 3]],
    material: &[u32],
    used: impl Fn(usize) -> bool,
) -> AlbedoError {
    let vertices: Vec<usize> = (0..truth.len()).filter(|&i| used(i)).collect();
    let scale = [0, 1, 2]
        .map(|c| median(&vertices.iter().map(|&i| truth[i][c] / estimate[i][c].max(1e-6)).collect::<Vec<_>>()));
    let each = || vertices.iter().flat_map(|&i| [0, 1, 2].map(|c| (i, c)));
    let relative: Vec<f64> =
        each().map(|(i, c)| (estimate[i][c] * scale[c] - truth[i][c]).abs() / truth[i][c].max(1e-3)).collect();
    let materials = material.iter().max().map_or(0, |m| m + 1);
    let (mut sum, mut weight) = (0.0, 0.0);
    for m in 0..materials {
        let count = vertices.iter().filter(|&&i| material[i] == m).count();
        if count < 10 {
            continue;
        }
        let ratios: Vec<[f64; 3]> = vertices
            .iter()
            .filter(|&&i| material[i] == m)
            .map(|&i| [0, 1, 2].map(|c| libm::log((estimate[i][c] * scale[c]).max(1e-4) / truth[i][c].max(1e-4))))
            .collect();
        let middle = [0, 1, 2].map(|c| median(&ratios.iter().map(|r| r[c]).collect::<Vec<_>>()));
        let off: Vec<f64> = ratios.iter().flat_map(|r| [0, 1, 2].map(|c| (r[c] - middle[c]).abs())).collect();
        sum += 1.4826 * median(&off) * count as f64;
        weight += count as f64;
    }
    AlbedoError { median: median(&relative), p90: percentile(&relative, 0.9), within: sum / weight }
}

/// Adjusted Rand index of two labellings.
#[must_use]
pub fn adjusted_rand_index(a: &[u32], b: &[u32]) -> f64 {
    let pairs = |n: f64| n * (n - 1.0) / 2.0;
    let mut table = std::collections::BTreeMap::new();
    let (mut rows, mut columns) = (std::collections::BTreeMap::new(), std::collections::BTreeMap::new());
    for (x, y) in a.iter().zip(b) {
        *table.entry((x, y)).or_insert(0.0) += 1.0;
        *rows.entry(x).or_insert(0.0) += 1.0;
        *columns.entry(y).or_insert(0.0) += 1.0;
    }
    let sum = |values: Vec<f64>| values.into_iter().map(pairs).sum::<f64>();
    let (together, x, y) =
        (sum(table.into_values().collect()), sum(rows.into_values().collect()), sum(columns.into_values().collect()));
    let expected = x * y / pairs(a.len() as f64);
    let mean = 0.5 * (x + y);
    if mean == expected { 1.0 } else { (together - expected) / (mean - expected) }
}

/// Area under the ROC curve of `score` for telling `label`; `None` if only one label occurs.
#[must_use]
pub fn area_under_curve(score: &[f64], label: &[bool]) -> Option<f64> {
    let of = |wanted: bool| score.iter().zip(label).filter(move |(_, l)| **l == wanted).map(|(s, _)| *s);
    let (positive, negative): (Vec<f64>, Vec<f64>) = (of(true).collect(), of(false).collect());
    if positive.is_empty() || negative.is_empty() {
        return None;
    }
    let wins: f64 = positive
        .iter()
        .flat_map(|p| {
            negative.iter().map(move |n| {
                if p > n {
                    1.0
                } else if p == n {
                    0.5
                } else {
                    0.0
                }
            })
        })
        .sum();
    Some(wins / (positive.len() * negative.len()) as f64)
}

/// Segments with fewer judged vertices say nothing of gloss.
const MIN_SEGMENT: usize = 20;

/// Area under the ROC curve of the specular weight `w_s` of segments for telling glossy ones. `vertices` are segment and
/// whether the true material is glossy; a segment is glossy if most of its vertices are.
#[must_use]
pub fn gloss_auc(vertices: impl IntoIterator<Item = (u32, bool)>, w_s: impl Fn(u32) -> f64) -> Option<f64> {
    let mut counts: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
    for (segment, glossy) in vertices {
        counts.entry(segment).or_default()[usize::from(glossy)] += 1;
    }
    counts.retain(|_, [matte, glossy]| *matte + *glossy >= MIN_SEGMENT);
    let score: Vec<f64> = counts.keys().map(|s| w_s(*s)).collect();
    let label: Vec<bool> = counts.values().map(|[matte, glossy]| glossy > matte).collect();
    area_under_curve(&score, &label)
}

/// Irradiance that two lights give at reference vertices, `transfer` being `[vertex][81][3]`: median and 90th percentile
/// of the relative error after one factor per channel.
#[must_use]
pub fn scene_irradiance(transfer: &[f64], estimate: &[[f64; 3]], truth: &[[f64; 3]]) -> (f64, f64) {
    let irradiance = |light: &[[f64; 3]]| -> Vec<[f64; 3]> {
        transfer
            .chunks_exact(truth.len() * 3)
            .map(|t| [0, 1, 2].map(|c| light.iter().enumerate().map(|(k, l)| t[3 * k + c] * l[c]).sum()))
            .collect()
    };
    let (e, t) = (irradiance(estimate), irradiance(truth));
    let scale = [0, 1, 2].map(|c| median(&e.iter().zip(&t).map(|(e, t)| t[c] / e[c].max(1e-9)).collect::<Vec<_>>()));
    let relative: Vec<f64> =
        e.iter().zip(&t).flat_map(|(e, t)| [0, 1, 2].map(|c| (e[c] * scale[c] / t[c].max(1e-9) - 1.0).abs())).collect();
    (median(&relative), percentile(&relative, 0.9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        assert_eq!(percentile(&[1.0, 2.0, 3.0, 4.0], 0.5), 2.5);
        assert_eq!(adjusted_rand_index(&[0, 0, 1, 1], &[5, 5, 2, 2]), 1.0);
        // scikit-learn: adjusted_rand_score([0, 0, 1, 2], [0, 0, 1, 1]) = 0.5714...
        assert!((adjusted_rand_index(&[0, 0, 1, 2], &[0, 0, 1, 1]) - 4.0 / 7.0).abs() < 1e-12);
        assert_eq!(area_under_curve(&[0.1, 0.4, 0.35, 0.8], &[false, false, true, true]), Some(0.75));
        assert_eq!(area_under_curve(&[0.1], &[true]), None);
    }
}
