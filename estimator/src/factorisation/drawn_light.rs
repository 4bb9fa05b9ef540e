//! What surfaces do not tell of the light: its colour in single directions, and directions that no surface faces.
//!
//! Channels are solved one by one, and a few hundred directions have more freedom than the surfaces' irradiance shows: their spots
//! come out green, pink and blue. Here the channels are drawn to the radiance that they have in common, and then to the radiance that
//! keyframes saw beyond the scan, each as strongly as the irradiance of held-out surface allows: lit colours have errors of their own, in which
//! a tint of all that is seen would drown. Albedos stay.

use crate::factorisation::joint_solution::{JointSolution, mean_radiance};
use crate::factorisation::light_form::{LightForm, Prior};
use crate::factorisation::problem::Observed;
use crate::factorisation::projection::Projection;
use crate::factorisation::robust_solver::Channel;
use crate::factorisation::seen_background::SeenBackground;
use crate::factorisation::solution::{Solution, zip3};
use crate::factorisation::statistics::{Statistics, samples};
use firmware_config::tuning::FactorisationTuning;
use nalgebra::DVector;
use rayon::prelude::*;

/// Weights of a prior that are tried, strongest first.
const WEIGHTS: [f64; 9] = [10.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0];
/// So much may each prior change the irradiance of held-out vertices, RMS relative to it. A tint of surfaces is seen sooner than that of the
/// light beyond them.
const MOST_OF_CHROMA: f64 = 0.01;
const MOST_OF_BACKGROUND: f64 = 0.03;
/// But no more than this share of what light leaves unexplained of held-out lit colours: plain surface tells it well.
const MOST_OF_UNEXPLAINED: f64 = 0.1;

/// The weight chosen, and the evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// Weight of the prior.
    pub weight: f64,
    /// Weights tried, strongest first, and RMS relative distance from the irradiance of held-out vertices.
    pub held_out: Vec<(f64, f64)>,
}

/// What the light was drawn to.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// The radiance that the channels have in common.
    pub chroma: Chosen,
    /// What keyframes saw beyond the scan; `None` where they saw nothing.
    pub background: Option<Chosen>,
}

/// The light of `solution` in at most so many bands, which lights a [`White`](crate::factorisation::White) surface as nearly the same as it
/// can. Segments' albedos stay.
#[must_use]
pub fn narrowed(white: &Observed, solution: &Solution, bands: usize, tuning: &FactorisationTuning) -> Solution {
    let cut = |rows: &[[f64; 3]]| {
        let (harmonics, sun) = rows.split_at(solution.harmonics().len());
        [&harmonics[..harmonics.len().min(bands * bands)], sun].concat()
    };
    let (light, standard_deviation) = (cut(&solution.light), cut(&solution.standard_deviation));
    let mut narrowed = Solution { light, standard_deviation, ..solution.clone() };
    let projection = Projection::of(white.transfer, narrowed.bands());
    // Where the light is dark in a channel, the other bands are left out as they are.
    if let Some(fits) = channels(white, solution, &projection, tuning) {
        let states: Vec<JointSolution> = fits.par_iter().map(|f| f.towards(&f.found(), tuning)).collect();
        set_light(&mut narrowed, &fits, &states, &projection);
    }
    narrowed
}

/// The light of `solution` on a white surface, channel by channel; `None` where it is dark in one.
fn channels<'a>(
    white: &Observed,
    solution: &Solution,
    projection: &'a Projection,
    tuning: &FactorisationTuning,
) -> Option<Vec<Fit<'a>>> {
    let samples = samples(white, tuning);
    let fit = |c: usize| Fit::new(&Channel::new(white, &samples, c, tuning), solution, projection);
    [0, 1, 2].into_par_iter().map(fit).collect()
}

/// Takes over the light of the channels.
fn set_light(solution: &mut Solution, fits: &[Fit], states: &[JointSolution], projection: &Projection) {
    let lights: Vec<DVector<f64>> = states.iter().map(|s| s.light(projection)).collect();
    solution.light = zip3(projection.coefficients(), &|c, i| fits[c].level * lights[c][i]);
    solution.radiance = zip3(projection.directions(), &|c, i| fits[c].level * states[c].radiance[i]);
}

