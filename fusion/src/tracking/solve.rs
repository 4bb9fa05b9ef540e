//! The Gauss–Newton step: geometric and photometric system, motion prior, observability.

use crate::tracking::normal_equations::System;
use firmware_config::FusionConfig;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// A photometric system without its two brightness unknowns.
pub struct Eliminated<const N: usize> {
    pub h: SMatrix<f64, N, N>,
    pub b: SVector<f64, N>,
    /// The brightness at x is `offset` − `slope` x.
    offset: SVector<f64, 2>,
    slope: SMatrix<f64, 2, N>,
}

/// Eliminates gain and offset (Schur complement). They have a weak prior, for frames without texture.
pub fn eliminate_brightness<const N: usize>(photo: &System, kept: &[usize; N], weight: f64) -> Eliminated<N> {
    let prior = SMatrix::<f64, 2, 2>::from_diagonal_element(1e-3);
    let h_brightness = SMatrix::<f64, 2, 2>::from_fn(|a, c| weight * photo.symmetric(6 + a, 6 + c)) + prior;
    let coupling = SMatrix::<f64, N, 2>::from_fn(|a, c| weight * photo.symmetric(kept[a], 6 + c));
    let rhs = SVector::<f64, 2>::new(photo.b[6], photo.b[7]) * weight;
    let inverse = h_brightness.try_inverse().unwrap_or_else(SMatrix::zeros);
    let gain = coupling * inverse;
    Eliminated {
        h: SMatrix::from_fn(|a, c| weight * photo.symmetric(kept[a], kept[c])) - gain * coupling.transpose(),
        b: SVector::from_fn(|a, _| weight * photo.b[kept[a]]) - gain * rhs,
        offset: inverse * rhs,
        slope: gain.transpose(),
    }
}

/// A Gauss–Newton step.
pub struct Step {
    /// Projector to the twists that the geometry observes, each with the share that is not noise of the normals.
    pub observed: Matrix6<f64>,
    /// Twist: translation in metres, rotation in radians.
    pub delta: Vector6<f64>,
    /// Change of the brightness gain.
    pub gain: f32,
    /// Change of the brightness offset.
    pub offset: f32,
    /// Smallest over largest eigenvalue of the geometric system, less what noise of the normals adds.
    pub condition: f64,
}

/// Solves for the step. `to_prediction` is the twist from the current pose to the predicted one, `depth` the median depth in
/// metres. Of every direction's geometric measurements counts the share that noise of the normals, which adds `tilted`, does not
/// explain. A direction whose eigenvalue is below `fusion.unobserved_below` of the largest is not observed: texture and the motion
/// prior decide.
pub fn solve(
    geo: &System,
    tilted: &Matrix6<f64>,
    photo: &System,
    to_prediction: &Vector6<f64>,
    depth: f64,
    config: &FusionConfig,
) -> Step {
    // Rotations are scaled to the motion of a point at the median depth.
    let lever = depth.max(0.1);
    let scale = Vector6::new(1.0, 1.0, 1.0, 1.0 / lever, 1.0 / lever, 1.0 / lever);

    let eigen = Matrix6::from_fn(|a, c| geo.symmetric(a, c) * scale[a] * scale[c]).symmetric_eigen();
    let largest = eigen.eigenvalues.max().max(1e-9);
    let rhs = Vector6::from_fn(|a, _| geo.b[a] * scale[a]);
    let tilted = Matrix6::from_fn(|a, c| tilted[(a, c)] * scale[a] * scale[c]);
    let mut h = Matrix6::zeros();
    let mut b = Vector6::zeros();
    let mut observed = Matrix6::zeros();
    let mut smallest = largest;
    for i in 0..6 {
        let axis = eigen.eigenvectors.column(i).into_owned();
        let all = eigen.eigenvalues[i];
        let genuine = (all - axis.dot(&(tilted * axis))).max(0.0);
        smallest = smallest.min(genuine);
        if genuine > config.unobserved_below * largest {
            h += axis * axis.transpose() * genuine;
            b += axis * (genuine / all * axis.dot(&rhs));
            observed += axis * axis.transpose() * (genuine / all);
        }
    }

    let units = Matrix6::from_diagonal(&scale);
    let image = eliminate_brightness(photo, &[0, 1, 2, 3, 4, 5], config.photometric_weight);
    let (h_photo, b_photo) = (units * image.h * units, units * image.b);

    let prior = Vector6::from_fn(|a, _| {
        let sigma = if a < 3 { config.prior_sigma_m } else { config.prior_sigma_rad * lever };
        1.0 / (sigma * sigma)
    });
    let regularisation = prior.component_mul(&to_prediction.component_div(&scale));
    let step = (h + h_photo + Matrix6::from_diagonal(&prior))
        .cholesky()
        .map_or_else(Vector6::zeros, |c| c.solve(&(b + b_photo + regularisation)));
    let delta = step.component_mul(&scale);
    let brightness = image.offset - image.slope * delta;
    Step {
        // For twists in metres and radians.
        observed: units * observed * Matrix6::from_diagonal(&scale.map(|s| 1.0 / s)),
        delta,
        gain: brightness[0] as f32,
        offset: brightness[1] as f32,
        condition: smallest / largest,
    }
}
