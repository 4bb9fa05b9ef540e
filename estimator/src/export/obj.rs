//! A result as Wavefront OBJ with its material file, for programs that read nothing newer: `scene.obj`, `scene.mtl` and, with a
//! texture, `albedo.jpg`. Metres, +Z up.

use crate::export::file::write_whole;
use crate::texture::seams::{Unwrapped, jpeg_up_to_one};
use glam::Vec3;
use recordings::result::Estimate;
use std::fmt::Write as _;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

/// Writes the files into `dir`, which exists. A result without texture gets colours behind its vertices, as most programs read
/// them.
///
/// # Errors
/// The disk is full or gone, or the texture is damaged.
pub fn write(result: &Estimate, dir: &Path) -> Result<()> {
    let unwrapped = result.texture.as_ref().map(|t| Unwrapped::new(&result.mesh, t));
    write_whole(&dir.join("scene.obj"), |file| scene(result, unwrapped.as_ref(), BufWriter::new(file)))?;
    write_whole(&dir.join("scene.mtl"), |mut file| file.write_all(materials(result).as_bytes()))?;
    if let Some(texture) = &result.texture {
        let jpeg = jpeg_up_to_one(texture)?;
        write_whole(&dir.join("albedo.jpg"), |mut file| file.write_all(&jpeg))?;
    }
    Ok(())
}

fn scene(result: &Estimate, unwrapped: Option<&Unwrapped>, mut out: impl Write) -> Result<()> {
    let mesh = &result.mesh;
    writeln!(out, "mtllib scene.mtl")?;
    for (p, a) in mesh.positions.iter().zip(&result.albedo) {
        write!(out, "v {} {} {}", p.x, p.y, p.z)?;
        let a = a.clamp(Vec3::ZERO, Vec3::ONE);
        if unwrapped.is_some() { writeln!(out)? } else { writeln!(out, " {:.4} {:.4} {:.4}", a.x, a.y, a.z)? }
    }
    for n in &mesh.normals {
        writeln!(out, "vn {:.5} {:.5} {:.5}", n.x, n.y, n.z)?;
    }
    for [u, v] in unwrapped.iter().flat_map(|u| &u.coordinates) {
        writeln!(out, "vt {u:.6} {:.6}", 1.0 - v)?;
    }
    for segment in 0..result.segments.len() as u32 {
        let own = (0..mesh.triangles.len()).filter(|&t| result.segment[mesh.triangles[t][0] as usize] == segment);
        let mut own = own.peekable();
        if own.peek().is_some() {
            writeln!(out, "usemtl segment_{segment}")?;
        }
        for t in own {
            let texel = |k: usize| unwrapped.map_or(String::new(), |u| (u.triangles[t][k] + 1).to_string());
            let corner = |k: usize| {
                let v = mesh.triangles[t][k] + 1;
                if mesh.normals.is_empty() { format!("{v}/{}", texel(k)) } else { format!("{v}/{}/{v}", texel(k)) }
            };
            writeln!(out, "f {} {} {}", corner(0), corner(1), corner(2))?;
        }
    }
    out.flush()
}

fn materials(result: &Estimate) -> String {
    let mut out = String::new();
    for (index, segment) in result.segments.iter().enumerate() {
        let [r, g, b] = if result.texture.is_some() { [1.0; 3] } else { segment.albedo.map(|a| a.clamp(0.0, 1.0)) };
        let gloss = segment.w_s.clamp(0.0, 1.0);
        // Writing to a string does not fail.
        let _ = writeln!(
            out,
            "newmtl segment_{index}\nKd {r:.4} {g:.4} {b:.4}\nKs {gloss:.4} {gloss:.4} {gloss:.4}\nNs 30"
        );
        if result.texture.is_some() {
            let _ = writeln!(out, "map_Kd albedo.jpg");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{textured, tiny};

    fn files(result: &Estimate) -> (String, String, bool) {
        let dir = tempfile::tempdir().unwrap();
        write(result, dir.path()).unwrap();
        let text = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
        (text("scene.obj"), text("scene.mtl"), dir.path().join("albedo.jpg").exists())
    }

    #[test]
    fn a_textured_scene_has_coordinates_and_a_picture() {
        let (scene, materials, picture) = files(&textured());
        let lines = |start: &str| scene.lines().filter(|l| l.starts_with(start)).count();
        assert_eq!((lines("v "), lines("vn "), lines("vt "), lines("f ")), (3, 3, 3, 1));
        assert!(scene.contains("usemtl segment_0\nf 1/1/1 3/2/3 2/3/2\n"), "{scene}");
        // The first vertex lies at texel (3.5, 1.5) of 16 × 8, counted from above.
        assert!(scene.contains("vt 0.250000 0.750000\n"), "{scene}");
        assert!(picture && materials.contains("map_Kd albedo.jpg"));
    }

    #[test]
    fn a_scene_without_texture_has_colours() {
        let (scene, materials, picture) = files(&tiny());
        assert!(
            scene.contains("v -0.2 -0.2 0 0.5000 0.5000 0.5000\n") && scene.contains("f 1//1 3//3 2//2\n"),
            "{scene}"
        );
        assert!(!picture && !materials.contains("map_Kd"));
    }
}
