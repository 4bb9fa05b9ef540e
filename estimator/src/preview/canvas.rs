//! Drawing on a page of pixels: rectangles, panels, text.

use crate::preview::font;
use crate::preview::keyframe_view::Panel;
use tiny_skia::{Color, Paint, Pixmap, PremultipliedColorU8, Rect, Transform};

/// Width of a panel in pixels.
pub const PANEL: u32 = 480;
/// Size of the text in pixels.
pub const TEXT_SIZE: f32 = 18.0;

const BACKGROUND: [u8; 3] = [18, 20, 24];
/// Where nothing is shown.
pub const NOTHING: [u8; 3] = [34, 37, 43];
/// Text.
pub const TEXT: [u8; 3] = [226, 228, 232];
/// Text that matters less.
pub const FAINT: [u8; 3] = [150, 155, 165];

/// An empty sheet; `None` if it has no size, or too much of it.
pub fn page(width: u32, height: u32) -> Option<Pixmap> {
    let mut page = Pixmap::new(width, height)?;
    page.fill(color(BACKGROUND));
    Some(page)
}

fn color([r, g, b]: [u8; 3]) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

/// Fills a rectangle (x, y, width, height).
pub fn fill(page: &mut Pixmap, (x, y, w, h): (u32, u32, u32, u32), with: [u8; 3]) {
    let mut paint = Paint { anti_alias: false, ..Paint::default() };
    paint.set_color(color(with));
    if let Some(rect) = Rect::from_xywh(x as f32, y as f32, w as f32, h as f32) {
        page.fill_rect(rect, &paint, Transform::identity(), None);
    }
}

/// A panel as a picture; `None` if it is empty.
pub fn pixmap(panel: &Panel) -> Option<Pixmap> {
    let mut picture = Pixmap::new(panel.width, panel.height)?;
    for (pixel, (rgb, covered)) in picture.pixels_mut().iter_mut().zip(&panel.pixels) {
        let alpha = (covered * 255.0).round() as u8;
        let [r, g, b] = rgb.map(|c| (c.clamp(0.0, 1.0) * f32::from(alpha)).round() as u8);
        *pixel = PremultipliedColorU8::from_rgba(r, g, b, alpha)?;
    }
    Some(picture)
}

/// Writes a line of text whose upper left corner is (x, y); what is longer than a panel is cut off.
pub fn write_text(page: &mut Pixmap, (x, y): (u32, u32), text: &str, with: [u8; 3]) {
    let (width, height) = (page.width() as i32, page.height() as i32);
    font::draw(text, TEXT_SIZE, |dx, dy, share| {
        let (px, py) = (x as i32 + dx, y as i32 + dy);
        if dx >= PANEL as i32 || px < 0 || py < 0 || px >= width || py >= height {
            return;
        }
        let pixel = &mut page.pixels_mut()[(py * width + px) as usize];
        let mix = |below: u8, c: u8| (f32::from(below) + (f32::from(c) - f32::from(below)) * share).round() as u8;
        let [r, g, b] = [mix(pixel.red(), with[0]), mix(pixel.green(), with[1]), mix(pixel.blue(), with[2])];
        *pixel = PremultipliedColorU8::from_rgba(r, g, b, 255).unwrap_or(*pixel);
    });
}
