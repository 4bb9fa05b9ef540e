//! Transfer and factorisation against scenes whose light and albedo are known.

use estimator::factorisation::{Colors, FactorisationOptions, Factorised, factorise};
use estimator::mesh::graph::Graph;
use estimator::numerics::random::{hash, unit};
use estimator::rays::RayScene;
use estimator::transfer::{self, Traced, Tracer, Transfer};
use firmware_config::SolverChoice;
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;
use recordings::types::Mesh;
use std::sync::Arc;
use tests::truth::Truth;
use tests::{metrics, shared};

const BANDS: usize = 9;

/// ‖T − T_ref‖ / ‖T_ref‖ over the reference vertices, l ≤ 4, for transfer without and with interreflection, and the
/// error that the program states for the same vertices.
fn transfer_error(truth: &Truth, traced: Traced) -> [f64; 3] {
    let albedo: Vec<Vec3> = truth.albedo.iter().map(|a| Vec3::from_array(a.map(|x| x as f32))).collect();
    let bounced = transfer::bounce(&traced, &albedo, 0);
    let transfer = Transfer { traced: Arc::new(traced), bounced: Some(bounced) };
    let reference = truth.transfer();
    let mut row = [0.0; 81];
    let (mut off, mut size, mut stated) = ([0.0; 2], [0.0; 2], 0.0);
    for (j, &i) in reference.vertices.iter().enumerate() {
        stated += f64::from(transfer.traced.error[i]).powi(2);
        for k in 0..25 {
            let t = reference.shade[j * 81 + k];
            off[0] += (f64::from(transfer.traced.direct[i * 81 + k]) - t).powi(2);
            size[0] += t * t;
        }
        for c in 0..3 {
            transfer.row(i, c, &mut row);
            for (k, found) in row.iter().take(25).enumerate() {
                let t = reference.gi[(j * 81 + k) * 3 + c];
                off[1] += (found - t).powi(2);
                size[1] += t * t;
            }
        }
    }
    let stated = transfer.traced.shared * (stated / size[0]).sqrt();
    [(off[0] / size[0]).sqrt(), (off[1] / size[1]).sqrt(), stated]
}

fn tracer<'a>(mesh: &'a Mesh, graph: &'a Graph, scene: &'a RayScene) -> Tracer<'a> {
    Tracer { mesh, graph, scene, bands: BANDS, seed: 1 }
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn transfer_is_that_of_the_reference() {
    let shared = shared();
    for name in ["ball", "bunny", "fruits"] {
        let truth = Truth::read(&shared, name);
        let scene = RayScene::new(&truth.mesh);
        let reference = truth.transfer();
        let open = transfer::unoccluded(&truth.mesh, BANDS);
        let (mut off, mut size) = (0.0, 0.0);
        for (j, &i) in reference.vertices.iter().enumerate() {
            for k in 0..25 {
                let t = reference.diffuse[j * 81 + k];
                off += (f64::from(open.direct[i * 81 + k]) - t).powi(2);
                size += t * t;
            }
        }
        assert!((off / size).sqrt() < 1e-3, "{name}: diffuse {}", (off / size).sqrt());
        let [shade, gi, stated] =
            transfer_error(&truth, tracer(&truth.mesh, &Graph::of(&truth.mesh), &scene).trace(128, &|_| ()));
        println!("{name}: 128 rays: shade {shade:.4}, gi {gi:.4}, stated {stated:.4}");
        assert!(shade < 0.05 && gi < 0.07, "{name}: shade {shade}, gi {gi}");
        assert!(shade / stated < 1.5 && stated / shade < 1.5, "{name}: the error is {shade}, stated as {stated}");
    }
}

