//! An exported result folder beside the scene it was made from. The figures are those of the independent scorer of the
//! shared truth scenes; only what the exported files say is judged.

use super::files::{pose, read_json, read_mask};
use super::produce::{MOST_ALBEDO, RERENDER_RAYS, VIEW_NAMES, median_ratio, read_environment};
use super::rerender::{Rerender, View, gain_for, psnr};
use crate::matching::Vertices;
use crate::metrics::{self, median, percentile};
use crate::synth::emitters::{Portal, Sphere};
use crate::synth::environment::luminance;
use glam::{DQuat, DVec3, Vec3};
use recordings::import::npy::Array;
use recordings::ply::read::{parse_ply, read_ply};
use recordings::types::{Intrinsics, Mesh, Pose};
use serde_json::{Map, Value, json};
use std::collections::HashMap;
use std::error::Error;
use std::path::Path;

/// Keyframes that must see a vertex for it to count.
const LEAST_VIEWS: f64 = 2.0;
/// A vertex of another mesh matches within this many edges, and within this distance at least, metres.
const MATCH_EDGES: f32 = 1.5;
const MATCH_M: f32 = 0.004;
/// Irradiance below this share of the mean is not judged.
const DARKEST: f32 = 0.02;
/// Bands that a light is judged by: those that are not exported count as zero.
const JUDGED_TERMS: usize = 25;

type Fallible<T> = Result<T, Box<dyn Error>>;

/// What is read of an exported result.
struct Found {
    mesh: Mesh,
    albedo: Vec<Vec3>,
    lit_color: Vec<Vec3>,
    emission: Option<Vec<Vec3>>,
    segment: Vec<u32>,
    /// w_s by segment.
    gloss: HashMap<u32, f64>,
    light: Vec<[f64; 3]>,
    spheres: Vec<Sphere>,
    /// Mean over the channels, by keyframe.
    log_gain: Vec<f64>,
    poses: Vec<Pose>,
    timestamp_s: Vec<f64>,
}

impl Found {
    fn read(folder: &Path) -> Fallible<Self> {
        const ALBEDO: [&str; 3] = ["albedo_r", "albedo_g", "albedo_b"];
        const LIT: [&str; 3] = ["lit_r", "lit_g", "lit_b"];
        const EMISSION: [&str; 3] = ["emission_r", "emission_g", "emission_b"];
        let bytes = std::fs::read(folder.join("vertices.ply"))?;
        let (mesh, columns) = parse_ply(&bytes, &[&ALBEDO[..], &LIT, &EMISSION, &["segment"]].concat())?;
        let column = |name: &str| columns.iter().find(|c| c.name == name).map(|c| &c.values);
        let vectors = |names: [&str; 3]| {
            let [x, y, z] = names.map(column);
            let (x, y, z) = (x?, y?, z?);
            Some((0..x.len()).map(|i| Vec3::new(x[i], y[i], z[i])).collect::<Vec<Vec3>>())
        };
        let missing = |name: &str| format!("{}: no {name}", folder.display());
        let document =
            |name: &str| -> Fallible<Value> { Ok(read_json(&folder.join(name))?.ok_or_else(|| missing(name))?) };
        let light = document("lighting_sh.json")?;
        let materials = document("materials.json")?;
        let exposures = document("exposures.json")?;
        let poses = document("poses.json")?;
        let rows = |v: &Value| v.as_array().cloned().unwrap_or_default();
        let number = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
        let mean_log = |v: &Value| match v.as_array() {
            Some(three) => three.iter().map(|g| libm::log(number(g))).sum::<f64>() / three.len() as f64,
            None => libm::log(number(v)),
        };
        let sphere = |v: &Value| -> Option<Sphere> {
            let vector = |v: &Value| serde_json::from_value::<Vec3>(v.clone()).ok();
            let radius_m = v["radius_m"].as_f64()? as f32;
            Some(Sphere { center: vector(&v["center"])?, radius_m, radiance: vector(&v["radiance"])? })
        };
        Ok(Self {
            mesh,
            albedo: vectors(ALBEDO).ok_or_else(|| missing("albedo"))?,
            lit_color: vectors(LIT).ok_or_else(|| missing("lit colours"))?,
            emission: vectors(EMISSION),
            segment: column("segment").ok_or_else(|| missing("segment"))?.iter().map(|s| *s as u32).collect(),
            gloss: rows(&materials["segments"]).iter().map(|s| (number(&s["id"]) as u32, number(&s["w_s"]))).collect(),
            light: serde_json::from_value(light["coefficients"].clone())?,
            spheres: rows(&light["spheres"]).iter().filter_map(sphere).collect(),
            log_gain: rows(&exposures["gain"]).iter().map(mean_log).collect(),
            poses: rows(&poses["frames"]).iter().filter_map(|f| pose(&f["camera_to_world"])).collect(),
            timestamp_s: rows(&poses["frames"]).iter().map(|f| number(&f["timestamp"])).collect(),
        })
    }
}

