//! Veiling glare in the observations of the surface: how much it can be, and without it.

use crate::association::light_field::LightField;
use crate::association::lit_color::lit_colors;
use crate::association::observations::{Association, Observation};
use crate::association::veil::without;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;

/// Share of the observations that may be darker than their veil: noise.
const DARKER: f64 = 0.001;

/// The veil in the observations at a share of 1.
pub struct VeilOfAll {
    /// V over the exposure's gain, linear RGB like the observation's colour: `[observation]`.
    of_observation: Vec<Vec3>,
    /// Mean over the observations: `[vertex]`.
    pub of_vertex: Vec<Vec3>,
    /// The share at which the darkest observations are all veil; infinite where there is no veil.
    pub most: f64,
}

impl Association {
    /// The veil in every observation, at a share of 1.
    #[must_use]
    pub fn veil(&self, mesh: &Mesh) -> VeilOfAll {
        let cameras: Vec<_> = self.views.iter().map(|v| v.world_from_camera.inverse()).collect();
        let one = |o: &Observation| {
            let j = o.keyframe as usize;
            let Some(veil) = &self.veils[j] else { return Vec3::ZERO };
            let p = cameras[j].transform(mesh.positions[o.vertex as usize].as_dvec3());
            let gain = self.views[j].gain.map(|g| g as f32);
            veil.over(p) / Vec3::from_array(gain)
        };
        let of_observation: Vec<Vec3> = self.observations.par_iter().map(one).collect();
        let share = |(o, veil): (&Observation, &Vec3)| {
            let least = (0..3).map(|c| o.color[c] / veil[c]).fold(f32::INFINITY, f32::min);
            (!o.clipped && least.is_finite()).then_some(least)
        };
        let mut shares: Vec<f32> = self.observations.iter().zip(&of_observation).filter_map(share).collect();
        shares.sort_unstable_by(f32::total_cmp);
        let most = shares.get((DARKER * shares.len() as f64) as usize).map_or(f64::INFINITY, |s| f64::from(*s));
        let mean = |row: &[u32]| {
            let range = row[0] as usize..row[1] as usize;
            let weighted = self.observations[range.clone()].iter().zip(&of_observation[range]);
            let (sum, weight) = weighted.fold((Vec3::ZERO, 0.0), |(s, w), (o, v)| (s + o.weight * *v, w + o.weight));
            if weight > 0.0 { sum / weight } else { Vec3::ZERO }
        };
        let of_vertex = self.offsets.windows(2).map(mean).collect();
        VeilOfAll { of_observation, of_vertex, most }
    }

    /// Takes `share` of the veil from every observation, and finds the lit colours again (Eq. 2). Exposures stay.
    pub fn take_veil(&mut self, veil: &VeilOfAll, share: f64) {
        let gains: Vec<Vec3> = self.views.iter().map(|v| Vec3::from_array(v.gain.map(|g| g as f32))).collect();
        let raw = |(o, v): (&Observation, &Vec3)| {
            let color = without(Vec3::from_array(o.color), *v * share as f32) * gains[o.keyframe as usize];
            Observation { color: color.to_array(), ..*o }
        };
        let observations = self.observations.iter().zip(&veil.of_observation).map(raw).collect();
        let field = LightField { observations, offsets: std::mem::take(&mut self.offsets) };
        let lit = lit_colors(&field, &self.views);
        (self.lit_color, self.lit_weight) = (lit.color, lit.weight);
        let exposed = |o: &Observation| {
            let color = Vec3::from_array(o.color) / gains[o.keyframe as usize];
            Observation { color: color.to_array(), ..*o }
        };
        self.observations = field.observations.iter().map(exposed).collect();
        self.offsets = field.offsets;
        self.lens.veil_share = share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::keyframe_image::KeyframeImage;
    use crate::association::lampless_air::LamplessAir;
    use crate::association::observations::Lens;
    use crate::association::veil::Veil;
    use crate::association::vignetting::Vignetting;
    use recordings::types::{CameraModel, Distortion, Intrinsics};

    /// The veil of a picture whose right quarter is white.
    fn window() -> Veil {
        let (width, height) = (160, 120);
        let camera = Intrinsics { width, height, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };
        let data = (0..width * height).flat_map(|i| [if i % width >= 120 { 255 } else { 0 }; 3]).collect();
        let table = std::array::from_fn(|i| i as f32 / 255.0);
        let lens = CameraModel { intrinsics: camera, distortion: Distortion::NONE };
        Veil::of(&KeyframeImage { camera, data, vignetting: Vignetting::default() }, &lens, &table, 250)
    }

    #[test]
    fn the_veil_of_a_window_is_taken_from_what_it_lay_over() {
        // One vertex of true colour 0.02 straight ahead of a camera with a window beside it.
        let veil = window();
        let mesh = Mesh { positions: vec![Vec3::Z], normals: vec![-Vec3::Z], ..Mesh::default() };
        let (share, color, gain) = (0.04, 0.02_f32, 2.0_f32);
        let seen = color / gain + share as f32 * veil.at(79.5, 59.5).y / gain;
        let view = crate::association::RefinedView {
            world_from_camera: recordings::types::Pose::IDENTITY,
            gain: [f64::from(gain); 3],
            residual_px: 0.0,
        };
        let observation = Observation { vertex: 0, keyframe: 0, color: [seen; 3], weight: 1.0, clipped: false };
        let mut fields = Association {
            lit_color: vec![Vec3::splat(seen)],
            lit_weight: vec![1.0],
            reliability: vec![1.0],
            clipped: vec![false],
            views: vec![view],
            observations: vec![observation],
            offsets: vec![0, 1],
            veils: vec![Some(veil)],
            lens: Lens::default(),
            seen_lamps: Vec::new(),
            lampless_air: LamplessAir::default(),
            decisions: Vec::new(),
            dark_below: 0.0,
            exposure: firmware_config::tuning::ExposureTuning::default(),
        };
        let veil = fields.veil(&mesh);
        let most = f64::from(seen * gain / (veil.of_vertex[0].y * gain));
        assert!((veil.most - most).abs() < 1e-6 && veil.most > share, "{} {most}", veil.most);
        fields.take_veil(&veil, share);
        let off = fields.lit_color[0] - Vec3::splat(color / gain);
        assert!(off.abs().max_element() < 1e-5 && fields.lens.veil_share == share, "{}", fields.lit_color[0]);
    }
}
