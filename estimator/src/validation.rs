//! Validation frames (`witnesses` in files): frames that no estimation step used, compared with the model rendered into their
//! view.

use crate::association::keyframe_image::{KeyframeImage, distorted};
use crate::association::moving_camera::MovingCamera;
use crate::association::pose;
use crate::association::sampling::colors_of_image;
use crate::association::veil::Veil;
use crate::association::{AssociationContext, Lens, RefinedView};
use crate::mesh::raster::{MISS, Raster, camera_positions};
use crate::numerics::robust::median;
use crate::specular::{Gloss, Reflection};
use crate::texture::detail::Detail;
use crate::texture::registration::{Expected, register, windows};
use crate::texture::sharpness::OctaveEnergy;
use firmware_config::{EstimatorConfig, Switch};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use recordings::decision::{Decision, TexturePrediction};
use recordings::result::WitnessError;
use recordings::types::{CameraModel, Intrinsics, Keyframe, Mesh, Pose, Response};

/// The model that is rendered.
#[derive(Clone, Copy)]
pub struct Model<'a> {
    /// Mesh, rays and light.
    pub reflection: &'a Reflection<'a>,
    /// Lit colour, linear RGB: `[vertex]`.
    pub lit_color: &'a [Vec3],
    /// Weight of the lit colour, 0 = never seen: `[vertex]`.
    pub lit_weight: &'a [f32],
    /// Albedo × irradiance over π, linear RGB: `[vertex]`.
    pub diffuse: &'a [Vec3],
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
    /// Specular weights: `[segment]`.
    pub gloss: &'a [Gloss],
    /// Lit colour without gloss, linear RGB: `[vertex]`.
    pub matte: &'a [Vec3],
    /// Texture, if there is one.
    pub detail: Option<&'a Detail<'a>>,
    /// What the colours are free of: the frame's own is put over what is predicted.
    pub lens: Lens,
}

/// Prediction of one validation frame, and what limits it.
#[derive(Debug, Clone)]
pub struct Compared {
    /// Errors from the refined pose, if poses are refined, else from the tracked one.
    pub error: WitnessError,
    /// PSNR from the tracked pose, dB: lit colours, model.
    pub tracked_psnr_db: [f64; 2],
    /// PSNR of the frame's own colours, brought onto the mesh and back, dB: a bound that the mesh sets.
    pub own_psnr_db: f64,
    /// RMS distance between the pixels of the two poses.
    pub moved_px: f64,
    /// The lit colours with the texture and without it; `None` without texture.
    pub texture: Option<TexturePrediction>,
}

/// Of the pixels that are compared, every so manieth along each side tells the exposure before the last one.
const SPARSE: usize = 3;

/// One pixel.
struct Pixel {
    /// Observed, 8 bits.
    seen: [u8; 3],
    /// Predicted, linear RGB.
    predicted: [f64; 3],
    /// Veil of the observed, linear RGB.
    veil: [f64; 3],
    /// Share of the light that vignetting leaves.
    shade: f64,
}

