//! The albedo texture: radiance of the texels, less gloss, over the light at the vertices.

use crate::association::sharpening::sharper;
use crate::association::{AssociationContext, Lens};
use crate::export::picture::encode_jpeg;
use crate::texture::atlas::{Atlas, EMPTY};
use crate::texture::filling::{Filling, VertexColors};
use crate::texture::mutual::register_views;
use crate::texture::views::{PosedKeyframe, TextureView, views};
use firmware_config::TextureChoice;
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::{AtlasFigures, Decision};
use recordings::result::Texture;
use recordings::types::Response;

/// Vertices at which the footprint of the pixels is looked up.
const FOOTPRINT_VERTICES: usize = 4000;
/// Largest albedo that the picture holds: beyond it darker ones would be too coarse in 8 bits.
const MAX_SCALE: f32 = 3.0;
/// Share of the page whose texels may be cut at the largest value: specks of gloss do not make all else coarser.
const CUT_SHARE: f64 = 1e-3;
/// Variance of the blur of lens and interpolation along each axis, pixels².
const BLUR_PX2: f32 = 0.4;
/// More than this share of a texel's difference from its neighbours is not put back: noise would be.
const MOST_LOST: f32 = 0.9;
/// Rings of empty texels around the charts that take their mean colour, for coarse mipmaps and the blocks of JPEG.
const FILL_RINGS: usize = 8;

/// A texture, and how it was decided. `lens` is what the colours of the vertices are free of.
#[must_use]
pub fn texture(
    context: &AssociationContext,
    keyframes: &[PosedKeyframe],
    colors: VertexColors,
    lens: Lens,
) -> (Option<Texture>, Decision) {
    let (tuning, mut views) = (&context.config.tuning.texture, views(context, keyframes, lens));
    let none = |footprint_m| (None, Decision::Texture { footprint_m, atlas: None, prediction: None });
    let Some(footprint) = footprint(context, &views) else { return none(0.0) };
    let wanted = match context.config.texture {
        TextureChoice::Texel(mm) => 1e-3 * mm as f32,
        _ => footprint * tuning.texel_px as f32,
    };
    let Some(atlas) = Atlas::new(context.mesh, wanted, tuning) else { return none(f64::from(footprint)) };
    let moved = register_views(context, &mut views, &atlas);
    tracing::debug!(moved_px = moved, "pictures registered to each other");
    let (blurred, seen) = Filling::new(context, &views, &atlas, colors).texels();
    drop(views);
    let albedo = sharpened(&blurred, &seen, &atlas, footprint);
    drop(blurred);
    let scale = scale(&albedo);
    let mut pixels = encoded(&albedo, scale);
    drop(albedo);
    fill(&mut pixels, &atlas);
    let Ok(jpeg) = encode_jpeg(atlas.width, atlas.height, &pixels, tuning.jpeg_quality as u8) else {
        return none(f64::from(footprint));
    };
    let texels = atlas.owner.iter().filter(|o| **o != EMPTY).count();
    let figures = AtlasFigures {
        width: atlas.width,
        height: atlas.height,
        texel_m: f64::from(atlas.texel),
        charts: atlas.charts.len() as u32,
        texels: texels as u32,
        seen: seen.iter().filter(|s| **s).count() as f64 / texels.max(1) as f64,
    };
    let Atlas { width, height, texel, charts, chart, .. } = atlas;
    let texture = Texture { width, height, texel_m: texel, scale, charts, chart, jpeg };
    let footprint_m = f64::from(footprint);
    (Some(texture), Decision::Texture { footprint_m, atlas: Some(figures), prediction: None })
}

/// Width that the smallest pixel of the vertices has at those seen from near (`texture.near_share` of them).
fn footprint(context: &AssociationContext, views: &[TextureView]) -> Option<f32> {
    let mesh = context.mesh;
    let stride = mesh.positions.len().div_ceil(FOOTPRINT_VERTICES).max(1);
    let smallest = (0..mesh.positions.len()).into_par_iter().step_by(stride).filter_map(|i| {
        let samples = views.iter().filter_map(|v| v.sample(context, mesh.positions[i], mesh.normals[i]));
        samples.map(|s| s.footprint).reduce(f32::min)
    });
    let mut smallest: Vec<f32> = smallest.collect();
    smallest.sort_by(f32::total_cmp);
    let share = context.config.tuning.texture.near_share;
    smallest.get((share * smallest.len() as f64) as usize).or(smallest.last()).copied()
}

