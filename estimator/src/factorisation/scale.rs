//! The factor per channel that albedo × light leaves free (Eq. 9). While light and albedo are solved for, the brightest
//! segment fixes it; that of the answer is fixed by a surface of known albedo, or by what is likely (S1).

use crate::factorisation::albedo::{self, Detail};
use crate::factorisation::problem::{Colors, KnownAlbedo};
use crate::factorisation::scale_prior::Surface;
use crate::factorisation::solution::Solution;
use crate::numerics::robust::median;
use firmware_config::tuning::FactorisationTuning;
use glam::{DVec3, Vec3};
use recordings::decision::{Decision, ScaleBasis};

/// Deviation of a scale that nothing has fixed yet, per channel.
pub const UNKNOWN: [f64; 3] = [f64::INFINITY; 3];

/// Albedo and light of one answer, which share the free factor.
pub struct Scaled<'a> {
    /// Light and segment albedos.
    pub solution: &'a mut Solution,
    /// Albedo and confidence per vertex.
    pub detail: &'a mut Detail,
    /// Irradiance over π per vertex.
    pub irradiance: &'a mut [Vec3],
    /// Relative standard deviation of the scale as it is, per channel, where secondary light fixes it.
    pub deviation: [f64; 3],
}

/// What fixed the scale, and how it was changed.
pub struct Fixed {
    /// Factors of the albedo.
    pub factor: DVec3,
    /// The evidence.
    pub decision: Decision,
}

/// Fixes the factor of albedo and light, and bounds the albedo to what is plausible.
pub fn fix(scaled: Scaled, colors: &Colors, tuning: &FactorisationTuning) -> Fixed {
    let Scaled { solution, detail, irradiance, deviation } = scaled;
    let surface = Surface::sampled(solution, detail, irradiance, colors);
    let known = colors.known.and_then(|k| Some((factor_of(k, detail)?, k)));
    let (log_factor, basis) = match known {
        Some((factor, known)) => (factor, ScaleBasis::Reference { albedo: known.albedo }),
        None => surface.likely(deviation, tuning),
    };
    let factor = DVec3::from_array(log_factor.map(libm::exp));
    let factor = if factor.is_finite() && factor.min_element() > 0.0 { factor } else { DVec3::ONE };
    let decision = surface.decision(factor, basis, tuning);
    solution.scale(factor, factor.recip());
    let (of_albedo, of_light) = (factor.as_vec3(), factor.recip().as_vec3());
    detail.albedo.iter_mut().for_each(|a| *a = albedo::plausible(*a * of_albedo));
    irradiance.iter_mut().for_each(|e| *e *= of_light);
    Fixed { factor, decision }
}

/// Scales albedo and light so that the brightest large segment has the same albedo in every solution, per channel: what is
/// compared and bounced while solving then has one scale. Returns the factor of the albedo.
pub(super) fn normalise(solution: &mut Solution, colors: &Colors, tuning: &FactorisationTuning) -> DVec3 {
    let seen = colors.seen();
    let factor = [0, 1, 2].map(|c| {
        let albedo: Vec<f64> = solution.albedo.iter().map(|a| a[c]).collect();
        let factor = tuning.normalised_albedo / brightest_large(&albedo, &seen, tuning);
        if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }
    });
    let factor = DVec3::from_array(factor);
    solution.scale(factor, factor.recip());
    factor
}

/// Logarithm of the factor that gives a surface its known albedo in the median. `None` where it has none yet.
fn factor_of(known: &KnownAlbedo, detail: &Detail) -> Option<[f64; 3]> {
    let mut log_factor = [0.0; 3];
    for (c, out) in log_factor.iter_mut().enumerate() {
        let found = median(known.vertices.iter().filter_map(|i| Some(detail.albedo.get(*i as usize)?[c])))?;
        *out = libm::log(known.albedo[c] / f64::from(found));
    }
    log_factor.iter().all(|x| x.is_finite()).then_some(log_factor)
}

