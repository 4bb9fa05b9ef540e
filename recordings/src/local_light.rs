//! Light that is not distant: lamps beside the scene, surfaces that emit, and the model of light that was chosen.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Model of the light. Stored as postcard: a variant is never moved, new ones stand at the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightModel {
    /// All light comes from infinity, or is reflected as Eq. (8) says.
    #[default]
    Distant,
    /// Distant light, and secondary light as it was observed.
    Secondary,
    /// The same, and lamps beside the scene.
    Lamps,
    /// The same, and surfaces that emit.
    Emitters,
    /// Lamps and emitting surfaces.
    LampsAndEmitters,
    /// A smooth function of position and normal explains the colours better than any of these.
    Unexplained,
}

impl LightModel {
    /// The name in files and tables. Secondary light is no source: with distant light alone the model is "distant".
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Distant | Self::Secondary => "distant",
            Self::Lamps => "lamps",
            Self::Emitters => "emitters",
            Self::LampsAndEmitters => "lamps+emitters",
            Self::Unexplained => "unexplained",
        }
    }
}

impl fmt::Display for LightModel {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A lamp beside the scene: a sphere that radiates evenly. The sun, and what else has no place, is a thousand scene sizes away.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lamp {
    /// Centre, world, metres.
    pub center: [f32; 3],
    /// Radius, metres.
    pub radius_m: f32,
    /// Linear RGB radiance, in units of the light.
    pub radiance: [f64; 3],
}

/// A piece of the mesh that emits from its front.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Emitter {
    /// Its vertices, ascending.
    pub vertices: Vec<u32>,
    /// Linear RGB radiance, in units of the light.
    pub radiance: [f64; 3],
}

/// The part of the light that is not distant.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LocalLight {
    /// Model that was chosen.
    pub model: LightModel,
    /// Lamps beside the scene.
    pub lamps: Vec<Lamp>,
    /// Emitting pieces of the mesh.
    pub emitters: Vec<Emitter>,
}

impl LocalLight {
    /// Radiance that each of `vertices` vertices emits: `[vertex]`, linear RGB.
    #[must_use]
    pub fn emission(&self, vertices: usize) -> Vec<Vec3> {
        let mut emission = vec![Vec3::ZERO; vertices];
        for emitter in &self.emitters {
            for &i in &emitter.vertices {
                emission[i as usize] = Vec3::from_array(emitter.radiance.map(|x| x as f32));
            }
        }
        emission
    }

    /// What makes this no light of a mesh with so many vertices, if anything.
    pub(crate) fn check(&self, vertices: usize) -> Result<(), String> {
        let sound = |radiance: &[f64; 3]| radiance.iter().all(|x| x.is_finite() && *x >= 0.0);
        for lamp in &self.lamps {
            let placed = lamp.center.iter().all(|x| x.is_finite()) && lamp.radius_m.is_finite() && lamp.radius_m > 0.0;
            if !placed || !sound(&lamp.radiance) {
                return Err("a lamp holds numbers that make no sense".into());
            }
        }
        for emitter in &self.emitters {
            if emitter.vertices.iter().any(|i| *i as usize >= vertices) || !sound(&emitter.radiance) {
                return Err("an emitting piece holds numbers that make no sense".into());
            }
        }
        Ok(())
    }
}
