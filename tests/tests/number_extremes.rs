//! Numbers at the extremes: light, albedo and exposures far apart, rotations, single against double precision, and random
//! systems whose solution is known.

#![allow(clippy::expect_used, reason = "these are tests")]

use estimator::factorisation::paper_solver::least_squares;
use estimator::factorisation::{Observed, Solution, directions, robust_solver};
use estimator::mesh::graph::Graph;
use estimator::numerics::random::{CosineDirections, hash, unit};
use estimator::numerics::sh;
use estimator::rays::RayScene;
use estimator::transfer::{self, Tracer, Transfer};
use firmware_config::tuning::FactorisationTuning;
use glam::{DQuat, DVec3, Vec3};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use recordings::types::Mesh;
use std::sync::Arc;
use tests::scans::{globe, joined, sheet};

/// A globe in open space, its vertices in `segments` patches, under `light`; lit colours follow from Eq. (9).
struct Lit {
    transfer: Transfer,
    lit_color: Vec<Vec3>,
    lit_weight: Vec<f32>,
    clipped: Vec<bool>,
    segment: Vec<u32>,
    segments: usize,
}

impl Lit {
    fn new(bands: usize, light: &[[f64; 3]], albedo: &[f64]) -> Self {
        let mesh = globe(32, 0.5, 1.0);
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, bands)), bounced: None };
        let segment: Vec<u32> =
            (0..mesh.positions.len() as u32).map(|i| hash(i / 5, 77) % albedo.len() as u32).collect();
        let mut row = vec![0.0; bands * bands];
        let lit = |i: usize| {
            transfer.row(i, 0, &mut row);
            let e = [0, 1, 2].map(|c| row.iter().zip(light).map(|(t, l)| t * l[c]).sum::<f64>().max(0.0));
            Vec3::from_array(e.map(|e| (albedo[segment[i] as usize] * e) as f32))
        };
        let lit_color = (0..mesh.positions.len()).map(lit).collect();
        let count = mesh.positions.len();
        Self {
            transfer,
            lit_color,
            lit_weight: vec![1.0; count],
            clipped: vec![false; count],
            segment,
            segments: albedo.len(),
        }
    }

    fn solve(&self, bands: usize) -> Solution {
        let observed = Observed {
            transfer: &self.transfer,
            lit_color: &self.lit_color,
            lit_weight: &self.lit_weight,
            reliability: &[],
            clipped: &self.clipped,
            segment: &self.segment,
            segments: self.segments,
        };
        robust_solver::solve(&observed, bands, None, &FactorisationTuning::default())
    }

    /// Median relative error of what the solution predicts for the lit colours.
    fn error(&self, solution: &Solution) -> f64 {
        let irradiance = self.transfer.irradiance(&solution.light);
        let mut errors: Vec<f64> = (0..self.lit_color.len())
            .map(|i| {
                let predicted = solution.albedo[self.segment[i] as usize][1] * f64::from(irradiance[i].y);
                (predicted / f64::from(self.lit_color[i].y).max(1e-30) - 1.0).abs()
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }
}

/// Coefficients of radiance given over the solver's own directions.
fn projected(bands: usize, radiance: impl Fn(usize, DVec3) -> f64) -> Vec<[f64; 3]> {
    let directions = directions();
    let mut light = vec![[0.0; 3]; bands * bands];
    let mut y = vec![0.0; bands * bands];
    for (d, direction) in directions.iter().enumerate() {
        sh::eval(*direction, &mut y);
        let weight = radiance(d, *direction) * 4.0 * std::f64::consts::PI / directions.len() as f64;
        light.iter_mut().zip(&y).for_each(|(l, y)| l.iter_mut().for_each(|l| *l += weight * y));
    }
    light
}

/// One direction a million times as bright as the others: its shading is found, and its place.
#[test]
fn light_of_a_million_to_one() {
    let light = projected(5, |d, _| if d == 40 { 1e6 } else { 1.0 });
    let lit = Lit::new(5, &light, &[0.2, 0.7]);
    let solution = lit.solve(5);
    assert!(solution.light.iter().flatten().all(|x| x.is_finite()));
    let error = lit.error(&solution);
    assert!(error < 0.03, "lit colours are off by {error}");
    let brightest =
        (0..solution.radiance.len()).max_by(|a, b| solution.radiance[*a][1].total_cmp(&solution.radiance[*b][1]));
    let directions = directions();
    let off = directions[brightest.expect("directions")].angle_between(directions[40]).to_degrees();
    assert!(off < 15.0, "the light is {off}° off");
}

#[test]
fn albedos_of_a_thousandth_and_almost_one() {
    let light = projected(3, |_, d| 1.0 + 0.8 * d.z + 0.3 * d.x);
    let lit = Lit::new(3, &light, &[0.001, 0.999, 0.3]);
    let solution = lit.solve(3);
    let ratio = |a: usize, b: usize| solution.albedo[a][1] / solution.albedo[b][1];
    assert!((ratio(0, 1) / (0.001 / 0.999) - 1.0).abs() < 0.02, "{}", ratio(0, 1));
    assert!((ratio(2, 1) / (0.3 / 0.999) - 1.0).abs() < 0.02, "{}", ratio(2, 1));
}

/// A channel that is black everywhere does not disturb the others, and ends in numbers.
#[test]
fn a_channel_without_light() {
    let light: Vec<[f64; 3]> = projected(3, |_, d| 1.0 + 0.5 * d.y).into_iter().map(|l| [l[0], l[1], 0.0]).collect();
    let lit = Lit::new(3, &light, &[0.2, 0.6]);
    let solution = lit.solve(3);
    for rows in [&solution.light, &solution.standard_deviation, &solution.radiance, &solution.albedo] {
        assert!(rows.iter().flatten().all(|x| x.is_finite()));
    }
    assert!((solution.albedo[1][1] / solution.albedo[0][1] / 3.0 - 1.0).abs() < 0.02);
    // Albedo and light share a factor: their product is what must be dark.
    let lit = |c: usize| solution.albedo[1][c] * solution.light[0][c];
    assert!(lit(2) < 1e-3 * lit(1), "a black channel reflects nothing: {} {}", lit(2), lit(1));
}

/// The unit of radiance is free: the same colours times 2⁻⁴⁰ or 2³⁰ (exact in any precision) give the same albedos and light.
#[test]
fn colours_of_any_unit() {
    let light = projected(4, |_, d| 1.0 + 0.8 * d.z);
    let solve = |unit: f32| {
        let mut lit = Lit::new(4, &light, &[0.2, 0.6]);
        lit.lit_color.iter_mut().for_each(|f| *f *= unit);
        lit.solve(4)
    };
    let one = solve(1.0);
    for unit in [libm::exp2f(-40.0), libm::exp2f(30.0)] {
        let other = solve(unit);
        // Radiance has mean 1 in the solver: the unit is the albedo's.
        // Above band 2 the cosine lets little or nothing through: an open globe does not determine those.
        for (a, b) in one.light.iter().zip(&other.light).take(9) {
            assert!((a[1] - b[1]).abs() < 1e-3 * one.light[0][1], "unit {unit}: {a:?} {b:?}");
        }
        let (a, b) = (one.albedo[0][1] / one.albedo[1][1], other.albedo[0][1] / other.albedo[1][1]);
        assert!((a / b - 1.0).abs() < 1e-3, "unit {unit}: {a} {b}");
        assert!(other.standard_deviation.iter().flatten().all(|x| x.is_finite() && *x > 0.0));
    }
}

/// Coefficients of a light turned by `rotation`: exact, since rotation stays within a band.
fn turned(light: &[f64], rotation: DQuat) -> Vec<f64> {
    let k = light.len();
    let draw = |i: usize, j: u32| f64::from(unit(hash(i as u32, j))) - 0.5;
    let directions: Vec<DVec3> =
        (0..3 * k).map(|i| DVec3::new(draw(i, 1), draw(i, 2), draw(i, 3)).normalize()).collect();
    let values = |d: DVec3| {
        let mut y = vec![0.0; k];
        sh::eval(d, &mut y);
        y
    };
    let (x, _) = least_squares(k, directions.len(), |i, out| {
        out[..k].copy_from_slice(&values(directions[i]));
        out[k] = values(rotation.inverse() * directions[i]).iter().zip(light).map(|(y, l)| y * l).sum();
    });
    x.iter().copied().collect()
}

/// Scene, light and rays turned together: the light that is found turns along to 1e-5.
#[test]
fn the_pipeline_turns_with_the_scene() {
    let bands = 4;
    let k = bands * bands;
    let rotation = DQuat::from_euler(glam::EulerRot::ZYX, 0.7, -0.4, 1.1);
    let still = joined(&[globe(16, 0.5, 1.0), sheet(16, Vec3::new(-1.0, -1.0, -0.5), Vec3::X * 2.0, Vec3::Y * 2.0)]);
    let turn = |v: &Vec3| (rotation * v.as_dvec3()).as_vec3();
    let moved = Mesh {
        positions: still.positions.iter().map(turn).collect(),
        normals: still.normals.iter().map(turn).collect(),
        triangles: still.triangles.clone(),
    };
    let light: Vec<f64> = (0..k).map(|i| if i == 0 { 3.0 } else { f64::from(unit(hash(i as u32, 9))) - 0.5 }).collect();
    // Rays are those of the scene at rest, turned with it.
    let rays = CosineDirections::new(64, 1);
    let visible = RayScene::new(&still);
    let rows = |rotation: DQuat| -> Vec<Vec<f64>> {
        (0..still.positions.len())
            .map(|i| {
                let (mut row, mut y) = (vec![0.0; k], vec![0.0; k]);
                let origin = visible.offset_origin(still.positions[i], still.normals[i]);
                rays.about(i as u32, still.normals[i], 0..64, |_, d| {
                    if visible.closest_hit(origin, d).is_none() {
                        sh::eval(rotation * d.as_dvec3(), &mut y);
                        row.iter_mut().zip(&y).for_each(|(r, y)| *r += y / 64.0);
                    }
                });
                row
            })
            .collect()
    };
    let (before, after) = (rows(DQuat::IDENTITY), rows(rotation));
    let lit: Vec<f64> = before.iter().map(|row| row.iter().zip(&light).map(|(t, l)| 0.5 * t * l).sum()).collect();
    let solve = |rows: &[Vec<f64>]| {
        let (x, _) = least_squares(k, rows.len(), |i, out| {
            out[..k].iter_mut().zip(&rows[i]).for_each(|(o, t)| *o = 0.5 * t);
            out[k] = lit[i];
        });
        x.iter().copied().collect::<Vec<f64>>()
    };
    let size = light.iter().map(|x| x * x).sum::<f64>().sqrt();
    let expected = turned(&solve(&before), rotation);
    for (a, b) in expected.iter().zip(&solve(&after)) {
        assert!((a - b).abs() < 1e-5 * size, "{a} {b}");
    }
    // The same for the closed form of open surfaces, at nine bands.
    let (open, open_moved) = (transfer::unoccluded(&still, 9), transfer::unoccluded(&moved, 9));
    let light: Vec<f64> = (0..81).map(|i| f64::from(unit(hash(i, 10))) - 0.5).collect();
    let moved_light = turned(&light, rotation);
    let irradiance = |rows: &[f32], light: &[f64]| -> Vec<f64> {
        rows.chunks(81).map(|r| r.iter().zip(light).map(|(t, l)| f64::from(*t) * l).sum()).collect()
    };
    for (a, b) in irradiance(&open.direct, &light).iter().zip(&irradiance(&open_moved.direct, &moved_light)) {
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}

/// Nine bands in single precision against the same rays in double precision.
#[test]
fn transfer_in_single_precision_is_that_in_double() {
    let whole = joined(&[globe(12, 0.5, 1.0), sheet(12, Vec3::new(-1.0, -1.0, -0.5), Vec3::X * 2.0, Vec3::Y * 2.0)]);
    // Corners whose normals are at right angles share no rays.
    let mesh = Mesh {
        positions: whole.triangles.iter().flatten().map(|i| whole.positions[*i as usize]).collect(),
        normals: whole.triangles.iter().flat_map(|_| Vec3::AXES).collect(),
        triangles: (0..whole.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    };
    let scene = RayScene::new(&mesh);
    let traced = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &scene, bands: 9, seed: 1 }.trace(64, &|_| ());
    let directions = CosineDirections::new(64, 1);
    let mut checked = 0;
    for i in (0..mesh.positions.len()).step_by(7) {
        let origin = scene.offset_origin(mesh.positions[i], mesh.normals[i]);
        let (mut free, mut hit, mut y) = (vec![0.0; 81], vec![0.0; 81], vec![0.0; 81]);
        let mut hits = 0;
        directions.about(i as u32, mesh.normals[i], 0..64, |_, d| {
            sh::eval(d.as_dvec3(), &mut y);
            let is_hit = scene.closest_hit(origin, d).is_some();
            hits += usize::from(is_hit);
            let sum = if is_hit { &mut hit } else { &mut free };
            sum.iter_mut().zip(&y).for_each(|(s, y)| *s += y / 64.0);
        });
        // Where most rays escape, it is the closed form less what is blocked.
        let mut open = vec![0.0; 81];
        sh::eval(mesh.normals[i].as_dvec3(), &mut open);
        for (k, found) in traced.direct[i * 81..(i + 1) * 81].iter().enumerate() {
            let closed = open[k] * sh::cosine_factor(sh::band(k));
            let expected = if hits <= 32 { closed - hit[k] } else { free[k] };
            assert!((f64::from(*found) - expected).abs() < 1e-5, "vertex {i}, k = {k}: {found} {expected}");
            checked += 1;
        }
    }
    assert!(checked > 1000);
}

/// The paper's least squares from transfers in single precision against those in double.
#[test]
fn solving_in_single_precision_is_that_in_double() {
    let k = 25;
    let normals: Vec<DVec3> = sh::even_directions(600);
    let rows: Vec<Vec<f64>> = normals
        .iter()
        .map(|n| {
            let mut row = vec![0.0; k];
            sh::eval(*n, &mut row);
            row.iter_mut().enumerate().for_each(|(i, t)| *t *= sh::cosine_factor(sh::band(i)));
            row
        })
        .collect();
    // The cosine's factor vanishes for odd bands above one: those cannot be determined in any precision.
    let determined = |i: usize| sh::cosine_factor(sh::band(i)).abs() > 1e-9;
    let light: Vec<f64> =
        (0..k).map(|i| if determined(i) { f64::from(unit(hash(i as u32, 3))) } else { 0.0 }).collect();
    let solve = |round: &dyn Fn(f64) -> f64| {
        let (x, _) = least_squares(k, rows.len(), |i, out| {
            out[..k].iter_mut().zip(&rows[i]).for_each(|(o, t)| *o = round(*t));
            out[k] = rows[i].iter().zip(&light).map(|(t, l)| t * l).sum();
        });
        x
    };
    let (double, single) = (solve(&|x| x), solve(&|x| f64::from(x as f32)));
    for i in (0..k).filter(|i| determined(*i)) {
        assert!((double[i] - light[i]).abs() < 1e-9, "k = {i}: {} {}", double[i], light[i]);
        assert!((single[i] - light[i]).abs() < 1e-4, "k = {i}: {} {}", single[i], light[i]);
    }
}

/// ρ = 0.999 by a plain series takes thousands of bounces; the one that is extrapolated makes sixteen.
#[test]
fn bounces_are_accelerated() {
    let mesh = globe(12, 1.0, -1.0);
    let mut traced = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 1, seed: 1 }
        .trace(64, &|_| ());
    Arc::make_mut(&mut traced.direct).fill(1.0);
    let white = vec![Vec3::splat(0.999); mesh.positions.len()];
    let fast = transfer::bounce(&traced, &white, 0);
    assert!(fast.bounces <= 16, "{}", fast.bounces);
    let plain = transfer::bounce(&traced, &white, 16);
    let traced = Arc::new(traced);
    let first = |bounced| {
        let mut row = [0.0];
        Transfer { traced: Arc::clone(&traced), bounced: Some(bounced) }.row(5, 0, &mut row);
        row[0]
    };
    let (fast, plain) = (first(fast), first(plain));
    assert!((fast / 1000.0 - 1.0).abs() < 0.01, "{fast}");
    assert!(plain < 20.0, "without acceleration sixteen bounces are not enough: {plain}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Random light and albedos: colours are explained, and albedos are right up to the factor that is free.
    #[test]
    fn random_scenes_are_factorised(seed in 0u32..100_000, bands in 2usize..5) {
        let draw = |i: u32| f64::from(unit(hash(i, seed)));
        let at = DVec3::new(draw(1) - 0.5, draw(2) - 0.5, draw(3) - 0.5).normalize_or(DVec3::Z);
        let (level, sharp) = (0.1 + draw(4), 1.0 + 3.0 * draw(5));
        let light = projected(bands, |_, d| level + libm::exp(sharp * (d.dot(at) - 1.0)));
        let albedo = [0.05 + 0.9 * draw(6), 0.05 + 0.9 * draw(7), 0.05 + 0.9 * draw(8)];
        let lit = Lit::new(bands, &light, &albedo);
        let solution = lit.solve(bands);
        let error = lit.error(&solution);
        prop_assert!(error < 0.02, "lit colours are off by {}", error);
        for s in 1..3 {
            let ratio = solution.albedo[s][1] / solution.albedo[0][1] / (albedo[s] / albedo[0]);
            prop_assert!((ratio - 1.0).abs() < 0.03, "albedo {}: {}", s, ratio);
        }
    }

    /// Random well-posed systems, any scale.
    #[test]
    fn random_systems_are_solved(seed in 0u32..100_000, exponent in -12i32..12) {
        let (k, count) = (16, 80);
        let unit_of = |i: usize| f64::from(unit(hash(i as u32, seed))) - 0.5;
        let scale = libm::pow(10.0, f64::from(exponent));
        let system = DMatrix::from_fn(count, k, |r, c| scale * unit_of(r * k + c));
        let truth = DVector::from_fn(k, |i, _| unit_of(100_000 + i));
        let target = &system * &truth;
        let (x, condition) = least_squares(k, count, |j, out| {
            (0..k).for_each(|c| out[c] = system[(j, c)]);
            out[k] = target[j];
        });
        prop_assert!(condition < 100.0, "{}", condition);
        prop_assert!((x - truth).amax() < 1e-9);
    }
}
