use super::SMALL;
use crate::synth::bvh::Bvh;
use crate::synth::environment::{Environment, luminance};
use crate::synth::material::{Material, cosine_direction};
use crate::synth::path::look_at;
use crate::synth::random::{Rng, Stratified};
use crate::synth::render::{self, Exposure, Shading};
use crate::synth::scene::{Part, Scene};
use crate::synth::scenes::{corner, rectangle};
use crate::synth::{cache, solid, tabletop, trace};
use glam::{DVec3, Vec2, Vec3};
use recordings::types::Mesh;
use std::f32::consts::PI;

fn ball(radius: f32, cell: f32) -> Mesh {
    solid::mesh(&|p| solid::sphere(p, radius), Vec3::splat(-1.2 * radius), Vec3::splat(1.2 * radius), cell)
}

fn white(mesh: Mesh, material: Material, environment: Environment) -> Scene {
    let texture = Box::new(|_| Vec3::ONE);
    Scene::new(vec![Part { name: "white", material, texture, mesh }], environment)
}

#[test]
fn a_white_bowl_in_a_white_furnace_is_invisible() {
    let line = [(0.0, 0.0), (0.05, 0.005), (0.09, 0.04), (0.10, 0.08)].map(Vec2::from);
    let profile = solid::smooth_profile(&line, 6);
    let low = Vec3::new(-0.12, -0.12, -0.02);
    let bowl = solid::mesh(&|p| solid::turned_shell(p, &profile, 0.01), low, Vec3::new(0.12, 0.12, 0.1), 0.003);
    let scene = white(bowl, Material::MATTE, Environment::uniform(Vec3::ONE));
    for target in [Vec3::new(0.01, 0.0, 0.0), Vec3::new(0.07, 0.03, 0.03), Vec3::new(-0.1, 0.0, 0.06)] {
        let origin = Vec3::new(0.05, -0.1, 0.5);
        let mut rng = Rng::new(3, 0);
        let n = 6000;
        let sum: Vec3 = (0..n).map(|_| trace::radiance(&scene, origin, (target - origin).normalize(), &mut rng)).sum();
        let mean = sum.x / n as f32;
        assert!((mean - 1.0).abs() < 0.015, "radiance {mean} at {target}");
    }
}

#[test]
fn the_glossy_lobe_never_reflects_more_than_arrives_and_its_sampling_agrees_with_its_density() {
    let mut rng = Rng::new(1, 1);
    for alpha in [0.1, 0.25, 0.6] {
        let material = Material::glossy(1.0, alpha);
        for cosine in [1.0f32, 0.7, 0.3, 0.1] {
            let outgoing = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            let n = 40_000;
            let mut points = Stratified::new(&mut rng);
            let by_lobe: f32 = (0..n)
                .map(|_| {
                    let (direction, weight) = material.sample_lobe(Vec3::Z, outgoing, points.point());
                    assert!((0.0..=1.0 + 1e-5).contains(&weight) && direction.is_normalized());
                    weight
                })
                .sum::<f32>()
                / n as f32;
            assert!(by_lobe <= 1.0 + 1e-4, "α {alpha} cos {cosine}: reflects {by_lobe}");
            assert!(alpha > 0.1 || cosine < 0.7 || by_lobe > 0.98, "α {alpha} cos {cosine}: only {by_lobe}");
            let by_sampling: f32 = (0..n)
                .map(|_| {
                    let direction = material.sample(Vec3::Z, outgoing, points.point(), rng.uniform());
                    let (reflected, density) = material.evaluate(Vec3::ZERO, Vec3::Z, outgoing, direction);
                    if density > 0.0 { reflected.x / density } else { 0.0 }
                })
                .sum::<f32>()
                / n as f32;
            assert!((by_sampling - by_lobe).abs() < 0.02, "α {alpha} cos {cosine}: {by_sampling} against {by_lobe}");
        }
    }
}

#[test]
fn irradiance_of_a_plane_is_the_analytic_one() {
    let environment = || Environment::new(128, |d| Vec3::new(1.0 + d.x, d.z.max(0.0), 1.0));
    let far_away = rectangle(Vec3::splat(1e3), Vec3::X, Vec3::Y, 1.0);
    let scene = white(far_away, Material::MATTE, environment());
    let light = vec![Vec3::ZERO; scene.mesh.positions.len()];
    let normals = [Vec3::Z, Vec3::new(0.6, 0.0, 0.8)];
    let found = cache::gathered_light(&scene, &light, &[Vec3::ZERO; 2], &normals, 4096, 5, 1);
    // E/π of 1 + x is 1 + 2/3 n_x; that of max(z, 0) on a horizontal plane 2/3.
    assert!((found[0] - Vec3::new(1.0, 2.0 / 3.0, 1.0)).abs().max_element() < 0.004, "{:?}", found[0]);
    assert!((found[1].x - 1.4).abs() < 0.004, "{:?}", found[1]);
}

#[test]
fn the_environment_is_sampled_by_its_density() {
    let environment = tabletop::living_room();
    let mut rng = Rng::new(8, 8);
    let n = 100_000;
    let (mut flux, mut share) = (0.0, 0.0);
    for _ in 0..n {
        let (direction, density) = environment.sample([rng.uniform(), rng.uniform()]);
        assert!((environment.density(direction) / density - 1.0).abs() < 1e-3 || density < 1e-4);
        flux += luminance(environment.radiance(direction)) / density;
        share += 1.0 / density;
    }
    assert!((flux / n as f32 / (4.0 * PI) - 1.0).abs() < 0.01, "mean luminance {}", flux / n as f32 / (4.0 * PI));
    assert!((share / n as f32 / (4.0 * PI) - 1.0).abs() < 0.05, "solid angle {}", share / n as f32);
}

