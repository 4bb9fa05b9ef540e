//! Exposure gains of the keyframes (Eq. 5), jointly over all vertices in the log domain.

use crate::association::Observation;
use firmware_config::ExposureChoice;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use recordings::result::Decision;

const CHUNK: usize = 4096;
const ROUNDS: usize = 12;
/// Tukey's constant: 95 % efficient on Gaussian noise.
const TUKEY: f64 = 4.685;

/// One logarithm of a sample: vertex, keyframe, log colour, weight.
struct Entry {
    keyframe: u16,
    log: [f64; 3],
    weight: f64,
}

/// Gains g_j per channel (picture = gain · radiance), geometric mean 1, and what was decided. `observations` hold the
/// pictures' own linear values, sorted by vertex by `offsets`.
pub fn solve(
    observations: &[Observation],
    offsets: &[u32],
    keyframes: usize,
    choice: ExposureChoice,
    dark: f32,
) -> (Vec<[f64; 3]>, Option<Decision>) {
    let neutral = vec![[1.0; 3]; keyframes];
    if choice == ExposureChoice::None || keyframes < 2 {
        return (neutral, None);
    }
    let rows = entries(observations, offsets, dark);
    if rows.is_empty() {
        return (neutral, None);
    }
    let all = |_: usize| true;
    let scalar = || fit(&rows, keyframes, false, &all);
    let rgb = || fit(&rows, keyframes, true, &all);
    let (logs, decision) = match choice {
        ExposureChoice::None => return (neutral, None),
        ExposureChoice::Scalar => (scalar(), None),
        ExposureChoice::Rgb => (rgb(), None),
        ExposureChoice::Auto => {
            // Gains from one half of the vertices have to predict the other half.
            let half = |r: usize| r.is_multiple_of(2);
            let other = |r: usize| !r.is_multiple_of(2);
            let [ignored, one, three] =
                [vec![[0.0; 3]; keyframes], fit(&rows, keyframes, false, &half), fit(&rows, keyframes, true, &half)]
                    .map(|logs| held_out(&rows, &logs, &other));
            let use_rgb = three < 0.99 * one;
            let decision = Decision {
                name: "exposure".into(),
                choice: if use_rgb { "rgb" } else { "scalar" }.into(),
                evidence: format!(
                    "median log residual of held-out vertices: none {ignored:.4}, scalar {one:.4}, rgb {three:.4}"
                ),
                next_level: if use_rgb { String::new() } else { format!("rgb gains: {three:.4}") },
            };
            (if use_rgb { rgb() } else { scalar() }, Some(decision))
        }
    };
    (logs.iter().map(|l| l.map(libm::exp)).collect(), decision)
}

fn entries(observations: &[Observation], offsets: &[u32], dark: f32) -> Vec<Vec<Entry>> {
    offsets
        .windows(2)
        .filter_map(|w| {
            let row: Vec<Entry> = observations[w[0] as usize..w[1] as usize]
                .iter()
                .filter(|o| o.weight > 0.0 && o.color.iter().all(|&c| c > dark))
                .map(|o| Entry {
                    keyframe: o.keyframe,
                    log: o.color.map(|c| libm::log(f64::from(c))),
                    weight: f64::from(o.weight),
                })
                .collect();
            (row.len() >= 2).then_some(row)
        })
        .collect()
}

/// Sums of one chunk of vertices: normal matrix, one right-hand side per channel.
struct Sums {
    matrix: DMatrix<f64>,
    right: [DVector<f64>; 3],
}

/// Log gains by iteratively reweighted least squares: log I_vj = log f_v + log g_j, log f_v eliminated.
fn fit(rows: &[Vec<Entry>], keyframes: usize, rgb: bool, used: &(dyn Fn(usize) -> bool + Sync)) -> Vec<[f64; 3]> {
    let mut logs = vec![[0.0; 3]; keyframes];
    let mut scale = f64::INFINITY;
    for _ in 0..ROUNDS {
        let parts: Vec<Sums> = rows
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(chunk, part)| {
                let mut sums = Sums {
                    matrix: DMatrix::zeros(keyframes, keyframes),
                    right: std::array::from_fn(|_| DVector::zeros(keyframes)),
                };
                for (_, row) in part.iter().enumerate().filter(|(i, _)| used(chunk * CHUNK + i)) {
                    accumulate(row, &logs, scale, &mut sums);
                }
                sums
            })
            .collect();
        let mut total = Sums {
            matrix: DMatrix::zeros(keyframes, keyframes),
            right: std::array::from_fn(|_| DVector::zeros(keyframes)),
        };
        for part in &parts {
            total.matrix += &part.matrix;
            for c in 0..3 {
                total.right[c] += &part.right[c];
            }
        }
        let step = solve_centred(&total, rgb);
        let moved = logs.iter().zip(&step).flat_map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs())).fold(0.0, f64::max);
        logs = step;
        let residuals = residuals(rows, &logs, used);
        let next = (1.4826 * median(residuals)).max(1e-4);
        let settled = moved < 1e-6 && (next / scale - 1.0).abs() < 1e-3;
        scale = next;
        if settled {
            break;
        }
    }
    logs
}

