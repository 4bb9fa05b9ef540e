//! Solver and transfer in turn.

use crate::factorisation::albedo::{self, Detail, Evidence, plausible};
use crate::factorisation::problem::{Colors, FactorisationOptions, Observed};
use crate::factorisation::solution::{DIRECTIONS, Solution};
use crate::factorisation::{paper_solver, robust_solver, scale};
use crate::numerics::sh;
use crate::transfer::{self, Bounced, Traced, Transfer};
use firmware_config::SolverChoice;
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;
use std::borrow::Cow;
use std::sync::Arc;

/// Where an exchange of the light changes irradiance by a larger factor, neither light is told.
const MOST_EXCHANGED: f32 = 2.0;

/// The answer of the factorisation.
#[derive(Debug)]
pub struct Factorised {
    /// Transfer with the albedo found.
    pub transfer: Transfer,
    /// Light and segment albedos.
    pub solution: Solution,
    /// Albedo and its confidence per vertex.
    pub detail: Detail,
    /// Irradiance over π, linear RGB: `[vertex]`.
    pub irradiance: Vec<Vec3>,
}

/// An earlier answer that a factorisation continues.
#[derive(Debug, Clone)]
pub struct Start {
    solution: Solution,
    albedo: Vec<Vec3>,
    bounced: Option<Bounced>,
}

impl From<Factorised> for Start {
    fn from(found: Factorised) -> Self {
        Self { solution: found.solution, albedo: found.detail.albedo, bounced: found.transfer.bounced }
    }
}

impl Factorised {
    /// A start for another factorisation of other segments, whose albedos are `albedo`, `[segment][channel]`.
    #[must_use]
    pub fn start_with(&self, albedo: Vec<[f64; 3]>) -> Start {
        let mut start = self.start();
        start.solution.albedo = albedo;
        start
    }

    /// A start for another factorisation.
    #[must_use]
    pub fn start(&self) -> Start {
        Start {
            solution: self.solution.clone(),
            albedo: self.detail.albedo.clone(),
            bounced: self.transfer.bounced.clone(),
        }
    }

    /// Albedo per vertex from other lit colours under the same light.
    pub fn detail_of(&mut self, colors: &Colors, tuning: &FactorisationTuning) {
        let errors = self.transfer.traced.relative_errors();
        let evidence = Evidence::new(colors, &self.irradiance, &errors);
        self.detail = albedo::detail(&evidence, &self.solution.albedo, tuning);
    }

    /// Exchanges the light. Paint shows what it showed: as far as a vertex differs from its segment by paint, its albedo makes up
    /// for the change of its irradiance.
    pub fn exchange(&mut self, solution: Solution) {
        let irradiance = self.transfer.irradiance(&solution.light);
        let changes = self.irradiance.iter().zip(&irradiance).zip(&self.detail.painted);
        for (albedo, ((before, after), painted)) in self.detail.albedo.iter_mut().zip(changes) {
            if before.min_element() > 0.0 && after.min_element() > 0.0 {
                let change = (*before / *after).clamp(Vec3::splat(1.0 / MOST_EXCHANGED), Vec3::splat(MOST_EXCHANGED));
                *albedo = plausible(*albedo * change.map(|x| libm::powf(x, *painted)));
            }
        }
        (self.solution, self.irradiance) = (solution, irradiance);
    }

    /// The light in the bands that mirrors show, the sun with the rest: `[k][channel]`.
    #[must_use]
    pub fn mirrored_light(&self) -> Cow<'_, [[f64; 3]]> {
        let light = self.solution.harmonics();
        let mut light = Cow::Borrowed(&light[..light.len().min(sh::MIRRORED_BANDS * sh::MIRRORED_BANDS)]);
        if let (Some(sun), Some(radiance)) = (&self.transfer.traced.sun, self.solution.sun()) {
            let mut y = vec![0.0; light.len()];
            sh::eval(Vec3::from_array(sun.lamp.center).normalize().as_dvec3(), &mut y);
            let share = 4.0 * std::f64::consts::PI / DIRECTIONS as f64;
            let rows = light.to_mut().iter_mut().zip(y);
            rows.for_each(|(l, y)| (0..3).for_each(|c| l[c] += share * y * radiance[c]));
        }
        light
    }
}

/// Factorises lit colours into light and albedo; continues `start` if there is one.
#[must_use]
pub fn factorise(
    traced: Arc<Traced>,
    colors: &Colors,
    options: &FactorisationOptions,
    start: Option<Start>,
) -> Factorised {
    let tuning = options.tuning;
    let mut transfer = Transfer { traced, bounced: None };
    let (before, albedo) = match start {
        Some(start) => {
            transfer.bounced = start.bounced;
            (Some(start.solution), start.albedo)
        }
        None => {
            // The first albedo only bounces light: a few bands suffice for it.
            let grey = vec![Vec3::splat(tuning.initial_albedo as f32); colors.lit_color.len()];
            bounce(&mut transfer, &grey, options);
            let bands = options.bands.min(tuning.first_bands as usize);
            let few = FactorisationOptions { bands, ..*options };
            let first = solve(transfer, colors, &few, None);
            transfer = first.transfer;
            (None, first.detail.albedo)
        }
    };
    bounce(&mut transfer, &albedo, options);
    solve(transfer, colors, options, before.as_ref())
}

