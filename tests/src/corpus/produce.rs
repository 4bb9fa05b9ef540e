//! A seed's scene, rendered and written in the layout of the shared truth scenes.

use super::cameras::{PHOTO_PERIOD_S, Way, with_error};
use super::files::{
    matrix, pose, write_bytes, write_floats, write_json, write_mask, write_mesh, write_picture, write_vectors,
};
use super::plan::{Detail, Plan};
use super::rerender::{Rerender, View, gain_for, psnr};
use super::stage::Stage;
use crate::metrics;
use crate::synth::emitters::Emitters;
use crate::synth::environment::{Environment, harmonics};
use crate::synth::exchange::{Exchange, Light, Lit};
use crate::synth::kinect::Kinect;
use crate::synth::material::cosine_direction;
use crate::synth::parallel;
use crate::synth::random::Rng;
use crate::synth::render::{self, Exposure, Shading};
use crate::synth::scene::Scene;
use glam::{DMat4, DVec4, Vec3};
use recordings::format_seconds;
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::types::{ColorEncoding, ColorFrame, Intrinsics, Pose, RgbImage};
use serde_json::{Value, json};
use std::error::Error;
use std::path::{Path, PathBuf};

/// Scenes of another version are made anew.
pub const VERSION: u32 = 2;

/// Order of the light's coefficients.
const ORDER: usize = 8;
/// Order at which the ceiling cuts the light.
const CEILING_ORDER: usize = 4;
/// Vertices with a reference transfer, paths for each, and bounces.
const TRANSFER_VERTICES: usize = 60;
const TRANSFER_PATHS: usize = 2048;
const TRANSFER_BOUNCES: usize = 12;
/// Cosine of incidence below which a view of a vertex does not count.
const SEEN_COSINE: f32 = 0.1;
/// `w_s` from which on a material counts as glossy.
const GLOSSY: f32 = 0.02;
/// Rays a vertex in [`Rerender`].
pub const RERENDER_RAYS: usize = 196;
/// Albedos above it are cut where light is bounced by them.
pub const MOST_ALBEDO: f32 = 0.98;
const JPEG_QUALITY: u8 = 92;

/// The folder of a seed's scene below `cache`, rendered if it is not there yet.
///
/// # Errors
/// A file cannot be written.
pub fn scene_folder(cache: &Path, seed: u64, detail: &Detail, threads: usize) -> Result<PathBuf, Box<dyn Error>> {
    let small = if *detail == Detail::FULL { "" } else { "-small" };
    let folder = cache.join(format!("{seed}-{VERSION}{small}"));
    if !folder.join("truth/spec.json").is_file() {
        let staging = cache.join(format!("{seed}-{VERSION}{small}.{}.part", std::process::id()));
        produce(&staging, &Plan::new(seed), detail, threads)?;
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::rename(&staging, &folder)?;
    }
    Ok(folder)
}

