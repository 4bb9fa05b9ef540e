//! Vertices as sharp as the pictures show them.

use crate::association::sharpening::sharp_colors;
use crate::factorisation::Factorised;
use crate::factorisation::albedo::plausible;
use crate::stages::prepare::Prepared;
use glam::Vec3;

/// Takes the blur of sampling windows and lens out of the albedo, as far as it is paint, and out of the lit colours as far, which leaves
/// the light of every vertex what it was; also out of those `with_gloss`, `[vertex]`.
pub fn sharpen(prepared: &mut Prepared, found: &mut Factorised, with_gloss: &mut [Vec3]) {
    let Prepared { graph, fields, .. } = prepared;
    let sharp = sharp_colors(&fields.lit_color, &fields.lit_weight, graph);
    for (i, sharp) in sharp.into_iter().enumerate() {
        let (color, painted) = (fields.lit_color[i], found.detail.painted[i]);
        if painted > 0.0 && color.min_element() > 0.0 {
            let factor = (sharp / color).map(|x| libm::powf(x, painted));
            found.detail.albedo[i] = plausible(found.detail.albedo[i] * factor);
            fields.lit_color[i] *= factor;
            with_gloss[i] *= factor;
        }
    }
}