/// Largest albedo of a channel among the segments with the minimum share of the seen vertices. `albedo` and `seen` are
/// `[segment]`.
pub(super) fn brightest_large(albedo: &[f64], seen: &[f64], tuning: &FactorisationTuning) -> f64 {
    let min_seen = tuning.scale_min_share * seen.iter().sum::<f64>();
    let large = albedo.iter().zip(seen).filter(|(_, n)| **n >= min_seen && **n > 0.0).map(|(a, _)| *a);
    large.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::graph::Graph;
    use proptest::prelude::*;

    /// Plain surfaces (albedo, vertices) under even light: albedo, irradiance and what `fix` makes of them.
    struct Scene {
        lit_color: Vec<Vec3>,
        segment: Vec<u32>,
        solution: Solution,
        detail: Detail,
        irradiance: Vec<Vec3>,
    }

    impl Scene {
        /// `gauge` is the factor of the albedo that the factorisation left in.
        fn new(surfaces: &[(Vec3, usize)], light: Vec3, gauge: Vec3) -> Self {
            let segment: Vec<u32> = (0u32..).zip(surfaces).flat_map(|(s, (_, n))| vec![s; *n]).collect();
            let albedo: Vec<Vec3> = segment.iter().map(|s| surfaces[*s as usize].0).collect();
            let row = (light / gauge).to_array().map(f64::from);
            Self {
                lit_color: albedo.iter().map(|a| *a * light).collect(),
                irradiance: vec![light / gauge; segment.len()],
                solution: Solution {
                    light: vec![row],
                    standard_deviation: vec![row],
                    radiance: vec![row],
                    albedo: surfaces.iter().map(|(a, _)| (*a * gauge).to_array().map(f64::from)).collect(),
                    held_out: 0.0,
                    regularisation: [0.0; 3],
                    condition: 1.0,
                },
                detail: Detail {
                    albedo: albedo.iter().map(|a| *a * gauge).collect(),
                    confidence: vec![1.0; segment.len()],
                    painted: vec![1.0; segment.len()],
                },
                segment,
            }
        }

        fn fix(&mut self, known: Option<&KnownAlbedo>, deviation: [f64; 3]) -> Fixed {
            let Self { lit_color, segment, solution, detail, irradiance } = self;
            let lit_weight = vec![1.0; segment.len()];
            let segments = solution.albedo.len();
            let clipped = vec![false; segment.len()];
            let colors = Colors {
                lit_color,
                lit_weight: &lit_weight,
                reliability: &[],
                clipped: &clipped,
                segment,
                segments,
                graph: &Graph::new(0, &[]),
                known,
            };
            fix(Scaled { solution, detail, irradiance, deviation }, &colors, &FactorisationTuning::default())
        }
    }

    const BROWN: Vec3 = Vec3::new(0.43, 0.26, 0.13);

    fn degrees(a: Vec3, b: Vec3) -> f32 {
        a.angle_between(b).to_degrees()
    }

    #[test]
    fn a_brown_table_stays_brown_and_paper_stays_white() {
        let paper = Vec3::splat(0.8);
        let mut scene = Scene::new(&[(BROWN, 900), (paper, 100)], Vec3::ONE, Vec3::new(3.0, 0.5, 1.4));
        scene.fix(None, UNKNOWN);
        let [table, sheet] = [0, 950].map(|i| scene.detail.albedo[i]);
        assert!(degrees(table, BROWN) < 3.0 && degrees(sheet, paper) < 3.0, "{table} {sheet}");
        assert!((table / BROWN - 1.0).abs().max_element() < 0.1, "{table}");
        // The product is what was seen.
        let seen = scene.detail.albedo[0] * scene.irradiance[0];
        assert!((seen / scene.lit_color[0] - 1.0).abs().max_element() < 1e-5, "{seen}");
    }

    #[test]
    fn white_things_tell_the_colour_of_the_light() {
        let (white, light) = (Vec3::splat(0.8), Vec3::new(1.1, 1.0, 0.9));
        let angle = |surfaces: &[(Vec3, usize)]| {
            let mut scene = Scene::new(surfaces, light, Vec3::ONE);
            scene.fix(None, UNKNOWN);
            degrees(scene.detail.albedo[0], surfaces[0].0)
        };
        let grey = Vec3::splat(0.25);
        let [without, with] = [angle(&[(grey, 1000)]), angle(&[(grey, 700), (white, 150), (white * 0.95, 150)])];
        assert!(with < 0.7 * without && without < 5.0, "{with} instead of {without} degrees");
    }

    #[test]
    fn a_known_albedo_is_kept_to_and_says_so() {
        let mut scene = Scene::new(&[(BROWN, 50), (Vec3::splat(0.3), 50)], Vec3::new(2.0, 1.0, 0.5), Vec3::ONE);
        let known = KnownAlbedo { vertices: vec![60, 61, 62], albedo: [0.3, 0.3, 0.3] };
        let fixed = scene.fix(Some(&known), [0.01; 3]);
        assert!((scene.detail.albedo[0] / BROWN - 1.0).abs().max_element() < 1e-5);
        let basis = ScaleBasis::Reference { albedo: [0.3; 3] };
        assert!(matches!(fixed.decision, Decision::AlbedoScale { chosen, .. } if chosen == basis));
    }

    #[test]
    fn secondary_light_keeps_the_level_but_not_albedos_above_one() {
        let level = |albedo: f32, deviation: [f64; 3]| {
            let mut scene = Scene::new(&[(Vec3::splat(albedo), 100)], Vec3::ONE, Vec3::ONE);
            scene.fix(None, deviation);
            scene.detail.albedo[0].y
        };
        assert!((level(0.3, [0.01; 3]) - 0.3).abs() < 0.02 && (level(0.3, UNKNOWN) - 0.8).abs() < 1e-3);
        assert!((level(1.6, [0.01; 3]) - 0.95).abs() < 1e-3);
    }

    #[test]
    fn where_nothing_is_seen_nothing_changes_and_where_nothing_is_known_the_rule_holds() {
        let mut scene = Scene::new(&[(BROWN, 10)], Vec3::ONE, Vec3::ONE);
        scene.detail.confidence.fill(0.0);
        assert_eq!(scene.fix(None, UNKNOWN).factor, DVec3::ONE);
        let mut scene = Scene::new(&[(BROWN, 10)], Vec3::ONE, Vec3::ONE);
        scene.detail.albedo[3] = Vec3::ZERO;
        let known = KnownAlbedo { vertices: vec![3], albedo: [0.5; 3] };
        let Decision::AlbedoScale { chosen, .. } = scene.fix(Some(&known), UNKNOWN).decision else { panic!() };
        assert_eq!(chosen, ScaleBasis::Likely);
    }

    proptest! {
        /// What the factorisation happened to leave in makes no difference.
        #[test]
        fn the_answer_does_not_depend_on_the_factor_before(r in 0.01f32..100.0, g in 0.01f32..100.0, b in 0.01f32..100.0) {
            let surfaces = [(BROWN, 60), (Vec3::new(0.7, 0.75, 0.8), 30), (Vec3::splat(0.05), 10)];
            let albedo = |gauge: Vec3| {
                let mut scene = Scene::new(&surfaces, Vec3::new(1.2, 1.0, 0.8), gauge);
                scene.fix(None, UNKNOWN);
                scene.detail.albedo[0]
            };
            let (one, other) = (albedo(Vec3::ONE), albedo(Vec3::new(r, g, b)));
            prop_assert!((one / other - 1.0).abs().max_element() < 1e-2, "{one} {other}");
        }
    }
}
