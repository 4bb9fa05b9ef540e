//! Test of the camera's response. Two images of one surface at two exposures show linear light that differs by one factor at
//! every brightness, if the response is right. All powers of the right response pass the test alike (Grossberg and Nayar,
//! "Modeling the space of camera response functions", 2004): it separates sRGB from a power law, but not two power laws.

use crate::association::observations::{Association, Observation};
use crate::numerics::robust::median;
use firmware_config::tuning::ResponseTuning;
use recordings::decision::{Decision, ResponseTest, Warning};
use recordings::types::Response;
use std::collections::BTreeMap;

/// The evidence for the stated `response`, and a warning if another response fits better.
pub fn verify(association: &Association, response: &Response, tuning: &ResponseTuning) -> (Decision, Option<Warning>) {
    let shared = shared(association, response, tuning);
    let stated = *response;
    let values: usize = shared.values().map(Vec::len).sum();
    let test = (!shared.is_empty()).then(|| {
        // One power represents all powers.
        let alternative = if stated == Response::Srgb { Response::Gamma(2.2) } else { Response::Srgb };
        ResponseTest {
            alternative,
            stated_change: change(&shared, tuning.levels, &stated),
            alternative_change: change(&shared, tuning.levels, &alternative),
        }
    });
    let contradicted = |t: &ResponseTest| {
        t.stated_change > tuning.max_change && t.stated_change >= tuning.clear_ratio * t.alternative_change
    };
    let warning = test.filter(contradicted).map(|t| Warning::ResponseMismatch { stated, better: t.alternative });
    let decision = Decision::Response {
        stated,
        values: values as u32,
        min_exposure_ratio: tuning.min_exposure_ratio,
        min_shared: tuning.min_shared,
        test,
    };
    (decision, warning)
}

/// (keyframe, keyframe, channel) → encoded values (0..1) of the same points in both keyframes.
type Shared = BTreeMap<(u16, u16, usize), Vec<[f64; 2]>>;

/// The observations with the smallest and the largest gain of each vertex.
fn shared(association: &Association, response: &Response, tuning: &ResponseTuning) -> Shared {
    let gain = |k: u16| association.views[usize::from(k)].gain;
    let mean_gain = |k: u16| gain(k).iter().product::<f64>();
    let mut shared = Shared::new();
    for row in association.offsets.windows(2) {
        let seen = &association.observations[row[0] as usize..row[1] as usize];
        let by_gain = |a: &&_, b: &&_| {
            let g = |o: &Observation| mean_gain(o.keyframe);
            g(a).total_cmp(&g(b))
        };
        let (Some(low), Some(high)) = (seen.iter().min_by(by_gain), seen.iter().max_by(by_gain)) else { continue };
        let (g_low, g_high) = (gain(low.keyframe), gain(high.keyframe));
        if libm::cbrt(mean_gain(high.keyframe) / mean_gain(low.keyframe)) < tuning.min_exposure_ratio {
            continue;
        }
        for c in 0..3 {
            let value = |color: f32, gain: f64| value(response, f64::from(color) * gain);
            let pair = [value(low.color[c], g_low[c]), value(high.color[c], g_high[c])];
            if pair.iter().all(|v| (tuning.min_value..tuning.max_value).contains(v)) {
                shared.entry((low.keyframe, high.keyframe, c)).or_default().push(pair);
            }
        }
    }
    shared.retain(|_, pairs| pairs.len() >= tuning.min_shared as usize);
    shared
}