/// Adds one vertex: the weights follow its residuals about its own robust mean.
fn accumulate(row: &[Entry], logs: &[[f64; 3]], scale: f64, sums: &mut Sums) {
    let centre = centre(row, logs);
    let mut weights = Vec::with_capacity(row.len());
    // A vertex whose views disagree (gloss, wrong pose) tells little with any of them.
    let mut spread = 0.0;
    let mut weight_sum = 0.0;
    for e in row {
        let r2 = residual2(e, logs, &centre);
        let x = r2 / (scale * scale * TUKEY * TUKEY);
        let robust = if scale.is_infinite() {
            1.0
        } else if x < 1.0 {
            (1.0 - x) * (1.0 - x)
        } else {
            0.0
        };
        weights.push(e.weight * robust);
        spread += e.weight * r2.min(scale * scale * TUKEY * TUKEY);
        weight_sum += e.weight;
    }
    if scale.is_finite() && weight_sum > 0.0 {
        let trust = scale * scale / (scale * scale + spread / weight_sum);
        weights.iter_mut().for_each(|w| *w *= trust * trust);
    }
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return;
    }
    let mean: [f64; 3] =
        std::array::from_fn(|c| row.iter().zip(&weights).map(|(e, w)| w * e.log[c]).sum::<f64>() / total);
    for (a, wa) in row.iter().zip(&weights) {
        let i = a.keyframe as usize;
        sums.matrix[(i, i)] += wa;
        for ((right, log), mean) in sums.right.iter_mut().zip(&a.log).zip(&mean) {
            right[i] += wa * (log - mean);
        }
        for (b, wb) in row.iter().zip(&weights) {
            sums.matrix[(i, b.keyframe as usize)] -= wa * wb / total;
        }
    }
}

/// Weighted median per channel of the exposure-free logs.
fn centre(row: &[Entry], logs: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|c| {
        let mut values: Vec<(f64, f64)> =
            row.iter().map(|e| (e.log[c] - logs[e.keyframe as usize][c], e.weight)).collect();
        weighted_median(&mut values)
    })
}

/// Mean squared residual over the channels.
fn residual2(e: &Entry, logs: &[[f64; 3]], centre: &[f64; 3]) -> f64 {
    let l = &logs[e.keyframe as usize];
    (0..3).map(|c| (e.log[c] - l[c] - centre[c]) * (e.log[c] - l[c] - centre[c])).sum::<f64>() / 3.0
}

fn residuals(rows: &[Vec<Entry>], logs: &[[f64; 3]], used: &(dyn Fn(usize) -> bool + Sync)) -> Vec<f64> {
    let parts: Vec<Vec<f64>> = rows
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, part)| {
            let mut out = Vec::new();
            for (i, row) in part.iter().enumerate() {
                if used(chunk * CHUNK + i) {
                    let centre = centre(row, logs);
                    out.extend(row.iter().map(|e| residual2(e, logs, &centre).sqrt()));
                }
            }
            out
        })
        .collect();
    parts.concat()
}

fn held_out(rows: &[Vec<Entry>], logs: &[[f64; 3]], used: &(dyn Fn(usize) -> bool + Sync)) -> f64 {
    median(residuals(rows, logs, used))
}

fn solve_centred(sums: &Sums, rgb: bool) -> Vec<[f64; 3]> {
    let n = sums.matrix.nrows();
    let trace = sums.matrix.trace().max(1e-300) / n as f64;
    let mut matrix = sums.matrix.clone();
    for i in 0..n {
        // The common factor is free, and so is a keyframe without observations: both are held at their prior, 1.
        matrix[(i, i)] += 1e-9 * trace + 1e-12;
        for j in 0..n {
            matrix[(i, j)] += trace / n as f64;
        }
    }
    let mut logs = vec![[0.0; 3]; n];
    let Some(cholesky) = matrix.cholesky() else {
        return logs;
    };
    if rgb {
        let x = sums.right.each_ref().map(|right| cholesky.solve(right));
        logs.iter_mut().enumerate().for_each(|(j, l)| *l = x.each_ref().map(|x| x[j]));
    } else {
        let mean = (&sums.right[0] + &sums.right[1] + &sums.right[2]) / 3.0;
        let x = cholesky.solve(&mean);
        (0..n).for_each(|j| logs[j] = [x[j]; 3]);
    }
    let mean = logs.iter().flatten().sum::<f64>() / (3 * n) as f64;
    logs.iter_mut().flatten().for_each(|l| *l -= mean);
    logs
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The value at which half the weight lies below; the values are sorted in place.
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