/// What is true.
struct Truth {
    mesh: Mesh,
    albedo: Vec<Vec3>,
    lit_color: Vec<Vec3>,
    emitting: Vec<bool>,
    material: Vec<u32>,
    seen: Vec<bool>,
    glossy: Vec<bool>,
    light: Vec<[f64; 3]>,
    /// True poses and gains in the order of the result's keyframes.
    poses: Vec<Pose>,
    given: Vec<Pose>,
    log_gain: Vec<f64>,
    camera: Intrinsics,
    spec: Value,
    reference: Value,
}

fn vectors(path: &Path) -> Vec<Vec3> {
    Array::read(path).expect("an array").rgb().iter().map(|c| Vec3::from(c.map(|x| x as f32))).collect()
}

impl Truth {
    /// `recorded`: keyframes are those of the recording with these time stamps (seconds).
    fn read(scene: &Path, recorded: Option<&[f64]>) -> Fallible<Self> {
        let truth = scene.join("truth");
        let document = |name: &str| -> Fallible<Value> {
            Ok(read_json(&truth.join(name))?.ok_or_else(|| format!("{}: no {name}", truth.display()))?)
        };
        let rows = |v: &Value| v.as_array().cloned().unwrap_or_default();
        let log = |v: &Value| libm::log(v.as_f64().unwrap_or(f64::NAN));
        let (mut poses, mut given, mut log_gain) = (Vec::new(), Vec::new(), Vec::new());
        let at = |frame: &Value| pose(&frame["camera_to_world"]).unwrap_or(Pose::IDENTITY);
        if let Some(times) = recorded {
            let frames = rows(&document("recording.json")?["frames"]);
            let away =
                |frame: &Value, time: f64| (frame["timestamp_ns"].as_f64().unwrap_or(f64::NAN) * 1e-9 - time).abs();
            for &time in times {
                let nearest = frames.iter().min_by(|a, b| away(a, time).total_cmp(&away(b, time)));
                let frame = nearest.ok_or("the recording has no frames")?;
                poses.push(at(frame));
                log_gain.push(log(&frame["gain"]));
            }
        } else {
            poses = rows(&document("poses.json")?["frames"]).iter().map(at).collect();
            given =
                rows(&read_json(&scene.join("keyframes.json"))?.unwrap_or_default()["frames"]).iter().map(at).collect();
            log_gain = rows(&document("exposures.json")?["gain"]).iter().map(log).collect();
        }
        let mesh = read_ply(&scene.join("mesh.ply"))?;
        let emission = truth.join("emission.npy");
        let emitting = if emission.is_file() {
            vectors(&emission).iter().map(|e| *e != Vec3::ZERO).collect()
        } else {
            vec![false; mesh.positions.len()]
        };
        let views = document("heldout/views.json")?;
        Ok(Self {
            albedo: vectors(&truth.join("albedo.npy")),
            lit_color: vectors(&truth.join("lit_color.npy")),
            emitting,
            material: Array::read(&truth.join("material_id.npy"))?.data.iter().map(|x| *x as u32).collect(),
            seen: Array::read(&truth.join("seen_count.npy"))?.data.iter().map(|x| *x >= LEAST_VIEWS).collect(),
            glossy: rows(&document("materials.json")?["materials"]).iter().map(|m| m["glossy"] == true).collect(),
            light: serde_json::from_value(document("lighting_sh.json")?["lighting"].clone())?,
            poses,
            given,
            log_gain,
            camera: serde_json::from_value(views["intrinsics"].clone())?,
            spec: document("spec.json")?,
            reference: document("reference.json")?,
            mesh,
        })
    }
}