/// The irradiance that was found, as the lit colours of one white surface: what another light of the same answer is to show.
#[derive(Debug)]
pub struct White {
    /// `[vertex]`.
    segment: Vec<u32>,
    /// `[vertex]`.
    clipped: Vec<bool>,
}

impl White {
    /// For so many vertices.
    #[must_use]
    pub fn new(vertices: usize) -> Self {
        Self { segment: vec![0; vertices], clipped: vec![false; vertices] }
    }

    /// Under the transfer of `found`, with the weights of `colors`.
    #[must_use]
    pub fn under<'a>(&'a self, found: &'a Factorised, colors: &Colors<'a>) -> Observed<'a> {
        let Self { segment, clipped } = self;
        Observed { lit_color: &found.irradiance, segment, segments: 1, clipped, ..colors.under(&found.transfer) }
    }
}

/// A solution under a first transfer, as a start for [`factorise`].
#[must_use]
pub fn start_from(transfer: Transfer, colors: &Colors, mut solution: Solution, tuning: &FactorisationTuning) -> Start {
    let (detail, _) = normalised(&transfer, colors, &mut solution, None, tuning);
    Start { solution, albedo: detail.albedo, bounced: transfer.bounced }
}

/// Interreflection for an albedo (Eq. 8), if it is modelled. The scale is not final: what would be brighter than any surface
/// bounces like the brightest.
fn bounce(transfer: &mut Transfer, albedo: &[Vec3], options: &FactorisationOptions) {
    if options.gi {
        let albedo: &[Vec3] = &albedo.iter().copied().map(plausible).collect::<Vec<_>>();
        transfer.bounced = Some(match transfer.bounced.take() {
            Some(before) if options.bounces == 0 => transfer::bounce_on(&transfer.traced, albedo, before),
            _ => transfer::bounce_scaled(&transfer.traced, albedo, options.bounces),
        });
    }
}

/// Light and albedo under a transfer (Eqs. 9–12).
fn solve(transfer: Transfer, colors: &Colors, options: &FactorisationOptions, start: Option<&Solution>) -> Factorised {
    let (bands, tuning) = (options.bands, options.tuning);
    let observed = colors.under(&transfer);
    let (mut solution, paper_albedo) = match options.solver {
        SolverChoice::Robust => (robust_solver::solve(&observed, bands, start, tuning), None),
        SolverChoice::Literal => {
            let (solution, albedo) = paper_solver::solve(&observed, bands, tuning);
            (solution, Some(albedo))
        }
        SolverChoice::Nonsegmented => {
            let one_segment = vec![0; colors.segment.len()];
            let whole = Observed { segment: &one_segment, segments: 1, ..observed };
            let mut solution = robust_solver::solve(&whole, bands, None, tuning);
            solution.albedo = vec![solution.albedo[0]; colors.segments];
            (solution, None)
        }
    };
    let (detail, irradiance) = normalised(&transfer, colors, &mut solution, paper_albedo, tuning);
    Factorised { transfer, solution, detail, irradiance }
}

