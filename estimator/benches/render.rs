//! Cost of mixed reality on a made-up result of 72 000 vertices at 640 × 480: an object inserted over a photo, an object removed from
//! it, and relighting by a sequence of panoramas; CPU and wall time, peak memory. `cargo bench -p estimator --bench render`.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod usage;

use estimator::rays::RayScene;
use estimator::render::change::{Changed, change};
use estimator::render::compose::{Viewpoint, compose, model};
use estimator::render::inpainting::geometry::cut;
use estimator::render::lighting::completion::complete;
use estimator::render::lighting::observed_background::ObservedBackground;
use estimator::render::lighting::panorama::{Panorama, Projector};
use estimator::render::objects::material::Material;
use estimator::render::objects::object::Object;
use estimator::render::relight::{BANDS, NewLight, Relight};
use estimator::render::removal::select::{Removal, select};
use firmware_config::RealityConfig;
use glam::{DMat3, DQuat, DVec3, Vec3};
use recordings::decision::TransferLevel;
use recordings::local_light::LocalLight;
use recordings::result::{Estimate, Light, Segment};
use recordings::types::{CameraModel, Distortion, Intrinsics, Mesh, Pose, Response, vertex_normals};
use std::time::Instant;
use usage::{peak_mib, processor_s};

/// Panoramas of the sequence and their width.
const LIGHTS: usize = 24;
const PANORAMA: usize = 512;

fn main() {
    let estimate = desk();
    let view = viewpoint();
    let config = RealityConfig::default();
    let scene = RayScene::new(&estimate.mesh);
    println!("{} vertices, 640x480, {} threads", estimate.mesh.positions.len(), rayon::current_num_threads());

    let around = || (complete(&estimate.light, &[], &config.tuning.surroundings), ObservedBackground::default());
    let nothing = vec![false; estimate.mesh.positions.len()];
    let before = change(&estimate, around(), cut(&estimate.mesh, &nothing, &config.tuning.inpainting), &[], &config);
    let photo = model(&before, &view, &config);
    let over = |name: &str, make: &dyn Fn() -> Changed| {
        let (cpu, wall) = (processor_s(), Instant::now());
        let picture = compose(&make(), &view, &photo, &config);
        let touched = picture.touched.iter().filter(|t| **t).count();
        let (cpu, wall) = (processor_s() - cpu, wall.elapsed().as_secs_f64());
        println!("{name}: {wall:.2} s ({cpu:.2} s of CPU), {touched} pixels changed; peak {:.0} MiB", peak_mib());
    };
    let mut object = Object { mesh: ball(48, 48), materials: vec![Material::default()], ..Object::default() };
    object.material = vec![0; object.mesh.triangles.len()];
    object.place(Vec3::new(-0.2, -0.1, 0.05), 0.0, 0.05);
    over("insert over a photo", &|| {
        change(
            &estimate,
            around(),
            cut(&estimate.mesh, &nothing, &config.tuning.inpainting),
            std::slice::from_ref(&object),
            &config,
        )
    });
    let low = Removal::Box(Vec3::new(0.0, 0.0, 0.001), Vec3::splat(1.0));
    let gone =
        select(&estimate.mesh, &estimate.segment, &scene, &[low], &config.tuning.removal).expect("the ball is there");
    over("remove from a photo", &|| {
        change(&estimate, around(), cut(&estimate.mesh, &gone, &config.tuning.inpainting), &[], &config)
    });

    let (cpu, wall) = (processor_s(), Instant::now());
    let relight = Relight::new(&before, &LocalLight::default(), &config, &|_| {});
    let kept = relight.view(&before, &view, &config);
    println!("transfer: {:.2} s ({:.2} s of CPU)", wall.elapsed().as_secs_f64(), processor_s() - cpu);
    let panoramas: Vec<Panorama> = (0..LIGHTS).map(panorama).collect();
    let projector = Projector::new(&panoramas[0], BANDS);
    let (cpu, wall) = (processor_s(), Instant::now());
    for p in &panoramas {
        let light = NewLight { coefficients: projector.project(p), environment: p.environment(0.0), scanned: false };
        let picture = relight.picture(&kept, &light, Vec3::ONE, None);
        assert!(picture.linear.iter().any(|p| p.y > 0.0));
    }
    let n = LIGHTS as f64;
    let (cpu, wall) = ((processor_s() - cpu) / n, wall.elapsed().as_secs_f64() / n);
    println!("relight: {:.1} frames/s ({:.0} ms of CPU a frame); peak {:.0} MiB", 1.0 / wall, cpu * 1e3, peak_mib());
}

