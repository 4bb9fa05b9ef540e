//! Gloss that the views of single vertices bear out.

use crate::numerics::robust::median;
use crate::specular::gloss::Gloss;
use crate::specular::observations::MirrorObservation;
use rayon::prelude::*;

/// Shares of a fitted weight that are tried.
const SHARES: [f64; 2] = [1.0, 0.5];

/// The fitted gloss of a segment, or less of it, so that the views of its vertices (`views`: `[vertex][view]`) agree no worse once it
/// is taken away; matte if they never do, or if what is left is less than `min_significance` standard errors. Neither irradiance nor
/// albedo enters. The fit bounds what single views say, and sees no mirrored surface; so where the light is wrong, it finds gloss
/// that tears the views apart.
pub(super) fn borne_out(views: &[Vec<MirrorObservation>], fitted: Gloss, min_significance: f64) -> Gloss {
    let as_seen = disagreement(views, &Gloss::NONE);
    let agrees = |gloss: &Gloss| disagreement(views, gloss) <= as_seen;
    SHARES
        .map(|share| fitted.shrunk(share))
        .into_iter()
        .filter(|gloss| gloss.lobe_weight > min_significance * gloss.error)
        .find(agrees)
        .unwrap_or(Gloss { error: fitted.error, ..Gloss::NONE })
}

/// Sum over vertices and channels of how far the views, without this gloss, are from their median: shares of the lit colour, each at
/// most 1.
fn disagreement(found: &[Vec<MirrorObservation>], gloss: &Gloss) -> f64 {
    let of_vertex = |views: &Vec<MirrorObservation>| -> f64 {
        let of_channel = |c: usize| {
            let middle = median(views.iter().map(|o| o.matte(gloss, c))).unwrap_or(0.0);
            let share =
                |o: &MirrorObservation| ((o.matte(gloss, c) - middle).abs() / o.lit[c].max(f64::MIN_POSITIVE)).min(1.0);
            views.iter().map(share).sum::<f64>()
        };
        (0..3).map(of_channel).sum()
    };
    let sums: Vec<f64> = found.par_iter().map(of_vertex).collect();
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specular::gloss::LOBES;

    /// Views of a grey vertex whose mirror direction shows this radiance.
    fn views(seen: [f64; 4], mirror: [f64; 4]) -> Vec<Vec<MirrorObservation>> {
        let of = |k: usize| MirrorObservation {
            seen: [seen[k]; 3],
            lit: [0.5; 3],
            irradiance: [1.0; 3],
            mirror: [[mirror[k]; 3]; LOBES.len()],
            weight: 1.0,
            keyframe: k,
        };
        vec![(0..4).map(of).collect()]
    }

    #[test]
    fn gloss_is_what_makes_the_views_agree() {
        let fitted =
            |lobe_weight| Gloss { significant: true, lobe_weight, w_s: lobe_weight, error: 0.01, ..Gloss::NONE };
        let matte = Gloss { error: 0.01, ..Gloss::NONE };
        let glossy = views([0.52, 0.51, 0.49, 0.48], [1.2, 1.1, 0.9, 0.8]);
        assert_eq!(borne_out(&glossy, fitted(0.1), 3.0), fitted(0.1));
        assert_eq!(borne_out(&glossy, fitted(0.24), 3.0), fitted(0.24).shrunk(0.5), "a level that is too high");
        assert_eq!(borne_out(&glossy, fitted(0.24), 15.0), matte, "half of it is nothing that stands out");
        let other_light = views([0.5, 0.5, 0.5, 0.5], [1.0, 1.0, 9.0, 1.0]);
        assert_eq!(borne_out(&other_light, fitted(0.1), 3.0), matte, "a light that is not there");
    }
}
