//! Veiling glare: the lens scatters a share of the picture's light over the picture, so that black things beside a window turn
//! grey. A pixel gets c + s · V, with V the mean of the picture weighted by 1 / (θ² + θ₀²), θ the angle to the pixel
//! (the small-angle part of the CIE glare function; Vos, "On the cause of disability glare", 1984).

use crate::association::keyframe_image::{KeyframeImage, distorted};
use crate::association::light_field::LightField;
use crate::association::lit_color::lit_colors;
use crate::association::observations::{Association, Observation};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::types::{CameraModel, Intrinsics, Mesh};

/// Cells of a picture: V is smooth.
const COLUMNS: usize = 20;
const ROWS: usize = 15;
/// θ₀, radians.
const CORE_RAD: f64 = 0.06;
/// Every so many pixels are read along each axis.
const STRIDE: usize = 3;
/// A colour keeps this share of itself at least.
const LEAST_LEFT: f32 = 0.05;
/// Share of the observations that may be darker than their veil: noise.
const DARKER: f64 = 0.001;

/// V of one picture, linear RGB before exposure, in cells.
#[derive(Debug, Clone)]
pub struct Veil {
    cells: Vec<Vec3>,
    camera: Intrinsics,
}

impl Veil {
    /// The veil of an undistorted picture. `lens` is its camera, `table` maps 8-bit values to linear light.
    #[must_use]
    pub fn of(image: &KeyframeImage, lens: &CameraModel, table: &[f32; 256]) -> Self {
        let k = image.camera;
        let (width, height) = (k.width as usize, k.height as usize);
        let mut sums = vec![(DVec3::ZERO, 0.0); COLUMNS * ROWS];
        for y in (0..height).step_by(STRIDE) {
            for x in (0..width).step_by(STRIDE) {
                // Beyond the lens the undistorted picture is white.
                let is_white = image.bytes(x, y) == [255; 3];
                if is_white && distorted(lens, x, y).is_none() {
                    continue;
                }
                let color = image.bytes(x, y).map(|b| f64::from(table[b as usize]));
                let sum = &mut sums[y * ROWS / height * COLUMNS + x * COLUMNS / width];
                *sum = (sum.0 + DVec3::from_array(color), sum.1 + 1.0);
            }
        }
        let direction = |cell: usize| {
            let u = ((cell % COLUMNS) as f64 + 0.5) * f64::from(k.width) / COLUMNS as f64;
            let v = ((cell / COLUMNS) as f64 + 0.5) * f64::from(k.height) / ROWS as f64;
            DVec3::new((u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0)
        };
        let directions: Vec<DVec3> = (0..COLUMNS * ROWS).map(|c| direction(c).normalize()).collect();
        let cell = |to: usize| {
            let (mut color, mut total) = (DVec3::ZERO, 0.0);
            for ((sum, count), from) in sums.iter().zip(&directions) {
                // The solid angle of a cell falls with the cube of the cosine to the axis.
                let square = directions[to].distance_squared(*from) + CORE_RAD * CORE_RAD;
                let weight = from.z.powi(3) / square;
                if *count > 0.0 {
                    color += *sum * (weight / count);
                    total += weight;
                }
            }
            (color / f64::max(total, f64::MIN_POSITIVE)).as_vec3()
        };
        Self { cells: (0..COLUMNS * ROWS).map(cell).collect(), camera: k }
    }

    /// V at a pixel.
    #[must_use]
    pub fn at(&self, u: f64, v: f64) -> Vec3 {
        let place = |x: f64, size: u32, cells: usize| {
            let at = ((x + 0.5) / f64::from(size) * cells as f64 - 0.5).clamp(0.0, cells as f64 - 1.0);
            let low = (at as usize).min(cells - 2);
            (low, (at - low as f64) as f32)
        };
        let (x, fx) = place(u, self.camera.width, COLUMNS);
        let (y, fy) = place(v, self.camera.height, ROWS);
        let row = |y: usize| self.cells[y * COLUMNS + x].lerp(self.cells[y * COLUMNS + x + 1], fx);
        row(y).lerp(row(y + 1), fy)
    }
}

/// A colour without this veil.
#[must_use]
pub fn without(color: Vec3, veil: Vec3) -> Vec3 {
    (color - veil).max(color * LEAST_LEFT)
}

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
            let k = &veil.camera;
            let gain = self.views[j].gain.map(|g| g as f32);
            veil.at(k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy) / Vec3::from_array(gain)
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
        self.veil_share = share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::types::Distortion;

    /// A picture of `width` × `height` pixels; `white` tells which are white.
    fn veil(white: impl Fn(u32, u32) -> bool) -> Veil {
        let (width, height) = (160, 120);
        let camera = Intrinsics { width, height, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = pixels.flat_map(|(x, y)| [if white(x, y) { 255 } else { 0 }; 3]).collect();
        let table = std::array::from_fn(|i| i as f32 / 255.0);
        Veil::of(
            &KeyframeImage { camera, data },
            &CameraModel { intrinsics: camera, distortion: Distortion::NONE },
            &table,
        )
    }

    #[test]
    fn an_even_picture_is_its_own_veil() {
        let veil = veil(|_, _| true);
        for (u, v) in [(0.0, 0.0), (80.0, 60.0), (159.0, 119.0)] {
            assert!((veil.at(u, v) - Vec3::ONE).abs().max_element() < 1e-5, "{}", veil.at(u, v));
        }
    }

    #[test]
    fn a_window_veils_what_is_beside_it_most() {
        let veil = veil(|x, _| x >= 120);
        let [near, middle, far] = [110.0, 70.0, 10.0].map(|u| veil.at(u, 60.0).y);
        assert!(near > 1.5 * middle && middle > 1.2 * far && far > 0.0, "{near} {middle} {far}");
        // The weights are normalised: the mean light is kept within what the borders change.
        assert!(veil.at(140.0, 60.0).y < 1.0);
    }

    #[test]
    fn no_colour_gets_black_or_negative() {
        let left = without(Vec3::new(0.1, 0.02, 0.0), Vec3::splat(0.05));
        assert!((left - Vec3::new(0.05, 0.001, 0.0)).abs().max_element() < 1e-6, "{left}");
    }

    #[test]
    fn the_veil_of_a_window_is_taken_from_what_it_lay_over() {
        // One vertex of true colour 0.02 straight ahead of a camera with a window beside it.
        let veil = veil(|x, _| x >= 120);
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
            views: vec![view],
            observations: vec![observation],
            offsets: vec![0, 1],
            veils: vec![Some(veil)],
            veil_share: 0.0,
            decisions: Vec::new(),
            dark_below: 0.0,
            exposure: firmware_config::tuning::ExposureTuning::default(),
        };
        let veil = fields.veil(&mesh);
        let most = f64::from(seen * gain / (veil.of_vertex[0].y * gain));
        assert!((veil.most - most).abs() < 1e-6 && veil.most > share, "{} {most}", veil.most);
        fields.take_veil(&veil, share);
        let off = fields.lit_color[0] - Vec3::splat(color / gain);
        assert!(off.abs().max_element() < 1e-5 && fields.veil_share == share, "{}", fields.lit_color[0]);
    }
}