/// A table of 1.2 m with a ball on it.
fn desk() -> Estimate {
    const SIDE: usize = 220;
    let mut mesh = Mesh::default();
    for i in 0..SIDE * SIDE {
        let at = |k: usize| (k as f32 / (SIDE - 1) as f32 - 0.5) * 1.2;
        mesh.positions.push(Vec3::new(at(i % SIDE), at(i / SIDE), 0.0));
    }
    for y in 0..SIDE - 1 {
        for x in 0..SIDE - 1 {
            let a = (y * SIDE + x) as u32;
            let n = SIDE as u32;
            mesh.triangles.extend([[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]);
        }
    }
    let table = mesh.positions.len();
    let ball = ball(154, 154);
    mesh.triangles.extend(ball.triangles.iter().map(|t| t.map(|i| i + table as u32)));
    mesh.positions.extend(ball.positions.iter().map(|p| *p * 0.1 + Vec3::new(0.2, 0.15, 0.102)));
    mesh.normals = vertex_normals(&mesh.positions, &mesh.triangles);
    let n = mesh.positions.len();
    let segment: Vec<u32> = (0..n).map(|i| u32::from(i >= table)).collect();
    let colors = [Vec3::new(0.5, 0.4, 0.3), Vec3::new(0.7, 0.2, 0.15)];
    let albedo: Vec<Vec3> = segment.iter().map(|s| colors[*s as usize]).collect();
    let lit_color = albedo.iter().zip(&mesh.normals).map(|(a, n)| *a * (0.5 + 0.4 * n.z)).collect();
    let segments = [table, n - table].into_iter().zip(colors).map(|(count, c)| Segment {
        vertices: count as u32,
        albedo: c.as_dvec3().to_array(),
        w_d: 1.0,
        w_s: 0.0,
        w_s_error: 0.01,
    });
    let mut coefficients = vec![[0.0; 3]; 81];
    (coefficients[0], coefficients[2], coefficients[3]) = ([3.0; 3], [1.0; 3], [0.8, 0.7, 0.6]);
    Estimate {
        name: "desk".into(),
        response: Response::Srgb,
        segment,
        lit_color,
        confidence: vec![1.0; n],
        albedo,
        light: Light { coefficients, ..Light::default() },
        segments: segments.collect(),
        keyframes: Vec::new(),
        transfer: TransferLevel::Gi,
        decisions: Vec::new(),
        cuts: Vec::new(),
        warnings: Vec::new(),
        albedo_scale_rule: String::new(),
        witnesses: Vec::new(),
        local_light: LocalLight::default(),
        texture: None,
        mesh,
    }
}

/// A unit ball of rings and sectors.
fn ball(rings: u32, sectors: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=rings {
        for j in 0..sectors {
            let (sa, ca) = libm::sincosf(std::f32::consts::PI * i as f32 / rings as f32);
            let (sb, cb) = libm::sincosf(std::f32::consts::TAU * j as f32 / sectors as f32);
            mesh.positions.push(Vec3::new(sa * cb, sa * sb, ca));
            if i < rings {
                let (a, b) = (i * sectors + j, i * sectors + (j + 1) % sectors);
                mesh.triangles.extend([[a, a + sectors, b], [b, a + sectors, b + sectors]]);
            }
        }
    }
    mesh.normals = mesh.positions.clone();
    mesh
}

fn viewpoint() -> Viewpoint {
    let eye = DVec3::new(0.0, -0.9, 0.7);
    let forward = (DVec3::new(0.0, 0.05, 0.0) - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let axes = DMat3::from_cols(right, forward.cross(right), forward);
    let intrinsics = Intrinsics { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 };
    Viewpoint {
        camera: CameraModel { intrinsics, distortion: Distortion::default() },
        world_from_camera: Pose::new(DQuat::from_mat3(&axes), eye),
        gain: Vec3::ONE,
    }
}

/// A panorama with a lamp that goes round.
fn panorama(frame: usize) -> Panorama {
    let lamp = PANORAMA * frame / LIGHTS;
    let pixels = (0..PANORAMA * PANORAMA / 2).map(|i| {
        let (x, y) = (i % PANORAMA, i / PANORAMA);
        let near = (x + PANORAMA - lamp) % PANORAMA < 24 && (60..84).contains(&y);
        Vec3::splat(if near { 60.0 } else { 0.4 })
    });
    Panorama::new(PANORAMA, pixels.collect()).expect("a panorama")
}
