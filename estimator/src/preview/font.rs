//! Text: Inter, a typeface under the SIL Open Font License (`font/OFL.txt`), rasterised by `ab_glyph`.

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use std::sync::LazyLock;

/// The font file: Latin letters, figures and the signs that captions have.
pub const INTER: &[u8] = include_bytes!("font/Inter-Regular.otf");

static FONT: LazyLock<Option<FontRef<'static>>> = LazyLock::new(|| FontRef::try_from_slice(INTER).ok());

/// Width of a line in pixels at a text size in pixels.
#[must_use]
pub fn width(text: &str, size: f32) -> f32 {
    layout(text, size).1
}

/// Draws a line whose upper left corner is (0, 0): `put(x, y, covered share)` for every pixel that it touches.
pub fn draw(text: &str, size: f32, mut put: impl FnMut(i32, i32, f32)) {
    let Some(font) = &*FONT else { return };
    for glyph in layout(text, size).0 {
        if let Some(outline) = font.outline_glyph(glyph) {
            let at = outline.px_bounds().min;
            outline.draw(|x, y, share| put(at.x as i32 + x as i32, at.y as i32 + y as i32, share));
        }
    }
}

/// Glyphs in their places, and the width of all.
fn layout(text: &str, size: f32) -> (Vec<Glyph>, f32) {
    let Some(font) = &*FONT else { return (Vec::new(), 0.0) };
    let scale = PxScale::from(size);
    let scaled = font.as_scaled(scale);
    let (mut glyphs, mut x, mut before) = (Vec::new(), 0.0, None);
    for character in text.chars() {
        let id = scaled.glyph_id(character);
        x += before.map_or(0.0, |b| scaled.kern(b, id));
        glyphs.push(id.with_scale_and_position(scale, point(x, scaled.ascent())));
        x += scaled.h_advance(id);
        before = Some(id);
    }
    (glyphs, x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sign_of_captions_and_decisions_has_a_glyph() {
        let font = FONT.as_ref().expect("the font can be read");
        for c in ('!'..='~').chain("°±·×–—…≈≤≥−→µ²³äöüéß".chars()) {
            assert_ne!(font.glyph_id(c).0, 0, "{c}");
        }
    }

    #[test]
    fn a_line_is_drawn_within_its_width() {
        let (mut ink, mut right, mut low) = (0.0, 0, 0);
        draw("Albedo × light", 18.0, |x, y, share| {
            ink += share;
            (right, low) = (right.max(x), low.max(y));
        });
        let width = width("Albedo × light", 18.0);
        assert!(
            ink > 100.0 && (right as f32) < width && (right as f32) > width - 4.0 && low < 22,
            "{ink} {right} {low}"
        );
        assert!(super::width("iiii", 18.0) < super::width("mmmm", 18.0));
    }
}
