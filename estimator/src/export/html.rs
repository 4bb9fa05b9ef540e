//! The result as one page that any browser opens, without network: mesh, light, segments, transfer and small keyframe
//! pictures in one file.

use crate::export::file::write_whole;
use crate::export::html_lamps::NearLight;
use crate::export::picture::encode_rgb;
use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::texture::seams::{Unwrapped, jpeg_up_to_one};
use crate::transfer::{Tracer, Transfer, bounce};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::Response;
use recordings::types::RgbImage;
use serde_json::json;
use std::io::{Error, Result, Write};
use std::path::Path;

const PAGE: &str = include_str!("viewer/page.html");
const STYLE: &str = include_str!("viewer/style.css");
/// Parts of the script, in order; they share one scope.
const SCRIPT: [&str; 7] = [
    include_str!("viewer/vector.js"),
    include_str!("viewer/light.js"),
    include_str!("viewer/object.js"),
    include_str!("viewer/reference.js"),
    include_str!("viewer/lamps.js"),
    include_str!("viewer/shown.js"),
    include_str!("viewer/viewer.js"),
];

/// Bands of the transfer in the page: 16 coefficients, what a vertex shader takes in four attributes.
const BANDS: usize = 4;
const COEFFICIENTS: usize = BANDS * BANDS;
/// Rays per vertex: the page shows 8-bit coefficients.
const RAYS: u32 = 32;
/// Keyframe pictures are reduced to at most this width, and there are at most this many.
const PICTURE_WIDTH: u32 = 160;
const MOST_PICTURES: usize = 24;

/// Writes the page; `timings` are seconds by stage. Nothing appears under `path` before it is complete.
///
/// # Errors
/// The disk is full or gone, or a keyframe's picture cannot be read.
pub fn write(result: &Estimate, scan: Option<&Scan>, timings: &[(String, f64)], path: &Path) -> Result<()> {
    let text = page(result, scan, timings)?;
    write_whole(path, |mut file| file.write_all(text.as_bytes()))
}

