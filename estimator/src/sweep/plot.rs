//! Error against seconds, both logarithmic: one panel a scene.

use crate::preview::canvas::{FAINT, NOTHING, TEXT, fill, page, write_text};
use crate::sweep::point::Point;
use recordings::decision::TransferLevel;
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// Size of a panel, and the room around its axes.
const WIDTH: u32 = 720;
const HEIGHT: u32 = 480;
const LEFT: u32 = 88;
const BOTTOM: u32 = 44;
const TOP: u32 = 40;
const RIGHT: u32 = 24;
/// Colours of diffuse, shade, gi and of everything else.
const LEVELS: [(TransferLevel, [u8; 3]); 3] = [
    (TransferLevel::Diffuse, [120, 140, 170]),
    (TransferLevel::Shade, [90, 190, 220]),
    (TransferLevel::Gi, [245, 170, 60]),
];
const AUTO: [u8; 3] = [110, 235, 120];
const PAPER: [u8; 3] = [240, 90, 110];

/// Draws the sweeps of several scenes as a PNG file.
///
/// # Errors
/// There is nothing to draw.
pub fn draw(scenes: &[(String, Vec<Point>)]) -> Result<Vec<u8>, String> {
    let mut sheet =
        page(WIDTH * scenes.len().min(2) as u32, HEIGHT * scenes.len().div_ceil(2) as u32).ok_or("nothing to draw")?;
    for (i, (name, points)) in (0u32..).zip(scenes) {
        panel(&mut sheet, (WIDTH * (i % 2), HEIGHT * (i / 2)), name, points);
    }
    sheet.encode_png().map_err(|e| e.to_string())
}

/// A logarithmic axis onto pixels.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn new(values: impl Iterator<Item = f64>, from: u32, to: u32) -> Self {
        let (low, high) = values
            .filter(|v| v.is_finite() && *v > 0.0)
            .fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        let (low, high) = if low < f64::INFINITY { (low / 1.15, high * 1.15) } else { (0.1, 1.0) };
        Self { low, high, from: f64::from(from), to: f64::from(to) }
    }

    fn at(&self, value: f64) -> f32 {
        let share = libm::log(value.clamp(self.low, self.high) / self.low) / libm::log(self.high / self.low);
        (self.from + share * (self.to - self.from)) as f32
    }

    /// 1, 2, 5 times powers of ten within the axis.
    fn ticks(&self) -> Vec<f64> {
        let powers = (-6..6).map(|e| libm::pow(10.0, f64::from(e)));
        powers.flat_map(|p| [p, 2.0 * p, 5.0 * p]).filter(|t| (self.low..=self.high).contains(t)).collect()
    }
}

fn panel(sheet: &mut Pixmap, (x0, y0): (u32, u32), name: &str, points: &[Point]) {
    let (left, right, top, bottom) = (x0 + LEFT, x0 + WIDTH - RIGHT, y0 + TOP, y0 + HEIGHT - BOTTOM);
    let x = Axis::new(points.iter().map(|p| p.seconds), left, right);
    let y = Axis::new(points.iter().map(Point::error), bottom, top);
    write_text(sheet, (left, y0 + 12), &format!("{name}: error / s"), TEXT);
    for t in x.ticks() {
        fill(sheet, (x.at(t) as u32, top, 1, bottom - top), NOTHING);
        write_text(sheet, ((x.at(t) as u32).saturating_sub(8), bottom + 10), &format!("{t}"), FAINT);
    }
    for t in y.ticks() {
        fill(sheet, (left, y.at(t) as u32, right - left, 1), NOTHING);
        write_text(sheet, (x0 + 12, (y.at(t) as u32).saturating_sub(8)), &short(t), FAINT);
    }
    let mut front: Vec<&Point> = points.iter().filter(|p| p.pareto).collect();
    front.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let mut line = PathBuilder::new();
    for (i, p) in front.iter().enumerate() {
        let at = (x.at(p.seconds), y.at(p.error()));
        if i == 0 { line.move_to(at.0, at.1) } else { line.line_to(at.0, at.1) }
    }
    if let Some(path) = line.finish() {
        let stroke = Stroke { width: 2.0, ..Stroke::default() };
        sheet.stroke_path(&path, &paint(TEXT), &stroke, Transform::identity(), None);
    }
    let mut named: Vec<(&Point, [u8; 3])> = Vec::new();
    for p in points {
        let level = LEVELS.iter().find(|l| l.0 == p.transfer).map_or(TEXT, |l| l.1);
        match p.name.as_str() {
            "auto" => named.push((p, AUTO)),
            "paper" => named.push((p, PAPER)),
            _ => dot(sheet, x.at(p.seconds), y.at(p.error()), if p.pareto { 5.0 } else { 3.5 }, level),
        }
    }
    for (p, color) in named {
        let (px, py) = (x.at(p.seconds), y.at(p.error()));
        dot(sheet, px, py, 7.0, color);
        let place = ((px as u32 + 10).min(right.saturating_sub(70)), (py as u32).saturating_sub(22).max(top));
        write_text(sheet, place, &p.name, color);
    }
    for (i, (level, color)) in (0u32..).zip(LEVELS) {
        write_text(sheet, (right - 300 + 100 * i, y0 + 12), level.name(), color);
    }
}

fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').to_owned()
}

fn paint([r, g, b]: [u8; 3]) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color(Color::from_rgba8(r, g, b, 255));
    paint
}

fn dot(sheet: &mut Pixmap, x: f32, y: f32, radius: f32, color: [u8; 3]) {
    if let Some(circle) = PathBuilder::from_circle(x, y, radius) {
        sheet.fill_path(&circle, &paint(color), FillRule::Winding, Transform::identity(), None);
    }
}