/// Gives the light of `solution` the strongest priors that held-out vertices of a [`White`](crate::factorisation::White) surface allow.
/// Changes coefficients and radiance only. `None` where the light is dark in a channel, and where no vertex is held out.
#[must_use]
pub fn draw(
    white: &Observed,
    solution: &mut Solution,
    background: &SeenBackground,
    tuning: &FactorisationTuning,
) -> Option<Drawn> {
    let projection = Projection::of(white.transfer, solution.bands());
    let fits = channels(white, solution, &projection, tuning)?;
    if fits.iter().any(|f| f.held_out.iter().all(|s| s.square <= 0.0)) {
        return None;
    }
    let grey = fits.iter().map(|f| &f.state.radiance).sum::<DVector<f64>>() / 3.0;
    let alike = |f: &Fit, weight: f64| f.found().drawn_to(&grey, |_| weight);
    let most = |most: f64| most.min(MOST_OF_UNEXPLAINED * solution.held_out);
    let (chroma, mut states) =
        strongest(&fits, &projection, tuning, most(MOST_OF_CHROMA), |c, weight| alike(&fits[c], weight))?;
    let seen = if background.is_empty() {
        None
    } else {
        let center = |c: usize| background.relative_to(c, fits[c].level, &states[c].radiance);
        let centers = [0, 1, 2].map(center);
        let towards = |c: usize, weight: f64| {
            alike(&fits[c], chroma.weight).drawn_to(&centers[c], |d| weight * background.share(d))
        };
        let (chosen, drawn) = strongest(&fits, &projection, tuning, most(MOST_OF_BACKGROUND), towards)?;
        states = drawn;
        Some(chosen)
    };
    set_light(solution, &fits, &states, &projection);
    Some(Drawn { chroma, background: seen })
}

/// The strongest weight of a prior, for channel and weight, that changes the irradiance of held-out vertices by at most `most`, and what it
/// makes of the channels.
fn strongest(
    fits: &[Fit],
    projection: &Projection,
    tuning: &FactorisationTuning,
    most: f64,
    prior: impl Fn(usize, f64) -> Prior + Sync,
) -> Option<(Chosen, Vec<JointSolution>)> {
    let trial = |weight: f64| {
        let drawn = |(c, fit): (usize, &Fit)| fit.towards(&prior(c, weight), tuning);
        let states: Vec<JointSolution> = fits.par_iter().enumerate().map(drawn).collect();
        let error = |(f, s): (&Fit, &JointSolution)| s.relative_square_error(&f.held_out, projection);
        (weight, fits.iter().zip(&states).map(error).sum::<f64>() / 3.0, states)
    };
    let mut tried: Vec<_> = WEIGHTS.into_par_iter().map(&trial).collect();
    let most = tried[WEIGHTS.len() - 1].1 + most * most;
    let first = tried.iter().position(|t| t.1 <= most)?;
    // A weight of the grid would jump where an error crosses the limit.
    if let Some(stronger) = first.checked_sub(1) {
        let (below, above) = (&tried[first], &tried[stronger]);
        let share = ((most - below.1) / (above.1 - below.1)).clamp(0.0, 1.0);
        let between = trial(interpolated(below.0, above.0, share));
        if between.1 <= most {
            tried.insert(first, between);
        }
    }
    let held_out = tried.iter().map(|t| (t.0, libm::sqrt(t.1))).collect();
    let (weight, _, states) = tried.swap_remove(first);
    Some((Chosen { weight, held_out }, states))
}

/// The weight a `share` of the way from `low` to `high`, in logarithms; linearly from 0.
fn interpolated(low: f64, high: f64, share: f64) -> f64 {
    if low > 0.0 { low * libm::pow(high / low, share) } else { high * share }
}