/// Renders and writes a scene.
///
/// # Errors
/// A file cannot be written.
pub fn produce(folder: &Path, plan: &Plan, detail: &Detail, threads: usize) -> Result<(), Box<dyn Error>> {
    let truth = folder.join("truth");
    for sub in ["keyframes", "truth/heldout", "truth/transfer"] {
        std::fs::create_dir_all(folder.join(sub))?;
    }
    let mut rng = Rng::new(plan.seed, 3);
    let stage = Stage::new(plan);
    let scene = stage.scene(rng.between(detail.vertices[0], detail.vertices[1]));
    let exchange = Exchange::trace(&scene, detail.rays, Rng::family(plan.seed, 4), threads);
    let dark = Emitters::default();
    let lights: Vec<Light> = (0..3)
        .map(|k| Light {
            environment: &stage.environments[k],
            emitters: if k == 0 { &scene.emitters } else { &dark },
            portals: &stage.portals,
        })
        .collect();
    let arriving: Vec<Vec<Vec3>> = lights
        .iter()
        .enumerate()
        .map(|(k, light)| exchange.solve(&exchange.direct(&scene, light, Rng::family(plan.seed, 5 + k as u64))))
        .collect();
    let origins = exchange.origins().to_vec();
    drop(exchange);
    let lit = |k: usize| Lit { light: lights[k], arriving: &arriving[k], emission: k == 0 };

    // Photographs, and the camera behind them.
    let count = detail.keyframes[0] + rng.below(detail.keyframes[1] - detail.keyframes[0] + 1);
    let way = Way::of_photos(stage.views, count);
    let mut kinect = camera(&stage, plan, detail, &mut rng, threads);
    let recording_kinect = kinect.clone();
    // The exposure has settled by the next photograph.
    kinect.color.response = 0.8;
    let original = lit(0);
    let poses: Vec<Pose> = (0..count).map(|k| way.pose(k as f64 * PHOTO_PERIOD_S)).collect();
    let given: Vec<Pose> = poses.iter().map(|p| with_error(p, &mut rng)).collect();
    let mut gains = Vec::new();
    for k in 0..count {
        let time_s = k as f64 * PHOTO_PERIOD_S;
        let (picture, gain) = kinect.photo(&scene, Shading::Lit(&original), k as u32, time_s, &|t| way.pose(t));
        write_picture(&folder.join(name(k)), &picture)?;
        gains.push((gain, clipped_share(&picture)));
    }
    write_mesh(&folder.join("mesh.ply"), &scene.mesh)?;
    write_cameras(folder, &kinect.camera, &poses, &given)?;
    let exposures = json!({
        "definition": "8-bit value = round(255*sRGB(clip(gain*white_balance*vignetting*(radiance + veil) + noise)))",
        "gain": gains.iter().map(|(g, _)| g.gain).collect::<Vec<_>>(),
        "white_balance": gains.iter().map(|(g, _)| g.white_balance.to_array()).collect::<Vec<_>>(),
        "clipped_fraction": gains.iter().map(|(_, c)| c).collect::<Vec<_>>(),
    });
    write_json(&truth.join("exposures.json"), &exposures)?;

    // What is true of the surface and of the light.
    let albedo = seen_albedo(&scene, &kinect.camera, &poses);
    let lit_color: Vec<Vec3> = albedo.iter().zip(&arriving[0]).map(|(a, l)| *a * *l).collect();
    let seen = seen_count(&scene, &kinect.camera, &poses, threads);
    let material = materials(&stage, &scene, &albedo, &truth)?;
    write_vectors(&truth.join("albedo.npy"), &[albedo.len()], &albedo)?;
    write_vectors(&truth.join("lit_color.npy"), &[lit_color.len()], &lit_color)?;
    write_bytes(&truth.join("seen_count.npy"), &seen)?;
    let emission: Vec<Vec3> = scene.part_of_vertex.iter().map(|&k| scene.emission[usize::from(k)]).collect();
    if scene.emitters.count() > 0 {
        let spheres = stage.spheres.iter().map(
            |s| json!({ "center": s.center.to_array(), "radius_m": s.radius_m, "radiance": s.radiance.to_array() }),
        );
        write_json(&truth.join("emitters.json"), &json!({ "spheres": spheres.collect::<Vec<_>>() }))?;
        write_vectors(&truth.join("emission.npy"), &[emission.len()], &emission)?;
    }
    let coefficients = write_light(&stage, &truth)?;
    write_transfer(&scene, &origins, &albedo, &seen, &mut rng, &truth, threads)?;

    // Held-out views.
    let (camera, poses) = (kinect.camera, way.held_out(&mut rng));
    let mut views: Vec<Vec<View>> = Vec::new();
    for k in 0..3 {
        let lit = lit(k);
        let taken = poses.iter().enumerate().map(|(j, pose)| {
            let seed = Rng::family(plan.seed, 100 + 10 * k as u64 + j as u64);
            let exposure = Exposure { seed, ..Exposure::still(*pose, detail.samples, threads) };
            let picture = render::color(&scene, Shading::Lit(&lit), &camera, &exposure).data;
            let mask = mask(&scene, &camera, pose, threads);
            picture.into_iter().zip(mask).map(|(v, m)| m.then_some(v)).collect()
        });
        views.push(taken.collect());
    }
    write_views(&truth.join("heldout"), &camera, &poses, &views)?;

    // The ceiling, and what lit colours taken as albedo reach: neither depends on the estimator.
    let used = |i: usize| seen[i] >= 2;
    let wide = |values: &[Vec3]| values.iter().map(|v| v.to_array().map(f64::from)).collect::<Vec<_>>();
    let naive = metrics::albedo(&wide(&lit_color), &wide(&albedo), &material, used);
    let rerender = Rerender::new(scene.mesh.clone(), RERENDER_RAYS, threads);
    let cut = &coefficients[..(CEILING_ORDER + 1) * (CEILING_ORDER + 1)];
    let scale = median_ratio(&albedo, &lit_color, used);
    let flat: Vec<Vec3> = lit_color.iter().map(|c| *c * scale).collect();
    let found = rerender.direct_found(cut, stage.spheres.clone(), Some(&emission));
    let even = rerender.direct_found(&coefficients[..1], vec![], None);
    let mut reference = serde_json::Map::new();
    for (key, albedo, original, glow) in [("ceiling", &albedo, &found, true), ("naive", &flat, &even, false)] {
        let albedo: Vec<Vec3> = albedo.iter().map(|a| a.min(Vec3::splat(MOST_ALBEDO))).collect();
        let mut row = serde_json::Map::new();
        for (k, truth) in views.iter().enumerate() {
            let direct =
                if k == 0 { original.clone() } else { rerender.direct(&stage.environments[k], &stage.portals) };
            let light = rerender.bounced(&direct, &albedo);
            let own = |i: usize| if glow && k == 0 { emission[i] } else { Vec3::ZERO };
            let colors: Vec<Vec3> = (0..albedo.len()).map(|i| albedo[i] * light[i] + own(i)).collect();
            let found: Vec<View> = poses.iter().map(|pose| rerender.view(&colors, &camera, pose)).collect();
            row.insert(VIEW_NAMES[k].into(), json!(psnr(&found, truth, gain_for(truth))));
        }
        reference.insert(key.into(), Value::Object(row));
    }
    reference.insert("naive_albedo".into(), json!({ "median": naive.median, "p90": naive.p90 }));
    write_json(&truth.join("reference.json"), &Value::Object(reference))?;

    if plan.recorded && detail.frames > 0 {
        record(folder, &truth, recording_kinect, &scene, &original, &stage, detail)?;
    }
    let portals: Vec<Value> = stage
        .portals
        .iter()
        .map(|p| json!({ "corner": p.corner.to_array(), "edges": p.edges.map(|e| e.to_array()) }))
        .collect();
    let spec = json!({
        "seed": plan.seed, "light": plan.light.name(), "support": format!("{:?}", plan.support).to_lowercase(),
        "panorama": stage.panorama, "recorded": plan.recorded && detail.frames > 0, "portals": portals,
        "vertices": scene.mesh.positions.len(), "keyframes": count, "materials": stage.pigments.len(),
        "bodies": stage.bodies.iter().map(|b| b.name).collect::<Vec<_>>(),
        "glare": stage.glare.share, "spheres": stage.spheres.len(), "width": camera.width, "height": camera.height,
    });
    Ok(write_json(&truth.join("spec.json"), &spec)?)
}

