//! Scenes whose albedo and lit colour are known, vertex by vertex. Ground truth is read inside the product because
//! `lumiscan trade` measures on the user's own machine; nothing but the sweep uses it.

use crate::numerics::robust::median;
use crate::rays::RayScene;
use crate::sweep::alignment::rigid_alignment;
use glam::{DVec3, Mat3, Vec3};
use recordings::import::npy::Array;
use recordings::import::trajectory::read_trajectory;
use recordings::ply::read::{VertexColumn, parse_ply, read_ply};
use recordings::types::{Mesh, Pose};
use std::collections::BTreeMap;
use std::path::Path;

/// Columns of albedo and lit colour in the mesh of a synthetic recording.
const COLUMNS: [[&str; 3]; 2] = [["albedo_r", "albedo_g", "albedo_b"], ["lit_r", "lit_g", "lit_b"]];
/// Normals of the same surface point agree within this cosine.
const SAME_SIDE: f32 = 0.7;

/// What is true of a scene.
pub struct Truth {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    albedo: Vec<Vec3>,
    irradiance: Vec<Vec3>,
    /// True poses by time stamp, if the scan has a frame of its own.
    trajectory: BTreeMap<i64, Pose>,
    /// Largest distance (m) between a recovered and the true surface to count as the same: 1.5 spacings of true vertices.
    reach: f32,
}

/// An answer at the vertices of the mesh that was found.
#[derive(Clone, Copy)]
pub struct Answer<'a> {
    /// Mesh that was found.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Keyframes by time stamp, in the frame of that mesh.
    pub views: &'a [(i64, Pose)],
    /// Vertices that two keyframes or more see.
    pub seen: &'a [bool],
    /// Albedo.
    pub albedo: &'a [Vec3],
    /// Irradiance.
    pub irradiance: &'a [Vec3],
}

impl Truth {
    /// A folder with `mesh.ply` and `truth/{albedo,lit_color}.npy`; poses are those of the mesh's frame.
    ///
    /// # Errors
    /// A file is missing or of another kind.
    pub fn of_photos(folder: &Path) -> Result<Self, String> {
        let read = || -> Result<_, recordings::Error> {
            let mesh = read_ply(&folder.join("mesh.ply"))?;
            let rows = |name: &str| read_rows(&folder.join("truth").join(name));
            Ok((mesh, rows("albedo.npy")?, rows("lit_color.npy")?))
        };
        let (mesh, albedo, lit) = read().map_err(|e| e.to_string())?;
        Self::new(mesh, albedo, &lit, BTreeMap::new())
    }

    /// A folder with `mesh.ply` (albedo and lit colour per vertex) and `trajectory.txt`, as the synthetic Kinect writes it.
    ///
    /// # Errors
    /// A file is missing or of another kind.
    pub fn of_recording(folder: &Path) -> Result<Self, String> {
        let path = folder.join("mesh.ply");
        let named = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
        let bytes = std::fs::read(&path).map_err(|e| named(&e))?;
        let (mesh, columns) = parse_ply(&bytes, COLUMNS.as_flattened()).map_err(|e| named(&e))?;
        let [r, g, b, lit_r, lit_g, lit_b] = columns.as_slice() else {
            return Err(named(&"not a mesh with albedo_r … albedo_b and lit_r … lit_b per vertex"));
        };
        let rows = |[r, g, b]: [&VertexColumn; 3]| -> Vec<Vec3> {
            let pairs = r.values.iter().zip(&g.values).zip(&b.values);
            pairs.map(|((r, g), b)| Vec3::new(*r, *g, *b)).collect()
        };
        let trajectory = read_trajectory(&folder.join("trajectory.txt")).map_err(|e| e.to_string())?;
        let trajectory = trajectory.into_iter().map(|(time, pose)| (time / 1000, pose)).collect();
        Self::new(mesh, rows([r, g, b]), &rows([lit_r, lit_g, lit_b]), trajectory)
    }

    fn new(mesh: Mesh, albedo: Vec<Vec3>, lit: &[Vec3], trajectory: BTreeMap<i64, Pose>) -> Result<Self, String> {
        let Mesh { positions, normals, .. } = mesh;
        if positions.is_empty() || [normals.len(), albedo.len(), lit.len()].iter().any(|n| *n != positions.len()) {
            return Err("truth: arrays of different lengths".into());
        }
        let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        // Surfaces fill the box like its faces do: about one vertex a cell.
        let d = high - low;
        let area = (d.x * d.y + d.y * d.z + d.z * d.x).max(f32::MIN_POSITIVE);
        let reach = 1.5 * (area / positions.len() as f32).sqrt();
        let irradiance = lit.iter().zip(&albedo).map(|(f, a)| *f / a.max(Vec3::splat(1e-6))).collect();
        Ok(Self { positions, normals, albedo, irradiance, trajectory, reach })
    }

    /// Median relative error of albedo and irradiance, after one factor per channel: at the true vertices, so that finer
    /// and coarser meshes are measured at the same places.
    #[must_use]
    pub fn errors(&self, answer: &Answer) -> (f64, f64) {
        let (rotation, translation) = self.frame(answer.views);
        let back = rotation.transpose();
        let mut pairs = [Vec::new(), Vec::new()];
        for (i, (p, n)) in self.positions.iter().zip(&self.normals).enumerate() {
            let known = [self.albedo[i], self.irradiance[i]];
            if let Some(found) = answer.at(back * (*p - translation), back * *n, self.reach)
                && found.iter().chain(&known).all(luminous)
            {
                pairs.iter_mut().zip(found).zip(known).for_each(|((pairs, f), k)| pairs.push(f / k));
            }
        }
        let [albedo, irradiance] = pairs.map(|ratios| relative_error(&ratios));
        (albedo, irradiance)
    }

