//! Scenes whose albedo and lit colour are known, vertex by vertex.

use crate::trade::luminous;
use glam::{DVec3, IVec3, Mat3, Vec3};
use nalgebra::{Matrix3, Vector3};
use recordings::types::{Mesh, Pose};
use std::collections::BTreeMap;
use std::path::Path;

/// Arrays and headers longer than this are not read.
const MOST_BYTES: u64 = 1 << 30;
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
    cell: f32,
    cells: BTreeMap<[i32; 3], Vec<u32>>,
}

impl Truth {
    /// A folder with `mesh.ply` and `truth/{albedo,lit_color}.npy`; poses are those of the mesh's frame.
    ///
    /// # Errors
    /// A file is missing or of another kind.
    pub fn of_photos(folder: &Path) -> Result<Self, String> {
        let mesh = recordings::ply::read_ply(&folder.join("mesh.ply")).map_err(|e| e.to_string())?;
        let albedo = read_npy(&folder.join("truth/albedo.npy"))?;
        let lit = read_npy(&folder.join("truth/lit_color.npy"))?;
        Self::new(mesh.positions, mesh.normals, albedo, &lit, BTreeMap::new())
    }

    /// A folder with `mesh.ply` (albedo and lit colour per vertex) and `trajectory.txt`, as the synthetic Kinect writes it.
    ///
    /// # Errors
    /// A file is missing or of another kind.
    pub fn of_recording(folder: &Path) -> Result<Self, String> {
        let rows = read_vertices(&folder.join("mesh.ply"))?;
        let take =
            |from: usize| rows.iter().map(|r| Vec3::new(r[from], r[from + 1], r[from + 2])).collect::<Vec<Vec3>>();
        let path = folder.join("trajectory.txt");
        let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let trajectory = text.lines().filter(|l| !l.starts_with('#')).filter_map(pose_of).collect();
        Self::new(take(0), take(3), take(6), &take(9), trajectory)
    }

    fn new(
        positions: Vec<Vec3>,
        normals: Vec<Vec3>,
        albedo: Vec<Vec3>,
        lit: &[Vec3],
        trajectory: BTreeMap<i64, Pose>,
    ) -> Result<Self, String> {
        if positions.is_empty() || [normals.len(), albedo.len(), lit.len()].iter().any(|n| *n != positions.len()) {
            return Err("truth: arrays of different lengths".into());
        }
        let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        // Surfaces fill the box like its faces do: about one vertex a cell.
        let d = high - low;
        let area = (d.x * d.y + d.y * d.z + d.z * d.x).max(f32::MIN_POSITIVE);
        let cell = 1.5 * (area / positions.len() as f32).sqrt();
        let irradiance = lit.iter().zip(&albedo).map(|(f, a)| *f / a.max(Vec3::splat(1e-6))).collect();
        let mut truth = Self { positions, normals, albedo, irradiance, trajectory, cell, cells: BTreeMap::new() };
        for i in 0..truth.positions.len() {
            let key = truth.key(truth.positions[i]).to_array();
            truth.cells.entry(key).or_default().push(i as u32);
        }
        Ok(truth)
    }

    fn key(&self, p: Vec3) -> IVec3 {
        (p / self.cell).floor().as_ivec3()
    }

    fn nearest(&self, p: Vec3, normal: Vec3) -> Option<usize> {
        let at = self.key(p);
        let mut best = (self.cell, None);
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    let key = [at.x.wrapping_add(x), at.y.wrapping_add(y), at.z.wrapping_add(z)];
                    for &i in self.cells.get(&key).into_iter().flatten() {
                        let i = i as usize;
                        let distance = self.positions[i].distance(p);
                        if distance < best.0 && self.normals[i].dot(normal) > SAME_SIDE {
                            best = (distance, Some(i));
                        }
                    }
                }
            }
        }
        best.1
    }

    /// Median relative error of albedo and irradiance over the vertices that were seen, after one factor per channel.
    #[must_use]
    pub fn errors(
        &self,
        mesh: &Mesh,
        views: &[(i64, Pose)],
        seen: impl Fn(usize) -> bool,
        albedo: &[Vec3],
        irradiance: &[Vec3],
    ) -> (f64, f64) {
        let (rotation, translation) = self.frame(views);
        let pairs: Vec<(usize, usize)> = (0..mesh.positions.len())
            .filter(|&i| seen(i) && luminous(&albedo[i]) && luminous(&irradiance[i]))
            .filter_map(|i| {
                let p = rotation * mesh.positions[i] + translation;
                self.nearest(p, rotation * mesh.normals[i]).map(|t| (i, t))
            })
            .filter(|&(_, t)| luminous(&self.albedo[t]) && luminous(&self.irradiance[t]))
            .collect();
        (relative_error(&pairs, albedo, &self.albedo), relative_error(&pairs, irradiance, &self.irradiance))
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
        if pairs.is_empty() {
            return (Mat3::IDENTITY, Vec3::ZERO);
        }
        let n = pairs.len() as f64;
        let (from, to) = pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(a, b), p| (a + p.0 / n, b + p.1 / n));
        // Kabsch.
        let mut cross = Matrix3::<f64>::zeros();
        for (a, b) in &pairs {
            let (a, b) = ((*a - from).to_array(), (*b - to).to_array());
            cross += Vector3::from(b) * Vector3::from(a).transpose();
        }
        let svd = cross.svd(true, true);
        let (Some(u), Some(v)) = (svd.u, svd.v_t) else { return (Mat3::IDENTITY, Vec3::ZERO) };
        let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
        let r = u * sign * v;
        let rotation = Mat3::from_cols_array(&std::array::from_fn(|i| r[(i % 3, i / 3)] as f32));
        (rotation, to.as_vec3() - rotation * from.as_vec3())
    }
}