/// Names of the held-out views' lights.
pub const VIEW_NAMES: [&str; 3] = ["original", "relight1", "relight2"];

fn name(k: usize) -> String {
    format!("keyframes/{k:03}.png")
}

fn camera(stage: &Stage, plan: &Plan, detail: &Detail, rng: &mut Rng, threads: usize) -> Kinect {
    let mut kinect = Kinect::new(detail.divide, Rng::family(plan.seed, 9), threads);
    kinect.samples = detail.samples;
    kinect.shutter_s = f64::from(rng.between(0.004, 0.020));
    kinect.readout_s = f64::from(rng.between(0.010, 0.026));
    kinect.glare = Some(stage.glare);
    kinect.color.target_mean = rng.between(0.16, 0.26);
    kinect.color.full_well_e = rng.between(2500.0, 8000.0);
    kinect.color.read_noise = rng.between(0.001, 0.0025);
    kinect.color.hunting = rng.between(0.03, 0.15);
    kinect.color.drift = rng.between(0.0, 0.03);
    kinect.color.balancing = rng.between(0.6, 0.95);
    kinect.color.most_clipped = 0.06;
    kinect.color.relative_range = [0.3, 3.0];
    kinect.color.vignetting = rng.between(0.0, 0.12);
    kinect
}

fn clipped_share(picture: &RgbImage) -> f64 {
    let clipped = picture.data.chunks_exact(3).filter(|c| c.contains(&255)).count();
    clipped as f64 / (picture.data.len() / 3).max(1) as f64
}

