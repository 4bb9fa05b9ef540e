//! Colour of the light, direction by direction, as far as surfaces tell it.
//!
//! Channels are solved one by one, and a few hundred directions have more freedom than the surfaces' irradiance shows: their spots
//! come out green, pink and blue. Here the channels are drawn to the radiance that they have in common, as strongly as the colours of
//! held-out surface allow. Albedos stay.

use crate::factorisation::alternation::{Alternation, LightForm, Prior};
use crate::factorisation::problem::Observed;
use crate::factorisation::projection::Projection;
use crate::factorisation::robust_solver::Channel;
use crate::factorisation::solution::{DIRECTIONS, Solution, zip3};
use crate::factorisation::statistics::{Statistics, samples};
use firmware_config::tuning::FactorisationTuning;
use nalgebra::DVector;
use rayon::prelude::*;

/// Weights of the prior that are tried, strongest first.
const WEIGHTS: [f64; 8] = [1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0];
/// The RMS relative error on held-out vertices may rise by this share: a richer model must explain more than that.
const MOST_RISE: f64 = 0.02;

/// The weight chosen, and the evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Chroma {
    /// Weight of the prior.
    pub weight: f64,
    /// Weights tried, strongest first, and RMS relative error on held-out vertices.
    pub held_out: Vec<(f64, f64)>,
}

/// Gives the light of `solution` the strongest prior on a common radiance that held-out vertices allow. Changes coefficients and
/// radiance only. `None` where the light is dark in a channel, and where no vertex is held out.
#[must_use]
pub fn draw_together(observed: &Observed, solution: &mut Solution, tuning: &FactorisationTuning) -> Option<Chroma> {
    let samples = samples(observed, tuning);
    let projection = Projection::new(solution.light.len());
    let fit = |c: usize| Fit::new(&Channel::new(observed, &samples, c, tuning), solution, &projection);
    let fits = [0, 1, 2].into_par_iter().map(fit).collect::<Option<Vec<Fit>>>()?;
    if fits.iter().any(|f| f.held_out.iter().all(|s| s.square <= 0.0)) {
        return None;
    }
    let grey = fits.iter().map(|f| &f.state.radiance).sum::<DVector<f64>>() / 3.0;
    let trial = |weight: f64| {
        let states: Vec<Alternation> = fits.par_iter().map(|f| f.towards(&grey, weight, tuning)).collect();
        let error = |(f, s): (&Fit, &Alternation)| s.relative_square_error(&f.held_out, &projection);
        (weight, fits.iter().zip(&states).map(error).sum::<f64>() / 3.0, states)
    };
    let tried = WEIGHTS.map(trial);
    let most = (1.0 + MOST_RISE) * (1.0 + MOST_RISE) * tried[WEIGHTS.len() - 1].1;
    let held_out = tried.iter().map(|t| (t.0, libm::sqrt(t.1))).collect();
    let (weight, _, states) = tried.into_iter().find(|t| t.1 <= most)?;
    let lights: Vec<DVector<f64>> = states.iter().map(|s| s.light(&projection)).collect();
    solution.light = zip3(projection.coefficients(), &|c, i| fits[c].level * lights[c][i]);
    solution.radiance = zip3(DIRECTIONS, &|c, i| fits[c].level * states[c].radiance[i]);
    Some(Chroma { weight, held_out })
}

/// One channel.
struct Fit<'a> {
    /// Mean radiance 1.
    state: Alternation,
    /// Of the samples that are fitted.
    form: LightForm<'a>,
    /// `[segment]`.
    held_out: Vec<Statistics>,
    regularisation: f64,
    /// Mean radiance of the solution.
    level: f64,
}