/// Judges a result folder; `recorded` if it comes from the scene's recording. The map has the scene's seed and kind, too.
///
/// # Errors
/// A file is missing or damaged.
pub fn judge(scene: &Path, result: &Path, recorded: bool, threads: usize) -> Fallible<Map<String, Value>> {
    let mut found = Found::read(result)?;
    let truth = Truth::read(scene, recorded.then_some(&found.timestamp_s[..]))?;
    let mut row = Map::new();
    for key in ["seed", "light", "support", "panorama"] {
        row.insert(key.into(), truth.spec[key].clone());
    }
    row.insert("road".into(), json!(if recorded { "fused" } else { "photos" }));
    let mut put = |key: &str, value: f64| {
        row.insert(key.into(), if value.is_finite() { json!((value * 1e5).round() / 1e5) } else { Value::Null });
    };

    if recorded {
        // The scan's world begins with its first frame.
        let world = aligned(&found.poses, &truth.poses);
        super::files::write_json(&result.join("world_to_truth.json"), &super::files::matrix(&world))?;
        found.turn(&world);
    }
    let (mm, deg) = pose_error(&found.poses, &truth.poses);
    put("pose_mm", mm);
    put("pose_deg", deg);
    put("pose_px", pixel_error(&truth, &found.poses));
    if !recorded {
        let (mm, deg) = pose_error(&truth.given, &truth.poses);
        put("given_pose_mm", mm);
        put("given_pose_deg", deg);
        put("given_pose_px", pixel_error(&truth, &truth.given));
    }
    let (error, ignored) = exposure_error(&found.log_gain, &truth.log_gain);
    put("exposure", error);
    put("exposure_ignored", ignored);
    put("light_error", light_error(&found.light, &truth.light));
    put("light_visible_median", visible_irradiance(scene, &found.light, &truth.light));
    put("lamps", found.spheres.len() as f64);

    // Vertices: `pairs` of the truth's and the result's.
    let same = found.mesh.positions.len() == truth.mesh.positions.len()
        && found.mesh.positions.iter().zip(&truth.mesh.positions).all(|(a, b)| (*a - *b).abs().max_element() < 1e-5);
    let seen: Vec<usize> = (0..truth.seen.len()).filter(|&i| truth.seen[i]).collect();
    let pairs = if same { seen.iter().map(|&i| (i, i)).collect() } else { matched(&truth.mesh, &seen, &found.mesh) };
    put("matched", pairs.len() as f64 / seen.len().max(1) as f64);
    let of = |values: &[Vec3], indices: &dyn Fn(&(usize, usize)) -> usize| -> Vec<Vec3> {
        pairs.iter().map(|p| values[indices(p)]).collect()
    };
    let (true_albedo, own_albedo) = (of(&truth.albedo, &|p| p.0), of(&found.albedo, &|p| p.1));
    let wide = |values: &[Vec3]| values.iter().map(|v| v.to_array().map(f64::from)).collect::<Vec<_>>();
    let material: Vec<u32> = pairs.iter().map(|p| truth.material[p.0]).collect();
    let segment: Vec<u32> = pairs.iter().map(|p| found.segment[p.1]).collect();
    let wide_truth = wide(&true_albedo);
    let albedo = metrics::albedo(&wide(&own_albedo), &wide_truth, &material, |_| true);
    put("albedo_median", albedo.median);
    put("albedo_p90", albedo.p90);
    put("albedo_within", albedo.within);
    let scale = median_ratio(&true_albedo, &own_albedo, |_| true);
    let angles: Vec<f64> =
        true_albedo.iter().zip(&own_albedo).map(|(a, b)| f64::from(a.angle_between(*b)).to_degrees()).collect();
    put("albedo_angle_deg", median(&angles));
    let factor: Vec<f64> =
        true_albedo.iter().zip(&own_albedo).map(|(a, b)| f64::from(luminance(*b) / luminance(*a).max(1e-3))).collect();
    put("albedo_luminance_factor", median(&factor));
    // Another mesh than the truth's has its own lit colours, too, but none where no picture shows it.
    let naive_colors = of(&found.lit_color, &|p| p.1);
    let is_shown = |i: usize| naive_colors[i] != Vec3::ZERO;
    let [naive_median, naive_p90] = if same {
        ["median", "p90"].map(|key| truth.reference["naive_albedo"][key].as_f64().unwrap_or(f64::NAN))
    } else {
        let naive = metrics::albedo(&wide(&naive_colors), &wide_truth, &material, is_shown);
        [naive.median, naive.p90]
    };
    put("naive_albedo_median", naive_median);
    put("naive_albedo_p90", naive_p90);
    put("ari", metrics::adjusted_rand_index(&material, &segment));
    let glossy = segment.iter().zip(&material).map(|(s, m)| (*s, truth.glossy[*m as usize]));
    let auc = metrics::gloss_auc(glossy, |s| found.gloss.get(&s).copied().unwrap_or(0.0));
    put("gloss_auc", auc.unwrap_or(f64::NAN));

    // Light on the surface, and held-out views.
    let most = Vec3::splat(MOST_ALBEDO);
    let albedo: Vec<Vec3> = found.albedo.iter().map(|a| (*a * scale).clamp(Vec3::ZERO, most)).collect();
    let scaled = scale.as_dvec3();
    let light: Vec<[f64; 3]> = found.light.iter().map(|l| (DVec3::from(*l) / scaled).to_array()).collect();
    let spheres = found.spheres.iter().map(|s| Sphere { radiance: s.radiance / scale, ..*s }).collect();
    let emission: Option<Vec<Vec3>> = found.emission.map(|e| e.iter().map(|e| *e / scale).collect());
    // On another mesh than the truth's: the truth's albedo, which is the ceiling, and lit colours as albedo.
    let references = (!same).then(|| {
        let mut ceiling = albedo.clone();
        let all: Vec<usize> = (0..ceiling.len()).collect();
        let nearest = matched(&found.mesh, &all, &truth.mesh);
        nearest.into_iter().for_each(|(own, of_truth)| ceiling[own] = truth.albedo[of_truth]);
        let factor = median_ratio(&true_albedo, &naive_colors, is_shown);
        let flat = |(c, own): (&Vec3, &Vec3)| if *c == Vec3::ZERO { *own } else { (*c * factor).min(most) };
        let naive = found.lit_color.iter().zip(&albedo).map(flat).collect();
        [("ceiling", ceiling), ("naive", naive)]
    });
    let rerender = Rerender::new(found.mesh, RERENDER_RAYS, threads);
    let arriving = rerender.bounced(&rerender.direct_found(&light, spheres, emission.as_deref()), &albedo);
    let (error, p90) = irradiance_error(&truth, &arriving, &pairs);
    put("irradiance_median", error);
    put("irradiance_p90", p90);
    let portals = portals(&truth.spec["portals"]);
    for (k, key) in VIEW_NAMES.iter().enumerate() {
        let (poses, views) = read_views(scene, k)?;
        let seen = |colors: &[Vec3]| {
            let own: Vec<View> = poses.iter().map(|pose| rerender.view(colors, &truth.camera, pose)).collect();
            psnr(&own, &views, gain_for(&views))
        };
        let reflected = |albedo: &[Vec3], light: &[Vec3]| albedo.iter().zip(light).map(|(a, l)| *a * *l).collect();
        let light = if k == 0 {
            arriving.clone()
        } else {
            let environment = read_environment(&scene.join(format!("truth/env_{key}.npy")));
            // Light gets through every gap of a scan, so that portals would miss some.
            let direct = rerender.direct(&environment, if same { &portals } else { &[] });
            for (kind, albedo) in references.iter().flatten() {
                let colors: Vec<Vec3> = reflected(albedo, &rerender.bounced(&direct, albedo));
                put(&format!("{kind}_{key}_psnr"), seen(&colors));
            }
            rerender.bounced(&direct, &albedo)
        };
        let mut colors: Vec<Vec3> = reflected(&albedo, &light);
        if let Some(emission) = emission.as_ref().filter(|_| k == 0) {
            colors.iter_mut().zip(emission).for_each(|(c, e)| *c += *e);
        }
        put(&format!("{key}_psnr"), seen(&colors));
    }
    for kind in ["ceiling", "naive"] {
        let of = |key: &str| truth.reference[kind][key].as_f64().unwrap_or(f64::NAN);
        put(&format!("{kind}_psnr"), 0.5 * (of("relight1") + of("relight2")));
        put(&format!("{kind}_original_psnr"), of("original"));
    }
    if !same {
        for kind in ["ceiling", "naive"] {
            let of = |key: &str| row[&format!("{kind}_{key}_psnr")].as_f64().unwrap_or(f64::NAN);
            let mean = 0.5 * (of("relight1") + of("relight2"));
            row.insert(format!("{kind}_psnr"), json!(mean));
        }
    }
    let of = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let relit = 0.5 * (of("relight1_psnr") + of("relight2_psnr"));
    row.insert("relit_psnr".into(), json!(relit));
    Ok(row)
}