fn write_cameras(folder: &Path, camera: &Intrinsics, poses: &[Pose], given: &[Pose]) -> std::io::Result<()> {
    let time_s = |k: usize| k as f64 * PHOTO_PERIOD_S;
    let frames = |poses: &[Pose]| -> Vec<Value> {
        let frame = |(k, p)| json!({ "file": name(k), "time_s": time_s(k), "camera_to_world": matrix(p) });
        poses.iter().enumerate().map(frame).collect()
    };
    write_json(&folder.join("keyframes.json"), &json!({ "intrinsics": camera, "frames": frames(given) }))?;
    write_json(&folder.join("truth/poses.json"), &json!({ "frames": frames(poses) }))?;
    let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    let nerf = |(k, p): (usize, &Pose)| {
        let m = (DMat4::from_rotation_translation(p.rotation, p.translation) * flip).transpose().to_cols_array_2d();
        json!({ "file_path": name(k), "time_s": time_s(k), "transform_matrix": m })
    };
    let transforms = json!({
        "camera_model": "PINHOLE", "w": camera.width, "h": camera.height,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "frames": given.iter().enumerate().map(nerf).collect::<Vec<_>>(),
    });
    write_json(&folder.join("transforms.json"), &transforms)
}

/// `material_id.npy` and `materials.json`; returns the ids.
fn materials(stage: &Stage, scene: &Scene, albedo: &[Vec3], truth: &Path) -> std::io::Result<Vec<u32>> {
    let id: Vec<u8> = scene
        .mesh
        .positions
        .iter()
        .zip(&scene.part_of_vertex)
        .map(|(p, &body)| stage.label(usize::from(body), *p))
        .collect();
    write_bytes(&truth.join("material_id.npy"), &id)?;
    let row = |(k, pigment): (usize, &super::paint::Pigment)| {
        let own: Vec<Vec3> = id.iter().zip(albedo).filter(|(i, _)| usize::from(**i) == k).map(|(_, a)| *a).collect();
        let mean = own.iter().sum::<Vec3>() / own.len().max(1) as f32;
        let material = pigment.material;
        json!({
            "id": k, "name": format!("{:?}", pigment.pattern).to_lowercase(), "w_d": 1.0, "w_d_of_base_color": 1.0 - material.w_s,
            "w_s": material.w_s, "alpha": material.alpha, "glossy": material.w_s >= GLOSSY, "vertices": own.len(),
            "mean_albedo": mean.to_array(),
        })
    };
    let rows: Vec<Value> = stage.pigments.iter().enumerate().map(row).collect();
    write_json(&truth.join("materials.json"), &json!({ "materials": rows }))?;
    Ok(id.into_iter().map(u32::from).collect())
}

