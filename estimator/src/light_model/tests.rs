//! A desk with a box in a corner of two walls, under a lamp or under a uniform sky: lit colours as the model makes them.

use crate::association::lampless_air::LamplessAir;
use crate::factorisation::{Colors, FactorisationOptions, SeenBackground, factorise};
use crate::light_model::choose::{self, Chosen, Near};
use crate::light_model::division::Division;
use crate::light_model::lamps::{self, Sphere};
use crate::light_model::secondary::secondary;
use crate::mesh::graph::Graph;
use crate::numerics::robust::median;
use crate::rays::RayScene;
use crate::transfer::{Traced, Tracer};
use firmware_config::SolverChoice;
use firmware_config::tuning::{FactorisationTuning, SegmentationTuning};
use glam::Vec3;
use recordings::decision::Decision;
use recordings::local_light::LightModel;
use recordings::types::Mesh;
use std::sync::Arc;

const LAMP: Sphere = Sphere { center: Vec3::new(0.62, 0.55, 0.7), radius: 0.03 };
const OTHER_LAMP: Sphere = Sphere { center: Vec3::new(0.2, 0.8, 0.5), radius: 0.03 };
const ALBEDO: [Vec3; 4] =
    [Vec3::new(0.5, 0.35, 0.2), Vec3::new(0.7, 0.7, 0.65), Vec3::new(0.6, 0.2, 0.2), Vec3::new(0.2, 0.4, 0.6)];

/// A square of `n` × `n` cells with its normal along `x` × `y`; its segment is appended for every vertex.
pub(super) fn square(mesh: &mut Mesh, segment: &mut Vec<u32>, of: u32, [origin, x, y]: [Vec3; 3], n: u32) {
    let first = mesh.positions.len() as u32;
    for i in 0..=n {
        for j in 0..=n {
            mesh.positions.push(origin + x * (i as f32 / n as f32) + y * (j as f32 / n as f32));
            mesh.normals.push(x.cross(y).normalize());
            segment.push(of);
        }
    }
    for i in 0..n {
        for j in 0..n {
            let a = first + i * (n + 1) + j;
            mesh.triangles.extend([[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]);
        }
    }
}

fn desk() -> (Mesh, Vec<u32>) {
    let (mut mesh, mut segment) = (Mesh::default(), Vec::new());
    let mut add = |of, corners, n| square(&mut mesh, &mut segment, of, corners, n);
    add(0, [Vec3::ZERO, Vec3::X, Vec3::Y], 40);
    add(1, [Vec3::ZERO, Vec3::Y, Vec3::Z], 30);
    add(1, [Vec3::ZERO, Vec3::Z, Vec3::X], 30);
    let (low, edge) = (Vec3::new(0.3, 0.35, 0.0), 0.22);
    let (x, y, z) = (Vec3::X * edge, Vec3::Y * edge, Vec3::Z * edge);
    add(2, [low + z, x, y], 12);
    add(2, [low + x, y, z], 12);
    add(2, [low + y, z, x], 12);
    add(3, [low, x, z], 12);
    add(3, [low, z, y], 12);
    (mesh, segment)
}

/// Lit colours under `direct` irradiance over π and all bounces.
fn lit(traced: &Traced, segment: &[u32], direct: &[Vec3]) -> Vec<Vec3> {
    let reflected =
        |e: &[Vec3]| -> Vec<Vec3> { segment.iter().zip(e).map(|(s, e)| ALBEDO[*s as usize] * *e).collect() };
    let mut f = reflected(direct);
    for _ in 0..12 {
        let arriving: Vec<Vec3> = (0..f.len()).map(|i| direct[i] + secondary(traced, &f, i)).collect();
        f = reflected(&arriving);
    }
    f
}

fn chosen(direct: impl Fn(&Mesh, &RayScene, &Traced, usize) -> Vec3) -> (Option<Near>, Vec<Decision>, Vec<u32>) {
    let (chosen, paint) = chosen_with(|paint| paint, f32::INFINITY, direct);
    (chosen.near, chosen.decisions, paint)
}

/// The choice where `segment_of` tells the segment of every paint, and colours are `clipped_at` a value; and the paint of every vertex.
fn chosen_with(
    segment_of: impl Fn(u32) -> u32,
    clipped_at: f32,
    direct: impl Fn(&Mesh, &RayScene, &Traced, usize) -> Vec3,
) -> (Chosen, Vec<u32>) {
    let (mesh, paint) = desk();
    let scene = RayScene::new(&mesh);
    let traced = Arc::new(
        Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &scene, bands: 5, seed: 1 }.trace(128, &|_| ()),
    );
    let direct: Vec<Vec3> = (0..mesh.positions.len()).map(|i| direct(&mesh, &scene, &traced, i)).collect();
    let mut lit_color = lit(&traced, &paint, &direct);
    let clipped: Vec<bool> = lit_color.iter().map(|f| f.max_element() > clipped_at).collect();
    lit_color.iter_mut().for_each(|f| *f = f.min(Vec3::splat(clipped_at)));
    let segment: Vec<u32> = paint.iter().map(|p| segment_of(*p)).collect();
    let weight = vec![1.0; lit_color.len()];
    let colors = Colors {
        lit_color: &lit_color,
        lit_weight: &weight,
        reliability: &[],
        clipped: &clipped,
        segment: &segment,
        segments: ALBEDO.len(),
        graph: &Graph::of(&mesh),
        known: None,
    };
    let tuning = FactorisationTuning::default();
    let options = FactorisationOptions {
        gi: true,
        bands: 3,
        max_bands: 3,
        bounces: 0,
        solver: SolverChoice::Robust,
        tuning: &tuning,
    };
    let found = factorise(Arc::clone(&traced), &colors, &options, None);
    let paints = SegmentationTuning::default();
    let (unseen_radiates, divided_by) = (false, Some(&paints));
    let parts = choose::Scene {
        mesh: &mesh,
        rays: &scene,
        colors,
        unseen_radiates,
        seen_lamps: &[],
        lampless_air: &LamplessAir::default(),
        background: &SeenBackground::default(),
        divided_by,
    };
    (choose::choose(&parts, &found, &options, &mut || true), paint)
}

