//! Tests of tracing and bounces on two planes that meet.

use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::transfer::bounces::{bounce, bounce_light, bounce_on, bounce_scaled};
use crate::transfer::irradiance::Transfer;
use crate::transfer::sun::Sun;
use crate::transfer::tracer::{MAX_HITS, Tracer, kept_rays};
use glam::Vec3;
use recordings::local_light::Lamp;
use recordings::types::Mesh;
use std::sync::Arc;

/// A floor and a wall of `n` × `n` squares that meet along an edge.
fn corner(n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for wall in [false, true] {
        let first = mesh.positions.len() as u32;
        for i in 0..=n {
            for j in 0..=n {
                let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
                mesh.positions.push(if wall { Vec3::new(0.0, y, x) } else { Vec3::new(x, y, 0.0) });
                mesh.normals.push(if wall { Vec3::X } else { Vec3::Z });
            }
        }
        for i in 0..n {
            for j in 0..n {
                let a = first + i * (n + 1) + j;
                mesh.triangles.extend([[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]);
            }
        }
    }
    mesh
}

#[test]
fn scaled_bounces_come_near_the_converged_series() {
    let mesh = corner(24);
    let tracer = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 5, seed: 1 };
    let traced = Arc::new(tracer.trace(128, &|_| ()));
    let albedo: Vec<Vec3> = mesh.normals.iter().map(|n| Vec3::new(0.9, 0.6, 0.3) * n.abs().x.max(0.7)).collect();
    let light = [[0.8; 3], [0.1; 3], [0.5; 3], [-0.2; 3], [0.0; 3], [0.2; 3], [-0.1; 3], [0.1; 3], [0.3; 3]];
    let arriving = |bounced| Transfer { traced: Arc::clone(&traced), bounced: Some(bounced) }.irradiance(&light);
    let all = arriving(bounce(&traced, &albedo, 0));
    let off = |some: Vec<Vec3>| {
        let worst = all.iter().zip(&some).map(|(a, s)| ((*s - *a) / *a).abs().max_element());
        worst.fold(0.0, f32::max)
    };
    let one = off(arriving(bounce(&traced, &albedo, 1)));
    let scaled = off(arriving(bounce_scaled(&traced, &albedo, 1)));
    assert!(one > 0.03, "later bounces matter here: {one}");
    assert!(scaled < 0.3 * one, "{scaled} instead of {one}");
    let grey = bounce(&traced, &vec![Vec3::splat(0.4); albedo.len()], 0);
    let (before, on) = (off(arriving(grey.clone())), off(arriving(bounce_on(&traced, &albedo, grey))));
    assert!(before > 0.03 && on < 3e-3, "from other albedos: {on}, which were {before} off");
}

#[test]
fn the_sun_is_a_coefficient_more_and_bounces_as_other_light_does() {
    let mesh = corner(24);
    let tracer = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 2, seed: 1 };
    let lamp = Lamp { center: [1e4, 0.0, 1e4], radius_m: 10.0, radiance: [1.0; 3] };
    let direct: Vec<f32> = mesh.normals.iter().map(|n| 0.1 * n.dot(Vec3::new(0.6, 0.0, 0.8))).collect();
    let traced = tracer.trace(128, &|_| ()).with_sun(Sun { lamp, direct: direct.clone() });
    let albedo = vec![Vec3::new(0.9, 0.6, 0.3); mesh.positions.len()];
    let bounced = Some(bounce(&traced, &albedo, 0));
    let transfer = Transfer { traced: Arc::new(traced), bounced };
    let power = [1.0, 2.0, 3.0];
    let irradiance = transfer.irradiance(&[[0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], power]);
    let straight: Vec<Vec3> = direct.iter().map(|e| Vec3::new(1.0, 2.0, 3.0) * *e).collect();
    let all = bounce_light(&transfer.traced, &albedo, &straight);
    let mut row = [0.0; 5];
    for (i, (found, all)) in irradiance.iter().zip(&all).enumerate() {
        assert!(((*found - *all) / *all).abs().max_element() < 2e-3, "{found} instead of {all}");
        transfer.row(i, 1, &mut row);
        assert!((row[4] * power[1] - f64::from(found.y)).abs() < 1e-5 * f64::from(found.y), "{row:?}, {found}");
    }
    let share = irradiance.iter().zip(&straight).map(|(all, s)| ((*all - *s) / *all).max_element()).fold(0.0, f32::max);
    assert!(share > 0.1, "bounced share {share}");
}

