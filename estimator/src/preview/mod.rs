//! The picture a person looks at first: one sheet with a keyframe, what the result makes of it, and the parts.

pub mod font;
pub mod spheres;
pub mod view;

use crate::export::{encode_srgb, hdr};
use crate::numerics::robust::median;
use crate::rays::RayScene;
use crate::render::lighting::completion::infer;
use crate::render::lighting::observed_background::surroundings;
use glam::Vec3;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::scan::Scan;
use recordings::types::RgbImage;
use std::fmt::Write;
use tiny_skia::{Color, Paint, Pixmap, PixmapPaint, PremultipliedColorU8, Rect, Transform};
use view::{Panel, View};

/// Width of a panel in pixels.
const PANEL: u32 = 480;
/// Panels in a row.
const COLUMNS: u32 = 4;
/// Space between panels.
const GAP: u32 = 16;
/// Space for a caption.
const CAPTION: u32 = 28;
/// Size of a font dot in pixels.
const DOT: u32 = 2;
/// Height of a line of text.
const LINE: u32 = 22;
/// Factor by which differences are shown.
const DIFFERENCE: f32 = 4.0;
/// Width of the small views by which the keyframe is chosen.
const THUMBNAIL: u32 = 48;

const BACKGROUND: [u8; 3] = [18, 20, 24];
pub(crate) const NOTHING: [u8; 3] = [34, 37, 43];
pub(crate) const TEXT: [u8; 3] = [226, 228, 232];
pub(crate) const FAINT: [u8; 3] = [150, 155, 165];

/// Draws the sheet as a PNG file.
///
/// # Errors
/// There is no keyframe to look from, or its picture cannot be decoded.
pub fn sheet(scan: &Scan, result: &Estimate) -> Result<Vec<u8>, String> {
    let coverage = |k| View::new(result, k, THUMBNAIL).coverage();
    let best = result.keyframes.iter().map(|k| (coverage(k), k)).max_by(|a, b| a.0.total_cmp(&b.0));
    let (_, keyframe) = best.ok_or("the result has no keyframe to look from")?;
    let photo =
        scan.keyframes.iter().find(|k| k.name == keyframe.name).ok_or("the scan lacks the result's keyframe")?;
    let photo = photo.color.decode().map_err(|e| format!("keyframe {}: {e}", keyframe.name))?;

    let view = View::new(result, keyframe, PANEL);
    let gain = Vec3::from_array(keyframe.gain.map(|g| g as f32));
    let as_photographed = |v: Vec3| (v * gain).to_array().map(|c| f32::from(result.response.encode(c)) / 255.0);
    let (albedo_scale, ws_max) = (display_scale(&result.albedo), largest_ws(result));
    let headlight = view.headlight();
    let by_segment = |color: &dyn Fn(usize) -> Vec3| -> Vec<Vec3> {
        result.segment.iter().zip(&headlight).map(|(s, light)| color(*s as usize) * *light).collect()
    };
    let ws_of = |s: usize| result.segments.get(s).map_or(0.0, |s| (s.w_s / ws_max.max(1e-6)) as f32);

    let mut panels = vec![
        (format!("Keyframe {}", keyframe.name), view.photo(&photo)),
        ("Lit colours, re-rendered".into(), view.paint(&result.lit_color, as_photographed)),
        ("Albedo × light + gloss".into(), view.paint(&view.model(), as_photographed)),
        (format!("Albedo (× {albedo_scale:.2})"), view.paint(&result.albedo, |v| display(v * albedo_scale))),
        (format!("{} segments", result.segments.len()), view.paint(&by_segment(&segment_color), |v| v.to_array())),
        (format!("Gloss w_s, 0 to {ws_max:.2}"), view.paint(&by_segment(&|s| heat(ws_of(s))), |v| v.to_array())),
        (format!("Light, {} bands: up is +Z, left edge +Y", result.light.bands()), light(result)),
    ];
    let height = panels[0].1.height;
    let balls =
        spheres::panel(&surrounding_light(scan, result), &keyframe.world_from_camera, (PANEL, height), as_photographed);
    panels.push(("Grey, silver, mirror in this light".into(), balls));
    panels.extend(witness(scan, result)?);
    compose(&panels, &facts(scan, result), height)
}

