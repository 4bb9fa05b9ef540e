//! Registration of the keyframes' pictures to each other: each to the blend of the others, at points spread over the texels.

use crate::association::AssociationContext;
use crate::texture::atlas::{Atlas, EMPTY, weights};
use crate::texture::registration::windows;
use crate::texture::texels::blend;
use crate::texture::views::{TextureView, ViewSample};
use firmware_config::Switch;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Moves the views to where they fit each other best; returns the RMS motion in pixels over all views and rounds.
/// Nothing moves where poses are not to be refined.
pub fn register_views(context: &AssociationContext, views: &mut [TextureView], atlas: &Atlas) -> f64 {
    let tuning = &context.config.tuning.registration;
    let rounds = if context.config.refine_poses == Switch::Off { 0 } else { tuning.rounds };
    let power = context.config.tuning.texture.weight_power as f32;
    let points = points(context, atlas, tuning.points as usize);
    let mut squares = 0.0;
    for round in 0..rounds {
        let seen: Vec<Vec<(usize, ViewSample)>> = points
            .par_iter()
            .map(|&(p, n)| {
                let sample = |(j, v): (usize, &TextureView)| Some((j, v.sample(context, p, n)?));
                views.iter().enumerate().filter_map(sample).collect()
            })
            .collect();
        let moved: Vec<f64> = views
            .par_iter_mut()
            .enumerate()
            .map(|(j, view)| {
                let mut others: Vec<ViewSample> = Vec::new();
                let mut color = |(seen, (point, _)): (&Vec<(usize, ViewSample)>, &(Vec3, Vec3))| {
                    seen.iter().find(|(i, s)| *i == j && !s.clipped)?;
                    others.clear();
                    others.extend(seen.iter().filter(|(i, s)| *i != j && !s.clipped).map(|(_, s)| *s));
                    Some((*point, blend(&mut others, power)?))
                };
                let colors: Vec<(Vec3, Vec3)> = seen.iter().zip(&points).filter_map(&mut color).collect();
                view.register(context, &colors, windows(round))
            })
            .collect();
        squares += moved.iter().map(|m| m * m).sum::<f64>() / moved.len().max(1) as f64;
    }
    if squares > 0.0 {
        views.par_iter_mut().for_each(|view| view.look(context));
    }
    squares.sqrt()
}

/// Points of the surface with their normals, about so many: the same share of the texels of every part, in the order of the triangles,
/// neighbours of which lie in the same parts of the pictures.
fn points(context: &AssociationContext, atlas: &Atlas, count: usize) -> Vec<(Vec3, Vec3)> {
    let mesh = context.mesh;
    let covered = (0..atlas.owner.len()).filter(|at| atlas.owner[*at] != EMPTY);
    let stride = (covered.clone().count() / count.max(1)).max(1);
    let point = |at: usize| {
        let owner = atlas.owner[at] as usize;
        let texel = Vec2::new((at % atlas.width as usize) as f32, (at / atlas.width as usize) as f32);
        let corners = mesh.triangles[owner].map(|i| i as usize);
        let w = weights(&atlas.charts[atlas.chart[owner] as usize], corners.map(|i| mesh.positions[i]), texel);
        // The gutter lies beyond the surface.
        w.iter().all(|w| *w >= 0.0).then(|| {
            let mix = |of: &[Vec3]| corners.iter().zip(w).map(|(&i, w)| of[i] * w).sum::<Vec3>();
            (owner, mix(&mesh.positions), mix(&mesh.normals).normalize_or_zero())
        })
    };
    let mut points: Vec<(usize, Vec3, Vec3)> = covered.step_by(stride).filter_map(point).collect();
    points.sort_by_key(|(owner, _, _)| *owner);
    points.into_iter().map(|(_, point, normal)| (point, normal)).collect()
}
