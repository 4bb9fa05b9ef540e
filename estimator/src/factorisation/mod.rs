//! Lit colours into light and albedo: the solver in turn with the transfer that the albedo makes (colour bleeding).

pub mod albedo;
pub mod distance_check;
pub mod paper_solver;
pub mod robust_solver;

use crate::factorisation::albedo::{Detail, Known};
use crate::factorisation::robust_solver::{Observed, Solution};
use crate::transfer::{self, Bounced, Traced, Transfer};
use firmware_config::SolverChoice;
use glam::Vec3;
use std::sync::Arc;

/// Albedo before anything is known of it (a0 of Eq. 10).
pub(crate) const MID_GREY: f32 = 0.5;
/// The free factor per channel is fixed by the brightest segment of at least this share of the seen vertices …
pub(crate) const SCALE_SHARE: f64 = 0.02;
/// … which gets this albedo.
const SCALE_ALBEDO: f64 = 0.75;
/// Bands of the first solution, whose albedo is only there to bounce light.
const FIRST_BANDS: usize = 4;

/// The rule that [`factorise`] fixes the free factor by, in words.
pub const SCALE_RULE: &str =
    "per channel, the brightest segment with at least 2 % of the seen vertices has albedo 0.75";

/// The answer of the factorisation.
#[derive(Debug)]
pub struct Factorised {
    /// Transfer with the albedo found.
    pub transfer: Transfer,
    /// Light and segment albedos, scaled by the rule.
    pub solution: Solution,
    /// Albedo per vertex.
    pub detail: Detail,
    /// Irradiance over π per vertex.
    pub irradiance: Vec<Vec3>,
}

/// How the factorisation is to be done.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Interreflection is modelled.
    pub gi: bool,
    /// SH bands of the light.
    pub bands: usize,
    /// Bands that may be taken instead where gloss had hidden them.
    pub most_bands: usize,
    /// Bounces, the rest in proportion to them; 0 = until they no longer matter.
    pub bounces: u32,
    /// Solver.
    pub solver: SolverChoice,
}

/// Lit colours and segments to be factorised.
#[derive(Debug, Clone, Copy)]
pub struct Colors<'a> {
    /// Lit colour f.
    pub lit_color: &'a [Vec3],
    /// Weight behind it; 0 = never seen.
    pub lit_weight: &'a [f32],
    /// Segment.
    pub segment: &'a [u32],
    /// Number of segments.
    pub segments: usize,
}

impl<'a> Colors<'a> {
    /// The same under a transfer.
    #[must_use]
    pub fn under(&self, transfer: &'a Transfer) -> Observed<'a> {
        let Self { lit_color, lit_weight, segment, segments } = *self;
        Observed { transfer, lit_color, lit_weight, segment, segments }
    }
}

/// An earlier answer.
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
    /// To go on from.
    #[must_use]
    pub fn start(&self) -> Start {
        Start {
            solution: self.solution.clone(),
            albedo: self.detail.albedo.clone(),
            bounced: self.transfer.bounced.clone(),
        }
    }
}

