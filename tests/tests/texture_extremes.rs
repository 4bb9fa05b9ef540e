//! Textures of scans that are bad: keyframes that miss or are blurred, one keyframe, huge meshes, thousands of pieces, triangles
//! of zero area. Each gives a texture, or none, and then the decision says so.

#![allow(clippy::expect_used, clippy::panic, reason = "these are tests")]

use estimator::association::keyframe_image::KeyframeImage;
use estimator::association::veil::Veil;
use estimator::association::{AssociationContext, Lens, RefinedView};
use estimator::rays::RayScene;
use estimator::texture::albedo::texture;
use estimator::texture::filling::VertexColors;
use firmware_config::EstimatorConfig;
use glam::{DQuat, Vec3};
use recordings::decision::{AtlasFigures, Decision};
use recordings::result::Texture;
use recordings::scan::Scan;
use recordings::types::{Mesh, Pose};
use tests::scans::{globe, joined, scan, shaded, sheet};

/// The texture of a scan whose vertices all have albedo 0.5 under even light.
fn textured(scan: &Scan) -> (Option<Texture>, Option<AtlasFigures>) {
    let (mesh, config) = (&scan.mesh, EstimatorConfig::default());
    let scene = RayScene::new(mesh);
    let context = AssociationContext::new(mesh, &scene, &scan.sensor.response, &config);
    let views = scan.keyframes.iter().map(|k| RefinedView {
        world_from_camera: k.world_from_camera,
        gain: [1.0; 3],
        residual_px: 0.0,
    });
    let views: Vec<RefinedView> = views.collect();
    let veil = |k: &recordings::types::Keyframe| {
        Some(Veil::of(&KeyframeImage::new(&k.color, &k.camera)?, &k.camera, &context.table, context.clipped))
    };
    let veils: Vec<Option<Veil>> = scan.keyframes.iter().map(veil).collect();
    let keyframes: Vec<_> = scan.keyframes.iter().zip(&views).zip(&veils).map(|((k, v), veil)| (k, v, veil)).collect();
    let (grey, weight) = (vec![Vec3::splat(0.5); mesh.positions.len()], vec![1.0; mesh.positions.len()]);
    let colors = VertexColors { with_gloss: &grey, matte: &grey, weight: &weight, albedo: &grey };
    let (found, decision) = texture(&context, &keyframes, colors, Lens::default());
    let Decision::Texture { atlas, .. } = decision else { panic!("another decision") };
    assert_eq!(found.is_some(), atlas.is_some());
    (found, atlas)
}

/// The picture of a texture, and whether every triangle has a chart on it.
fn holds(mesh: &Mesh, texture: &Texture) -> bool {
    let picture = texture.picture().expect("a picture");
    let size = (picture.width, picture.height) == (texture.width, texture.height);
    size && texture.chart.len() == mesh.triangles.len()
        && texture.chart.iter().all(|c| (*c as usize) < texture.charts.len())
}

#[test]
fn keyframes_that_miss_leave_the_vertices() {
    let mut away = scan(globe(24, 0.5, 1.0), 3, 2.0, shaded);
    for keyframe in &mut away.keyframes {
        let turn = Pose::new(DQuat::from_rotation_y(std::f64::consts::PI), glam::DVec3::ZERO);
        keyframe.world_from_camera = keyframe.world_from_camera.compose(&turn);
    }
    assert!(textured(&away).0.is_none());
    away.keyframes.clear();
    assert!(textured(&away).0.is_none());
}

#[test]
fn damaged_pictures_leave_the_vertices() {
    let mut damaged = scan(globe(24, 0.5, 1.0), 3, 2.0, shaded);
    damaged.keyframes.iter_mut().for_each(|k| k.color.bytes.truncate(100));
    assert!(textured(&damaged).0.is_none());
}

/// Pictures without any detail say nothing of where they were taken: what they show stays.
#[test]
fn blurred_keyframes_give_a_smooth_texture() {
    let blurred = scan(globe(24, 0.5, 1.0), 4, 2.0, |_, _| [128; 3]);
    let (found, _) = textured(&blurred);
    let found = found.expect("a texture");
    assert!(holds(&blurred.mesh, &found));
    let picture = found.picture().expect("a picture");
    let (low, high) = picture.data.iter().fold((255, 0), |(l, h), v| (l.min(*v), h.max(*v)));
    // Grey 128 in the pictures is below the 0.5 of what none of them shows.
    assert!(low >= 100 && high <= 200, "{low} to {high}");
}

#[test]
fn one_keyframe_gives_a_texture_of_what_it_sees() {
    let one = scan(globe(24, 0.5, 1.0), 1, 2.0, shaded);
    let (found, atlas) = textured(&one);
    assert!(holds(&one.mesh, &found.expect("a texture")));
    let seen = atlas.expect("an atlas").seen;
    assert!((0.2..0.5).contains(&seen), "a camera sees less than half of a ball, not {seen}");
}

#[test]
fn ten_thousand_pieces_fit_a_page() {
    let piece = |i: u32| {
        let corner = Vec3::new((i % 100) as f32, (i / 100) as f32, 0.0) * 0.01 - Vec3::new(0.5, 0.5, 0.0);
        sheet(1, corner, Vec3::X * 0.008, Vec3::Y * 0.008)
    };
    let pieces: Vec<Mesh> = (0..10_000).map(piece).collect();
    let many = scan(joined(&pieces), 2, 1.0, shaded);
    let (found, atlas) = textured(&many);
    assert!(holds(&many.mesh, &found.expect("a texture")));
    assert_eq!(atlas.expect("an atlas").charts, 10_000);
}

#[test]
fn triangles_of_zero_area_have_a_chart_too() {
    let mut mesh = globe(24, 0.5, 1.0);
    let n = mesh.positions.len() as u32;
    mesh.triangles.extend((0..n / 2).map(|i| [i, i, i + 1]));
    mesh.triangles.extend((0..n / 2).map(|i| [i, i, i]));
    let degenerate = scan(mesh, 3, 2.0, shaded);
    assert!(holds(&degenerate.mesh, &textured(&degenerate).0.expect("a texture")));
    // Nothing but them: no surface.
    let points = Mesh { triangles: vec![[0, 0, 1], [2, 2, 2]], ..degenerate.mesh };
    assert!(textured(&scan(points, 3, 2.0, shaded)).0.is_none());
}

#[test]
fn a_huge_mesh_stays_on_its_page() {
    let huge = scan(globe(671, 0.5, 1.0), 2, 2.0, shaded);
    assert!(huge.mesh.positions.len() > 900_000);
    let (found, atlas) = textured(&huge);
    assert!(holds(&huge.mesh, &found.expect("a texture")));
    let side = EstimatorConfig::default().tuning.texture.max_side;
    assert!(atlas.is_some_and(|a| a.width <= side && a.height <= side));
}