/// `env*.npy` and `lighting_sh.json`; returns the coefficients of the light.
fn write_light(stage: &Stage, truth: &Path) -> std::io::Result<Vec<[f64; 3]>> {
    let mut document = serde_json::Map::new();
    document.insert("order".into(), json!(ORDER));
    let mut first = Vec::new();
    for (k, environment) in stage.environments.iter().enumerate() {
        let (file, key) =
            [("env.npy", "lighting"), ("env_relight1.npy", "relight1"), ("env_relight2.npy", "relight2")][k];
        let (rows, map) = environment.map();
        write_vectors(&truth.join(file), &[rows, 2 * rows], map)?;
        let coefficients = environment.spherical_harmonics(ORDER);
        document.insert(key.into(), json!(coefficients));
        if k == 0 {
            first = coefficients;
        }
    }
    write_json(&truth.join("lighting_sh.json"), &Value::Object(document))?;
    Ok(first)
}

/// Diffuse albedo at the vertices as photographs can show it: the mean over a disc of a pixel's size, at the mean distance.
/// Samples of a print at points would differ from any picture of it.
fn seen_albedo(scene: &Scene, camera: &Intrinsics, poses: &[Pose]) -> Vec<Vec3> {
    const POINTS: usize = 24;
    let eyes: Vec<Vec3> = poses.iter().map(|p| p.translation.as_vec3()).collect();
    let of = |i: usize| {
        let (p, normal) = (scene.mesh.positions[i], scene.mesh.normals[i]);
        let part = &scene.parts[usize::from(scene.part_of_vertex[i])];
        let (t, b) = normal.any_orthonormal_pair();
        let distance = eyes.iter().map(|e| e.distance(p)).sum::<f32>() / eyes.len().max(1) as f32;
        let radius = distance / camera.fx as f32;
        let sum: Vec3 = (0..POINTS)
            .map(|k| {
                let (s, c) = libm::sincosf(2.399_963_1 * k as f32);
                let r = radius * ((k as f32 + 0.5) / POINTS as f32).sqrt();
                (part.texture)(p + (t * c + b * s) * r)
            })
            .sum();
        sum * ((1.0 - part.material.w_s) / POINTS as f32)
    };
    (0..scene.mesh.positions.len()).map(of).collect()
}

/// Number of keyframes that see each vertex.
fn seen_count(scene: &Scene, camera: &Intrinsics, poses: &[Pose], threads: usize) -> Vec<u8> {
    let mesh = &scene.mesh;
    parallel::map(mesh.positions.len(), 256, threads, |i| {
        let (p, n) = (mesh.positions[i], mesh.normals[i]);
        let sees = |pose: &&Pose| {
            let q = pose.rotation.conjugate() * (p.as_dvec3() - pose.translation);
            let (x, y) = (camera.fx * q.x / q.z + camera.cx, camera.fy * q.y / q.z + camera.cy);
            let inside = q.z > 0.05
                && (0.0..=f64::from(camera.width - 1)).contains(&x)
                && (0.0..=f64::from(camera.height - 1)).contains(&y);
            let eye = pose.translation.as_vec3();
            inside && n.dot((eye - p).normalize()) > SEEN_COSINE && !scene.blocked(p, n, eye)
        };
        poses.iter().filter(sees).count() as u8
    })
}

/// True where all of a pixel lies on the mesh.
fn mask(scene: &Scene, camera: &Intrinsics, pose: &Pose, threads: usize) -> Vec<bool> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let (origin, turn) = (pose.translation.as_vec3(), pose.rotation.as_quat());
    parallel::map(width * height, width, threads, |k| {
        [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.0, 0.0)].iter().all(|(dx, dy)| {
            let pixel = [(k % width) as f32 + dx, (k / width) as f32 + dy];
            let direction = (turn * render::ray(camera, pixel)).normalize();
            let limit = scene.emitters.along(origin, direction).map_or(f32::INFINITY, |(distance, _)| distance);
            scene.distance(origin, direction).is_some_and(|d| d < limit)
        })
    })
}

