//! What fills the texels: radiance that keyframes show, less gloss, over the light at the vertices.

use crate::association::AssociationContext;
use crate::texture::atlas::{Atlas, EMPTY, weights};
use crate::texture::texels::blend;
use crate::texture::views::{SeenTriangle, TextureView, ViewSample};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Largest factor between the albedo of a texel and of the vertices around it.
const MAX_RATIO: f32 = 8.0;
/// Smallest share of a texel's radiance that is left when gloss is taken off.
const MIN_MATTE: f32 = 0.05;
/// A keyframe with less than this share of the weight of the best one that shows all of a triangle is asked for its texels only where the
/// others are clipped or show nothing.
const HARDLY: f32 = 0.35;
/// Texels along each side of a tile.
const TILE: usize = 32;

/// What the vertices know: `[vertex]`.
#[derive(Clone, Copy)]
pub struct VertexColors<'a> {
    /// Lit colour with gloss.
    pub with_gloss: &'a [Vec3],
    /// Lit colour without gloss.
    pub matte: &'a [Vec3],
    /// Weight of the lit colour, 0 = never seen.
    pub weight: &'a [f32],
    /// Albedo.
    pub albedo: &'a [Vec3],
}

/// What texels are filled from.
pub struct Filling<'a> {
    context: &'a AssociationContext<'a>,
    views: &'a [TextureView],
    atlas: &'a Atlas,
    colors: VertexColors<'a>,
    /// Weights of the keyframes at the vertices, 0 where they do not show them: `[keyframe][vertex]`.
    weights: Vec<Vec<f32>>,
    /// Weight up to which a keyframe hardly counts: `[triangle]`.
    hardly: Vec<f32>,
}

/// A triangle, and the keyframes that show it.
struct Part<'a> {
    corners: [usize; 3],
    /// Weight up to which a keyframe hardly counts.
    hardly: f32,
    /// Those that count.
    first: Vec<SeenTriangle<'a>>,
    /// Those that hardly do, once they are asked.
    others: Option<Vec<SeenTriangle<'a>>>,
}

impl<'a> Filling<'a> {
    /// Looks up how much the views count where.
    #[must_use]
    pub fn new(
        context: &'a AssociationContext,
        views: &'a [TextureView],
        atlas: &'a Atlas,
        colors: VertexColors<'a>,
    ) -> Self {
        let weights = weights_of_views(context, views);
        let hardly = hardly(context.mesh, &weights);
        Self { context, views, atlas, colors, weights, hardly }
    }

    /// Albedo of the texels, `[row][column]`, black where there is no surface, and which of them a keyframe shows.
    #[must_use]
    pub fn texels(&self) -> (Vec<Vec3>, Vec<bool>) {
        let Self { atlas, .. } = self;
        let band = TILE * atlas.width as usize;
        let mut texels = vec![Vec3::ZERO; atlas.owner.len()];
        let mut seen = vec![false; atlas.owner.len()];
        let bands = texels.par_chunks_mut(band).zip(seen.par_chunks_mut(band)).zip(atlas.owner.par_chunks(band));
        bands.enumerate().for_each(|(number, ((texels, seen), owners))| {
            let (width, top) = (atlas.width as usize, number * TILE);
            let mut samples: Vec<ViewSample> = Vec::new();
            for left in (0..width).step_by(TILE) {
                for of_triangle in by_owner(owners, width, left).chunk_by(|a, b| a.0 == b.0) {
                    let owner = of_triangle[0].0 as usize;
                    let (chart, mut part) = (&atlas.charts[atlas.chart[owner] as usize], self.part(owner));
                    let positions = part.corners.map(|i| self.context.mesh.positions[i]);
                    for at in of_triangle.iter().map(|(_, at)| *at as usize) {
                        let w = weights(chart, positions, Vec2::new((at % width) as f32, (top + at / width) as f32));
                        (texels[at], seen[at]) = self.texel(&mut part, w, &mut samples);
                    }
                }
            }
        });
        (texels, seen)
    }