/// The witness that is covered most (no step used it), its rendering and what the two differ by; none without witnesses.
fn witness(scan: &Scan, result: &Estimate) -> Result<Vec<(String, Panel)>, String> {
    let of = |w: &recordings::types::Keyframe| ResultKeyframe {
        name: w.name.clone(),
        timestamp_ns: 0,
        gain: [1.0; 3],
        world_from_camera: w.world_from_camera,
        camera: w.camera,
        residual_px: 0.0,
    };
    let coverage = |w: &recordings::types::Keyframe| View::new(result, &of(w), THUMBNAIL).coverage();
    let best = scan.witnesses.iter().map(|w| (coverage(w), w)).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, frame)) = best.filter(|(c, _)| *c > 0.0) else {
        return Ok(Vec::new());
    };
    let picture = frame.color.decode().map_err(|e| format!("witness {}: {e}", frame.name))?;
    let from = of(frame);
    let view = View::new(result, &from, PANEL);
    let photo = view.photo(&picture);
    let mut rendering = view.paint(&view.model(), |v| v.to_array());
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
        (format!("Witness {}, used by no step", frame.name), photo),
        ("Its rendering".into(), rendering),
        (format!("Difference (x {DIFFERENCE})"), difference),
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

/// The recovered light with what the keyframes saw beyond the scan.
fn surrounding_light(scan: &Scan, result: &Estimate) -> crate::render::lighting::environment::Environment {
    let picture = |name: &str| scan.keyframes.iter().find(|k| k.name == name)?.color.decode().ok();
    let pictures: Vec<Option<RgbImage>> = result.keyframes.iter().map(|k| picture(&k.name)).collect();
    infer(&result.light, &surroundings(result, &RayScene::new(&result.mesh), &pictures))
}

/// Lays the panels out, the facts in the last place.
fn compose(panels: &[(String, Panel)], facts: &[String], height: u32) -> Result<Vec<u8>, String> {
    let cell = (PANEL + GAP, height + CAPTION + GAP);
    let rows = (panels.len() as u32 + 1).div_ceil(COLUMNS);
    let mut page = page(COLUMNS * cell.0 + GAP, rows * cell.1 + GAP).ok_or("the sheet is too large")?;
    let place = |i: usize| (GAP + (i as u32 % COLUMNS) * cell.0, GAP + (i as u32 / COLUMNS) * cell.1);
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
    page.encode_png().map_err(|e| e.to_string())
}

/// What the result says of itself, in lines that fit a panel.
fn facts(scan: &Scan, result: &Estimate) -> Vec<String> {
    let mut text = format!("{}\n", result.name);
    let (v, t) = (result.mesh.positions.len(), result.mesh.triangles.len());
    let _ = writeln!(text, "{v} vertices, {t} triangles");
    let _ = writeln!(text, "{} keyframes of {} frames", result.keyframes.len(), scan.stats.pairs);
    for w in &result.witnesses {
        let (lit, model) = (w.lit_psnr_db, w.model_psnr_db);
        let _ = writeln!(text, "witness {}: lit {lit:.1} dB, model {model:.1} dB", w.name);
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
    let columns = (PANEL / ((font::COLUMNS as u32 + 1) * DOT)) as usize;
    text.lines().flat_map(|line| wrap(line, columns)).collect()
}

/// Breaks a line at spaces; continuations are indented.
fn wrap(line: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in line.split(' ') {
        let last = lines.len() - 1;
        if !lines[last].trim().is_empty() && lines[last].chars().count() + 1 + word.chars().count() > columns {
            lines.push(format!("  {word}"));
        } else {
            let space = if lines[last].is_empty() { "" } else { " " };
            lines[last] += &format!("{space}{word}");
        }
    }
    lines
}

/// The light as a panorama, its 99th percentile white.
fn light(result: &Estimate) -> Panel {
    let (w, h) = (PANEL as usize, PANEL as usize / 2);
    let radiance: Vec<Vec3> = hdr::panorama(&result.light, (w, h)).into_iter().map(Vec3::from_array).collect();
    let white = percentile(radiance.iter().map(|v| v.max_element()), 0.99).max(f32::MIN_POSITIVE);
    let pixels = radiance.iter().map(|v| (display(*v / white), 1.0)).collect();
    Panel { width: w as u32, height: h as u32, pixels }
}

/// Factor that brings the brightest albedos near white: their common scale is free.
fn display_scale(albedo: &[Vec3]) -> f32 {
    let bright = percentile(albedo.iter().map(|a| a.max_element()), 0.98);
    if bright > 0.0 { 0.9 / bright } else { 1.0 }
}

fn percentile(values: impl Iterator<Item = f32>, share: f32) -> f32 {
    let mut finite: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        return 0.0;
    }
    let at = ((finite.len() - 1) as f32 * share) as usize;
    *finite.select_nth_unstable_by(at, f32::total_cmp).1
}