fn under_the_lamp(mesh: &Mesh, scene: &RayScene, traced: &Traced, i: usize) -> Vec3 {
    let sky = traced.direct[i * 25] * 0.282_095 * 4.0 * std::f32::consts::PI * 0.1;
    Vec3::new(0.5, 0.4, 0.3) * lamps::form_factor(mesh, scene, i, &LAMP) + Vec3::splat(sky)
}

fn under_two_lamps(mesh: &Mesh, scene: &RayScene, traced: &Traced, i: usize) -> Vec3 {
    under_the_lamp(mesh, scene, traced, i) + Vec3::new(0.3, 0.3, 0.3) * lamps::form_factor(mesh, scene, i, &OTHER_LAMP)
}

#[test]
fn a_lamp_beside_the_scene_is_found_where_it_is() {
    let (near, decision, segment) = chosen(under_the_lamp);
    let near = near.unwrap_or_else(|| panic!("distant light was kept: {decision:?}"));
    assert_eq!(near.light.model, LightModel::Lamps, "{decision:?}");
    let lamp = near.light.lamps[0];
    let off = Vec3::from_array(lamp.center).distance(LAMP.center);
    assert!(off < 0.03, "{off} m from its place");
    let wrong: Vec<f32> = segment
        .iter()
        .zip(&near.detail.albedo)
        .map(|(s, a)| (*a / ALBEDO[*s as usize] - 1.0).abs().max_element())
        .collect();
    let wrong = median(wrong).unwrap_or(1.0);
    assert!(wrong < 0.1, "albedo off by {wrong}, its scale included");
}

/// Distance of the nearest lamp.
fn off(near: &Near, from: &Sphere) -> f32 {
    near.light.lamps.iter().map(|l| Vec3::from_array(l.center).distance(from.center)).fold(f32::INFINITY, f32::min)
}

