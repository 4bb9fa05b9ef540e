//! Makes the bundled data: `cargo run --release -p tests --example synthesise -- recordings/data`.
//!
//! Writes `tabletop.lrec`, `tiny.lrec` and `tabletop_truth/` into the folder given. The same bytes come out on any
//! number of threads.

use glam::Vec3;
use recordings::import::trajectory::format_trajectory;
use recordings::ply::write::{Column, write_ply};
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::types::{ColorEncoding, ColorFrame, RgbImage, TimestampNs};
use serde_json::json;
use std::error::Error;
use std::io::{BufWriter, Write};
use std::path::Path;
use tests::synth::kinect::{Frame, Kinect};
use tests::synth::render::Shading;
use tests::synth::scene::{Part, Scene};
use tests::synth::{cache, tabletop};

const CELL_M: f32 = 0.0025;
const TRUTH_CELL_M: f32 = 0.008;
const DIFFUSE_SAMPLES: usize = 640;
const SAMPLES: usize = 12;
const JPEG_QUALITY: u8 = 88;
const TINY_FRAMES: u32 = 6;
const SEED: u64 = 2016;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).ok_or("usage: synthesise FOLDER")?;
    let folder = Path::new(&folder);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);

    let scene = tabletop::tabletop(CELL_M);
    eprintln!("diffuse light at {} vertices", scene.mesh.positions.len());
    let light = cache::diffuse_light(&scene, DIFFUSE_SAMPLES, SEED, threads);

    std::fs::create_dir_all(folder)?;
    let mut kinect = Kinect::new(1, SEED, threads);
    kinect.samples = SAMPLES;
    let frames = record(&folder.join("tabletop.lrec"), &mut kinect, &scene, Shading::Cached(&light), tabletop::FRAMES)?;
    let mut small = Kinect::new(4, SEED, threads);
    small.samples = 4 * SAMPLES;
    record(&folder.join("tiny.lrec"), &mut small, &scene, Shading::Cached(&light), TINY_FRAMES)?;
    write_truth(&folder.join("tabletop_truth"), &scene, &light, &frames, threads)
}

fn record(
    path: &Path,
    kinect: &mut Kinect,
    scene: &Scene,
    shading: Shading,
    count: u32,
) -> Result<Vec<Frame>, Box<dyn Error>> {
    let arc = tabletop::arc();
    let mut writer = RecordingWriter::create(path, RecordingKind::Frames, &kinect.sensor())?;
    let mut taken = Vec::new();
    for index in 0..count {
        let mut frame = kinect.frame(scene, shading, index, &|time_s| arc.pose(time_s));
        writer.write(&Event::Color(jpeg(&frame.rgb, frame.color_timestamp_ns)?))?;
        writer.write(&Event::Accelerometer(frame.accelerometer))?;
        writer.write(&Event::Depth(std::mem::take(&mut frame.depth)))?;
        frame.rgb = RgbImage::default();
        taken.push(frame);
        eprintln!("{}: frame {} of {count}", path.display(), index + 1);
    }
    writer.finish()?;
    Ok(taken)
}

fn jpeg(rgb: &RgbImage, timestamp_ns: TimestampNs) -> Result<ColorFrame, Box<dyn Error>> {
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, JPEG_QUALITY);
    let size = (u16::try_from(rgb.width)?, u16::try_from(rgb.height)?);
    encoder.encode(&rgb.data, size.0, size.1, jpeg_encoder::ColorType::Rgb)?;
    let (width, height) = (rgb.width, rgb.height);
    Ok(ColorFrame { timestamp_ns, width, height, encoding: ColorEncoding::Jpeg, bytes, missing_packets: 0 })
}

fn write_truth(
    folder: &Path,
    scene: &Scene,
    light: &[Vec3],
    taken: &[Frame],
    threads: usize,
) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let trajectory: Vec<_> = taken.iter().map(|f| (f.color_timestamp_ns, f.world_from_camera)).collect();
    std::fs::write(folder.join("trajectory.txt"), format_trajectory(&trajectory))?;
    write_json(&folder.join("exposures.json"), &exposures(taken))?;
    let coefficients = scene.environment.spherical_harmonics(8);
    write_json(&folder.join("lighting_sh.json"), &json!({ "coefficients": coefficients }))?;

    let mut coarse = tabletop::tabletop(TRUTH_CELL_M);
    let light = cache::gathered_light(
        scene,
        light,
        &coarse.mesh.positions,
        &coarse.mesh.normals,
        DIFFUSE_SAMPLES,
        SEED + 1,
        threads,
    );
    // What no light reaches lies within other objects.
    let light = drop_vertices(&mut coarse, light, |light| light == Vec3::ZERO);
    write_json(&folder.join("materials.json"), &materials(&coarse))?;
    write_mesh(&folder.join("mesh.ply"), &coarse, &light)
}