#[test]
fn spherical_harmonics_follow_the_convention() {
    let environment = Environment::new(128, |d| Vec3::new(1.0, 1.0 + 0.5 * d.x, 1.0 + d.x * d.y + 0.3 * d.z));
    let c = environment.spherical_harmonics(8);
    assert_eq!(c.len(), 81);
    let four_pi = f64::from(4.0 * PI);
    let mut expected = [[0.0f64; 3]; 81];
    expected[0] = [four_pi * 0.282_094_79; 3];
    expected[3][1] = 0.5 * four_pi / 3.0 * 0.488_602_51;
    expected[2][2] = 0.3 * four_pi / 3.0 * 0.488_602_51;
    expected[4][2] = four_pi / 15.0 * 1.092_548_43;
    for (k, (found, expected)) in c.iter().zip(expected).enumerate() {
        for channel in 0..3 {
            assert!((found[channel] - expected[channel]).abs() < 2e-3, "Y{k}: {found:?} is not {expected:?}");
        }
    }
}

#[test]
fn the_hierarchy_finds_what_a_plain_loop_finds() {
    let mut rng = Rng::new(2, 2);
    let mut mesh = Mesh::default();
    for _ in 0..400 {
        let centre = Vec3::new(rng.uniform(), rng.uniform(), rng.uniform());
        let first = mesh.positions.len() as u32;
        for _ in 0..3 {
            mesh.positions.push(centre + 0.2 * Vec3::new(rng.uniform(), rng.uniform(), rng.uniform()));
        }
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    let whole = Bvh::new(&mesh);
    let single: Vec<Bvh> = mesh
        .triangles
        .iter()
        .map(|t| Bvh::new(&Mesh { positions: mesh.positions.clone(), normals: vec![], triangles: vec![*t] }))
        .collect();
    let mut hits = 0;
    for _ in 0..300 {
        let origin = Vec3::new(rng.uniform(), rng.uniform(), -1.0);
        let direction = Vec3::new(rng.normal() * 0.3, rng.normal() * 0.3, 1.0).normalize();
        let nearest = single.iter().filter_map(|b| b.closest(origin, direction, 9.0)).map(|h| h.distance);
        let nearest = nearest.fold(f32::INFINITY, f32::min);
        let found = whole.closest(origin, direction, 9.0).map_or(f32::INFINITY, |h| h.distance);
        assert_eq!(found, nearest);
        assert_eq!(whole.occluded(origin, direction, 9.0), nearest.is_finite());
        hits += usize::from(nearest.is_finite());
    }
    assert!(hits > 50, "only {hits} rays hit anything");
    assert_eq!(Bvh::new(&Mesh::default()).closest(Vec3::ZERO, Vec3::X, 1.0), None);
}

#[test]
fn surface_nets_close_and_lie_on_the_solid() {
    let mesh = ball(0.05, 0.004);
    assert!(mesh.positions.iter().all(|p| (p.length() - 0.05).abs() < 1e-5));
    assert!(mesh.positions.iter().zip(&mesh.normals).all(|(p, n)| n.dot(p.normalize()) > 0.9999));
    let volume: f32 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    let expected = 4.0 / 3.0 * PI * 0.05f32.powi(3);
    assert!((volume / expected - 1.0).abs() < 0.01, "volume {volume} of {expected}: outside and inside mixed up?");
    let edges: std::collections::BTreeSet<_> =
        mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
    assert_eq!(edges.len(), 3 * mesh.triangles.len());
    assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))));
}

#[test]
fn looked_up_light_renders_what_path_tracing_renders() {
    let scene = corner(0.7, tabletop::living_room());
    let light = cache::diffuse_light(&scene, 256, 1, 2);
    let pose = look_at(DVec3::new(1.3, 1.1, 0.9), DVec3::splat(0.25), 0.0);
    let taken = |shading, samples| render::color(&scene, shading, &SMALL, &Exposure::still(pose, samples, 2)).data;
    let (fast, slow) = (taken(Shading::Cached(&light), 4), taken(Shading::Traced, 160));
    let mean = |data: &[Vec3]| data.iter().sum::<Vec3>() / data.len() as f32;
    let bias = (mean(&fast) / mean(&slow) - 1.0).abs().max_element();
    // Light bends sharply in the seams; between vertices it is drawn straight.
    assert!(bias < 0.02, "means differ by {bias}");
    let pairs = fast.iter().zip(&slow);
    let rms =
        (pairs.map(|(a, b)| ((*a - *b) / b.max(Vec3::splat(0.1))).x.powi(2)).sum::<f32>() / fast.len() as f32).sqrt();
    assert!(rms < 0.15, "pixels differ by {rms}");
}

#[test]
fn an_open_corner_is_lit_by_its_own_bounces() {
    let bounced = cache::diffuse_light(&corner(0.8, Environment::uniform(Vec3::ONE)), 96, 1, 2);
    let direct = cache::diffuse_light(&corner(0.0, Environment::uniform(Vec3::ONE)), 96, 1, 2);
    let mean = |light: &[Vec3]| light.iter().map(|l| l.x).sum::<f32>() / light.len() as f32;
    assert!(mean(&bounced) > 1.15 * mean(&direct) && mean(&bounced) < 1.0, "{} {}", mean(&bounced), mean(&direct));
}

#[test]
fn directions_about_a_normal_are_unit_and_average_to_two_thirds() {
    let mut points = Stratified::new(&mut Rng::new(1, 2));
    let normal = Vec3::new(0.3, -0.5, 0.81).normalize();
    let sum: Vec3 = (0..4000).map(|_| cosine_direction(normal, points.point())).sum();
    assert!((sum / 4000.0 - normal * (2.0 / 3.0)).length() < 0.002);
}