fn write_views(folder: &Path, camera: &Intrinsics, poses: &[Pose], views: &[Vec<View>]) -> std::io::Result<()> {
    let size = [camera.width, camera.height];
    let shape = [camera.height as usize, camera.width as usize];
    let mut frames = Vec::new();
    for (j, pose) in poses.iter().enumerate() {
        let file = |key: &str| format!("{j:03}_{key}.npy");
        for (k, key) in VIEW_NAMES.iter().enumerate() {
            let data: Vec<Vec3> = views[k][j].iter().map(|v| v.unwrap_or_default()).collect();
            write_vectors(&folder.join(file(key)), &shape, &data)?;
        }
        let mask: Vec<bool> = views[0][j].iter().map(Option::is_some).collect();
        write_mask(&folder.join(format!("{j:03}_mask.png")), size, &mask)?;
        frames.push(json!({
            "camera_to_world": matrix(pose), "mask": format!("{j:03}_mask.png"), "original": file(VIEW_NAMES[0]),
            "relight": [file(VIEW_NAMES[1]), file(VIEW_NAMES[2])],
        }));
    }
    let document = json!({ "intrinsics": camera, "view_gain": gain_for(&views[0]), "frames": frames });
    write_json(&folder.join("views.json"), &document)
}

/// Reference transfer with interreflection at random seen vertices, by paths: `T_gi.npy`, `vertex_index.npy`.
fn write_transfer(
    scene: &Scene,
    origins: &[Vec3],
    albedo: &[Vec3],
    seen: &[u8],
    rng: &mut Rng,
    truth: &Path,
    threads: usize,
) -> std::io::Result<()> {
    let candidates: Vec<usize> = (0..seen.len()).filter(|&i| seen[i] >= 2).collect();
    let chosen: Vec<usize> = (0..TRANSFER_VERTICES).map(|_| candidates[rng.below(candidates.len())]).collect();
    let seed = Rng::family(rng.below(1 << 20) as u64, 7);
    let terms = (ORDER + 1) * (ORDER + 1);
    let transfer = parallel::map(chosen.len(), 1, threads, |k| {
        let mut rng = Rng::new(seed, k as u64);
        let mut sum = vec![[0.0f64; 3]; terms];
        for _ in 0..TRANSFER_PATHS {
            let (mut position, mut normal) = (origins[chosen[k]], scene.mesh.normals[chosen[k]]);
            let (mut facet, mut throughput) = (normal, Vec3::ONE);
            for _ in 0..=TRANSFER_BOUNCES {
                let direction = cosine_direction(normal, [rng.uniform(), rng.uniform()]);
                if facet.dot(direction) <= 0.0 {
                    break;
                }
                let Some(next) = scene.next(position, facet, direction) else {
                    for (s, y) in sum.iter_mut().zip(harmonics(ORDER, direction)) {
                        *s = std::array::from_fn(|c| s[c] + y * f64::from(throughput[c]) / TRANSFER_PATHS as f64);
                    }
                    break;
                };
                if !next.outside {
                    break;
                }
                throughput *=
                    next.vertices.iter().zip(next.weights).map(|(&i, w)| albedo[i as usize] * w).sum::<Vec3>();
                (position, normal, facet) = (next.position, next.normal, next.facet);
            }
        }
        sum
    });
    let folder = truth.join("transfer");
    let values = transfer.iter().flatten().flatten().map(|x| *x as f32);
    write_floats(&folder.join("T_gi.npy"), &[chosen.len(), terms, 3], values)?;
    let index =
        super::files::array("<i4", &[chosen.len()], chosen.iter().flat_map(|&i| (i as i32).to_le_bytes()).collect());
    std::fs::write(folder.join("vertex_index.npy"), index)
}

