//! Held-out views of a mesh with albedos at its vertices, under a light that is known or was found.

use crate::synth::emitters::{Emitters, Portal, Sphere};
use crate::synth::environment::{Environment, luminance};
use crate::synth::exchange::{Exchange, Light};
use crate::synth::material::Material;
use crate::synth::parallel;
use crate::synth::render::ray;
use crate::synth::scene::{Part, Scene};
use glam::Vec3;
use recordings::types::{Intrinsics, Mesh, Pose};

/// A mesh with its light transport.
pub struct Rerender {
    scene: Scene,
    exchange: Exchange,
    threads: usize,
}

/// A picture; pixels that the mesh's front does not fill hold nothing.
pub type View = Vec<Option<Vec3>>;

impl Rerender {
    /// Traces `rays` rays a vertex.
    #[must_use]
    pub fn new(mesh: Mesh, rays: usize, threads: usize) -> Self {
        let texture = Box::new(|_| Vec3::ONE);
        let part = Part { name: "mesh", material: Material::MATTE, texture, mesh };
        let scene = Scene::new(vec![part], Environment::uniform(Vec3::ZERO));
        let exchange = Exchange::trace(&scene, rays, 77, threads);
        Self { scene, exchange, threads }
    }

    /// Irradiance / π at the vertices, straight from light in spherical harmonics, from spheres, and from vertices that
    /// emit.
    #[must_use]
    pub fn direct_found(
        &self,
        coefficients: &[[f64; 3]],
        spheres: Vec<Sphere>,
        emission: Option<&[Vec3]>,
    ) -> Vec<Vec3> {
        let order = coefficients.len().isqrt().saturating_sub(1);
        let mut out: Vec<Vec3> = self
            .exchange
            .transfer(order)
            .iter()
            .map(|t| {
                let channel = |c: usize| t.iter().zip(coefficients).map(|(t, l)| t * l[c]).sum::<f64>() as f32;
                Vec3::new(channel(0), channel(1), channel(2))
            })
            .collect();
        let mesh = &self.scene.mesh;
        let triangles = emission.into_iter().flat_map(|e| {
            let mean = |t: &[u32; 3]| t.iter().map(|&i| e[i as usize]).sum::<Vec3>() / 3.0;
            let glowing = mesh.triangles.iter().filter(move |t| mean(t) != Vec3::ZERO);
            glowing.map(move |t| (t.map(|i| mesh.positions[i as usize]), mean(t)))
        });
        let emitters = Emitters::new(spheres, triangles);
        if emitters.count() > 0 {
            let near = self.exchange.direct_near(&self.scene, &emitters, 78);
            out.iter_mut().zip(near).for_each(|(o, n)| *o += n);
        }
        out
    }

    /// Irradiance / π at the vertices, straight from a distant light.
    #[must_use]
    pub fn direct(&self, environment: &Environment, portals: &[Portal]) -> Vec<Vec3> {
        let light = Light { environment, emitters: &Emitters::default(), portals };
        self.exchange.direct(&self.scene, &light, 79)
    }

    /// Irradiance / π with all bounces.
    #[must_use]
    pub fn bounced(&self, direct: &[Vec3], albedo: &[Vec3]) -> Vec<Vec3> {
        self.exchange.solve_with(direct, albedo)
    }

    /// A view of vertex colours, interpolated, four rays a pixel.
    #[must_use]
    pub fn view(&self, colors: &[Vec3], camera: &Intrinsics, world_from_camera: &Pose) -> View {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (origin, turn) = (world_from_camera.translation.as_vec3(), world_from_camera.rotation.as_quat());
        parallel::map(width * height, width, self.threads, |k| {
            let mut sum = Vec3::ZERO;
            for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                let pixel = [(k % width) as f32 + dx, (k / width) as f32 + dy];
                let surface = self.scene.intersect(origin, (turn * ray(camera, pixel)).normalize())?;
                // A scan of one side is a shell, and the inside of a shell is no answer to what its outside looks like.
                if !surface.outside {
                    return None;
                }
                sum += surface.vertices.iter().zip(surface.weights).map(|(&i, w)| colors[i as usize] * w).sum::<Vec3>();
            }
            Some(sum / 4.0)
        })
    }
}

/// PSNR in dB (sRGB, at an exposure gain) of views against truth where both have something, after one factor a channel
/// over all views, fitted where the truth is not clipped.
#[must_use]
pub fn psnr(found: &[View], truth: &[View], gain: f32) -> f64 {
    let pairs: Vec<(Vec3, Vec3)> =
        found.iter().flatten().zip(truth.iter().flatten()).filter_map(|(f, t)| Some(((*f)?, (*t)?))).collect();
    let unclipped: Vec<&(Vec3, Vec3)> = pairs.iter().filter(|(_, t)| (*t * gain).max_element() < 1.0).collect();
    let sum = |of: &dyn Fn(&(Vec3, Vec3)) -> Vec3| unclipped.iter().map(|p| of(p).as_dvec3()).sum::<glam::DVec3>();
    let scale = (sum(&|(f, t)| *f * *t) / sum(&|(f, _)| *f * *f).max(glam::DVec3::splat(1e-20))).as_vec3();
    let squared: f64 = pairs
        .iter()
        .flat_map(|(f, t)| (srgb(*f * scale * gain) - srgb(*t * gain)).to_array())
        .map(|d| f64::from(d) * f64::from(d))
        .sum();
    -10.0 * libm::log10((squared / (3 * pairs.len()).max(1) as f64).max(1e-12))
}

fn srgb(v: Vec3) -> Vec3 {
    let encode = |x: f32| {
        let x = x.clamp(0.0, 1.0);
        if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::powf(x, 1.0 / 2.4) - 0.055 }
    };
    Vec3::from(v.to_array().map(encode))
}

/// The gain that brings the mean luminance of views to 0.2.
#[must_use]
pub fn gain_for(views: &[View]) -> f32 {
    let values: Vec<f32> = views.iter().flatten().flatten().map(|v| luminance(*v)).collect();
    0.2 * values.len() as f32 / values.iter().sum::<f32>().max(1e-9)
}
