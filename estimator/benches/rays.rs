//! Rays a second on one core, any hit and closest hit: `cargo bench -p estimator --bench rays -- [FOLDER]`.
//!
//! With a FOLDER, meshes and rays are written there too, for `embree.sh`, which traces the same with Embree.
//! The scene of posed pictures needs `LUMISCAN_SHARED=<shared data>`; the room is made up.

#![allow(clippy::expect_used)]

#[expect(dead_code, reason = "how much memory rays take is no matter here")]
mod usage;

use estimator::numerics::random::CosineDirections;
use estimator::rays::RayScene;
use glam::Vec3;
use recordings::import::photos::import_photos;
use recordings::types::Mesh;
use std::path::{Path, PathBuf};
use usage::processor_s;

/// Rays of a scene.
const RAYS: usize = 1 << 21;
/// Passes over them; the fastest counts, in processor time, because what else runs on a machine only ever slows.
const PASSES: usize = 3;

type Ray = (Vec3, Vec3);

fn main() {
    let folder = std::env::args().skip(1).find(|a| !a.starts_with("--")).map(PathBuf::from);
    let mut scenes = vec![("room", room(80))];
    match std::env::var_os("LUMISCAN_SHARED").map(PathBuf::from) {
        Some(shared) => {
            let scan = import_photos(&shared.join("truth/bunny"), None).expect("a scan");
            scenes.push(("bunny", scan.mesh));
        }
        None => println!("skipped: bunny (LUMISCAN_SHARED is not set; it names the folder with truth/bunny)"),
    }
    for (name, mesh) in &scenes {
        let scene = RayScene::new(mesh);
        let rays = cosine_rays(mesh, &scene);
        if let Some(folder) = &folder {
            write(folder, name, mesh, &rays).expect("a folder that can be written");
        }
        let (blocked, any) = rate(&rays, |o, d| scene.occluded(o, d));
        let (hits, closest) = rate(&rays, |o, d| scene.closest_hit(o, d).is_some());
        assert_eq!(blocked, hits, "both kinds of ray agree on what is hit");
        println!("{name} {any:.3} {closest:.3} {:.5}", hits as f64 / rays.len() as f64);
    }
}

/// Rays that hit, and millions of rays a second.
fn rate(rays: &[Ray], hit: impl Fn(Vec3, Vec3) -> bool) -> (usize, f64) {
    let pass = || {
        let start = processor_s();
        let hits = rays.iter().filter(|(o, d)| hit(*o, *d)).count();
        (hits, rays.len() as f64 / (processor_s() - start) / 1e6)
    };
    (0..PASSES).map(|_| pass()).fold((0, 0.0), |best, p| (p.0, p.1.max(best.1)))
}

/// Rays as transfer traces them: from every vertex in turn, cosine-distributed about its normal.
fn cosine_rays(mesh: &Mesh, scene: &RayScene) -> Vec<Ray> {
    let each = RAYS.div_ceil(mesh.positions.len());
    let directions = CosineDirections::new(each as u32, 1);
    let mut rays = Vec::with_capacity(each * mesh.positions.len());
    for (vertex, (p, n)) in (0u32..).zip(mesh.positions.iter().zip(&mesh.normals)) {
        let origin = scene.offset_origin(*p, *n);
        directions.about(vertex, *n, 0..each, |_, d| rays.push((origin, d)));
    }
    rays
}

/// Little-endian: counts of vertices, triangles and rays; positions; corners; origins and directions in turn.
fn write(folder: &Path, name: &str, mesh: &Mesh, rays: &[Ray]) -> std::io::Result<()> {
    let mut bytes = Vec::new();
    for count in [mesh.positions.len(), mesh.triangles.len(), rays.len()] {
        bytes.extend((count as u32).to_le_bytes());
    }
    mesh.positions.iter().for_each(|p| bytes.extend(p.to_array().into_iter().flat_map(f32::to_le_bytes)));
    mesh.triangles.iter().for_each(|t| bytes.extend(t.iter().flat_map(|i| i.to_le_bytes())));
    for (o, d) in rays {
        bytes.extend(o.to_array().into_iter().chain(d.to_array()).flat_map(f32::to_le_bytes));
    }
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join(format!("{name}.rays")), bytes)
}

/// The inside of a room with wavy walls and a few balls in it; `n` squares along each side.
fn room(n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let size = Vec3::new(5.0, 4.0, 2.6);
    for axis in 0..3 {
        for side in [0.0f32, 1.0] {
            let inward = 1.0 - 2.0 * side;
            let place = |s: f32, t: f32| {
                let wave = 0.02 * libm::sinf(19.0 * s) * libm::sinf(23.0 * t);
                let mut p = Vec3::ZERO;
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (side + inward * wave, s, t);
                p * size
            };
            patch(&mut mesh, n, inward > 0.0, place);
        }
    }
    for ball in 0..6u32 {
        let center = Vec3::new(0.8 + 0.7 * ball as f32, 1.0 + 0.4 * (ball % 3) as f32, 0.5 + 0.25 * (ball % 4) as f32);
        let place = |s: f32, t: f32| {
            let ((sa, ca), (sb, cb)) =
                (libm::sincosf(std::f32::consts::TAU * s), libm::sincosf(std::f32::consts::PI * (0.01 + 0.98 * t)));
            center + 0.3 * Vec3::new(sb * ca, sb * sa, -cb)
        };
        patch(&mut mesh, n / 2, true, place);
    }
    mesh
}

/// `n` × `n` squares over the unit square, with the normals that their corners have.
fn patch(mesh: &mut Mesh, n: u32, forward: bool, place: impl Fn(f32, f32) -> Vec3) {
    let first = mesh.positions.len() as u32;
    let h = 1e-3;
    for i in 0..=n {
        for j in 0..=n {
            let (s, t) = (i as f32 / n as f32, j as f32 / n as f32);
            let across = (place(s + h, t) - place(s - h, t)).cross(place(s, t + h) - place(s, t - h));
            mesh.positions.push(place(s, t));
            mesh.normals.push(if forward { across } else { -across }.normalize_or(Vec3::Z));
        }
    }
    for i in 0..n {
        for j in 0..n {
            let a = first + i * (n + 1) + j;
            mesh.triangles.extend([[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]);
        }
    }
}