/// Compares one validation frame with the model; `None` if its picture cannot be decoded.
#[must_use]
pub fn compare(
    model: &Model,
    context: &AssociationContext,
    frame: &Keyframe,
    config: &EstimatorConfig,
) -> Option<Compared> {
    let mut picture = KeyframeImage::new(&frame.color, &frame.camera)?;
    picture.vignetting = model.lens.vignetting;
    let tracked = frame.world_from_camera;
    let stride = config.tuning.validation.pixel_stride as usize;
    let veil = Veil::of(&picture, &frame.camera, &context.table, context.clipped);
    let image = ValidationImage { picture: &picture, lens: &frame.camera, veil: &veil, stride };
    // Exposures on the way to the pose.
    let sparse = SPARSE * stride;
    let from = |camera: MovingCamera| Rendered::new(context, &image, camera);
    let still = |pose: &Pose| from(MovingCamera::still(pose, &picture.camera));
    let mut rendered = still(&tracked);
    let mut found = rendered.pixels(model, lit);
    let psnr = |pixels: &[Pixel]| psnr(pixels, context);
    let gains = |pixels: &[Pixel]| gains(pixels, context);
    let tracked_psnr_db = [psnr(&found), psnr(&rendered.pixels(model, modelled))];
    let mut view = RefinedView { world_from_camera: tracked, gain: gains(&found), residual_px: 0.0 };
    if config.refine_poses != Switch::Off {
        for round in 0..config.tuning.validation.rounds {
            // Exposures hardly change the pose.
            let levels: &[f64] = if round == 0 { &[0.25, 0.5, 1.0] } else { &[1.0] };
            view.world_from_camera = pose::located(context, &picture, model.lit_color, model.lit_weight, &view, levels);
            rendered = still(&view.world_from_camera);
            view.gain = gains(&rendered.pixels_every(sparse, model, lit));
        }
        for round in 0..config.tuning.registration.rounds {
            let expected = rendered.expected(model, view.gain);
            rendered = from(register(context, &picture, rendered.camera, &expected, windows(round)).camera);
            view.gain = gains(&rendered.pixels_every(sparse, model, lit));
        }
        found = rendered.pixels(model, lit);
        view.gain = gains(&found);
        // Where a picture shows little but an outline, its pose may be told less by it than by tracking.
        if psnr(&found) < tracked_psnr_db[0] {
            rendered = still(&tracked);
            found = rendered.pixels(model, lit);
            view.gain = gains(&found);
        }
        view.world_from_camera = rendered.camera.camera_from_world.inverse();
    }
    let (own_color, own_weight) = colors_of_image(context, &picture, &view.world_from_camera);
    let own = Model {
        lit_color: &own_color,
        lit_weight: &own_weight,
        detail: None,
        lens: Lens { veil_share: 0.0, ..model.lens },
        ..*model
    };
    let lit_psnr_db = psnr(&found);
    let texture = model.detail.map(|_| {
        let vertices = Model { detail: None, ..*model };
        TexturePrediction {
            vertices_psnr_db: psnr(&rendered.pixels(&vertices, lit)),
            psnr_db: lit_psnr_db,
            vertices_sharpness: rendered.sharpness(&vertices, view.gain),
            sharpness: rendered.sharpness(model, view.gain),
        }
    });
    let compared = (picture.camera.width as usize).div_ceil(stride) * (picture.camera.height as usize).div_ceil(stride);
    let error = WitnessError {
        name: frame.name.clone(),
        lit_psnr_db,
        model_psnr_db: psnr(&rendered.pixels(model, modelled)),
        coverage: if compared > 0 { found.len() as f64 / compared as f64 } else { 0.0 },
    };
    Some(Compared {
        error,
        tracked_psnr_db,
        own_psnr_db: psnr(&rendered.pixels(&own, lit)),
        moved_px: shift(context, &picture.camera, &tracked, &view.world_from_camera),
        texture,
    })
}

/// Means over the validation frames; `None` without texture or frames.
#[must_use]
pub fn texture_prediction(compared: &[Compared]) -> Option<TexturePrediction> {
    let found: Vec<TexturePrediction> = compared.iter().filter_map(|c| c.texture).collect();
    let mean = |of: fn(&TexturePrediction) -> f64| found.iter().map(of).sum::<f64>() / found.len() as f64;
    (!found.is_empty()).then(|| TexturePrediction {
        vertices_psnr_db: mean(|p| p.vertices_psnr_db),
        psnr_db: mean(|p| p.psnr_db),
        vertices_sharpness: mean(|p| p.vertices_sharpness),
        sharpness: mean(|p| p.sharpness),
    })
}

/// Means over the validation frames; `None` without frames.
#[must_use]
pub fn decision(compared: &[Compared], config: &EstimatorConfig) -> Option<Decision> {
    let mean = |of: &dyn Fn(&Compared) -> f64| compared.iter().map(of).sum::<f64>() / compared.len() as f64;
    (!compared.is_empty()).then(|| Decision::Witnesses {
        frames: compared.len() as u32,
        refined: config.refine_poses != Switch::Off,
        lit_psnr_db: mean(&|c| c.error.lit_psnr_db),
        model_psnr_db: mean(&|c| c.error.model_psnr_db),
        moved_px: mean(&|c| c.moved_px),
        tracked_lit_psnr_db: mean(&|c| c.tracked_psnr_db[0]),
        tracked_model_psnr_db: mean(&|c| c.tracked_psnr_db[1]),
        own_psnr_db: mean(&|c| c.own_psnr_db),
    })
}