/// Texels that keyframes show without the blur of lens and pixels as wide as `footprint`, within their charts.
fn sharpened(texels: &[Vec3], seen: &[bool], atlas: &Atlas, footprint: f32) -> Vec<Vec3> {
    let per_texel = footprint / atlas.texel;
    let lost = (2.0 * BLUR_PX2 * per_texel * per_texel).min(MOST_LOST);
    let width = atlas.width as usize;
    let is_seen = |at: &usize| seen.get(*at).is_some_and(|s| *s);
    let chart = |at: usize| Some(at).filter(is_seen).map(|at| atlas.chart[atlas.owner[at] as usize]);
    let sharp = |at: usize| {
        let Some(own) = chart(at) else { return texels[at] };
        let around = [at.wrapping_sub(1), at + 1, at.wrapping_sub(width), at + width];
        sharper(texels[at], around.into_iter().filter(|k| chart(*k) == Some(own)).map(|k| texels[k]), lost)
    };
    (0..texels.len()).into_par_iter().map(sharp).collect()
}

/// The albedo that 255 stands for: 1, or more where texels are brighter than that. Vertices of white paper have the mean of
/// paper and print, or are held at 1: the paper between the print is above them.
fn scale(texels: &[Vec3]) -> f32 {
    let mut above: Vec<f32> = texels.iter().map(|a| a.max_element()).filter(|a| *a > 1.0).collect();
    let cut = (CUT_SHARE * texels.len() as f64) as usize;
    if above.len() <= cut {
        return 1.0;
    }
    let (_, scale, _) = above.select_nth_unstable_by(cut, |a, b| b.total_cmp(a));
    scale.min(MAX_SCALE)
}

/// Albedo over `scale` in sRGB bytes, `[row][column][channel]`.
fn encoded(texels: &[Vec3], scale: f32) -> Vec<u8> {
    let mut bytes = vec![0u8; 3 * texels.len()];
    bytes.par_chunks_mut(3).zip(texels).for_each(|(bytes, albedo)| {
        bytes.copy_from_slice(&(*albedo / scale).to_array().map(|a| Response::Srgb.encode(a)));
    });
    bytes
}

/// Continues the charts over the empty texels around them, and gives the rest their mean colour.
fn fill(pixels: &mut [u8], atlas: &Atlas) {
    let (w, h) = (atlas.width as usize, atlas.height as usize);
    let mut known: Vec<bool> = atlas.owner.iter().map(|o| *o != EMPTY).collect();
    let (mut sum, mut count) = ([0u64; 3], 0u64);
    for at in (0..known.len()).filter(|at| known[*at]) {
        (0..3).for_each(|c| sum[c] += u64::from(pixels[3 * at + c]));
        count += 1;
    }
    for _ in 0..FILL_RINGS {
        let around = |at: usize| {
            let (x, y) = (at % w, at / w);
            let inside =
                [(x > 0, at.wrapping_sub(1)), (x + 1 < w, at + 1), (y > 0, at.wrapping_sub(w)), (y + 1 < h, at + w)];
            inside.into_iter().filter_map(|(inside, at)| inside.then_some(at))
        };
        let ring: Vec<(usize, [u8; 3])> = (0..known.len())
            .into_par_iter()
            .filter(|at| !known[*at])
            .filter_map(|at| {
                let (sum, n) = around(at).filter(|n| known[*n]).fold(([0u32; 3], 0), |(s, n), i| {
                    (std::array::from_fn(|c| s[c] + u32::from(pixels[3 * i + c])), n + 1)
                });
                (n > 0).then(|| (at, sum.map(|s| (s / n) as u8)))
            })
            .collect();
        for (at, color) in ring {
            pixels[3 * at..3 * at + 3].copy_from_slice(&color);
            known[at] = true;
        }
    }
    let mean = sum.map(|s| (s / count.max(1)) as u8);
    (0..known.len()).filter(|at| !known[*at]).for_each(|at| pixels[3 * at..3 * at + 3].copy_from_slice(&mean));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_brighter_than_its_vertices_is_not_cut_and_specks_are() {
        let mut texels = vec![Vec3::splat(0.4); 10_000];
        assert_eq!(scale(&texels), 1.0);
        texels[..5].fill(Vec3::splat(2.5));
        assert_eq!(scale(&texels), 1.0, "specks");
        texels[..500].fill(Vec3::new(0.8, 1.5, 0.9));
        let found = scale(&texels);
        assert_eq!(found, 1.5);
        let bytes = encoded(&texels, found);
        let back = |byte: u8| Response::Srgb.linear_table()[byte as usize] * found;
        assert!((back(bytes[1]) - 1.5).abs() < 1e-3 && (back(bytes[0]) - 0.8).abs() < 0.01);
        texels[..500].fill(Vec3::splat(50.0));
        assert_eq!(scale(&texels), MAX_SCALE);
    }
}
