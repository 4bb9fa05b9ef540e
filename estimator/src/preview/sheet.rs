//! The sheet: panels, captions, and the facts of the result.

use crate::export::hdr;
use crate::export::picture::encode_rgb;
use crate::numerics::cielab::luminance;
use crate::numerics::robust::{median, quantile};
use crate::preview::canvas::{FAINT, NOTHING, PANEL, TEXT, TEXT_SIZE, fill, page, pixmap, write_text};
use crate::preview::color::{LightExposure, display, heat, segment_color};
use crate::preview::font;
use crate::preview::keyframe_view::{KeyframeView, Panel};
use crate::preview::lamps;
use crate::preview::spheres;
use crate::preview::vertex_light::VertexLight;
use crate::rays::RayScene;
use crate::render::lighting::completion::completed;
use crate::texture::detail::Detail;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::scan::Scan;
use recordings::types::Keyframe;
use std::fmt::Write;
use tiny_skia::{PixmapPaint, Transform};

/// Panels in a row.
const COLUMNS: u32 = 4;
/// Space between panels.
const GAP: u32 = 16;
/// Space for a caption.
const CAPTION: u32 = 28;
/// Height of a line of text.
const LINE: u32 = 22;
/// Factor by which differences are shown.
const DIFFERENCE: f32 = 4.0;
/// Width of the small views by which the keyframe is chosen.
const THUMBNAIL: u32 = 48;

/// Draws the sheet as a PNG file.
///
/// # Errors
/// There is no keyframe to look from, or its picture cannot be decoded.
pub fn sheet(scan: &Scan, result: &Estimate) -> Result<Vec<u8>, String> {
    let (_, keyframe) = widest(result, &result.keyframes).ok_or("the result has no keyframe to look from")?;
    let photo =
        scan.keyframes.iter().find(|k| k.name == keyframe.name).ok_or("the scan lacks the result's keyframe")?;
    let photo = photo.color.decode().map_err(|e| format!("keyframe {}: {e}", keyframe.name))?;

    let view = KeyframeView::new(result, keyframe, PANEL);
    let frames: Vec<ResultKeyframe> = scan.witnesses.iter().map(as_given).collect();
    let validation = widest(result, &frames).filter(|(coverage, _)| *coverage > 0.0);
    let validation = validation.map(|(_, frame)| KeyframeView::new(result, frame, PANEL));
    let mut seen = view.seen();
    if let Some(other) = &validation {
        seen.iter_mut().zip(other.seen()).for_each(|(seen, other)| *seen |= other);
    }
    let scene = RayScene::new(&result.mesh);
    let light = VertexLight::new(result, &scene, &seen);
    let detail = detail(result)?;
    let gain = Vec3::from_array(keyframe.gain.map(|g| g as f32));
    let as_photographed = |v: Vec3| (v * gain).to_array().map(|c| f32::from(result.response.encode(c)) / 255.0);
    let (albedo_scale, ws_max) = (albedo_exposure(result, gain), largest_ws(result));
    let headlight = view.headlight();
    let by_segment = |color: &dyn Fn(usize) -> Vec3| -> Vec<Vec3> {
        result.segment.iter().zip(&headlight).map(|(s, light)| color(*s as usize) * *light).collect()
    };
    let ws_of = |s: usize| result.segments.get(s).map_or(0.0, |s| (s.w_s / ws_max.max(1e-6)) as f32);

    let mut panels = vec![
        (format!("Keyframe {}", keyframe.name), view.photo(&photo)),
        ("Lit colours, re-rendered".into(), view.paint_with(detail.as_ref(), &result.lit_color, as_photographed)),
        ("Albedo × light + gloss".into(), view.paint_with(detail.as_ref(), &view.model(&light), as_photographed)),
        (
            format!("Albedo × {albedo_scale:.2}, in the exposure of the lit colours"),
            view.paint_with(detail.as_ref(), &result.albedo, |v| display(v * albedo_scale)),
        ),
        (format!("{} segments", result.segments.len()), view.paint(&by_segment(&segment_color), |v| v.to_array())),
        (format!("Gloss w_s, 0 to {ws_max:.2}"), view.paint(&by_segment(&|s| heat(ws_of(s))), |v| v.to_array())),
    ];
    let lamps = lamps::seen(result);
    let environment = completed(result, Some(scan), &scene);
    let size = (PANEL as usize, PANEL as usize / 2);
    let radiance = hdr::panorama(&environment, size);
    let exposed = LightExposure::of(&radiance);
    let pixels = radiance.iter().map(|v| (exposed.display(*v), 1.0)).collect();
    let mut panorama = Panel { width: size.0 as u32, height: size.1 as u32, pixels };
    lamps::mark(&mut panorama, &lamps);
    let marked = if lamps.is_empty() { "" } else { "; rings: lamps" };
    panels.push((format!("Light, {} bands: up is +Z, left edge +Y{marked}", result.light.bands()), panorama));
    let height = panels[0].1.height;
    let around = (&environment, lamps.as_slice());
    let balls = spheres::panel(around, &keyframe.world_from_camera, (PANEL, height), |v| exposed.display(v));
    panels.push(("Grey, silver, mirror in this light".into(), balls));
    if let Some(view) = &validation {
        panels.extend(validation_panels(scan, result, view, detail.as_ref(), &light)?);
    }
    compose(&panels, &facts(scan, result), height)
}

