//! Exposures from matte surfaces only: gloss brightens an image as an exposure does.

use crate::association::exposure;
use crate::association::exposure_patches::{ExposureProblem, Known};
use crate::association::light_field::LightField;
use crate::association::lit_color::lit_colors;
use crate::association::observations::{Association, Observation, are_exposed};
use firmware_config::ExposureChoice;
use recordings::types::Mesh;

impl Association {
    /// Estimates exposures and lit colours again (Eqs. 5 and 2) with `matte`, `[vertex]`, known. Glossy vertices keep a small
    /// weight. Returns the RMS change of the log gains; `None`, without a change, if most keyframes see too little matte
    /// surface or exposures are not estimated at all.
    pub fn expose_by(&mut self, matte: &[bool], mesh: &Mesh, median_edge: f32) -> Option<f64> {
        let estimated = are_exposed(&self.views);
        let rgb = self.views.iter().any(|v| v.gain[0] != v.gain[1] || v.gain[1] != v.gain[2]);
        // [keyframe][glossy, matte]: sums of weights.
        let mut shares = vec![[0.0f64; 2]; self.views.len()];
        for o in &self.observations {
            shares[o.keyframe as usize][usize::from(matte[o.vertex as usize])] += f64::from(o.weight);
        }
        let is_enough = |[glossy, matte]: &&[f64; 2]| *matte > self.exposure.min_matte_share * (glossy + matte);
        let enough = shares.iter().filter(is_enough).count();
        if !estimated || 2 * enough <= shares.len() {
            return None;
        }
        let glossy_weight = self.exposure.glossy_weight as f32;
        let gains: Vec<[f32; 3]> = self.views.iter().map(|v| v.gain.map(|g| g as f32)).collect();
        let raw = |o: &Observation| {
            let weight = if matte[o.vertex as usize] { o.weight } else { glossy_weight * o.weight };
            let gain = gains[o.keyframe as usize];
            Observation { color: std::array::from_fn(|c| o.color[c] * gain[c]), weight, ..*o }
        };
        let mut field =
            LightField { observations: self.observations.iter().map(raw).collect(), offsets: self.offsets.clone() };
        let choice = if rgb { ExposureChoice::Rgb } else { ExposureChoice::Scalar };
        let problem = ExposureProblem {
            mesh,
            median_edge,
            keyframes: self.views.len(),
            dark_below: self.dark_below,
            veils: &self.veils,
            lens: None,
            known: Known::Poses,
            tuning: &self.exposure,
        };
        let new = exposure::solve(&field, &problem, &self.views, choice).gains;
        let mut moved = 0.0;
        let pairs = self.views.iter_mut().zip(&new).zip(&shares);
        // A keyframe that was left out keeps its gain.
        for ((view, new), _) in pairs.filter(|(_, [glossy, matte])| glossy + matte > 0.0) {
            moved += view.gain.iter().zip(new).map(|(a, b)| libm::log(b / a).powi(2)).sum::<f64>() / 3.0;
            view.gain = *new;
        }
        let moved = libm::sqrt(moved / self.views.len() as f64);
        field.observations.iter_mut().zip(&self.observations).for_each(|(raw, o)| raw.weight = o.weight);
        let lit = lit_colors(&field, &self.views);
        (self.lit_color, self.lit_weight) = (lit.color, lit.weight);
        for (o, raw) in self.observations.iter_mut().zip(&field.observations) {
            let gain = self.views[o.keyframe as usize].gain;
            o.color = std::array::from_fn(|c| raw.color[c] / gain[c] as f32);
        }
        Some(moved)
    }
}
