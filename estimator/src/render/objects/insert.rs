//! Objects to insert: an object file, another scan or a part of it, and its place.

use crate::rays::RayScene;
use crate::render::change::scanned;
use crate::render::compose::Viewpoint;
use crate::render::error::{RenderError, Result};
use crate::render::objects::gltf::document;
use crate::render::objects::material::Material;
use crate::render::objects::object::Object;
use crate::render::objects::ply;
use firmware_config::RealityConfig;
use glam::{Vec2, Vec3};
use recordings::result::Estimate;
use recordings::types::Mesh;
use std::path::{Path, PathBuf};

/// Largest object file, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// `OBJECT[@x,y,z[,yaw_deg[,scale]]]`, where OBJECT is a file or `other.lres[#segment=4,7]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Insert {
    /// Object file or result.
    pub path: PathBuf,
    /// Segments of a result; empty = all of it.
    pub segments: Vec<u32>,
    /// Where its origin stands (of a scan's part: the middle of its foot); `None` = where the view's middle meets the scan.
    pub position: Option<Vec3>,
    /// Turn about +Z in degrees.
    pub yaw_deg: f32,
    /// Size factor.
    pub scale: f32,
}

impl std::str::FromStr for Insert {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let place = text.rsplit_once('@').map(|(object, place)| {
            let numbers: std::result::Result<Vec<f32>, _> = place.split(',').map(|x| x.trim().parse::<f32>()).collect();
            (object, numbers)
        });
        let (object, numbers) = match place {
            Some((object, Ok(n))) => (object, n),
            // An @ in a file's name.
            Some((_, Err(_))) if Path::new(text).exists() => (text, Vec::new()),
            Some((_, Err(_))) => return Err("after @ must stand x,y,z[,yaw_deg[,scale]]".into()),
            None => (text, Vec::new()),
        };
        if ![0, 3, 4, 5].contains(&numbers.len()) || numbers.iter().any(|x| !x.is_finite()) {
            return Err("after @ must stand x,y,z[,yaw_deg[,scale]]".into());
        }
        let scale = numbers.get(4).copied().unwrap_or(1.0);
        if scale <= 0.0 {
            return Err("the scale must be more than 0".into());
        }
        let (path, segments) = match object.split_once("#segment=") {
            None => (object, Vec::new()),
            Some((path, list)) => {
                let ids = list.split(',').map(|s| s.trim().parse().map_err(|_| format!("`{s}` is no segment number")));
                (path, ids.collect::<std::result::Result<_, _>>()?)
            }
        };
        Ok(Self {
            path: path.into(),
            segments,
            position: (numbers.len() >= 3).then(|| Vec3::new(numbers[0], numbers[1], numbers[2])),
            yaw_deg: numbers.get(3).copied().unwrap_or(0.0),
            scale,
        })
    }
}