/// One channel.
struct Fit<'a> {
    /// Mean radiance 1.
    state: JointSolution,
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
        let level = mean_radiance(&state.radiance);
        if !(level > 0.0 && level.is_finite()) {
            return None;
        }
        state.radiance /= level;
        state.albedo = vec![level];
        let folds =
            channel.folds(&channel.robust_weights(&channel.predict(&state, projection), &state.albedo), projection);
        let form = LightForm::new(&folds.fitted, &state.albedo, projection);
        Some(Self { state, form, held_out: folds.held_out, regularisation: channel.regularisation(solution), level })
    }

    /// The prior that holds what was found.
    fn found(&self) -> Prior {
        Prior::found(&self.state.radiance, self.regularisation)
    }

    /// The same level with another prior.
    fn towards(&self, prior: &Prior, tuning: &FactorisationTuning) -> JointSolution {
        let held = prior.held(&self.form, tuning);
        let radiance = self.form.clone().solved(prior, &held, &self.state.radiance);
        JointSolution { radiance, albedo: self.state.albedo.clone() }
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

    fn noisy(i: usize) -> f32 {
        1.0 + 0.03 * (libm::sinf(i as f32 * 12.9898) * 43758.547).fract()
    }

    /// A grey ball in light from above, of which `tint` of the blue comes from below. Colours have errors of 3 %. Mean distance of the
    /// channels' coefficients, relative to the light, before and after; and the share of blue that the light has from below.
    fn ball(tint: f32) -> (f64, f64, f64) {
        let normals: Vec<Vec3> = sh::even_directions(4000).iter().map(|d| d.as_vec3().normalize()).collect();
        let mesh = Mesh { positions: normals.clone(), normals: normals.clone(), ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, 5)), bounced: None };
        let light = |n: &Vec3, sign: f32| 0.5 + 0.4 * sign * n.z;
        let color = |(i, n): (usize, &Vec3)| {
            let blue = (1.0 - tint) * light(n, 1.0) + tint * light(n, -1.0);
            Vec3::new(light(n, 1.0) * noisy(3 * i), light(n, 1.0) * noisy(3 * i + 1), blue * noisy(3 * i + 2))
        };
        let lit_color: Vec<Vec3> = normals.iter().enumerate().map(color).collect();
        let n = normals.len();
        let observed = Observed {
            transfer: &transfer,
            lit_color: &lit_color,
            lit_weight: &vec![1.0; n],
            reliability: &[],
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
        let irradiance = transfer.irradiance(&solution.light);
        let white = Observed { lit_color: &irradiance, ..observed };
        draw(&white, &mut solution, &SeenBackground::default(), &tuning).expect("light in every channel");
        assert_eq!(solution.albedo, albedo);
        let irradiance = transfer.irradiance(&solution.light);
        let bottom = (0..n).min_by(|a, b| normals[*a].z.total_cmp(&normals[*b].z)).expect("a ball");
        let blue = irradiance[bottom].z * albedo[0][2] as f32 / (irradiance[bottom].x * albedo[0][0] as f32);
        (before, apart(&solution), f64::from(blue))
    }

    #[test]
    fn a_weight_between_two_of_the_grid_lies_on_the_way_from_one_to_the_other() {
        assert_eq!(interpolated(0.1, 10.0, 0.0), 0.1);
        assert!((interpolated(0.1, 10.0, 0.5) - 1.0).abs() < 1e-12);
        assert!((interpolated(0.1, 10.0, 1.0) - 10.0).abs() < 1e-12);
        assert_eq!(interpolated(0.0, 0.001, 0.25), 0.00025);
    }

    #[test]
    fn directions_that_no_surface_tells_take_what_was_seen_there() {
        // Surface that faces up, in even light and with errors of 3 %; red and bright below.
        let normals: Vec<Vec3> = sh::even_directions(30_000).iter().map(|d| d.as_vec3().normalize()).collect();
        let normals: Vec<Vec3> = normals.into_iter().filter(|n| n.z > 0.7).collect();
        let n = normals.len();
        let mesh = Mesh { positions: normals.clone(), normals, ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, 5)), bounced: None };
        let observed = Observed {
            transfer: &transfer,
            lit_color: &(0..n).map(|i| Vec3::splat(noisy(i))).collect::<Vec<_>>(),
            lit_weight: &vec![1.0; n],
            reliability: &[],
            clipped: &vec![false; n],
            segment: &vec![0; n],
            segments: 1,
        };
        let tuning = FactorisationTuning::default();
        let mut solution = robust_solver::solve(&observed, 5, None, &tuning);
        let below = |d: Vec3, low: Vec3| if d.z < -0.6 { Some((d, low, false)) } else { None };
        let seen = |low: Vec3| {
            let all = sh::even_directions(4000).into_iter().filter_map(move |d| below(d.as_vec3().normalize(), low));
            SeenBackground::new(all, 1.0 / 4000.0)
        };
        let level = solution.radiance.iter().map(|r| r[0]).sum::<f64>() / solution.radiance.len() as f64;
        let low = Vec3::new(3.0, 1.0, 1.0) * level as f32;
        let irradiance = transfer.irradiance(&solution.light);
        let white = Observed { lit_color: &irradiance, ..observed };
        let drawn = draw(&white, &mut solution, &seen(low), &tuning).expect("light in every channel");
        assert!(drawn.background.expect("something was seen").weight > 0.0);
        let light = sh::radiance(&solution.light, glam::DVec3::NEG_Z).map(|c| c / level);
        assert!(light[0] > 2.0 && light[1] < 1.6, "{light:?} where 3, 1 and 1 were seen");
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