#[test]
fn two_lamps_are_found_where_they_are_though_what_is_below_one_is_clipped() {
    for clipped_at in [f32::INFINITY, 1.5] {
        let (chosen, _) = chosen_with(|paint| paint, clipped_at, under_two_lamps);
        let near = chosen.near.unwrap_or_else(|| panic!("{:?}", chosen.decisions));
        let off = [off(&near, &LAMP), off(&near, &OTHER_LAMP)];
        assert_eq!(near.light.model, LightModel::Lamps, "clipped at {clipped_at}: {:?}", chosen.decisions);
        assert!(off.iter().all(|o| *o < 0.05), "clipped at {clipped_at}: {off:?} m from their places");
    }
}

/// The choice under a uniform sky that brings level surface a radiosity of 1, and a sun that brings `share` of that to what faces it.
fn chosen_under_the_sun(toward: Vec3, share: f32) -> (Chosen, Vec<u32>) {
    let sun = Sphere { center: toward * 2000.0, radius: 20.0 };
    chosen_with(
        |paint| paint,
        f32::INFINITY,
        |mesh, scene, traced, i| {
            let sky = traced.direct[i * 25] * 0.282_095 * 4.0 * std::f32::consts::PI;
            Vec3::splat(sky + share * 2000.0_f32.powi(2) * lamps::form_factor(mesh, scene, i, &sun))
        },
    )
}

#[test]
fn the_sun_is_found_where_it_stands() {
    let (toward, share) = (Vec3::new(0.64, 0.6, 0.48), 2.0);
    let (chosen, paint) = chosen_under_the_sun(toward, share);
    let sunny = chosen.sunny.unwrap_or_else(|| panic!("no sun: {:?}", chosen.decisions));
    let lamp = sunny.transfer.traced.sun.as_ref().expect("a sunny answer has a sun").lamp;
    let found = Vec3::from_array(lamp.center);
    let off = found.angle_between(toward).to_degrees();
    assert!(off < 2.0 && found.length() > 100.0, "{off} degrees off, {found} m away");
    // What it brings over what the uniform sky brings, which is its mean radiance.
    let times = sunny.solution.sun().expect("a sunny answer has a sun")[1];
    let brings = times * lamp.radiance[1] * f64::from(lamp.radius_m / found.length()).powi(2);
    let sky = sunny.solution.light[0][1] / libm::sqrt(4.0 * std::f64::consts::PI);
    assert!((brings / sky / f64::from(share) - 1.0).abs() < 0.15, "{} times the sky instead of {share}", brings / sky);
    // One factor is free.
    let ratio = |(p, a): (&u32, &Vec3)| f64::from(a.y / ALBEDO[*p as usize].y);
    let ratios: Vec<f64> = paint.iter().zip(&sunny.detail.albedo).map(ratio).collect();
    let level = median(ratios.iter().copied()).unwrap_or(1.0);
    let wrong = median(ratios.iter().map(|r| (r / level - 1.0).abs())).unwrap_or(1.0);
    assert!(wrong < 0.03, "albedo off by {wrong}");
}

#[test]
fn what_is_no_brighter_than_the_sky_is_no_sun() {
    let (chosen, _) = chosen_under_the_sun(Vec3::new(0.64, 0.6, 0.48), 0.02);
    assert!(chosen.near.is_none() && chosen.sunny.is_none(), "{:?}", chosen.decisions);
}

#[test]
fn a_desk_and_walls_that_were_taken_for_one_paint_are_divided() {
    let (chosen, paint) = chosen_with(|paint| if paint == 1 { 0 } else { paint }, f32::INFINITY, under_the_lamp);
    let Some((Division { part, of }, decision)) = chosen.division else { panic!("{:?}", chosen.decisions) };
    // Most of a part is of one paint.
    let mut count = vec![[0; ALBEDO.len()]; of.len()];
    part.iter().zip(&paint).for_each(|(part, paint)| count[*part as usize][*paint as usize] += 1);
    let most: usize = count.iter().map(|c| c.iter().max().copied().unwrap_or(0)).sum();
    assert!(most as f64 > 0.98 * part.len() as f64, "{count:?}, {decision:?}");
}

#[test]
fn a_uniform_sky_stays_distant() {
    let (near, decision, _) = chosen(|_, _, traced, i| {
        Vec3::new(1.0, 0.9, 0.8) * traced.direct[i * 25] * 0.282_095 * 4.0 * std::f32::consts::PI
    });
    assert!(near.is_none(), "{decision:?}");
}