/// The picture of a validation frame, and the grid of pixels that are compared.
struct ValidationImage<'a> {
    picture: &'a KeyframeImage,
    lens: &'a CameraModel,
    veil: &'a Veil,
    /// Every n-th pixel along each side.
    stride: usize,
}

/// The mesh as a camera sees it, beside the picture.
struct Rendered<'a> {
    context: &'a AssociationContext<'a>,
    image: &'a ValidationImage<'a>,
    camera: MovingCamera,
    /// Of the camera, in the world.
    center: DVec3,
    /// Vertices in the camera's frame.
    points: Vec<DVec3>,
    raster: Raster,
}

impl<'a> Rendered<'a> {
    fn new(context: &'a AssociationContext, image: &'a ValidationImage, camera: MovingCamera) -> Self {
        let points = camera.points(context.mesh);
        let raster = Raster::new(&points, &context.mesh.triangles, &image.picture.camera, context.near);
        Self { context, image, camera, center: camera.camera_from_world.inverse().translation, points, raster }
    }

    /// The surface point at a pixel; `None` beside the mesh, and beyond the lens, where there is no picture.
    fn at(&self, x: usize, y: usize) -> Option<SurfacePoint> {
        let triangle = self.raster.triangle[y * self.raster.camera.width as usize + x];
        if triangle == MISS || distorted(self.image.lens, x, y).is_none() {
            return None;
        }
        let corners = self.context.mesh.triangles[triangle as usize].map(|i| self.points[i as usize]);
        Some(SurfacePoint { triangle, weights: self.raster.weights(x, y, corners), seen_from: self.center })
    }

    /// Observed colours of the pixels that are compared, and `predicted` ones.
    fn pixels(&self, model: &Model, predicted: fn(&Model, &SurfacePoint) -> Option<[f64; 3]>) -> Vec<Pixel> {
        self.pixels_every(self.image.stride, model, predicted)
    }

    /// The same of every `stride`-th pixel along each side.
    fn pixels_every(
        &self,
        stride: usize,
        model: &Model,
        predicted: fn(&Model, &SurfacePoint) -> Option<[f64; 3]>,
    ) -> Vec<Pixel> {
        let &ValidationImage { picture, veil, .. } = self.image;
        let (width, height) = (picture.camera.width as usize, picture.camera.height as usize);
        let rows: Vec<usize> = (0..height).step_by(stride).collect();
        let pixel = |(x, y): (usize, usize)| {
            let predicted = predicted(model, &self.at(x, y)?)?;
            let seen = picture.bytes(x, y);
            let veil = veil.at(x as f64, y as f64).to_array().map(|v| model.lens.veil_share * f64::from(v));
            let shade = f64::from(picture.vignetting.shade(&picture.camera, x as f64, y as f64));
            Some(Pixel { seen, predicted, veil, shade })
        };
        rows.par_iter().flat_map_iter(|&y| (0..width).step_by(stride).map(move |x| (x, y))).filter_map(pixel).collect()
    }

    /// The lit colours that the picture should have at the surface points that it shows.
    fn expected(&self, model: &Model, gain: [f64; 3]) -> Vec<Expected> {
        let (context, image) = (self.context, self.image);
        let (width, height) = (image.picture.camera.width as usize, image.picture.camera.height as usize);
        let points = f64::from(context.config.tuning.registration.points);
        let step = (((width * height) as f64 / points).sqrt().ceil() as usize).max(1);
        let gain = DVec3::from_array(gain).as_vec3();
        let at = |(x, y): (usize, usize)| {
            let at = self.at(x, y)?;
            let lit = lit(model, &at)?;
            let corners = context.mesh.triangles[at.triangle as usize];
            let point = corners.iter().zip(at.weights).map(|(&i, w)| context.mesh.positions[i as usize] * w).sum();
            let veil = image.veil.at(x as f64, y as f64) * model.lens.veil_share as f32;
            Some(Expected { point, color: (DVec3::from_array(lit).as_vec3() * gain + veil).max(Vec3::ZERO) })
        };
        (0..height).step_by(step).flat_map(|y| (0..width).step_by(step).map(move |x| (x, y))).filter_map(at).collect()
    }