impl Found {
    fn turn(&mut self, world: &Pose) {
        let (rotation, translation) = (world.rotation.as_quat(), world.translation.as_vec3());
        self.mesh.positions.iter_mut().for_each(|p| *p = rotation * *p + translation);
        self.mesh.normals.iter_mut().for_each(|n| *n = rotation * *n);
        self.spheres.iter_mut().for_each(|s| s.center = rotation * s.center + translation);
        for pose in &mut self.poses {
            *pose = Pose::new(world.rotation * pose.rotation, world.rotation * pose.translation + world.translation);
        }
        self.light = turned(&self.light, world.rotation);
    }
}

/// Coefficients of the light turned by a rotation: L'(ω) = L(R⁻¹ ω), by quadrature over the sphere.
fn turned(light: &[[f64; 3]], rotation: DQuat) -> Vec<[f64; 3]> {
    use crate::synth::environment::harmonics;
    let order = light.len().isqrt().saturating_sub(1);
    // A quadrature that is exact enough for products of nine bands.
    const POINTS: usize = 20_000;
    let mut out = vec![[0.0; 3]; light.len()];
    for k in 0..POINTS {
        let z = 1.0 - (2 * k + 1) as f64 / POINTS as f64;
        let (s, c) = libm::sincos(std::f64::consts::PI * (1.0 + 5f64.sqrt()) * (k as f64 + 0.5));
        let direction = DVec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z);
        let from = harmonics(order, (rotation.inverse() * direction).as_vec3());
        let value: [f64; 3] = std::array::from_fn(|c| from.iter().zip(light).map(|(y, l)| y * l[c]).sum());
        let weight = 4.0 * std::f64::consts::PI / POINTS as f64;
        for (o, y) in out.iter_mut().zip(harmonics(order, direction.as_vec3())) {
            *o = std::array::from_fn(|c| o[c] + weight * y * value[c]);
        }
    }
    out
}

