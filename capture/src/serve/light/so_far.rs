//! What is known of the light, as clients see it.

use glam::Vec3;
use recordings::result::Light;
use recordings::types::Mesh;
use serde::Serialize;

/// Directions over the sphere.
const DIRECTIONS: usize = 128;
/// A surface tells of the light from directions within this cosine of its normal.
const TELLS: f32 = 0.5;
/// Share of the surface that must face a direction for it to count as told.
const SHARE: f32 = 0.01;

/// The light so far.
#[derive(Debug, Clone, Serialize)]
pub struct LightSoFar {
    /// Number of the estimate.
    pub number: u64,
    /// Time of the scan that it is of, seconds.
    pub seconds: f64,
    /// Vertices that it is from.
    pub vertices: usize,
    /// Processor time that it took, seconds.
    pub cpu_s: f64,
    /// Coefficients of radiance, linear RGB, `[k][channel]`; real orthonormal spherical harmonics, index l (l + 1) + m, world.
    pub coefficients: Vec<[f64; 3]>,
    /// Unit directions, world.
    pub directions: Vec<[f32; 3]>,
    /// `[direction]`: 0 where no surface tells of the light from there, 1 where enough do.
    pub told: Vec<f32>,
}

impl LightSoFar {
    /// The light that was found on a mesh. `confidence` of its vertices is 0 where no picture shows them: those tell of nothing.
    #[must_use]
    pub fn new(number: u64, seconds: f64, cpu_s: f64, light: &Light, mesh: &Mesh, confidence: &[f32]) -> Self {
        let directions: Vec<Vec3> = (0..DIRECTIONS).map(fibonacci).collect();
        let with_confidence = mesh.normals.iter().zip(confidence);
        let shown: Vec<&Vec3> = with_confidence.filter(|(_, c)| **c > 0.0).map(|(n, _)| n).collect();
        let told = directions.iter().map(|d| {
            let facing = shown.iter().filter(|n| n.dot(*d) > TELLS).count() as f32;
            (facing / shown.len().max(1) as f32 / SHARE).min(1.0)
        });
        Self {
            number,
            seconds,
            cpu_s,
            vertices: mesh.positions.len(),
            coefficients: light.coefficients.clone(),
            told: told.collect(),
            directions: directions.iter().map(|d| d.to_array()).collect(),
        }
    }
}

/// Direction `i` of a Fibonacci lattice on the sphere.
fn fibonacci(i: usize) -> Vec3 {
    let z = 1.0 - (2.0 * i as f32 + 1.0) / DIRECTIONS as f32;
    let turn = i as f32 * 2.399_963_2;
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * libm::cosf(turn), r * libm::sinf(turn), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_tells_of_the_light_from_above_alone() {
        // Its other side, which no picture shows, tells nothing.
        let normals = [[Vec3::Z; 10], [-Vec3::Z; 10]].concat();
        let mesh = Mesh { positions: vec![Vec3::ZERO; 20], normals, triangles: vec![] };
        let confidence = [[1.0; 10], [0.0; 10]].concat();
        let light = LightSoFar::new(1, 2.0, 0.5, &Light::default(), &mesh, &confidence);
        for (d, told) in light.directions.iter().zip(&light.told) {
            assert!((Vec3::from(*d).length() - 1.0).abs() < 1e-5);
            assert_eq!(*told, if d[2] > 0.5 { 1.0 } else { 0.0 });
        }
    }
}
