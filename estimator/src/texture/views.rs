//! Keyframes as seen from points of the surface.

use crate::association::keyframe_image::{KeyframeImage, distorted};
use crate::association::moving_camera::MovingCamera;
use crate::association::veil::{self, Veil};
use crate::association::{AssociationContext, Lens, RefinedView};
use crate::mesh::raster::Raster;
use crate::texture::registration::{Expected, register};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::types::{CameraModel, Keyframe};

/// Pixels along the border that are not sampled: demosaicing and undistortion reach over them.
const CUT_PX: f64 = 4.0;
/// Half width of the window in pixels where a texel covers many.
const MAX_RADIUS_PX: f64 = 4.0;

/// A keyframe, and the depth of what it sees.
pub struct TextureView {
    image: KeyframeImage,
    lens: CameraModel,
    camera: MovingCamera,
    center: Vec3,
    /// Exposure e_j of the channels.
    exposure: Vec3,
    /// What the lens scatters over the picture.
    veil: Veil,
    /// Share of it that is taken away.
    veil_share: f32,
    /// See [`depth`].
    depth: Vec<f32>,
    focal: f64,
}

/// Where a keyframe shows a point.
#[derive(Debug, Clone, Copy)]
pub struct Visible {
    /// Column of the picture.
    u: f64,
    /// Row of the picture.
    v: f64,
    /// Distance from the picture's border, pixels.
    border: f64,
    /// Width of a pixel at the point, in the mesh's units.
    footprint: f64,
    /// Of the angle between normal and view.
    cosine: f32,
}

/// What a keyframe shows of a point.
#[derive(Debug, Clone, Copy)]
pub struct ViewSample {
    /// Linear RGB after exposure.
    pub color: Vec3,
    /// Larger for views from the front, from near, and far from the picture's border.
    pub weight: f32,
    /// Width of a pixel at the point, in the mesh's units.
    pub footprint: f32,
    /// A pixel is clipped: the colour is a lower bound.
    pub clipped: bool,
}

/// True if a view at this cosine counts.
fn is_faced(context: &AssociationContext, cosine: f32) -> bool {
    f64::from(cosine) > context.config.tuning.texture.min_cosine
}

/// A triangle as a keyframe sees it: its corners in the camera's frame when their rows are read, and the cosines there. Within a
/// triangle both are linear but for what the camera moves between its rows.
pub struct SeenTriangle<'a> {
    view: &'a TextureView,
    corners: [DVec3; 3],
    cosines: [f32; 3],
}

impl SeenTriangle<'_> {
    /// What the keyframe shows of a point with these barycentric weights, and the same of the nearest point in the triangle, under a window
    /// of the width of a texel; `None` if it is hidden, outside the picture, or seen from behind.
    #[must_use]
    pub fn sample(&self, context: &AssociationContext, w: [f32; 3], near: [f32; 3], texel: f32) -> Option<ViewSample> {
        let cosine = (0..3).map(|k| near[k] * self.cosines[k]).sum::<f32>();
        if !is_faced(context, cosine) {
            return None;
        }
        let point = (0..3).map(|k| self.corners[k] * f64::from(w[k])).sum();
        self.view.sample_at(context, &self.view.visible_at(context, point, cosine)?, texel)
    }
}

/// A keyframe, its pose and exposure, and its veil if its picture can be decoded.
pub type PosedKeyframe<'a> = (&'a Keyframe, &'a RefinedView, &'a Option<Veil>);

/// The keyframes whose pictures can be decoded, freed of what the lens does to them.
#[must_use]
pub fn views(context: &AssociationContext, keyframes: &[PosedKeyframe], lens: Lens) -> Vec<TextureView> {
    let view = |&(keyframe, view, veil): &PosedKeyframe| {
        let mut image = KeyframeImage::new(&keyframe.color, &keyframe.camera)?;
        image.vignetting = lens.vignetting;
        let camera = MovingCamera::still(&view.world_from_camera, &image.camera);
        Some(TextureView {
            lens: keyframe.camera,
            center: view.world_from_camera.translation.as_vec3(),
            exposure: Vec3::from_array(view.gain.map(|g| (1.0 / g) as f32)),
            veil: veil.clone()?,
            veil_share: lens.veil_share as f32,
            depth: depth(context, &camera),
            camera,
            focal: image.camera.focal(),
            image,
        })
    };
    keyframes.par_iter().filter_map(view).collect()
}

/// Least depth of the surface at a pixel and the four beside it, `[row][column]`: what is compared is hidden where any of them hides it.
/// Pixels at the border, which are not sampled, have their own.
fn depth(context: &AssociationContext, camera: &MovingCamera) -> Vec<f32> {
    let k = &camera.intrinsics;
    let own = Raster::new(&camera.points(context.mesh), &context.mesh.triangles, k, context.near).depth;
    let (width, height) = (k.width as usize, k.height as usize);
    let mut least = own.clone();
    for y in 1..height.saturating_sub(1) {
        let row = |y: usize| &own[y * width..][..width];
        let (above, here, below) = (row(y - 1), row(y), row(y + 1));
        for (x, least) in least[y * width..][..width].iter_mut().enumerate().take(width - 1).skip(1) {
            *least = here[x].min(here[x - 1]).min(here[x + 1]).min(above[x]).min(below[x]);
        }
    }
    least
}