    /// Energy of the upper octave of the lit colours, rendered, over that of the picture, in blocks on one smooth surface.
    fn sharpness(&self, model: &Model, gain: [f64; 3]) -> f64 {
        let (context, image) = (self.context, self.image);
        let (width, height) = (image.picture.camera.width as usize, image.picture.camera.height as usize);
        let block = |x: usize, y: usize| {
            let (mut observed, mut rendered) = ([0.0; 4], [0.0; 4]);
            let mut depths = (f32::INFINITY, 0.0f32);
            for (i, (x, y)) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].into_iter().enumerate() {
                let at = self.at(x, y)?;
                let depth = self.raster.depth[y * width + x];
                depths = (depths.0.min(depth), depths.1.max(depth));
                let bytes = image.picture.bytes(x, y);
                if bytes.iter().any(|&b| b >= context.clipped) {
                    return None;
                }
                let lit = lit(model, &at)?;
                // Photon noise and contrast are alike at all levels in square roots of light.
                observed[i] = f64::sqrt(bytes.iter().map(|&b| f64::from(context.table[b as usize])).sum());
                let veil = image.veil.at(x as f64, y as f64) * model.lens.veil_share as f32;
                let shade = f64::from(image.picture.vignetting.shade(&image.picture.camera, x as f64, y as f64));
                rendered[i] =
                    f64::sqrt((0..3).map(|c| (shade * (gain[c] * lit[c] + f64::from(veil[c]))).max(0.0)).sum());
            }
            (depths.1 - depths.0 < context.median_edge).then(|| OctaveEnergy::of(observed, rendered))
        };
        let rows: Vec<usize> = (0..height.saturating_sub(1)).step_by(image.stride).collect();
        let of_row = |&y: &usize| {
            let blocks = (0..width.saturating_sub(1)).step_by(image.stride).filter_map(|x| block(x, y));
            blocks.fold(OctaveEnergy::default(), OctaveEnergy::and)
        };
        let sums: Vec<OctaveEnergy> = rows.par_iter().map(of_row).collect();
        sums.into_iter().fold(OctaveEnergy::default(), OctaveEnergy::and).kept()
    }
}