impl<'a> Fit<'a> {
    fn new(channel: &Channel, solution: &Solution, projection: &'a Projection) -> Option<Self> {
        let mut state = channel.state_of(solution);
        let level = state.radiance.mean();
        if !(level > 0.0 && level.is_finite()) {
            return None;
        }
        state.radiance /= level;
        state.albedo.iter_mut().for_each(|a| *a *= level);
        let folds =
            channel.folds(&channel.robust_weights(&channel.predict(&state, projection), &state.albedo), projection);
        let form = LightForm::new(&folds.fitted, &state.albedo, projection);
        Some(Self { state, form, held_out: folds.held_out, regularisation: channel.regularisation(solution), level })
    }

    /// The same albedos with a prior of this weight on the radiance `grey`.
    fn towards(&self, grey: &DVector<f64>, weight: f64, tuning: &FactorisationTuning) -> Alternation {
        let mut state = self.state.clone();
        state.light_alone(&self.form, &Prior::grey(self.regularisation, weight, grey), tuning);
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factorisation::robust_solver;
    use crate::numerics::sh;
    use crate::transfer::{self, Transfer};
    use glam::Vec3;
    use recordings::types::Mesh;
    use std::sync::Arc;

    /// A grey ball in light from above, of which `tint` of the blue comes from below. Colours have errors of 3 %. Mean distance of the
    /// channels' coefficients, relative to the light, before and after; and the share of blue that the light has from below.
    fn ball(tint: f32) -> (f64, f64, f64) {
        let normals: Vec<Vec3> = sh::even_directions(4000).iter().map(|d| d.as_vec3().normalize()).collect();
        let mesh = Mesh { positions: normals.clone(), normals: normals.clone(), ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, 5)), bounced: None };
        let noise = |i: usize| 1.0 + 0.03 * (libm::sinf(i as f32 * 12.9898) * 43758.547).fract();
        let light = |n: &Vec3, sign: f32| 0.5 + 0.4 * sign * n.z;
        let color = |(i, n): (usize, &Vec3)| {
            let blue = (1.0 - tint) * light(n, 1.0) + tint * light(n, -1.0);
            Vec3::new(light(n, 1.0) * noise(3 * i), light(n, 1.0) * noise(3 * i + 1), blue * noise(3 * i + 2))
        };
        let lit_color: Vec<Vec3> = normals.iter().enumerate().map(color).collect();
        let n = normals.len();
        let observed = Observed {
            transfer: &transfer,
            lit_color: &lit_color,
            lit_weight: &vec![1.0; n],
            clipped: &vec![false; n],
            segment: &vec![0; n],
            segments: 1,
        };
        let tuning = FactorisationTuning::default();
        let mut solution = robust_solver::solve(&observed, 5, None, &tuning);
        let albedo = solution.albedo.clone();
        let apart = |s: &Solution| {
            let relative = |c: usize| s.light.iter().map(move |l| l[c] / s.light[0][c]);
            let off: f64 = relative(0).zip(relative(1)).map(|(r, g)| (r - g) * (r - g)).sum();
            libm::sqrt(off)
        };
        let before = apart(&solution);
        draw_together(&observed, &mut solution, &tuning).expect("light in every channel");
        assert_eq!(solution.albedo, albedo);
        let irradiance = transfer.irradiance(&solution.light);
        let bottom = (0..n).min_by(|a, b| normals[*a].z.total_cmp(&normals[*b].z)).expect("a ball");
        let blue = irradiance[bottom].z * albedo[0][2] as f32 / (irradiance[bottom].x * albedo[0][0] as f32);
        (before, apart(&solution), f64::from(blue))
    }

    #[test]
    fn errors_do_not_color_the_light() {
        let (before, after, _) = ball(0.0);
        assert!(after < 0.3 * before, "{before} before, {after} after");
    }

    #[test]
    fn light_whose_color_surfaces_tell_keeps_it() {
        // Below, red has 0.1 and blue 0.1 · 0.7 + 0.9 · 0.3 = 0.34.
        let (_, _, blue) = ball(0.3);
        assert!((3.0..3.8).contains(&blue), "{blue} instead of 3.4");
    }
}
