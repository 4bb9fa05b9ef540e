//! Objects to insert: an object file, another scan or a part of it, and its place.

use crate::rays::RayScene;
use crate::render::change::scanned;
use crate::render::compose::Viewpoint;
use crate::render::error::{RenderError, Result};
use crate::render::objects::gltf::document;
use crate::render::objects::material::Material;
use crate::render::objects::object::Object;
use crate::render::objects::ply;
use crate::render::objects::support::{own_up, standing_point};
use firmware_config::RealityConfig;
use glam::{Vec2, Vec3};
use recordings::result::Estimate;
use recordings::types::Mesh;
use std::path::{Path, PathBuf};

/// Largest object file, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// Where an object stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// On what the middle of the view shows.
    Middle,
    /// On what this pixel of the view shows.
    Pixel(f32, f32),
    /// With its origin here (of a scan's part: the middle of its foot), metres.
    Position(Vec3),
}

/// `OBJECT[@PLACE[,yaw_deg[,scale]]]`, where OBJECT is a file or `other.lres[#segment=4,7]`, and PLACE `x,y,z` or `pixel:X,Y`.
#[derive(Debug, Clone, PartialEq)]
pub struct Insert {
    /// Object file or result.
    pub path: PathBuf,
    /// Segments of a result; empty = all of it.
    pub segments: Vec<u32>,
    /// Where it stands.
    pub place: Place,
    /// Turn about +Z in degrees.
    pub yaw_deg: f32,
    /// Size factor.
    pub scale: f32,
}

impl std::str::FromStr for Insert {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        const FORM: &str = "after @ must stand x,y,z[,yaw_deg[,scale]] or pixel:X,Y[,yaw_deg[,scale]]";
        let split = text.rsplit_once('@').map(|(object, place)| (object, numbers(place)));
        let (object, pixel, numbers) = match split {
            Some((object, Some((pixel, n)))) => (object, pixel, n),
            // An @ in a file's name.
            Some((_, None)) if !Path::new(text).exists() => return Err(FORM.into()),
            _ => (text, false, Vec::new()),
        };
        let (place, rest) = match (pixel, &numbers[..]) {
            (false, []) => (Place::Middle, &[][..]),
            (true, [x, y, rest @ ..]) => (Place::Pixel(*x, *y), rest),
            (false, [x, y, z, rest @ ..]) => (Place::Position(Vec3::new(*x, *y, *z)), rest),
            _ => return Err(FORM.into()),
        };
        if rest.len() > 2 || numbers.iter().any(|x| !x.is_finite()) {
            return Err(FORM.into());
        }
        let scale = rest.get(1).copied().unwrap_or(1.0);
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
        Ok(Self { path: path.into(), segments, place, yaw_deg: rest.first().copied().unwrap_or(0.0), scale })
    }
}

/// The numbers of a place, and whether it is a pixel.
fn numbers(place: &str) -> Option<(bool, Vec<f32>)> {
    let pixel = place.strip_prefix("pixel:");
    let list = pixel.unwrap_or(place).split(',').map(|x| x.trim().parse().ok()).collect::<Option<_>>()?;
    Some((pixel.is_some(), list))
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
    if is_scan || !matches!(insert.place, Place::Position(_)) {
        object.place(-foot, 0.0, 1.0);
    }
    let (position, up) = match insert.place {
        Place::Position(p) => (p, Vec3::Z),
        Place::Pixel(..) | Place::Middle => {
            let radius = (high - low).truncate().min_element() / 2.0 * insert.scale;
            let (w, h) = view.size();
            let (x, y) = match insert.place {
                Place::Pixel(x, y) => (x, y),
                _ => ((w - 1) as f32 / 2.0, (h - 1) as f32 / 2.0),
            };
            if x < 0.0 || y < 0.0 || x > (w - 1) as f32 || y > (h - 1) as f32 {
                return Err(RenderError::Request(format!("pixel {x},{y} is not in the view, which has {w}x{h}")));
            }
            let ray = (view.world_from_camera.translation.as_vec3(), view.ray(x, y));
            let up = own_up(mesh);
            let found = standing_point(mesh, scene, up, ray, radius).ok_or_else(|| {
                RenderError::Request(format!(
                    "the view shows no surface at pixel {x},{y} to put the object on; name another: OBJECT@pixel:X,Y"
                ))
            })?;
            (found, up)
        }
    };
    object.place(Vec3::ZERO, insert.yaw_deg.to_radians(), insert.scale);
    object.stand(position, up);
    let odd =
        placement_warnings(&object, mesh, scene).into_iter().map(|o| format!("{}: {o}", path.display())).collect();
    Ok((object, odd))
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
            (i.path, i.place, i.yaw_deg, i.scale),
            ("a/knot.glb".into(), Place::Position(Vec3::new(0.0, 0.5, -1.0)), 90.0, 2.0)
        );
        let i: Insert = "knot.glb@pixel:470,300.5,45".parse().unwrap();
        assert_eq!((i.path, i.place, i.yaw_deg, i.scale), ("knot.glb".into(), Place::Pixel(470.0, 300.5), 45.0, 1.0));
        let i: Insert = "other.lres#segment=4,7@1,2,3".parse().unwrap();
        let place = Place::Position(Vec3::new(1.0, 2.0, 3.0));
        assert_eq!((i.path, i.segments, i.place), ("other.lres".into(), vec![4, 7], place));
        assert_eq!("knot.glb".parse::<Insert>().unwrap().place, Place::Middle);
        for bad in [
            "a@1,2",
            "a@1,2,x",
            "a@1,2,3,0,0",
            "a@1,2,3,0,-1",
            "a@nan,0,0",
            "a.lres#segment=x",
            "a@pixel:3",
            "a@pixel:1,2,3,4,5",
        ] {
            assert!(bad.parse::<Insert>().is_err(), "{bad}");
        }
    }
}