impl Visible {
    /// Larger for views from the front, from near, and far from the picture's border.
    #[must_use]
    pub fn weight(&self, context: &AssociationContext) -> f32 {
        let inside = (self.border / context.config.tuning.texture.border_px).min(1.0);
        let near = f64::from(context.median_edge) / self.footprint;
        (f64::from(self.cosine) * near * near * inside) as f32
    }
}

impl TextureView {
    /// Moves the camera to where its picture fits these colours of points best, linear RGB, under windows of these half widths in turn;
    /// returns by how many pixels. What it sees is as before until it [`looks`](Self::look).
    pub fn register(&mut self, context: &AssociationContext, colors: &[(Vec3, Vec3)], windows: &[f64]) -> f64 {
        let expected = |&(point, color): &(Vec3, Vec3)| {
            let (u, v) = self.camera.pixel(self.camera.point(point));
            Expected { point, color: color / self.exposure + self.veil_at(u, v) }
        };
        let expected: Vec<Expected> = colors.iter().map(expected).collect();
        let found = register(context, &self.image, self.camera, &expected, windows);
        if found.moved_px > 0.0 {
            self.camera = found.camera;
            self.center = self.camera.camera_from_world.inverse().translation.as_vec3();
        }
        found.moved_px
    }

    /// Renders what the camera sees from where it is now.
    pub fn look(&mut self, context: &AssociationContext) {
        self.depth = depth(context, &self.camera);
    }

    /// What the keyframe shows of a point with this unit normal under its narrowest window; `None` if the point is hidden, outside the
    /// picture, or seen from behind.
    #[must_use]
    pub fn sample(&self, context: &AssociationContext, point: Vec3, normal: Vec3) -> Option<ViewSample> {
        self.sample_at(context, &self.visible(context, point, normal)?, 0.0)
    }

    /// What the keyframe shows there under a window of the width of a texel.
    fn sample_at(&self, context: &AssociationContext, visible: &Visible, texel: f32) -> Option<ViewSample> {
        let &Visible { u, v, footprint, .. } = visible;
        let radius = (f64::from(texel) / footprint).clamp(1.0, MAX_RADIUS_PX);
        let sample = self.image.sample(&context.table, u, v, radius)?;
        let clipped = sample.brightest >= context.clipped;
        // Beyond the lens the undistorted picture is white.
        if clipped && distorted(&self.lens, u.round() as usize, v.round() as usize).is_none() {
            return None;
        }
        let weight = visible.weight(context);
        let color = veil::without(Vec3::from_array(sample.color), self.veil_at(u, v)) * self.exposure;
        Some(ViewSample { color, weight, footprint: footprint as f32, clipped })
    }

    /// What is taken away of the veil at a pixel: in most scenes nothing.
    fn veil_at(&self, u: f64, v: f64) -> Vec3 {
        if self.veil_share > 0.0 { self.veil.at(u, v) * self.veil_share } else { Vec3::ZERO }
    }

    /// How the keyframe sees a triangle with these corners and unit normals.
    #[must_use]
    pub fn triangle(&self, positions: [Vec3; 3], normals: [Vec3; 3]) -> SeenTriangle<'_> {
        let cosines = std::array::from_fn(|k| self.cosine(positions[k], normals[k]));
        SeenTriangle { view: self, corners: positions.map(|p| self.camera.point(p)), cosines }
    }

    /// Where the keyframe shows a point with this unit normal; `None` if the point is hidden, outside the picture, or seen from behind.
    #[must_use]
    pub fn visible(&self, context: &AssociationContext, point: Vec3, normal: Vec3) -> Option<Visible> {
        let cosine = self.cosine(point, normal);
        is_faced(context, cosine).then(|| self.visible_at(context, self.camera.point(point), cosine)).flatten()
    }

    /// Of the angle between a unit normal and the view.
    fn cosine(&self, point: Vec3, normal: Vec3) -> f32 {
        (self.center - point).normalize_or_zero().dot(normal)
    }

    /// The same of a point in the camera's frame when its row is read.
    fn visible_at(&self, context: &AssociationContext, p: DVec3, cosine: f32) -> Option<Visible> {
        let tuning = &context.config.tuning.texture;
        if p.z.is_nan() || p.z <= context.near {
            return None;
        }
        let k = &self.image.camera;
        let (u, v) = self.camera.pixel(p);
        let border = u.min(v).min(f64::from(k.width) - 1.0 - u).min(f64::from(k.height) - 1.0 - v);
        if border.is_nan() || border <= CUT_PX {
            return None;
        }
        let footprint = p.z / self.focal;
        let hidden = tuning.hidden_edges * f64::from(context.median_edge) + tuning.hidden_footprints * footprint;
        let (x, y) = (u.round() as usize, v.round() as usize);
        let depth = f64::from(self.depth[y * k.width as usize + x]);
        (p.z <= depth + hidden).then_some(Visible { u, v, border, footprint, cosine })
    }
}