    /// Truth's frame from the scan's: the rigid motion that brings the cameras, with their axes, onto the true ones.
    fn frame(&self, views: &[(i64, Pose)]) -> (Mat3, Vec3) {
        let marks =
            |pose: &Pose| [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|a| pose.translation + pose.rotation * a);
        let mut pairs: Vec<(DVec3, DVec3)> = Vec::new();
        for (time, pose) in views {
            if let Some(known) = self.trajectory.get(&(time / 1000)) {
                pairs.extend(marks(pose).into_iter().zip(marks(known)));
            }
        }
        let aligned = rigid_alignment(&pairs);
        aligned
            .map_or((Mat3::IDENTITY, Vec3::ZERO), |(rotation, translation)| (rotation.as_mat3(), translation.as_vec3()))
    }
}

impl Answer<'_> {
    /// Albedo and irradiance of the seen surface that is nearest to `position` along its normal.
    fn at(&self, position: Vec3, normal: Vec3, reach: f32) -> Option<[Vec3; 2]> {
        let along = |normal: Vec3| self.scene.closest_hit(self.scene.offset_origin(position, -normal), normal);
        let corners = |triangle: u32| self.mesh.triangles[triangle as usize].map(|i| i as usize);
        let faces = |triangle| {
            let [a, b, c] = corners(triangle).map(|i| self.mesh.normals[i]);
            (a + b + c).normalize_or_zero().dot(normal) > SAME_SIDE
        };
        let hits = [along(normal), along(-normal)].into_iter().flatten();
        let near = hits.filter(|h| h.distance < reach && faces(h.triangle));
        let hit = near.min_by(|a, b| a.distance.total_cmp(&b.distance))?;
        let [a, b, c] = corners(hit.triangle);
        let blend = |v: &[Vec3]| v[a] * (1.0 - hit.u - hit.v) + v[b] * hit.u + v[c] * hit.v;
        (self.seen[a] && self.seen[b] && self.seen[c]).then(|| [blend(self.albedo), blend(self.irradiance)])
    }
}

/// Median relative error over places and channels, after the median of each channel; NaN of no places.
fn relative_error(ratios: &[Vec3]) -> f64 {
    let scale = [0, 1, 2].map(|c| median(ratios.iter().map(|r| f64::from(r[c]))).unwrap_or(f64::NAN));
    let relative = ratios.iter().flat_map(|r| [0, 1, 2].map(|c| (f64::from(r[c]) / scale[c] - 1.0).abs()));
    median(relative).unwrap_or(f64::NAN)
}

fn luminous(v: &Vec3) -> bool {
    v.is_finite() && v.min_element() > 0.0
}

/// Rows `[vertex][rgb]` of an array.
fn read_rows(path: &Path) -> Result<Vec<Vec3>, recordings::Error> {
    let rows = Array::read(path)?.rgb();
    Ok(rows.into_iter().map(|row| Vec3::from_array(row.map(|x| x as f32))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of `n` × `n` cells, a little above or below z = 0.
    fn square(n: u32, height: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for j in 0..=n {
                mesh.positions.push(Vec3::new(i as f32 / n as f32, j as f32 / n as f32, height));
                mesh.normals.push(Vec3::Z);
                if i < n && j < n {
                    let at = |i: u32, j: u32| i * (n + 1) + j;
                    mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                    mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
        mesh
    }

    #[test]
    fn finer_and_coarser_meshes_are_measured_at_the_same_places() {
        let known = square(40, 0.0);
        // A third of the square, which finer vertices might crowd, is wrong by a fifth.
        let answer = |p: &Vec3| Vec3::splat(if p.x > 0.68 { 0.6 } else { 0.5 });
        let count = known.positions.len();
        let grey = vec![Vec3::splat(0.5); count];
        let truth = Truth::new(known.clone(), grey.clone(), &grey, BTreeMap::new()).expect("arrays of one length");
        let share_wrong = |mesh: &Mesh| {
            let albedo: Vec<Vec3> = mesh.positions.iter().map(answer).collect();
            let irradiance = vec![Vec3::ONE; albedo.len()];
            let seen = vec![true; albedo.len()];
            let (scene, albedo, irradiance) = (&RayScene::new(mesh), &albedo, &irradiance);
            let answer = Answer { mesh, scene, views: &[], seen: &seen, albedo, irradiance };
            let at = |p: &Vec3| answer.at(*p, Vec3::Z, truth.reach);
            let places: Vec<[Vec3; 2]> = known.positions.iter().filter_map(at).collect();
            assert_eq!(truth.errors(&answer), (0.0, 0.0), "the median position is right");
            (places.len(), places.iter().filter(|p| p[0].x > 0.55).count() as f64 / places.len() as f64)
        };
        for mesh in [square(80, 0.001), square(20, -0.001), square(7, 0.0)] {
            let (places, wrong) = share_wrong(&mesh);
            assert!(places >= count * 9 / 10, "{places} of {count}");
            assert!((wrong - 0.32).abs() < 0.05, "{wrong}");
        }
        let far = square(20, 0.2);
        assert_eq!(places(&far, &truth), 0, "another surface is not the true one");
    }

    fn places(mesh: &Mesh, truth: &Truth) -> usize {
        let ones = vec![Vec3::ONE; mesh.positions.len()];
        let (scene, seen) = (&RayScene::new(mesh), vec![true; ones.len()]);
        let answer = Answer { mesh, scene, views: &[], seen: &seen, albedo: &ones, irradiance: &ones };
        truth.positions.iter().filter(|p| answer.at(**p, Vec3::Z, truth.reach).is_some()).count()
    }
}