/// The whole page.
///
/// # Errors
/// A keyframe's picture cannot be read.
pub fn page(result: &Estimate, scan: Option<&Scan>, timings: &[(String, f64)]) -> Result<String> {
    let scene = RayScene::new(&result.mesh);
    let graph = Graph::of(&result.mesh);
    let traced =
        Tracer { mesh: &result.mesh, graph: &graph, scene: &scene, bands: BANDS, seed: 1 }.trace(RAYS, &|_| {});
    let near = NearLight::new(result, &scene, &traced);
    let bounced = Some(bounce(&traced, &result.albedo, 0));
    let transfer = Transfer { traced: traced.into(), bounced };
    let level = level(result, &transfer, &near);
    let (transfer, scale) = coded(&transfer);
    let (low, high) =
        result.mesh.positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
    let size = (high - low).max(Vec3::splat(1e-9));
    let mut data = Vec::new();
    let mut part = |bytes: &[u8]| {
        let start = data.len();
        data.extend_from_slice(bytes);
        while !data.len().is_multiple_of(4) {
            data.push(0);
        }
        start
    };
    let unwrapped = result.texture.as_ref().map(|t| Unwrapped::new(&result.mesh, t));
    let vertices = match &unwrapped {
        Some(unwrapped) => unwrapped.vertex.clone(),
        None => (0..result.mesh.positions.len() as u32).collect(),
    };
    let triangles = unwrapped.as_ref().map_or(&result.mesh.triangles, |u| &u.triangles);
    let coordinates = unwrapped.as_ref().map_or(&[][..], |u| &u.coordinates);
    let positions: Vec<u16> = vertices
        .iter()
        .map(|&i| result.mesh.positions[i as usize])
        .flat_map(|p| ((p - low) / size * 65_535.0).to_array().map(|x| x.round() as u16).into_iter().chain([0]))
        .collect();
    let srgb = |c: Vec3| [c.x, c.y, c.z].map(|c| Response::Srgb.encode(c));
    let shown = display_gain(result);
    let signed = |x: f32| (x * 127.0).round() as i8 as u8;
    let offsets = json!({
        "positions": part(bytemuck::cast_slice(&positions)),
        "normals": part(&flat(&vertices, &result.mesh.normals, |n| [signed(n.x), signed(n.y), signed(n.z), 0])),
        "albedo": part(&flat(&vertices, &result.albedo, |a| { let [r, g, b] = srgb(*a); [r, g, b, 255] })),
        "lit": part(&flat(&vertices, &result.lit_color, |f| { let [r, g, b] = srgb(*f * shown); [r, g, b, 255] })),
        "confidence": part(&flat(&vertices, &result.confidence, |c| [(c.clamp(0.0, 1.0) * 255.0) as u8])),
        "segment": part(&flat(&vertices, &result.segment, |s| (*s as u16).to_le_bytes())),
        "transfer": part(&flat(&vertices, &transfer, |row| *row)),
        "lamps": part(&near.transfer.at(&vertices)), "others": part(&near.others.at(&vertices)),
        "emission": part(&near.emission.at(&vertices)),
        "triangles": part(bytemuck::cast_slice(triangles)),
        "coordinates": part(bytemuck::cast_slice(coordinates)),
    });
    let texture = result.texture.as_ref().map(jpeg_up_to_one).transpose()?;
    let pictures = pictures(result, scan)?;
    let finite = |x: f64| if x.is_finite() { json!(x) } else { json!(null) };
    let total = result.segment.len().max(1) as f64;
    let light: Vec<[f64; 3]> =
        (0..COEFFICIENTS).map(|k| result.light.coefficients.get(k).copied().unwrap_or_default()).collect();
    let facts = json!({
        "name": result.name,
        "vertices": result.mesh.positions.len(),
        "corners": vertices.len(),
        "texture": texture.map(|jpeg| STANDARD.encode(jpeg)),
        "triangles": result.mesh.triangles.len(),
        "low": low.to_array(), "size": size.to_array(),
        "offsets": offsets, "transferScale": scale, "light": light, "gain": shown,
        "lamps": near.lamps, "lampScale": near.transfer.scale, "level": level,
        "hasOthers": !near.others.bytes.is_empty(), "othersScale": near.others.scale, "emissionScale": near.emission.scale,
        "segments": result.segments.iter().map(|s| json!({
            "albedo": s.albedo, "w_d": finite(s.w_d), "w_s": finite(s.w_s), "w_s_error": finite(s.w_s_error),
            "share": f64::from(s.vertices) / total,
        })).collect::<Vec<_>>(),
        "decisions": result.decisions.iter().map(|d| {
            let d = d.text();
            json!({ "name": d.name, "choice": d.choice, "evidence": d.evidence, "cost": d.cost, "next": d.next_level })
        }).collect::<Vec<_>>(),
        "warnings": texts(&result.warnings), "cuts": texts(&result.cuts), "timings": timings,
        "keyframes": result.keyframes.iter().zip(pictures.iter().map(Some).chain(std::iter::repeat(None))).map(|(k, p)| {
            let (i, d) = (&k.camera.intrinsics, &k.camera.distortion);
            json!({
                "name": k.name, "pose": k.world_from_camera.to_rows(), "gain": k.gain,
                "fx": i.fx / f64::from(i.width), "fy": i.fy / f64::from(i.height),
                "cx": (i.cx + 0.5) / f64::from(i.width), "cy": (i.cy + 0.5) / f64::from(i.height),
                "width": i.width, "height": i.height, "lens": [d.k1, d.k2, d.p1, d.p2, d.k3],
                "aspect": f64::from(i.width) / f64::from(i.height), "picture": p,
            })
        }).collect::<Vec<_>>(),
    });
    // A name may hold anything: nothing in it may end the script.
    let facts = facts.to_string().replace('<', "\\u003c");
    let preview = pictures.first().map_or(String::new(), |p| {
        format!("<img alt=\"The scan's first keyframe\" src=\"data:image/png;base64,{p}\">")
    });
    Ok(PAGE
        .replace("/*STYLE*/", STYLE)
        .replace("<!--PREVIEW-->", &preview)
        .replace("/*FACTS*/", &facts)
        .replace("/*DATA*/", &STANDARD.encode(&data))
        .replace("/*SCRIPT*/", &format!("\"use strict\";\n(() => {{\n{}}})();\n", SCRIPT.concat())))
}