/// Factorises lit colours. Goes on from `start` where an earlier answer stands.
#[must_use]
pub fn factorise(traced: Arc<Traced>, colors: &Colors, settings: &Settings, start: Option<Start>) -> Factorised {
    let Settings { gi, bands, bounces, solver, .. } = *settings;
    let one_segment = vec![0; colors.segment.len()];
    let transfer_error = relative_error(&traced);
    let mut transfer = Transfer { traced, bounced: None };
    let bounce = |transfer: &mut Transfer, albedo: &[Vec3]| {
        if gi {
            // Eq. (8)
            transfer.bounced = Some(match transfer.bounced.take() {
                Some(before) if bounces == 0 => transfer::bounce_on(&transfer.traced, albedo, before),
                _ => transfer::bounce_and_rest(&transfer.traced, albedo, bounces),
            });
        }
    };
    let solve = |transfer: &Transfer, bands: usize, start: Option<&Solution>| {
        let observed = colors.under(transfer);
        // Eqs. (9)–(12).
        let (mut solution, literal) = match solver {
            SolverChoice::Robust => (robust_solver::solve(&observed, bands, start), None),
            SolverChoice::Literal => {
                let (solution, albedo) = paper_solver::solve(&observed, bands);
                (solution, Some(albedo))
            }
            SolverChoice::Nonsegmented => {
                let whole = Observed { segment: &one_segment, segments: 1, ..observed };
                let mut solution = robust_solver::solve(&whole, bands, None);
                solution.albedo = vec![solution.albedo[0]; colors.segments];
                (solution, None)
            }
        };
        let scale = fix_scale(&mut solution, colors);
        let irradiance = transfer.irradiance(&solution.light);
        let known = Known {
            lit_color: colors.lit_color,
            lit_weight: colors.lit_weight,
            irradiance: &irradiance,
            transfer_error: &transfer_error,
            segment: colors.segment,
        };
        let mut detail = albedo::detail(&known, &solution.albedo);
        if let Some(albedo) = literal {
            detail.albedo = albedo.iter().map(|a| (*a * scale).clamp(Vec3::ZERO, Vec3::ONE)).collect();
        }
        (solution, detail, irradiance)
    };
    let (before, albedo) = match start {
        Some(start) => {
            transfer.bounced = start.bounced;
            (Some(start.solution), start.albedo)
        }
        None => {
            // What the albedo is takes no fine light to see.
            bounce(&mut transfer, &vec![Vec3::splat(MID_GREY); colors.lit_color.len()]);
            (None, solve(&transfer, bands.min(FIRST_BANDS), None).1.albedo)
        }
    };
    bounce(&mut transfer, &albedo);
    let (solution, detail, irradiance) = solve(&transfer, bands, before.as_ref());
    Factorised { transfer, solution, detail, irradiance }
}

/// The light that explains the colours with fewer bands than `found` has.
#[must_use]
pub fn narrowed(found: &Factorised, colors: &Colors, bands: usize) -> Solution {
    let mut solution = robust_solver::solve(&colors.under(&found.transfer), bands, Some(&found.solution));
    fix_scale(&mut solution, colors);
    solution
}

/// What a solution under a first transfer says, as a start for [`factorise`].
#[must_use]
pub fn start_from(transfer: Transfer, colors: &Colors, mut solution: Solution) -> Start {
    fix_scale(&mut solution, colors);
    let irradiance = transfer.irradiance(&solution.light);
    let known = Known {
        lit_color: colors.lit_color,
        lit_weight: colors.lit_weight,
        irradiance: &irradiance,
        transfer_error: &relative_error(&transfer.traced),
        segment: colors.segment,
    };
    let albedo = albedo::detail(&known, &solution.albedo).albedo;
    Start { solution, albedo, bounced: transfer.bounced }
}

/// Applies [`SCALE_RULE`]; returns the factors that the albedos were multiplied by.
fn fix_scale(solution: &mut Solution, colors: &Colors) -> Vec3 {
    let mut scale = Vec3::ONE;
    let mut seen = vec![0.0f64; colors.segments];
    for (segment, weight) in colors.segment.iter().zip(colors.lit_weight) {
        if *weight > 0.0 {
            seen[*segment as usize] += 1.0;
        }
    }
    let total: f64 = seen.iter().sum();
    for c in 0..3 {
        let large = |s: &usize| seen[*s] >= SCALE_SHARE * total && seen[*s] > 0.0;
        let brightest = (0..colors.segments).filter(large).map(|s| solution.albedo[s][c]).fold(0.0, f64::max);
        let factor = SCALE_ALBEDO / brightest;
        if factor.is_finite() && factor > 0.0 {
            solution.albedo.iter_mut().for_each(|a| a[c] *= factor);
            let light = solution.light.iter_mut().chain(&mut solution.standard_deviation).chain(&mut solution.radiance);
            light.for_each(|l| l[c] /= factor);
            scale[c] = factor as f32;
        }
    }
    scale
}

/// Error of the transfer relative to its norm over the first bands.
fn relative_error(traced: &Traced) -> Vec<f32> {
    let k = traced.bands * traced.bands;
    traced
        .direct
        .chunks(k)
        .zip(&traced.error)
        .map(|(row, error)| {
            let size = row.iter().take(25).map(|t| t * t).sum::<f32>().sqrt();
            if size > 0.0 { (error / size).min(10.0) } else { 10.0 }
        })
        .collect()
}