/// The texture, decoded; `None` where there is none.
fn detail(result: &Estimate) -> Result<Option<Detail<'_>>, String> {
    result.texture.as_ref().map(|t| Detail::new(t, &result.mesh, &result.albedo)).transpose()
}

/// Of these frames the one in which the mesh covers most, with the share that it covers.
fn widest<'a>(result: &Estimate, frames: &'a [ResultKeyframe]) -> Option<(f64, &'a ResultKeyframe)> {
    let coverage = |k| (KeyframeView::new(result, k, THUMBNAIL).coverage(), k);
    let covered: Vec<(f64, &ResultKeyframe)> = frames.par_iter().map(coverage).collect();
    covered.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))
}

/// A validation frame from the place that tracking gave it.
fn as_given(frame: &Keyframe) -> ResultKeyframe {
    ResultKeyframe {
        name: frame.name.clone(),
        timestamp_ns: 0,
        gain: [1.0; 3],
        world_from_camera: frame.world_from_camera,
        camera: frame.camera,
        residual_px: 0.0,
    }
}

/// A validation frame (used by no step), its rendering, and their difference.
fn validation_panels(
    scan: &Scan,
    result: &Estimate,
    view: &KeyframeView,
    detail: Option<&Detail>,
    light: &VertexLight,
) -> Result<Vec<(String, Panel)>, String> {
    let Some(frame) = scan.witnesses.iter().find(|w| w.name == view.name()) else { return Ok(Vec::new()) };
    let picture = frame.color.decode().map_err(|e| format!("validation frame {}: {e}", frame.name))?;
    let photo = view.photo(&picture);
    let mut rendering = view.paint_with(detail, &view.model(light), |v| v.to_array());
    let table = result.response.linear_table();
    let gain = exposure(&photo, &rendering, &table);
    for (rgb, _) in &mut rendering.pixels {
        *rgb = std::array::from_fn(|c| f32::from(result.response.encode(rgb[c] * gain[c])) / 255.0);
    }
    let pixels = photo
        .pixels
        .iter()
        .zip(&rendering.pixels)
        .map(|((p, pc), (r, rc))| (std::array::from_fn(|c| (p[c] - r[c]).abs() * DIFFERENCE), pc.min(*rc)));
    let difference = Panel { width: photo.width, height: photo.height, pixels: pixels.collect() };
    Ok(vec![
        (format!("Validation frame {}", frame.name), photo),
        ("Its rendering".into(), rendering),
        (format!("Difference × {DIFFERENCE}"), difference),
    ])
}

/// Gain per channel under which linear `rendering` is as bright as `photo` (display values): median of ratios.
fn exposure(photo: &Panel, rendering: &Panel, table: &[f32; 256]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let both = photo.pixels.iter().zip(&rendering.pixels);
        let ratios =
            both.filter(|((p, pc), (r, rc))| *pc > 0.9 && *rc > 0.9 && p[c] > 0.05 && p[c] < 0.95 && r[c] > 1e-6);
        median(ratios.map(|((p, _), (r, _))| table[(p[c] * 255.0).round() as usize] / r[c])).unwrap_or(1.0)
    })
}

