//! Plots as PNG and SVG files, drawn by `plotters` with the bundled typeface: no font of the system is needed.

use crate::export::picture::encode_rgb;
use crate::preview::font::INTER;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::error::Error;
use std::sync::LazyLock;

/// Name by which plots ask for the typeface; browsers show an SVG file with their own.
const FAMILY: &str = "sans-serif";
/// Fewer ticks than this say nothing of a logarithmic axis.
const LEAST_TICKS: usize = 4;

static TYPEFACE: LazyLock<bool> =
    LazyLock::new(|| plotters::style::register_font(FAMILY, FontStyle::Normal, INTER).is_ok());

/// What draws onto an area of any kind.
pub type Drawn = Result<(), Box<dyn Error + Send + Sync>>;

/// A PNG file of `(width, height)` pixels that `draw` fills, on white.
///
/// # Errors
/// It could not be drawn.
pub fn png(
    (width, height): (u32, u32),
    draw: impl FnOnce(DrawingArea<BitMapBackend<'_>, Shift>) -> Drawn,
) -> Result<Vec<u8>, String> {
    ready()?;
    let mut pixels = vec![255u8; 3 * width as usize * height as usize];
    draw(BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area()).map_err(|e| e.to_string())?;
    encode_rgb(width, height, &pixels, png::Compression::default()).map_err(|e| e.to_string())
}

/// The same as an SVG file.
///
/// # Errors
/// It could not be drawn.
pub fn svg(size: (u32, u32), draw: impl FnOnce(DrawingArea<SVGBackend<'_>, Shift>) -> Drawn) -> Result<String, String> {
    ready()?;
    let mut text = String::new();
    draw(SVGBackend::with_string(&mut text, size).into_drawing_area()).map_err(|e| e.to_string())?;
    Ok(text)
}

fn ready() -> Result<(), String> {
    if *TYPEFACE { Ok(()) } else { Err("the bundled typeface cannot be read".into()) }
}

/// Text of a size in pixels.
#[must_use]
pub fn text(size: u32) -> TextStyle<'static> {
    (FAMILY, size).into_font().color(&RGBColor(40, 40, 46))
}

/// Range of a logarithmic axis around positive values; `None` without any.
#[must_use]
pub fn log_range(values: impl Iterator<Item = f64>) -> Option<std::ops::Range<f64>> {
    const ROOM: f64 = 1.2;
    let (low, high) =
        values.filter(|v| v.is_finite() && *v > 0.0).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    (low < f64::INFINITY).then(|| low / ROOM..high * ROOM)
}

/// Ticks of a logarithmic axis: 1, 2, 5 times powers of ten, or closer where these are few.
#[must_use]
pub fn log_ticks(range: &std::ops::Range<f64>) -> Vec<f64> {
    let within = |steps: &[f64]| -> Vec<f64> {
        let powers = (-12..12).map(|e| libm::pow(10.0, f64::from(e)));
        powers.flat_map(|p| steps.iter().map(move |s| s * p)).filter(|t| range.contains(t)).collect()
    };
    let tried = [within(&[1.0]), within(&[1.0, 2.0, 5.0]), within(&[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0])];
    let finest: Vec<f64> = (10..100).map(|i| f64::from(i) / 10.0).collect();
    tried.into_iter().find(|t| t.len() >= LEAST_TICKS).unwrap_or_else(|| within(&finest))
}

/// A number without zeros that say nothing.
#[must_use]
pub fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_logarithmic_axis_has_ticks() {
        for range in [0.9..100.0, 2.0..70.0, 0.031..0.052, 0.11..0.3, 1e-3..1e4] {
            let ticks = log_ticks(&range);
            assert!(ticks.len() >= LEAST_TICKS && ticks.len() <= 24, "{range:?}: {ticks:?}");
            assert!(ticks.iter().all(|t| range.contains(t)) && ticks.is_sorted());
        }
        assert_eq!(log_ticks(&(0.9..1500.0)), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!([short(0.05), short(2.0), short(1000.0), short(0.1234)], ["0.05", "2", "1000", "0.1234"]);
        assert_eq!(log_range([f64::NAN, 0.0].into_iter()), None);
    }
}