fn relative_error(pairs: &[(usize, usize)], found: &[Vec3], truth: &[Vec3]) -> f64 {
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        if values.is_empty() { f64::NAN } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    };
    let ratio = |&(i, t): &(usize, usize), c: usize| f64::from(found[i][c] / truth[t][c]);
    let scale = [0, 1, 2].map(|c| median(pairs.iter().map(|p| ratio(p, c)).collect()));
    median(pairs.iter().flat_map(|p| [0, 1, 2].map(|c| (ratio(p, c) / scale[c] - 1.0).abs())).collect())
}

/// `timestamp tx ty tz qx qy qz qw`, by microseconds.
fn pose_of(line: &str) -> Option<(i64, Pose)> {
    let mut fields = line.split_whitespace();
    let time = recordings::parse_seconds(fields.next()?)?;
    let v: Vec<f64> = fields.map(str::parse).collect::<Result<_, _>>().ok()?;
    let [tx, ty, tz, qx, qy, qz, qw] = v.try_into().ok()?;
    let pose = Pose::new(glam::DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(tx, ty, tz));
    Some((time / 1000, pose))
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    let told = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
    let length = std::fs::metadata(path).map_err(|e| told(&e))?.len();
    if length > MOST_BYTES {
        return Err(told(&"too large"));
    }
    std::fs::read(path).map_err(|e| told(&e))
}

/// Rows of three floats from a NumPy file (little endian, C order).
fn read_npy(path: &Path) -> Result<Vec<Vec3>, String> {
    let bytes = read(path)?;
    let parse = || {
        let length = usize::from(u16::from_le_bytes(bytes.get(8..10)?.try_into().ok()?));
        let header = std::str::from_utf8(bytes.get(10..10 + length)?).ok()?;
        (bytes.starts_with(b"\x93NUMPY\x01") && header.contains("'<f4'") && header.contains("False"))
            .then(|| bytes.get(10 + length..))?
    };
    let data = parse().ok_or_else(|| format!("{}: not an array of 32-bit floats", path.display()))?;
    Ok(data.chunks_exact(12).map(|c| Vec3::from_array([0, 4, 8].map(|o| float(c, o)))).collect())
}

/// The first twelve numbers of every vertex of a binary PLY whose vertices begin with twelve floats.
fn read_vertices(path: &Path) -> Result<Vec<[f32; 12]>, String> {
    let bytes = read(path)?;
    let parse = || {
        let end = b"end_header\n";
        let start = bytes.windows(end.len()).take(4096).position(|w| w == end)? + end.len();
        let header = std::str::from_utf8(&bytes[..start]).ok()?;
        let vertex = header.split("element vertex ").nth(1)?;
        let count: usize = vertex.lines().next()?.trim().parse().ok()?;
        let properties: Vec<&str> = vertex.lines().skip(1).take_while(|l| l.starts_with("property")).collect();
        let floats = properties.iter().take_while(|l| l.starts_with("property float")).count();
        let others = properties.iter().skip(floats);
        let stride = 4 * floats + others.clone().filter(|l| l.starts_with("property uchar")).count();
        if !header.contains("binary_little_endian") || floats != 12 || others.count() != stride - 48 {
            return None;
        }
        bytes.get(start..start.checked_add(count.checked_mul(stride)?)?).map(|b| (b, stride))
    };
    let (data, stride) = parse().ok_or_else(|| format!("{}: not a mesh with truth", path.display()))?;
    Ok(data.chunks_exact(stride).map(|c| std::array::from_fn(|i| float(c, 4 * i))).collect())
}

fn float(bytes: &[u8], at: usize) -> f32 {
    bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(f32::NAN, f32::from_le_bytes)
}