/// Median over used vertices of `truth / found`, by channel.
pub(super) fn median_ratio(truth: &[Vec3], found: &[Vec3], used: impl Fn(usize) -> bool) -> Vec3 {
    let channel = |c: usize| {
        let ratio = |i: usize| f64::from(truth[i][c]) / f64::from(found[i][c]).max(1e-6);
        metrics::median(&(0..truth.len()).filter(|&i| used(i)).map(ratio).collect::<Vec<_>>()) as f32
    };
    Vec3::new(channel(0), channel(1), channel(2))
}

/// `recording.lrec`, `recording/` for the scorer, and `truth/recording.json` with the true poses by time stamp.
fn record(
    folder: &Path,
    truth: &Path,
    mut kinect: Kinect,
    scene: &Scene,
    lit: &Lit,
    stage: &Stage,
    detail: &Detail,
) -> Result<(), Box<dyn Error>> {
    let way = Way::of_recording(stage.views, f64::from(detail.frames) * kinect.period_ns as f64 * 1e-9);
    let path = folder.join("recording.lrec");
    let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &kinect.sensor())?;
    let mut frames = Vec::new();
    // Half the rays of a photograph: its neighbours are alike.
    kinect.samples = detail.samples.div_ceil(2);
    for index in 0..detail.frames {
        let frame = kinect.frame(scene, Shading::Lit(lit), index, &|t| way.pose(t));
        let mut bytes = Vec::new();
        let size = (u16::try_from(frame.rgb.width)?, u16::try_from(frame.rgb.height)?);
        let encoder = jpeg_encoder::Encoder::new(&mut bytes, JPEG_QUALITY);
        encoder.encode(&frame.rgb.data, size.0, size.1, jpeg_encoder::ColorType::Rgb)?;
        writer.write(&Event::Color(ColorFrame {
            timestamp_ns: frame.color_timestamp_ns,
            width: frame.rgb.width,
            height: frame.rgb.height,
            encoding: ColorEncoding::Jpeg,
            bytes,
            missing_packets: 0,
        }))?;
        writer.write(&Event::Accelerometer(frame.accelerometer))?;
        writer.write(&Event::Depth(frame.depth))?;
        frames.push(json!({
            "timestamp_ns": frame.color_timestamp_ns, "camera_to_world": matrix(&frame.world_from_camera),
            "gain": frame.gain.gain,
        }));
    }
    writer.finish()?;
    write_trajectory(&folder.join("recording"), &frames)?;
    Ok(write_json(&truth.join("recording.json"), &json!({ "frames": frames }))?)
}

/// What the independent scorer reads of a recording (`--rgbd`): `rgb.txt`, `groundtruth.txt`, `truth/exposures.json`.
fn write_trajectory(folder: &Path, frames: &[Value]) -> std::io::Result<()> {
    let (mut names, mut poses) = (String::new(), String::new());
    for frame in frames {
        let time_s = format_seconds(frame["timestamp_ns"].as_i64().unwrap_or(0));
        let pose = pose(&frame["camera_to_world"]).unwrap_or(Pose::IDENTITY);
        let (t, q) = (pose.translation, pose.rotation);
        names += &format!("{time_s} -\n");
        poses += &format!("{time_s} {} {} {} {} {} {} {}\n", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    std::fs::create_dir_all(folder.join("truth"))?;
    std::fs::write(folder.join("rgb.txt"), names)?;
    std::fs::write(folder.join("groundtruth.txt"), poses)?;
    let gains: Vec<&Value> = frames.iter().map(|f| &f["gain"]).collect();
    write_json(&folder.join("truth/exposures.json"), &json!({ "gain": gains }))
}

/// A light of a scene folder: the map as it was written.
///
/// # Panics
/// The file is missing or damaged.
#[must_use]
pub fn read_environment(path: &Path) -> Environment {
    let array = recordings::import::npy::Array::read(path).expect("an array");
    Environment::from_map(array.rgb().iter().map(|c| Vec3::from(c.map(|x| x as f32))).collect())
}