/// RMS change of the log factor between two images over `levels` of brightness, relative to the factor.
fn change(shared: &Shared, levels: u32, response: &Response) -> f64 {
    let (mut sum, mut count) = (0.0, 0u32);
    for pairs in shared.values() {
        let mut by_level: Vec<[f64; 2]> = pairs
            .iter()
            .map(|[a, b]| [a + b, libm::log(response.linear_from_value(*b) / response.linear_from_value(*a))])
            .collect();
        by_level.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let whole = median(by_level.iter().map(|p| p[1])).unwrap_or(0.0);
        for level in by_level.chunks(by_level.len().div_ceil(levels as usize)) {
            let d = median(level.iter().map(|p| p[1])).unwrap_or(0.0) / whole - 1.0;
            if d.is_finite() {
                sum += d * d;
                count += 1;
            }
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

/// Encoded value of linear light; 0 for negative light.
fn value(response: &Response, linear: f64) -> f64 {
    response.value_from_linear(linear.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::lampless_air::LamplessAir;
    use crate::association::observations::{Lens, RefinedView};
    use firmware_config::tuning::ExposureTuning;
    use glam::Vec3;
    use recordings::types::Pose;

    /// A surface of many shades, taken by a camera with response `real` at two exposures `ratio` apart, and associated with
    /// response `stated`.
    fn association(real: Response, stated: Response, ratio: f64) -> Association {
        let n = 4000;
        let mut observations = Vec::new();
        let gain = |c: usize| {
            // The solution of Eq. (5): a median of ratios.
            let shades = (0..n).map(|i| (i as f64 + 0.5) / f64::from(n));
            let l = |x: f64| stated.linear_from_value(value(&real, x));
            let ratios = shades.map(|s| l(0.5 * s) / l(0.5 * s / ratio));
            median(ratios).unwrap_or(0.0) * [1.0, 1.02, 0.97][c]
        };
        let gains = [[1.0; 3], [gain(0), gain(1), gain(2)]];
        for i in 0..n {
            let shade = (f64::from(i) + 0.5) / f64::from(n);
            for (k, exposure) in [0.5 / ratio, 0.5].into_iter().enumerate() {
                let color = [0, 1, 2].map(|c| {
                    let white = if k == 0 { 1.0 } else { [1.0, 1.02, 0.97][c] };
                    let noise = 0.004 * (f64::from((i * 37 + c as i32 * 11 + k as i32 * 5) % 17) / 8.0 - 1.0);
                    (stated.linear_from_value(value(&real, shade * exposure * white) + noise) / gains[k][c]) as f32
                });
                observations.push(Observation {
                    vertex: i as u32,
                    keyframe: k as u16,
                    color,
                    weight: 1.0,
                    clipped: false,
                });
            }
        }
        let view = |gain| RefinedView { world_from_camera: Pose::IDENTITY, gain, residual_px: 0.0 };
        Association {
            veils: Vec::new(),
            lens: Lens::default(),
            seen_lamps: Vec::new(),
            lampless_air: LamplessAir::default(),
            lit_color: vec![Vec3::ONE; n as usize],
            lit_weight: vec![1.0; n as usize],
            reliability: vec![1.0; n as usize],
            clipped: Vec::new(),
            views: gains.map(view).to_vec(),
            observations,
            offsets: (0..=n as u32).map(|i| 2 * i).collect(),
            decisions: Vec::new(),
            dark_below: 0.004,
            exposure: ExposureTuning::default(),
        }
    }

    #[test]
    fn a_right_response_is_confirmed_and_a_wrong_one_reported() {
        let (linear, gamma) = (Response::Linear, Response::Gamma(2.2));
        for (real, stated, fits) in [
            (Response::Srgb, Response::Srgb, true),
            (linear, linear, true),
            (gamma, gamma, true),
            // Powers of each other.
            (linear, gamma, true),
            (linear, Response::Srgb, false),
            (gamma, Response::Srgb, false),
            (Response::Srgb, gamma, false),
            (Response::Srgb, linear, false),
        ] {
            let (decision, warning) = verify(&association(real, stated, 4.0), &stated, &ResponseTuning::default());
            assert_eq!(warning.is_none(), fits, "{real:?} as {stated:?}: {decision:?} {warning:?}");
        }
    }

    #[test]
    fn exposures_too_close_are_not_tested() {
        let (decision, warning) =
            verify(&association(Response::Srgb, Response::Srgb, 1.3), &Response::Srgb, &ResponseTuning::default());
        assert!(warning.is_none() && matches!(decision, Decision::Response { test: None, .. }), "{decision:?}");
    }
}