fn largest_ws(result: &Estimate) -> f64 {
    result.segments.iter().map(|s| s.w_s).filter(|w| w.is_finite()).fold(0.0, f64::max)
}

/// Linear to screen values.
fn display(linear: Vec3) -> [f32; 3] {
    linear.to_array().map(|c| f32::from(encode_srgb(c)) / 255.0)
}

/// Colours of segments: hues a golden angle apart, so that neighbours in number differ most.
fn segment_color(segment: usize) -> Vec3 {
    let hue = (segment as f32 * 0.618_034).fract() * 6.0;
    let lightness = [1.0, 0.78, 0.6][segment % 3];
    let ramp = |offset: f32| (((hue + offset) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    (Vec3::new(ramp(0.0), ramp(4.0), ramp(2.0)) * 0.7 + 0.3) * lightness
}

/// Dark blue over red to yellow.
fn heat(value: f32) -> Vec3 {
    const STOPS: [Vec3; 4] = [
        Vec3::new(0.16, 0.18, 0.38),
        Vec3::new(0.55, 0.16, 0.50),
        Vec3::new(0.93, 0.37, 0.25),
        Vec3::new(1.0, 0.92, 0.5),
    ];
    let x = value.clamp(0.0, 1.0) * 3.0;
    let i = (x as usize).min(2);
    STOPS[i].lerp(STOPS[i + 1], x - i as f32)
}

/// An empty sheet; `None` if it has no size, or too much of it.
pub(crate) fn page(width: u32, height: u32) -> Option<Pixmap> {
    let mut page = Pixmap::new(width, height)?;
    page.fill(color(BACKGROUND));
    Some(page)
}

fn color([r, g, b]: [u8; 3]) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

pub(crate) fn fill(page: &mut Pixmap, (x, y, w, h): (u32, u32, u32, u32), with: [u8; 3]) {
    let mut paint = Paint { anti_alias: false, ..Paint::default() };
    paint.set_color(color(with));
    if let Some(rect) = Rect::from_xywh(x as f32, y as f32, w as f32, h as f32) {
        page.fill_rect(rect, &paint, Transform::identity(), None);
    }
}

fn pixmap(panel: &Panel) -> Option<Pixmap> {
    let mut picture = Pixmap::new(panel.width, panel.height)?;
    for (pixel, (rgb, covered)) in picture.pixels_mut().iter_mut().zip(&panel.pixels) {
        let alpha = (covered * 255.0).round() as u8;
        let [r, g, b] = rgb.map(|c| (c.clamp(0.0, 1.0) * f32::from(alpha)).round() as u8);
        *pixel = PremultipliedColorU8::from_rgba(r, g, b, alpha)?;
    }
    Some(picture)
}

pub(crate) fn write_text(page: &mut Pixmap, (x, y): (u32, u32), text: &str, with: [u8; 3]) {
    let step = (font::COLUMNS as u32 + 1) * DOT;
    for (i, character) in (0u32..).zip(text.chars().take((PANEL / step) as usize)) {
        for (row, bits) in (0u32..).zip(font::glyph(character)) {
            for column in (0..font::COLUMNS as u32).filter(|c| bits >> (font::COLUMNS as u32 - 1 - c) & 1 == 1) {
                fill(page, (x + i * step + column * DOT, y + row * DOT, DOT, DOT), with);
            }
        }
    }
}