/// Reads an object and places it on a `mesh` with the rays `scene`; also returns warnings about its place.
///
/// # Errors
/// The file cannot be used, or no place is found for it.
pub fn load(
    insert: &Insert,
    view: &Viewpoint,
    mesh: &Mesh,
    scene: &RayScene,
    config: &RealityConfig,
) -> Result<(Object, Vec<String>)> {
    let path = &insert.path;
    let is_scan = path.extension().is_some_and(|e| e == "lres");
    let mut object = if is_scan { part_of(path, &insert.segments, config)? } else { from_file(path)? };
    let (low, high) = object.bounds();
    let foot = Vec3::new((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z);
    if is_scan || insert.position.is_none() {
        object.place(-foot, 0.0, 1.0);
    }
    let position = match insert.position {
        Some(p) => p,
        None => middle(view, scene).ok_or_else(|| {
            RenderError::Request(
                "the middle of the view meets no surface to put the object on; give a position: OBJECT@x,y,z".into(),
            )
        })?,
    };
    object.place(position, insert.yaw_deg.to_radians(), insert.scale);
    let odd =
        placement_warnings(&object, mesh, scene).into_iter().map(|o| format!("{}: {o}", path.display())).collect();
    Ok((object, odd))
}

/// Where the middle of the view meets the scan.
fn middle(view: &Viewpoint, scene: &RayScene) -> Option<Vec3> {
    let (w, h) = view.size();
    let eye = view.world_from_camera.translation.as_vec3();
    let d = view.ray((w - 1) as f32 / 2.0, (h - 1) as f32 / 2.0);
    scene.closest_hit(eye, d).map(|hit| eye + d * hit.distance)
}

fn placement_warnings(object: &Object, mesh: &Mesh, scene: &RayScene) -> Vec<String> {
    let (low, high) = object.bounds();
    let p = &mesh.positions;
    let (from, to) = p.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let mut odd = Vec::new();
    if low.cmpgt(to).any() || high.cmplt(from).any() {
        let shown = |p: Vec3| format!("{:.2},{:.2},{:.2}", p.x, p.y, p.z);
        odd.push(format!("stands outside the scan, which reaches from {} to {} m", shown(from), shown(to)));
    }
    let middle = (low + high) / 2.0;
    if let Some(hit) = scene.closest_hit(middle, Vec3::Z) {
        let t = mesh.triangles[hit.triangle as usize];
        let up: f32 = t.iter().map(|&i| mesh.normals[i as usize].z).sum();
        if up > 1.5 && middle.z + hit.distance > high.z {
            odd.push("stands under a surface of the scan".into());
        }
    }
    odd
}

fn from_file(path: &Path) -> Result<Object> {
    let size = std::fs::metadata(path).map_err(|e| RenderError::file(path, e))?.len();
    if size > MAX_FILE_BYTES {
        return Err(RenderError::file(path, "is larger than 1 GiB"));
    }
    let bytes = std::fs::read(path).map_err(|e| RenderError::file(path, e))?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let object = if bytes.starts_with(b"ply") { ply::read(&bytes) } else { document::read(&bytes, folder) };
    object.map_err(|e| RenderError::file(path, e))
}

/// A result's surface, or some of its segments.
fn part_of(path: &Path, segments: &[u32], config: &RealityConfig) -> Result<Object> {
    let result = Estimate::read(path)?;
    if let Some(s) = segments.iter().find(|s| !result.segment.contains(s)) {
        let most = result.segments.len().saturating_sub(1);
        return Err(RenderError::file(path, format!("has no segment {s} (they go from 0 to {most})")));
    }
    let whole = scanned(&result, config);
    if segments.is_empty() {
        return Ok(whole);
    }
    let wanted = |t: &[u32; 3]| t.iter().all(|&i| segments.contains(&result.segment[i as usize]));
    let mut index = vec![u32::MAX; whole.mesh.positions.len()];
    let mut part = Object { materials: whole.materials.clone(), ..Object::default() };
    for (t, m) in whole.mesh.triangles.iter().zip(&whole.material).filter(|(t, _)| wanted(t)) {
        let triangle = t.map(|i| {
            let new = &mut index[i as usize];
            if *new == u32::MAX {
                *new = part.mesh.positions.len() as u32;
                part.mesh.positions.push(whole.mesh.positions[i as usize]);
                part.mesh.normals.push(whole.mesh.normals[i as usize]);
                part.color.push(whole.color[i as usize]);
                part.uv.push(Vec2::ZERO);
            }
            *new
        });
        part.mesh.triangles.push(triangle);
        part.material.push(*m);
    }
    if part.mesh.triangles.is_empty() {
        return Err(RenderError::file(path, "these segments have no triangle"));
    }
    Ok(part)
}

/// Gives an object the recovered material of a segment.
///
/// # Errors
/// There is no such segment.
pub fn give_material(object: &mut Object, estimate: &Estimate, segment: u32, config: &RealityConfig) -> Result<()> {
    let s = estimate.segments.get(segment as usize).ok_or_else(|| {
        RenderError::Request(format!("there is no segment {segment}: the result has {}", estimate.segments.len()))
    })?;
    let of_segment = scanned(estimate, config).materials.swap_remove(segment as usize);
    object.materials = vec![Material { base_color: Vec3::from(s.albedo.map(|a| a as f32)), ..of_segment }];
    object.material.iter_mut().for_each(|m| *m = 0);
    object.color.clear();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read() {
        let i: Insert = "a/knot.glb@0,0.5,-1,90,2".parse().unwrap();
        assert_eq!(
            (i.path, i.position, i.yaw_deg, i.scale),
            ("a/knot.glb".into(), Some(Vec3::new(0.0, 0.5, -1.0)), 90.0, 2.0)
        );
        let i: Insert = "other.lres#segment=4,7@1,2,3".parse().unwrap();
        assert_eq!((i.path, i.segments, i.position), ("other.lres".into(), vec![4, 7], Some(Vec3::new(1.0, 2.0, 3.0))));
        assert_eq!("knot.glb".parse::<Insert>().unwrap().position, None);
        for bad in ["a@1,2", "a@1,2,x", "a@1,2,3,0,0", "a@1,2,3,0,-1", "a@nan,0,0", "a.lres#segment=x"] {
            assert!(bad.parse::<Insert>().is_err(), "{bad}");
        }
    }
}