/// The rigid transform that maps poses to others, by their mean rotation and position.
fn aligned(from: &[Pose], to: &[Pose]) -> Pose {
    let first = to.first().zip(from.first()).map_or(DQuat::IDENTITY, |(t, f)| t.rotation * f.rotation.inverse());
    let sum = from.iter().zip(to).fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, (f, t)| {
        let turn = t.rotation * f.rotation.inverse();
        if turn.dot(first) < 0.0 { sum - turn } else { sum + turn }
    });
    let rotation = sum.normalize();
    let shift: DVec3 = from.iter().zip(to).map(|(f, t)| t.translation - rotation * f.translation).sum();
    Pose::new(rotation, shift / from.len().max(1) as f64)
}

/// Mean errors in millimetres and degrees.
fn pose_error(found: &[Pose], truth: &[Pose]) -> (f64, f64) {
    let count = found.len().min(truth.len()).max(1) as f64;
    let pairs = || found.iter().zip(truth);
    let mm: f64 = pairs().map(|(f, t)| 1e3 * f.translation.distance(t.translation)).sum();
    let deg: f64 = pairs().map(|(f, t)| f.rotation.angle_between(t.rotation).to_degrees()).sum();
    (mm / count, deg / count)
}

/// Mean over the keyframes of the median shift of the surface's image, pixels.
fn pixel_error(truth: &Truth, found: &[Pose]) -> f64 {
    const EVERY: usize = 7;
    let shifts = metrics::pixel_shifts(&truth.camera, &truth.mesh.positions, EVERY, found, &truth.poses);
    let shifts: Vec<f64> = shifts.into_iter().filter(|x| x.is_finite()).collect();
    shifts.iter().sum::<f64>() / shifts.len().max(1) as f64
}

/// RMS of the log gains after one factor, and the same if all gains were alike.
fn exposure_error(found: &[f64], truth: &[f64]) -> (f64, f64) {
    let differences: Vec<f64> = found.iter().zip(truth).map(|(f, t)| f - t).collect();
    (metrics::rms_about_median(&differences), metrics::rms_about_median(truth))
}