/// RMS distance, in pixels, between the projections of the vertices that both poses see.
fn shift(context: &AssociationContext, k: &Intrinsics, one: &Pose, other: &Pose) -> f64 {
    let project = |p: DVec3| {
        let (u, v) = k.project(p);
        let inside = p.z > context.near && u >= 0.0 && v >= 0.0 && u < f64::from(k.width) && v < f64::from(k.height);
        inside.then(|| DVec2::new(u, v))
    };
    let pairs = camera_positions(context.mesh, one).into_iter().zip(camera_positions(context.mesh, other));
    let (sum, count) = pairs
        .filter_map(|(a, b)| Some(project(a)?.distance_squared(project(b)?)))
        .fold((0.0, 0.0), |(s, n), d| (s + d, n + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }
}

/// A point of the mesh.
struct SurfacePoint {
    triangle: u32,
    /// Barycentric weights.
    weights: [f32; 3],
    /// Position of the camera.
    seen_from: DVec3,
}

impl SurfacePoint {
    /// The corners' values mixed.
    fn mix(&self, mesh: &Mesh, values: &[Vec3]) -> Vec3 {
        mesh.triangles[self.triangle as usize].iter().zip(self.weights).map(|(&i, w)| values[i as usize] * w).sum()
    }
}

/// True if a corner was never seen.
fn is_unseen(model: &Model, at: &SurfacePoint) -> bool {
    model.reflection.mesh.triangles[at.triangle as usize].iter().any(|&i| model.lit_weight[i as usize] <= 0.0)
}

/// Lit colour of a surface point, linear RGB; `None` where a corner was never seen.
fn lit(model: &Model, at: &SurfacePoint) -> Option<[f64; 3]> {
    if is_unseen(model, at) {
        return None;
    }
    let lit = at.mix(model.reflection.mesh, model.lit_color);
    let lit = match model.detail {
        Some(detail) => {
            let matte = at.mix(model.reflection.mesh, model.matte);
            lit - matte + detail.ratio(at.triangle, at.weights) * matte
        }
        None => lit,
    };
    Some(lit.to_array().map(f64::from))
}

/// Model colour of a surface point, linear RGB; `None` where a corner was never seen.
fn modelled(model: &Model, at: &SurfacePoint) -> Option<[f64; 3]> {
    if is_unseen(model, at) {
        return None;
    }
    let mesh = model.reflection.mesh;
    let diffuse = at.mix(mesh, model.diffuse);
    let diffuse = model.detail.map_or(diffuse, |detail| detail.ratio(at.triangle, at.weights) * diffuse);
    let mut modelled = diffuse.to_array().map(f64::from);
    let corners = mesh.triangles[at.triangle as usize];
    let (w_d, w_s) = corners.iter().zip(at.weights).fold((0.0, 0.0), |(d, s), (&i, w)| {
        let gloss = model.gloss[model.segment[i as usize] as usize];
        let (w_d, w_s) = if gloss.significant { (gloss.w_d, gloss.w_s) } else { (1.0, 0.0) };
        (d + w_d * f64::from(w), s + w_s * f64::from(w))
    });
    if w_s > 0.0 {
        let position = at.mix(mesh, &mesh.positions);
        let normal = at.mix(mesh, &mesh.normals).normalize_or_zero();
        let to_camera = (at.seen_from - position.as_dvec3()).normalize_or(DVec3::Z).as_vec3();
        let mirror = model.reflection.at(position, normal, to_camera).unwrap_or([0.0; 3]);
        for c in 0..3 {
            modelled[c] = w_d * modelled[c] + w_s * mirror[c]; // Eq. (13)
        }
    }
    Some(modelled)
}

/// Median exposure gain per channel over the pixels that are neither dark nor clipped.
fn gains(pixels: &[Pixel], context: &AssociationContext) -> [f64; 3] {
    [0, 1, 2].map(|c| {
        let seen = |p: &Pixel| f64::from(context.table[p.seen[c] as usize]);
        let ratios = pixels
            .iter()
            .filter(|p| p.predicted[c] > 1e-6 && seen(p) > 0.004 && p.seen[c] < context.clipped)
            .map(|p| (seen(p) / p.shade - p.veil[c]) / p.predicted[c]);
        median(ratios).unwrap_or(1.0)
    })
}

/// PSNR in 8-bit values after one fitted exposure gain per channel: those of the picture where they are sRGB's, with or without a shoulder, else
/// of sRGB.
fn psnr(pixels: &[Pixel], context: &AssociationContext) -> f64 {
    if pixels.is_empty() {
        return 0.0;
    }
    let gain = gains(pixels, context);
    let shown = if let Response::Shoulder(_) = context.response { context.response } else { Response::Srgb };
    let value = |x: f64| shown.value_from_linear(x.clamp(0.0, shown.full_scale()));
    let seen = context.table.map(|x| value(f64::from(x)));
    let off = |p: &Pixel, c: usize| value((gain[c] * p.predicted[c] + p.veil[c]) * p.shade) - seen[p.seen[c] as usize];
    let square: f64 = pixels.iter().flat_map(|p| [0, 1, 2].map(|c| off(p, c).powi(2))).sum();
    let mean = square / (3 * pixels.len()) as f64;
    // 8 bits cannot show less than the variance of their rounding.
    -10.0 * libm::log10(mean.max(1.0 / (12.0 * 255.0 * 255.0)))
}