/// Normalises the solution; albedo in detail, and irradiance over π per vertex. `paper_albedo` stands in for the former.
fn normalised(
    transfer: &Transfer,
    colors: &Colors,
    solution: &mut Solution,
    paper_albedo: Option<Vec<Vec3>>,
    tuning: &FactorisationTuning,
) -> (Detail, Vec<Vec3>) {
    let factor = scale::normalise(solution, colors, tuning).as_vec3();
    let irradiance = transfer.irradiance(&solution.light);
    let errors = transfer.traced.relative_errors();
    let mut detail = albedo::detail(&Evidence::new(colors, &irradiance, &errors), &solution.albedo, tuning);
    if let Some(albedo) = paper_albedo {
        detail.albedo = albedo.iter().map(|a| *a * factor).collect();
    }
    (detail, irradiance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factorisation::drawn_light;
    use crate::mesh::graph::Graph;
    use recordings::types::Mesh;

    /// A surface that is seen everywhere, with its lit colours.
    struct Seen {
        lit: Vec<Vec3>,
        weight: Vec<f32>,
        clipped: Vec<bool>,
        segment: Vec<u32>,
        graph: Graph,
    }

    impl Seen {
        fn new(lit: Vec<Vec3>, segment: Vec<u32>) -> Self {
            let (weight, clipped) = (vec![1.0; lit.len()], vec![false; lit.len()]);
            Self { weight, clipped, graph: Graph::new(lit.len(), &[]), lit, segment }
        }

        /// In two segments.
        fn colors(&self) -> Colors<'_> {
            Colors {
                lit_color: &self.lit,
                lit_weight: &self.weight,
                reliability: &[],
                clipped: &self.clipped,
                segment: &self.segment,
                segments: 2,
                graph: &self.graph,
                known: None,
            }
        }
    }

    /// Without interreflection.
    fn options(bands: usize, tuning: &FactorisationTuning) -> FactorisationOptions<'_> {
        FactorisationOptions { gi: false, bands, max_bands: bands, bounces: 0, solver: SolverChoice::Robust, tuning }
    }

    /// A ball in light of four bands. One half is plain, the other has paint in stripes.
    fn striped_ball(tuning: &FactorisationTuning) -> (Factorised, Seen) {
        let normals: Vec<Vec3> = sh::even_directions(2000).iter().map(|d| d.as_vec3()).collect();
        let mesh = Mesh { positions: normals.clone(), normals: normals.clone(), ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, 4)), bounced: None };
        let light: Vec<[f64; 3]> =
            (0..16).map(|k| [[3.0, 0.3, 0.8, -0.4, 0.2, 0.3, -0.2, 0.1, 0.2][k.min(8)]; 3]).collect();
        let paint = |n: &Vec3| if n.x > 0.0 && libm::sinf(20.0 * n.y) > 0.0 { 0.3 } else { 0.6 };
        let lit = transfer.irradiance(&light).iter().zip(&normals).map(|(e, n)| *e * paint(n)).collect();
        let seen = Seen::new(lit, normals.iter().map(|n| u32::from(n.x > 0.0)).collect());
        (factorise(transfer.traced, &seen.colors(), &options(4, tuning), None), seen)
    }

    /// RMS relative distance of albedo × irradiance from the lit colours, where there is paint.
    fn off(found: &Factorised, lit: &[Vec3]) -> f64 {
        let shown = found.detail.albedo.iter().zip(&found.irradiance).map(|(a, e)| *a * *e);
        let painted = shown.zip(lit).zip(&found.detail.painted).filter(|(_, painted)| **painted > 0.5);
        let squares: Vec<f64> = painted.map(|((s, f), _)| f64::from(s.x / f.x - 1.0).powi(2)).collect();
        assert!(squares.len() > 500, "{} vertices with paint", squares.len());
        f64::sqrt(squares.iter().sum::<f64>() / squares.len() as f64)
    }

    #[test]
    fn another_light_leaves_what_paint_shows_and_what_plain_surface_is() {
        let tuning = FactorisationTuning::default();
        let (mut found, Seen { lit, .. }) = striped_ball(&tuning);
        let (before, albedo) = (off(&found, &lit), found.detail.albedo.clone());
        let mut tinted = found.solution.clone();
        tinted.light.iter_mut().for_each(|l| l[0] *= 1.2);
        found.exchange(tinted);
        assert!(off(&found, &lit) < before + 0.01, "{} instead of {before}", off(&found, &lit));
        for (i, painted) in found.detail.painted.iter().enumerate().filter(|(_, painted)| **painted < 0.05) {
            let change = found.detail.albedo[i].x / albedo[i].x;
            assert!((change - 1.0).abs() < 0.01, "{change} where the share of paint is {painted}");
        }
    }

    #[test]
    fn fewer_bands_light_the_surface_like_all() {
        let tuning = FactorisationTuning::default();
        let (found, seen) = striped_ball(&tuning);
        // A cosine hardly has a fourth band.
        let white = White::new(seen.lit.len());
        let fewer = drawn_light::narrowed(&white.under(&found, &seen.colors()), &found.solution, 3, &tuning);
        assert_eq!((fewer.light.len(), &fewer.albedo), (9, &found.solution.albedo));
        let irradiance = found.transfer.irradiance(&fewer.light);
        for (before, after) in found.irradiance.iter().zip(irradiance) {
            assert!((after.x / before.x - 1.0).abs() < 0.02, "{after} instead of {before}");
        }
    }

    /// White specks on a brown ball: they hold less surface than what fixes the scale while solving.
    #[test]
    fn small_surfaces_may_be_brighter_than_the_brightest_large_one() {
        let albedo = [Vec3::new(0.3, 0.2, 0.1), Vec3::splat(0.8)];
        let normals: Vec<Vec3> = crate::factorisation::directions().iter().map(|d| d.as_vec3().normalize()).collect();
        let mesh = Mesh { positions: normals.clone(), normals, ..Mesh::default() };
        let segment: Vec<u32> = (0..mesh.positions.len()).map(|i| u32::from(i % 80 == 7)).collect();
        let lit_color: Vec<Vec3> = segment.iter().map(|s| albedo[*s as usize] * Vec3::new(1.0, 0.9, 0.8)).collect();
        let seen = Seen::new(lit_color, segment);
        let tuning = FactorisationTuning::default();
        let traced = Arc::new(transfer::unoccluded(&mesh, 2));
        let found = factorise(traced, &seen.colors(), &options(2, &tuning), None);
        let ratio = found.detail.albedo[7] / found.detail.albedo[0];
        let wrong = (ratio / (albedo[1] / albedo[0]) - 1.0).abs().max_element();
        assert!(wrong < 0.05, "{ratio} instead of {}", albedo[1] / albedo[0]);
    }
}