/// Relative error of the coefficients after one factor a channel.
fn light_error(found: &[[f64; 3]], truth: &[[f64; 3]]) -> f64 {
    let count = found.len().max(JUDGED_TERMS).min(truth.len());
    let (mut error, mut size) = (0.0, 0.0);
    for c in 0..3 {
        let f = |k: usize| found.get(k).map_or(0.0, |f| f[c]);
        let both: f64 = (0..count).map(|k| f(k) * truth[k][c]).sum();
        let own: f64 = (0..count).map(|k| f(k) * f(k)).sum();
        let scale = both / own.max(1e-20);
        error += (0..count).map(|k| (f(k) * scale - truth[k][c]).powi(2)).sum::<f64>();
        size += (0..count).map(|k| truth[k][c] * truth[k][c]).sum::<f64>();
    }
    (error / size).sqrt()
}

/// Median relative error of the irradiance at the vertices with a reference transfer.
fn visible_irradiance(scene: &Path, found: &[[f64; 3]], truth: &[[f64; 3]]) -> f64 {
    let transfer = Array::read(&scene.join("truth/transfer/T_gi.npy")).expect("an array");
    metrics::scene_irradiance(&transfer.data, found, truth).0
}

/// For vertices of one mesh the nearest of another with an agreeing normal.
fn matched(mesh: &Mesh, of: &[usize], other: &Mesh) -> Vec<(usize, usize)> {
    let mut edge = vec![0.0f32; mesh.positions.len()];
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let length = mesh.positions[a as usize].distance(mesh.positions[b as usize]);
            for i in [a, b] {
                edge[i as usize] = edge[i as usize].max(length);
            }
        }
    }
    let limit = |i: usize| MATCH_M.max(MATCH_EDGES * edge[i]);
    let cell = of.iter().map(|&i| limit(i)).fold(MATCH_M, f32::max);
    let others = Vertices::new(other, cell);
    let nearest = |&i: &usize| {
        let p = mesh.positions[i];
        let best = others.nearest(p, mesh.normals[i])?;
        (p.distance(other.positions[best]) < limit(i)).then_some((i, best))
    };
    of.iter().filter_map(nearest).collect()
}

/// Median and 90th percentile of the relative error of irradiance at the truth's vertices, one factor a channel; emitting
/// and the darkest vertices left out.
fn irradiance_error(truth: &Truth, arriving: &[Vec3], pairs: &[(usize, usize)]) -> (f64, f64) {
    let own: Vec<Vec3> =
        pairs.iter().map(|p| truth.lit_color[p.0] / truth.albedo[p.0].max(Vec3::splat(1e-3))).collect();
    let level = |v: &Vec3| v.element_sum() / 3.0;
    let mean = own.iter().map(level).sum::<f32>() / own.len().max(1) as f32;
    let used: Vec<usize> =
        (0..pairs.len()).filter(|&k| level(&own[k]) > DARKEST * mean && !truth.emitting[pairs[k].0]).collect();
    let t: Vec<Vec3> = used.iter().map(|&k| own[k]).collect();
    let f: Vec<Vec3> = used.iter().map(|&k| arriving[pairs[k].1]).collect();
    let scale = median_ratio(&t, &f, |_| true);
    let relative: Vec<f64> =
        t.iter().zip(&f).flat_map(|(t, f)| (*f * scale / *t - 1.0).abs().to_array()).map(f64::from).collect();
    (median(&relative), percentile(&relative, 0.9))
}

fn portals(value: &Value) -> Vec<Portal> {
    #[derive(serde::Deserialize)]
    struct Row {
        corner: Vec3,
        edges: [Vec3; 2],
    }
    let rows: Vec<Row> = serde_json::from_value(value.clone()).unwrap_or_default();
    rows.into_iter().map(|r| Portal { corner: r.corner, edges: r.edges }).collect()
}

/// Poses and true pictures of the held-out views under a light.
fn read_views(scene: &Path, light: usize) -> Fallible<(Vec<Pose>, Vec<View>)> {
    let folder = scene.join("truth/heldout");
    let document = read_json(&folder.join("views.json"))?.ok_or("no held-out views")?;
    let frames = document["frames"].as_array().ok_or("no held-out views")?;
    let (mut poses, mut views) = (Vec::new(), Vec::new());
    for (j, frame) in frames.iter().enumerate() {
        poses.push(pose(&frame["camera_to_world"]).ok_or("a pose is no rigid transform")?);
        let mask = read_mask(&folder.join(format!("{j:03}_mask.png")))?;
        let data = vectors(&folder.join(format!("{j:03}_{}.npy", VIEW_NAMES[light])));
        views.push(data.into_iter().zip(mask).map(|(v, m)| m.then_some(v)).collect());
    }
    Ok((poses, views))
}
