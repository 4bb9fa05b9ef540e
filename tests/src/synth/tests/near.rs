use super::SMALL;
use crate::synth::emitters::{Emitters, Portal, Sphere};
use crate::synth::environment::Environment;
use crate::synth::exchange::{Exchange, Light, Lit};
use crate::synth::glare::Glare;
use crate::synth::path::look_at;
use crate::synth::render::{self, Exposure, Image, Shading};
use crate::synth::scene::Scene;
use crate::synth::scenes::{append, corner, matte, rectangle};
use glam::{DVec3, Vec3};
use recordings::types::Mesh;

fn plane() -> Scene {
    let mesh = rectangle(Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y, 0.25);
    Scene::new(vec![matte("plane", mesh, |_| Vec3::splat(0.5))], Environment::uniform(Vec3::ZERO))
}

#[test]
fn a_sphere_lights_a_plane_as_the_formula_says() {
    let sphere = Sphere { center: Vec3::new(0.1, 0.0, 0.5), radius_m: 0.1, radiance: Vec3::new(1.0, 2.0, 3.0) };
    let scene = plane().with_emitters(vec![sphere], &[]);
    let exchange = Exchange::trace(&scene, 256, 1, 2);
    let found = exchange.direct_near(&scene, &scene.emitters, 2);
    for (p, found) in exchange.origins().iter().zip(&found) {
        let to = sphere.center - *p;
        // E/π = L r² cos θ / d² for a sphere that is wholly above the plane.
        let expected = sphere.radiance * (0.01 * to.z / to.length() / to.length_squared());
        assert!((*found / expected - 1.0).abs().max_element() < 0.02, "{found} instead of {expected} at {p}");
    }
}

#[test]
fn exchanged_light_renders_what_path_tracing_renders() {
    let sphere = Sphere { center: Vec3::new(0.5, 0.5, 0.6), radius_m: 0.06, radiance: Vec3::splat(30.0) };
    let environment = Environment::new(64, |d| Vec3::new(1.0 + d.x, 1.0, 1.0 + 0.5 * d.z));
    let scene = corner(0.8, environment).with_emitters(vec![sphere], &[]);
    let light = Light { environment: &scene.environment, emitters: &scene.emitters, portals: &[] };
    let exchange = Exchange::trace(&scene, 196, 1, 2);
    let arriving = exchange.solve(&exchange.direct(&scene, &light, 2));
    let lit = Lit { light, arriving: &arriving, emission: true };
    let pose = look_at(DVec3::new(1.5, 1.2, 1.0), DVec3::splat(0.3), 0.0);
    let mean = |shading, samples| {
        let data = render::color(&scene, shading, &SMALL, &Exposure::still(pose, samples, 2)).data;
        data.iter().map(|v| v.min(Vec3::splat(5.0))).sum::<Vec3>() / data.len() as f32
    };
    let (fast, slow) = (mean(Shading::Lit(&lit), 4), mean(Shading::Traced, 160));
    assert!((fast / slow - 1.0).abs().max_element() < 0.02, "{fast} instead of {slow}");
}

/// A closed cube with a hole in its ceiling.
fn cellar() -> (Scene, Portal) {
    let mut mesh = Mesh::default();
    let (o, s) = (Vec3::ZERO, 0.05);
    for (corner, u, v) in [
        (o, Vec3::X, Vec3::Y),
        (o, Vec3::Z, Vec3::X),
        (o, Vec3::Y, Vec3::Z),
        (Vec3::X, Vec3::Z, Vec3::Y),
        (Vec3::Y, Vec3::X, Vec3::Z),
        (Vec3::new(0.0, 0.0, 1.0), Vec3::Y, Vec3::X * 0.6),
    ] {
        append(&mut mesh, rectangle(corner, u, v, s));
    }
    let portal = Portal { corner: Vec3::new(0.6, 0.0, 1.0), edges: [Vec3::X * 0.4, Vec3::Y] };
    let environment = Environment::new(32, |d| Vec3::splat(1.0 + 0.5 * d.x));
    (Scene::new(vec![matte("cellar", mesh, |_| Vec3::splat(0.6))], environment), portal)
}

#[test]
fn an_opening_lets_in_what_falls_through_it() {
    let (scene, portal) = cellar();
    let exchange = Exchange::trace(&scene, 256, 1, 2);
    let by = |portals: &[Portal]| {
        let light = Light { environment: &scene.environment, emitters: &Emitters::default(), portals };
        exchange.direct(&scene, &light, 3)
    };
    let (with, without) = (by(&[portal]), by(&[]));
    let sum = |light: &[Vec3]| light.iter().map(|l| l.x).sum::<f32>();
    assert!((sum(&with) / sum(&without) - 1.0).abs() < 0.01, "{} instead of {}", sum(&with), sum(&without));
    // Seams between the walls let nothing through: far below the hole's rim no vertex is brighter than the floor.
    let floor = with.iter().zip(&scene.mesh.positions).filter(|(_, p)| p.z < 1e-6).map(|(l, _)| l.x);
    let brightest = floor.clone().fold(0.0, f32::max);
    let middle = floor.clone().sum::<f32>() / floor.count() as f32;
    assert!(brightest < 2.0 * middle, "{brightest} of {middle}");
}

#[test]
fn glare_keeps_the_light_and_spreads_it() {
    let scene = plane();
    let mut picture = Image {
        width: SMALL.width,
        height: SMALL.height,
        data: vec![Vec3::ONE; (SMALL.width * SMALL.height) as usize],
    };
    let mut white = plane();
    white.environment = Environment::uniform(Vec3::ONE);
    let glare = Glare { share: 0.1, core_rad: 0.06 };
    let up = look_at(DVec3::Z, DVec3::new(0.0, 0.01, 2.0), 0.0);
    glare.add(&mut picture, &white, Shading::Flat, &SMALL, &up, 1);
    // Even surroundings leave an even picture, but for where the surroundings that are looked at end.
    let middle = picture.data[picture.data.len() / 2 + SMALL.width as usize / 2];
    assert!((middle.x - 1.0).abs() < 0.01, "{middle}");
    let mut dark = Image { data: vec![Vec3::ZERO; picture.data.len()], ..picture };
    glare.add(&mut dark, &scene, Shading::Flat, &SMALL, &up, 1);
    assert!(dark.data.iter().all(|v| *v == Vec3::ZERO));
}