fn many_rays(name: &str) {
    let shared = shared();
    let truth = Truth::read(&shared, name);
    let scene = RayScene::new(&truth.mesh);
    let [shade, gi, stated] =
        transfer_error(&truth, tracer(&truth.mesh, &Graph::of(&truth.mesh), &scene).trace(4096, &|_| ()));
    println!("{name}: 4096 rays: shade {shade:.5}, gi {gi:.5}, stated {stated:.5}");
    assert!(shade < 0.006 && gi < 0.01, "{name}: shade {shade}, gi {gi}");
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn many_rays_converge_to_the_reference() {
    many_rays("ball");
}

#[test]
#[ignore = "half a billion rays: minutes"]
fn many_rays_converge_on_larger_meshes() {
    many_rays("bunny");
    many_rays("fruits");
}

/// True lit colours with 3 % noise, true materials as segments.
fn solve(truth: &Truth, gi: bool, diffuse: bool, solver: SolverChoice) -> Factorised {
    let scene = RayScene::new(&truth.mesh);
    let traced = if diffuse {
        transfer::unoccluded(&truth.mesh, BANDS)
    } else {
        tracer(&truth.mesh, &Graph::of(&truth.mesh), &scene).trace(64, &|_| ())
    };
    // A sum of four uniform numbers, scaled to a standard deviation of 3 %.
    let noise = |i: usize, c: usize| {
        let draw = |k| unit(hash(i as u32 * 3 + c as u32, k));
        1.0 + 0.03 * 3f32.sqrt() * (draw(1) + draw(2) + draw(3) + draw(4) - 2.0)
    };
    let noisy = |(i, f): (usize, &[f64; 3])| Vec3::from_array([0, 1, 2].map(|c| f[c] as f32 * noise(i, c)));
    let lit: Vec<Vec3> = truth.lit_color.iter().enumerate().map(noisy).collect();
    let weight: Vec<f32> = truth.seen.iter().map(|s| *s as f32).collect();
    let segments = truth.material.iter().max().map_or(0, |s| *s as usize + 1);
    let clipped = vec![false; weight.len()];
    let colors = Colors {
        lit_color: &lit,
        lit_weight: &weight,
        reliability: &[],
        clipped: &clipped,
        segment: &truth.material,
        segments,
        graph: &Graph::of(&truth.mesh),
        known: None,
    };
    let bands = if solver == SolverChoice::Literal { 5 } else { BANDS };
    let tuning = &FactorisationTuning::default();
    let options = FactorisationOptions { gi, bands, max_bands: bands, bounces: 0, solver, tuning };
    factorise(Arc::new(traced), &colors, &options, None)
}

fn albedo_error(truth: &Truth, found: &Factorised) -> metrics::AlbedoError {
    let albedo: Vec<[f64; 3]> = found.detail.albedo.iter().map(|a| a.to_array().map(f64::from)).collect();
    metrics::albedo(&albedo, &truth.albedo, &truth.material, |i| truth.seen[i] >= 2)
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn light_and_albedo_from_true_colours() {
    let shared = shared();
    for name in ["ball", "bunny", "fruits"] {
        let truth = Truth::read(&shared, name);
        let found = solve(&truth, true, false, SolverChoice::Robust);
        let albedo = albedo_error(&truth, &found);
        let (median, p90) = metrics::scene_irradiance(&truth.transfer().gi, &found.solution.light, &truth.light);
        println!("{name}: albedo {albedo:.4?}, scene irradiance {median:.4} / {p90:.4}");
        assert!(albedo.median < 0.03 && albedo.p90 < 0.10 && albedo.within < 0.05, "{name}: {albedo:?}");
        assert!(median < 0.04 && p90 < 0.15, "{name}: scene irradiance {median} / {p90}");
    }
}

/// The paper's Fig. 8: each level of transfer explains the colours better than the one below it.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn gi_beats_shade_beats_diffuse() {
    let shared = shared();
    let truth = Truth::read(&shared, "fruits");
    let error = |gi, diffuse| albedo_error(&truth, &solve(&truth, gi, diffuse, SolverChoice::Robust)).p90;
    let (gi, shade, diffuse) = (error(true, false), error(false, false), error(false, true));
    println!("p90 of the albedo error: gi {gi:.4}, shade {shade:.4}, diffuse {diffuse:.4}");
    assert!(gi < shade && shade < diffuse, "gi {gi}, shade {shade}, diffuse {diffuse}");
}

/// The paper's Fig. 9: one albedo for the whole scene fails on several materials. The paper's additive update is compared too.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn nonsegmented_fails_on_several_materials() {
    let shared = shared();
    let truth = Truth::read(&shared, "fruits");
    let error = |solver| {
        let found = solve(&truth, true, false, solver);
        metrics::scene_irradiance(&truth.transfer().gi, &found.solution.light, &truth.light).0
    };
    let [ours, none, literal] = [SolverChoice::Robust, SolverChoice::Nonsegmented, SolverChoice::Literal].map(error);
    println!("scene irradiance error: ours {ours:.4}, nonsegmented {none:.4}, paper's {literal:.4}");
    assert!(ours < 0.3 * none && ours < 0.7 * literal, "ours {ours}, nonsegmented {none}, paper's {literal}");
}