fn exposures(taken: &[Frame]) -> serde_json::Value {
    json!({
        "timestamp": taken.iter().map(|f| f.color_timestamp_ns as f64 * 1e-9).collect::<Vec<_>>(),
        "gain": taken.iter().map(|f| rounded(f.gain.gain)).collect::<Vec<_>>(),
        "white_balance": taken.iter().map(|f| f.gain.white_balance.to_array().map(rounded)).collect::<Vec<_>>(),
    })
}

fn materials(scene: &Scene) -> serde_json::Value {
    let albedo = scene.albedo();
    let material = |(id, part): (usize, &Part)| {
        let own = albedo.iter().zip(&scene.part_of_vertex).filter(|(_, k)| usize::from(**k) == id);
        let (sum, count) = own.fold((Vec3::ZERO, 0u32), |(sum, n), (a, _)| (sum + a, n + 1));
        let mean = (sum / count.max(1) as f32).to_array().map(rounded);
        json!({ "id": id, "name": part.name, "w_s": rounded(part.material.w_s), "alpha": rounded(part.material.alpha),
            "w_d": 1.0, "mean_albedo": mean, "vertices": count })
    };
    json!({ "materials": scene.parts.iter().enumerate().map(material).collect::<Vec<_>>() })
}

/// The mesh with albedo, lit colour (albedo × `light`) and material of every vertex.
fn write_mesh(path: &Path, scene: &Scene, light: &[Vec3]) -> Result<(), Box<dyn Error>> {
    let albedo = scene.albedo();
    let lit: Vec<Vec3> = albedo.iter().zip(light).map(|(a, l)| *a * *l).collect();
    let material: Vec<u8> = scene.part_of_vertex.iter().map(|k| u8::try_from(*k)).collect::<Result<_, _>>()?;
    let columns = [
        (&["albedo_r", "albedo_g", "albedo_b"][..], Column::Floats(&albedo)),
        (&["lit_r", "lit_g", "lit_b"], Column::Floats(&lit)),
        (&["material"], Column::Byte(&material)),
    ];
    let mut file = BufWriter::new(std::fs::File::create(path)?);
    Ok(write_ply(&mut file, "units: metres; albedo and diffuse lit colour, linear RGB", &scene.mesh, &columns)?)
}

/// Drops vertices by their light, and the triangles that lose one; returns the light of those that stay.
fn drop_vertices(scene: &mut Scene, light: Vec<Vec3>, dropped: impl Fn(Vec3) -> bool) -> Vec<Vec3> {
    let mut kept = 0..;
    let index: Vec<Option<u32>> = light.iter().map(|&l| if dropped(l) { None } else { kept.next() }).collect();
    fn retained<T: Copy>(values: &[T], index: &[Option<u32>]) -> Vec<T> {
        values.iter().zip(index).filter_map(|(v, i)| i.map(|_| *v)).collect()
    }
    let mesh = &mut scene.mesh;
    mesh.positions = retained(&mesh.positions, &index);
    mesh.normals = retained(&mesh.normals, &index);
    scene.part_of_vertex = retained(&scene.part_of_vertex, &index);
    let moved = |t: &[u32; 3]| Some([index[t[0] as usize]?, index[t[1] as usize]?, index[t[2] as usize]?]);
    mesh.triangles = mesh.triangles.iter().filter_map(moved).collect();
    retained(&light, &index)
}

fn rounded(x: f32) -> f64 {
    (f64::from(x) * 1e6).round() / 1e6
}

fn write_json(path: &Path, value: &serde_json::Value) -> Result<(), Box<dyn Error>> {
    let mut file = std::fs::File::create(path)?;
    serde_json::to_writer_pretty(&mut file, value)?;
    Ok(file.write_all(b"\n")?)
}