fn texts<T: ToString>(of: &[T]) -> Vec<String> {
    of.iter().map(ToString::to_string).collect()
}

/// Bytes of the `values`, `[vertex]`, of these vertices.
fn flat<T, const N: usize>(vertices: &[u32], values: &[T], bytes: impl Fn(&T) -> [u8; N]) -> Vec<u8> {
    vertices.iter().flat_map(|&i| bytes(&values[i as usize])).collect()
}

/// The factor under which the lit colours fill a screen's range.
fn display_gain(result: &Estimate) -> f32 {
    let mut values: Vec<f32> = result.lit_color.iter().map(|f| f.max_element()).filter(|x| x.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    values.get(values.len() * 98 / 100).filter(|x| **x > 0.0).map_or(1.0, |x| 0.8 / x)
}

/// All light over the light from far away, mean of the green channel over the vertices: what relit pictures are as bright as.
fn level(result: &Estimate, transfer: &Transfer, near: &NearLight) -> f32 {
    let far: f64 = transfer.irradiance(&result.light.coefficients).iter().map(|e| f64::from(e.y)).sum();
    let near: f64 = near.irradiance.iter().map(|e| f64::from(e.y)).sum();
    if far > 0.0 { ((far + near) / far) as f32 } else { 1.0 }
}

/// Transfer (Eq. 8, gi, mean of the channels) in signed bytes, `[vertex][16]`, and the value of 127 per coefficient.
fn coded(transfer: &Transfer) -> (Vec<[u8; COEFFICIENTS]>, [f32; COEFFICIENTS]) {
    let n = transfer.traced.vertices();
    let mut rows = vec![[0.0f32; COEFFICIENTS]; n];
    let mut most = [1e-9f32; COEFFICIENTS];
    for (v, row) in rows.iter_mut().enumerate() {
        let mut one = [0.0f64; COEFFICIENTS];
        for channel in 0..3 {
            transfer.row(v, channel, &mut one);
            row.iter_mut().zip(one).for_each(|(r, t)| *r += t as f32 / 3.0);
        }
        most.iter_mut().zip(row).for_each(|(m, r)| *m = m.max(r.abs()));
    }
    let bytes =
        rows.iter().map(|row| std::array::from_fn(|k| (row[k] / most[k] * 127.0).round() as i8 as u8)).collect();
    (bytes, most)
}

/// Small keyframe pictures as base64 PNG, for as many keyframes as are shown.
fn pictures(result: &Estimate, scan: Option<&Scan>) -> Result<Vec<String>> {
    let Some(scan) = scan else {
        return Ok(Vec::new());
    };
    let find = |name: &str| scan.keyframes.iter().find(|k| k.name == name);
    result
        .keyframes
        .iter()
        .take(MOST_PICTURES)
        .map_while(|k| find(&k.name))
        .map(|k| {
            let image = reduced(&k.color.decode().map_err(Error::other)?);
            Ok(STANDARD.encode(encode_rgb(image.width, image.height, &image.data, png::Compression::default())?))
        })
        .collect()
}

/// A picture reduced by a whole factor.
fn reduced(image: &RgbImage) -> RgbImage {
    let f = image.width.div_ceil(PICTURE_WIDTH).max(1);
    let (width, height) = ((image.width / f).max(1), (image.height / f).max(1));
    let mean = |x: u32, y: u32, c: u32| {
        let sum: u32 = (0..f * f)
            .map(|i| u32::from(image.data[(3 * ((y * f + i / f) * image.width + x * f + i % f) + c) as usize]))
            .sum();
        (sum / (f * f)) as u8
    };
    let data = (0..width * height).flat_map(|i| [0, 1, 2].map(|c| mean(i % width, i / width, c))).collect();
    RgbImage { width, height, data }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn the_page_is_whole_and_a_name_cannot_leave_its_place() {
        let mut result = tiny();
        result.name = "</script><b>".into();
        let page = page(&result, None, &[("fusion".into(), 1.5)]).unwrap();
        assert!(!page.contains("</script><b>") && !page.contains("/*FACTS*/") && !page.contains("/*DATA*/"));
        assert!(!page.contains("http://") && !page.contains("https://"));
    }
}