    fn part(&self, triangle: usize) -> Part<'a> {
        let corners = self.context.mesh.triangles[triangle].map(|i| i as usize);
        let hardly = self.hardly[triangle];
        Part { corners, hardly, first: self.asked(corners, |weight| weight > hardly), others: None }
    }

    /// The keyframes whose largest weight at the corners of a triangle counts.
    fn asked(&self, corners: [usize; 3], counts: impl Fn(f32) -> bool) -> Vec<SeenTriangle<'a>> {
        let mesh = self.context.mesh;
        let (positions, normals) = (corners.map(|i| mesh.positions[i]), corners.map(|i| mesh.normals[i]));
        let weight = |of_view: &Vec<f32>| corners.iter().map(|&i| of_view[i]).fold(0.0, f32::max);
        let asked = self.views.iter().zip(&self.weights).filter(|(_, of_view)| counts(weight(of_view)));
        asked.map(|(view, _)| view.triangle(positions, normals)).collect()
    }

    /// Albedo of the texel with these barycentric weights, and true if a keyframe shows it.
    fn texel(&self, part: &mut Part<'a>, w: [f32; 3], samples: &mut Vec<ViewSample>) -> (Vec3, bool) {
        let Self { context, atlas, colors, .. } = self;
        let near = normalised(w);
        samples.clear();
        let mut sample = |views: &[SeenTriangle]| {
            samples.extend(views.iter().filter_map(|view| view.sample(context, w, near, atlas.texel)));
            samples.iter().all(|s| s.clipped)
        };
        if sample(&part.first) {
            let (corners, hardly) = (part.corners, part.hardly);
            let asked = || self.asked(corners, |weight| weight > 0.0 && weight <= hardly);
            sample(part.others.get_or_insert_with(asked));
        }
        let mix = |of: &[Vec3]| part.corners.iter().zip(near).map(|(&i, w)| of[i] * w).sum::<Vec3>();
        let albedo = mix(colors.albedo);
        let power = context.config.tuning.texture.weight_power as f32;
        let Some(radiance) = blend(samples, power) else { return (albedo, false) };
        if part.corners.iter().any(|&i| colors.weight[i] <= 0.0) {
            return (albedo, true);
        }
        let matte = mix(colors.matte);
        let gloss = mix(colors.with_gloss) - matte;
        (albedo * ratio((radiance - gloss).max(radiance * MIN_MATTE), matte), true)
    }
}

/// Texels of a tile, from the column `left` on, that show surface, by the triangle that they are on: (triangle, index into `owners`).
/// `owners` are rows of this width. The texels of a tile lie in the same parts of the pictures and z-buffers.
fn by_owner(owners: &[u32], width: usize, left: usize) -> Vec<(u32, u32)> {
    let tile = (left..owners.len()).step_by(width).flat_map(|row| row..row + TILE.min(width - left));
    let mut texels: Vec<(u32, u32)> = tile.map(|at| (owners[at], at as u32)).filter(|t| t.0 != EMPTY).collect();
    texels.sort_unstable();
    texels
}

/// Weights of the keyframes at the vertices, 0 where they do not show them: `[keyframe][vertex]`. A keyframe that shows no corner of a
/// triangle is not asked for its texels.
fn weights_of_views(context: &AssociationContext, views: &[TextureView]) -> Vec<Vec<f32>> {
    let vertices = || context.mesh.positions.par_iter().zip(&context.mesh.normals);
    let of_view = |view: &TextureView| {
        vertices().map(|(p, n)| view.visible(context, *p, *n).map_or(0.0, |v| v.weight(context))).collect()
    };
    views.iter().map(of_view).collect()
}

/// Weight up to which a keyframe hardly counts: `[triangle]`.
fn hardly(mesh: &Mesh, weights_of_views: &[Vec<f32>]) -> Vec<f32> {
    let best = |corners: &[u32; 3]| {
        let of_view = |weights: &Vec<f32>| corners.iter().map(|&i| weights[i as usize]).fold(f32::MAX, f32::min);
        weights_of_views.iter().map(of_view).fold(0.0, f32::max)
    };
    mesh.triangles.par_iter().map(|t| HARDLY * best(t)).collect()
}

/// Weights of the nearest point of the triangle, roughly.
fn normalised(w: [f32; 3]) -> [f32; 3] {
    let w = w.map(|x| x.max(0.0));
    let sum = w[0] + w[1] + w[2];
    w.map(|x| x / sum)
}

/// A colour over another one, bounded; 1 where the other is black.
fn ratio(color: Vec3, over: Vec3) -> Vec3 {
    let one = |c: f32, o: f32| if o > 0.0 { (c / o).clamp(0.0, MAX_RATIO) } else { 1.0 };
    Vec3::new(one(color.x, over.x), one(color.y, over.y), one(color.z, over.z))
}