#[test]
fn light_from_anywhere_bounces_as_spherical_harmonics_do() {
    let mesh = corner(24);
    let tracer = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 2, seed: 1 };
    let traced = Arc::new(tracer.trace(128, &|_| ()));
    let albedo = vec![Vec3::new(0.9, 0.6, 0.3); mesh.positions.len()];
    let all = Transfer { traced: Arc::clone(&traced), bounced: Some(bounce(&traced, &albedo, 0)) };
    let straight = Transfer { traced: Arc::clone(&traced), bounced: None }.irradiance(&[[1.0, 2.0, 3.0]]);
    let bounced = bounce_light(&traced, &albedo, &straight);
    let pairs = all.irradiance(&[[1.0, 2.0, 3.0]]).into_iter().zip(bounced).zip(straight);
    let (off, share) = pairs.fold((0.0f32, 0.0f32), |(off, share), ((a, b), s)| {
        (off.max(((a - b) / a).abs().max_element()), share.max(((a - s) / a).max_element()))
    });
    assert!(off < 2e-3 && share > 0.1, "{off}, bounced share {share}");
    assert_eq!(bounce_light(&traced, &albedo, &vec![Vec3::ZERO; albedo.len()])[0], Vec3::ZERO);
}

#[test]
fn kept_hits_stay_below_their_maximum_and_bounces_do_not_change() {
    assert_eq!(kept_rays(1000, 128, 128_000), 128);
    assert_eq!(kept_rays(1000, 128, 127_999), 64);
    assert_eq!(kept_rays(2_000_000, 65_536, MAX_HITS), 16);
    assert_eq!(kept_rays(usize::MAX, 128, MAX_HITS), 1);
    let mesh = corner(24);
    let tracer = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 5, seed: 1 };
    let bounced = |kept| {
        let traced = tracer.trace_range(0..512, kept, Vec::new, &|_| true).expect("traced");
        assert!(traced.corners.len() <= kept as usize * mesh.positions.len());
        let blocked = traced.mean_blocked();
        (bounce(&traced, &vec![Vec3::splat(0.5); mesh.positions.len()], 0).share, blocked)
    };
    let (all, few) = (bounced(512), bounced(32));
    assert!(all.0 > 0.05 && (few.0 / all.0 - 1.0).abs() < 0.02, "{all:?} {few:?}");
    assert_eq!(all.1, few.1, "blocked shares do not depend on the hits kept");
}

#[test]
fn more_rays_continue_the_first() {
    let mesh = corner(12);
    let tracer = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 5, seed: 1 };
    let traced = |rays, have| tracer.trace_while(rays, have, &|_| true).expect("traced");
    let (all, first) = (traced(512, None), traced(128, None));
    let more = traced(512, Some(&first));
    assert_eq!((more.rays, &more.offsets, &more.corners), (all.rays, &first.offsets, &first.corners));
    let worst = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst(&all.blocked, &more.blocked) < 1e-6);
    // The first rays alone may choose the other of the two estimates of Eq. (8).
    let (error, size) = (all.relative_error(), more.relative_error());
    assert!(worst(&all.direct, &more.direct) < 0.02, "{}", worst(&all.direct, &more.direct));
    assert!((0.6..1.6).contains(&(error / size)), "{error} {size}");
}