/// Lays the panels out, the facts in the last place.
fn compose(panels: &[(String, Panel)], facts: &[String], height: u32) -> Result<Vec<u8>, String> {
    let cell = (PANEL + GAP, height + CAPTION + GAP);
    let rows = (panels.len() as u32 + 1).div_ceil(COLUMNS);
    let place = |i: usize| (GAP + (i as u32 % COLUMNS) * cell.0, GAP + (i as u32 / COLUMNS) * cell.1);
    let text_end = place(panels.len()).1 + facts.len() as u32 * LINE + GAP;
    let height_of_all = text_end.max(rows * cell.1 + GAP);
    let mut page = page(COLUMNS * cell.0 + GAP, height_of_all).ok_or("the sheet is too large")?;
    for (i, (caption, panel)) in panels.iter().enumerate() {
        let (x, y) = place(i);
        fill(&mut page, (x, y, PANEL, height), NOTHING);
        let picture = pixmap(panel).ok_or("a panel is empty")?;
        let top = y + (height.saturating_sub(panel.height)) / 2;
        page.draw_pixmap(x as i32, top as i32, picture.as_ref(), &PixmapPaint::default(), Transform::identity(), None);
        write_text(&mut page, (x, y + height + 8), caption, TEXT);
    }
    let (x, mut y) = place(panels.len());
    for (i, line) in facts.iter().enumerate() {
        write_text(&mut page, (x, y), line, if i == 0 { TEXT } else { FAINT });
        y += LINE;
    }
    // The page is opaque.
    let rgb: Vec<u8> = page.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    encode_rgb(page.width(), page.height(), &rgb, png::Compression::Fast).map_err(|e| e.to_string())
}

/// Facts of the result, in lines that fit a panel.
fn facts(scan: &Scan, result: &Estimate) -> Vec<String> {
    let mut text = format!("{}\n", result.name);
    let (v, t) = (result.mesh.positions.len(), result.mesh.triangles.len());
    let _ = writeln!(text, "{v} vertices, {t} triangles");
    let _ = writeln!(text, "{} keyframes of {} frames", result.keyframes.len(), scan.stats.pairs);
    for (number, lamp) in result.local_light.lamps.iter().enumerate() {
        let [x, y, z] = lamp.center;
        let _ = writeln!(text, "lamp {number}: at {x:.2}, {y:.2}, {z:.2} m");
    }
    for w in &result.witnesses {
        let (lit, model) = (w.lit_psnr_db, w.model_psnr_db);
        let _ = writeln!(text, "validation {}: lit {lit:.1} dB, model {model:.1} dB", w.name);
    }
    for d in &result.decisions {
        let d = d.text();
        let _ = writeln!(text, "{}: {}", d.name, d.choice);
    }
    for cut in &result.cuts {
        let _ = writeln!(text, "cut: {cut}");
    }
    for warning in &result.warnings {
        let _ = writeln!(text, "! {warning}");
    }
    text.lines().flat_map(wrap).collect()
}

/// Breaks a line at spaces where it is wider than a panel; continuations are indented.
fn wrap(line: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in line.split(' ') {
        let last = lines.len() - 1;
        let longer = font::width(&format!("{} {word}", lines[last]), TEXT_SIZE);
        if !lines[last].trim().is_empty() && longer > PANEL as f32 {
            lines.push(format!("   {word}"));
        } else {
            let space = if lines[last].is_empty() { "" } else { " " };
            lines[last] += &format!("{space}{word}");
        }
    }
    lines
}

/// Factor under which the albedo is as bright as the lit colours are in the keyframe's exposure, as if all of it were lit alike;
/// less where white would be beyond white.
fn albedo_exposure(result: &Estimate, gain: Vec3) -> f32 {
    let seen = result.lit_color.iter().zip(&result.albedo).zip(&result.confidence).filter(|(_, c)| **c > 0.0);
    let ratios =
        seen.map(|((lit, albedo), _)| luminance(*lit) / luminance(*albedo)).filter(|r| r.is_finite() && *r > 0.0);
    let lit = median(ratios).map_or(1.0, |r| r * luminance(gain));
    let bright = high(result.albedo.iter().map(|a| a.max_element()), 0.98);
    if bright > 0.0 { lit.min(1.0 / bright) } else { lit }
}

fn high(values: impl Iterator<Item = f32>, share: f64) -> f32 {
    quantile(values.filter(|v| v.is_finite()), share).unwrap_or(0.0)
}

fn largest_ws(result: &Estimate) -> f64 {
    result.segments.iter().map(|s| s.w_s).filter(|w| w.is_finite()).fold(0.0, f64::max)
}
